//! Peg transfer: a PSM takes a block from one peg to another.
//!
//! # Description
//!
//! Four blocks, triangular rings, stand on a board about pegs. PSM1 is to lift one of them off its
//! peg and put it onto another one. Fingers and block touch by friction alone: nothing ever attaches a
//! block to the jaws.
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
//! | 7–9 | block x, y, z (its centre), scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 10–12 | block less wrist x, y, z, scene frame | −0.313, −0.323, −0.1722 | 0.213, 0.323, 0.2158 | m |
//! | 13–15 | middle of the block's wall 1 x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 16–18 | roll, pitch, yaw of that wall | −π, −π/2, −π | π, π/2, π | rad |
//!
//! The angles are extrinsic XYZ Euler angles, R = Rz(yaw)·Ry(pitch)·Rx(roll): 3–5 of the wrist-yaw
//! link, whose y axis points along the jaws and whose z axis is their hinge; 16–18 of a frame whose
//! x axis points from the wall to the axis of the block, which is its z axis. What is outside its
//! range is shown at its end. Achieved goal: the centre of the block (x, y, z, m); desired goal: the
//! centre of the target peg. Both ignore `domain`'s noise and encoder errors.
//!
//! # Rewards
//!
//! `sparse` (default): 0 where the block is on the peg, −1 otherwise. It is on the peg where the goals
//! are less than 5 mm apart in x and y and less than 4 mm in z: a block that stands on the board is
//! 3.75 mm below the peg's centre. The jaws may still hold it. `dense`: minus the distance of the
//! goals, m. Both are functions of the goals alone.
//!
//! # Starting State
//!
//! The wrist at the corner (0.50, 0.05, 0.7552) m, jaws closed and straight down. Four blocks stand
//! about pegs drawn from the six sources, each turned by up to ±30°; one of them is to go to a peg
//! drawn from the six targets.
//!
//! # Episode End
//!
//! Truncated after 50 steps; never terminated.
//!
//! # Options
//!
//! `reward`, `action`, `observation`, and:
//!
//! - `grasp`: `interact`: friction alone; `approx`: an attachment between wrist and block when jaws close whose
//!   tip is within `grasp_distance` (0.002 m) of it, through which the fingers then pass; `weld`:
//!   friction until the block's centre is 10 mm above those of the pegs, then an attachment.
//! - `start`: `approach` (the open jaws are about a wall), `pick` (they hold it) or `lift` (above the
//!   pegs): one of 64 states that the expert made, with a new target, which the seed varies: jaws and block
//!   begin up to 15 mm beside (lifted) or 1 mm beside along x and y, other blocks are turned about their pegs, and rows
//!   of `domain` are drawn anew, see [`start`](super::start).
//! - `preset = "surrol"`: positions, goals and tolerances in units of 0.2 m (metres × 5), blocks of
//!   10 g, gripped with 3 N instead of 1 N, `grasp = "weld"` unless given.
//! - `arm = "si"`: the arm of the S and Si in place of the first generation's, see
//!   [`psm_scene`](super::psm_scene); not with `preset = "surrol"`.
//! - `domain`: `mass` (0.5 to 5; factor on the mass, besides what the size makes of it: stiffness
//!   of contacts is per mass, so fingers sink into what is lighter), `size` (0.98 to 1.1; factor
//!   on all lengths) of all blocks: a block below 0.966 that stands about its peg is more than 4
//!   mm below its middle, `friction` (coefficient of the jaws), `observation_noise` (m, on
//!   observed positions), `joint_offset` (rad, on every rotary joint), `latency` (steps; the arm
//!   holds until the first action arrives).
//! - `setup`: `base` (x, y, z in m and turn in rad of the arm's base), `table_height` (m). The arm
//!   must reach the whole workspace.
//!
//! # Differences from the original
//!
//! - The block is held by friction from beginning to end; the original fixes it to the wrist when it
//!   is 10 mm above the pegs' centres.
//! - Metres instead of metres × 5.
//! - Blocks weigh 1.44 g (acetal) instead of 10 g, and stand on the board from the first step instead
//!   of falling onto it.
//! - dVRK's joint limits; the jaws stay above the board instead of running into it.
//! - An instrument that would crush a block yields.
//! - The expert grasps the wall to which it has to turn least, with one finger in the middle of the
//!   room between wall and peg. Seeds determine the episode.
//!
//! # Version History
//!
//! - v0: first version.

use nalgebra::Vector3;
use trocar_proto::builtin::{self, TaskInfo};
use trocar_proto::relative::Relative;
use trocar_proto::spec::{Element, GoalSpec, OptionSpec};
use trocar_proto::{Options, Rejection, Stage};

use super::expert::{ArmView, ExpertInput};
use super::objects;
use super::options::{self, Preset};
use super::peg_board::{Block, Layout, PegBoard};
use super::peg_expert::{self, Transfer};
use super::psm_scene::{self, PaperAction, PsmArm, Station, Turn, WORKSPACE};
use super::relative::Grasping;
use super::start::{self, Extent, Start};
use super::theatre;
use super::tray;
use super::{Arms, Registered, State, Task};
use crate::render::Scene;
use crate::sim::grasp::Grasp;
use crate::sim::instrument::TIP_OFFSET;
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

/// Number of blocks. Source: the original.
const BLOCKS: usize = 4;

/// The wall of the block that is observed. Source: the original.
const WALL: usize = 1;

/// Height of the block's centre above that of its target from which an attachment may hold it under
/// `grasp = "weld"`, m. Source: the original.
const WELD_LIFT: f64 = 0.01;

/// The task; see the module's description.
#[derive(Debug, Clone)]
pub struct PegTransfer {
    arm: PsmArm,
    board: PegBoard,
    grasp: Grasp,
    start: Start,
    preset: Preset,
    layout: Layout,
}

impl Registered for PegTransfer {
    const INFO: TaskInfo = builtin::PEG_TRANSFER;
    const CONSTANT_UNDER_PAPER: &'static [&'static str] = &["wrist link roll", "wrist link pitch"];

    fn options() -> Vec<OptionSpec> {
        objects::options(1, Block::SIZE, [start::option()], [])
    }

    fn new(options: &Options) -> Result<(Self, World), Rejection> {
        let preset = options::preset_of(options);
        let mut world = tray::bare_table(preset);
        let board = PegBoard::insert(&mut world, preset, BLOCKS, options::Domain::of(options)?);
        let paper = PaperAction { turn: Turn::Vertical, jaw: true };
        let start = [WORKSPACE.min.x, WORKSPACE.max.y, WORKSPACE.max.z + TIP_OFFSET];
        let station = Station::psm1(start, PegBoard::top());
        let layout = Layout { block: board.blocks()[0], target: 0 };
        let grasp = Grasp::new(&mut world, options::grasp_of(options), layout.block.body());
        let task = Self {
            arm: PsmArm::insert(&mut world, options, paper, station)?,
            layout,
            grasp,
            start: Start::of(options),
            board,
            preset,
        };
        Ok((task, world))
    }
}

impl Task for PegTransfer {
    fn action(&self) -> Vec<Element> {
        self.arm.action_elements()
    }

    fn goal(&self) -> Option<GoalSpec> {
        Some(PegBoard::goal_spec(self.preset))
    }

    fn relative(&self, _: &[Element]) -> Relative {
        let grasping = Grasping {
            arms: [&self.arm],
            object: "block",
            places: ["wall 1"],
            grips: [peg_expert::grips_on_peg(self.layout.block, WALL)],
            level: Some(peg_expert::clear_of_pegs(self.layout.block)),
            preset: self.preset,
        };
        grasping.features()
    }

    fn begins_prepared(&self) -> bool {
        self.start != Start::Reset
    }

    fn prepare(&mut self, world: &mut World, rng: &mut Rng) {
        start::bring_about(self, world, rng, self.arm.rate(), Self::begin, |task, world| {
            task.transfer().progress(&task.arm, world) >= task.start
        });
    }

    fn vary(&mut self, world: &mut World, rng: &mut Rng, extent: Extent) -> bool {
        let body = self.layout.block.body();
        let (before, is_held) = (world.pose(body), self.arm.holds(world, body));
        let growth = self.board.vary(world, &mut self.layout, rng, extent.contacts);
        let is_lifted = self.start == Start::Lift;
        let wrist =
            self.transfer().vary(&self.arm, world, (&before, growth), is_lifted, rng, extent);
        let widening = if is_held { growth } else { 1.0 };
        if !self.arm.vary(world, rng, &wrist, (widening, extent.contacts))
            || !self.arm.is_in_reach()
        {
            return false;
        }
        if is_held {
            world.set_velocity(body, &Vector3::zeros());
        }
        true
    }

    fn is_prepared(&self, world: &World) -> bool {
        match self.start {
            Start::Pick | Start::Lift => self.arm.holds(world, self.layout.block.body()),
            Start::Approach | Start::Reset => self.arm.is_open(world),
        }
    }

    fn reset(&mut self, world: &mut World, rng: &mut Rng) {
        if self.begins_prepared() {
            self.layout.target = PegBoard::draw_target(rng);
        } else {
            self.begin(world, rng);
        }
    }

    fn objects(&self) -> Vec<(&'static str, BodyId)> {
        self.board.named(&self.layout)
    }

    fn set_goal(&mut self, goal: &Vector3<f64>) -> Result<(), Rejection> {
        self.layout.target = PegBoard::target_at(goal)?;
        Ok(())
    }

    fn command(&mut self, world: &mut World, action: Option<&[f32]>) {
        psm_scene::command([&mut self.arm], world, &mut self.grasp, action);
    }

    fn arms(&mut self) -> Arms<'_> {
        [&mut self.arm].into_iter().collect()
    }

    fn after_step(&mut self, world: &mut World) {
        let Layout { block, target } = self.layout;
        let height = world.pose(block.body()).translation.z;
        let is_lifted = height > PegBoard::peg(target).z + WELD_LIFT;
        psm_scene::settle([&mut self.arm], world, &mut self.grasp, is_lifted);
    }

    fn state(&self, world: &World, state: &mut State<'_>) {
        self.arm.state(world, state);
        let block = self.layout.block;
        let centre = ("block", &world.pose(block.body()));
        let wall = ("wall 1", &block.scene_from_wall(world, WALL));
        objects::state(centre, wall, self.arm.scene_from_wrist(), self.preset, state);
    }

    fn goals(&self, world: &World, achieved: &mut [f32], desired: &mut [f32]) {
        let Layout { block, target } = self.layout;
        let centre = world.pose(block.body()).translation.vector;
        objects::write_goal(&centre, self.preset, achieved);
        objects::write_goal(&PegBoard::peg(target), self.preset, desired);
    }

    fn scene(&self, world: &World, scene: &mut Scene) {
        theatre::draw(scene, self.arm.model());
        self.board.draw(world, &self.layout, scene);
        self.arm.draw(world, scene);
    }

    fn expert(&self, world: &World, input: &ExpertInput<'_>, action: &mut [f32]) {
        let [view] = ArmView::of([&self.arm], world, input);
        let (_, (target, jaw)) = self.transfer().plan(&view, world, input);
        view.act(&target, jaw, action);
    }

    fn stage(&self, world: &World, input: &ExpertInput<'_>) -> Stage {
        let [view] = ArmView::of([&self.arm], world, input);
        self.transfer().plan(&view, world, input).0
    }
}

impl PegTransfer {
    /// Sets up the blocks, draws a target, brings the arm to its start.
    fn begin(&mut self, world: &mut World, rng: &mut Rng) {
        self.layout = self.board.lay_out(world, rng);
        self.grasp.reset(world, self.layout.block.body());
        self.arm.reset(world, rng);
    }

    /// What is to be done.
    fn transfer(&self) -> Transfer {
        let Layout { block, target } = self.layout;
        Transfer { block, target, side: 0.0 }
    }
}
