//! The only file of the client that knows the transport.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use iceoryx2::pending_response::PendingResponse;
use iceoryx2::port::ReceiveError;
use iceoryx2::port::client::Client as ClientPort;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::prelude::{Alignment, EventId, ServiceName};
use iceoryx2::response::Response;
use trocar_proto::bell::Bells;
use trocar_proto::control::{self, ControlReply, ControlRequest, MAX_MESSAGE, SessionInfo};
use trocar_proto::door::Door;
use trocar_proto::endpoint::{self, Membership, Node, ServerState, Transport};
use trocar_proto::sleep::Woken;
use trocar_proto::vigil::Vigil;
use trocar_proto::wire::{ALIGNMENT, Header};
use trocar_proto::{Code, Rejection};

use crate::error::CallError;
pub(crate) use crate::owned::Owned;

/// How long a wait may last before the server's life is checked; then twice as long, up to [`LONGEST_SLICE`].
pub(crate) const SLICE: Duration = Duration::from_millis(100);
const LONGEST_SLICE: Duration = Duration::from_millis(400);

/// How long control replies are polled for without sleeping.
const BRISK: Duration = Duration::from_micros(200);

/// A reply in shared memory; it stays there until this is dropped.
pub(crate) type RawReply = Response<Transport, [u8], Header>;

type PendingRequest = PendingResponse<Transport, [u8], Header, [u8], Header>;

/// A request that was sent and not yet answered.
#[derive(Debug)]
pub(crate) struct Pending {
    request: PendingRequest,
    /// How often the bell of replies had been rung before it was sent, or when its reply was last looked for.
    seen: u32,
}

type Port = ClientPort<Transport, [u8], Header, [u8], Header>;

/// Names an operation of the transport that failed.
pub(crate) fn transport<E: std::fmt::Debug>(what: &'static str) -> impl FnOnce(E) -> CallError {
    move |error| CallError::Transport(format!("{what}: {error:?}"))
}

/// The connection of one client: its participant of the transport and the control port.
#[derive(Debug)]
pub(crate) struct Link {
    // Declaration order is drop order: ports before the node, the node before the membership.
    /// Threads that share a client take turns: one control request at a time is in flight.
    control: Mutex<Port>,
    bell: Notifier<Transport>,
    door: Door,
    node: Node,
    membership: Membership,
    epoch: u64,
}

impl Link {
    /// Opens the control port of the run `epoch` of the server.
    pub(crate) fn open(membership: Membership, epoch: u64) -> Result<Self, CallError> {
        let node = membership.node().map_err(transport("node"))?;
        let name = service_name(&endpoint::control_service(epoch));
        let service = node
            .service_builder(&name)
            .request_response::<[u8], [u8]>()
            .request_user_header::<Header>()
            .response_user_header::<Header>()
            .open()
            .map_err(transport("control service"))?;
        let control = service
            .client_builder()
            .initial_max_slice_len(MAX_MESSAGE)
            .create()
            .map_err(transport("control port"))?;
        let event =
            node.service_builder(&name).event().open().map_err(transport("control bell"))?;
        let bell = event.notifier_builder().create().map_err(transport("control bell port"))?;
        let door = Door::open(membership.endpoint(), epoch).map_err(transport("door"))?;
        Ok(Self { control: Mutex::new(control), bell, door, node, membership, epoch })
    }

    /// The number that names this participant to the server.
    pub(crate) fn node_id(&self) -> u128 {
        self.node.id().value()
    }

    /// An error if the server that this client connected to takes no more requests.
    pub(crate) fn check_server(&self) -> Result<(), CallError> {
        self.check(false)
    }

    /// An error if it answers none any more, either: one that ends answers what it was asked.
    fn check_answers(&self) -> Result<(), CallError> {
        self.check(true)
    }

    fn check(&self, may_end: bool) -> Result<(), CallError> {
        let endpoint = self.membership.endpoint();
        let closed = match endpoint.server_state() {
            ServerState::Running { epoch, .. } if epoch == self.epoch => return Ok(()),
            ServerState::Ending { epoch, .. } if may_end && epoch == self.epoch => return Ok(()),
            ServerState::Ending { epoch, .. } | ServerState::Closed { epoch } => {
                epoch == self.epoch
            }
            ServerState::Running { .. } | ServerState::Absent => false,
        };
        Err(CallError::ServerLost { name: endpoint.name().to_string(), closed })
    }

    /// Sends one control request and waits for its reply; a refusal is an error.
    pub(crate) fn call(&self, request: &ControlRequest) -> Result<ControlReply, CallError> {
        let mut bytes = vec![0; MAX_MESSAGE];
        let length = control::encode(request, &mut bytes)?;
        let header = Header { length: length as u32, ..Header::new(request.kind()) };
        let reply = self.call_raw(header, &bytes[..length])?;
        match reply {
            ControlReply::Refused(refusal) => Err(refusal.into()),
            reply => Ok(reply),
        }
    }

    /// Sends any header and bytes as a control request; the tests send broken ones.
    pub(crate) fn call_raw(&self, header: Header, bytes: &[u8]) -> Result<ControlReply, CallError> {
        // A server that is gone takes no requests, and sending them would come to wait for ever.
        self.check_server()?;
        let control = self.control.lock().unwrap_or_else(PoisonError::into_inner);
        let mut request =
            control.loan_slice(bytes.len().max(1)).map_err(transport("control request"))?;
        request.payload_mut()[..bytes.len()].copy_from_slice(bytes);
        *request.user_header_mut() = header;
        let pending = request.send().map_err(transport("control request"))?;
        if pending.number_of_server_connections() == 0 {
            self.check_server()?;
            return Err(CallError::Transport("the server is not there yet".into()));
        }
        ring(&self.bell)?;
        let start = Instant::now();
        let mut checked = start;
        loop {
            // Asked before the reply is looked for: a server answers, and then lets go.
            let held = pending.is_connected();
            if let Some(reply) = pending.receive().map_err(transport("control reply"))? {
                let length = (reply.user_header().length as usize).min(reply.payload().len());
                return Ok(control::decode(&reply.payload()[..length])?);
            }
            if !held {
                self.check_server()?;
                return Err(CallError::Transport("the server did not answer; see its log".into()));
            }
            if checked.elapsed() > SLICE {
                self.check_answers()?;
                checked = Instant::now();
            }
            if start.elapsed() < BRISK {
                std::thread::yield_now();
            } else {
                std::thread::sleep(BRISK);
            }
        }
    }
}

/// The ports of one session.
#[derive(Debug)]
pub(crate) struct DataPort {
    port: Port,
    seat: u32,
    bells: Bells,
    vigil: Vigil,
    /// Somebody had to be woken up for the latest request.
    slept: bool,
    request_bytes: usize,
    session: u64,
    link: Arc<Owned<Link>>,
}

impl DataPort {
    pub(crate) fn open(
        link: Arc<Owned<Link>>,
        info: &SessionInfo,
        request_bytes: usize,
    ) -> Result<Self, CallError> {
        let alignment = Alignment::new(ALIGNMENT).expect("a power of two");
        let (epoch, session) = (info.epoch, info.session);
        let service = link
            .node
            .service_builder(&service_name(&endpoint::data_service(epoch, session)))
            .request_response::<[u8], [u8]>()
            .request_user_header::<Header>()
            .response_user_header::<Header>()
            .request_payload_alignment(alignment)
            .response_payload_alignment(alignment)
            .open()
            .map_err(transport("data service"))?;
        let port = service
            .client_builder()
            .initial_max_slice_len(request_bytes)
            .create()
            .map_err(transport("data port"))?;
        let bells = Bells::open(link.membership.endpoint(), epoch, session);
        let bells = bells.map_err(transport("session bells"))?;
        let vigil = Vigil::new();
        Ok(Self { port, seat: info.seat, bells, vigil, slept: false, request_bytes, session, link })
    }

    /// Sends a request whose payload `fill` writes.
    pub(crate) fn send(
        &mut self,
        header: Header,
        fill: impl FnOnce(&mut [u8]),
    ) -> Result<Pending, CallError> {
        let seen = self.bells.reply().count();
        let mut request = self.port.loan_slice(self.request_bytes).map_err(transport("request"))?;
        fill(request.payload_mut());
        *request.user_header_mut() = header;
        let request = request.send().map_err(transport("request"))?;
        self.slept = self.link.door.ring(self.seat, self.bells.size());
        Ok(Pending { request, seen })
    }

    /// Waits at most `patience` for the reply to `pending`. It looks for it when the bell was rung, when the time is over,
    /// and when it has slept in vain; then it also checks that the server lives.
    pub(crate) fn receive(
        &mut self,
        pending: &mut Pending,
        patience: Duration,
    ) -> Result<Option<RawReply>, CallError> {
        let deadline = Instant::now() + patience;
        let (mut slice, mut late) = (SLICE, false);
        self.vigil.begin(self.slept);
        loop {
            let count = self.bells.reply().count();
            let left = deadline.saturating_duration_since(Instant::now());
            if count != pending.seen || late || left.is_zero() {
                if let Some(reply) = self.look(&pending.request)? {
                    self.vigil.end();
                    return Ok(Some(reply));
                }
                (pending.seen, late) = (count, false);
                if left.is_zero() {
                    return Ok(None);
                }
            }
            if self.vigil.keep() {
                continue;
            }
            let (bell, limit) = (self.bells.reply(), left.min(slice));
            match self.link.door.await_reply(self.seat, bell, pending.seen, limit) {
                Woken::Rung => {}
                Woken::Late => {
                    self.link.check_answers()?;
                    slice = (2 * slice).min(LONGEST_SLICE);
                    late = true;
                }
                // The caller may want to act on the signal.
                Woken::Interrupted => return Ok(None),
            }
        }
    }

    /// The reply to `request`, if it is there; an error if it will never be.
    fn look(&self, request: &PendingRequest) -> Result<Option<RawReply>, CallError> {
        // Asked before the reply is looked for: a server answers, and then lets go.
        let held = request.number_of_server_connections() > 0 && request.is_connected();
        match request.receive() {
            Ok(None) if !held => Err(self.why_unanswered()),
            Ok(reply) => Ok(reply),
            Err(ReceiveError::ExceedsMaxBorrows) => Err(CallError::TooManyHeld),
            Err(error) => Err(transport("reply")(error)),
        }
    }

    pub(crate) fn link(&self) -> &Arc<Owned<Link>> {
        &self.link
    }

    /// What to say where the server let go of a request that it did not answer.
    pub(crate) fn why_unanswered(&self) -> CallError {
        let closed = || {
            Rejection::new(
                Code::UnknownSession,
                "session",
                self.session,
                "the server has closed it (idle for longer than serve --idle-limit, or a fault in \
                 its log); open another",
            )
        };
        self.link.check_server().err().unwrap_or_else(|| closed().into())
    }
}

fn ring(bell: &Notifier<Transport>) -> Result<(), CallError> {
    // Fails where the bell's queue is full, and then the server wakes up anyway.
    bell.notify_with_custom_event_id(EventId::new(0)).map(|_| ()).map_err(transport("bell"))
}

fn service_name(name: &str) -> ServiceName {
    name.try_into().expect("names of services are short")
}

/// A refusal that travelled in a data reply.
pub(crate) fn refusal(reply: &RawReply) -> CallError {
    let length = (reply.user_header().length as usize).min(reply.payload().len());
    match control::decode::<Rejection>(&reply.payload()[..length]) {
        Ok(refusal) => refusal.into(),
        Err(refusal) => CallError::Malformed(refusal.to_string()),
    }
}
