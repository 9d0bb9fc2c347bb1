//! Wall and CPU time of some processes.

use std::time::Instant;

use super::Measured;
use crate::usage::{TICKS_PER_SECOND, cpu_seconds};

/// Measures from its start on.
#[derive(Debug)]
pub(super) struct Stopwatch {
    pids: Vec<u32>,
    start: Instant,
    cpu_seconds: f64,
}

impl Stopwatch {
    /// Starts, for the CPU time of these processes together.
    pub(super) fn start(pids: &[u32]) -> anyhow::Result<Self> {
        let cpu_seconds = cpu_seconds(pids)?;
        Ok(Self { pids: pids.to_vec(), start: Instant::now(), cpu_seconds })
    }

    /// What `steps` steps since its start have cost.
    pub(super) fn stop(self, steps: u64) -> anyhow::Result<Measured> {
        let seconds = self.start.elapsed().as_secs_f64();
        let cpu_seconds = cpu_seconds(&self.pids)? - self.cpu_seconds;
        // A tick more or less is an error of 0.5 % in a measurement of 2 s.
        Ok(Measured { steps, seconds, cpu_seconds: cpu_seconds.max(1.0 / TICKS_PER_SECOND) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_that_is_burnt_is_seen() {
        let watch = Stopwatch::start(&[std::process::id()]).unwrap();
        let start = Instant::now();
        while start.elapsed().as_millis() < 200 {
            std::hint::spin_loop();
        }
        let measured = watch.stop(7).unwrap();
        assert_eq!(measured.steps, 7);
        assert!(measured.seconds >= 0.2 && measured.cpu_seconds > 0.0);
    }
}
