//! Effort of a motion: path lengths of the tips and largest forces of the jaws.

use std::ops::AddAssign;

use super::{Profile, Way};
use crate::sim::instrument::Posture;

/// What instruments did in some time, all of them together.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Effort {
    /// Length of the paths of their tips, m; a path is the polygon through where a tip is after each substep.
    pub tip_path: f64,
    /// Largest force between a jaw and a touched body, N, averaged over 1/60 s; 0 if the jaws touched nothing. Friction
    /// is excluded.
    pub peak_force: f64,
    /// Largest mean pressure of tissue on a finger or wrist, Pa, each the average of a substep.
    pub tissue_pressure: f64,
}

impl AddAssign for Effort {
    /// Goes on to what was done afterwards, or elsewhere.
    fn add_assign(&mut self, other: Self) {
        self.tip_path += other.tip_path;
        self.peak_force = self.peak_force.max(other.peak_force);
        self.tissue_pressure = self.tissue_pressure.max(other.tissue_pressure);
    }
}

/// How far the directions of two jaws may be apart for a turn to be one about them.
const ALONG_JAWS: f64 = 1e-9;

impl Way {
    /// Length of the path of the tip, m, from `start` on until `done` of `substeps` substeps' worth of it are covered.
    pub(super) fn tip_path(&self, start: &Posture, done: u32, substeps: u32) -> f64 {
        let tip = |posture: &Posture| posture.world_from_tip().translation.vector;
        if is_straight(&self.profile) {
            return (tip(&self.along(done, done, substeps)) - tip(start)).norm();
        }
        let mut last = tip(start);
        let mut length = 0.0;
        for now in self.done + 1..=done {
            let next = tip(&self.along(now, now, substeps));
            length += (next - last).norm();
            last = next;
        }
        length
    }
}

/// Whether the tip moves along a straight line and never back: then the polygon is as long as its chord.
fn is_straight(profile: &Profile) -> bool {
    let Profile::Smoothstep { start, end } = profile else { return false };
    let [one, other] = [start, end].map(|posture| posture.world_from_wrist.rotation);
    let jaws = nalgebra::Vector3::z();
    one == other || (one * jaws - other * jaws).norm_squared() < ALONG_JAWS * ALONG_JAWS
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::sim::frames;
    use crate::sim::instrument::{Instrument, JAW_CLOSED, TIP_OFFSET};
    use crate::sim::motion::Motion;
    use crate::sim::world::{self, Part, Shape, Solver, World};

    const SUBSTEPS: u32 = 48;

    /// Where the tip of closed jaws is, m, and how it is turned.
    fn posture(tip: [f64; 3], turn: [f64; 3]) -> Posture {
        let tip = frames::pose(tip, turn);
        let world_from_wrist = tip * frames::Pose::translation(0.0, 0.0, -TIP_OFFSET);
        Posture { world_from_wrist, jaw: JAW_CLOSED }
    }

    /// A world in which nothing is in the way; where `falls`, time must pass in it all the same.
    fn empty(falls: bool) -> World {
        let mut world = World::new(Solver::LIGHT);
        let cube = Part {
            body_from_part: frames::Pose::identity(),
            shape: Shape::Cuboid(Vector3::repeat(5e-3)),
        };
        let far = frames::Pose::translation(0.5, 0.0, 1.0);
        let cube = world.insert(world::Motion::Free { mass: 1e-3 }, &far, 1.0, &[cube]);
        if falls {
            world.wake(cube);
        }
        world
    }

    /// What each way of letting the time of a motion pass gives: at once, in two parts, substep by substep.
    fn efforts<const N: usize>(starts: [Posture; N], profiles: &[Profile; N]) -> [Effort; 3] {
        [(false, SUBSTEPS), (false, SUBSTEPS / 2), (true, SUBSTEPS)].map(|(falls, part)| {
            let mut world = empty(falls);
            let mut arms = starts.map(|start| Instrument::insert(&mut world, start, 1.0));
            let mut arms: Vec<_> = arms.iter_mut().collect();
            let mut motion = Motion::new(profiles.iter().cloned(), SUBSTEPS);
            let mut effort = Effort::default();
            while motion.left() > 0 {
                effort += motion.pass(part, &mut arms, &mut world);
            }
            effort
        })
    }

    #[test]
    fn the_path_of_a_straight_move_is_its_length() {
        let turned = [std::f64::consts::PI, 0.0, 0.3];
        let (start, end) = (posture([0.0, 0.0, 0.1], turned), posture([3e-3, 4e-3, 0.112], turned));
        for effort in efforts([start], &[Profile::Smoothstep { start, end }]) {
            assert!((effort.tip_path - 13e-3).abs() < 1e-12, "{effort:?}");
            assert_eq!(effort.peak_force.to_bits(), 0.0_f64.to_bits());
        }
        // On beyond a set-point and no farther than the middle of the way to the next: half of both ways.
        let bend = Profile::Bend { start, via: end, end: posture([3e-3, 4e-3, 0.122], turned) };
        let [once, parts, substeps] = efforts([start], &[bend]).map(|effort| effort.tip_path);
        assert!((once - parts).abs() < 1e-15 && (once - substeps).abs() < 1e-12);
        assert!(once > 22e-3 && once < 23e-3, "{once}");
    }

    #[test]
    fn the_path_of_a_turn_is_its_arc_and_not_the_chord() {
        let angle = 0.5;
        let wrist = |pitch: f64| Posture {
            world_from_wrist: frames::pose(
                [0.0, 0.0, 0.1],
                [std::f64::consts::PI + pitch, 0.0, 0.0],
            ),
            jaw: JAW_CLOSED,
        };
        let (start, end) = (wrist(0.0), wrist(angle));
        for effort in efforts([start], &[Profile::Smoothstep { start, end }]) {
            let ratio = effort.tip_path / (TIP_OFFSET * angle);
            // The chord is 1.0 % shorter, the polygon of 48 sides a millionth for each of them.
            assert!((ratio - 1.0).abs() < 1e-5, "{ratio}");
        }
        // About the jaws themselves, nothing of the tip's moves.
        let end = Posture {
            world_from_wrist: start.world_from_wrist * frames::pose([0.0; 3], [0.0, 0.0, 0.5]),
            ..start
        };
        for effort in efforts([start], &[Profile::Smoothstep { start, end }]) {
            assert!(effort.tip_path < 1e-12, "{effort:?}");
        }
    }

    #[test]
    fn the_paths_of_two_arms_add_up() {
        let down = [std::f64::consts::PI, 0.0, 0.0];
        let starts = [posture([0.0, 0.0, 0.1], down), posture([0.1, 0.0, 0.1], down)];
        let ends = [posture([0.0, 6e-3, 0.1], down), posture([0.1, 0.0, 0.108], down)];
        let profile = |index: usize| Profile::Smoothstep { start: starts[index], end: ends[index] };
        for effort in efforts(starts, &[profile(0), profile(1)]) {
            assert!((effort.tip_path - 14e-3).abs() < 1e-12, "{effort:?}");
        }
    }
}
