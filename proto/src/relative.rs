//! Where things are relative to each other: features of state and goals, for policies.
//!
//! A state has positions and Euler angles in one frame. What decides what to do is mostly how far one thing is from
//! another, to a millimetre nearby and roughly far away, and how it is turned. [`Relative`] says for one task which of
//! these are computed, as a list of few kinds. So three programs compute the same:
//!
//! - the server, for the word `relative` of the option `observation`;
//! - clients, for batches whose goals are replaced afterwards (hindsight experience replay);
//! - exported policies, as a graph.
//!
//! Features are pure functions of the state, the achieved and the desired goal. They are computed in f64 and rounded to
//! f32, with elementary functions that are the same everywhere: server and clients get the same bits.
//!
//! Six numbers of a rotation are continuous where its angles jump. Source: Zhou et al., On the Continuity of
//! Rotation Representations in Neural Networks, CVPR 2019.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::spec::{Element, TaskSpec};

/// Largest size of a number that [`Bound::Clip`] leaves.
pub const CLIP: f32 = 3.0;

/// The features of a task; empty where it has no goals.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Relative {
    /// How many numbers the state has, and each goal.
    pub dims: [usize; 2],
    /// The features in order.
    pub features: Vec<Feature>,
}

/// Some numbers that belong together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Feature {
    /// What it tells, e.g. `mid arc from wrist`.
    pub name: String,
    /// In which frame.
    pub frame: String,
    /// How it is computed.
    pub rule: Rule,
}

/// How a feature is computed from x: state, achieved and desired goal, one after the other. Numbers of x are meant by
/// where they begin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Rule {
    /// (to − from) / scale, within a bound, for the first `count` numbers of two places.
    Offset {
        /// What is told.
        to: Place,
        /// From what.
        from: Place,
        /// How many numbers.
        count: usize,
        /// What 1 stands for, in the unit of x.
        scale: f32,
        /// What becomes of large ones.
        bound: Bound,
    },
    /// The first two columns, one after the other, of R(x\[seen_from\])ᵀ · R(x\[of\]), or of R(x\[of\]). R = Rz(yaw) ·
    /// Ry(pitch) · Rx(roll) of three numbers, roll, pitch and yaw, rad.
    Rotation {
        /// What is turned.
        of: usize,
        /// In whose axes that is told.
        seen_from: Option<usize>,
    },
    /// Of d = R(x\[seen_from\])ᵀ · R(x\[of\]) · direction: 2·dx·dy, 2·dy·dz, 2·dx·dz, dx² − dy², dy² − dz². They are
    /// the same for d and −d: half a turn makes no difference to how a wire is grasped.
    Line {
        /// What is turned.
        of: usize,
        /// A direction in its axes, of length 1.
        direction: [f32; 3],
        /// In whose axes that is told.
        seen_from: usize,
    },
}

/// Three numbers; or fewer, of which there are as many as are told.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Place {
    /// Those of x from here on.
    At(usize),
    /// Always these.
    Fixed([f32; 3]),
    /// x\[at\] + R(x\[angles\]) · offset: a point that is fixed to what is turned so.
    On {
        /// Where that is.
        at: usize,
        /// How it is turned.
        angles: usize,
        /// The point in its axes.
        offset: [f32; 3],
    },
}

/// What becomes of large numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Bound {
    /// They end at ±[`CLIP`].
    Clip,
    /// tanh: they approach ±1.
    Tanh,
}

impl Rule {
    /// How many numbers it gives.
    pub fn dim(&self) -> usize {
        match self {
            Self::Offset { count, .. } => *count,
            Self::Rotation { .. } => 6,
            Self::Line { .. } => 5,
        }
    }

    /// Largest size of its numbers.
    fn limit(&self) -> f32 {
        match self {
            Self::Offset { bound: Bound::Clip, .. } => CLIP,
            _ => 1.0,
        }
    }

    /// What tells its numbers apart.
    fn parts(&self) -> &'static [&'static str] {
        match self {
            Self::Offset { count: 1, .. } => &[""],
            Self::Offset { .. } => &[" x", " y", " z"],
            Self::Rotation { .. } => {
                &[" x of x", " y of x", " z of x", " x of y", " y of y", " z of y"]
            }
            Self::Line { .. } => &[" 2xy", " 2yz", " 2xz", " x²−y²", " y²−z²"],
        }
    }

    fn write(&self, x: &[f32], numbers: &mut [f32]) {
        match *self {
            Self::Offset { to, from, count, scale, bound } => {
                let (to, from) = (to.of(x, count), from.of(x, count));
                for (index, number) in numbers.iter_mut().enumerate() {
                    let offset = (to[index] - from[index]) / f64::from(scale);
                    *number = match bound {
                        Bound::Clip => (offset as f32).clamp(-CLIP, CLIP),
                        Bound::Tanh => libm::tanh(offset) as f32,
                    };
                }
            }
            Self::Rotation { of, seen_from } => {
                let of = rotation(x, of);
                let seen = seen_from.map_or(of, |from| rotation(x, from).transpose() * of);
                // Matrices lie column by column.
                for (number, part) in numbers.iter_mut().zip(seen.iter()) {
                    *number = *part as f32;
                }
            }
            Self::Line { of, direction, seen_from } => {
                let direction = rotation(x, of) * Vector3::from(direction.map(f64::from));
                let d = rotation(x, seen_from).transpose() * direction;
                let products = [
                    2.0 * d.x * d.y,
                    2.0 * d.y * d.z,
                    2.0 * d.x * d.z,
                    d.x * d.x - d.y * d.y,
                    d.y * d.y - d.z * d.z,
                ];
                for (number, product) in numbers.iter_mut().zip(products) {
                    *number = product as f32;
                }
            }
        }
    }
}

impl Place {
    fn of(self, x: &[f32], count: usize) -> Vector3<f64> {
        let three = |numbers: &[f32]| {
            Vector3::from_fn(|axis, _| numbers.get(axis).map_or(0.0, |number| f64::from(*number)))
        };
        match self {
            Self::At(at) => three(&x[at..at + count]),
            Self::Fixed(place) => three(&place),
            Self::On { at, angles, offset } => {
                three(&x[at..at + count]) + rotation(x, angles) * three(&offset)
            }
        }
    }
}

/// Rz(yaw) · Ry(pitch) · Rx(roll) of the three numbers from `at` on.
fn rotation(x: &[f32], at: usize) -> Matrix3<f64> {
    let [(sr, cr), (sp, cp), (sy, cy)] =
        [x[at], x[at + 1], x[at + 2]].map(|angle| libm::sincos(f64::from(angle)));
    #[rustfmt::skip]
    let rotation = Matrix3::new(
        cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,
        sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,
        -sp,     cp * sr,                cp * cr,
    );
    rotation
}

impl Relative {
    /// How many numbers there are.
    pub fn dim(&self) -> usize {
        self.features.iter().map(|feature| feature.rule.dim()).sum()
    }

    /// Every number: what it tells, in which frame, its range.
    pub fn elements(&self) -> Vec<Element> {
        let of_feature = |feature: &Feature| {
            let limit = feature.rule.limit();
            let scale = match feature.rule {
                Rule::Offset { scale, .. } => format!(" / {scale}"),
                _ => String::new(),
            };
            let parts = feature.rule.parts().iter().take(feature.rule.dim());
            let named = parts.map(|part| format!("{}{part}{scale}", feature.name));
            named
                .map(|name| Element::new(&name, &feature.frame, "1", -limit, limit))
                .collect::<Vec<_>>()
        };
        self.features.iter().flat_map(of_feature).collect()
    }

    /// Writes the features of a state and goals of [`Self::dims`] numbers over `features`, [`Self::dim`] of them.
    ///
    /// # Panics
    /// Where a slice has another length.
    pub fn write(&self, state: &[f32], achieved: &[f32], desired: &[f32], features: &mut [f32]) {
        let mut x = Vec::with_capacity(state.len() + 2 * achieved.len());
        self.write_with(&mut x, state, achieved, desired, features);
    }

    /// The same of a batch, row by row.
    ///
    /// # Panics
    /// Where the slices do not have the same number of rows.
    pub fn write_batch(
        &self,
        states: &[f32],
        achieved: &[f32],
        desired: &[f32],
        features: &mut [f32],
    ) {
        let [state, goal] = self.dims;
        let rows = states.len() / state.max(1);
        let lengths = [states.len(), achieved.len(), desired.len(), features.len()];
        let expected = [state, goal, goal, self.dim()].map(|width| rows * width);
        assert_eq!(lengths, expected, "numbers of {rows} rows");
        let goals = achieved.chunks_exact(goal).zip(desired.chunks_exact(goal));
        let rows = states.chunks_exact(state).zip(goals).zip(features.chunks_exact_mut(self.dim()));
        let mut x = vec![];
        for ((state, (achieved, desired)), features) in rows {
            self.write_with(&mut x, state, achieved, desired, features);
        }
    }

    fn write_with(
        &self,
        x: &mut Vec<f32>,
        state: &[f32],
        achieved: &[f32],
        desired: &[f32],
        features: &mut [f32],
    ) {
        assert_eq!([state.len(), achieved.len(), desired.len()], {
            let [state, goal] = self.dims;
            [state, goal, goal]
        });
        assert_eq!(features.len(), self.dim());
        x.clear();
        for part in [state, achieved, desired] {
            x.extend_from_slice(part);
        }
        let mut rest = features;
        for feature in &self.features {
            let (own, others) = rest.split_at_mut(feature.rule.dim());
            feature.rule.write(x, own);
            rest = others;
        }
    }
}

impl TaskSpec {
    /// The features of a batch of states and goals, of the rows' numbers in [`Relative::dims`], row by row.
    ///
    /// # Panics
    /// Where the slices do not have the same number of rows.
    pub fn features(&self, states: &[f32], achieved: &[f32], desired: &[f32]) -> Vec<f32> {
        let rows = states.len() / self.relative.dims[0].max(1);
        let mut features = vec![0.0; rows * self.relative.dim()];
        self.relative.write_batch(states, achieved, desired, &mut features);
        features
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::{FRAC_PI_2, PI};

    fn features(rule: Rule, state: &[f32], goals: [&[f32]; 2]) -> Vec<f32> {
        let feature = Feature { name: "thing".into(), frame: "scene".into(), rule };
        let relative = Relative { dims: [state.len(), goals[0].len()], features: vec![feature] };
        let mut numbers = vec![f32::NAN; relative.dim()];
        relative.write(state, goals[0], goals[1], &mut numbers);
        assert_eq!(relative.elements().len(), numbers.len());
        for (number, element) in numbers.iter().zip(relative.elements()) {
            assert!((element.min..=element.max).contains(number), "{number} of {element:?}");
        }
        numbers
    }

    fn are_close(numbers: &[f32], expected: &[f32]) -> bool {
        numbers.len() == expected.len()
            && numbers.iter().zip(expected).all(|(one, other)| (one - other).abs() < 1e-6)
    }

    #[test]
    fn an_offset_is_scaled_and_bounded() {
        let rule =
            |from, bound| Rule::Offset { to: Place::At(2), from, count: 2, scale: 0.5, bound };
        let goals: [&[f32]; 2] = [&[0.25, 9.0], &[0.0, 0.0]];
        let clipped = features(rule(Place::At(0), Bound::Clip), &[0.0, 1.0], goals);
        assert_eq!(clipped, [0.5, 3.0]);
        let fixed = features(rule(Place::Fixed([1.0, 8.5, 0.0]), Bound::Tanh), &[0.0, 1.0], goals);
        assert_eq!(fixed, [-1.5, 1.0].map(|number| libm::tanh(number) as f32));
    }

    #[test]
    fn a_place_may_be_on_what_is_turned() {
        // A quarter turn about z takes 2 along x to 2 along y.
        let on = Place::On { at: 0, angles: 3, offset: [2.0, 0.0, 0.0] };
        let rule = |to, from| Rule::Offset { to, from, count: 3, scale: 1.0, bound: Bound::Clip };
        let state = [1.0, 0.0, 0.0, 0.0, 0.0, FRAC_PI_2, 1.0, 2.5, 0.0];
        let from = features(rule(Place::At(6), on), &state, [&[], &[]]);
        assert!(are_close(&from, &[0.0, 0.5, 0.0]), "{from:?}");
        let to = features(rule(on, Place::At(6)), &state, [&[], &[]]);
        assert!(are_close(&to, &[0.0, -0.5, 0.0]), "{to:?}");
    }

    #[test]
    fn a_rotation_is_told_in_the_axes_of_another() {
        let of = |seen_from| Rule::Rotation { of: 3, seen_from };
        // A quarter turn about z takes x to y and y to −x.
        let quarter = [0.0, 0.0, 0.3, 0.0, 0.0, FRAC_PI_2];
        let alone = features(of(None), &quarter, [&[], &[]]);
        assert!(are_close(&alone, &[0.0, 1.0, 0.0, -1.0, 0.0, 0.0]), "{alone:?}");
        // Turned together, they are turned alike.
        let (one, other) = ([0.1, -0.4, 0.7], [1.0, 0.2, -2.0]);
        let both = |yaw: f32| {
            let turned = [one, other].map(|[roll, pitch, own]| [roll, pitch, own + yaw]);
            features(of(Some(0)), &turned.concat(), [&[], &[]])
        };
        assert!(are_close(&both(0.0), &both(1.3)));
        assert!(!are_close(&both(0.0), &features(of(None), &[one, other].concat(), [&[], &[]])));
    }

    #[test]
    fn half_a_turn_of_a_wire_makes_no_difference() {
        let rule = || Rule::Line { of: 3, direction: [0.0, 1.0, 0.0], seen_from: 0 };
        // Half a turn about x takes y to −y.
        let seen = |roll: f32| features(rule(), &[0.3, 0.1, -0.2, roll, -0.1, 0.4], [&[], &[]]);
        assert!(are_close(&seen(0.5), &seen(0.5 - PI)));
        assert!(!are_close(&seen(0.5), &seen(1.0)));
    }

    #[test]
    fn a_batch_has_the_bits_of_its_rows() {
        let rule = Rule::Rotation { of: 0, seen_from: Some(1) };
        let feature = Feature { name: "turn".into(), frame: "scene".into(), rule };
        let relative = Relative { dims: [4, 1], features: vec![feature] };
        let states = [0.1, 0.2, 0.3, 0.4, -1.0, 2.0, -3.0, 0.5];
        let mut batch = [0.0; 12];
        relative.write_batch(&states, &[1.0, 2.0], &[3.0, 4.0], &mut batch);
        for row in 0..2 {
            let mut alone = [0.0; 6];
            relative.write(&states[4 * row..][..4], &[1.0], &[3.0], &mut alone);
            assert_eq!(alone, batch[6 * row..][..6]);
        }
    }
}
