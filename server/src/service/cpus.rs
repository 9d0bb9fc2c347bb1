//! Which of the machine's processors a server uses.

use std::str::FromStr;

use rustix::thread::{CpuSet, sched_setaffinity};
use trocar_proto::{Code, Rejection};

/// Processors by number, as `taskset` writes them: `0-3` or `0,2,4-5`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cpus(Vec<usize>);

impl Cpus {
    /// How many there are.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// Keeps the calling thread, and those that it starts from now on, to these processors.
    pub fn pin(&self) -> Result<(), Rejection> {
        let mut set = CpuSet::new();
        for cpu in &self.0 {
            set.set(*cpu);
        }
        sched_setaffinity(None, &set).map_err(|error| {
            let allowed = "allowed are processors of this machine that the process may use";
            Rejection::new(Code::InvalidOption, "cpus", format!("{:?}: {error}", self.0), allowed)
        })
    }
}

impl FromStr for Cpus {
    type Err = Rejection;

    fn from_str(text: &str) -> Result<Self, Rejection> {
        let range = |part: &str| {
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            let (first, last) = (first.parse().ok()?, last.parse().ok()?);
            (first <= last && last < CpuSet::MAX_CPU).then_some(first..=last)
        };
        let ranges: Option<Vec<_>> = text.split(',').map(range).collect();
        let Some(ranges) = ranges else {
            let allowed = format!(
                "allowed are numbers below {} and ranges of them, as 0,2,4-5",
                CpuSet::MAX_CPU
            );
            return Err(Rejection::new(Code::InvalidOption, "cpus", format!("{text:?}"), allowed));
        };
        let mut cpus: Vec<usize> = ranges.into_iter().flatten().collect();
        cpus.sort_unstable();
        cpus.dedup();
        Ok(Self(cpus))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_processors_are_read() {
        let cpus = |text: &str| text.parse::<Cpus>().map(|cpus| cpus.0);
        assert_eq!(cpus("3").unwrap(), [3]);
        assert_eq!(cpus("4-5,0,2,4").unwrap(), [0, 2, 4, 5]);
        for bad in ["", "a", "1-", "3-2", "0,,1", "-1", "0-99999"] {
            assert!(cpus(bad).unwrap_err().to_string().contains("allowed"), "{bad}");
        }
    }

    #[test]
    fn threads_that_are_started_later_are_pinned_too() {
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let allowed = rustix::thread::sched_getaffinity(None).unwrap();
                let first = (0..CpuSet::MAX_CPU).find(|cpu| allowed.is_set(*cpu)).unwrap();
                Cpus(vec![first]).pin().unwrap();
                let inherits = std::thread::spawn(|| rustix::thread::sched_getaffinity(None));
                assert_eq!(inherits.join().unwrap().unwrap().count(), 1);
                assert!(Cpus(vec![CpuSet::MAX_CPU - 1]).pin().is_err());
            });
        });
    }
}
