//! Work that the threads of a turn take up bite by bite.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};

use super::scheduler::{TURN, Turn};

/// Work that can be cut in two anywhere.
pub(crate) trait Divisible: Send + Sized {
    /// How many pieces there are.
    fn len(&self) -> usize;
    /// The first `at` pieces, and the rest.
    fn split_at(self, at: usize) -> (Self, Self);
    /// Does the work.
    fn run(self);
}

/// Work from which the threads of one turn take bite by bite until it is done, or the turn is over.
/// What a piece takes varies a lot, so only the clock tells when that is.
pub(super) struct Pile<W> {
    rest: Mutex<Option<W>>,
    /// How many pieces are taken at once.
    bite: usize,
    over: Instant,
    /// A turn gets at least one bite done.
    begun: AtomicBool,
    /// CPU time of all threads together, ns.
    computed: AtomicU64,
}

impl<W: Divisible> Pile<W> {
    pub(super) fn new(work: W, bite: usize) -> Self {
        let (rest, over) = (Mutex::new(Some(work)), Instant::now() + TURN);
        Self { rest, bite, over, begun: AtomicBool::new(false), computed: AtomicU64::new(0) }
    }

    /// Works on all threads of the turn, which the current pool has. Each is given back by itself:
    /// others need not wait for the last one.
    pub(super) fn share_out(&self, mut turn: Turn<'_>) {
        match turn.split_off() {
            Some(half) => {
                rayon::join(|| self.share_out(turn), || self.share_out(half));
            }
            None => self.work_off(turn),
        }
    }

    /// Works on this thread, which is the only one of the turn.
    pub(super) fn work_off(&self, turn: Turn<'_>) {
        let (start, computed) = (Instant::now(), cpu_time());
        while let Some(work) = self.take() {
            work.run();
        }
        // Nobody is charged for the time in which the kernel lets others have the processor.
        let computed = cpu_time().saturating_sub(computed).as_nanos() as u64;
        self.computed.fetch_add(computed, Ordering::Relaxed);
        turn.charge(computed, start.elapsed());
        drop(turn); // others may have the thread
    }

    /// The next bite, if there is one and still time for it.
    fn take(&self) -> Option<W> {
        if self.begun.swap(true, Ordering::Relaxed) && Instant::now() >= self.over {
            return None;
        }
        let mut rest = self.rest.lock().unwrap_or_else(PoisonError::into_inner);
        let work = rest.take()?;
        let bite = self.bite.min(work.len());
        let (now, left) = work.split_at(bite);
        *rest = Some(left).filter(|left| left.len() > 0);
        Some(now)
    }

    /// What was not done, and the CPU time that the rest took.
    pub(super) fn end(self) -> (Option<W>, Duration) {
        let rest = self.rest.into_inner().unwrap_or_else(PoisonError::into_inner);
        (rest, Duration::from_nanos(self.computed.into_inner()))
    }
}

/// CPU time of this thread since some moment.
pub(super) fn cpu_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec.cast_unsigned(), time.tv_nsec as u32)
}
