//! A session: answers its client's messages, one when it is its quantum.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use trocar_proto::control::{
    self, Autoreset, ClientInfo, ControlReply, SessionInfo, SessionRequest,
};
use trocar_proto::endpoint::{Endpoint, Node};
use trocar_proto::missing_page::guarded;
use trocar_proto::open_files::SESSION_FILES;
use trocar_proto::wire::{
    Header, MAX_IN_FLIGHT, PictureLayout, ReplyLayout, RequestLayout, flag, kind,
};
use trocar_proto::{Code, Rejection};

use super::admission::{self, Footprint};
use super::batch::{self, Batch, BatchCommand};
use super::handle::{Nature, Pace, SessionHandle, Shared};
use super::internal;
use super::meter::{Meter, TaskMeter};
use super::observer::{Failures, LiveRecording, StepObserver};
use super::ports::{self, DataPorts, Request, Unreachable};
use super::rows::Rows;
use super::scheduler::{Entity, Poll, Polled, Quantum, Scheduler, SlotReservation, ThreadQuota};
use super::store::{self, Ledger, Saved, Store};
use super::watch::{Registration, Subscriptions, WatchRegistry};
use crate::env::{Env, Imaging, Rebuild};
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
        match Session::open(Arc::clone(&context), quota, inner, &wanted, slot, life) {
            Ok((session, info)) => {
                ports::reply(&request, &ControlReply::OpenSession(info.into()));
                drop(request);
                context.scheduler.occupy(session.slot.id, entity, Box::new(session));
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

/// The server's side of a session.
struct Session {
    context: Arc<ServerContext>,
    shared: Arc<Shared>,
    meter: TaskMeter,
    batch: Batch,
    /// Whether the step after an episode's end resets instead of stepping.
    next_step: bool,
    request_layout: RequestLayout,
    reply_layout: ReplyLayout,
    /// How its environments are drawn when that is asked for.
    view: Option<(Imaging, PictureLayout)>,
    ports: DataPorts,
    inbox: Inbox,
    stats: SessionStats,
    // Dropped last, in this order: from then on its slot is free, and nothing is left of it.
    _registration: Registration,
    slot: SlotReservation,
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

/// A request's arrays, copied out of shared memory before anything looks at them, since their
/// client could still change them.
#[derive(Debug, Default)]
struct Inbox {
    env_ids: Vec<u32>,
    actions: Vec<f32>,
    numbers: Vec<u64>,
    episodes: Vec<u64>,
}

impl Session {
    fn open(
        context: Arc<ServerContext>,
        quota: ClientQuota,
        shared: Arc<Shared>,
        wanted: &SessionRequest,
        slot: SlotReservation,
        life: Sender<Infallible>,
    ) -> Result<(Self, SessionInfo), Rejection> {
        let batch = Batch::new(&context.registry, wanted)?;
        let spec = batch.spec();
        let (envs, action_dim) = (wanted.envs as usize, spec.action_dim());
        let request_layout = RequestLayout::new(envs, spec);
        let reply_layout = ReplyLayout::new(envs, spec);
        let (epoch, id) = (context.epoch, shared.id);
        let view = wanted.view.as_ref();
        let view = view.map(|view| context.registry.view(&wanted.task, &wanted.options, view));
        let view = view.transpose()?.map(|imaging| {
            let layout = PictureLayout::new(imaging.spec());
            (imaging, layout)
        });
        let info = SessionInfo {
            session: id,
            epoch,
            slot: slot.id.0,
            envs: wanted.envs,
            spec: (**spec).clone(),
            view: view.as_ref().map(|(imaging, _)| Box::new(imaging.spec().clone())),
        };
        let most = view.as_ref().map_or(0, |(_, layout)| layout.bytes).max(reply_layout.bytes);
        shared.nature.get_or_init(|| Nature {
            max_steps: spec.max_steps,
            seconds_per_step: spec.seconds_per_step,
            has_goal: spec.goal.is_some(),
        });
        let store = Store::new(quota.ledger, batch.like());
        *shared.store.lock().unwrap_or_else(PoisonError::into_inner) = Some(store);
        // Starts may have taken long, and nothing may be put where the server has cleared away.
        if shared.stop.load(Ordering::Acquire) {
            let why = "the session is being closed";
            return Err(Rejection::new(Code::UnknownSession, "session", id, why));
        }
        let no_room = |error: std::io::Error| {
            Rejection::new(Code::MemoryBudget, "envs", wanted.envs, error.to_string())
        };
        let ports = guarded(|| DataPorts::open(&context.node, &context.endpoint, epoch, id, most))
            .map_err(no_room)??;
        shared.files_due.store(ports::CONNECTION_FILES, Ordering::Relaxed);
        // What is promised to a client is its own from now on, whatever fills shared memory.
        context.endpoint.allocate("the session").map_err(no_room)?;
        let Shared { task, client, .. } = &*shared;
        let (pid, language) = (client.pid, client.language.as_str());
        tracing::info!(session = id, pid, language, task, envs, "session opened");
        context.meter.opened();
        let session = Self {
            ports,
            inbox: Inbox {
                env_ids: vec![0; envs],
                actions: vec![0.0; envs * action_dim],
                numbers: vec![0; envs],
                episodes: vec![0; envs],
            },
            stats: SessionStats {
                opened: Instant::now(),
                active: Instant::now(),
                steps: 0,
                left: MAX_IN_FLIGHT,
            },
            meter: context.meter.task(&shared.task),
            next_step: wanted.autoreset == Autoreset::NextStep,
            batch,
            request_layout,
            reply_layout,
            view,
            _registration: context.watch.register(id, Arc::clone(&shared)),
            context,
            shared,
            slot,
            _life: life,
        };
        Ok((session, info))
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
            self.shared.subscriptions.show(&self.batch);
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
        let room = match &self.view {
            Some((_, layout)) if asked.kind == kind::RENDER => layout.bytes,
            _ => self.reply_layout.bytes,
        };
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
        let result = self.carry_out(&asked, request.payload(), response.payload_mut(), quantum);
        let watched = self.shared.subscriptions.is_watched();
        let steps = match result {
            Ok(()) => {
                header.rows = asked.rows;
                if watched && asked.kind != kind::RENDER {
                    let env_ids = &self.inbox.env_ids[..asked.rows as usize];
                    let (layout, reply) = (&self.reply_layout, response.payload());
                    self.shared.subscriptions.note(asked.kind, env_ids, layout, reply);
                }
                self.count(&asked, response.payload(), start.elapsed())
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
        if watched {
            // Its client goes on meanwhile.
            self.shared.subscriptions.show(&self.batch);
        }
        (steps, slept)
    }

    /// Counts what a request has done; returns how many steps environments took.
    fn count(&self, asked: &Header, reply: &[u8], time: Duration) -> u64 {
        let rows = asked.rows as usize;
        if !matches!(asked.kind, kind::STEP | kind::RESET) {
            return 0;
        }
        let steps: &[u32] = self.reply_layout.steps.view(reply, rows);
        let faults: &[u8] = self.reply_layout.fault.view(reply, rows);
        let begun = steps.iter().filter(|steps| **steps == 0).count() as u64;
        let failed = faults.iter().filter(|fault| **fault != 0).count() as u64;
        self.meter.resets.inc_by(begun);
        self.meter.failures.inc_by(failed);
        if asked.kind == kind::RESET {
            return 0;
        }
        self.tally(reply, rows);
        let steps = rows as u64 - if self.next_step { begun } else { 0 };
        self.meter.steps.inc_by(steps);
        self.meter.stepped(time);
        steps
    }

    /// Counts the episodes that ended with a step.
    fn tally(&self, reply: &[u8], rows: usize) {
        let layout = &self.reply_layout;
        let terminated: &[u8] = layout.terminated.view(reply, rows);
        let truncated: &[u8] = layout.truncated.view(reply, rows);
        let is_success: &[u8] = layout.is_success.view(reply, rows);
        let any = |flags: &[u8]| flags.iter().fold(0, |any, flag| any | flag) != 0;
        if any(terminated) || any(truncated) {
            let mut pace = self.shared.pace.lock().unwrap_or_else(PoisonError::into_inner);
            for row in (0..rows).filter(|row| terminated[*row] | truncated[*row] != 0) {
                pace.tally.ended(is_success[row] != 0);
            }
        }
    }

    /// Does what is asked.
    fn carry_out(
        &mut self,
        asked: &Header,
        payload: &[u8],
        reply: &mut [u8],
        quantum: &mut Quantum<'_>,
    ) -> Result<(), Rejection> {
        admission::check_header(asked)?;
        let malformed = |field: &str, value: u64, allowed: String| {
            Rejection::new(Code::Malformed, field, value, allowed)
        };
        if (asked.epoch, asked.session) != (self.context.epoch, self.shared.id) {
            return Err(Rejection::new(
                Code::StaleSession,
                "session",
                format!("{} of run {:016x}", asked.session, asked.epoch),
                format!("this is {} of run {:016x}", self.shared.id, self.context.epoch),
            ));
        }
        let rows = asked.rows as usize;
        if !(1..=self.shared.envs as usize).contains(&rows) {
            let allowed = format!("allowed is 1 to {}", self.shared.envs);
            return Err(malformed("header.rows", rows as u64, allowed));
        }
        if payload.len() < self.request_layout.bytes {
            let allowed = format!("expected {} bytes", self.request_layout.bytes);
            return Err(malformed("payload", payload.len() as u64, allowed));
        }
        let Inbox { env_ids, actions, numbers, episodes } = &mut self.inbox;
        let layout = &self.request_layout;
        let seeded = asked.kind == kind::RESET && asked.flags & flag::HAS_SEEDS != 0;
        if seeded {
            episodes[..rows].copy_from_slice(layout.episodes.view(payload, rows));
        }
        if seeded || asked.kind > kind::STEP {
            numbers[..rows].copy_from_slice(layout.numbers.view(payload, rows));
        }
        let numbers = &numbers[..rows];
        env_ids[..rows].copy_from_slice(layout.env_ids.view(payload, rows));
        let env_ids = &env_ids[..rows];
        if asked.kind == kind::RENDER {
            let Some((imaging, layout)) = &self.view else {
                let why = "the session was opened without a view; open it with one";
                return Err(Rejection::new(Code::Unsupported, "render", "no view", why));
            };
            return if asked.flags & flag::DEPTH == 0 {
                let rgb = layout.rgb.view_mut(reply, 1);
                self.batch.draw(env_ids, imaging, rgb, &mut [], quantum)
            } else {
                let depth = layout.depth.view_mut(reply, 1);
                self.batch.draw(env_ids, imaging, &mut [], depth, quantum)
            };
        }
        let mut out = Rows::of(&self.reply_layout, reply, rows);
        let states;
        let command = match asked.kind {
            kind::STEP => {
                let sent: &[f32] = layout.actions.view(payload, rows);
                actions[..sent.len()].copy_from_slice(sent);
                BatchCommand::Step(&actions[..sent.len()])
            }
            kind::RESET => BatchCommand::Reset(seeded.then_some((numbers, &episodes[..rows]))),
            kind::SNAPSHOT => {
                let mut room = self.shared.with_store(|store| store.make_room(rows))?;
                let copies = self.batch.copies(env_ids, quantum)?;
                self.shared.with_store(|store| {
                    for (row, copy) in copies.into_iter().enumerate() {
                        out.snapshot.row(row)[0] = store.put(&mut room, Saved::State(copy));
                    }
                    Ok(())
                })?;
                return Ok(());
            }
            kind::RESTORE => {
                states = saved(&self.shared, &self.batch, numbers, quantum)?;
                BatchCommand::Restore(&states)
            }
            kind::ARRANGE => {
                let placements = self.shared.with_store(|store| {
                    numbers.iter().map(|number| store.placement(*number)).collect::<Result<_, _>>()
                })?;
                states = self.batch.arranged(env_ids, placements, quantum)?;
                BatchCommand::Restore(&states)
            }
            kind::FORK => {
                states = self.batch.sources(numbers, quantum)?;
                BatchCommand::Restore(&states)
            }
            other => {
                let (first, last) = (kind::RESET, kind::ARRANGE);
                let allowed = format!("allowed are {first} (reset) to {last} (arrange)");
                return Err(malformed("header.kind", other.into(), allowed));
            }
        };
        let want_expert = asked.flags & flag::WANT_EXPERT != 0;
        let failures = self.context.failures.as_ref();
        let observer = StepObserver { failures, recording: &self.shared.recording };
        self.batch.apply(command, env_ids, want_expert, observer, out, quantum)
    }

    fn note(&self, start: Instant, steps: u64) {
        self.shared.pace.lock().unwrap_or_else(PoisonError::into_inner).note(start, steps);
    }
}

impl Poll for Session {
    fn poll(&mut self, quantum: &mut Quantum<'_>) -> Polled {
        if self.shared.stop.load(Ordering::Acquire) || self.stats.left == 0 {
            self.end();
            return Polled::Closed;
        }
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
        self.batch.learn(time);
    }

    fn failed(&mut self) {
        self.context.meter.closed("failed");
        tracing::error!(session = self.shared.id, "answering a session panicked; it is closed");
    }
}

/// The states that a session keeps under these numbers; imported ones are rebuilt first.
fn saved(
    shared: &Shared,
    batch: &Batch,
    numbers: &[u64],
    quantum: &mut Quantum<'_>,
) -> Result<Vec<Arc<Env>>, Rejection> {
    let found: Vec<Saved> =
        shared.with_store(|store| numbers.iter().map(|number| store.get(*number)).collect())?;
    let mut recipes = BTreeMap::new();
    for (number, saved) in numbers.iter().zip(&found) {
        match saved {
            Saved::State(_) => {}
            Saved::Recipe(recipe) => {
                recipes.insert(*number, Arc::clone(recipe));
            }
            Saved::Placement(_) => return Err(store::no_state(*number)),
        }
    }
    let rebuilds = recipes.values().map(|recipe| Rebuild::new(batch.like(), (**recipe).clone()));
    let go_on = || !shared.stop.load(Ordering::Acquire);
    let Some(rebuilt) = batch::rebuild(rebuilds.collect(), quantum, go_on) else {
        let why = "the session is being closed";
        return Err(Rejection::new(Code::UnknownSession, "session", shared.id, why));
    };
    let mut states = BTreeMap::new();
    for (number, env) in recipes.into_keys().zip(rebuilt) {
        states.insert(number, Arc::new(env?));
    }
    shared.with_store(|store| {
        for (number, state) in &states {
            store.replace(*number, state);
        }
        Ok(())
    })?;
    let state = |(number, saved): (&u64, Saved)| match saved {
        Saved::State(env) => env,
        Saved::Recipe(_) | Saved::Placement(_) => Arc::clone(&states[number]),
    };
    Ok(numbers.iter().zip(found).map(state).collect())
}
