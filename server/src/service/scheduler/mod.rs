//! The scheduler: which session's message is answered next, and by which thread. README.md beside this file has its
//! states, a diagram, and why no wake-up is lost.
//!
//! | file | holds |
//! |---|---|
//! | [`mod@self`] | slots, and what changes them |
//! | `run_queue.rs` | permits to compute, and which session is next for one |
//! | `quantum.rs` | how long a message's work keeps its permits |
//! | `work_queue.rs` | work that several threads take chunk by chunk |
//! | `worker.rs` | the threads that poll sessions |

use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use trocar_proto::notify::doorbell::{Doorbell, SLOTS};

use self::run_queue::{Parked, RunQueue, Runnable};
use self::worker::Worker;

mod quantum;
mod run_queue;
#[cfg(test)]
pub(super) mod tests;
mod work_queue;
mod worker;

pub(crate) use quantum::Quantum;
pub(super) use run_queue::{Entity, ThreadQuota};
pub(crate) use work_queue::Splittable;

/// How long a session is not polled whose client does not ring, at most: it may have to end, or a page watches it.
pub(super) const SCAN_PERIOD: Duration = Duration::from_millis(100);

/// The number of a session at the doorbell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct SlotId(pub(super) u32);

/// What has a slot: a session.
pub(super) trait Poll: Send {
    /// Answers one message, if there is any.
    fn poll(&mut self, quantum: &mut Quantum<'_>) -> Polled;

    /// The message that was answered took so much CPU time.
    fn computed(&mut self, time: Duration);

    /// It panicked, and is not polled any more.
    fn failed(&mut self);
}

/// What a poll found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Polled {
    /// A message was answered.
    Answered {
        /// Its client had to be woken up.
        slept: bool,
        /// There is another one.
        more: bool,
    },
    /// There was none.
    Idle,
    /// The session ends.
    Closed,
}

/// The slots, and the threads that poll the sessions in them.
pub(super) struct Scheduler {
    pool: rayon::ThreadPool,
    pub(super) doorbell: Doorbell,
    state: Mutex<State>,
    /// Time for which threads had permits, all together, ns.
    busy: AtomicU64,
    /// A worker that looks awake has to look at the queue, too.
    kicked: AtomicBool,
}

/// What workers share.
struct State {
    queue: RunQueue,
    slots: Vec<Slot>,
    /// Workers that look at the doorbell and the queue awake, or are being started.
    looking: usize,
    /// Workers that sleep at the doorbell, with those that were woken up and have not looked yet.
    asleep: usize,
    /// The doorbell says that one wants to be woken up, unless one was since.
    advertised: bool,
}

enum Slot {
    Free,
    /// A session is about to occupy it, or leaves it.
    Reserved,
    Occupied(Occupied),
}

struct Occupied {
    entity: Arc<Entity>,
    /// Not here while it is polled.
    session: Option<Box<dyn Poll>>,
    /// It is to be polled, and that has not begun.
    ready: bool,
    /// It was polled since the latest scan.
    polled: bool,
}

/// A slot that no other session gets, until this is dropped.
pub(super) struct SlotReservation {
    scheduler: Arc<Scheduler>,
    pub(super) id: SlotId,
}

/// A session that a worker polls, with a permit.
struct Running {
    slot: SlotId,
    entity: Arc<Entity>,
    session: Box<dyn Poll>,
}

/// A session that was polled.
struct Finished {
    slot: SlotId,
    entity: Arc<Entity>,
    /// The permit was not given back before.
    permitted: bool,
    /// The session, unless it ends.
    session: Option<Box<dyn Poll>>,
    more: bool,
}

impl Scheduler {
    /// One with so many threads to step environments. Workers come when they are needed.
    pub(super) fn new(
        threads: usize,
        doorbell: Doorbell,
    ) -> Result<Arc<Self>, rayon::ThreadPoolBuildError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|index| format!("trocar-step-{index}"))
            .build()?;
        let state = State {
            queue: RunQueue::new(threads),
            slots: (0..SLOTS).map(|_| Slot::Free).collect(),
            looking: 0,
            asleep: 0,
            advertised: false,
        };
        let (state, busy, kicked) = (Mutex::new(state), AtomicU64::new(0), AtomicBool::new(false));
        Ok(Arc::new(Self { pool, doorbell, state, busy, kicked }))
    }

    /// Time for which threads had permits, all together.
    pub(super) fn busy(&self) -> Duration {
        Duration::from_nanos(self.busy.load(Ordering::Relaxed))
    }

    /// A free slot, if there is any.
    pub(super) fn reserve(self: &Arc<Self>) -> Option<SlotReservation> {
        let mut state = self.lock();
        let free = state.slots.iter().position(|slot| matches!(slot, Slot::Free))?;
        state.slots[free] = Slot::Reserved;
        Some(SlotReservation { scheduler: Arc::clone(self), id: SlotId(free as u32) })
    }

    /// From now on `session` has this slot. It is polled once, whether its client has rung or not.
    pub(super) fn occupy(
        self: &Arc<Self>,
        slot: SlotId,
        entity: Arc<Entity>,
        session: Box<dyn Poll>,
    ) {
        let session = Some(session);
        let occupied = Occupied { entity, session, ready: false, polled: false };
        let mut state = self.lock();
        state.slots[slot.0 as usize] = Slot::Occupied(occupied);
        state.make_ready(slot);
        self.dispatch(state);
    }

    /// Has a session polled, whether its client has rung or not.
    pub(super) fn schedule(self: &Arc<Self>, slot: SlotId) {
        let mut state = self.lock();
        state.make_ready(slot);
        self.dispatch(state);
    }

    /// Has the sessions polled that were not since the scan before. The control loop calls it, every
    /// [`SCAN_PERIOD`].
    pub(super) fn scan(self: &Arc<Self>) {
        let mut state = self.lock();
        for slot in 0..SLOTS {
            if let Slot::Occupied(occupied) = &mut state.slots[slot]
                && !std::mem::take(&mut occupied.polled)
            {
                state.make_ready(SlotId(slot as u32));
            }
        }
        self.dispatch(state);
    }

    fn is_parallel(&self) -> bool {
        self.pool.current_num_threads() > 1
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // What is guarded is consistent after every statement, panic or not.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the queue, and hands out the permits that are free then.
    fn update(self: &Arc<Self>, change: impl FnOnce(&mut RunQueue)) {
        let mut state = self.lock();
        change(&mut state.queue);
        self.dispatch(state);
    }

    /// Whether `entity`, whose quantum is over, keeps its permit.
    fn renew(&self, entity: &Entity) -> bool {
        let mut state = self.lock();
        state.collect(&self.doorbell);
        state.queue.renew(entity)
    }

    /// Hands permits out to parked workers; sessions are left to a worker that looks.
    fn dispatch(self: &Arc<Self>, mut state: MutexGuard<'_, State>) {
        state.collect(&self.doorbell);
        let (_, permitted) = state.hand_out(false);
        if self.release(state, permitted) {
            self.doorbell.kick();
        }
    }

    /// Sees to it that a worker takes what is next and that one listens for rings; then lets go of the lock. Workers
    /// are woken up after that: on the same processor they may run at once. True where a client may have rung before it
    /// could know that a worker listens.
    fn release(
        self: &Arc<Self>,
        mut state: MutexGuard<'_, State>,
        permitted: Vec<Arc<Parked>>,
    ) -> bool {
        let is_due = state.queue.peek().is_some();
        let is_unheard = state.queue.free > 0 && state.looking + state.asleep == 0;
        let (looks, sleeps) = (state.looking > 0, state.asleep > 0);
        let starts = !looks && !sleeps && (is_due || is_unheard) && !state.is_empty();
        state.looking += usize::from(starts);
        let advertises = state.advertise(&self.doorbell);
        drop(state);
        for worker in permitted {
            worker.unpark();
        }
        if starts {
            Worker::start(self);
        } else if is_due && looks {
            self.kicked.store(true, Ordering::Release);
        } else if is_due && sleeps {
            self.doorbell.kick();
        }
        advertises && self.doorbell.is_rung()
    }
}

impl State {
    /// Puts the sessions into the queue whose clients have rung.
    fn collect(&mut self, doorbell: &Doorbell) {
        for slot in doorbell.take() {
            self.make_ready(SlotId(slot));
        }
    }

    /// Puts a session into the queue, or has it polled again after the poll that has begun.
    fn make_ready(&mut self, slot: SlotId) {
        let Slot::Occupied(occupied) = &mut self.slots[slot.0 as usize] else { return };
        if !occupied.ready && occupied.session.is_some() {
            self.queue.push(&occupied.entity, Runnable::Slot(slot));
        }
        occupied.ready = true;
    }

    /// Hands permits out in the order of the queue: to parked workers, and to one session if the caller `polls` it.
    fn hand_out(&mut self, polls: bool) -> (Option<Running>, Vec<Arc<Parked>>) {
        let (mut running, mut permitted) = (None, vec![]);
        while let Some(next) = self.queue.peek() {
            if matches!(next, Runnable::Slot(_)) && (running.is_some() || !polls) {
                break;
            }
            match self.queue.pop() {
                Some(Runnable::Slot(slot)) => running = Some(self.begin(slot)),
                Some(Runnable::Worker(worker)) => permitted.push(worker),
                None => break,
            }
        }
        (running, permitted)
    }

    fn begin(&mut self, slot: SlotId) -> Running {
        let Slot::Occupied(occupied) = &mut self.slots[slot.0 as usize] else {
            unreachable!("a session in the queue has its slot");
        };
        (occupied.ready, occupied.polled) = (false, true);
        let session = occupied.session.take().expect("a session in the queue is not polled");
        Running { slot, entity: Arc::clone(&occupied.entity), session }
    }

    /// Takes back what a poll had.
    fn settle(&mut self, finished: Finished) {
        let Finished { slot, entity, permitted, session, more } = finished;
        if permitted {
            self.queue.give_back(&entity, 1);
        }
        let Some(session) = session else { return };
        let Slot::Occupied(occupied) = &mut self.slots[slot.0 as usize] else { return };
        occupied.session = Some(session);
        if std::mem::take(&mut occupied.ready) || more {
            self.make_ready(slot);
        }
    }

    /// Says at the doorbell whether rings have to wake a worker up. True where it begins to do so: a client may have
    /// rung before it could know.
    fn advertise(&mut self, doorbell: &Doorbell) -> bool {
        let wanted = self.asleep > 0 && self.looking == 0 && self.queue.free > 0;
        if wanted == self.advertised {
            return false;
        }
        self.advertised = wanted;
        doorbell.advertise(wanted);
        wanted
    }

    fn is_empty(&self) -> bool {
        !self.slots.iter().any(|slot| matches!(slot, Slot::Occupied(_)))
    }
}

impl fmt::Debug for Scheduler {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Scheduler").field("doorbell", &self.doorbell).finish_non_exhaustive()
    }
}

impl Drop for SlotReservation {
    fn drop(&mut self) {
        self.scheduler.lock().slots[self.id.0 as usize] = Slot::Free;
    }
}
