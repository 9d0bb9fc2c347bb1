//! Turns: which session's environments run on which threads.
//!
//! A session asks for a turn, runs a slice of its environments for about a millisecond, and asks
//! again. Turns go in order of arrival, so sessions share the threads evenly whatever their size;
//! a session that finds idle threads uses them too. None of this changes any result.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
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

/// The threads that step environments, and who may use them.
#[derive(Debug)]
pub(crate) struct Scheduler {
    pool: rayon::ThreadPool,
    turns: Mutex<Turns>,
}

#[derive(Debug)]
struct Turns {
    free: usize,
    waiting: VecDeque<Arc<Waiter>>,
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
        let turns = Mutex::new(Turns { free: threads, waiting: VecDeque::new() });
        Ok(Self { pool, turns })
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
                self.pool.install(|| run_on(now, threads));
            }
            let measured = start.elapsed() * threads as u32 / count as u32;
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
        if turns.free == 0 || !turns.waiting.is_empty() {
            WAITER.with(|waiter| {
                waiter.called.store(false, Ordering::Relaxed);
                turns.waiting.push_back(Arc::clone(waiter));
                drop(turns);
                while !waiter.called.load(Ordering::Acquire) {
                    std::thread::park();
                }
            });
            return Turn { scheduler: self, threads: 1 };
        }
        let threads = turns.free.min(most);
        turns.free -= threads;
        Turn { scheduler: self, threads }
    }

    fn release(&self, count: usize) {
        let mut turns = self.lock();
        for _ in 0..count {
            if let Some(waiter) = turns.waiting.pop_front() {
                waiter.called.store(true, Ordering::Release);
                waiter.thread.unpark();
            } else {
                turns.free += 1;
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, Turns> {
        // The guarded numbers are consistent after every statement, panic or not.
        self.turns.lock().unwrap_or_else(PoisonError::into_inner)
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
