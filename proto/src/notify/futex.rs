//! Threads that sleep on a word in shared memory until another thread wakes them up (futex(2)).

use std::sync::atomic::AtomicU32;
use std::time::Duration;

use rustix::io::Errno;
use rustix::thread::futex::{self, Flags, Timespec};

/// How a wait ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WaitOutcome {
    /// Another thread may have woken this one up, or the word had changed.
    Woken,
    /// The time was over.
    TimedOut,
    /// A signal came.
    Interrupted,
}

/// Sleeps until a thread wakes this one up at `word`, at most for `limit`; not at all where the word is not `seen`.
pub(crate) fn wait(word: &AtomicU32, seen: u32, limit: Duration) -> WaitOutcome {
    let limit = Timespec {
        tv_sec: limit.as_secs().try_into().unwrap_or(i64::MAX),
        tv_nsec: limit.subsec_nanos().into(),
    };
    match futex::wait(word, Flags::empty(), seen, Some(&limit)) {
        Err(Errno::TIMEDOUT) => WaitOutcome::TimedOut,
        Err(Errno::INTR) => WaitOutcome::Interrupted,
        Ok(()) | Err(_) => WaitOutcome::Woken,
    }
}

/// Wakes up to `count` of the threads that sleep at `word`.
pub(crate) fn wake(word: &AtomicU32, count: u32) {
    // Fails where the memory is gone, and then no thread sleeps there.
    futex::wake(word, Flags::empty(), count).ok();
}
