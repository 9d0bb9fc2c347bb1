//! The control loop: rare messages, opening and closing sessions.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fs::File;
use std::io::{self, Read};
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use iceoryx2::port::listener::ListenerWaitError;
use trocar_proto::control::{
    self, ClientInfo, ClientLimits, ControlHandler, ControlReply, ControlRequest, ServerInfo,
    ServerStatus, SessionInfo, SessionRequest, Unanswered,
};
use trocar_proto::endpoint::{Endpoint, LEAST_WAIT, MAX_CLIENTS, Node, ServerLock};
use trocar_proto::missing_page::guarded;
use trocar_proto::notify::doorbell::Doorbell;
use trocar_proto::open_files::OpenFiles;
use trocar_proto::wire::Header;
use trocar_proto::{Code, Options, Placement, Rejection, TaskSpec};

use super::admission::{Admission, Admitted, Footprint, Holding, Quota, Usage};
use super::exporter::Exporter;
use super::handle::SessionHandle;
use super::heap;
use super::liveness::{self, Lifetime, LiveNodes};
use super::meter::Meter;
use super::observer::Failures;
use super::ports::{self, ControlPorts, Request};
use super::scheduler::{SCAN_PERIOD, Scheduler, SlotReservation, ThreadQuota};
use super::session::{self, ClientQuota};
use super::store::Ledger;
use super::watch::WatchRegistry;
use super::{ServeError, ServerConfig, StopSignal, internal};
use crate::clock::thread_time;
use crate::registry::Registry;
use crate::view::View;
use crate::view::source::About;

/// Serves until asked to stop.
pub(super) fn run(
    registry: Arc<Registry>,
    config: &ServerConfig,
    lock: &ServerLock,
    node: &Arc<Node>,
    endpoint: Endpoint,
    stop: &StopSignal,
    ready: impl FnOnce(),
) -> Result<(), ServeError> {
    let epoch = lock.epoch();
    let ports =
        guarded(|| ControlPorts::open(node, epoch)).map_err(internal("shared memory"))??;
    let doorbell = Doorbell::make(&endpoint, epoch).map_err(internal("doorbell"))?;
    endpoint.allocate("a server").map_err(internal("shared memory"))?;
    let scheduler = Scheduler::new(config.threads, doorbell)
        .map_err(|error| ServeError::Threads(error.to_string()))?;
    let meter = Meter::new(Arc::clone(&scheduler), config.threads, config.memory_bytes);
    let meter = Arc::new(meter);
    let exporter = config.metrics.map(|address| {
        Exporter::start(address, Arc::clone(&meter))
            .map_err(|source| ServeError::Metrics { address, source })
    });
    let exporter = exporter.transpose()?;
    let admission = Admission::new(Arc::clone(&registry), config, epoch);
    let watch = Arc::new(WatchRegistry::new(about(&admission), token()));
    let view = config.view.map(|address| {
        View::start(address, Arc::clone(&watch) as _)
            .map_err(|source| ServeError::View { address, source })
    });
    let view = view.transpose()?;
    let mut hosted = SessionRegistry {
        admission,
        ledger: Arc::new(Ledger::new(config.memory_bytes)),
        quota: config.client,
        quotas: BTreeMap::new(),
        context: Arc::new(session::ServerContext {
            registry,
            meter,
            node: Arc::clone(node),
            endpoint,
            epoch,
            idle_limit: config.idle_limit,
            failures: config.failures.clone().map(Failures::new),
            watch,
            scheduler,
        }),
        sessions: BTreeMap::new(),
        ending: Vec::new(),
        opened: 0,
        deaths: false,
        clearance: None,
        view,
        started: Instant::now(),
        asked: None,
        stop: stop.clone(),
    };
    let mut lifetime = Lifetime::new(config);
    let (mut looked, mut pause) = (Instant::now(), liveness::INTERVAL);
    let mut scanned = Instant::now();
    ready();
    let metrics = exporter.as_ref().map(|exporter| tracing::field::display(exporter.address));
    let seen = hosted.view.as_ref().map(|view| tracing::field::display(view.address()));
    let (name, pid, threads) = (&config.name, std::process::id(), config.threads);
    tracing::info!(%name, pid, threads, metrics, view = seen, "serving");
    while !stop.is_set() {
        hosted.context.scheduler.doorbell.beat();
        hosted.answer_waiting(&ports);
        if scanned.elapsed() >= SCAN_PERIOD {
            scanned = Instant::now();
            hosted.context.scheduler.scan();
        }
        if looked.elapsed() >= pause {
            let computed = thread_time();
            looked = Instant::now();
            hosted.sweep(&mut lifetime);
            pause = liveness::pause(thread_time().saturating_sub(computed));
        }
        let patience = pause.saturating_sub(looked.elapsed()).min(SCAN_PERIOD);
        match ports.event.timed_wait(|_| {}, patience.max(LEAST_WAIT)) {
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => {}
            Err(error) => {
                tracing::warn!(?error, "the control event failed");
                std::thread::sleep(Duration::from_millis(1));
            }
        }
    }
    tracing::info!(sessions = hosted.sessions.len(), "shutting down");
    if let Err(error) = lock.announce_end() {
        tracing::warn!(%error, "clients will take this for a crash");
    }
    hosted.drain(&ports, config.drain_limit);
    Ok(())
}

/// A text that cannot be guessed, of 128 random bits; empty, which is no token, where the system gives none.
fn token() -> String {
    let mut bytes = [0; 16];
    let read = File::open("/dev/urandom").and_then(|mut file| file.read_exact(&mut bytes));
    if let Err(error) = read {
        tracing::warn!(%error, "no random numbers: no page can drive arms");
        return String::new();
    }
    format!("{:032x}", u128::from_ne_bytes(bytes))
}

/// The server, as its viewer names it.
fn about(admission: &Admission) -> About {
    let info = admission.info();
    let version = env!("CARGO_PKG_VERSION");
    About { name: info.name.clone(), pid: info.pid, version, recording: false }
}

/// The sessions, and what is needed to open more.
struct SessionRegistry {
    admission: Admission,
    context: Arc<session::ServerContext>,
    /// The memory that all may take.
    ledger: Arc<Ledger>,
    /// What one client may have of these.
    quota: Quota,
    /// What the clients that have sessions have of these, by process id.
    quotas: BTreeMap<u32, ClientQuota>,
    sessions: BTreeMap<u64, SessionHandle>,
    /// Sessions that were closed and are not gone yet, or not known to be.
    ending: Vec<SessionHandle>,
    opened: u64,
    /// Whether there were dead clients at the last look.
    deaths: bool,
    /// The thread that removes what dead clients left, or that did.
    clearance: Option<JoinHandle<()>>,
    /// The live viewer, from when a client asked for it.
    view: Option<View>,
    started: Instant,
    /// The message that is being answered, and the memory of the session that it opens.
    asked: Option<(Request, Footprint)>,
    stop: StopSignal,
}

impl SessionRegistry {
    /// Answers every client that waits once before any client is answered twice.
    fn answer_waiting(&mut self, ports: &ControlPorts) {
        let waiting: Vec<Request> =
            std::iter::from_fn(|| ports.receive()).take(MAX_CLIENTS).collect();
        for request in waiting {
            self.answer(request);
        }
    }

    fn answer(&mut self, request: Request) {
        // The client could still write to what it sent: check a copy.
        let header = *request.user_header();
        let payload = request.payload().to_vec();
        let reply = match self.check(&header, &payload) {
            Ok(Admitted { request: asked, footprint }) => {
                self.asked = Some((request, footprint));
                let reply = asked.dispatch(self);
                let (Some(reply), Some((request, _))) = (reply, self.asked.take()) else { return };
                ports::reply(&request, &reply);
                reply
            }
            Err(refusal) => {
                let reply = ControlReply::Refused(refusal);
                ports::reply(&request, &reply);
                reply
            }
        };
        if let ControlReply::Refused(refusal) = &reply {
            match control::decode(payload.get(..header.length as usize).unwrap_or_default()) {
                Ok(ControlRequest::OpenSession { client, .. }) => {
                    session::note_refusal(&self.context.meter, client.pid, refusal);
                }
                _ => self.context.meter.refused(refusal.code),
            }
        }
    }

    /// Begins to open a session, which then replies.
    fn open(
        &mut self,
        slot: SlotReservation,
        wanted: SessionRequest,
        client: ClientInfo,
        footprint: Footprint,
        request: Request,
    ) {
        self.opened += 1;
        let place = (self.opened, slot);
        let (context, quota) = (Arc::clone(&self.context), self.quota(&client));
        let handle = session::open(context, quota, place, wanted, client, footprint, request);
        if let Some(handle) = handle {
            self.sessions.insert(self.opened, handle);
            self.take_stock();
        }
    }

    fn check(&mut self, header: &Header, payload: &[u8]) -> Result<Admitted, Rejection> {
        let checked = self.admission.check(header, payload, &self.usage(header.kind));
        match &checked {
            // Sessions that are ending hold on to what they had for up to a tenth of a second.
            Err(refusal)
                if matches!(refusal.code, Code::MemoryBudget | Code::TooManySessions)
                    && !self.ending.is_empty() =>
            {
                self.ending.drain(..).for_each(SessionHandle::join);
                self.admission.check(header, payload, &self.usage(header.kind))
            }
            _ => checked,
        }
    }

    /// A session of this client.
    fn session_of(&self, session: u64, node: u128) -> Result<&SessionHandle, Rejection> {
        let found = self.sessions.get(&session).filter(|handle| handle.client().node == node);
        found.ok_or_else(|| no_session(session))
    }

    /// A session of whichever client.
    fn any_session(&self, session: u64) -> Result<&SessionHandle, Rejection> {
        self.sessions.get(&session).ok_or_else(|| {
            let known: Vec<_> = self.sessions.keys().map(ToString::to_string).collect();
            let allowed = format!("open sessions: {}", known.join(", "));
            Rejection::new(Code::UnknownSession, "session", session, allowed)
        })
    }

    /// Closes the sessions of dead clients and removes what they left.
    fn sweep(&mut self, lifetime: &mut Lifetime) {
        let Some(live) = LiveNodes::take(&self.context.node) else { return };
        let scheduler = &self.context.scheduler;
        let over = self.sessions.extract_if(.., |id, handle| {
            let alive = live.has(handle.client().node);
            if !alive {
                tracing::info!(session = id, pid = handle.client().pid, "client is gone");
                handle.stop(scheduler, "reclaimed");
            }
            !alive || handle.has_ended()
        });
        self.ending.extend(over.map(|(_, handle)| handle));
        let ending = self.ending.len();
        let ended = self.ending.extract_if(.., |handle| handle.has_ended());
        ended.for_each(SessionHandle::join);
        if self.ending.len() < ending {
            heap::give_back();
        }
        self.take_stock();
        // From one look to the next, sessions remove their part; that is faster.
        let due = std::mem::replace(&mut self.deaths, live.deaths) && live.deaths;
        if due && self.clearance.as_ref().is_none_or(JoinHandle::is_finished) {
            self.clearance = clear(Arc::clone(&self.context.node)).ok();
        }
        if let Some(why) = lifetime.verdict(live.clients()) {
            tracing::info!(why, "the server ends");
            if !self.stop.is_set() {
                self.stop.set();
            }
        }
    }

    /// Lets sessions answer what they were asked, for at most `limit` and unless that is cut short;
    /// answers control messages meanwhile. Sessions that take longer are left behind.
    fn drain(mut self, ports: &ControlPorts, limit: Duration) {
        let start = Instant::now();
        let scheduler = Arc::clone(&self.context.scheduler);
        self.sessions.values().for_each(|session| session.finish(&scheduler));
        while !self.sessions.values().chain(&self.ending).all(SessionHandle::has_ended) {
            if self.stop.is_urgent() || start.elapsed() > limit {
                break;
            }
            scheduler.doorbell.beat();
            self.answer_waiting(ports);
            ports.event.timed_wait(|_| {}, Duration::from_millis(2)).ok();
        }
        for handle in self.sessions.into_values().chain(self.ending) {
            if handle.has_ended() {
                handle.join();
            } else {
                tracing::warn!(session = handle.id(), "left behind: it has not answered yet");
                handle.stop(&scheduler, "shutdown");
            }
        }
        if let Some(clearance) = self.clearance {
            clearance.join().ok();
        }
    }

    fn used(&self) -> Footprint {
        let Footprint { shared, private } = self.used_by_sessions();
        Footprint { shared, private: private + self.ledger.snapshots() }
    }

    fn used_by_sessions(&self) -> Footprint {
        self.sessions.values().chain(&self.ending).map(SessionHandle::footprint).sum()
    }

    /// What sessions take, as a request of this kind needs it; to their clients, those that are ending are gone.
    fn usage(&self, kind: u32) -> Usage {
        let mut clients: BTreeMap<u32, Holding> = BTreeMap::new();
        for session in self.sessions.values() {
            let holding = clients.entry(session.client().pid).or_default();
            holding.sessions += 1;
            holding.envs += u64::from(session.envs());
            holding.memory_bytes += session.footprint().total();
        }
        for (pid, holding) in &mut clients {
            holding.memory_bytes +=
                self.quotas.get(pid).map_or(0, |quota| quota.ledger.snapshots());
        }
        let files = match kind {
            ControlRequest::OPEN_SESSION => self.open_files(),
            _ => OpenFiles::default(),
        };
        let sessions = self.sessions.len() + self.ending.len();
        Usage { memory: self.used(), sessions, files, clients }
    }

    /// The open files, with those that sessions have still to take.
    fn open_files(&self) -> OpenFiles {
        let OpenFiles { used, limit } = OpenFiles::now();
        let due: usize = self.sessions.values().map(SessionHandle::files_due).sum();
        OpenFiles { used: used + due, limit }
    }

    /// The quota of a client, new where it has no session.
    fn quota(&mut self, client: &ClientInfo) -> ClientQuota {
        let new = || ClientQuota {
            ledger: Arc::new(self.ledger.of_client(self.quota.memory_bytes)),
            threads: ThreadQuota::new(self.quota.threads),
        };
        self.quotas.entry(client.pid).or_insert_with(new).clone()
    }

    /// Lets sessions know how much is left for their snapshots, and Prometheus what there is. A
    /// snapshot that is taken in just this moment may exceed the budget by what the session that is
    /// being opened takes.
    fn take_stock(&mut self) {
        self.ledger.set_sessions(self.used_by_sessions().total());
        let mut held: BTreeMap<u32, u64> = BTreeMap::new();
        for session in self.sessions.values() {
            *held.entry(session.client().pid).or_default() += session.footprint().total();
        }
        self.quotas.retain(|pid, _| held.contains_key(pid));
        for (pid, quota) in &self.quotas {
            quota.ledger.set_sessions(held[pid]);
        }
        let meter = &self.context.meter;
        meter.clients.set(held.len() as i64);
        meter.sessions.set(self.sessions.len() as i64);
        meter.envs.set(self.sessions.values().map(|session| i64::from(session.envs())).sum());
        meter.memory.set(self.used().total() as i64);
    }
}

impl ControlHandler for SessionRegistry {
    fn hello(&mut self, _: ClientInfo) -> Result<ServerInfo, Unanswered> {
        Ok(self.admission.info().clone())
    }

    fn list_tasks(&mut self) -> Result<Vec<String>, Unanswered> {
        Ok(self.context.registry.ids().map(str::to_string).collect())
    }

    fn describe_task(
        &mut self,
        task: String,
        options: Options,
    ) -> Result<Box<TaskSpec>, Unanswered> {
        Ok(self.context.registry.spec(&task, &options)?.into())
    }

    fn open_session(
        &mut self,
        wanted: SessionRequest,
        client: ClientInfo,
    ) -> Result<Box<SessionInfo>, Unanswered> {
        if self.stop.is_set() {
            let (name, why) =
                (&self.admission.info().name, "it is ending; open the session in its successor");
            return Err(Rejection::new(Code::ShuttingDown, "server", name, why).into());
        }
        let Some(slot) = self.context.scheduler.reserve() else {
            let (open, why) = (self.sessions.len(), "every slot is taken; close a session");
            return Err(Rejection::new(Code::TooManySessions, "session", open, why).into());
        };
        // It is answered once everything is in place.
        let (request, footprint) = self.asked.take().expect("a message is being answered");
        self.open(slot, wanted, client, footprint, request);
        Err(Unanswered::Later)
    }

    fn close_session(&mut self, session: u64, node: u128) -> Result<(), Unanswered> {
        match self.sessions.entry(session) {
            Entry::Occupied(entry) if entry.get().client().node == node => {
                let handle = entry.remove();
                handle.stop(&self.context.scheduler, "closed");
                self.ending.push(handle);
                self.take_stock();
                Ok(())
            }
            _ => Err(no_session(session).into()),
        }
    }

    fn status(&mut self) -> Result<ServerStatus, Unanswered> {
        let info = self.admission.info();
        Ok(ServerStatus {
            name: info.name.clone(),
            pid: info.pid,
            epoch: info.epoch,
            uptime_s: self.started.elapsed().as_secs_f64(),
            sessions: self.sessions.values().map(SessionHandle::status).collect(),
            memory_bytes: self.used().total(),
        })
    }

    fn shutdown(&mut self) -> Result<(), Unanswered> {
        // A second time would be an order to hurry.
        if !self.stop.is_set() {
            self.stop.set();
        }
        Ok(())
    }

    fn drop_snapshots(
        &mut self,
        session: u64,
        node: u128,
        snapshots: Vec<u64>,
    ) -> Result<(), Unanswered> {
        Ok(self.session_of(session, node)?.forget(&snapshots)?)
    }

    fn export_snapshot(
        &mut self,
        session: u64,
        node: u128,
        snapshot: u64,
    ) -> Result<Vec<u8>, Unanswered> {
        Ok(self.session_of(session, node)?.export(snapshot)?)
    }

    fn import_snapshot(
        &mut self,
        session: u64,
        node: u128,
        bytes: Vec<u8>,
    ) -> Result<u64, Unanswered> {
        Ok(self.session_of(session, node)?.import(&bytes)?)
    }

    fn record(&mut self, session: u64, env: u32, every: u32) -> Result<(), Unanswered> {
        Ok(self.any_session(session)?.record(env, every)?)
    }

    fn recorded(&mut self, session: u64) -> Result<(Vec<u8>, u64), Unanswered> {
        Ok(self.any_session(session)?.recorded()?)
    }

    fn import_placement(
        &mut self,
        session: u64,
        node: u128,
        placement: Placement,
    ) -> Result<u64, Unanswered> {
        Ok(self.session_of(session, node)?.place(placement)?)
    }

    fn limits(&mut self) -> Result<ClientLimits, Unanswered> {
        let Quota { sessions, envs, memory_bytes, threads } = self.quota;
        let limit = |number: u64| (number < u64::MAX).then_some(number);
        Ok(ClientLimits {
            session_envs: self.admission.info().max_envs,
            sessions: limit(sessions as u64),
            envs: limit(envs),
            memory_bytes: limit(memory_bytes),
            threads: limit(threads as u64),
        })
    }

    fn drive_token(&mut self) -> Result<String, Unanswered> {
        Ok(self.context.watch.token().to_string())
    }

    fn viewer(&mut self) -> Result<SocketAddr, Unanswered> {
        if let Some(view) = &self.view {
            return Ok(view.address());
        }
        let address = (Ipv4Addr::LOCALHOST, 0).into();
        let view = View::start(address, Arc::clone(&self.context.watch) as _);
        let view = view.map_err(internal("viewer"))?;
        tracing::info!(view = %view.address(), "the viewer was asked for");
        Ok(self.view.insert(view).address())
    }
}

/// Removes what dead clients left, on a thread of its own: it may take seconds.
fn clear(node: Arc<Node>) -> io::Result<JoinHandle<()>> {
    std::thread::Builder::new().name("trocar-clear".into()).spawn(move || {
        // What a client left unfinished may have no memory.
        guarded(|| node.try_cleanup_dead_nodes()).ok();
    })
}

fn no_session(session: u64) -> Rejection {
    Rejection::new(Code::UnknownSession, "session", session, "this client has no such session")
}
