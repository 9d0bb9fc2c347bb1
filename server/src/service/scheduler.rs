//! Turns: which session's environments run on which threads.
//!
//! A session asks for a turn, runs a slice of its environments for about a millisecond, and asks
//! again. The next turn is for whoever has had the threads for the least time, and idle time saves
//! nothing up (start-time fair queueing, Goyal et al. 1996). So sessions share the threads evenly
//! whatever their size, and one that needs less than its share hardly waits. A session that finds idle
//! threads uses them too. None of this changes any result.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::Thread;
use std::time::{Duration, Instant};

/// How long a session may keep a thread while others wait.
const TURN: Duration = Duration::from_millis(1);

/// Work that is worth another thread: waking one up costs about half of it.
const WORTH: Duration = Duration::from_micros(50);

/// Work that can be cut in two anywhere.
pub(crate) trait Divisible: Send + Sized {
    /// How many pieces there are.
    fn len(&self) -> usize;
    /// The first `at` pieces, and the rest.
    fn split_at(self, at: usize) -> (Self, Self);
    /// Does the work.
    fn run(self);
}

/// The threads that step environments, and how many of them its user may have at a time. Clones
/// have that share together, and their time counts together.
#[derive(Debug, Clone)]
pub(crate) struct Scheduler {
    threads: Arc<Threads>,
    share: Arc<Share>,
    /// Time for which threads were taken, on the clock of [`Turns`], ns.
    spent: Arc<AtomicU64>,
}

#[derive(Debug)]
struct Threads {
    pool: rayon::ThreadPool,
    turns: Mutex<Turns>,
    /// Time for which threads were taken, all together, ns.
    busy: AtomicU64,
}

#[derive(Debug)]
struct Turns {
    free: usize,
    /// In order of arrival.
    waiting: Vec<Waiting>,
    /// What the one who had the latest turn had spent before it, ns.
    clock: u64,
}

/// How many threads somebody may have, and has. Read and written under the lock of [`Turns`].
#[derive(Debug)]
struct Share {
    limit: usize,
    taken: AtomicUsize,
}

impl Share {
    fn new(limit: usize) -> Arc<Self> {
        Arc::new(Self { limit, taken: AtomicUsize::new(0) })
    }

    fn left(&self) -> usize {
        self.limit.saturating_sub(self.taken.load(Ordering::Relaxed))
    }
}

/// Somebody who waits for a turn.
#[derive(Debug)]
struct Waiting {
    waiter: Arc<Waiter>,
    share: Arc<Share>,
    spent: u64,
}

#[derive(Debug)]
struct Waiter {
    thread: Thread,
    called: AtomicBool,
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
        let turns = Mutex::new(Turns { free: threads, waiting: vec![], clock: 0 });
        let threads = Threads { pool, turns, busy: AtomicU64::new(0) };
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
        let mut rest = work;
        while rest.len() > 0 {
            let expected = cost.as_nanos().max(1) * rest.len() as u128;
            let most = (expected / WORTH.as_nanos()).clamp(1, rest.len() as u128) as usize;
            let turn = self.acquire(most);
            let threads = turn.threads;
            let slice = (TURN.as_nanos() / cost.as_nanos().max(1)).max(1) as usize;
            let count = slice.saturating_mul(threads).min(rest.len());
            let (now, later) = rest.split_at(count);
            rest = later;
            let start = Instant::now();
            if threads == 1 {
                now.run();
            } else {
                self.threads.pool.install(|| run_on(now, threads));
            }
            let taken = start.elapsed() * threads as u32;
            self.threads.busy.fetch_add(taken.as_nanos() as u64, Ordering::Relaxed);
            self.spent.fetch_add(taken.as_nanos() as u64, Ordering::Relaxed);
            let measured = taken / count as u32;
            *cost = (*cost + measured) / 2;
        }
    }

    /// Whether every thread is taken.
    pub(crate) fn is_busy(&self) -> bool {
        self.lock().free == 0
    }

    /// Waits for a thread, then takes up to `most` that are idle.
    fn acquire(&self, most: usize) -> Turn<'_> {
        let mut turns = self.lock();
        let spent = self.spent.fetch_max(turns.clock, Ordering::Relaxed).max(turns.clock);
        // Whoever waits while threads are free has taken all of its share.
        let threads = turns.free.min(most).min(self.share.left());
        if threads == 0 {
            WAITER.with(|waiter| {
                waiter.called.store(false, Ordering::Relaxed);
                let (waiter, share) = (Arc::clone(waiter), Arc::clone(&self.share));
                turns.waiting.push(Waiting { waiter, share, spent });
                drop(turns);
            });
            WAITER.with(|waiter| {
                while !waiter.called.load(Ordering::Acquire) {
                    std::thread::park();
                }
            });
            return Turn { scheduler: self, threads: 1 };
        }
        turns.free -= threads;
        turns.clock = spent;
        self.share.taken.fetch_add(threads, Ordering::Relaxed);
        Turn { scheduler: self, threads }
    }

    fn release(&self, count: usize) {
        let mut turns = self.lock();
        turns.free += count;
        self.share.taken.fetch_sub(count, Ordering::Relaxed);
        while turns.free > 0 {
            let waiting = turns.waiting.iter().enumerate();
            let may_run = waiting.filter(|(_, each)| each.share.left() > 0);
            let Some((next, _)) = may_run.min_by_key(|(_, each)| each.spent) else { break };
            let Waiting { waiter, share, spent } = turns.waiting.remove(next);
            turns.free -= 1;
            turns.clock = turns.clock.max(spent);
            share.taken.fetch_add(1, Ordering::Relaxed);
            waiter.called.store(true, Ordering::Release);
            waiter.thread.unpark();
        }
    }

    fn lock(&self) -> MutexGuard<'_, Turns> {
        // The guarded numbers are consistent after every statement, panic or not.
        self.threads.turns.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Threads that are taken. They are given back when this is dropped, also by a panic.
struct Turn<'a> {
    scheduler: &'a Scheduler,
    threads: usize,
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.scheduler.release(self.threads);
    }
}

/// Runs `work` on about `threads` threads of the current pool.
fn run_on<W: Divisible>(work: W, threads: usize) {
    let count = work.len();
    if threads <= 1 || count <= 1 {
        return work.run();
    }
    let left = threads / 2;
    let (first, second) = work.split_at(count * left / threads);
    rayon::join(|| run_on(first, left), || run_on(second, threads - left));
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
        let turn = running.acquire(1);
        let order = Mutex::new(vec![]);
        std::thread::scope(|scope| {
            for (count, (user, name)) in
                [(&heavy, "heavy"), (&light, "light"), (&idle, "idle")].into_iter().enumerate()
            {
                let order = &order;
                scope.spawn(move || {
                    let turn = user.acquire(1);
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
        assert!(most_free.into_inner() <= 3);
        assert_eq!(scheduler.lock().free, 3);
        assert_eq!((small.share.left(), scheduler.share.left()), (1, usize::MAX));
        assert!(scheduler.busy() > Duration::ZERO);
    }

    #[test]
    fn every_piece_is_done_once_and_never_on_more_threads_than_allowed() {
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
            assert!(most.into_inner() <= threads);
            assert_eq!(scheduler.lock().free, threads);
        }
    }
}
