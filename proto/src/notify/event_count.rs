//! An event count: a sleeper waits for a count to move on. Producers call the kernel only where the sleeper sleeps.

use std::sync::atomic::Ordering;
use std::time::Duration;

use super::futex::WaitOutcome;
use super::platform::{FutexWord, Platform};

/// The words of an event count with one sleeper; zeros at first.
#[derive(Debug)]
#[repr(C, align(128))] // nothing that others write to lies beside it
pub struct EventCount<P: Platform> {
    count: P::Futex,
    /// Not 0 where the sleeper sleeps, or is about to.
    asleep: P::Futex,
}

impl<P: Platform> Default for EventCount<P> {
    fn default() -> Self {
        Self { count: P::Futex::default(), asleep: P::Futex::default() }
    }
}

impl<P: Platform> EventCount<P> {
    /// How many events there were, modulo 2³².
    pub fn count(&self) -> u32 {
        self.count.load(Ordering::Acquire)
    }

    /// Counts an event. True where the sleeper has to be [woken up](Self::wake).
    #[must_use = "a sleeper that is not woken up sleeps on"]
    pub fn signal(&self) -> bool {
        self.count.increment(Ordering::Release);
        P::fence();
        self.asleep.load(Ordering::Relaxed) != 0
    }

    /// Wakes the sleeper up.
    pub fn wake(&self) {
        self.count.wake(1);
    }

    /// Sleeps until there were more events than `seen`, at most for `limit`.
    pub fn wait(&self, seen: u32, limit: Duration) -> WaitOutcome {
        self.asleep.store(1, Ordering::Relaxed);
        P::fence();
        let moved = self.count.load(Ordering::Acquire) != seen;
        let outcome = if moved { WaitOutcome::Woken } else { self.count.wait(seen, limit) };
        self.asleep.store(0, Ordering::Relaxed);
        outcome
    }
}
