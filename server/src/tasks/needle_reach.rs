//! Needle reach: the closed jaw tip of a PSM goes to a point just above a needle.
//!
//! # Description
//!
//! A needle of 40 mm lies on a pad in a tray. The tip of PSM1's closed jaws, which points straight
//! down, must come within 5 mm of a point 5 mm above the middle of the needle's arc. The needle is
//! a real object: the instrument can push it, and the goal stays where it was.
//!
//! # Action Space
//!
//! `action = "paper"`, each number in [−1, 1]; the other modes are in [`psm_scene`](super::psm_scene).
//!
//! | Num | Meaning | Min | Max | Unit |
//! |---|---|---|---|---|
//! | 0 | dx, scene frame | −1 | 1 | 10 mm |
//! | 1 | dy, scene frame | −1 | 1 | 10 mm |
//! | 2 | dz, scene frame | −1 | 1 | 10 mm |
//! | 3 | ignored (turn in other tasks) | −1 | 1 | – |
//! | 4 | ignored (jaw in other tasks) | −1 | 1 | – |
//!
//! The movement starts from the sensed wrist, takes 0.2 s along a smooth profile, and is confined
//! to the workspace: see [`psm_scene`](super::psm_scene). The jaws stay closed in every mode.
//!
//! # Observation Space
//!
//! | Num | Meaning | Min | Max | Unit |
//! |---|---|---|---|---|
//! | 0 | wrist x (wrist-yaw axis, as sensed), scene frame | 0.495 | 0.605 | m |
//! | 1 | wrist y | −0.055 | 0.055 | m |
//! | 2 | wrist z | 0.6842 | 0.7722 | m |
//! | 3 | roll of the wrist link; −π/2 under `paper` | −π | π | rad |
//! | 4 | pitch; 0 under `paper` | −π/2 | π/2 | rad |
//! | 5 | yaw; π/2 under `paper` | −π | π | rad |
//! | 6 | jaw angle; always 0 | −0.1 | 1.6 | rad |
//!
//! The angles are extrinsic XYZ Euler angles, R = Rz(yaw)·Ry(pitch)·Rx(roll), of the wrist-yaw link,
//! whose y axis points along the jaws and whose z axis is their hinge. Achieved goal: the true tip
//! (x, y, z, m), 10.2 mm from the wrist; desired goal: the point above the needle. Both ignore
//! `domain`'s noise and encoder errors.
//!
//! # Rewards
//!
//! `sparse` (default): 0 where the goals are less than 5 mm apart, −1 otherwise. `dense`: minus
//! their distance, m. Both are functions of the goals alone.
//!
//! # Starting State
//!
//! The wrist at the corner (0.50, 0.05, 0.7552) m, jaws closed and straight down. The needle lies
//! flat, turned by up to ±90°. `spawn = "workspace"`: anywhere wholly on the part of the pad that
//! lies in the 10 cm workspace. `spawn = "narrow"`: the centre of its circle within ±10 mm of the
//! workspace's centre.
//!
//! # Episode End
//!
//! Truncated after 50 steps; never terminated.
//!
//! # Options
//!
//! `reward`, `action`, `observation`, `spawn`, and:
//!
//! - `preset = "surrol"`: positions, goals and tolerance in units of 0.2 m (metres × 5), needle of
//!   10 g, `spawn = "narrow"` unless given.
//! - `arm = "si"`: the arm of the S and Si in place of the first generation's, see
//!   [`psm_scene`](super::psm_scene); not with `preset = "surrol"`.
//! - `domain`: `mass` (0.5 to 5; factor on the mass, besides what the size makes of it: stiffness
//!   of contacts is per mass, so fingers sink into what is lighter), `size` (0.8 to 1.2; factor on
//!   all lengths) of the needle, `observation_noise` (m, on observed positions), `joint_offset`
//!   (rad, on every rotary joint), `latency` (steps; the arm holds until the first action
//!   arrives).
//! - `setup`: `base` (x, y, z in m and turn in rad of the arm's base), `table_height` (m). The arm
//!   must reach the whole workspace.
//!
//! # Differences from the original
//!
//! - Metres instead of metres × 5; the needle's area follows the paper (`narrow` is the code's).
//! - The needle weighs 0.36 g (steel) instead of 10 g and lies at rest from the first step.
//! - dVRK's joint limits; the jaws stay above the pad instead of running into it.
//! - An instrument that would crush the needle yields.
//! - Seeds determine the episode.
//!
//! # Version History
//!
//! - v0: first version.

use nalgebra::Vector3;
use trocar_proto::builtin::{self, TaskInfo};

use super::options::{Domain, Preset};
use super::reaching::{Reachable, Reaching};
use super::tray::Needle;
use crate::render::Scene;
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

/// The task; see the module's description.
pub type NeedleReach = Reaching<Needle>;

impl Reachable for Needle {
    const INFO: TaskInfo = builtin::NEEDLE_REACH;
    const NAME: &'static str = "needle";
    const SIZE: [f64; 2] = Needle::SIZE;

    fn insert(world: &mut World, preset: Preset, domain: Domain) -> Self {
        Needle::insert(world, preset, domain)
    }

    fn body(&self) -> BodyId {
        Needle::body(self)
    }

    fn lay(&mut self, narrow: bool, world: &mut World, rng: &mut Rng) {
        if narrow {
            self.lay_near_the_middle(world, rng);
        } else {
            self.lay_anywhere(world, rng);
        }
    }

    fn reached(&self, world: &World) -> Vector3<f64> {
        self.scene_from_middle(world).translation.vector
    }

    fn draw(&self, world: &World, scene: &mut Scene) {
        Needle::draw(self, world, scene);
    }
}

#[cfg(test)]
mod tests {
    use trocar_proto::Options;

    use super::*;
    use crate::assets::Model;
    use crate::sim::frames::Aabb;
    use crate::tasks::psm_scene::{RATE, STEP_LENGTH, WORKSPACE};
    use crate::tasks::{Registered, Task, time, tray};

    #[test]
    fn the_goal_is_above_a_needle_that_lies_wholly_on_pad_and_workspace() {
        let options = Options::new().resolve(&NeedleReach::options()).unwrap();
        let (mut task, mut world) = NeedleReach::new(&options).unwrap();
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for seed in 0..500 {
            task.reset(&mut world, &mut Rng::new(seed, 0));
            let middle = task.object.scene_from_middle(&world).translation.vector;
            assert!((task.goal - middle - Vector3::new(0.0, 0.0, 0.005)).norm() < 1e-12);
            assert!((middle.z - tray::pad().max.z - 0.5e-3).abs() < 1e-6);
            assert!(WORKSPACE.meets(&Aabb::around([middle.into()])));
            low = low.min(middle.x);
            high = high.max(middle.x);
        }
        assert!(low < 0.505 && high > 0.575, "{low} to {high}");
    }

    #[test]
    fn jaws_that_point_down_never_press_the_needle_through_the_pad_nor_shoot_it_away() {
        attack_the_needle("paper");
    }

    #[test]
    fn jaws_that_tilt_never_press_the_needle_through_the_pad_nor_shoot_it_away() {
        attack_the_needle("cartesian");
    }

    /// An arm that presses on the needle, pushes it about and sweeps over it, for 10,000 steps.
    fn attack_the_needle(mode: &str) {
        /// Fastest that the needle may become, m/s: ten times the instrument.
        const FASTEST: f64 = 1.5;
        let options = Options::new().with_text("action", mode);
        let options = options.resolve(&NeedleReach::options()).unwrap();
        let (mut task, prepared) = NeedleReach::new(&options).unwrap();
        let mut actions = Rng::new(17, 0);
        let mut action = vec![0.0; task.action().len()];
        let (mut lowest, mut fastest, mut touched) = (f64::INFINITY, 0.0_f64, 0);
        for episode in 0..200 {
            let mut world = prepared.clone();
            task.reset(&mut world, &mut Rng::new(episode, 0));
            let laid = world.pose(task.object.body());
            for _ in 0..50 {
                for number in &mut action {
                    *number = actions.uniform(-1.0, 1.0) as f32;
                }
                if actions.unit() < 0.7 {
                    let needle = world.pose(task.object.body());
                    let parts = &Model::needle().parts;
                    let part = parts[actions.index(parts.len())].body_from_part;
                    let to = (needle * part).translation.vector - task.arm.tip();
                    let down = if to.xy().norm() < 0.003 { -0.01 } else { to.z };
                    let to = Vector3::new(to.x, to.y, down) / STEP_LENGTH;
                    for axis in 0..3 {
                        action[axis] = to[axis].clamp(-1.0, 1.0) as f32;
                    }
                }
                time::step(&mut task, &mut world, Some(&action), RATE.substeps());
                let needle = world.pose(task.object.body());
                let over_pad = tray::pad().grown(-1e-3);
                for part in &Model::needle().parts {
                    let middle = (needle * part.body_from_part).translation.vector;
                    let inside = over_pad.clamp(&middle).xy() == middle.xy();
                    if inside && middle.z > tray::pad().min.z {
                        lowest = lowest.min(middle.z - tray::pad().max.z);
                    }
                }
                fastest = fastest.max(world.velocity(task.object.body()).norm());
                assert!(world.is_finite());
            }
            touched += usize::from(world.pose(task.object.body()) != laid);
        }
        assert!(lowest > 0.0, "{mode}: the wire's axis was {lowest} m above the pad");
        assert!(fastest < FASTEST, "{mode}: {fastest}");
        assert!(touched > 150, "{mode}: {touched}");
    }
}
