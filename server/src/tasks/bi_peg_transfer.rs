//! Bimanual peg transfer: a PSM takes a block to the other, which puts it onto a peg.
//!
//! # Description
//!
//! Six blocks, triangular rings, stand on a board about the pegs on PSM2's side. PSM2 is to lift one
//! of them off its peg and hand it over in the air, over the midline, to PSM1, which puts it onto a
//! peg on its own side. Fingers and block touch by friction alone: nothing ever attaches a block to the
//! jaws.
//!
//! # Action Space
//!
//! `action = "paper"`, each number in [−1, 1]; the other modes are in [`psm_scene`](super::psm_scene).
//!
//! | Num | Meaning | Min | Max | Unit |
//! |---|---|---|---|---|
//! | 0 | PSM1 dx, scene frame | −1 | 1 | 10 mm |
//! | 1 | PSM1 dy, scene frame | −1 | 1 | 10 mm |
//! | 2 | PSM1 dz, scene frame | −1 | 1 | 10 mm |
//! | 3 | PSM1 turn about the vertical | −1 | 1 | 30° |
//! | 4 | PSM1 jaw: below 0 close, else open to 40° | −1 | 1 | – |
//! | 5–9 | the same of PSM2 | −1 | 1 | |
//!
//! Both arms move at the same time, from the sensed wrists, in 0.2 s along a smooth profile, each
//! confined to its own workspace: see [`psm_scene`](super::psm_scene).
//!
//! # Observation Space
//!
//! | Num | Meaning | Min | Max | Unit |
//! |---|---|---|---|---|
//! | 0 | PSM1 wrist x (wrist-yaw axis, as sensed), scene frame | 0.476 | 0.624 | m |
//! | 1 | PSM1 wrist y | −0.074 | 0.074 | m |
//! | 2 | PSM1 wrist z | 0.6762 | 0.7912 | m |
//! | 3 | roll of PSM1's wrist link; −π/2 under `paper` | −π | π | rad |
//! | 4 | pitch; 0 under `paper` | −π/2 | π/2 | rad |
//! | 5 | yaw; π/2 at the start | −π | π | rad |
//! | 6 | PSM1 jaw angle: the opening between the fingers | −0.1 | 1.6 | rad |
//! | 7–13 | the same of PSM2 | | | |
//! | 14–16 | block x, y, z (its centre), scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 17–19 | block less PSM1's wrist x, y, z, scene frame | −0.332, −0.342, −0.1912 | 0.232, 0.342, 0.2238 | m |
//! | 20–22 | block less PSM2's wrist x, y, z, scene frame | −0.332, −0.342, −0.1912 | 0.232, 0.342, 0.2238 | m |
//! | 23–25 | middle of the block's wall 1 x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 26–28 | roll, pitch, yaw of that wall | −π, −π/2, −π | π, π/2, π | rad |
//! | 29–31 | middle of the block's wall 2 x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 32–34 | roll, pitch, yaw of that wall | −π, −π/2, −π | π, π/2, π | rad |
//!
//! The angles are extrinsic XYZ Euler angles, R = Rz(yaw)·Ry(pitch)·Rx(roll): 3–5 and 10–12 of the
//! wrist-yaw links, whose y axis points along the jaws and whose z axis is their hinge; 26–28 and
//! 32–34 of frames whose x axis points from the wall to the axis of the block, which is their z axis.
//! What is outside its range is shown at its end. Achieved goal: the centre of the block (x, y, z, m);
//! desired goal: the centre of the target peg. Both ignore `domain`'s noise and encoder errors.
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
//! The wrists at the corners (0.50, ±0.05, 0.7552) m, jaws closed and straight down. Six blocks stand
//! about the six sources, each turned by up to ±30°; one of them is to go to a peg drawn from the six
//! targets.
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
//!   friction until the block's centre is 10 mm above those of the pegs, then an attachment. One arm at a time
//!   has an attachment.
//! - `start`, the paper's variants: PSM2 has done `approach` (its open jaws are about a wall), `pick`
//!   (they hold it) or `lift` (above the pegs): one of 64 states that the expert made, with a new
//!   target, which the seed varies: PSM2 and block begin up to 15 mm beside (lifted) or 1 mm beside along x and y, PSM1
//!   up to 3 mm, other blocks are turned about their pegs, and rows of `domain` are drawn anew, see
//!   [`start`](super::start).
//! - `preset = "surrol"`: positions, goals and tolerances in units of 0.2 m (metres × 5), blocks of
//!   10 g, gripped with 3 N instead of 1 N, `grasp = "weld"` unless given.
//! - `arm = "si"`: the arms of the S and Si in place of the first generation's, see
//!   [`psm_scene`](super::psm_scene); not with `preset = "surrol"`.
//! - `domain`: `mass` (0.5 to 5; factor on the mass, besides what the size makes of it: stiffness
//!   of contacts is per mass, so fingers sink into what is lighter), `size` (0.98 to 1.1; factor
//!   on all lengths) of all blocks: a block below 0.966 that stands about its peg is more than 4
//!   mm below its middle, `friction` (coefficient of the jaws), `observation_noise` (m, on
//!   observed positions), `joint_offset` (rad, on every rotary joint), `latency` (steps; the arms
//!   hold until the first action arrives).
//! - `setup`: `base`, `base_2` (x, y, z in m and turn in rad of PSM1's and PSM2's base),
//!   `table_height` (m). Each arm must reach its whole workspace.
//!
//! `spawn` does not apply: blocks and goals are where the pegs are.
//!
//! # Differences from the original
//!
//! - The block is held by friction from beginning to end; the original fixes it to the wrist when it
//!   is 10 mm above the pegs' centres.
//! - Metres instead of metres × 5.
//! - Blocks weigh 1.44 g (acetal) instead of 10 g, and stand on the board from the first step instead
//!   of falling onto it.
//! - dVRK's joint limits; the jaws stay above the board instead of running into it; shafts do not
//!   pass through each other.
//! - An instrument that would crush a block yields.
//! - The expert's PSM2 grasps the wall to which it has to turn least of those on its own side, PSM1
//!   another one; they meet beside the target, as low as the pegs allow. Seeds determine the episode.
//!
//! # Version History
//!
//! - v0: first version.

use nalgebra::Vector3;
use trocar_proto::builtin::{self, TaskInfo};
use trocar_proto::relative::Relative;
use trocar_proto::spec::{Element, GoalSpec, OptionSpec};
use trocar_proto::{Options, Rejection, Stage};

use super::bimanual::{self, HandOver, Phase, Waypoint};
use super::expert::{ArmView, ExpertInput};
use super::objects;
use super::options::{self, Preset};
use super::peg_board::{Block, Layout, PegBoard};
use super::peg_expert::{self, Transfer};
use super::psm_scene::{self, PaperAction, PsmArm, Station, Turn};
use super::relative::Grasping;
use super::start::{self, Extent, Start};
use super::theatre;
use super::tray;
use super::{Arms, Registered, State, Task};
use crate::render::Scene;
use crate::sim::frames::{Aabb, Pose};
use crate::sim::grasp::{Grasp, GraspMode};
use crate::sim::instrument::{JAW_OPEN, Jaws, TIP_OFFSET};
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

/// Number of blocks. Source: the original.
const BLOCKS: usize = 6;

/// The walls of the block that are observed. Source: the original, whose PSM1 and PSM2 grasp them.
const WALLS: [usize; 2] = [1, 2];

/// What the state calls them.
const WALL_NAMES: [&str; 2] = ["wall 1", "wall 2"];

/// Where PSM1 and PSM2 work, m. Source: the original.
const WORKSPACES: [Aabb; 2] = [
    Aabb::new([0.50, 0.0, 0.686], [0.60, 0.05, 0.745]),
    Aabb::new([0.50, -0.05, 0.686], [0.60, 0.0, 0.745]),
];

/// Height of the block's centre above that of its target from which an attachment may hold it under
/// `grasp = "weld"`, m. Source: the original.
const WELD_LIFT: f64 = 0.01;

/// How far above the grasp PSM1 opens its jaws, m. Source: the original.
const HOVER: f64 = 0.01;

/// How far a block may sink below the pegs' tops while it is handed over, beside them, m.
const SINKING: f64 = 5e-3;

/// How much farther aside a wall must be for a radian more to turn: of two that are alike, PSM1 stays with one.
const AS_GOOD: f64 = 0.1;

/// Distance from the midline at which PSM1 waits, m.
const WAITING: f64 = 0.025;

/// Largest distance of PSM1 at the beginning from its prepared place along x, and along y away from PSM2, m.
const WAITING_SHIFT: f64 = 3e-3;

/// The task; see the module's description.
#[derive(Debug, Clone)]
pub struct BiPegTransfer {
    arms: [PsmArm; 2],
    board: PegBoard,
    grasp: Grasp,
    /// Whether jaws have the block when they close near it (`grasp = "approx"`).
    by_nearness: bool,
    /// For how long, s, both arms have held the block.
    together: f64,
    start: Start,
    preset: Preset,
    layout: Layout,
}

impl Registered for BiPegTransfer {
    const INFO: TaskInfo = builtin::BI_PEG_TRANSFER;
    const CONSTANT_UNDER_PAPER: &'static [&'static str] = &[
        "PSM1 wrist link roll",
        "PSM1 wrist link pitch",
        "PSM2 wrist link roll",
        "PSM2 wrist link pitch",
    ];

    fn options() -> Vec<OptionSpec> {
        objects::options(2, Block::SIZE, [start::option()], [])
    }

    fn new(options: &Options) -> Result<(Self, World), Rejection> {
        let preset = options::preset_of(options);
        let mut world = tray::bare_table(preset);
        let board = PegBoard::insert(&mut world, preset, BLOCKS, options::Domain::of(options)?);
        let layout = Layout { block: board.blocks()[0], target: 0 };
        let mode = options::grasp_of(options);
        let grasp = Grasp::new(&mut world, mode, layout.block.body());
        let paper = PaperAction { turn: Turn::Vertical, jaw: true };
        let mut arm = |arm: usize| {
            let workspace = WORKSPACES[arm];
            let y = [workspace.max.y, workspace.min.y][arm];
            let start = [workspace.min.x, y, workspace.max.z + TIP_OFFSET];
            let start = psm_scene::straight_down(start);
            let (support, jaws) = (PegBoard::top(), Jaws::NEEDLE_DRIVER);
            let station = Station { arm, workspace, start, support, squeeze: None, jaws };
            PsmArm::insert(&mut world, options, paper, station)
        };
        let task = Self {
            arms: [arm(0)?, arm(1)?],
            board,
            grasp,
            by_nearness: matches!(mode, GraspMode::Approx { .. }),
            together: 0.0,
            start: Start::of(options),
            preset,
            layout,
        };
        Ok((task, world))
    }
}

impl Task for BiPegTransfer {
    fn action(&self) -> Vec<Element> {
        bimanual::action_elements(self.arms.each_ref())
    }

    fn goal(&self) -> Option<GoalSpec> {
        Some(PegBoard::goal_spec(self.preset))
    }

    fn relative(&self, _: &[Element]) -> Relative {
        let grasping = Grasping {
            arms: self.arms.each_ref(),
            object: "block",
            places: WALL_NAMES,
            grips: [
                peg_expert::grips_in_air(self.layout.block, WALLS[0]),
                peg_expert::grips_on_peg(self.layout.block, WALLS[0]),
            ],
            level: Some(peg_expert::clear_of_pegs(self.layout.block)),
            preset: self.preset,
        };
        grasping.features()
    }

    fn begins_prepared(&self) -> bool {
        self.start != Start::Reset
    }

    fn prepare(&mut self, world: &mut World, rng: &mut Rng) {
        start::bring_about(self, world, rng, self.arms[0].rate(), Self::begin, |task, world| {
            task.fetching().progress(&task.arms[1], world) >= task.start
        });
    }

    fn vary(&mut self, world: &mut World, rng: &mut Rng, extent: Extent) -> bool {
        let body = self.layout.block.body();
        let (before, is_held) = (world.pose(body), self.arms[1].holds(world, body));
        let growth = self.board.vary(world, &mut self.layout, rng, extent.contacts);
        let is_lifted = self.start == Start::Lift;
        let fetching = self.fetching();
        let held = (&before, growth);
        let wrist = fetching.vary(&self.arms[1], world, held, is_lifted, rng, extent);
        let widening = if is_held { growth } else { 1.0 };
        let mut waiting = *self.arms[0].commanded();
        waiting.translation.vector.x += extent.share * rng.uniform(-WAITING_SHIFT, WAITING_SHIFT);
        waiting.translation.vector.y += extent.share * rng.uniform(0.0, WAITING_SHIFT);
        let is_placed = self.arms[1].vary(world, rng, &wrist, (widening, extent.contacts))
            && self.arms[0].vary_free(world, rng, &waiting);
        if !is_placed || !self.arms[1].is_in_reach() {
            return false;
        }
        if is_held {
            world.set_velocity(body, &Vector3::zeros());
        }
        true
    }

    fn is_prepared(&self, world: &World) -> bool {
        match self.start {
            Start::Pick | Start::Lift => self.arms[1].holds(world, self.layout.block.body()),
            Start::Approach | Start::Reset => self.arms[1].is_open(world),
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
        psm_scene::command(self.arms.each_mut(), world, &mut self.grasp, action);
    }

    fn arms(&mut self) -> Arms<'_> {
        self.arms.each_mut().into()
    }

    fn after_step(&mut self, world: &mut World) {
        let Layout { block, target } = self.layout;
        let height = world.pose(block.body()).translation.z;
        let is_lifted = height > PegBoard::peg(target).z + WELD_LIFT;
        psm_scene::settle(self.arms.each_mut(), world, &mut self.grasp, is_lifted);
        let arms = self.arms.each_ref();
        self.together = bimanual::holding_together(arms, world, block.body(), self.together);
    }

    fn state(&self, world: &World, state: &mut State<'_>) {
        let block = self.layout.block;
        let centre = ("block", &world.pose(block.body()));
        let [one, two] = &WALLS.map(|wall| block.scene_from_wall(world, wall));
        let walls = [(WALL_NAMES[0], one), (WALL_NAMES[1], two)];
        bimanual::state(self.arms.each_ref(), centre, walls, self.preset, world, state);
    }

    fn goals(&self, world: &World, achieved: &mut [f32], desired: &mut [f32]) {
        let Layout { block, target } = self.layout;
        let centre = world.pose(block.body()).translation.vector;
        objects::write_goal(&centre, self.preset, achieved);
        objects::write_goal(&PegBoard::peg(target), self.preset, desired);
    }

    fn scene(&self, world: &World, scene: &mut Scene) {
        theatre::draw(scene, self.arms[0].model());
        self.board.draw(world, &self.layout, scene);
        self.arms.iter().for_each(|arm| arm.draw(world, scene));
    }

    fn expert(&self, world: &World, input: &ExpertInput<'_>, action: &mut [f32]) {
        let views = ArmView::of(self.arms.each_ref(), world, input);
        bimanual::act(&views, &self.plan(&views, world, input).1, action);
    }

    fn stage(&self, world: &World, input: &ExpertInput<'_>) -> Stage {
        let views = ArmView::of(self.arms.each_ref(), world, input);
        self.plan(&views, world, input).0
    }
}

impl BiPegTransfer {
    /// Sets up the blocks, draws a target, brings the arms to their starts.
    fn begin(&mut self, world: &mut World, rng: &mut Rng) {
        self.layout = self.board.lay_out(world, rng);
        self.grasp.reset(world, self.layout.block.body());
        self.together = 0.0;
        for arm in &mut self.arms {
            arm.reset(world, rng);
        }
    }

    /// PSM2's part: to pick up the block by a wall on its own side.
    fn fetching(&self) -> Transfer {
        let Layout { block, target } = self.layout;
        Transfer { block, target, side: -1.0 }
    }

    /// PSM1's part: to bring the block to its target.
    fn placing(&self) -> Transfer {
        Transfer { side: 0.0, ..self.fetching() }
    }

    /// What is done now, and what both arms do for it.
    fn plan(
        &self,
        [one, two]: &[ArmView<'_>; 2],
        world: &World,
        input: &ExpertInput<'_>,
    ) -> (Stage, [Waypoint; 2]) {
        let Layout { block, target } = self.layout;
        let pose = input.pose(world, block.body());
        let up = peg_expert::way_over_pegs(block, &pose);
        let hand_over = self.hand_over(one, two, &pose);
        // Once the other arm has come, what keeps clear of the pegs is high enough.
        let least = if hand_over.is_near(one) { -SINKING } else { 0.5 * peg_expert::PASS };
        let is_low = up > peg_expert::PASS - least;
        match hand_over.phase(two, one, world, input) {
            Phase::Under(_) if is_low => {
                let lifting = peg_expert::lifting(two, block, &pose, up);
                let lifting = bimanual::carried(two, lifting);
                (Stage::Lift, [self.waiting(one), lifting])
            }
            Phase::Under([giver, taker]) => {
                (hand_over.giving(two, one, world, input), [taker, giver])
            }
            Phase::Over { giver, clear: false } => {
                (Stage::HandOver, [bimanual::staying(one), giver])
            }
            Phase::Over { giver, clear: true } => {
                let (stage, waypoint) = self.placing().plan(one, world, input);
                (stage, [waypoint, giver])
            }
            Phase::Lost => {
                let [_, reach] = self.arms.each_ref().map(PsmArm::reach);
                let is_on = PegBoard::is_on(world, block, target);
                if is_on || pose.translation.y > reach.max.y {
                    let (stage, waypoint) = self.placing().plan(one, world, input);
                    (stage, [waypoint, bimanual::staying(two)])
                } else {
                    let (stage, waypoint) = self.fetching().plan(two, world, input);
                    (stage, [self.waiting(one), waypoint])
                }
            }
        }
    }

    /// The hand-over over the midline, beside the target, of a block at `pose`.
    fn hand_over(&self, one: &ArmView<'_>, two: &ArmView<'_>, pose: &Pose) -> HandOver {
        let Layout { block, target } = self.layout;
        let (giver, taker) = (&two.wrist, &one.wrist);
        let held = peg_expert::held_wall(block, pose, giver);
        let aside = |wall: &usize| {
            let turn = peg_expert::grasp_in_air(block, pose, *wall, taker).rotation;
            let turn = turn.angle_to(&one.aim.rotation);
            peg_expert::outwards(block, pose, *wall).y - turn * AS_GOOD
        };
        let taken = (0..Block::WALLS)
            .filter(|wall| *wall != held)
            .max_by(|a, b| aside(a).total_cmp(&aside(b)))
            .expect("a block has walls");

        // Both wrists are as far from the midline as each other.
        let taking = peg_expert::grasp_in_air(block, pose, taken, taker);
        let way = Vector3::new(
            PegBoard::peg(target).x - pose.translation.x,
            -0.5 * (giver.translation.y + taking.translation.y),
            peg_expert::way_over_pegs(block, pose),
        );
        let offered = Pose::from(way) * pose;
        HandOver {
            object: block.body(),
            offer: Pose::from(way) * giver,
            take: [peg_expert::grasp_in_air(block, &offered, taken, taker), taking],
            together: self.together,
            hover: HOVER,
            by_nearness: self.by_nearness,
        }
    }

    /// Where PSM1 waits while PSM2 fetches the block: beside the target, clear of PSM2.
    fn waiting(&self, one: &ArmView<'_>) -> Waypoint {
        let mut wrist = one.aim;
        wrist.translation.x = PegBoard::peg(self.layout.target).x;
        wrist.translation.y = WAITING;
        wrist.translation.z = one.arm().reach().max.z;
        (wrist, JAW_OPEN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::world::BodyId;
    use crate::tasks::bimanual::tests::{Watched, act_as_expert, count};

    impl Watched for BiPegTransfer {
        fn both(&self) -> &[PsmArm; 2] {
            &self.arms
        }

        fn object(&self) -> BodyId {
            self.layout.block.body()
        }
    }

    #[test]
    fn the_expert_hands_the_block_over_in_the_air_and_leaves_it_on_its_peg() {
        let (mut done, episodes) = (0, count(12, 500));
        for seed in 0..episodes {
            let (mut task, mut world) = BiPegTransfer::new(&Options::new()).unwrap();
            Task::reset(&mut task, &mut world, &mut Rng::new(seed, 0));
            let (mut handed_over, mut by_two) = (false, false);
            for _ in 0..BiPegTransfer::INFO.steps {
                act_as_expert(&mut task, &mut world);
                let block = world.pose(task.object());
                let held = task.arms.each_ref().map(|arm| arm.holds(&world, task.object()));
                by_two |= held == [false, true];
                handed_over |= by_two
                    && held == [true, true]
                    && peg_expert::way_over_pegs(task.layout.block, &block) < 1e-3;
            }
            let is_on = PegBoard::is_on(&world, task.layout.block, task.layout.target);
            done += u64::from(handed_over && is_on);
        }
        assert!(done as f64 >= 0.95 * episodes as f64, "{done} of {episodes}");
    }
}
