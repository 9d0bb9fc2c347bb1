//! Where an instrument is to be at each substep of a motion.

use std::collections::VecDeque;

use crate::sim::instrument::Posture;

/// The path of an instrument, and how fast it goes along it.
#[derive(Debug, Clone)]
pub enum Profile {
    /// From rest to rest: smoothstep, with velocity 0 at both ends.
    Smoothstep {
        /// Where it begins.
        start: Posture,
        /// Where it ends.
        end: Posture,
    },
    /// On past `via`: a quadratic Bézier curve, which leaves `start` towards `via` and comes to `end` from
    /// there. Curves from one middle of two set-points to the next, by way of the set-point between them, are
    /// a uniform quadratic B-spline: the velocity has no jumps, and no point is beyond the set-points.
    Bend {
        /// Where it begins.
        start: Posture,
        /// Where both ends of the curve point to.
        via: Posture,
        /// Where it ends.
        end: Posture,
    },
    /// Through set-points of each substep, which come one by one; the first is where it begins.
    Streamed(VecDeque<Posture>),
    /// Through postures of each substep, as a drivetrain with play and lag brings them about; the first is where it
    /// begins. While plays are taken up, it goes by micrometres, whichever way.
    Traced(Vec<Posture>),
}

impl Profile {
    /// Staying where it is.
    pub fn rest(posture: Posture) -> Self {
        Self::Smoothstep { start: posture, end: posture }
    }

    /// The posture with the wrist where it is to be after `wrist` of `substeps` substeps, and the jaw where it is
    /// to be after `jaw` of them.
    ///
    /// # Panics
    /// Where a streamed set-point has not come yet.
    pub fn at(&self, wrist: u32, jaw: u32, substeps: u32) -> Posture {
        match self {
            Self::Smoothstep { start, end } => {
                start.towards(end, smoothstep(wrist, substeps), smoothstep(jaw, substeps))
            }
            Self::Bend { start, via, end } => {
                let [wrist, jaw] = [wrist, jaw].map(|now| f64::from(now) / f64::from(substeps));
                let (to_via, to_end) =
                    (start.towards(via, wrist, jaw), via.towards(end, wrist, jaw));
                to_via.towards(&to_end, wrist, jaw)
            }
            Self::Streamed(points) => {
                Posture { jaw: points[jaw as usize].jaw, ..points[wrist as usize] }
            }
            Self::Traced(points) => {
                Posture { jaw: points[jaw as usize].jaw, ..points[wrist as usize] }
            }
        }
    }

    /// The part of the way that is covered after `done` of `substeps` substeps of it, from 0 to 1.
    pub fn covered(&self, done: u32, substeps: u32) -> f64 {
        match self {
            Self::Smoothstep { .. } => smoothstep(done, substeps),
            Self::Bend { .. } | Self::Streamed(_) | Self::Traced(_) => {
                f64::from(done) / f64::from(substeps.max(1))
            }
        }
    }

    /// Where it ends, as far as that is known.
    ///
    /// # Panics
    /// Where no set-point was streamed.
    pub fn end(&self) -> Posture {
        match self {
            Self::Smoothstep { end, .. } | Self::Bend { end, .. } => *end,
            Self::Streamed(points) => *points.back().expect("it begins somewhere"),
            Self::Traced(points) => *points.last().expect("it begins somewhere"),
        }
    }
}

/// 0 at 0, 1 at `total`, with velocity 0 at both ends.
pub(crate) fn smoothstep(done: u32, total: u32) -> f64 {
    let x = f64::from(done) / f64::from(total);
    x * x * (3.0 - 2.0 * x)
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "these results are exact")]
mod tests {
    use super::*;
    use crate::sim::frames;

    #[test]
    fn a_smoothstep_has_no_jump_in_its_velocity() {
        let speeds: Vec<f64> = (0..48).map(|i| smoothstep(i + 1, 48) - smoothstep(i, 48)).collect();
        assert!(speeds[0] < 0.1 / 48.0 * 2.0 && speeds[47] < 0.1 / 48.0 * 2.0);
        let jump = speeds.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
        assert!(jump < 0.15 / 48.0);
        assert_eq!(smoothstep(48, 48), 1.0);
    }

    #[test]
    fn bends_from_middle_to_middle_have_no_jump_in_their_velocity() {
        let posture = |x: f64, turn: f64| Posture {
            world_from_wrist: frames::pose([x, 0.0, 0.0], [0.0, 0.0, turn]),
            jaw: x,
        };
        // Set-points that stand, go on evenly, and stand again: where each substep brings the wrist.
        let places = [0.0, 0.0, 1.0, 2.0, 3.0, 3.0, 3.0].map(|x| posture(x, 0.2 * x));
        let middle = |a: &Posture, b: &Posture| a.towards(b, 0.5, 0.5);
        let mut passed = vec![places[0]];
        for three in places.windows(3) {
            let (start, end) = (middle(&three[0], &three[1]), middle(&three[1], &three[2]));
            let bend = Profile::Bend { start, via: three[1], end };
            passed.extend((1..=12).map(|now| bend.at(now, now, 12)));
        }
        let speeds = |of: fn(&Posture) -> f64| -> Vec<f64> {
            passed.windows(2).map(|pair| of(&pair[1]) - of(&pair[0])).collect()
        };
        let turned = |posture: &Posture| frames::euler_xyz(&posture.world_from_wrist.rotation)[2];
        for (speeds, unit) in [
            (speeds(|posture| posture.world_from_wrist.translation.x), 1.0),
            (speeds(|posture| posture.jaw), 1.0),
            (speeds(turned), 0.2),
        ] {
            let even = unit / 12.0;
            for pair in speeds.windows(2) {
                assert!((pair[1] - pair[0]).abs() < even / 12.0 + 1e-9, "{speeds:?}");
            }
            assert!(speeds.iter().all(|speed| (-1e-12..even + 1e-9).contains(speed)), "{speeds:?}");
        }
        let end = passed.last().expect("it went somewhere");
        assert!((end.world_from_wrist.translation.x - 3.0).abs() < 1e-12);
    }
}
