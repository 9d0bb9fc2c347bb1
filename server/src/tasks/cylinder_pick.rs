//! Cylinder pick: a PSM picks up a standing cylinder and brings it to a goal.
//!
//! # Description
//!
//! A steel pin 6 mm long and 2.5 mm thick stands on a pad in a tray. PSM1 is to grasp it, lift it and bring its middle within
//! 5 mm of a point above the pad. It is round, so three translations and the jaw are enough. Fingers and cylinder touch
//! by friction alone: nothing ever attaches the cylinder to the jaws. It falls over where it is pushed.
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
//! | 5 | yaw; π/2 under `paper` | −π | π | rad |
//! | 6 | jaw angle: the opening between the fingers | −0.1 | 1.6 | rad |
//! | 7–9 | cylinder x, y, z (its middle), scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 10–12 | cylinder less wrist x, y, z, scene frame | −0.313, −0.323, −0.1722 | 0.213, 0.323, 0.2158 | m |
//! | 13–15 | middle of its upper end x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 16–18 | roll, pitch, yaw of the cylinder | −π, −π/2, −π | π, π/2, π | rad |
//!
//! The angles are extrinsic XYZ Euler angles, R = Rz(yaw)·Ry(pitch)·Rx(roll): 3–5 of the wrist-yaw
//! link, whose y axis points along the jaws and whose z axis is their hinge; 16–18 of the cylinder, whose z axis is its
//! axis. What is outside its range is shown at its end. Achieved goal: the middle of the cylinder (x, y, z, m); desired
//! goal: where it is to be. Both ignore `domain`'s noise and encoder errors.
//!
//! # Rewards
//!
//! `sparse` (default): 0 where the goals are less than 5 mm apart, −1 otherwise. `dense`: minus
//! their distance, m. Both are functions of the goals alone.
//!
//! # Starting State
//!
//! The wrist at the corner (0.50, 0.05, 0.7202) m, jaws closed and straight down. The cylinder stands on its end.
//! `spawn = "workspace"`: cylinder anywhere on the part of the pad that lies in the 10 cm workspace, goal uniform in the
//! workspace from 20 mm above the pad to its top (0.745 m). `spawn = "narrow"`, dVRL's ranges: cylinder and goal within
//! ±25 mm of the workspace's centre along x and y, goal 5 to 30 mm above the pad.
//!
//! # Episode End
//!
//! Truncated after 50 steps; never terminated.
//!
//! # Options
//!
//! `reward`, `action`, `observation`, `spawn`, and:
//!
//! - `grasp`: `interact`: friction alone; `approx`: an attachment between wrist and cylinder when jaws close whose
//!   tip is within `grasp_distance` (0.002 m) of it, through which the fingers then pass; `weld`:
//!   friction until it is 5 mm higher than it stood, then an attachment.
//! - `start`: `approach` (the open jaws are about the cylinder), `pick` (they hold it) or `lift` (as high
//!   as its goal): one of 64 states that the expert made, with a new goal, which the seed varies: jaws and object
//!   begin together anywhere that the object may lie, and rows of `domain` are drawn anew, see
//!   [`start`](super::start).
//! - `preset = "surrol"`: positions, goals and tolerance in units of 0.2 m (metres × 5), cylinder of
//!   10 g, gripped with 3 N instead of 1 N, `spawn = "narrow"` and `grasp = "weld"` unless given.
//! - `arm = "si"`: the arm of the S and Si in place of the first generation's, see
//!   [`psm_scene`](super::psm_scene); not with `preset = "surrol"`.
//! - `domain`: `mass` (0.5 to 5; factor on the mass, besides what the size makes of it: stiffness
//!   of contacts is per mass, so fingers sink into what is lighter), `size` (0.8 to 1.2; factor on
//!   all lengths) of the cylinder, `friction` (coefficient of the jaws), `observation_noise` (m, on
//!   observed positions), `joint_offset` (rad, on every rotary joint), `latency` (steps; the arm
//!   holds until the first action arrives), `pad_stiffness` (50 to 1000 N/m; 200 where only the depth is
//!   given) and `pad_depth` (0 to 0.002 m; 0.001 where only the stiffness is given): the pad gives by that
//!   much, jaws may be pressed into it, and the cylinder sinks with it. Without either, and at depth 0
//!   throughout, it is rigid.
//! - `setup`: `base` (x, y, z in m and turn in rad of the arm's base), `table_height` (m). The arm
//!   must reach the whole workspace.
//!
//! # Differences from dVRL's Pick
//!
//! - The cylinder is held by friction; dVRL's is attached to the gripper, as `grasp = "approx"` does.
//! - An action moves by up to 10 mm in 0.2 s; dVRL's by up to 1 mm.
//! - Success is 5 mm, as in all tasks; dVRL's 3 mm is `tolerance = 0.6`.
//! - Metres in the scene frame; dVRL divides positions by 25 mm.
//! - The wrist starts at a corner, dVRL's above the middle.
//!
//! # Version History
//!
//! - v0: first version.

use nalgebra::Vector3;
use trocar_proto::builtin::{self, TaskInfo};

use super::cylinder::Cylinder;
use super::expert::ExpertInput;
use super::options::{Domain, Preset};
use super::pad::Pad;
use super::picking::{Pickable, Picking};
use super::psm_scene::{self, Turn, WORKSPACE};
use super::tray;
use crate::render::Scene;
use crate::sim::frames::Pose;
use crate::sim::instrument::TIP_OFFSET;
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

/// How far the tip reaches below the middle when the jaws close, m, for a cylinder of size 1.
const GRASP_DEPTH: f64 = 2e-3;

/// How much higher than where it stood an attachment may hold it under `grasp = "weld"`, m.
const WELD_LIFT: f64 = 0.005;

/// Height of the lowest goal over the pad, m: as for needles.
const LOWEST_GOAL: f64 = 0.02;

/// Least and greatest height of goals over the pad under `spawn = "narrow"`, m. Source: dVRL's Pick.
const NARROW_HEIGHTS: [f64; 2] = [0.005, 0.03];

/// The task; see the module's description.
pub type CylinderPick = Picking<Cylinder>;

impl Pickable for Cylinder {
    const INFO: TaskInfo = builtin::CYLINDER_PICK;
    const PAPER: Turn = Turn::Nothing;
    const CONSTANT_UNDER_PAPER: &'static [&'static str] =
        &["wrist link roll", "wrist link pitch", "wrist link yaw"];
    const NAMES: [&'static str; 2] = ["cylinder", "upper end"];
    const CARRIED: &'static str = "cylinder";
    const SIZE: [f64; 2] = Cylinder::SIZE;

    fn furnish(preset: Preset, domain: Domain) -> (World, Option<Pad>, Self) {
        let (mut world, pad) = tray::padded_world(preset, domain);
        let cylinder = Cylinder::insert(&mut world, preset, domain);
        (world, Some(pad), cylinder)
    }

    const NARROW: f64 = Cylinder::NARROW;

    fn body(&self) -> BodyId {
        Cylinder::body(self)
    }

    fn size(&self) -> f64 {
        Cylinder::size(self)
    }

    fn vary(&mut self, world: &mut World, rng: &Rng) {
        Cylinder::vary(self, world, rng);
    }

    fn support(&self) -> f64 {
        tray::pad().max.z
    }

    fn lowest_goal() -> f64 {
        tray::pad().max.z + LOWEST_GOAL
    }

    fn narrow_goal(rng: &mut Rng) -> Vector3<f64> {
        let mut about = |middle: f64| middle + rng.uniform(-Cylinder::NARROW, Cylinder::NARROW);
        let (x, y) = (about(WORKSPACE.centre().x), about(WORKSPACE.centre().y));
        let [low, high] = NARROW_HEIGHTS;
        Vector3::new(x, y, tray::pad().max.z + rng.uniform(low, high))
    }

    fn lay(&mut self, narrow: bool, world: &mut World, rng: &mut Rng) {
        self.stand(narrow, world, rng);
    }

    fn place(&self, world: &World) -> Pose {
        self.upper_end(world)
    }

    fn carried(&self, world: &World) -> Vector3<f64> {
        world.pose(self.body()).translation.vector
    }

    fn is_lifted(&self, world: &World) -> bool {
        self.carried(world).z > tray::pad().max.z + self.half_length() + WELD_LIFT
    }

    fn grasp(
        &self,
        world: &World,
        pad: Option<&Pad>,
        _: &Pose,
        input: &ExpertInput<'_>,
    ) -> (Pose, f64) {
        let middle = input.pose(world, self.body()).translation.vector;
        let wrist = middle + Vector3::z() * (TIP_OFFSET - GRASP_DEPTH * self.size());
        (Pose::from_parts(wrist.into(), psm_scene::down()), pad.map_or(0.0, Pad::depth))
    }

    fn draw(&self, world: &World, pad: Option<&Pad>, scene: &mut Scene) {
        tray::draw_tray(scene);
        if let Some(pad) = pad {
            pad.draw(world, scene);
        }
        Cylinder::draw(self, world, scene);
    }
}
