//! The server's ends of the transport: how its services are made, and what a reply is.
//!
//! Whatever looks for requests or sends a reply connects to clients that have come meanwhile, and opens their shared
//! memory: so it is [`guarded`].

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use iceoryx2::active_request::ActiveRequest;
use iceoryx2::port::LoanError;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::server::Server as ServerPort;
use iceoryx2::port::update_connections::UpdateConnections as _;
use iceoryx2::port::{DegradationAction, DegradationCause, DegradationInfo};
use iceoryx2::prelude::{PortFactory as _, ServiceName};
use iceoryx2::response_mut::ResponseMut;
use iceoryx2::service::port_factory::request_response::PortFactory;
use trocar_proto::Rejection;
use trocar_proto::cause;
use trocar_proto::control::{self, ControlReply, MAX_MESSAGE};
use trocar_proto::endpoint::{self, Endpoint, MAX_CLIENTS, Node, Transport};
use trocar_proto::missing_page::guarded;
use trocar_proto::notify::reply_event::ReplyEvent;
use trocar_proto::open_files::{OpenFiles, SESSION_FILES};
use trocar_proto::wire::{Header, MAX_HELD_REPLIES, MAX_IN_FLIGHT};

use super::admission::CONTROL_FILES;
use super::internal;

/// Control replies that there is room for at a time: those that clients have not read yet.
const CONTROL_REPLIES: usize = 32;

/// How long a control reply waits for room: clients read theirs at once, unless they are stopped.
const ROOM: Duration = Duration::from_millis(100);

/// Files that the server has open for a client's control requests.
const CLIENT_PORT_FILES: usize = 3;

/// Shared memory that a server takes beside its sessions, bytes: room for control replies, and bookkeeping.
pub(super) const START_BYTES: u64 = (CONTROL_REPLIES * MAX_MESSAGE) as u64 + (384 << 10);

/// Replies of a session that there is room for at a time: those that its client holds on to, those to requests in
/// flight and to as many that it has dropped, and the one that is written.
pub(super) const REPLIES: usize = MAX_HELD_REPLIES + 2 * MAX_IN_FLIGHT + 1;

/// A request that waits for its reply.
pub(super) type Request = ActiveRequest<Transport, [u8], Header, [u8], Header>;

/// Where requests arrive.
type Port = ServerPort<Transport, [u8], Header, [u8], Header>;

/// A service with such requests.
type Service = PortFactory<Transport, [u8], Header, [u8], Header>;

/// A reply that is being written.
pub(super) type Response = ResponseMut<Transport, [u8], Header>;

/// Room for a reply of `bytes` bytes to `request`. It holds what the last reply there held, of the
/// same session: clearing it would cost as much as writing it.
#[allow(unsafe_code)]
pub(super) fn loan(request: &Request, bytes: usize) -> Result<Response, LoanError> {
    let room = request.loan_slice_uninit(bytes)?;
    // SAFETY: the room lies in a mapping of shared memory, whose bytes are zero until they are
    // first written; and every byte is a valid u8.
    Ok(unsafe { room.assume_init() })
}

/// Sends a reply. Before that, the transport connects to clients that have come.
pub(super) fn send(response: Response) -> Result<(), String> {
    match guarded(|| response.send()) {
        Ok(sent) => sent.map_err(|error| format!("{error:?}")),
        Err(error) => Err(error.to_string()),
    }
}

/// Most clients at a time: each may have files open in the server for itself and a session.
fn most_clients() -> usize {
    let files = OpenFiles::now();
    let each = SESSION_FILES + CLIENT_PORT_FILES;
    (files.limit.saturating_sub(files.used + CONTROL_FILES) / each).clamp(1, MAX_CLIENTS)
}

/// Whether a port could not be connected to a client. The transport tries that once for each client, and once more
/// whenever one comes or goes.
#[derive(Clone, Default)]
struct Missed(Arc<AtomicBool>);

impl Missed {
    /// What the transport calls there.
    fn handler(
        &self,
    ) -> impl Fn(DegradationCause, &DegradationInfo) -> DegradationAction + Send + use<> {
        let missed = self.clone();
        move |_, _| {
            let cause = cause::take().unwrap_or_default();
            tracing::warn!(cause, "a client could not be connected");
            missed.0.store(true, Ordering::Relaxed);
            DegradationAction::Ignore
        }
    }

    /// Whether that happened since it was last asked.
    fn take(&self) -> bool {
        // Mostly it did not, and reading is cheaper.
        self.0.load(Ordering::Relaxed) && self.0.swap(false, Ordering::Relaxed)
    }
}

/// Where control messages arrive.
pub(super) struct ControlPorts {
    pub(super) event: Listener<Transport>,
    port: Port,
    service: Service,
    missed: Missed,
}

impl ControlPorts {
    /// Creates the control service of the run `epoch` of the server.
    pub(super) fn open(node: &Node, epoch: u64) -> Result<Self, Rejection> {
        cause::forget();
        let clients = most_clients();
        let name = service_name(&endpoint::control_service(epoch));
        let service = node
            .service_builder(&name)
            .request_response::<[u8], [u8]>()
            .request_user_header::<Header>()
            .response_user_header::<Header>()
            .max_servers(1)
            .max_clients(clients)
            .max_nodes(clients + 1)
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
            .max_notifiers(clients)
            .max_nodes(clients + 1)
            .create()
            .map_err(internal("control event"))?;
        // The listener first: a client that can open the control service can ring.
        let event = event.listener_builder().create().map_err(internal("control event port"))?;
        let missed = Missed::default();
        let port = service
            .server_builder()
            .initial_max_slice_len(MAX_MESSAGE)
            .max_loaned_responses_per_request(1)
            .override_response_preallocation(|_| CONTROL_REPLIES)
            .set_request_degradation_handler(missed.handler())
            .set_response_degradation_handler(missed.handler())
            .create()
            .map_err(internal("control port"))?;
        Ok(Self { event, port, service, missed })
    }

    /// The next request.
    pub(super) fn receive(&self) -> Option<Request> {
        // The transport drops requests of clients that it is connected to in one direction only.
        if guarded(|| self.port.update_connections().ok()).is_err() {
            tracing::warn!("a client that had no shared memory could not be connected");
        }
        if self.missed.take() {
            self.look_again();
        }
        guarded(|| self.port.receive().ok().flatten()).ok().flatten()
    }

    /// Lets the port connect to the clients that it has missed, since another one comes and goes.
    fn look_again(&self) {
        let looked = guarded(|| {
            let passing = self.service.client_builder().initial_max_slice_len(1).create();
            let passing = passing.map_err(|error| cause::explain(&error))?;
            self.port.update_connections().ok();
            drop(passing);
            Ok::<_, String>(())
        });
        if let Err(cause) = looked.map_err(|error| error.to_string()).flatten() {
            tracing::warn!(cause, "clients that were missed are looked for later");
            self.missed.0.store(true, Ordering::Relaxed);
        }
    }
}

/// Sends a control reply. A client that is gone by now gets none.
pub(super) fn reply(request: &Request, reply: &ControlReply) {
    let mut bytes = vec![0; MAX_MESSAGE];
    let encoded = control::encode(reply, &mut bytes)
        .or_else(|refusal| control::encode(&ControlReply::Refused(refusal), &mut bytes));
    let Ok(length) = encoded else { return };
    let start = Instant::now();
    let room = loop {
        match request.loan_slice(length) {
            Err(LoanError::OutOfMemory) if start.elapsed() < ROOM => {
                std::thread::sleep(ROOM / 100);
            }
            room => break room,
        }
    };
    let sent = room.map_err(|error| format!("{error:?}")).and_then(|mut response| {
        response.payload_mut().copy_from_slice(&bytes[..length]);
        let asked = request.user_header();
        *response.user_header_mut() =
            Header { length: length as u32, request: asked.request, ..Header::new(asked.kind) };
        send(response)
    });
    if let Err(error) = sent {
        tracing::warn!(error, "a control reply was not delivered");
    }
}

/// The client of a session cannot be connected.
#[derive(Debug)]
pub(super) struct Unreachable;

/// Of the open files of a session, those that it takes once its client is connected.
pub(super) const CONNECTION_FILES: usize = 3;

/// Where the requests of one session arrive, and what tells its client of replies.
pub(super) struct DataPorts {
    port: Port,
    pub(super) replies: ReplyEvent,
    service: Service,
    missed: Missed,
}

impl DataPorts {
    /// Creates the service of a session, and the event count of its replies, whose replies have `reply_bytes` bytes.
    pub(super) fn open(
        node: &Node,
        endpoint: &Endpoint,
        epoch: u64,
        session: u64,
        reply_bytes: usize,
    ) -> Result<Self, Rejection> {
        cause::forget();
        let service = node
            .service_builder(&service_name(&endpoint::data_service(epoch, session)))
            .request_response::<[u8], [u8]>()
            .request_user_header::<Header>()
            .response_user_header::<Header>()
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
        let replies = ReplyEvent::make(endpoint, epoch, session)
            .map_err(internal("the session's replies"))?;
        let missed = Missed::default();
        let port = service
            .server_builder()
            .initial_max_slice_len(reply_bytes)
            .max_loaned_responses_per_request(1)
            .override_response_preallocation(|_| REPLIES)
            .set_request_degradation_handler(missed.handler())
            .set_response_degradation_handler(missed.handler())
            .create()
            .map_err(internal("data port"))?;
        Ok(Self { port, replies, service, missed })
    }

    /// Whether there is a client, to which [`Self::receive`] connects.
    pub(super) fn has_client(&self) -> bool {
        self.service.dynamic_config().number_of_clients() > 0
    }

    /// Whether there may be another request.
    pub(super) fn has_requests(&self) -> bool {
        guarded(|| self.port.has_requests().unwrap_or(true)).unwrap_or(true)
    }

    /// The next request; an error where its client could not be connected, which would wait for replies in vain.
    pub(super) fn receive(&self) -> Result<Option<Request>, Unreachable> {
        let received = guarded(|| self.port.receive());
        if self.missed.take() {
            return Err(Unreachable);
        }
        match received {
            Ok(Ok(request)) => Ok(request),
            Ok(Err(error)) => {
                tracing::warn!(?error, "a request was not received");
                Ok(None)
            }
            Err(error) => {
                tracing::warn!(%error, "a client could not be connected");
                Err(Unreachable)
            }
        }
    }
}

fn service_name(name: &str) -> ServiceName {
    name.try_into().expect("names of services are short")
}
