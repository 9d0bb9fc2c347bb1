//! Where sessions wait for their clients, and the threads that answer them.
//!
//! A session that has nothing to do is a value in its seat and has no thread. *Workers* look at the door
//! ([`trocar_proto::door`]). A session whose client has rung gets a turn, the one that has computed least first, and
//! any worker answers it. So one thread answers what many clients sent, message by message, and the kernel changes
//! threads only for the clients. Some workers are in the middle of a message and wait for their next turn; besides
//! them, some workers look. All of them end once the last session has: the C library keeps memory that a thread has
//! freed for as long as that thread lives (`heap.rs`).
//!
//! No worker is woken up while all threads are taken: a worker that ends a turn looks at the door. But beside long turns
//! one worker, the *runner*, sleeps there for sessions that need little, which then go ahead (`turns.rs`). It does nothing
//! else: the kernel gives a thread that has just computed for long the processor late when it is woken up.

use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use trocar_proto::door::{Door, Listener, SEATS};

use self::worker::Worker;
use super::scheduler::Turn;
use super::turns::{Grant, Need, Turns, User, Waiter, Waiting, Who};

#[cfg(test)]
pub(super) mod tests;
mod worker;

/// How long a session is not looked at whose client does not ring: it may have to end, or a page watches
/// it.
const SLICE: Duration = Duration::from_millis(100);

/// Work that is worth waking another worker up for: less than that is done before the other worker
/// is awake.
const WORTH_HELP: Duration = Duration::from_micros(20);

/// How often the door is looked at in a row: a client may ring without end.
const MOST_LOOKS: u32 = 8;

/// A session, or what else has a client that rings at the door.
pub(super) trait Guest: Send {
    /// Answers one message, if there is any.
    fn attend(&mut self, turn: &mut Turn<'_>) -> Attended;

    /// What its next message is expected to need, after the latest one took so much CPU time.
    fn outlook(&mut self, computed: Duration) -> Outlook;

    /// It panicked, and is not attended any more.
    fn failed(&mut self);
}

/// What was done for a guest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Attended {
    /// A message was answered.
    Answered {
        /// Its client had to be woken up.
        slept: bool,
        /// There is another one.
        more: bool,
    },
    /// There was none.
    Nothing,
    /// It leaves.
    Over,
}

/// What is expected of a guest's next message.
#[derive(Debug, Clone, Copy)]
pub(super) struct Outlook {
    pub(super) need: Need,
    pub(super) cost: Duration,
}

/// The seats, and the threads for the guests that have them.
pub(super) struct Hall {
    pub(super) pool: rayon::ThreadPool,
    pub(super) door: Door,
    state: Mutex<State>,
    /// Time for which threads were taken, all together, ns.
    pub(super) busy: AtomicU64,
    /// A worker that looks at the door, awake, has to look at the queue, too.
    beckons: AtomicBool,
    /// Every thread is taken, so no worker looks awake.
    taken: AtomicBool,
}

/// What workers share.
pub(super) struct State {
    pub(super) turns: Turns,
    places: Vec<Place>,
    /// Workers that look at the door awake.
    polling: usize,
    /// Workers that sleep there, of each kind of [`Listener`].
    asleep: [Asleep; 2],
    /// There is one that attends to nothing but what is small.
    runner: bool,
    /// It looks after a while, whether a client rings or not.
    patient: bool,
    /// A worker looks after [`SLICE`].
    timed: bool,
    /// When all seats were last looked at.
    patrolled: Instant,
}

/// Workers of a kind that sleep at the door.
#[derive(Default)]
struct Asleep {
    /// How many, with workers that were woken up and have not looked yet.
    count: usize,
    /// The server has woken one of them up, or started one.
    summoned: bool,
    /// The door says that one wants to be woken up, unless one was since.
    posted: bool,
}

impl Asleep {
    /// Says at the door whether one wants to be woken up.
    fn post(&mut self, door: &Door, listener: Listener, wanted: bool) {
        // A worker that was woken up and has not looked yet will say.
        let underway = self.posted && !door.is_alert(listener);
        if wanted != self.posted && !underway {
            door.set_alert(listener, wanted);
            self.posted = wanted;
        }
    }
}

/// What is at a seat.
enum Place {
    Free,
    /// A guest is about to take it, or leaves it.
    Kept,
    Taken(Taken),
}

struct Taken {
    user: Arc<User>,
    outlook: Outlook,
    /// Not here while it is attended.
    guest: Option<Box<dyn Guest>>,
    /// Its client has rung, or it is to be looked at, and its turn has not begun.
    rung: bool,
    /// It was attended since all seats were looked at.
    attended: bool,
}

/// A seat, until this is dropped.
pub(super) struct Seat {
    hall: Arc<Hall>,
    pub(super) number: u32,
}

/// A guest whose turn it is.
struct Visit {
    seat: u32,
    user: Arc<User>,
    guest: Box<dyn Guest>,
    outlook: Outlook,
    grant: Grant,
}

/// A visit that is over.
struct Done {
    seat: u32,
    user: Arc<User>,
    /// The thread, if it was not given back before.
    grant: Option<Grant>,
    /// The guest, if it stays.
    stays: Option<(Box<dyn Guest>, Outlook)>,
    more: bool,
}

impl Hall {
    /// A hall with so many threads to step environments. Workers come when they are needed.
    pub(super) fn open(
        threads: usize,
        door: Door,
    ) -> Result<Arc<Self>, rayon::ThreadPoolBuildError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|index| format!("trocar-step-{index}"))
            .build()?;
        let state = State {
            turns: Turns::new(threads),
            places: (0..SEATS).map(|_| Place::Free).collect(),
            polling: 0,
            asleep: [Asleep::default(), Asleep::default()],
            runner: false,
            patient: false,
            timed: false,
            patrolled: Instant::now(),
        };
        Ok(Arc::new(Self {
            pool,
            door,
            state: Mutex::new(state),
            busy: AtomicU64::new(0),
            beckons: AtomicBool::new(false),
            taken: AtomicBool::new(false),
        }))
    }

    /// Whether there are several threads.
    pub(super) fn is_parallel(&self) -> bool {
        self.pool.current_num_threads() > 1
    }

    /// How many workers may sleep. Each has a heap of its own: with 16 clients of which five a second are killed, a
    /// server with as many as came took 44 to 50 MiB after a minute, with these 36 to 40 (a run each).
    fn most_sleepers(&self) -> usize {
        self.pool.current_num_threads() + 1
    }

    /// A seat that is free, if there is any.
    pub(super) fn keep_seat(self: &Arc<Self>) -> Option<Seat> {
        let mut state = self.lock();
        let number = state.places.iter().position(|place| matches!(place, Place::Free))?;
        state.places[number] = Place::Kept;
        Some(Seat { hall: Arc::clone(self), number: number as u32 })
    }

    /// From now on `guest` sits there. It is looked at once, whether its client has rung or not.
    pub(super) fn admit(
        self: &Arc<Self>,
        seat: u32,
        user: Arc<User>,
        outlook: Outlook,
        guest: Box<dyn Guest>,
    ) {
        let mut state = self.lock();
        let guest = Some(guest);
        let taken = Taken { user, outlook, guest, rung: false, attended: false };
        state.places[seat as usize] = Place::Taken(taken);
        drop(state);
        self.call(seat);
    }

    /// Has the guest at `seat` attended to, whether its client has rung or not.
    pub(super) fn call(self: &Arc<Self>, seat: u32) {
        let mut state = self.lock();
        state.call(seat);
        let help = state.needs_help(None);
        self.fetch_help(state, help);
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, State> {
        // What is guarded is consistent after every statement, panic or not.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether `user`, whose turn is over, may go on.
    pub(super) fn renew(&self, user: &User, grant: Grant) -> bool {
        let mut state = self.lock();
        state.collect(&self.door);
        state.turns.renew(user, grant)
    }

    /// Hands threads out to the entries of the queue that are next, after `change`.
    pub(super) fn free(self: &Arc<Self>, change: impl FnOnce(&mut Turns)) {
        let mut state = self.lock();
        change(&mut state.turns);
        let (state, _) = self.hand_out(state, None, false);
        let help = state.needs_help(None);
        self.fetch_help(state, help);
    }

    /// Hands threads out to the entries of the queue that are next. The first guest is for the caller, if the caller
    /// looks for one and `attends` to its kind. Workers are woken up with the lock released: on the same processor
    /// they may run at once.
    fn hand_out<'a>(
        &'a self,
        mut state: MutexGuard<'a, State>,
        attends: Option<Listener>,
        overdue: bool,
    ) -> (MutexGuard<'a, State>, Option<Visit>) {
        let fits = |need: Need| match attends {
            Some(Listener::Any) => true,
            Some(Listener::Small) => need.is_small(),
            None => false,
        };
        let (mut visit, mut looks) = (None, 0);
        loop {
            state.collect(&self.door);
            match state.turns.due(overdue) {
                Some(Waiting { who: Who::Guest(_), need, .. })
                    if visit.is_none() && fits(*need) =>
                {
                    visit = state.begin_visit();
                }
                Some(Waiting { who: Who::Worker(_), .. }) => {
                    if let Some(waiter) = state.call_worker() {
                        drop(state);
                        waiter.thread.unpark();
                        state = self.lock();
                    }
                }
                _ => {
                    state.post(self);
                    looks += 1;
                    // A client may have rung before it could know that a worker listens.
                    let listens = state.asleep.iter().any(|asleep| asleep.posted);
                    if !listens || !self.door.is_rung() || looks == MOST_LOOKS {
                        return (state, visit);
                    }
                }
            }
        }
    }

    /// Has a worker of the kind that is needed look at the door and at the queue.
    fn fetch_help(self: &Arc<Self>, mut state: MutexGuard<'_, State>, kind: Option<Listener>) {
        let Some(kind) = kind else { return };
        if kind == Listener::Any && state.polling > 0 {
            self.beckons.store(true, Ordering::SeqCst);
            return;
        }
        let is_there = kind == Listener::Small && state.runner;
        let asleep = state.asleep(kind);
        let is_asleep = asleep.count > 0;
        // The runner looks again, if it is awake.
        if asleep.summoned || (is_there && !is_asleep) {
            return;
        }
        asleep.summoned = true;
        state.runner |= kind == Listener::Small;
        drop(state);
        if is_asleep {
            self.door.wake(kind);
        } else if let Err(error) = Worker::start(Arc::clone(self), kind) {
            tracing::warn!(%error, "a thread could not be started; clients wait for those that there are");
            let mut state = self.lock();
            state.asleep(kind).summoned = false;
            state.runner &= kind != Listener::Small;
        }
    }
}

impl State {
    fn asleep(&mut self, kind: Listener) -> &mut Asleep {
        &mut self.asleep[kind as usize]
    }

    /// Puts those into the queue whose clients have rung.
    pub(super) fn collect(&mut self, door: &Door) {
        for seat in door.take() {
            self.call(seat);
        }
    }

    /// Puts the guest at `seat` into the queue, or has it looked at again after its turn.
    fn call(&mut self, seat: u32) {
        let Place::Taken(taken) = &mut self.places[seat as usize] else { return };
        if !taken.rung && taken.guest.is_some() {
            self.turns.queue(&taken.user, Who::Guest(seat), taken.outlook.need);
        }
        taken.rung = true;
    }

    /// Calls guests that were not attended since this was last done.
    fn patrol(&mut self) {
        if self.patrolled.elapsed() < SLICE {
            return;
        }
        self.patrolled = Instant::now();
        for seat in 0..SEATS {
            let Place::Taken(taken) = &mut self.places[seat] else { continue };
            if !std::mem::take(&mut taken.attended) {
                self.call(seat as u32);
            }
        }
    }

    /// Begins the turn of the guest that is next.
    fn begin_visit(&mut self) -> Option<Visit> {
        let (Waiting { who: Who::Guest(seat), .. }, grant) = self.turns.begin()? else {
            return None;
        };
        let Place::Taken(taken) = &mut self.places[seat as usize] else { return None };
        (taken.rung, taken.attended) = (false, true);
        let (user, outlook) = (Arc::clone(&taken.user), taken.outlook);
        taken.guest.take().map(|guest| Visit { seat, user, guest, outlook, grant })
    }

    /// Gives a thread to the worker that is next.
    fn call_worker(&mut self) -> Option<Arc<Waiter>> {
        let (Waiting { who: Who::Worker(waiter), .. }, grant) = self.turns.begin()? else {
            return None;
        };
        waiter.ahead.store(grant.ahead, Ordering::Relaxed);
        waiter.called.store(true, Ordering::Release);
        Some(waiter)
    }

    /// Takes back what a visit had.
    fn settle(&mut self, done: Done) {
        if let Some(grant) = done.grant {
            self.turns.give_back(&done.user, grant);
        }
        let Some((guest, outlook)) = done.stays else { return };
        let Place::Taken(taken) = &mut self.places[done.seat as usize] else { return };
        (taken.guest, taken.outlook) = (Some(guest), outlook);
        if std::mem::take(&mut taken.rung) || done.more {
            self.call(done.seat);
        }
    }

    /// Says at the door whether rings have to wake a worker up.
    fn post(&mut self, hall: &Hall) {
        let busy = self.turns.is_busy();
        hall.taken.store(busy, Ordering::Relaxed);
        let awake = self.polling + self.turns.little > 0;
        let runs = self.turns.may_go_ahead() && !self.patient;
        let [any, small] = &mut self.asleep;
        any.post(&hall.door, Listener::Any, any.count > 0 && !busy && !awake);
        small.post(&hall.door, Listener::Small, small.count > 0 && runs);
    }

    /// The kind of worker that has to look at the queue, or listen, while the caller attends to a guest of this
    /// `outlook`, or to none.
    fn needs_help(&self, outlook: Option<Outlook>) -> Option<Listener> {
        // A worker whose guest needs little looks again soon.
        let soon = outlook.is_some_and(|outlook| outlook.need == Need::Little);
        let busy = self.turns.is_busy();
        let unheard = outlook.is_some()
            && !soon
            && self.polling + self.asleep[Listener::Any as usize].count == 0;
        if self.turns.due(false).is_some() {
            let kind = if busy { Listener::Small } else { Listener::Any };
            return (busy || !(soon && self.is_brief())).then_some(kind);
        }
        let tried = self.turns.is_tried() && !self.patient;
        if tried || (self.turns.may_go_ahead() && !self.runner) {
            return Some(Listener::Small);
        }
        (unheard && !busy).then_some(Listener::Any)
    }

    /// Whether the guests that wait are attended to before another worker is awake.
    fn is_brief(&self) -> bool {
        let mut left = WORTH_HELP;
        self.turns.waiting.iter().all(|waiting| {
            let cost = match &waiting.who {
                Who::Guest(seat) => match &self.places[*seat as usize] {
                    Place::Taken(taken) => taken.outlook.cost,
                    Place::Free | Place::Kept => Duration::ZERO,
                },
                // It has waited for a thread already.
                Who::Worker(_) => return false,
            };
            left = left.saturating_sub(cost);
            !left.is_zero()
        })
    }

    fn is_empty(&self) -> bool {
        !self.places.iter().any(|place| matches!(place, Place::Taken(_)))
    }
}

impl fmt::Debug for Hall {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Hall").field("door", &self.door).finish_non_exhaustive()
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.hall.lock().places[self.number as usize] = Place::Free;
    }
}
