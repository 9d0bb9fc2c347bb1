//! The server's ends of the transport: how its services are made, and what a reply is.

use iceoryx2::active_request::ActiveRequest;
use iceoryx2::port::LoanError;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::server::Server as ServerPort;
use iceoryx2::prelude::{Alignment, ServiceName};
use iceoryx2::response_mut::ResponseMut;
use trocar_proto::Rejection;
use trocar_proto::bell::Bells;
use trocar_proto::control::{self, ControlReply, MAX_MESSAGE};
use trocar_proto::endpoint::{self, Endpoint, MAX_CLIENTS, Node, Transport};
use trocar_proto::wire::{ALIGNMENT, Header, MAX_HELD_REPLIES, MAX_IN_FLIGHT};

use super::internal;

/// A request that waits for its reply.
pub(super) type Request = ActiveRequest<Transport, [u8], Header, [u8], Header>;

/// Where requests arrive.
pub(super) type Port = ServerPort<Transport, [u8], Header, [u8], Header>;

/// What tells that some arrived.
pub(super) type Bell = Listener<Transport>;

/// A reply that is being written.
pub(super) type Response = ResponseMut<Transport, [u8], Header>;

/// Room for a reply of `bytes` bytes to `request`. It holds what the last reply there held, of the
/// same session: clearing it would cost as much as writing it.
#[allow(unsafe_code)]
pub(super) fn loan(request: &Request, bytes: usize) -> Result<Response, LoanError> {
    let room = request.loan_slice_uninit(bytes)?;
    // SAFETY: the room lies in a mapping of shared memory, whose bytes are zero until somebody has
    // written them; and every byte is a valid u8.
    Ok(unsafe { room.assume_init() })
}

/// Where control messages arrive.
pub(super) struct ControlPorts {
    pub(super) port: Port,
    pub(super) bell: Listener<Transport>,
}

impl ControlPorts {
    /// Creates the control service of the run `epoch` of the server.
    pub(super) fn open(node: &Node, epoch: u64) -> Result<Self, Rejection> {
        let name = service_name(&endpoint::control_service(epoch));
        let service = node
            .service_builder(&name)
            .request_response::<[u8], [u8]>()
            .request_user_header::<Header>()
            .response_user_header::<Header>()
            .max_servers(1)
            .max_clients(MAX_CLIENTS)
            .max_nodes(MAX_CLIENTS + 1)
            .max_active_requests_per_client(1)
            .max_loaned_requests(1)
            .max_response_buffer_size(1)
            .max_borrowed_responses_per_pending_response(1)
            .enable_safe_overflow_for_requests(false)
            .enable_safe_overflow_for_responses(false)
            .enable_fire_and_forget_requests(false)
            .create()
            .map_err(internal("control service"))?;
        let event = node
            .service_builder(&name)
            .event()
            .max_listeners(1)
            .max_notifiers(MAX_CLIENTS)
            .max_nodes(MAX_CLIENTS + 1)
            .create()
            .map_err(internal("control bell"))?;
        // The listener first: whoever can open the control service can ring.
        let bell = event.listener_builder().create().map_err(internal("control bell port"))?;
        let port = service
            .server_builder()
            .initial_max_slice_len(MAX_MESSAGE)
            .max_loaned_responses_per_request(1)
            .create()
            .map_err(internal("control port"))?;
        Ok(Self { port, bell })
    }
}

/// Sends a control reply. A client that is gone by now gets none.
pub(super) fn reply(request: &Request, reply: &ControlReply) {
    let mut bytes = vec![0; MAX_MESSAGE];
    let encoded = control::encode(reply, &mut bytes)
        .or_else(|refusal| control::encode(&ControlReply::Refused(refusal), &mut bytes));
    let Ok(length) = encoded else { return };
    let sent = request.loan_slice(length).map_err(|error| format!("{error:?}")).and_then(
        |mut response| {
            response.payload_mut().copy_from_slice(&bytes[..length]);
            let asked = request.user_header();
            *response.user_header_mut() =
                Header { length: length as u32, request: asked.request, ..Header::new(asked.kind) };
            response.send().map_err(|error| format!("{error:?}"))
        },
    );
    if let Err(error) = sent {
        tracing::debug!(error, "a control reply was not delivered");
    }
}

/// Where the requests of one session arrive, and what tells its client of replies.
pub(super) struct DataPorts {
    pub(super) port: Port,
    pub(super) bells: Bells,
}

impl DataPorts {
    /// Creates the service and the bells of a session whose replies have `reply_bytes` bytes.
    pub(super) fn open(
        node: &Node,
        endpoint: &Endpoint,
        epoch: u64,
        session: u64,
        reply_bytes: usize,
    ) -> Result<Self, Rejection> {
        let alignment = Alignment::new(ALIGNMENT).expect("a power of two");
        let service = node
            .service_builder(&service_name(&endpoint::data_service(epoch, session)))
            .request_response::<[u8], [u8]>()
            .request_user_header::<Header>()
            .response_user_header::<Header>()
            .request_payload_alignment(alignment)
            .response_payload_alignment(alignment)
            .max_servers(1)
            .max_clients(1)
            .max_nodes(2)
            .max_active_requests_per_client(MAX_IN_FLIGHT)
            .max_loaned_requests(1)
            .max_response_buffer_size(1)
            .max_borrowed_responses_per_pending_response(MAX_HELD_REPLIES)
            .enable_safe_overflow_for_requests(false)
            .enable_safe_overflow_for_responses(false)
            .enable_fire_and_forget_requests(false)
            .create()
            .map_err(internal("data service"))?;
        let bells = Bells::make(endpoint, epoch, session).map_err(internal("session bells"))?;
        let port = service
            .server_builder()
            .initial_max_slice_len(reply_bytes)
            .max_loaned_responses_per_request(1)
            .create()
            .map_err(internal("data port"))?;
        Ok(Self { port, bells })
    }
}

fn service_name(name: &str) -> ServiceName {
    name.try_into().expect("names of services are short")
}
