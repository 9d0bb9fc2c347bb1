//! Processor time.

use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

/// What this thread has computed since it began.
pub(crate) fn thread_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec.cast_unsigned(), time.tv_nsec as u32)
}
