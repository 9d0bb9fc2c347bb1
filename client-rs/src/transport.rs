//! The only file of the client that knows the transport.

use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use iceoryx2::pending_response::PendingResponse;
use iceoryx2::port::ReceiveError;
use iceoryx2::port::client::Client as ClientPort;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::{DegradationAction, DegradationCause, DegradationInfo};
use iceoryx2::prelude::{BackpressureStrategy, EventId, PortFactory, ServiceName};
use iceoryx2::response::Response;
use iceoryx2::service::port_factory::client::ClientCreateError;
use trocar_proto::cause;
use trocar_proto::control::{
    self, ControlCalls, ControlReply, ControlRequest, MAX_MESSAGE, SessionInfo,
};
use trocar_proto::endpoint::{
    self, CLIENT_BYTES, Endpoint, Membership, Node, ServerState, Transport,
};
use trocar_proto::missing_page::guarded;
use trocar_proto::notify::doorbell::Doorbell;
use trocar_proto::notify::futex::WaitOutcome;
use trocar_proto::notify::reply_event::ReplyEvent;
use trocar_proto::notify::spin_wait::SpinWait;
use trocar_proto::open_files::{CLIENT_FILES, OpenFiles};
use trocar_proto::wire::{Header, MAX_HELD_REPLIES};
use trocar_proto::{Code, Rejection};

use crate::error::CallError;
pub(crate) use crate::owned::Owned;

/// How long a wait may last before the server's life is checked; then twice as long, up to [`LONGEST_SLICE`].
pub(crate) const SLICE: Duration = Duration::from_millis(100);
const LONGEST_SLICE: Duration = Duration::from_millis(400);

/// Control requests that there is room for: one that is written, one that the server may still look at.
const CONTROL_REQUESTS: usize = 2;

/// How long control replies are polled for without sleeping.
const BRISK: Duration = Duration::from_micros(200);

/// How long a server may stand still while a client waits for it.
const STILL: Duration = Duration::from_secs(7);

/// Longest pause between two looks at its heartbeat: after more, the client was not waiting.
const PAUSE: Duration = Duration::from_secs(1);

/// How long a control request may take; one that opens a session may have to prepare where its episodes begin.
const LIMIT: Duration = Duration::from_secs(8);
const OPENING_LIMIT: Duration = Duration::from_mins(10);

/// The heartbeat of a server, as its waiting client sees it.
#[derive(Debug)]
struct Heartbeat {
    count: u32,
    /// Since when it has been that, under continued watch.
    since: Instant,
    looked: Instant,
}

/// A reply in shared memory; it stays there until this is dropped.
#[derive(Debug)]
pub(crate) struct RawReply {
    response: Response<Transport, [u8], Header>,
    /// One of those that its session has handed out.
    _held: Arc<()>,
}

impl Deref for RawReply {
    type Target = Response<Transport, [u8], Header>;

    fn deref(&self) -> &Self::Target {
        &self.response
    }
}

type PendingRequest = PendingResponse<Transport, [u8], Header, [u8], Header>;

/// A request that was sent and not yet answered.
#[derive(Debug)]
pub(crate) struct Pending {
    request: PendingRequest,
    /// How many replies there were before it was sent, or when its reply was last looked for.
    seen: u32,
}

type Port = ClientPort<Transport, [u8], Header, [u8], Header>;

/// Names an operation of the transport that failed, and why it did.
pub(crate) fn transport<E: std::fmt::Debug>(what: &'static str) -> impl FnOnce(E) -> CallError {
    move |error| CallError::Transport(format!("{what}: {}", cause::explain(&error)))
}

fn io(what: &'static str) -> impl FnOnce(std::io::Error) -> CallError {
    move |error| CallError::Transport(format!("{what}: {error}"))
}

#[allow(clippy::needless_pass_by_value)] // for map_err
fn shared_memory(error: std::io::Error) -> CallError {
    CallError::Transport(error.to_string())
}

/// Why a port could not be connected to the server, if it could not: the transport tries that once, and goes on.
#[derive(Debug, Clone, Default)]
struct Missed(Arc<Mutex<Option<String>>>);

impl Missed {
    /// What the transport calls there.
    fn handler(
        &self,
    ) -> impl Fn(DegradationCause, &DegradationInfo) -> DegradationAction + Send + use<> {
        let missed = self.clone();
        move |_, _| {
            let cause = cause::take().unwrap_or_default();
            *missed.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(cause);
            DegradationAction::Ignore
        }
    }

    fn check(&self) -> Result<(), CallError> {
        match self.0.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(cause) => Err(CallError::Transport(format!("connection to the server: {cause}"))),
            None => Ok(()),
        }
    }
}

/// The connection of one client: its participant of the transport and the control port.
#[derive(Debug)]
pub(crate) struct Link {
    // Declaration order is drop order: ports before the node, the node before the membership.
    /// Threads that share a client take turns: one control request at a time is in flight.
    control: Mutex<Port>,
    missed: Missed,
    event: Notifier<Transport>,
    doorbell: Doorbell,
    heartbeat: Mutex<Heartbeat>,
    node: Node,
    membership: Membership,
    epoch: u64,
}

impl ControlCalls for Link {
    type Error = CallError;

    fn call(&self, request: &ControlRequest) -> Result<ControlReply, CallError> {
        let mut bytes = vec![0; MAX_MESSAGE];
        let length = control::encode(request, &mut bytes)?;
        let header = Header { length: length as u32, ..Header::new(request.kind()) };
        let reply = self.call_raw(header, &bytes[..length], request.purpose())?;
        match reply {
            ControlReply::Refused(refusal) => Err(refusal.into()),
            reply => Ok(reply),
        }
    }

    fn unexpected(reply: &ControlReply) -> CallError {
        let version = trocar_proto::PROTOCOL_VERSION;
        CallError::Malformed(format!("version {version} does not expect {reply:?} here"))
    }
}

impl Link {
    /// Whether this process can have another connection at all; else, why not.
    pub(crate) fn check_room() -> Result<(), String> {
        Endpoint::check_free("a client", CLIENT_BYTES).map_err(|error| error.to_string())?;
        OpenFiles::now().check("a client", CLIENT_FILES)
    }

    /// Opens the control port of the run `epoch` of the server.
    pub(crate) fn open(membership: Membership, epoch: u64) -> Result<Self, CallError> {
        guarded(|| Self::try_open(membership, epoch)).map_err(shared_memory)?
    }

    fn try_open(membership: Membership, epoch: u64) -> Result<Self, CallError> {
        let node = membership.node().map_err(transport("node"))?;
        let missed = Missed::default();
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
            .override_request_preallocation(|_| CONTROL_REQUESTS)
            .set_request_degradation_handler(missed.handler())
            .set_response_degradation_handler(missed.handler())
            // Else a server that does not take an earlier request would be waited for without end.
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|error| match error {
                ClientCreateError::ExceedsMaxSupportedClients => {
                    let most = service.dynamic_config().number_of_clients();
                    let why = "the server takes no more; close some, or raise its limit of open files (ulimit -n)";
                    Rejection::new(Code::TooManySessions, "clients", most + 1, why).into()
                }
                error => transport("control port")(error),
            })?;
        missed.check()?;
        let event =
            node.service_builder(&name).event().open().map_err(transport("control event"))?;
        let event = event.notifier_builder().create().map_err(transport("control event port"))?;
        let doorbell = Doorbell::open(membership.endpoint(), epoch).map_err(io("doorbell"))?;
        membership.endpoint().allocate("a client").map_err(shared_memory)?;
        let now = Instant::now();
        let heartbeat =
            Mutex::new(Heartbeat { count: doorbell.heartbeat(), since: now, looked: now });
        let control = Mutex::new(control);
        Ok(Self { control, missed, event, doorbell, heartbeat, node, membership, epoch })
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
        // Where it cannot be looked for, this process lacks something. Whether the server goes on, its heartbeat tells.
        let Ok(state) = endpoint.look() else { return Ok(()) };
        let closed = match state {
            ServerState::Running { epoch, .. } if epoch == self.epoch => return Ok(()),
            ServerState::Ending { epoch, .. } if may_end && epoch == self.epoch => return Ok(()),
            ServerState::Ending { epoch, .. } | ServerState::Closed { epoch } => {
                epoch == self.epoch
            }
            ServerState::Running { .. } | ServerState::Absent => false,
        };
        Err(CallError::ServerLost { name: endpoint.name().to_string(), closed })
    }

    /// An error if the server has stood still while `what` was waited for, which began at `start`. A server that goes on
    /// has a moment to say so.
    fn check_heartbeat(&self, what: &str, start: Instant) -> Result<(), CallError> {
        let (count, now) = (self.doorbell.heartbeat(), Instant::now());
        let mut heartbeat = self.heartbeat.lock().unwrap_or_else(PoisonError::into_inner);
        if heartbeat.count != count || now - heartbeat.looked > PAUSE {
            (heartbeat.count, heartbeat.since) = (count, now);
        }
        heartbeat.looked = now;
        if now - heartbeat.since < STILL || now - start < 2 * PAUSE {
            return Ok(());
        }
        Err(self.timeout(format!("{what}; it is stopped or gets no processor"), STILL))
    }

    fn timeout(&self, what: String, waited: Duration) -> CallError {
        let name = self.membership.endpoint().name().to_string();
        CallError::Timeout { name, what, seconds: waited.as_secs_f64() }
    }

    /// Sends any header and bytes as a control request; the tests send broken ones.
    pub(crate) fn call_raw(
        &self,
        header: Header,
        bytes: &[u8],
        purpose: &str,
    ) -> Result<ControlReply, CallError> {
        // A server that is gone takes no requests, and sending them would come to wait for ever.
        self.check_server()?;
        let control = self.control.lock().unwrap_or_else(PoisonError::into_inner);
        let start = Instant::now();
        cause::forget();
        let pending = loop {
            let mut request =
                control.loan_slice(bytes.len().max(1)).map_err(transport("control request"))?;
            request.payload_mut()[..bytes.len()].copy_from_slice(bytes);
            *request.user_header_mut() = header;
            let pending = guarded(|| request.send())
                .map_err(shared_memory)?
                .map_err(transport("control request"))?;
            if pending.number_of_server_connections() > 0 {
                break pending;
            }
            self.missed.check()?;
            // Its port is not there yet, or it has not taken an earlier request, whose sender gave up.
            self.check_server()?;
            self.check_heartbeat(purpose, start)?;
            if start.elapsed() > LIMIT {
                return Err(self.timeout(format!("{purpose}; it takes no requests"), LIMIT));
            }
            std::thread::sleep(BRISK);
        };
        notify(&self.event)?;
        let mut checked = start;
        loop {
            // Asked before the reply is looked for: a server answers, and then lets go.
            let held = pending.is_connected();
            let received = guarded(|| pending.receive()).map_err(shared_memory)?;
            if let Some(reply) = received.map_err(transport("control reply"))? {
                let length = (reply.user_header().length as usize).min(reply.payload().len());
                return Ok(control::decode(&reply.payload()[..length])?);
            }
            if !held {
                self.check_server()?;
                return Err(CallError::Transport("the server did not answer; see its log".into()));
            }
            if checked.elapsed() > SLICE {
                self.check_answers()?;
                self.check_heartbeat(purpose, start)?;
                let is_opening = header.kind == ControlRequest::OPEN_SESSION;
                let limit = if is_opening { OPENING_LIMIT } else { LIMIT };
                if start.elapsed() > limit {
                    return Err(self.timeout(purpose.into(), limit));
                }
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
    slot: u32,
    replies: ReplyEvent,
    /// Has a clone in each reply that is held on to.
    held: Arc<()>,
    spin_wait: SpinWait,
    /// Since when replies have been waited for, at most: the latest request, or the latest loss of patience.
    waiting: Instant,
    /// A worker had to be woken up for the latest request.
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
        guarded(|| Self::try_open(link, info, request_bytes)).map_err(shared_memory)?
    }

    fn try_open(
        link: Arc<Owned<Link>>,
        info: &SessionInfo,
        request_bytes: usize,
    ) -> Result<Self, CallError> {
        cause::forget();
        let (epoch, session) = (info.epoch, info.session);
        let missed = Missed::default();
        let service = link
            .node
            .service_builder(&service_name(&endpoint::data_service(epoch, session)))
            .request_response::<[u8], [u8]>()
            .request_user_header::<Header>()
            .response_user_header::<Header>()
            .open()
            .map_err(transport("data service"))?;
        let port = service
            .client_builder()
            .initial_max_slice_len(request_bytes)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .set_request_degradation_handler(missed.handler())
            .set_response_degradation_handler(missed.handler())
            .create()
            .map_err(transport("data port"))?;
        missed.check()?;
        let endpoint = link.membership.endpoint();
        let replies =
            ReplyEvent::open(endpoint, epoch, session).map_err(io("the session's replies"))?;
        endpoint.allocate("the session").map_err(shared_memory)?;
        let spin_wait = SpinWait::new();
        let held = Arc::new(());
        Ok(Self {
            port,
            slot: info.slot,
            replies,
            held,
            spin_wait,
            waiting: Instant::now(),
            slept: false,
            request_bytes,
            session,
            link,
        })
    }

    /// Sends a request whose payload `fill` writes.
    pub(crate) fn send(
        &mut self,
        header: Header,
        fill: impl FnOnce(&mut [u8]),
    ) -> Result<Pending, CallError> {
        cause::forget();
        let seen = self.replies.count();
        let mut request = self.port.loan_slice(self.request_bytes).map_err(transport("request"))?;
        fill(request.payload_mut());
        *request.user_header_mut() = header;
        let request =
            guarded(|| request.send()).map_err(shared_memory)?.map_err(transport("request"))?;
        self.slept = self.link.doorbell.ring(self.slot);
        self.waiting = Instant::now();
        Ok(Pending { request, seen })
    }

    /// Waits at most `patience` for the reply to `pending`. It looks for it when there is a reply more, when the time is over,
    /// and when it has slept in vain; then it also checks that the server lives.
    pub(crate) fn receive(
        &mut self,
        pending: &mut Pending,
        patience: Duration,
    ) -> Result<Option<RawReply>, CallError> {
        let deadline = Instant::now() + patience;
        let (mut slice, mut late) = (SLICE, false);
        self.spin_wait.begin(self.slept);
        loop {
            let count = self.replies.count();
            let left = deadline.saturating_duration_since(Instant::now());
            if count != pending.seen || late || left.is_zero() {
                if let Some(reply) = self.look(&pending.request)? {
                    self.spin_wait.end();
                    return Ok(Some(reply));
                }
                (pending.seen, late) = (count, false);
                if left.is_zero() {
                    return Ok(None);
                }
            }
            if self.spin_wait.spin() {
                continue;
            }
            match self.replies.wait(pending.seen, left.min(slice)) {
                WaitOutcome::Woken => {}
                WaitOutcome::TimedOut => {
                    self.link.check_answers()?;
                    let what = "the reply to a step, reset or snapshot";
                    let still = self.link.check_heartbeat(what, self.waiting);
                    still.inspect_err(|_| self.waiting = Instant::now())?;
                    slice = (2 * slice).min(LONGEST_SLICE);
                    late = true;
                }
                // The caller may want to act on the signal.
                WaitOutcome::Interrupted => return Ok(None),
            }
        }
    }

    /// The reply to `request`, if it is there; an error if it will never be.
    fn look(&self, request: &PendingRequest) -> Result<Option<RawReply>, CallError> {
        // Asked before the reply is looked for: a server answers, and then lets go.
        let connected = request.number_of_server_connections() > 0 && request.is_connected();
        if Arc::strong_count(&self.held) > MAX_HELD_REPLIES && request.has_response() {
            return Err(CallError::TooManyHeld);
        }
        match guarded(|| request.receive()).map_err(shared_memory)? {
            Ok(None) if !connected => Err(self.why_unanswered()),
            Ok(response) => {
                Ok(response.map(|response| RawReply { response, _held: Arc::clone(&self.held) }))
            }
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

fn notify(event: &Notifier<Transport>) -> Result<(), CallError> {
    // Fails where the event's queue is full, and then the server wakes up anyway.
    event
        .notify_with_custom_event_id(EventId::new(0))
        .map(|_| ())
        .map_err(transport("control event"))
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
