//! Needle pick: a PSM picks up a needle and brings the middle of its arc to a goal.
//!
//! # Description
//!
//! A needle of 40 mm lies on a pad in a tray. PSM1 is to grasp it, lift it and bring the middle of
//! its arc within 5 mm of a point above the pad. By default fingers and needle touch by friction
//! alone: nothing ever attaches the needle to the jaws.
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
//! | 3 | turn about the vertical | −1 | 1 | 30° |
//! | 4 | jaw: below 0 close, else open to 40° | −1 | 1 | – |
//!
//! The movement starts from the sensed wrist, takes 0.2 s along a smooth profile, and is confined
//! to the workspace: see [`psm_scene`](super::psm_scene).
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
//! | 5 | yaw; π/2 at the start | −π | π | rad |
//! | 6 | jaw angle: the opening between the fingers | −0.1 | 1.6 | rad |
//! | 7–9 | needle x, y, z (centre of its arc), scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 10–12 | needle less wrist x, y, z, scene frame | −0.313, −0.323, −0.1722 | 0.213, 0.323, 0.2158 | m |
//! | 13–15 | middle of the arc x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 16–18 | roll, pitch, yaw of the needle at its middle | −π, −π/2, −π | π, π/2, π | rad |
//!
//! The angles are extrinsic XYZ Euler angles, R = Rz(yaw)·Ry(pitch)·Rx(roll): 3–5 of the wrist-yaw
//! link, whose y axis points along the jaws and whose z axis is their hinge; 16–18 of a frame whose
//! x axis points to the centre of the arc and whose y axis lies along the wire, towards the
//! swage. What is outside its range is shown at its end. Achieved goal: the middle of the arc (x,
//! y, z, m); desired goal: where it is to be. Both ignore `domain`'s noise and encoder errors.
//!
//! # Rewards
//!
//! `sparse` (default): 0 where the goals are less than 5 mm apart, −1 otherwise. `dense`: minus
//! their distance, m. Both are functions of the goals alone.
//!
//! # Starting State
//!
//! The wrist at the corner (0.50, 0.05, 0.7202) m, jaws closed and straight down. The needle lies
//! flat, turned by up to ±90°. `spawn = "workspace"`: needle anywhere wholly on the part of the pad
//! that lies in the 10 cm workspace, goal uniform in the workspace from 20 mm above the pad, over
//! the tray's rim, to its top (0.745 m). `spawn = "narrow"`: the centre of the needle's circle within
//! ±10 mm of the workspace's centre; goal normal about that centre with 10 mm along x and y, at the
//! height 0.7152 m.
//!
//! # Episode End
//!
//! Truncated after 50 steps; never terminated.
//!
//! # Options
//!
//! `reward`, `action`, `observation`, `spawn`, and:
//!
//! - `grasp`: `interact`: friction alone; `approx`: an attachment between wrist and needle when jaws close
//!   whose tip is within `grasp_distance` (0.002 m) of the wire, through which the fingers then pass;
//!   `weld`: friction until the middle of the arc is 5 mm higher than it lay, then an attachment.
//! - `start`: `approach` (the open jaws are about the wire), `pick` (they hold it) or `lift` (as high
//!   as its goal): one of 64 states that the expert made, with a new goal, which the seed varies: jaws and object
//!   begin together anywhere that the object may lie, and rows of `domain` are drawn anew, see
//!   [`start`](super::start).
//! - `preset = "surrol"`: positions, goals and tolerance in units of 0.2 m (metres × 5), needle of
//!   10 g, gripped with 3 N instead of 1 N, `spawn = "narrow"` and `grasp = "weld"` unless given.
//! - `arm = "si"`: the arm of the S and Si in place of the first generation's, see
//!   [`psm_scene`](super::psm_scene); not with `preset = "surrol"`.
//! - `domain`: `mass` (0.5 to 5; factor on the mass, besides what the size makes of it: stiffness
//!   of contacts is per mass, so fingers sink into what is lighter), `size` (0.8 to 1.2; factor on
//!   all lengths) of the needle, `friction` (coefficient of the jaws), `observation_noise` (m, on
//!   observed positions), `joint_offset` (rad, on every rotary joint), `latency` (steps; the arm
//!   holds until the first action arrives), `pad_stiffness` (50 to 1000 N/m; 200 where only the depth is
//!   given) and `pad_depth` (0 to 0.002 m; 0.001 where only the stiffness is given): the pad gives by that
//!   much, jaws may be pressed into it, and the needle sinks with it. Without either, and at depth 0
//!   throughout, it is rigid.
//! - `setup`: `base` (x, y, z in m and turn in rad of the arm's base), `table_height` (m). The arm
//!   must reach the whole workspace.
//!
//! # Differences from the original
//!
//! - The needle is held by friction from beginning to end; the original fixes it to the wrist when
//!   it has risen by 5 mm, as `grasp = "weld"` does.
//! - Metres instead of metres × 5; needle and goal areas follow the paper (`narrow` is the code's).
//! - The needle weighs 0.36 g (steel) instead of 10 g and lies at rest from the first step.
//! - dVRK's joint limits; the jaws stay above the pad instead of running into it.
//! - An instrument that would crush the needle yields.
//! - The expert lifts straight up before it moves sideways. Seeds determine the episode.
//!
//! # Version History
//!
//! - v0: first version.

use nalgebra::Vector3;
use trocar_proto::builtin::{self, TaskInfo};

use super::expert::ExpertInput;
use super::objects;
use super::options::{Domain, Preset};
use super::pad::Pad;
use super::pick;
use super::picking::{Pickable, Picking};
use super::psm_scene::{Turn, WORKSPACE};
use super::tray::{self, Needle};
use crate::render::Scene;
use crate::sim::frames::{Aabb, Pose};
use crate::sim::instrument::TIP_OFFSET;
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

/// How far the tip reaches below the middle of the wire when the jaws close, m, for a needle of size
/// 1: the finger's end is then as far above the pad as it may be.
const GRASP_DEPTH: f64 = 0.45e-3;

/// How far below the grasp the expert sends the wrist, m: it bears heights that are wrong by half as much.
const PRESS: f64 = 2e-3;

/// Height of the middle of the arc above the pad from which an attachment may hold the needle under
/// `grasp = "weld"`, m. Source: the original, which takes 5 mm from where it lay.
const WELD_LIFT: f64 = 0.0055;

/// Height of the lowest goal over the pad, m: above the tray's rim, which a needle that is held at
/// its middle would otherwise meet.
const LOWEST_GOAL: f64 = 0.02;

/// The task; see the module's description.
pub type NeedlePick = Picking<Needle>;

impl Pickable for Needle {
    const INFO: TaskInfo = builtin::NEEDLE_PICK;
    const PAPER: Turn = Turn::Vertical;
    const CONSTANT_UNDER_PAPER: &'static [&'static str] = &["wrist link roll", "wrist link pitch"];
    const NAMES: [&'static str; 2] = ["needle", "mid arc"];
    const CARRIED: &'static str = "mid arc";
    const SIZE: [f64; 2] = Needle::SIZE;

    fn furnish(preset: Preset, domain: Domain) -> (World, Option<Pad>, Self) {
        let (mut world, pad) = tray::padded_world(preset, domain);
        let needle = Needle::insert(&mut world, preset, domain);
        (world, Some(pad), needle)
    }

    const NARROW: f64 = Needle::NARROW;

    fn body(&self) -> BodyId {
        Needle::body(self)
    }

    fn size(&self) -> f64 {
        self.form().size()
    }

    fn vary(&mut self, world: &mut World, rng: &Rng) {
        Needle::vary(self, world, rng);
    }

    fn area() -> Aabb {
        let (pad, reach) = (tray::pad(), WORKSPACE);
        Aabb { min: pad.min.sup(&reach.min), max: pad.max.inf(&reach.max) }
    }

    fn support(&self) -> f64 {
        tray::pad().max.z
    }

    fn lowest_goal() -> f64 {
        tray::pad().max.z + LOWEST_GOAL
    }

    fn narrow_goal(rng: &mut Rng) -> Vector3<f64> {
        objects::goal_near_the_middle(0.01, 0.7152, rng) // source: the original
    }

    fn lay(&mut self, narrow: bool, world: &mut World, rng: &mut Rng) {
        if narrow {
            self.lay_near_the_middle(world, rng);
        } else {
            self.lay_anywhere(world, rng);
        }
    }

    fn place(&self, world: &World) -> Pose {
        self.scene_from_middle(world)
    }

    fn carried(&self, world: &World) -> Vector3<f64> {
        self.scene_from_middle(world).translation.vector
    }

    fn is_lifted(&self, world: &World) -> bool {
        self.scene_from_middle(world).translation.z > tray::pad().max.z + WELD_LIFT
    }

    fn grasp(
        &self,
        world: &World,
        _: Option<&Pad>,
        wrist: &Pose,
        input: &ExpertInput<'_>,
    ) -> (Pose, f64) {
        let middle = Pose::from(input.position_error) * self.scene_from_middle(world);
        let wire = middle.rotation * Vector3::y();
        let above = Vector3::z() * (TIP_OFFSET - GRASP_DEPTH * self.form().size());
        let at = middle.translation.vector + above;
        (Pose::from_parts(at.into(), pick::jaws_across(&wire, wrist)), PRESS)
    }

    fn draw(&self, world: &World, pad: Option<&Pad>, scene: &mut Scene) {
        tray::draw_tray(scene);
        if let Some(pad) = pad {
            pad.draw(world, scene);
        }
        Needle::draw(self, world, scene);
    }
}

#[cfg(test)]
mod tests {
    use trocar_proto::Options;

    use super::*;
    use crate::tasks::{Registered, Task, time};

    /// Lets the expert work for `steps` steps on what it is told.
    fn work(task: &mut NeedlePick, world: &mut World, input: &ExpertInput<'_>, steps: u32) {
        let mut action = vec![0.0; task.action().len()];
        for _ in 0..steps {
            Task::expert(task, world, input, &mut action);
            let substeps = task.arm.rate().substeps();
            time::step(task, world, Some(&action), substeps);
        }
    }

    fn episode(seed: u64) -> (NeedlePick, World) {
        let options = Options::new().resolve(&NeedlePick::options()).unwrap();
        let (mut task, mut world) = NeedlePick::new(&options).unwrap();
        Task::reset(&mut task, &mut world, &mut Rng::new(seed, 0));
        (task, world)
    }

    fn is_there(task: &NeedlePick, world: &World) -> bool {
        let middle = task.object.scene_from_middle(world).translation.vector;
        (middle - task.goal).norm() < objects::TOLERANCE
    }

    #[test]
    fn the_height_of_a_grasp_is_found_by_touch() {
        for off in [-1e-3, 1e-3] {
            let input =
                ExpertInput { position_error: Vector3::z() * off, ..ExpertInput::default() };
            for seed in 0..4 {
                let (mut task, mut world) = episode(seed);
                work(&mut task, &mut world, &input, NeedlePick::INFO.steps);
                assert!(is_there(&task, &world), "{seed}, {off} m too high");
            }
        }
    }

    #[test]
    fn a_needle_that_slipped_away_is_picked_up_again() {
        let input = ExpertInput::default();
        for seed in 0..4 {
            let (mut task, mut world) = episode(seed);
            let mut taken = 0;
            while taken == 0 || !task.arm.holds(&world, task.object.body()) {
                work(&mut task, &mut world, &input, 1);
                taken += 1;
                assert!(taken < NeedlePick::INFO.steps);
            }
            // Out of the jaws, and a little farther.
            let lying = world.pose(task.object.body());
            task.object.lay_near_the_middle(&mut world, &mut Rng::new(seed, 1));
            assert!(
                (world.pose(task.object.body()).translation.vector - lying.translation.vector)
                    .norm()
                    > 1e-3
            );
            work(&mut task, &mut world, &input, NeedlePick::INFO.steps - 10);
            assert!(is_there(&task, &world), "{seed}");
        }
    }
}
