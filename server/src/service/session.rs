//! A session: answers its client's messages, one when it is its quantum.

use std::convert::Infallible;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use trocar_proto::control::{self, ClientInfo, ControlReply, SessionInfo, SessionRequest};
use trocar_proto::dvrk::LiveInfo;
use trocar_proto::endpoint::{Endpoint, Node};
use trocar_proto::missing_page::guarded;
use trocar_proto::open_files::SESSION_FILES;
use trocar_proto::spec::ImageSpec;
use trocar_proto::wire::{Header, MAX_IN_FLIGHT, kind};
use trocar_proto::{Code, Rejection, TaskSpec};

use super::admission::{self, Footprint};
use super::batch_session::BatchSession;
use super::handle::{Nature, Pace, SessionHandle, Shared};
use super::internal;
use super::live_session::LiveSession;
use super::meter::Meter;
use super::observer::{Failures, LiveRecording};
use super::ports::{self, DataPorts, Request, Unreachable};
use super::scheduler::{
    Entity, Poll, Polled, Quantum, Scheduler, SlotId, SlotReservation, ThreadQuota,
};
use super::store::{Ledger, Store};
use super::watch::{Registration, Subscriptions, WatchRegistry};
use crate::env::Env;
use crate::registry::Registry;

/// What all sessions of a server share.
pub(super) struct ServerContext {
    pub(super) registry: Arc<Registry>,
    pub(super) meter: Arc<Meter>,
    pub(super) node: Arc<Node>,
    pub(super) endpoint: Endpoint,
    pub(super) epoch: u64,
    pub(super) idle_limit: Duration,
    /// Where failures are recorded, if they are.
    pub(super) failures: Option<Failures>,
    /// Where sessions show themselves, if they may be watched.
    pub(super) watch: Arc<WatchRegistry>,
    /// The threads that step environments.
    pub(super) scheduler: Arc<Scheduler>,
}

/// What all sessions of a client have together.
#[derive(Clone)]
pub(super) struct ClientQuota {
    /// The memory that they may take.
    pub(super) ledger: Arc<Ledger>,
    /// The threads that they may have.
    pub(super) threads: Arc<ThreadQuota>,
}

/// Counts a session that is refused, and says so in the log.
pub(super) fn note_refusal(meter: &Meter, pid: u32, refusal: &Rejection) {
    meter.refused(refusal.code);
    let Rejection { code, field, value, allowed } = refusal;
    tracing::info!(pid, ?code, field, value, allowed, "session refused");
}

/// Opens a session in `slot`, on a thread of its own, which answers `request` when all is in place, or says why not.
pub(super) fn open(
    context: Arc<ServerContext>,
    quota: ClientQuota,
    (id, slot): (u64, SlotReservation),
    wanted: SessionRequest,
    client: ClientInfo,
    footprint: Footprint,
    request: Request,
) -> Option<SessionHandle> {
    let shared = Arc::new(Shared {
        id,
        slot: slot.id,
        client,
        task: wanted.task.clone(),
        envs: wanted.envs,
        stop: AtomicBool::new(false),
        finish: AtomicBool::new(false),
        reason: OnceLock::new(),
        pace: Mutex::new(Pace::new()),
        store: Mutex::new(None),
        recording: LiveRecording::default(),
        nature: OnceLock::new(),
        subscriptions: Subscriptions::default(),
        world: OnceLock::new(),
        files_due: AtomicUsize::new(SESSION_FILES),
    });
    let meter = Arc::clone(&context.meter);
    let (life, ended) = channel();
    // If the thread cannot be started, the request goes back with it and the client is told.
    let parcel = Arc::new(Mutex::new(Some((wanted, request))));
    let (inner, in_thread) = (Arc::clone(&shared), Arc::clone(&parcel));
    let pid = shared.client.pid;
    let thread = std::thread::Builder::new().name(format!("trocar-open-{id}")).spawn(move || {
        let parcel = in_thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some((wanted, request)) = parcel else { return };
        let entity = Entity::new(&quota.threads);
        let opened = match wanted.live {
            None => BatchSession::new(&context, &inner, &wanted)
                .and_then(|kind| Session::open(&context, quota, inner, &wanted, kind, slot, life)),
            Some(live) => LiveSession::new(&context, &quota.ledger, &inner, &wanted, live)
                .and_then(|kind| Session::open(&context, quota, inner, &wanted, kind, slot, life)),
        };
        match opened {
            Ok(Opened { session, slot, info }) => {
                ports::reply(&request, &ControlReply::OpenSession(info.into()));
                drop(request);
                context.scheduler.occupy(slot, entity, session);
            }
            Err(refusal) => {
                note_refusal(&context.meter, pid, &refusal);
                ports::reply(&request, &ControlReply::Refused(refusal));
            }
        }
    });
    match thread {
        Ok(_) => Some(SessionHandle { shared, ended, footprint }),
        Err(error) => {
            let refusal = internal("thread")(error);
            note_refusal(&meter, pid, &refusal);
            if let Some((_, request)) = parcel.lock().unwrap_or_else(PoisonError::into_inner).take()
            {
                ports::reply(&request, &ControlReply::Refused(refusal));
            }
            None
        }
    }
}

/// What a session holds, and what it does with its client's messages: environments that are stepped, or a live world.
pub(super) trait SessionKind: Send + 'static {
    /// What its client is told of it.
    fn describe(&self) -> Description;

    /// An environment like those that it has, for its snapshots.
    fn like(&self) -> Arc<Env>;

    /// Size of a reply to a request of this kind, bytes.
    fn reply_bytes(&self, kind: u32) -> usize;

    /// Size of its largest reply, bytes: a picture, or what every other request is answered with.
    fn most_bytes(&self) -> usize {
        self.reply_bytes(kind::RENDER).max(self.reply_bytes(kind::STEP))
    }

    /// Carries out a request, which was found at `start`, and writes its reply. Returns how many steps environments
    /// took.
    fn carry_out(
        &mut self,
        asked: &Header,
        payload: &[u8],
        reply: &mut [u8],
        start: Instant,
        quantum: &mut Quantum<'_>,
    ) -> Result<u64, Rejection>;

    /// Lets time pass that passes without requests.
    fn pass_time(&mut self, _quantum: &mut Quantum<'_>) {}

    /// Shows itself to the pages that watch.
    fn show(&mut self);

    /// The latest message took so much CPU time.
    fn learn(&mut self, time: Duration);
}

/// What the client of a session is told of it.
pub(super) struct Description {
    pub(super) spec: TaskSpec,
    pub(super) view: Option<Box<ImageSpec>>,
    pub(super) live: Option<Box<LiveInfo>>,
}

/// A session that was opened.
struct Opened {
    session: Box<dyn Poll>,
    slot: SlotId,
    info: SessionInfo,
}

/// The server's side of a session.
struct Session<K> {
    context: Arc<ServerContext>,
    shared: Arc<Shared>,
    kind: K,
    ports: DataPorts,
    stats: SessionStats,
    // Dropped last, in this order: from then on its slot is free, and nothing is left of it.
    _registration: Registration,
    _slot: SlotReservation,
    _life: Sender<Infallible>,
}

/// How a session has gone so far.
struct SessionStats {
    opened: Instant,
    /// When its client last sent something.
    active: Instant,
    /// Steps that environments took.
    steps: u64,
    /// Requests that a client may still have in flight when its server was told to end.
    left: usize,
}

impl<K: SessionKind> Session<K> {
    fn open(
        context: &Arc<ServerContext>,
        quota: ClientQuota,
        shared: Arc<Shared>,
        wanted: &SessionRequest,
        kind: K,
        slot: SlotReservation,
        life: Sender<Infallible>,
    ) -> Result<Opened, Rejection> {
        let Description { spec, view, live } = kind.describe();
        let (epoch, id, envs) = (context.epoch, shared.id, wanted.envs);
        shared.nature.get_or_init(|| Nature {
            max_steps: spec.max_steps,
            seconds_per_step: spec.seconds_per_step,
            has_goal: spec.goal.is_some(),
        });
        let store = Store::new(quota.ledger, &kind.like());
        *shared.store.lock().unwrap_or_else(PoisonError::into_inner) = Some(store);
        // Starts may have taken long, and nothing may be put where the server has cleared away.
        if shared.stop.load(Ordering::Acquire) {
            return Err(shared.being_closed());
        }
        let no_room = |error: std::io::Error| {
            Rejection::new(Code::MemoryBudget, "envs", envs, error.to_string())
        };
        let most = kind.most_bytes();
        let ports = guarded(|| DataPorts::open(&context.node, &context.endpoint, epoch, id, most))
            .map_err(no_room)??;
        shared.files_due.store(ports::CONNECTION_FILES, Ordering::Relaxed);
        // What is promised to a client is its own from now on, whatever fills shared memory.
        context.endpoint.allocate("the session").map_err(no_room)?;
        let Shared { task, client, .. } = &*shared;
        let (pid, language, is_live) = (client.pid, client.language.as_str(), live.is_some());
        tracing::info!(session = id, pid, language, task, envs, is_live, "session opened");
        context.meter.opened();
        let slot_id = slot.id;
        let info = SessionInfo { session: id, epoch, slot: slot_id.0, envs, spec, view, live };
        let session = Self {
            ports,
            kind,
            stats: SessionStats {
                opened: Instant::now(),
                active: Instant::now(),
                steps: 0,
                left: MAX_IN_FLIGHT,
            },
            _registration: context.watch.register(id, Arc::clone(&shared)),
            context: Arc::clone(context),
            shared,
            _slot: slot,
            _life: life,
        };
        Ok(Opened { session: Box::new(session), slot: slot_id, info })
    }

    /// Takes note that it ends.
    fn end(&self) {
        let Shared { id, task, envs, client, reason, .. } = &*self.shared;
        let SessionStats { opened, steps, .. } = self.stats;
        let reason = reason.get().copied().unwrap_or("idle");
        self.context.meter.closed(reason);
        let (session, pid, seconds) = (id, client.pid, opened.elapsed().as_secs_f64());
        tracing::info!(session, pid, task, envs, reason, steps, seconds, "session closed");
    }

    /// Where there is no request.
    fn rest(&mut self, finish: bool) -> Polled {
        if finish || self.stats.active.elapsed() > self.context.idle_limit {
            self.end();
            return Polled::Closed;
        }
        if self.shared.subscriptions.is_watched() {
            self.kind.show();
        }
        Polled::Idle
    }

    /// Answers one request, which was found at `start`; returns how many steps environments took, and whether the client had to be woken up.
    fn answer(
        &mut self,
        request: &Request,
        start: Instant,
        quantum: &mut Quantum<'_>,
    ) -> (u64, bool) {
        let asked = *request.user_header();
        let room = self.kind.reply_bytes(asked.kind);
        let mut response = match ports::loan(request, room) {
            Ok(response) => response,
            Err(error) => {
                tracing::warn!(session = self.shared.id, ?error, "no room for a reply");
                return (0, false);
            }
        };
        let mut header = Header {
            session: self.shared.id,
            epoch: self.context.epoch,
            ..Header::new(asked.kind)
        };
        header.request = asked.request;
        header.flags = asked.flags;
        let (payload, reply) = (request.payload(), response.payload_mut());
        let result = self
            .check(&asked)
            .and_then(|()| self.kind.carry_out(&asked, payload, reply, start, quantum));
        let steps = match result {
            Ok(steps) => {
                header.rows = asked.rows;
                steps
            }
            Err(refusal) => {
                self.context.meter.refused(refusal.code);
                header.status = refusal.code as u32;
                let encoded = control::encode(&refusal, response.payload_mut());
                header.length = encoded.unwrap_or(0) as u32;
                0
            }
        };
        *response.user_header_mut() = header;
        if let Err(error) = ports::send(response) {
            tracing::debug!(session = self.shared.id, error, "a reply was not delivered");
        }
        let slept = self.ports.replies.signal();
        if slept {
            self.ports.replies.wake();
        }
        if self.shared.subscriptions.is_watched() {
            // Its client goes on meanwhile.
            self.kind.show();
        }
        (steps, slept)
    }

    /// Whether a request is one of this session's.
    fn check(&self, asked: &Header) -> Result<(), Rejection> {
        admission::check_header(asked)?;
        if (asked.epoch, asked.session) != (self.context.epoch, self.shared.id) {
            return Err(Rejection::new(
                Code::StaleSession,
                "session",
                format!("{} of run {:016x}", asked.session, asked.epoch),
                format!("this is {} of run {:016x}", self.shared.id, self.context.epoch),
            ));
        }
        Ok(())
    }

    fn note(&self, start: Instant, steps: u64) {
        self.shared.pace.lock().unwrap_or_else(PoisonError::into_inner).note(start, steps);
    }
}

impl<K: SessionKind> Poll for Session<K> {
    fn poll(&mut self, quantum: &mut Quantum<'_>) -> Polled {
        if self.shared.stop.load(Ordering::Acquire) || self.stats.left == 0 {
            self.end();
            return Polled::Closed;
        }
        self.kind.pass_time(quantum);
        // Asked before a request is looked for: what arrived by then is answered.
        let finish = self.shared.finish.load(Ordering::Acquire);
        let connects = self.shared.files_due.load(Ordering::Relaxed) > 0 && self.ports.has_client();
        let received = self.ports.receive();
        if connects {
            self.shared.files_due.store(0, Ordering::Relaxed);
        }
        match received {
            Ok(Some(request)) => {
                let start = Instant::now();
                let (steps, slept) = self.answer(&request, start, quantum);
                self.note(start, steps);
                self.stats.steps += steps;
                self.stats.active = Instant::now();
                self.stats.left -= usize::from(finish);
                let more = finish || self.ports.has_requests();
                Polled::Answered { slept, more }
            }
            Ok(None) => self.rest(finish),
            Err(Unreachable) => {
                self.shared.reason.get_or_init(|| "unreachable");
                self.end();
                Polled::Closed
            }
        }
    }

    fn computed(&mut self, time: Duration) {
        self.kind.learn(time);
    }

    fn failed(&mut self) {
        self.context.meter.closed("failed");
        tracing::error!(session = self.shared.id, "answering a session panicked; it is closed");
    }
}
