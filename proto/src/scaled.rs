//! Scaled observations: every element of state and goals as (x − centre) / half-width of its range.
//!
//! Positions are metres around 0.05: networks learn little from such inputs. Scaled elements lie in [−1, 1]. Rewards and
//! success are computed from unscaled goals, on the server and on its clients, so hindsight relabelling gives the bits of
//! the server's reward.

use serde::{Deserialize, Serialize};

use crate::goal::SuccessRule;
use crate::relative::Relative;
use crate::spec::{Element, GoalSpec, TaskSpec};

/// Stated range of an element before scaling.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Range {
    /// Smallest value.
    pub min: f32,
    /// Largest value.
    pub max: f32,
}

impl Range {
    /// The range of `element`.
    pub fn of(element: &Element) -> Self {
        Self { min: element.min, max: element.max }
    }

    fn centre(self) -> f64 {
        f64::midpoint(f64::from(self.min), f64::from(self.max))
    }

    /// Half of the width; 1 for a range of zero width.
    fn half_width(self) -> f64 {
        let half = (f64::from(self.max) - f64::from(self.min)) / 2.0;
        if half > 0.0 { half } else { 1.0 }
    }

    /// (x − centre) / half-width, without clipping.
    pub fn scale(self, value: f32) -> f32 {
        ((f64::from(value) - self.centre()) / self.half_width()) as f32
    }

    /// Inverse of [`Self::scale`], up to rounding to f32.
    pub fn unscale(self, value: f32) -> f32 {
        (f64::from(value) * self.half_width() + self.centre()) as f32
    }

    /// Unscales one vector, element by element.
    pub fn unscale_all(ranges: &[Self], values: &[f32]) -> Vec<f32> {
        ranges.iter().zip(values).map(|(range, value)| range.unscale(*value)).collect()
    }
}

/// Scales `values` by the ranges of `elements`.
pub fn scale_all(elements: &[Element], values: &mut [f32]) {
    for (value, element) in values.iter_mut().zip(elements) {
        *value = Range::of(element).scale(*value);
    }
}

fn scaled(elements: &[Element]) -> Vec<Element> {
    let scaled = |element: &Element| {
        let range = Range::of(element);
        let (min, max) = (range.scale(element.min), range.scale(element.max));
        Element { unit: "1".into(), min, max, ..element.clone() }
    };
    elements.iter().map(scaled).collect()
}

impl TaskSpec {
    /// The specification with scaled observations and goals. Relative features need unscaled numbers, so the scaled
    /// specification has none.
    #[must_use]
    pub fn scaled(&self) -> Self {
        let goal = self.goal.as_ref().map(|goal| GoalSpec {
            elements: scaled(&goal.elements),
            success: SuccessRule::Scaled {
                ranges: goal.elements.iter().map(Range::of).collect(),
                rule: Box::new(goal.success.clone()),
            },
        });
        let relative = Relative { dims: self.relative.dims, features: vec![] };
        Self { observation: scaled(&self.observation), goal, relative, ..self.clone() }
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "these results are exact")]
mod tests {
    use super::*;
    use crate::goal::Reward;

    #[test]
    fn ends_of_a_range_become_one_and_values_beyond_are_not_clipped() {
        let range = Range { min: 0.25, max: 0.75 };
        assert_eq!([0.25, 0.5, 0.75, 1.0].map(|x| range.scale(x)), [-1.0, 0.0, 1.0, 2.0]);
        assert_eq!([-1.0, 0.0, 1.0, 2.0].map(|x| range.unscale(x)), [0.25, 0.5, 0.75, 1.0]);
        let fixed = Range { min: 3.0, max: 3.0 };
        assert_eq!([fixed.scale(3.0), fixed.scale(3.5), fixed.unscale(0.5)], [0.0, 0.5, 3.5]);
    }

    #[test]
    fn rewards_are_those_of_unscaled_goals() {
        let ranges = vec![Range { min: 0.0, max: 0.5 }, Range { min: 1.0, max: 1.0 }];
        let plain = SuccessRule::Distance { tolerance: 0.1 };
        let rule = SuccessRule::Scaled { ranges: ranges.clone(), rule: Box::new(plain.clone()) };
        let scale = |goal: [f32; 2]| [ranges[0].scale(goal[0]), ranges[1].scale(goal[1])];
        for (achieved, desired) in [([0.25, 1.0], [0.3125, 1.0]), ([0.25, 1.0], [0.375, 1.0])] {
            let (from, to) = (scale(achieved), scale(desired));
            assert_eq!(rule.holds(&from, &to), plain.holds(&achieved, &desired));
            for reward in [Reward::Sparse, Reward::Dense] {
                assert_eq!(reward.of(&rule, &from, &to), reward.of(&plain, &achieved, &desired));
            }
        }
    }
}
