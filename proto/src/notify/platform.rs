//! The atomics and futexes that the protocols here are written for.

use std::fmt::Debug;
use std::sync::atomic::{self, AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

use super::futex::{self, WaitOutcome};

/// A family of words and the fence between them.
pub trait Platform: Debug + 'static {
    /// A word on which threads sleep.
    type Futex: FutexWord;
    /// A row of 64 flags.
    type Flags: FlagWord;
    /// `fence(SeqCst)`.
    fn fence();
}

/// A 32-bit word, 0 at first, on which threads sleep.
pub trait FutexWord: Debug + Default + Send + Sync {
    /// Reads it.
    fn load(&self, order: Ordering) -> u32;
    /// Writes it.
    fn store(&self, value: u32, order: Ordering);
    /// Writes it and returns what it was.
    fn swap(&self, value: u32, order: Ordering) -> u32;
    /// Adds one, modulo 2³².
    fn increment(&self, order: Ordering);
    /// Sleeps until a thread wakes this one, at most for `limit`; not at all where the word is not `seen`.
    fn wait(&self, seen: u32, limit: Duration) -> WaitOutcome;
    /// Wakes up to `count` of the threads that sleep.
    fn wake(&self, count: u32);
}

/// 64 flags, all down at first.
pub trait FlagWord: Debug + Default + Send + Sync {
    /// Raises these.
    fn raise(&self, flags: u64, order: Ordering);
    /// Reads all.
    fn load(&self, order: Ordering) -> u64;
    /// Lowers all and returns those that were up.
    fn take(&self, order: Ordering) -> u64;
}

/// Atomics in memory that processes share, and futex(2).
#[derive(Debug)]
pub struct Linux;

impl Platform for Linux {
    type Futex = AtomicU32;
    type Flags = AtomicU64;

    fn fence() {
        atomic::fence(Ordering::SeqCst);
    }
}

impl FutexWord for AtomicU32 {
    fn load(&self, order: Ordering) -> u32 {
        self.load(order)
    }

    fn store(&self, value: u32, order: Ordering) {
        self.store(value, order);
    }

    fn swap(&self, value: u32, order: Ordering) -> u32 {
        self.swap(value, order)
    }

    fn increment(&self, order: Ordering) {
        self.fetch_add(1, order);
    }

    fn wait(&self, seen: u32, limit: Duration) -> WaitOutcome {
        futex::wait(self, seen, limit)
    }

    fn wake(&self, count: u32) {
        futex::wake(self, count);
    }
}

/// An atomic of the standard library or of `loom`, which have the same methods.
macro_rules! flag_word {
    ($atomic:ty) => {
        impl FlagWord for $atomic {
            fn raise(&self, flags: u64, order: Ordering) {
                self.fetch_or(flags, order);
            }

            fn load(&self, order: Ordering) -> u64 {
                self.load(order)
            }

            fn take(&self, order: Ordering) -> u64 {
                self.swap(0, order)
            }
        }
    };
}

flag_word!(AtomicU64);

#[cfg(feature = "loom")]
pub use model::Model;

#[cfg(feature = "loom")]
mod model {
    use loom::sync::atomic::{AtomicU32, AtomicU64, fence};
    use loom::sync::{Condvar, Mutex};

    use super::{Debug, Duration, FlagWord, FutexWord, Ordering, Platform, WaitOutcome};

    /// What `loom` explores. A futex is a word beside a mutex and a condition variable. Waits have no end here, so a
    /// wake-up that is lost is a deadlock, which `loom` reports.
    #[derive(Debug)]
    pub struct Model;

    impl Platform for Model {
        type Futex = ModelFutex;
        type Flags = AtomicU64;

        fn fence() {
            fence(Ordering::SeqCst);
        }
    }

    #[derive(Debug, Default)]
    pub struct ModelFutex {
        word: AtomicU32,
        sleepers: Mutex<()>,
        condition: Condvar,
    }

    impl FutexWord for ModelFutex {
        fn load(&self, order: Ordering) -> u32 {
            self.word.load(order)
        }

        fn store(&self, value: u32, order: Ordering) {
            self.word.store(value, order);
        }

        fn swap(&self, value: u32, order: Ordering) -> u32 {
            self.word.swap(value, order)
        }

        fn increment(&self, order: Ordering) {
            self.word.fetch_add(1, order);
        }

        fn wait(&self, seen: u32, _limit: Duration) -> WaitOutcome {
            // The kernel compares and falls asleep under a lock that a waking thread takes, too.
            let sleepers = self.sleepers.lock().expect("no thread panics with it");
            if self.word.load(Ordering::Acquire) == seen {
                drop(self.condition.wait(sleepers).expect("no thread panics with it"));
            }
            WaitOutcome::Woken
        }

        fn wake(&self, count: u32) {
            let sleepers = self.sleepers.lock().expect("no thread panics with it");
            if count == 1 {
                self.condition.notify_one();
            } else {
                self.condition.notify_all();
            }
            drop(sleepers);
        }
    }

    flag_word!(AtomicU64);
}
