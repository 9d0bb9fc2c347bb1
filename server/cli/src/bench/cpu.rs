//! Wall and CPU time of some processes.

use std::time::Instant;

use anyhow::Context;

use super::Measured;

/// Parts of a second in which the kernel states CPU times. It is the same number on every Linux
/// whose programs we run: it is part of the kernel's interface.
const TICKS_PER_SECOND: f64 = 100.0;

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

fn cpu_seconds(pids: &[u32]) -> anyhow::Result<f64> {
    let of = |pid: &u32| -> anyhow::Result<f64> {
        let path = format!("/proc/{pid}/stat");
        let text = std::fs::read_to_string(&path).with_context(|| path.clone())?;
        ticks(&text).map(|ticks| ticks as f64 / TICKS_PER_SECOND).context(path)
    };
    pids.iter().map(of).sum()
}

/// User and system time of all threads of a process, those that have ended included.
fn ticks(stat: &str) -> Option<u64> {
    // The program's name may hold anything, so fields are counted from its closing parenthesis.
    let (_, fields) = stat.rsplit_once(')')?;
    let mut fields = fields.split_whitespace().skip(11);
    let (user, system) = (fields.next()?, fields.next()?);
    Some(user.parse::<u64>().ok()? + system.parse::<u64>().ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_that_is_burnt_is_seen() {
        let stat = "12 (a ) b) S 1 2 3 4 5 6 7 8 9 10 70 30 0 0 20 0 1 0 5";
        assert_eq!(ticks(stat), Some(100));
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
