//! Turns: which session's environments run on which threads.
//!
//! A session asks for a turn, runs its environments bite by bite for about two milliseconds, and asks
//! again if somebody else waits. The next turn is for whoever has had the threads for the least time,
//! and idle time saves nothing up (start-time fair queueing, Goyal et al. 1996). So sessions share the
//! threads evenly whatever their size, and one that needs less than its share hardly waits. A session
//! that finds idle threads uses them too.
//!
//! Who waits for a turn is in the queue of `turns.rs`; so are sessions that sleep until their client rings, while
//! all threads are taken (`seat.rs`).
//!
//! A turn can last much longer: one environment's step may take milliseconds, and the kernel may give
//! the processor to others meanwhile. Whoever is next and needs little does not wait for its end but
//! goes ahead, on one thread more, one at a time: at once where every thread has somebody who needs more,
//! else after a millisecond, or as many as there were others before it when it looked last. None of this
//! changes any result.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::pile::{Divisible, MOST_LONG, Pile};
use super::turns::{Grant, Share, Turns, User, Waiter};
use crate::clock::thread_time;

/// How long a session may keep a thread while others wait, and one bite more. With half of it, 64 clients of
/// 16 NeedlePick environments on one core had 0.92 of the rate (seven alternating pairs), with twice as
/// much 0.97 (five).
const TURN: Duration = Duration::from_millis(2);

/// How long whoever needs little and is next waits for others that do before it goes ahead. Who is not next
/// looks again after as much for each who is before it: if all did so every millisecond, 64 clients would have the
/// kernel change threads 14,000 times a second.
const PATIENCE: Duration = Duration::from_millis(1);

/// Work that is taken up at once.
const BITE: Duration = Duration::from_micros(200);

/// Work that is worth another thread: waking one up costs about half of it.
const WORTH: Duration = Duration::from_micros(50);

/// The threads that step environments, and how many of them its user may have at a time. Clones
/// have that share together, and their time counts together.
#[derive(Debug, Clone)]
pub(crate) struct Scheduler {
    threads: Arc<Threads>,
    pub(super) user: Arc<User>,
}

#[derive(Debug)]
struct Threads {
    count: usize,
    pool: rayon::ThreadPool,
    turns: Mutex<Turns>,
    /// Time for which threads were taken, all together, ns.
    busy: AtomicU64,
}

thread_local! {
    /// This thread, which waits for one turn at a time.
    static WAITER: Arc<Waiter> =
        Arc::new(Waiter { thread: std::thread::current(), called: AtomicBool::new(false) });
}

impl Scheduler {
    /// A scheduler of `threads` threads.
    pub(crate) fn new(threads: usize) -> Result<Self, rayon::ThreadPoolBuildError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|index| format!("trocar-step-{index}"))
            .build()?;
        let turns = Mutex::new(Turns::new(threads));
        let threads = Threads { count: threads, pool, turns, busy: AtomicU64::new(0) };
        Ok(Self { threads: Arc::new(threads), user: User::new(Share::new(usize::MAX)) })
    }

    /// The same threads, of which this one and its clones may have at most `limit` at a time.
    pub(crate) fn limited(&self, limit: usize) -> Self {
        Self { threads: Arc::clone(&self.threads), user: User::new(Share::new(limit)) }
    }

    /// The same threads and share, for somebody whose time counts separately.
    pub(crate) fn separate(&self) -> Self {
        let user = User::new(Arc::clone(&self.user.share));
        Self { threads: Arc::clone(&self.threads), user }
    }

    /// Time for which threads were taken, all together.
    pub(crate) fn busy(&self) -> Duration {
        Duration::from_nanos(self.threads.busy.load(Ordering::Relaxed))
    }

    /// Does `work`, turn by turn. `cost` is the time one piece is expected to take; it is updated
    /// by what was measured.
    pub(crate) fn run<W: Divisible>(&self, work: W, cost: &mut Duration) {
        if work.first_long().is_some() {
            self.work_through::<W, MOST_LONG>(work, cost);
        } else {
            self.work_through::<W, 0>(work, cost);
        }
    }

    fn work_through<W: Divisible, const LONG: usize>(&self, work: W, cost: &mut Duration) {
        let count = work.len();
        let each = cost.as_nanos().max(1);
        let pile = Pile::<W, LONG>::new(work, (BITE.as_nanos() / each) as usize);
        loop {
            let left = pile.len();
            if left == 0 {
                break;
            }
            let most = (each * left as u128 / WORTH.as_nanos()).clamp(1, left as u128) as usize;
            let turn = self.acquire(most, is_little(*cost, left));
            pile.expect(turn.grant.threads);
            if turn.grant.threads == 1 {
                turn.work_off(&pile);
            } else {
                self.threads.pool.install(|| turn.share_out(&pile));
            }
        }
        if count > 0 {
            *cost = (*cost + pile.computed() / count as u32) / 2;
        }
    }

    /// Whether there are several threads.
    pub(crate) fn is_parallel(&self) -> bool {
        self.threads.count > 1
    }

    /// Whether every thread is taken.
    pub(crate) fn is_busy(&self) -> bool {
        self.lock().is_busy()
    }

    /// Waits for a thread, then takes up to `most` that are idle. Who needs `little` may go ahead.
    fn acquire(&self, most: usize, little: bool) -> Turn<'_> {
        let mut turns = self.lock();
        if let Some(grant) = turns.take(&self.user, most, little) {
            return Turn { scheduler: self, grant };
        }
        WAITER.with(|waiter| {
            waiter.called.store(false, Ordering::Relaxed);
            let mut ahead = turns.queue(&self.user, waiter, little);
            let mut before = if little { turns.before(waiter) } else { 0 };
            drop(turns);
            while !ahead && !waiter.called.load(Ordering::Acquire) {
                if little {
                    std::thread::park_timeout(PATIENCE * before.max(1) as u32);
                    let mut turns = self.lock();
                    ahead = turns.go_ahead(waiter);
                    before = turns.before(waiter);
                } else {
                    std::thread::park();
                }
            }
            Turn { scheduler: self, grant: Grant { threads: 1, little, ahead } }
        })
    }

    /// Threads get free as `how` says, and go to those who are next. They are woken up with the lock released:
    /// on the same processor they may run at once, and would only find it taken.
    pub(super) fn free(&self, how: impl FnOnce(&mut Turns)) {
        let mut turns = self.lock();
        how(&mut turns);
        while let Some(called) = turns.pass_on() {
            drop(turns);
            called.wake();
            turns = self.lock();
        }
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Turns> {
        // The guarded numbers are consistent after every statement, panic or not.
        self.threads.turns.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Whether `count` pieces that take `cost` each are little work.
pub(super) fn is_little(cost: Duration, count: usize) -> bool {
    cost.as_nanos().max(1) * count as u128 <= BITE.as_nanos()
}

/// Threads that are taken. They are given back when this is dropped, also by a panic.
struct Turn<'a> {
    scheduler: &'a Scheduler,
    grant: Grant,
}

impl Turn<'_> {
    /// Half of the threads, where there are several.
    fn split_off(&mut self) -> Option<Self> {
        let half = self.grant.threads / 2;
        self.grant.threads -= half;
        let grant = Grant { threads: half, ..self.grant };
        (half > 0).then_some(Self { grant, ..*self })
    }

    /// Works on all of its threads, which the current pool has. Each is given back by itself: others
    /// need not wait for the last one.
    fn share_out<W: Divisible, const LONG: usize>(mut self, pile: &Pile<W, LONG>) {
        match self.split_off() {
            Some(half) => {
                rayon::join(|| self.share_out(pile), || half.share_out(pile));
            }
            None => self.work_off(pile),
        }
    }

    /// Works on this thread, which is its only one. It gets at least one bite done.
    fn work_off<W: Divisible, const LONG: usize>(self, pile: &Pile<W, LONG>) {
        let mut watch = Watch::start();
        while let Some(work) = pile.take() {
            work.run();
            if watch.start.elapsed() >= TURN {
                self.charge(pile, &watch);
                watch = Watch::start();
                if !self.scheduler.lock().renew(&self.scheduler.user, self.grant) {
                    break;
                }
            }
        }
        self.charge(pile, &watch);
    }

    /// Takes note of the time that it took. Nobody is charged for that in which the kernel lets others
    /// have the processor.
    fn charge<W: Divisible, const LONG: usize>(&self, pile: &Pile<W, LONG>, watch: &Watch) {
        let computed = thread_time().saturating_sub(watch.computed).as_nanos() as u64;
        pile.charge(computed);
        self.scheduler.user.spent.fetch_add(computed, Ordering::Relaxed);
        let taken = watch.start.elapsed().as_nanos() as u64;
        self.scheduler.threads.busy.fetch_add(taken, Ordering::Relaxed);
    }
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.scheduler.free(|turns| turns.give_back(&self.scheduler.user, self.grant));
    }
}

/// When a thread began to work.
struct Watch {
    start: Instant,
    computed: Duration,
}

impl Watch {
    fn start() -> Self {
        Self { start: Instant::now(), computed: thread_time() }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicUsize;

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
            let turns = scheduler.lock();
            assert_eq!((turns.free, turns.long), (2, 0));
        }
    }

    #[test]
    fn who_had_the_threads_for_less_time_comes_first_and_idle_time_saves_nothing_up() {
        let scheduler = Scheduler::new(1).unwrap();
        let [heavy, light, idle] = [30, 20, 0].map(|spent| {
            let user = scheduler.separate();
            user.user.spent.store(spent, Ordering::Relaxed);
            user
        });
        let running = scheduler.separate();
        running.user.spent.store(10, Ordering::Relaxed);
        let turn = running.acquire(1, false);
        let order = Mutex::new(vec![]);
        std::thread::scope(|scope| {
            for (count, (user, name)) in
                [(&heavy, "heavy"), (&light, "light"), (&idle, "idle")].into_iter().enumerate()
            {
                let order = &order;
                scope.spawn(move || {
                    let turn = user.acquire(1, false);
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
        assert_eq!(idle.user.spent.load(Ordering::Relaxed), 10);
        assert_eq!(scheduler.lock().clock, 30);
    }

    #[test]
    fn a_queue_of_small_ones_goes_ahead_of_a_long_turn_whoever_has_computed_least_first() {
        let scheduler = Scheduler::new(1).unwrap();
        let [long, first] = [(); 2].map(|()| scheduler.separate());
        let turn = long.acquire(1, false);
        // They arrive from the last to the first, and two have computed as much.
        let spent = [40, 30, 30, 20, 10];
        let done = Mutex::new(vec![]);
        std::thread::scope(|scope| {
            let block = first.acquire(1, true);
            for (index, spent) in spent.into_iter().enumerate() {
                let small = scheduler.separate();
                small.user.spent.store(spent, Ordering::Relaxed);
                let done = &done;
                scope.spawn(move || {
                    let turn = small.acquire(1, true);
                    done.lock().unwrap().push((spent, index, turn.grant.ahead));
                });
                while scheduler.lock().waiting.len() <= index {
                    std::thread::yield_now();
                }
            }
            drop(block);
        });
        let done = done.into_inner().unwrap();
        assert_eq!(
            done,
            [(10, 4, true), (20, 3, true), (30, 1, true), (30, 2, true), (40, 0, true)]
        );
        drop(turn);
        assert_eq!(scheduler.lock().free, 1);
    }

    #[test]
    fn who_needs_little_does_not_wait_for_the_end_of_a_long_turn() {
        let scheduler = Scheduler::new(1).unwrap();
        let [long, small, large] = [(); 3].map(|()| scheduler.separate());
        large.user.spent.store(10, Ordering::Relaxed);
        let quota = scheduler.limited(1);
        let turn = long.acquire(1, false);
        let state = || {
            let turns = scheduler.lock();
            (turns.free, turns.long, turns.ahead, turns.waiting.len())
        };
        assert_eq!(state(), (0, 1, false, 0));
        let one = small.acquire(1, true);
        assert_eq!((one.grant.ahead, state()), (true, (0, 1, true, 0)));
        drop(one);
        assert_eq!(state(), (0, 1, false, 0));
        // Nor does it help to have many: one goes ahead at a time, and nobody beyond its share.
        let (one, other) = (quota.acquire(1, true), quota.separate());
        std::thread::scope(|scope| {
            let later = scope.spawn(|| drop(other.acquire(1, true)));
            let large = scope.spawn(|| large.acquire(1, false).grant.ahead);
            while state().3 < 2 {
                std::thread::yield_now();
            }
            std::thread::sleep(4 * TURN);
            assert_eq!(state(), (0, 1, true, 2));
            drop(one);
            later.join().unwrap();
            assert_eq!(state(), (0, 1, false, 1));
            drop(turn);
            assert!(!large.join().unwrap());
        });
        assert_eq!(state(), (1, 0, false, 0));
        assert_eq!((quota.user.share.left(), scheduler.user.share.left()), (1, usize::MAX));
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
        assert_eq!((small.user.share.left(), scheduler.user.share.left()), (1, usize::MAX));
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
