//! How often a task is commanded: the option `rate`.
//!
//! Limits, increments and the length of an episode are quantities of time: at twice the rate, 1.0 in an action stands
//! for half as much, and an episode has twice as many steps.

use trocar_proto::Options;
use trocar_proto::spec::{Allowed, OptionSpec, OptionValue};

use crate::sim::world::SUBSTEPS_PER_SECOND;

/// The rates that tasks may be commanded at, Hz: a step of each is a whole number of substeps.
pub const RATES: [f64; 6] = [5.0, 10.0, 20.0, 30.0, 40.0, 60.0];

/// How often a task is commanded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rate {
    hertz: f64,
    /// The rate at which 1.0 in an action stands for what the task says, Hz.
    nominal: f64,
}

impl Rate {
    /// The rate of a task at which its numbers are those of its description, Hz.
    pub const fn nominal(hertz: f64) -> Self {
        Self { hertz, nominal: hertz }
    }

    /// The rate that resolved options ask of a task; its nominal one where it has no such option.
    #[must_use]
    pub fn of(self, options: &Options) -> Self {
        Self { hertz: options.number("rate").unwrap_or(self.nominal), ..self }
    }

    /// `rate`: how often the task is commanded, at least at `least` Hz.
    pub fn option(self, least: f64) -> OptionSpec {
        OptionSpec {
            name: "rate".into(),
            summary:
                "Steps in a second, Hz. Increments, limits and the number of steps scale with time."
                    .into(),
            default: OptionValue::Number(self.nominal),
            allowed: Allowed::NumberOf(RATES.into_iter().filter(|rate| *rate >= least).collect()),
        }
    }

    /// Simulated time of one step, s.
    pub fn seconds(self) -> f64 {
        1.0 / self.hertz
    }

    /// Substeps of one step.
    pub fn substeps(self) -> u32 {
        substeps(self.seconds())
    }

    /// Steps in the time of `nominal` ones at the nominal rate.
    pub fn steps(self, nominal: u32) -> u32 {
        (f64::from(nominal) / self.scale()).round() as u32
    }

    /// Steps in `seconds` at this rate; at least 1.
    pub fn steps_in(self, seconds: f64) -> u32 {
        (seconds * self.hertz).round().max(1.0) as u32
    }

    /// A step's time over that of one at the nominal rate, where it is exactly 1.
    pub fn scale(self) -> f64 {
        self.nominal / self.hertz
    }

    /// Whether this is the nominal rate.
    pub fn is_nominal(self) -> bool {
        self.hertz == self.nominal
    }
}

/// Substeps in `seconds`, the nearest whole number.
pub fn substeps(seconds: f64) -> u32 {
    (seconds * SUBSTEPS_PER_SECOND).round() as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rate_has_whole_substeps_and_the_same_episode_in_seconds() {
        for hertz in RATES {
            let rate = Rate { hertz, nominal: 5.0 };
            assert_eq!(f64::from(rate.substeps()) * hertz, SUBSTEPS_PER_SECOND);
            assert_eq!(f64::from(rate.steps(50)) * rate.seconds(), 10.0);
        }
        assert_eq!(Rate::nominal(5.0).seconds(), 0.2);
        assert_eq!(Rate::nominal(10.0).seconds(), 0.1);
    }
}
