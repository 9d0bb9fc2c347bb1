//! A session with a live world: commands to its arms, ticks, and what became of them.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use trocar_proto::control::SessionRequest;
use trocar_proto::dvrk::LiveRequest;
use trocar_proto::dvrk::record::{CommandRecord, QuestionRecord};
use trocar_proto::wire::{
    Header, LiveReplyLayout, LiveRequestLayout, MAX_COMMANDS, MAX_TICKS, PictureLayout, flag, kind,
};
use trocar_proto::{Code, Rejection};

use super::batch::PICTURE;
use super::batch_session;
use super::driver::Driver;
use super::handle::Shared;
use super::internal;
use super::scheduler::{Quantum, Scheduler, SlotId, Splittable};
use super::session::{Description, ServerContext, SessionKind};
use super::shared_world::{Passed, SharedWorld};
use super::store::{self, Ledger, Saved};
use crate::env::{Env, Imaging, Shot};

/// Ticks that are simulated between two looks at the quantum: a few hundred microseconds.
const TICKS_AT_ONCE: u32 = 12;

/// Most ticks that a paced world catches up with before it looks for a request: a few milliseconds.
const MOST_TICKS_DUE: u64 = 240;

/// Shortest pause of a paced world between two looks at what is due.
const SHORTEST_PAUSE: Duration = Duration::from_millis(1);

/// A session's part in a live world.
pub(super) struct LiveSession {
    shared: Arc<Shared>,
    world: Arc<SharedWorld>,
    is_maker: bool,
    /// What its commands come from.
    driver: Driver,
    request_layout: LiveRequestLayout,
    reply_layout: LiveReplyLayout,
    /// How the world is drawn when that is asked for.
    view: Option<(Imaging, PictureLayout)>,
    /// A request's commands, copied out of shared memory before anything looks at them.
    commands: Vec<CommandRecord>,
    /// Events that its client was told.
    heard: u64,
    /// Steps of the task that were counted.
    steps: u32,
    /// Expected CPU time of a few ticks.
    cost: Duration,
    _timer: Option<Timer>,
}

impl LiveSession {
    /// A session with a world of its own, or with that of another session.
    pub(super) fn new(
        context: &Arc<ServerContext>,
        ledger: &Arc<Ledger>,
        shared: &Arc<Shared>,
        wanted: &SessionRequest,
        live: LiveRequest,
    ) -> Result<Self, Rejection> {
        let world = match live.world {
            None => Arc::new(SharedWorld::new(&context.registry, ledger, wanted, live)?),
            Some(session) => {
                let found = context.watch.session(session);
                let world = found.and_then(|shared| shared.world.get().cloned());
                let world = world.ok_or_else(|| {
                    let why = "no open session of this number has a live world";
                    Rejection::new(Code::UnknownSession, "live.world", session, why)
                })?;
                world.check_shared(wanted)?;
                world
            }
        };
        let is_maker = live.world.is_none();
        let timer = match world.period() {
            Some(period) if is_maker => {
                Some(Timer::start(&context.scheduler, shared.slot, period.max(SHORTEST_PAUSE))?)
            }
            _ => None,
        };
        let view = batch_session::view_of(context, wanted)?
            .map(|(imaging, layout)| (imaging.in_scene(&world.with_env(Env::scene)), layout));
        let world = shared.world.get_or_init(|| world);
        let spec = world.with_env(|env| env.spec().clone());
        let driver = Driver::Session {
            session: shared.id,
            pid: shared.client.pid,
            is_supervised: live.intervention,
        };
        Ok(Self {
            reply_layout: LiveReplyLayout::new(world.info(), &spec),
            request_layout: LiveRequestLayout::new(),
            commands: Vec::with_capacity(MAX_COMMANDS),
            heard: 0,
            steps: 0,
            cost: Duration::from_micros(200),
            world: Arc::clone(world),
            shared: Arc::clone(shared),
            view,
            is_maker,
            driver,
            _timer: timer,
        })
    }

    /// Does what commands ask for, and lets time pass. Returns how many steps of the task have passed since the
    /// message before.
    fn live(
        &mut self,
        asked: &Header,
        payload: &[u8],
        reply: &mut [u8],
        quantum: &mut Quantum<'_>,
    ) -> Result<u64, Rejection> {
        let rows = asked.rows as usize;
        let refuse = |field: &str, value: usize, most: usize| {
            let allowed = format!("allowed is 0 to {most}");
            Rejection::new(Code::Malformed, field, value, allowed)
        };
        if rows > MAX_COMMANDS {
            return Err(refuse("header.rows", rows, MAX_COMMANDS));
        }
        let layout = &self.request_layout;
        let ticks = layout.ticks.view::<u32>(payload, 1)[0];
        if ticks > MAX_TICKS {
            return Err(refuse("ticks", ticks as usize, MAX_TICKS as usize));
        }
        self.commands.clear();
        self.commands.extend_from_slice(&layout.commands.view(payload, 1)[..rows]);
        self.world.command(self.driver, &self.commands)?;
        let until_event = asked.flags & flag::UNTIL_EVENT != 0;
        let mut passed = Passed::default();
        while passed.ticks < ticks && !(until_event && passed.has_told) {
            if self.shared.stop.load(Ordering::Acquire) {
                return Err(self.shared.being_closed());
            }
            let most = (ticks - passed.ticks).min(TICKS_AT_ONCE);
            let (world, mut now) = (&self.world, Ok(Passed::default()));
            quantum.run(Whole::new(|| now = world.advance(most, until_event)), self.cost);
            let now = now?;
            passed.ticks += now.ticks;
            passed.has_told |= now.has_told;
        }
        if passed.ticks > 0 {
            self.note_change();
        }
        self.world.write(&self.reply_layout, reply, passed, &mut self.heard)?;
        let steps = self.world.with_env(Env::steps);
        // A world that was brought back to an earlier state has fewer.
        Ok(u64::from(steps.saturating_sub(std::mem::replace(&mut self.steps, steps))))
    }

    /// Keeps the state of the world.
    fn save(&self, reply: &mut [u8]) -> Result<(), Rejection> {
        let mut room = self.shared.with_store(|store| store.make_room(1))?;
        let saved = Saved::World(Arc::new(self.world.save()?));
        let number = self.shared.with_store(|store| Ok(store.put(&mut room, saved)))?;
        self.reply_layout.snapshot.view_mut(reply, 1)[0] = number;
        Ok(())
    }

    /// Brings the world back to a state that was kept.
    fn restore(&mut self, payload: &[u8], reply: &mut [u8]) -> Result<(), Rejection> {
        let number: u64 = self.request_layout.snapshot.view(payload, 1)[0];
        let Saved::World(saved) = self.shared.with_store(|store| store.get(number))? else {
            return Err(store::no_state(number));
        };
        self.world.restore(self.driver, &saved)?;
        self.be_elsewhere(reply)
    }

    /// Begins another episode.
    fn reset(&mut self, payload: &[u8], reply: &mut [u8]) -> Result<(), Rejection> {
        let seed: u64 = self.request_layout.seed.view(payload, 1)[0];
        self.world.reset(self.driver, seed)?;
        self.be_elsewhere(reply)
    }

    /// Tells of a world that was brought into another state.
    fn be_elsewhere(&mut self, reply: &mut [u8]) -> Result<(), Rejection> {
        self.steps = self.world.with_env(Env::steps);
        self.note_change();
        self.world.write(&self.reply_layout, reply, Passed::default(), &mut self.heard)
    }

    /// Draws the world as it is: colours, or depth.
    fn draw(
        &self,
        depth: bool,
        reply: &mut [u8],
        quantum: &mut Quantum<'_>,
    ) -> Result<(), Rejection> {
        let Some((view, layout)) = &self.view else { return Err(batch_session::no_view()) };
        // Its time goes on meanwhile.
        let scene = self.world.with_env(Env::scene);
        let shot = Shot { scene, rgb: &mut [], depth: &mut [], mask: &mut [], points: &mut [] };
        let mut shot = if depth {
            Shot { depth: layout.depth.view_mut(reply, 1), ..shot }
        } else {
            Shot { rgb: layout.rgb.view_mut(reply, 1), ..shot }
        };
        quantum.run(Whole::new(|| view.draw(std::slice::from_mut(&mut shot))), PICTURE);
        Ok(())
    }

    /// Lets the pages that watch know that there is something new.
    fn note_change(&self) {
        if self.shared.subscriptions.is_watched() {
            self.shared.subscriptions.note_change();
        }
    }
}

impl SessionKind for LiveSession {
    fn describe(&self) -> Description {
        Description {
            spec: self.world.with_env(|env| env.spec().clone()),
            view: self.view.as_ref().map(|(imaging, _)| Box::new(imaging.spec().clone())),
            live: Some(Box::new(self.world.info().clone())),
        }
    }

    fn like(&self) -> Arc<Env> {
        Arc::new(self.world.with_env(Env::clone))
    }

    fn reply_bytes(&self, kind: u32) -> usize {
        match &self.view {
            Some((_, layout)) if kind == kind::RENDER => layout.bytes,
            _ => self.reply_layout.bytes,
        }
    }

    fn carry_out(
        &mut self,
        asked: &Header,
        payload: &[u8],
        reply: &mut [u8],
        _: Instant,
        quantum: &mut Quantum<'_>,
    ) -> Result<u64, Rejection> {
        if payload.len() < self.request_layout.bytes {
            let allowed = format!("expected {} bytes", self.request_layout.bytes);
            return Err(Rejection::new(Code::Malformed, "payload", payload.len(), allowed));
        }
        match asked.kind {
            kind::LIVE => return self.live(asked, payload, reply, quantum),
            kind::ASK => {
                let question: QuestionRecord = self.request_layout.question.view(payload, 1)[0];
                self.reply_layout.answer.view_mut(reply, 1)[0] = self.world.answer(&question)?;
            }
            kind::RENDER => self.draw(asked.flags & flag::DEPTH != 0, reply, quantum)?,
            kind::SNAPSHOT => self.save(reply)?,
            kind::RESTORE => self.restore(payload, reply)?,
            kind::RESET => self.reset(payload, reply)?,
            other => {
                use kind::{ASK, LIVE, RENDER, RESET, RESTORE, SNAPSHOT};
                let taken = [LIVE, ASK, RENDER, SNAPSHOT, RESTORE, RESET];
                let allowed = format!("a live world takes {taken:?}");
                return Err(Rejection::new(Code::Malformed, "header.kind", other, allowed));
            }
        }
        Ok(0)
    }

    fn pass_time(&mut self, quantum: &mut Quantum<'_>) {
        if self.world.info().speed.is_none() {
            return;
        }
        let mut left = self.world.due().min(MOST_TICKS_DUE) as u32;
        while left > 0 && !self.shared.stop.load(Ordering::Acquire) {
            let (world, now) = (&self.world, left.min(TICKS_AT_ONCE));
            quantum.run(Whole::new(|| world.catch_up(now)), self.cost);
            left -= now;
        }
        self.note_change();
    }

    fn show(&mut self) {
        self.world.with_env(|env| self.shared.subscriptions.show(|_| env));
    }

    fn learn(&mut self, _: Duration) {}
}

impl Drop for LiveSession {
    fn drop(&mut self) {
        self.world.leave(self.shared.id, self.is_maker);
    }
}

/// Work in one piece.
struct Whole<F>(Option<F>);

impl<F: FnOnce() + Send> Whole<F> {
    fn new(work: F) -> Self {
        Self(Some(work))
    }
}

impl<F: FnOnce() + Send> Splittable for Whole<F> {
    fn len(&self) -> usize {
        usize::from(self.0.is_some())
    }

    fn split_at(self, at: usize) -> (Self, Self) {
        if at == 0 { (Self(None), self) } else { (self, Self(None)) }
    }

    fn run(self) {
        if let Some(work) = self.0 {
            work();
        }
    }
}

/// Has a session polled at the pace of its world, until this is dropped.
struct Timer(
    #[expect(dead_code, reason = "its end is what the thread waits for")] Sender<Infallible>,
);

impl Timer {
    fn start(
        scheduler: &Arc<Scheduler>,
        slot: SlotId,
        period: Duration,
    ) -> Result<Self, Rejection> {
        let (stop, stopped) = channel();
        let scheduler = Arc::clone(scheduler);
        let thread = std::thread::Builder::new().name(format!("trocar-pace-{}", slot.0));
        thread
            .spawn(move || {
                while stopped.recv_timeout(period) == Err(RecvTimeoutError::Timeout) {
                    scheduler.schedule(slot);
                }
            })
            .map_err(internal("thread"))?;
        Ok(Self(stop))
    }
}
