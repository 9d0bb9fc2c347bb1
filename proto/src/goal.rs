//! Distance, success and reward as pure functions of achieved and desired goals.
//!
//! Server and clients call the same functions, so relabelled transitions (hindsight experience
//! replay) get exactly the reward that the server would have given.

use serde::{Deserialize, Serialize};

use crate::scaled::Range;

/// When an achieved goal counts as the desired one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum SuccessRule {
    /// Euclidean distance below `tolerance` (unit of the goal).
    Distance {
        /// Largest distance, exclusive.
        tolerance: f32,
    },
    /// A block on a peg: horizontal distance below `horizontal`, vertical below `vertical`.
    Seated {
        /// Largest distance in x and y together, m, exclusive.
        horizontal: f32,
        /// Largest distance in z, m, exclusive.
        vertical: f32,
    },
    /// Centred in the image and level: image error below `image`, |angle| below `angle`.
    /// The goal is (x, y, angle).
    Centred {
        /// Largest image distance, normalised image units, exclusive.
        image: f32,
        /// Largest angle, rad, exclusive.
        angle: f32,
    },
    /// Every part of the goal by itself: they have different units.
    Parts(Vec<GoalPart>),
    /// A rule of unscaled goals, for scaled ones.
    Scaled {
        /// Range of each element before scaling.
        ranges: Vec<Range>,
        /// The rule of unscaled goals.
        rule: Box<SuccessRule>,
    },
}

/// Some numbers of a goal that belong together: a position, a share, a force.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GoalPart {
    /// What it is, e.g. `exposed`.
    pub name: String,
    /// The first of its numbers in the goal.
    pub start: usize,
    /// How many numbers it has.
    pub count: usize,
    /// Largest Euclidean distance at which it is reached, exclusive, in its unit.
    pub tolerance: f32,
    /// The distance that takes 1 from the dense reward, in its unit; no option changes it.
    pub unit: f32,
}

impl GoalPart {
    /// How far this part of `achieved` is from that of `desired`, in its unit; NaN where goals have no such part.
    pub fn distance(&self, achieved: &[f32], desired: &[f32]) -> f32 {
        let numbers = self.start..self.start.saturating_add(self.count);
        match (achieved.get(numbers.clone()), desired.get(numbers)) {
            (Some(achieved), Some(desired)) => distance(achieved, desired),
            _ => f32::NAN,
        }
    }
}

impl SuccessRule {
    /// Whether `achieved` reaches `desired`. NaN never does.
    pub fn holds(&self, achieved: &[f32], desired: &[f32]) -> bool {
        match self {
            Self::Distance { tolerance } => distance(achieved, desired) < *tolerance,
            Self::Seated { horizontal, vertical } => {
                distance(&achieved[..2], &desired[..2]) < *horizontal
                    && (achieved[2] - desired[2]).abs() < *vertical
            }
            Self::Centred { image, angle } => {
                distance(&achieved[..2], &desired[..2]) < *image
                    && (achieved[2] - desired[2]).abs() < *angle
            }
            Self::Parts(parts) => {
                parts.iter().all(|part| part.distance(achieved, desired) < part.tolerance)
            }
            Self::Scaled { ranges, rule } => {
                let [achieved, desired] =
                    [achieved, desired].map(|goal| Range::unscale_all(ranges, goal));
                rule.holds(&achieved, &desired)
            }
        }
    }
}

/// Which reward a session gives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Reward {
    /// 0 on success, −1 otherwise.
    Sparse,
    /// −‖achieved − desired‖, in the unit of the goal. Of a goal with [parts](SuccessRule::Parts): minus the sum of
    /// their distances, each over the part's [unit](GoalPart::unit).
    Dense,
    /// A function of the full state that only the server can compute (tasks without goals).
    State,
}

impl Reward {
    /// The reward of one pair of goals.
    ///
    /// # Panics
    /// For [`Reward::State`], which is no function of goals.
    pub fn of(self, rule: &SuccessRule, achieved: &[f32], desired: &[f32]) -> f32 {
        match self {
            Self::Sparse if rule.holds(achieved, desired) => 0.0,
            Self::Sparse => -1.0,
            Self::Dense => match rule {
                SuccessRule::Parts(parts) => {
                    let distance = |part: &GoalPart| part.distance(achieved, desired) / part.unit;
                    -parts.iter().map(distance).fold(0.0, |sum, part| sum + part)
                }
                SuccessRule::Scaled { ranges, rule } => {
                    let [achieved, desired] =
                        [achieved, desired].map(|goal| Range::unscale_all(ranges, goal));
                    self.of(rule, &achieved, &desired)
                }
                _ => -distance(achieved, desired),
            },
            Self::State => unreachable!("a task without goals computes its reward itself"),
        }
    }

    /// The rewards of a batch: `achieved` and `desired` are (n, dim) in row-major order.
    pub fn of_batch(
        self,
        rule: &SuccessRule,
        dim: usize,
        achieved: &[f32],
        desired: &[f32],
        rewards: &mut [f32],
    ) {
        let pairs = achieved.chunks_exact(dim).zip(desired.chunks_exact(dim));
        for (reward, (achieved, desired)) in rewards.iter_mut().zip(pairs) {
            *reward = self.of(rule, achieved, desired);
        }
    }
}

/// Euclidean distance of two goals, summed in index order.
pub fn distance(achieved: &[f32], desired: &[f32]) -> f32 {
    let squares = achieved.iter().zip(desired).map(|(a, d)| (a - d) * (a - d));
    squares.fold(0.0, |sum, square| sum + square).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rewards_of_a_batch_are_those_of_its_rows() {
        let rule = SuccessRule::Distance { tolerance: 0.005 };
        let achieved = [0.0, 0.0, 0.0, 0.1, 0.2, 0.3];
        let desired = [0.0, 0.0, 0.004, 0.1, 0.2, 0.0];
        let mut rewards = [f32::NAN; 2];
        Reward::Sparse.of_batch(&rule, 3, &achieved, &desired, &mut rewards);
        assert_eq!(rewards, [0.0, -1.0]);
        Reward::Dense.of_batch(&rule, 3, &achieved, &desired, &mut rewards);
        assert_eq!(rewards, [-0.004, -0.3]);
    }

    #[test]
    fn the_tolerance_is_exclusive_and_nan_is_no_success() {
        let rule = SuccessRule::Distance { tolerance: 0.5 };
        assert!(!rule.holds(&[0.5], &[0.0]));
        assert!(rule.holds(&[0.499], &[0.0]));
        assert!(!rule.holds(&[f32::NAN], &[0.0]));
    }

    #[test]
    fn every_part_of_a_goal_has_its_own_tolerance_and_unit() {
        let part = |name: &str, start, count, tolerance, unit| GoalPart {
            name: name.into(),
            start,
            count,
            tolerance,
            unit,
        };
        let rule = SuccessRule::Parts(vec![
            part("point", 0, 3, 0.01, 0.01),
            part("exposed", 3, 1, 0.2, 0.1),
        ]);
        let desired = [0.0, 0.0, 0.0, 1.0];
        assert!(rule.holds(&[0.009, 0.0, 0.0, 0.9], &desired));
        assert!(!rule.holds(&[0.011, 0.0, 0.0, 0.9], &desired));
        assert!(!rule.holds(&[0.0, 0.0, 0.0, 0.7], &desired));
        let reward = Reward::Dense.of(&rule, &[0.0, 0.02, 0.0, 0.5], &desired);
        assert!((reward + 7.0).abs() < 1e-5, "{reward}");
        // A part that goals do not have is never reached.
        assert!(!rule.holds(&[0.0; 3], &desired));
    }

    #[test]
    fn seated_and_centred_look_at_both_parts() {
        let seated = SuccessRule::Seated { horizontal: 0.005, vertical: 0.004 };
        assert!(seated.holds(&[0.003, 0.003, 0.0035], &[0.0; 3]));
        assert!(!seated.holds(&[0.004, 0.004, 0.0], &[0.0; 3]));
        assert!(!seated.holds(&[0.0, 0.0, 0.004], &[0.0; 3]));
        let centred = SuccessRule::Centred { image: 0.01, angle: 0.01 };
        assert!(centred.holds(&[0.005, 0.005, -0.009], &[0.0; 3]));
        assert!(!centred.holds(&[0.0, 0.0, -0.01], &[0.0; 3]));
    }
}
