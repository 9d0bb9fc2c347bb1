//! Turns: which session's environments run on which threads.
//!
//! A session asks for a turn, runs its environments bite by bite for about a millisecond, and asks
//! again. The next turn is for whoever has had the threads for the least time, and idle time saves
//! nothing up (start-time fair queueing, Goyal et al. 1996). So sessions share the threads evenly
//! whatever their size, and one that needs less than its share hardly waits. A session that finds idle
//! threads uses them too.
//!
//! A turn can last much longer: one environment's step may take milliseconds, and the kernel may give
//! the processor to others meanwhile. Whoever is next and needs little does not wait for its end but
//! goes ahead, on one thread more, one at a time. None of this changes any result.
//!
//! Waking a thread up takes longer than many a step. So where there is always somebody who will soon
//! look, whose turn ends or who waits awake, the threads of sessions that need little are left asleep
//! ([`Guest`]): whoever looks does their work in their place.

use std::cell::Cell;
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::pile::{Divisible, Pile};
use super::turns::{Guest, PROMISE, Promise, Share, Turns, WAITER, Waiter, Waiting};

/// How long a session may keep a thread while others wait, and one bite more.
pub(crate) const TURN: Duration = Duration::from_millis(1);

/// Work that is taken up at once.
const BITE: Duration = Duration::from_micros(200);

/// Work that is worth another thread: waking one up costs about half of it.
const WORTH: Duration = Duration::from_micros(50);

/// The threads that step environments, and how many of them its user may have at a time. Clones
/// have that share together, and their time counts together.
#[derive(Clone)]
pub(crate) struct Scheduler {
    threads: Arc<Threads>,
    share: Arc<Share>,
    /// CPU time, on the clock of [`Turns`], ns.
    spent: Arc<AtomicU64>,
}

struct Threads {
    pool: rayon::ThreadPool,
    turns: Mutex<Turns>,
    /// Time for which threads were taken, all together, ns.
    busy: AtomicU64,
}

impl fmt::Debug for Scheduler {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Scheduler").field("spent", &self.spent).finish_non_exhaustive()
    }
}

impl Scheduler {
    /// A scheduler of `threads` threads.
    pub(crate) fn new(threads: usize) -> Result<Self, rayon::ThreadPoolBuildError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|index| format!("trocar-step-{index}"))
            .build()?;
        let turns = Turns {
            free: threads,
            ahead: false,
            waiting: vec![],
            clock: 0,
            guests: vec![],
            watchers: 0,
            slow: 0,
        };
        let threads = Threads { pool, turns: Mutex::new(turns), busy: AtomicU64::new(0) };
        let (threads, share) = (Arc::new(threads), Share::new(usize::MAX));
        Ok(Self { threads, share, spent: Arc::default() })
    }

    /// The same threads, of which this one and its clones may have at most `limit` at a time.
    pub(crate) fn limited(&self, limit: usize) -> Self {
        Self { share: Share::new(limit), ..self.separate() }
    }

    /// The same threads and share, for somebody whose time counts separately.
    pub(crate) fn separate(&self) -> Self {
        Self { spent: Arc::default(), ..self.clone() }
    }

    /// Time for which threads were taken, all together.
    pub(crate) fn busy(&self) -> Duration {
        Duration::from_nanos(self.threads.busy.load(Ordering::Relaxed))
    }

    /// Does `work`, turn by turn. `cost` is the time one piece is expected to take; it is updated
    /// by what was measured.
    pub(crate) fn run<W: Divisible>(&self, work: W, cost: &mut Duration) {
        let mut rest = Some(work);
        while let Some(work) = rest.take().filter(|work| work.len() > 0) {
            let (count, each) = (work.len(), cost.as_nanos().max(1));
            let most = (each * count as u128 / WORTH.as_nanos()).clamp(1, count as u128) as usize;
            let need = Need {
                most,
                little: each * count as u128 <= BITE.as_nanos(),
                brief: each * count as u128 <= WORTH.as_nanos(),
                slow: each > BITE.as_nanos(),
            };
            let turn = self.acquire(&need);
            let mut bite = (BITE.as_nanos() / each).max(1) as usize;
            if turn.threads > 1 {
                // So that all of them end at about the same time.
                bite = bite.min(count.div_ceil(2 * turn.threads));
            }
            let pile = Pile::new(work, bite);
            if turn.threads == 1 {
                pile.work_off(turn);
            } else {
                self.threads.pool.install(|| pile.share_out(turn));
            }
            let (left, computed) = pile.end();
            let done = count - left.as_ref().map_or(0, W::len);
            *cost = (*cost + computed / done as u32) / 2;
            rest = left;
            if rest.is_some() {
                self.make_way();
            }
        }
    }

    /// Between two turns: lets guests go first that had less time.
    fn make_way(&self) {
        if IS_GUEST.get() {
            // It takes longer than was expected, and on a thread that is not its own.
            self.lock().dismiss();
        } else {
            self.attend(self.spent(), || true);
        }
    }

    /// Does the work of guests that had less time than `limit`, as long as there is some and
    /// `go_on` says so; returns whether there was any. The thread then owes them another look, or
    /// [`Self::retire`].
    pub(crate) fn attend(&self, limit: u64, go_on: impl Fn() -> bool) -> bool {
        let mut any = false;
        while go_on() {
            let mut turns = self.lock();
            if PROMISE.get() != Promise::None {
                turns.promise(Promise::Soon);
            }
            let Some(guest) = turns.take_up(limit) else { break };
            drop(turns);
            any = true;
            let was_guest = IS_GUEST.replace(true);
            guest.serve();
            IS_GUEST.set(was_guest);
            if guest.is_due() && !self.lock().has(&guest) {
                guest.wake();
            }
        }
        any
    }

    /// From now on this thread does the work of guests before it sleeps; it has a guest itself, which
    /// others may serve where it needs `little`.
    pub(crate) fn watch(&self, own: &Arc<dyn Guest>, little: bool) {
        let mut turns = self.lock();
        turns.promise(Promise::Soon);
        if little {
            turns.enlist(own);
        } else {
            own.disarm();
            turns.guests.retain(|guest| !Arc::ptr_eq(guest, own));
        }
    }

    /// Whether more threads are awake, this one among them, than could be used.
    pub(crate) fn is_crowded(&self) -> bool {
        let turns = self.lock();
        turns.watchers > turns.free
    }

    /// This thread is about to sleep: others look for the messages of its guest, or these wake it up.
    /// Whether any is due is to be asked afterwards.
    pub(crate) fn retire(&self, own: &Arc<dyn Guest>) {
        let mut turns = self.lock();
        turns.promise(Promise::None);
        if !turns.has(own) {
            own.arm();
        }
        turns.settle();
    }

    /// This thread ends, and its guest with it.
    pub(crate) fn leave(&self, own: &Arc<dyn Guest>) {
        let mut turns = self.lock();
        turns.promise(Promise::None);
        turns.guests.retain(|guest| !Arc::ptr_eq(guest, own));
        turns.settle();
    }

    /// CPU time that it had, ns.
    pub(super) fn spent(&self) -> u64 {
        self.spent.load(Ordering::Relaxed)
    }

    /// Whether it may have a thread more.
    pub(super) fn may_have_more(&self) -> bool {
        self.share.left() > 0
    }

    /// Waits for a thread, then takes up to as many as it needs that are idle.
    fn acquire(&self, need: &Need) -> Turn<'_> {
        let &Need { most, little, brief, slow } = need;
        let mut turns = self.lock();
        // It will not look soon.
        let busy = if PROMISE.get() == Promise::None { Promise::None } else { Promise::Later };
        let spent = self.spent.fetch_max(turns.clock, Ordering::Relaxed).max(turns.clock);
        // Whoever waits while threads are free has taken all of its share.
        let threads = turns.free.min(most).min(self.share.left());
        if threads > 0 {
            turns.free -= threads;
            turns.slow += if slow { threads } else { 0 };
            turns.clock = spent;
            self.share.taken.fetch_add(threads, Ordering::Relaxed);
            if !brief {
                turns.promise(busy);
            }
            turns.settle();
            return Turn { scheduler: self, threads, ahead: false, slow };
        }
        WAITER.with(|waiter| {
            waiter.called.store(false, Ordering::Relaxed);
            let share = Arc::clone(&self.share);
            turns.waiting.push(Waiting { waiter: Arc::clone(waiter), share, spent });
            turns.promise(busy);
            turns.settle();
            drop(turns);
            let mut ahead = false;
            while !ahead && !waiter.called.load(Ordering::Acquire) {
                if little {
                    std::thread::park_timeout(TURN);
                    ahead = self.go_ahead(waiter);
                } else {
                    std::thread::park();
                }
            }
            if slow {
                let mut turns = self.lock();
                turns.slow += 1;
                turns.settle();
            }
            Turn { scheduler: self, threads: 1, ahead, slow }
        })
    }

    /// Takes a thread more than there are, where this one is next and nobody else has done so.
    fn go_ahead(&self, waiter: &Arc<Waiter>) -> bool {
        let mut turns = self.lock();
        let Some(next) = turns.next() else { return false };
        if turns.ahead || !Arc::ptr_eq(&turns.waiting[next].waiter, waiter) {
            return false;
        }
        turns.call(next);
        turns.ahead = true;
        true
    }

    fn release(&self, turn: &Turn<'_>) {
        let mut turns = self.lock();
        self.share.taken.fetch_sub(turn.threads, Ordering::Relaxed);
        turns.slow -= if turn.slow { turn.threads } else { 0 };
        if turn.ahead {
            turns.ahead = false;
        } else {
            turns.free += turn.threads;
        }
        while turns.free > 0 {
            let Some(next) = turns.next() else { break };
            turns.free -= 1;
            let waiter = turns.call(next);
            waiter.called.store(true, Ordering::Release);
            waiter.thread.unpark();
        }
        if PROMISE.get() == Promise::Later {
            turns.promise(Promise::Soon);
        }
        turns.settle();
    }

    fn lock(&self) -> MutexGuard<'_, Turns> {
        // The guarded numbers are consistent after every statement, panic or not.
        self.threads.turns.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

thread_local! {
    /// Whether this thread does the work of a guest.
    static IS_GUEST: Cell<bool> = const { Cell::new(false) };
}

/// What somebody needs for its next turn.
#[derive(Debug, Default)]
struct Need {
    /// As many threads as are useful.
    most: usize,
    /// All of it takes no longer than a bite: it may go ahead.
    little: bool,
    /// All of it is not worth another thread.
    brief: bool,
    /// One piece takes longer than a bite.
    slow: bool,
}

/// Threads that are taken. They are given back when this is dropped, also by a panic.
pub(super) struct Turn<'a> {
    scheduler: &'a Scheduler,
    threads: usize,
    /// It is one more than there are.
    ahead: bool,
    /// Its pieces take long.
    slow: bool,
}

impl Turn<'_> {
    /// One of its threads has computed for so many ns, in that time.
    pub(super) fn charge(&self, computed: u64, taken: Duration) {
        self.scheduler.spent.fetch_add(computed, Ordering::Relaxed);
        self.scheduler.threads.busy.fetch_add(taken.as_nanos() as u64, Ordering::Relaxed);
    }

    /// Half of the threads, where there are several.
    pub(super) fn split_off(&mut self) -> Option<Self> {
        let half = self.threads / 2;
        self.threads -= half;
        (half > 0).then_some(Self { threads: half, ..*self })
    }
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.scheduler.release(self);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, AtomicUsize};

    use super::super::pile::cpu_time;
    use super::*;

    struct Count<'a> {
        cells: &'a mut [u32],
        running: &'a AtomicUsize,
        most: &'a AtomicUsize,
    }

    impl Divisible for Count<'_> {
        fn len(&self) -> usize {
            self.cells.len()
        }

        fn split_at(self, at: usize) -> (Self, Self) {
            let (first, second) = self.cells.split_at_mut(at);
            let Self { running, most, .. } = self;
            (Self { cells: first, running, most }, Self { cells: second, running, most })
        }

        fn run(self) {
            let running = self.running.fetch_add(1, Ordering::SeqCst) + 1;
            self.most.fetch_max(running, Ordering::SeqCst);
            for cell in self.cells {
                *cell += 1;
                std::thread::yield_now();
            }
            self.running.fetch_sub(1, Ordering::SeqCst);
        }
    }

    struct Panic(usize);

    impl Divisible for Panic {
        fn len(&self) -> usize {
            self.0
        }

        fn split_at(self, at: usize) -> (Self, Self) {
            (Self(at), Self(self.0 - at))
        }

        fn run(self) {
            panic!("work that fails");
        }
    }

    #[test]
    fn work_that_panics_gives_its_threads_back() {
        let scheduler = Scheduler::new(2).unwrap();
        for pieces in [1, 8] {
            let work = || scheduler.run(Panic(pieces), &mut Duration::from_micros(100));
            assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).is_err());
            assert_eq!(scheduler.lock().free, 2);
        }
    }

    #[test]
    fn who_had_the_threads_for_less_time_comes_first_and_idle_time_saves_nothing_up() {
        let scheduler = Scheduler::new(1).unwrap();
        let [heavy, light, idle] = [30, 20, 0].map(|spent| {
            let user = scheduler.separate();
            user.spent.store(spent, Ordering::Relaxed);
            user
        });
        let running = scheduler.separate();
        running.spent.store(10, Ordering::Relaxed);
        let turn = running.acquire(&Need { most: 1, ..Need::default() });
        let order = Mutex::new(vec![]);
        std::thread::scope(|scope| {
            for (count, (user, name)) in
                [(&heavy, "heavy"), (&light, "light"), (&idle, "idle")].into_iter().enumerate()
            {
                let order = &order;
                scope.spawn(move || {
                    let turn = user.acquire(&Need { most: 1, ..Need::default() });
                    order.lock().unwrap().push(name);
                    drop(turn);
                });
                while scheduler.lock().waiting.len() <= count {
                    std::thread::yield_now();
                }
            }
            drop(turn);
        });
        assert_eq!(*order.lock().unwrap(), ["idle", "light", "heavy"]);
        assert_eq!(idle.spent.load(Ordering::Relaxed), 10);
        assert_eq!(scheduler.lock().clock, 30);
    }

    #[test]
    fn who_needs_little_does_not_wait_for_the_end_of_a_long_turn() {
        let scheduler = Scheduler::new(1).unwrap();
        let [long, small, large] = [(); 3].map(|()| scheduler.separate());
        large.spent.store(10, Ordering::Relaxed);
        let quota = scheduler.limited(1);
        let turn = long.acquire(&Need { most: 1, ..Need::default() });
        let state = || {
            let turns = scheduler.lock();
            (turns.free, turns.ahead, turns.waiting.len())
        };
        assert_eq!(state(), (0, false, 0));
        let one = small.acquire(&Need { most: 1, little: true, ..Need::default() });
        assert_eq!((one.ahead, state()), (true, (0, true, 0)));
        drop(one);
        assert_eq!(state(), (0, false, 0));
        // Nor does it help to have many: one goes ahead at a time, and nobody beyond its share.
        let (one, other) =
            (quota.acquire(&Need { most: 1, little: true, ..Need::default() }), quota.separate());
        std::thread::scope(|scope| {
            let later = scope
                .spawn(|| drop(other.acquire(&Need { most: 1, little: true, ..Need::default() })));
            let large = scope.spawn(|| large.acquire(&Need { most: 1, ..Need::default() }).ahead);
            while state().2 < 2 {
                std::thread::yield_now();
            }
            std::thread::sleep(4 * TURN);
            assert_eq!(state(), (0, true, 2));
            drop(one);
            later.join().unwrap();
            assert_eq!(state(), (0, false, 1));
            drop(turn);
            assert!(!large.join().unwrap());
        });
        assert_eq!(state(), (1, false, 0));
        assert_eq!((quota.share.left(), scheduler.share.left()), (1, usize::MAX));
    }

    /// A guest whose messages are counted.
    struct Visitor {
        scheduler: Scheduler,
        name: &'static str,
        messages: AtomicUsize,
        armed: AtomicBool,
        woken: AtomicUsize,
        /// Who was served, in order.
        served: Arc<Mutex<Vec<&'static str>>>,
    }

    impl Visitor {
        fn new(scheduler: &Scheduler, name: &'static str, served: &Served) -> Arc<Self> {
            Arc::new(Self {
                scheduler: scheduler.separate(),
                name,
                messages: AtomicUsize::new(0),
                armed: AtomicBool::new(true),
                woken: AtomicUsize::new(0),
                served: Arc::clone(served),
            })
        }

        fn is_armed(&self) -> bool {
            self.armed.load(Ordering::SeqCst)
        }
    }

    type Served = Arc<Mutex<Vec<&'static str>>>;

    impl Guest for Visitor {
        fn scheduler(&self) -> &Scheduler {
            &self.scheduler
        }

        fn is_due(&self) -> bool {
            self.messages.load(Ordering::SeqCst) > 0
        }

        fn claim(&self) -> bool {
            true
        }

        fn serve(&self) {
            self.messages.fetch_sub(1, Ordering::SeqCst);
            drop(self.scheduler.acquire(&Need { most: 1, ..Need::default() }));
            self.served.lock().unwrap().push(self.name);
        }

        fn arm(&self) {
            self.armed.store(true, Ordering::SeqCst);
        }

        fn disarm(&self) {
            self.armed.store(false, Ordering::SeqCst);
        }

        fn wake(&self) {
            self.woken.fetch_add(1, Ordering::SeqCst);
        }
    }

    #[test]
    fn guests_are_left_asleep_only_while_somebody_will_look_for_their_messages() {
        let scheduler = Scheduler::new(1).unwrap();
        let served = Served::default();
        let [own, other] = ["own", "other"].map(|name| Visitor::new(&scheduler, name, &served));
        let dynamic = |visitor: &Arc<Visitor>| -> Arc<dyn Guest> { Arc::<Visitor>::clone(visitor) };
        // On a thread of its own, since it has a promise of its own.
        let retire = |visitor: &Arc<Visitor>| {
            std::thread::scope(|scope| {
                scope.spawn(|| {
                    scheduler.watch(&dynamic(visitor), true);
                    scheduler.retire(&dynamic(visitor));
                });
            });
        };
        retire(&other);
        assert!(other.is_armed());
        // While this thread is awake, it looks: in order of the time that they had.
        scheduler.watch(&dynamic(&own), true);
        retire(&other);
        assert!(!own.is_armed() && !other.is_armed());
        own.scheduler.spent.store(5, Ordering::Relaxed);
        own.messages.store(1, Ordering::SeqCst);
        other.messages.store(1, Ordering::SeqCst);
        assert!(!scheduler.attend(0, || false));
        assert!(scheduler.attend(u64::MAX, || true));
        assert_eq!(*served.lock().unwrap(), ["other", "own"]);
        // It will not look soon: others do it, whose turn ends, unless that takes long, too.
        let need = |slow| Need { most: 1, slow, ..Need::default() };
        drop(scheduler.acquire(&need(false)));
        assert!(!other.is_armed());
        other.messages.store(1, Ordering::SeqCst);
        let turn = scheduler.acquire(&need(true));
        assert!(other.is_armed() && own.is_armed());
        assert_eq!(other.woken.load(Ordering::SeqCst), 1);
        assert!(!scheduler.attend(u64::MAX, || true));
        drop(turn);
        // Nor does it when it sleeps.
        scheduler.watch(&dynamic(&own), true);
        retire(&other);
        assert!(!other.is_armed());
        scheduler.retire(&dynamic(&own));
        assert!(other.is_armed() && own.is_armed());
        assert_eq!(other.woken.load(Ordering::SeqCst), 2);
        assert_eq!(own.woken.load(Ordering::SeqCst), 0);
        let turns = scheduler.lock();
        assert_eq!((turns.watchers, turns.slow, turns.free, turns.guests.len()), (0, 0, 1, 0));
    }

    #[test]
    fn guests_that_had_less_time_go_between_two_turns() {
        let scheduler = Scheduler::new(1).unwrap();
        let served = Served::default();
        let guest = Visitor::new(&scheduler, "guest", &served);
        let dynamic: Arc<dyn Guest> = Arc::<Visitor>::clone(&guest);
        let long = scheduler.separate();
        scheduler.watch(&dynamic, true);
        guest.messages.store(1, Ordering::SeqCst);
        let (running, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let mut cells = vec![0; 1000];
        let work = Count { cells: &mut cells, running: &running, most: &most };
        // Pieces are taken up one by one, and take longer than was expected: each is a turn.
        long.run(Slow(work), &mut Duration::from_micros(150));
        assert_eq!(*served.lock().unwrap(), ["guest"]);
        assert!(cells.iter().all(|cell| *cell == 1));
        scheduler.leave(&dynamic);
    }

    /// Work of which a piece takes a whole turn.
    struct Slow<'a>(Count<'a>);

    impl Divisible for Slow<'_> {
        fn len(&self) -> usize {
            self.0.len().div_ceil(500)
        }

        fn split_at(self, at: usize) -> (Self, Self) {
            let (first, second) = self.0.split_at(at * 500);
            (Self(first), Self(second))
        }

        fn run(self) {
            self.0.run();
            let start = cpu_time();
            while cpu_time().saturating_sub(start) < 2 * TURN {}
        }
    }

    #[test]
    fn a_share_is_not_exceeded_and_the_rest_is_for_others() {
        let scheduler = Scheduler::new(3).unwrap();
        let small = scheduler.limited(1);
        let (running, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let (free, most_free) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let mut cells = vec![vec![0; 129]; 4];
        let mut others = vec![vec![0; 129]; 4];
        std::thread::scope(|scope| {
            for cells in &mut cells {
                let (small, running, most) = (small.clone(), &running, &most);
                scope.spawn(move || {
                    let mut cost = Duration::from_micros(100);
                    small.run(Count { cells, running, most }, &mut cost);
                });
            }
            for cells in &mut others {
                let (scheduler, free, most_free) = (&scheduler, &free, &most_free);
                scope.spawn(move || {
                    let mut cost = Duration::from_micros(100);
                    scheduler.run(Count { cells, running: free, most: most_free }, &mut cost);
                });
            }
        });
        assert!(cells.iter().chain(&others).flatten().all(|cell| *cell == 1));
        assert_eq!(most.into_inner(), 1);
        assert!(most_free.into_inner() <= 4);
        assert_eq!(scheduler.lock().free, 3);
        assert_eq!((small.share.left(), scheduler.share.left()), (1, usize::MAX));
        assert!(scheduler.busy() > Duration::ZERO);
    }

    #[test]
    fn every_piece_is_done_once_and_on_at_most_one_thread_more_than_there_are() {
        for threads in [1, 2, 3] {
            let scheduler = Scheduler::new(threads).unwrap();
            let (running, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
            let mut cells = vec![vec![0; 257]; 8];
            std::thread::scope(|scope| {
                for cells in &mut cells {
                    let (scheduler, running, most) = (&scheduler, &running, &most);
                    scope.spawn(move || {
                        let mut cost = Duration::from_micros(100);
                        for _ in 0..20 {
                            scheduler.run(Count { cells, running, most }, &mut cost);
                        }
                    });
                }
            });
            assert!(cells.iter().flatten().all(|cell| *cell == 20));
            assert!(most.into_inner() <= threads + 1);
            assert_eq!(scheduler.lock().free, threads);
        }
    }
}
