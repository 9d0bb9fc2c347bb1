//! The control loop: rare messages, opening and closing sessions.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::Arc;
use std::time::{Duration, Instant};

use iceoryx2::port::listener::ListenerWaitError;
use trocar_proto::control::{ControlReply, ServerStatus};
use trocar_proto::endpoint::{LEAST_WAIT, MAX_CLIENTS, Node, ServerLock};
use trocar_proto::wire::Header;
use trocar_proto::{Code, Rejection};

use super::desk::{Answer, Desk, Footprint};
use super::lease::{self, Census, Watch};
use super::ports::{self, ControlPorts, Request};
use super::scheduler::Scheduler;
use super::session::{self, SessionHandle};
use super::store::Ledger;
use super::{ServeError, ServerConfig, StopSignal};
use crate::tasks::Registry;

/// Serves until asked to stop.
pub(super) fn run(
    registry: Arc<Registry>,
    config: &ServerConfig,
    lock: &ServerLock,
    node: &Arc<Node>,
    stop: &StopSignal,
    ready: impl FnOnce(),
) -> Result<(), ServeError> {
    let epoch = lock.epoch();
    let ControlPorts { port, bell } = ControlPorts::open(node, epoch)?;
    let scheduler =
        Scheduler::new(config.threads).map_err(|error| ServeError::Threads(error.to_string()))?;
    let mut host = Host {
        desk: Desk::new(Arc::clone(&registry), config, epoch),
        ground: Arc::new(session::Ground {
            registry,
            scheduler,
            ledger: Arc::new(Ledger::new(config.memory_bytes)),
            node: Arc::clone(node),
            epoch,
            idle_limit: config.idle_limit,
        }),
        sessions: BTreeMap::new(),
        ending: Vec::new(),
        opened: 0,
        started: Instant::now(),
        stop: stop.clone(),
    };
    let mut watch = Watch::new(config);
    let mut looked = Instant::now();
    ready();
    tracing::info!(name = %config.name, pid = std::process::id(), threads = config.threads, "serving");
    while !stop.is_set() {
        // Every client that waits is answered once before anybody is answered twice.
        let waiting: Vec<Request> =
            std::iter::from_fn(|| port.receive().ok().flatten()).take(MAX_CLIENTS).collect();
        for request in waiting {
            host.answer(request);
        }
        if looked.elapsed() >= lease::INTERVAL {
            looked = Instant::now();
            host.sweep(&mut watch);
        }
        let patience = lease::INTERVAL.saturating_sub(looked.elapsed());
        match bell.timed_wait(|_| {}, patience.max(LEAST_WAIT)) {
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => {}
            Err(error) => {
                tracing::warn!(?error, "the control bell failed");
                std::thread::sleep(Duration::from_millis(1));
            }
        }
    }
    tracing::info!(sessions = host.sessions.len(), "shutting down");
    if let Err(error) = lock.announce_end() {
        tracing::warn!(%error, "clients will take this for a crash");
    }
    host.shut_down();
    Ok(())
}

/// The sessions, and what is needed to open more.
struct Host {
    desk: Desk,
    ground: Arc<session::Ground>,
    sessions: BTreeMap<u64, SessionHandle>,
    /// Sessions that were closed and whose threads have not ended yet, or not been joined.
    ending: Vec<SessionHandle>,
    opened: u64,
    started: Instant,
    stop: StopSignal,
}

impl Host {
    fn answer(&mut self, request: Request) {
        // The client could still write to what it sent: judge a copy.
        let header = *request.user_header();
        let payload = request.payload().to_vec();
        let result = match self.judge(&header, &payload) {
            Answer::Reply(reply) => reply,
            Answer::Open { request: wanted, client, footprint } => {
                self.opened += 1;
                let id = self.opened;
                let handle =
                    session::open(Arc::clone(&self.ground), id, wanted, client, footprint, request);
                if let Some(handle) = handle {
                    self.sessions.insert(id, handle);
                    self.tell_the_ledger();
                }
                // The session's own thread replies once everything is in place.
                return;
            }
            Answer::Close { session, node } => self.close(session, node),
            Answer::Forget { session, node, snapshots } => {
                let done = self.session_of(session, node).and_then(|one| one.forget(&snapshots));
                done.map_or_else(ControlReply::Refused, |()| ControlReply::Done)
            }
            Answer::Export { session, node, snapshot } => {
                let bytes = self.session_of(session, node).and_then(|one| one.export(snapshot));
                bytes.map_or_else(ControlReply::Refused, ControlReply::Exported)
            }
            Answer::Import { session, node, bytes } => {
                let number = self.session_of(session, node).and_then(|one| one.import(&bytes));
                number.map_or_else(ControlReply::Refused, ControlReply::Imported)
            }
            Answer::Status => ControlReply::Status(self.status()),
            Answer::Shutdown => {
                self.stop.set();
                ControlReply::Done
            }
        };
        ports::reply(&request, &result);
    }

    fn judge(&mut self, header: &Header, payload: &[u8]) -> Answer {
        let answer = self.desk.judge(header, payload, self.used(), self.count());
        match &answer {
            // Sessions that are ending hold on to what they had for up to a tenth of a second.
            Answer::Reply(ControlReply::Refused(refusal))
                if matches!(refusal.code, Code::MemoryBudget | Code::TooManySessions)
                    && !self.ending.is_empty() =>
            {
                self.ending.drain(..).for_each(SessionHandle::join);
                self.desk.judge(header, payload, self.used(), self.count())
            }
            _ => answer,
        }
    }

    fn close(&mut self, session: u64, node: u128) -> ControlReply {
        match self.sessions.entry(session) {
            Entry::Occupied(entry) if entry.get().client().node == node => {
                let handle = entry.remove();
                handle.stop();
                self.ending.push(handle);
                ControlReply::Done
            }
            _ => ControlReply::Refused(no_session(session)),
        }
    }

    /// A session of this client.
    fn session_of(&self, session: u64, node: u128) -> Result<&SessionHandle, Rejection> {
        let found = self.sessions.get(&session).filter(|handle| handle.client().node == node);
        found.ok_or_else(|| no_session(session))
    }

    /// Closes the sessions of dead clients and removes what they left.
    fn sweep(&mut self, watch: &mut Watch) {
        let Some(census) = Census::take(&self.ground.node) else { return };
        let over = self.sessions.extract_if(.., |id, handle| {
            let alive = census.has(handle.client().node);
            if !alive {
                tracing::info!(session = id, pid = handle.client().pid, "client is gone");
                handle.stop();
            }
            !alive || handle.has_ended()
        });
        self.ending.extend(over.map(|(_, handle)| handle));
        self.ending.extract_if(.., |handle| handle.has_ended()).for_each(SessionHandle::join);
        self.tell_the_ledger();
        if census.deaths {
            self.ground.node.try_cleanup_dead_nodes();
        }
        if let Some(why) = watch.verdict(census.clients()) {
            tracing::info!(why, "the server ends");
            self.stop.set();
        }
    }

    fn shut_down(self) {
        for handle in self.sessions.values() {
            handle.stop();
        }
        // Whatever they still create in shared memory must be there before it is removed.
        self.sessions.into_values().chain(self.ending).for_each(SessionHandle::join);
    }

    fn used(&self) -> Footprint {
        let Footprint { shared, private } = self.used_by_sessions();
        Footprint { shared, private: private + self.ground.ledger.snapshots() }
    }

    fn used_by_sessions(&self) -> Footprint {
        self.sessions.values().chain(&self.ending).map(SessionHandle::footprint).sum()
    }

    /// Lets sessions know how much is left for their snapshots. One that is taken in just this
    /// moment may exceed the budget by what the session that is being opened takes.
    fn tell_the_ledger(&self) {
        self.ground.ledger.set_sessions(self.used_by_sessions().total());
    }

    fn count(&self) -> usize {
        self.sessions.len() + self.ending.len()
    }

    fn status(&self) -> ServerStatus {
        let info = self.desk.info();
        ServerStatus {
            name: info.name.clone(),
            pid: info.pid,
            epoch: info.epoch,
            uptime_s: self.started.elapsed().as_secs_f64(),
            sessions: self.sessions.values().map(SessionHandle::status).collect(),
            memory_bytes: self.used().total(),
        }
    }
}

fn no_session(session: u64) -> Rejection {
    Rejection::new(Code::UnknownSession, "session", session, "this client has no such session")
}
