//! Gauze retrieve: a PSM picks up a gauze and brings it to a goal.
//!
//! # Description
//!
//! A folded gauze swab lies in a tray. PSM1 is to grasp it by its pleat, lift it and bring its
//! middle within 5 mm of a point above the tray. Fingers and gauze touch by friction alone: nothing
//! ever attaches the gauze to the jaws. The gauze is rigid.
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
//! | 7–9 | gauze x, y, z (its middle), scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 10–12 | gauze less wrist x, y, z, scene frame | −0.313, −0.323, −0.1722 | 0.213, 0.323, 0.2158 | m |
//! | 13–15 | crest of the pleat x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 16–18 | roll, pitch, yaw of the gauze | −π, −π/2, −π | π, π/2, π | rad |
//!
//! The angles are extrinsic XYZ Euler angles, R = Rz(yaw)·Ry(pitch)·Rx(roll): 3–5 of the wrist-yaw
//! link, whose y axis points along the jaws and whose z axis is their hinge; 16–18 of the gauze,
//! whose x axis lies along the pleat. What is outside its range is shown at its end. Achieved goal:
//! the middle of the gauze (x, y, z, m); desired goal: where it is to be. Both ignore `domain`'s
//! noise and encoder errors.
//!
//! # Rewards
//!
//! `sparse` (default): 0 where the goals are less than 5 mm apart, −1 otherwise. `dense`: minus
//! their distance, m. Both are functions of the goals alone.
//!
//! # Starting State
//!
//! The wrist at the corner (0.50, 0.05, 0.7202) m, jaws closed and straight down. The gauze lies flat
//! on the floor of the tray, its pleat along x, as jaws need it that do not turn.
//! `spawn = "workspace"`: gauze anywhere wholly in the 10 cm workspace, goal uniform in the workspace
//! from 5 mm above the tray's rim to its top (0.745 m). `spawn = "narrow"`: the gauze's middle within
//! ±10 mm of the workspace's centre; goal normal about that centre with 20 mm along x and y, at the
//! height 0.7252 m.
//!
//! # Episode End
//!
//! Truncated after 50 steps; never terminated.
//!
//! # Options
//!
//! `reward`, `action`, `observation`, `spawn`, and:
//!
//! - `grasp`: `interact`: friction alone; `approx`: an attachment between wrist and gauze when jaws close whose
//!   tip is within `grasp_distance` (0.002 m) of it, through which the fingers then pass; `weld`:
//!   friction until it is 2.5 mm higher than it lay, then an attachment.
//! - `start`: `approach` (the open jaws are about the pleat), `pick` (they hold it) or `lift` (as high
//!   as its goal): one of 64 states that the expert made, with a new goal, which the seed varies: jaws and object
//!   begin together anywhere that the object may lie, and rows of `domain` are drawn anew, see
//!   [`start`](super::start).
//! - `preset = "surrol"`: positions, goals and tolerance in units of 0.2 m (metres × 5), gauze of
//!   50 g, gripped with 3 N instead of 1 N, `spawn = "narrow"` and `grasp = "weld"` unless given.
//! - `arm = "si"`: the arm of the S and Si in place of the first generation's, see
//!   [`psm_scene`](super::psm_scene); not with `preset = "surrol"`.
//! - `domain`: `mass` (0.5 to 5; factor on the mass, besides what the size makes of it: stiffness
//!   of contacts is per mass, so fingers sink into what is lighter), `size` (0.8 to 1.2; factor on
//!   all lengths) of the gauze, `friction` (coefficient of the jaws), `observation_noise` (m, on
//!   observed positions), `joint_offset` (rad, on every rotary joint), `latency` (steps; the arm
//!   holds until the first action arrives), `pad_stiffness` (50 to 1000 N/m; 200 where only the depth is
//!   given) and `pad_depth` (0 to 0.002 m; 0.001 where only the stiffness is given): the gauze lies on
//!   NeedlePick's pad, 2.8 mm higher than the floor, which gives by that much; jaws may be pressed into it,
//!   and the gauze sinks with it.
//! - `setup`: `base` (x, y, z in m and turn in rad of the arm's base), `table_height` (m). The arm
//!   must reach the whole workspace.
//!
//! # Differences from the original
//!
//! - The gauze is held by friction from beginning to end; the original fixes it to the wrist when
//!   it has risen by 2.5 mm.
//! - The gauze is as wide as it looks and is gripped by a pleat that one sees; the original's is a
//!   box of 4 × 2 × 3 mm.
//! - Metres instead of metres × 5; gauze and goal areas follow the paper (`narrow` is the code's).
//! - The gauze weighs 0.34 g (soaked cotton) instead of 50 g and lies at rest from the first step.
//! - dVRK's joint limits; the jaws stay above the tray instead of running into it.
//! - An instrument that would crush the gauze yields.
//! - The expert lifts straight up before it moves sideways. Seeds determine the episode.
//!
//! # Version History
//!
//! - v0: first version.

use nalgebra::Vector3;
use trocar_proto::builtin::{self, TaskInfo};

use super::expert::ExpertInput;
use super::gauze::{self, Gauze};
use super::objects;
use super::options::{Domain, Preset};
use super::pad::Pad;
use super::picking::{Pickable, Picking};
use super::psm_scene::{self, Turn};
use crate::render::Scene;
use crate::sim::frames::Pose;
use crate::sim::instrument::TIP_OFFSET;
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

/// Height of the tip over the sheet beside the pleat when the jaws close, m: they must not press on
/// it.
const GRASP_CLEARANCE: f64 = 0.15e-3;

/// Height above the tray's floor from which an attachment may hold the gauze under `grasp = "weld"`, m.
/// Source: the original, which takes 2.5 mm from where it lay.
const WELD_LIFT: f64 = 0.0025;

/// Height of the lowest goal over the tray's rim, m: a gauze that hangs in the jaws passes over it.
const LOWEST_GOAL: f64 = 0.005;

/// The task; see the module's description.
pub type GauzeRetrieve = Picking<LyingGauze>;

/// A gauze, and the height on which it lies, m.
#[derive(Debug, Clone)]
pub struct LyingGauze {
    gauze: Gauze,
    floor: f64,
}

impl Pickable for LyingGauze {
    const INFO: TaskInfo = builtin::GAUZE_RETRIEVE;
    const PAPER: Turn = Turn::Nothing;
    const CONSTANT_UNDER_PAPER: &'static [&'static str] =
        &["wrist link roll", "wrist link pitch", "wrist link yaw"];
    const NAMES: [&'static str; 2] = ["gauze", "crest"];
    const CARRIED: &'static str = "gauze";
    const SIZE: [f64; 2] = Gauze::SIZE;

    fn furnish(preset: Preset, domain: Domain) -> (World, Option<Pad>, Self) {
        let (mut world, pad) = gauze::furnished_world(preset, domain);
        let gauze = Gauze::insert(&mut world, preset, domain);
        (world, pad, Self { gauze, floor: gauze::floor(domain) })
    }

    const NARROW: f64 = Gauze::NARROW;

    fn body(&self) -> BodyId {
        self.gauze.body()
    }

    fn size(&self) -> f64 {
        self.gauze.size()
    }

    fn vary(&mut self, world: &mut World, rng: &Rng) {
        self.gauze.vary(world, rng);
    }

    fn support(&self) -> f64 {
        self.floor
    }

    fn lowest_goal() -> f64 {
        gauze::rim() + LOWEST_GOAL
    }

    fn narrow_goal(rng: &mut Rng) -> Vector3<f64> {
        objects::goal_near_the_middle(0.02, 0.7252, rng) // source: the original
    }

    fn lay(&mut self, narrow: bool, world: &mut World, rng: &mut Rng) {
        if narrow {
            self.gauze.lay_near_the_middle(world, rng);
        } else {
            self.gauze.lay_anywhere(world, rng);
        }
    }

    fn place(&self, world: &World) -> Pose {
        world.pose(self.body()) * Pose::from(self.gauze.crest())
    }

    fn carried(&self, world: &World) -> Vector3<f64> {
        world.pose(self.body()).translation.vector
    }

    fn is_lifted(&self, world: &World) -> bool {
        self.carried(world).z > self.floor + WELD_LIFT
    }

    fn grasp(
        &self,
        world: &World,
        pad: Option<&Pad>,
        _: &Pose,
        input: &ExpertInput<'_>,
    ) -> (Pose, f64) {
        let gauze = input.pose(world, self.body());
        let tip = gauze * Pose::translation(0.0, 0.0, self.gauze.sheet() + GRASP_CLEARANCE);
        let wrist = tip.translation.vector + Vector3::z() * TIP_OFFSET;
        // Fingers that press on the sheet while they close stay in touch with it.
        (Pose::from_parts(wrist.into(), psm_scene::down()), pad.map_or(0.0, Pad::depth))
    }

    fn draw(&self, world: &World, pad: Option<&Pad>, scene: &mut Scene) {
        if let Some(pad) = pad {
            pad.draw(world, scene);
        }
        self.gauze.draw(world, scene);
    }
}
