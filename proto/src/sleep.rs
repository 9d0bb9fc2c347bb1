//! Threads that sleep on a word in shared memory until another thread wakes them up (futex(2)).

use std::num::NonZeroU32;
use std::sync::atomic::AtomicU32;
use std::time::Duration;

use rustix::io::{Errno, Result};
use rustix::thread::futex::{self, Flags, Timespec};
use rustix::time::{ClockId, clock_gettime};

/// How a wait ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Woken {
    /// There may have been a ring.
    Rung,
    /// The time was over.
    Late,
    /// A signal came.
    Interrupted,
}

impl Woken {
    fn of(result: Result<()>) -> Self {
        match result {
            Err(Errno::TIMEDOUT) => Self::Late,
            Err(Errno::INTR) => Self::Interrupted,
            Ok(()) | Err(_) => Self::Rung,
        }
    }
}

/// Sleeps until a thread is woken up at `word`, at most for `limit`; not at all where the word is not `seen`.
pub(crate) fn wait(word: &AtomicU32, seen: u32, limit: Duration) -> Woken {
    Woken::of(futex::wait(word, Flags::empty(), seen, Some(&timespec(limit))))
}

/// The same, until those of one of `bits` are woken up.
pub(crate) fn wait_as(word: &AtomicU32, seen: u32, limit: Duration, bits: NonZeroU32) -> Woken {
    let now = clock_gettime(ClockId::Monotonic);
    let now = Duration::new(now.tv_sec.cast_unsigned(), now.tv_nsec as u32);
    let end = timespec(now.saturating_add(limit));
    Woken::of(futex::wait_bitset(word, Flags::empty(), seen, Some(&end), bits))
}

/// Wakes up one of the threads that sleep at `word`.
pub(crate) fn wake_one(word: &AtomicU32) {
    // Fails where the memory is gone, and then no thread sleeps there.
    futex::wake(word, Flags::empty(), 1).ok();
}

/// Wakes up all threads that sleep at `word` as one of `bits`.
pub(crate) fn wake_all(word: &AtomicU32, bits: NonZeroU32) {
    futex::wake_bitset(word, Flags::empty(), i32::MAX as u32, bits).ok();
}

fn timespec(time: Duration) -> Timespec {
    Timespec {
        tv_sec: time.as_secs().try_into().unwrap_or(i64::MAX),
        tv_nsec: time.subsec_nanos().into(),
    }
}
