//! A session as others see it: the control loop, which closes it and asks about it, and the viewer.

use std::convert::Infallible;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use trocar_proto::control::{ClientInfo, SessionStatus};
use trocar_proto::part::MAX_PART;
use trocar_proto::{Code, Placement, Rejection};

use super::admission::Footprint;
use super::observer::LiveRecording;
use super::scheduler::{Scheduler, SlotId};
use super::shared_world::SharedWorld;
use super::store::Store;
use super::watch::Subscriptions;
use crate::view::source::{SessionCard, Tally};

/// A session as the control loop sees it.
pub(super) struct SessionHandle {
    pub(super) shared: Arc<Shared>,
    /// Nothing is ever said there; it is closed when the session is gone.
    pub(super) ended: Receiver<Infallible>,
    pub(super) footprint: Footprint,
}

/// What a session shares with the threads that ask about it.
pub(super) struct Shared {
    pub(super) id: u64,
    /// Its number at the doorbell.
    pub(super) slot: SlotId,
    pub(super) client: ClientInfo,
    pub(super) task: String,
    pub(super) envs: u32,
    pub(super) stop: AtomicBool,
    /// What arrived is still to be answered, and nothing more.
    pub(super) finish: AtomicBool,
    /// Why it ends, where it is told to.
    pub(super) reason: OnceLock<&'static str>,
    pub(super) pace: Mutex<Pace>,
    /// `None` until the session is open.
    pub(super) store: Mutex<Option<Store>>,
    pub(super) recording: LiveRecording,
    /// What the task is like; nothing until the session is open.
    pub(super) nature: OnceLock<Nature>,
    pub(super) subscriptions: Subscriptions,
    /// Its live world, where it has one.
    pub(super) world: OnceLock<Arc<SharedWorld>>,
    /// Open files that it has still to take.
    pub(super) files_due: AtomicUsize,
}

/// What the viewer shows of a task.
#[derive(Debug)]
pub(super) struct Nature {
    pub(super) max_steps: u32,
    pub(super) seconds_per_step: f64,
    pub(super) has_goal: bool,
}

impl Shared {
    /// Its environments.
    pub(super) fn envs(&self) -> u32 {
        self.envs
    }

    /// Where it is watched.
    pub(super) fn subscriptions(&self) -> &Subscriptions {
        &self.subscriptions
    }

    /// The session in the viewer's list.
    pub(super) fn card(&self) -> SessionCard {
        let (nature, world) = (self.nature.get(), self.world.get());
        let pace = self.pace.lock().unwrap_or_else(PoisonError::into_inner);
        let success_rate = pace.tally.success_rate();
        SessionCard {
            id: self.id,
            pid: self.client.pid,
            language: self.client.language.clone(),
            task: self.task.clone(),
            envs: self.envs,
            arms: world.map_or_else(Vec::new, |world| world.arm_names()),
            speed: world.and_then(|world| world.info().speed),
            max_steps: nature.map_or(0, |nature| nature.max_steps),
            seconds_per_step: nature.map_or(0.0, |nature| nature.seconds_per_step),
            steps_per_second: pace.steps_per_second(),
            p50_us: pace.latency.value_at_quantile(0.5) as f64,
            p99_us: pace.latency.value_at_quantile(0.99) as f64,
            episodes: pace.tally.episodes(),
            success_rate: success_rate.filter(|_| nature.is_some_and(|nature| nature.has_goal)),
        }
    }

    /// The refusal of what its client asks for while it is being closed.
    pub(super) fn being_closed(&self) -> Rejection {
        let why = "the session is being closed";
        Rejection::new(Code::UnknownSession, "session", self.id, why)
    }

    /// Does something with the session's snapshots.
    pub(super) fn with_store<T>(
        &self,
        act: impl FnOnce(&mut Store) -> Result<T, Rejection>,
    ) -> Result<T, Rejection> {
        // Whatever panicked has left every snapshot whole: they are put in and taken out as one.
        let mut store = self.store.lock().unwrap_or_else(PoisonError::into_inner);
        let opening =
            || Rejection::new(Code::UnknownSession, "session", self.id, "it is being opened");
        act(store.as_mut().ok_or_else(opening)?)
    }
}

/// How fast a session runs.
#[derive(Debug)]
pub(super) struct Pace {
    /// Time per message, µs.
    latency: Histogram<u64>,
    span_start: Instant,
    span_steps: u64,
    steps_per_second: f64,
    /// How episodes ended, where any thread may look.
    pub(super) tally: Tally,
}

impl SessionHandle {
    pub(super) fn client(&self) -> &ClientInfo {
        &self.shared.client
    }

    pub(super) fn footprint(&self) -> Footprint {
        self.footprint
    }

    /// Open files that it has still to take: those of a session that opens, or whose client is not connected yet.
    pub(super) fn files_due(&self) -> usize {
        self.shared.files_due.load(Ordering::Relaxed)
    }

    /// Drops snapshots of the session.
    pub(super) fn forget(&self, snapshots: &[u64]) -> Result<(), Rejection> {
        self.shared.with_store(|store| {
            for number in snapshots {
                store.forget(*number);
            }
            Ok(())
        })
    }

    /// A snapshot of the session as bytes.
    pub(super) fn export(&self, snapshot: u64) -> Result<Vec<u8>, Rejection> {
        self.shared.with_store(|store| store.export(snapshot))
    }

    /// Brings a snapshot into the session and gives its number.
    pub(super) fn import(&self, bytes: &[u8]) -> Result<u64, Rejection> {
        self.shared.with_store(|store| store.import(bytes))
    }

    /// Brings a placement into the session and gives its number.
    pub(super) fn place(&self, placement: Placement) -> Result<u64, Rejection> {
        self.shared.with_store(|store| store.place(placement))
    }

    /// Begins to record one of its environments, a state each `every` steps.
    pub(super) fn record(&self, env: u32, every: u32) -> Result<(), Rejection> {
        if env >= self.shared.envs {
            let allowed = format!("allowed are numbers below {}", self.shared.envs);
            return Err(Rejection::new(Code::InvalidEnvIds, "env", env, allowed));
        }
        match self.shared.world.get() {
            Some(world) => world.record(),
            None => self.shared.recording.start(env, every),
        }
        Ok(())
    }

    /// What was recorded since the last time, and how many states were lost.
    pub(super) fn recorded(&self) -> Result<(Vec<u8>, u64), Rejection> {
        match self.shared.world.get() {
            Some(world) => Ok((world.recorded(MAX_PART)?, 0)),
            None => self.shared.recording.fetch(MAX_PART),
        }
    }

    pub(super) fn id(&self) -> u64 {
        self.shared.id
    }

    pub(super) fn envs(&self) -> u32 {
        self.shared.envs
    }

    /// Asks the session to end.
    pub(super) fn stop(&self, scheduler: &Arc<Scheduler>, reason: &'static str) {
        self.shared.reason.set(reason).ok();
        self.shared.stop.store(true, Ordering::Release);
        scheduler.schedule(self.shared.slot);
    }

    /// Asks the session to end once it has answered what it was asked.
    pub(super) fn finish(&self, scheduler: &Arc<Scheduler>) {
        self.shared.reason.set("shutdown").ok();
        self.shared.finish.store(true, Ordering::Release);
        scheduler.schedule(self.shared.slot);
    }

    pub(super) fn has_ended(&self) -> bool {
        self.ended.try_recv() == Err(TryRecvError::Disconnected)
    }

    /// Waits until nothing is left of it.
    pub(super) fn join(self) {
        self.ended.recv().ok();
    }

    pub(super) fn status(&self) -> SessionStatus {
        let Shared { id, client, task, envs, pace, .. } = &*self.shared;
        let pace = pace.lock().unwrap_or_else(PoisonError::into_inner);
        SessionStatus {
            id: *id,
            pid: client.pid,
            task: task.clone(),
            envs: *envs,
            steps_per_second: pace.steps_per_second(),
            p50_us: pace.latency.value_at_quantile(0.5) as f64,
            p99_us: pace.latency.value_at_quantile(0.99) as f64,
        }
    }
}

impl Pace {
    /// Latencies beyond a minute count as a minute.
    const LONGEST_US: u64 = 60_000_000;

    /// Span over which steps per second are counted.
    const SPAN: Duration = Duration::from_secs(1);

    pub(super) fn new() -> Self {
        Self {
            latency: Histogram::new_with_max(Self::LONGEST_US, 2).expect("2 digits are allowed"),
            span_start: Instant::now(),
            span_steps: 0,
            steps_per_second: 0.0,
            tally: Tally::default(),
        }
    }

    pub(super) fn note(&mut self, start: Instant, steps: u64) {
        self.latency.saturating_record(start.elapsed().as_micros() as u64);
        self.span_steps += steps;
        let span = self.span_start.elapsed();
        if span >= Self::SPAN {
            self.steps_per_second = self.span_steps as f64 / span.as_secs_f64();
            self.span_start = Instant::now();
            self.span_steps = 0;
        }
    }

    /// The rate of the last full span, or of the present one where that says more.
    fn steps_per_second(&self) -> f64 {
        let span = self.span_start.elapsed();
        if span >= Self::SPAN || self.steps_per_second == 0.0 {
            return self.span_steps as f64 / span.as_secs_f64().max(1e-3);
        }
        self.steps_per_second
    }
}
