//! Peg transfer with both arms (draft).

use nalgebra::Vector3;
use trocar_proto::goal::Reward;
use trocar_proto::spec::OptionSpec;
use trocar_proto::{Options, Rejection, TaskSpec};

use super::Task;
use super::bimanual::{self, HandOver, Stage, Waypoint};
use super::objects;
use super::options::{self, Preset};
use super::peg_board::{Block, Layout, PegBoard};
use super::peg_expert::{self, Transfer};
use super::psm_scene::{self, MAX_STEPS, PaperAction, PsmArm, SECONDS_PER_STEP, Station, Turn};
use super::start::{self, Start};
use super::tray;
use crate::sim::frames::{Aabb, Pose};
use crate::sim::grasp::{Grasp, GraspMode};
use crate::sim::instrument::{JAW_OPEN, TIP_OFFSET};
use crate::sim::random::Rng;
use crate::sim::world::World;

/// Number of blocks. Source: the original.
const BLOCKS: usize = 6;

/// The walls of the block that are observed. Source: the original, whose PSM1 and PSM2 grasp them.
const WALLS: [usize; 2] = [1, 2];

/// Where PSM1 and PSM2 work, m. Source: the original.
const WORKSPACES: [Aabb; 2] = [
    Aabb::new([0.50, 0.0, 0.686], [0.60, 0.05, 0.745]),
    Aabb::new([0.50, -0.05, 0.686], [0.60, 0.0, 0.745]),
];

/// Height of the block's centre above that of its target from which a tie may hold it under
/// `grasp = "weld"`, m. Source: the original.
const WELD_LIFT: f64 = 0.01;

/// How far above the grasp PSM1 opens its jaws, m. Source: the original.
const HOVER: f64 = 0.01;

/// Distance from the midline at which PSM1 waits, m.
const WAITING: f64 = 0.025;

/// The task; see the module's description.
#[derive(Debug, Clone)]
pub struct BiPegTransfer {
    arms: [PsmArm; 2],
    board: PegBoard,
    grasp: Grasp,
    /// Whether jaws have the block when they close near it (`grasp = "approx"`).
    by_nearness: bool,
    /// For how many steps both arms have held the block.
    together: u32,
    start: Start,
    preset: Preset,
    reward: Reward,
    layout: Layout,
}

impl Task for BiPegTransfer {
    const ID: &'static str = "BiPegTransfer-v0";

    fn options() -> Vec<OptionSpec> {
        let [grasp, grasp_distance] = options::grasp();
        vec![
            options::reward(),
            grasp,
            grasp_distance,
            options::action(),
            options::observation(),
            options::preset(),
            start::option(),
            options::grasp_domain(),
            options::setup(&PsmArm::setup_rows(2)),
        ]
    }

    fn new(options: &Options) -> Result<(Self, World), Rejection> {
        let preset = options::preset_of(options);
        let mut world = tray::bare_table(preset);
        let board = PegBoard::insert(&mut world, preset, BLOCKS);
        let layout = Layout { block: board.blocks()[0], target: 0 };
        let mode = options::grasp_of(options);
        let grasp = Grasp::new(&mut world, mode, layout.block.body());
        let paper = PaperAction { turn: Turn::Vertical, jaw: true };
        let mut arm = |arm: usize| {
            let workspace = WORKSPACES[arm];
            let y = [workspace.max.y, workspace.min.y][arm];
            let start = [workspace.min.x, y, workspace.max.z + TIP_OFFSET];
            let start = psm_scene::straight_down(start);
            let station =
                Station { arm, workspace, start, support: PegBoard::top(), squeeze: None };
            PsmArm::insert(&mut world, options, paper, station)
        };
        let task = Self {
            arms: [arm(0)?, arm(1)?],
            board,
            grasp,
            by_nearness: matches!(mode, GraspMode::Approx { .. }),
            together: 0,
            start: Start::of(options),
            preset,
            reward: options::reward_of(options),
            layout,
        };
        Ok((task, world))
    }

    fn spec(&self) -> TaskSpec {
        let [one, two] = &self.arms;
        let walls = ["wall 1", "wall 2"];
        TaskSpec {
            id: Self::ID.into(),
            summary: "Take a block to the other arm, which puts it onto a peg.".into(),
            max_steps: MAX_STEPS,
            seconds_per_step: SECONDS_PER_STEP,
            action: bimanual::action_elements([one, two]),
            observation: bimanual::observation_elements([one, two], "block", walls, self.preset),
            goal: Some(PegBoard::goal_spec(self.preset)),
            reward: self.reward,
            options: Self::options(),
        }
    }

    fn begins_prepared(&self) -> bool {
        self.start != Start::Reset
    }

    fn prepare(&mut self, world: &mut World, rng: &mut Rng) {
        start::bring_about(self, world, rng, Self::begin, |task, world| {
            task.fetching().progress(&task.arms[1], world) >= task.start
        });
    }

    fn reset(&mut self, world: &mut World, rng: &mut Rng) {
        if self.begins_prepared() {
            self.layout.target = PegBoard::draw_target(rng);
        } else {
            self.begin(world, rng);
        }
    }

    fn apply(&mut self, world: &mut World, action: Option<&[f32]>) {
        let Layout { block, target } = self.layout;
        let lifted = PegBoard::peg(target).z + WELD_LIFT;
        let [one, two] = &mut self.arms;
        psm_scene::step([one, two], world, &mut self.grasp, action, |world| {
            world.pose(block.body()).translation.z > lifted
        });
        let arms = [&*one, &*two];
        self.together = bimanual::holding_together(arms, world, block.body(), self.together);
    }

    fn observe(
        &self,
        world: &World,
        observation: &mut [f32],
        achieved: &mut [f32],
        desired: &mut [f32],
    ) {
        let [one, two] = &self.arms;
        let Layout { block, target } = self.layout;
        let centre = world.pose(block.body());
        let walls = WALLS.map(|wall| block.scene_from_wall(world, wall));
        bimanual::observe([one, two], world, &centre, &walls, self.preset, observation);
        objects::write_goal(&centre.translation.vector, self.preset, achieved);
        objects::write_goal(&PegBoard::peg(target), self.preset, desired);
    }

    fn expert(&self, world: &World, action: &mut [f32]) {
        let [one, two] = &self.arms;
        bimanual::act([one, two], &self.waypoints(world), action);
    }
}

impl BiPegTransfer {
    /// Sets up the blocks, draws a target, brings the arms to their starts.
    fn begin(&mut self, world: &mut World, rng: &mut Rng) {
        self.layout = self.board.lay_out(world, rng);
        self.grasp.reset(world, self.layout.block.body());
        self.together = 0;
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

    /// What both arms are to do now.
    fn waypoints(&self, world: &World) -> [Waypoint; 2] {
        let [one, two] = &self.arms;
        let Layout { block, target } = self.layout;
        let up = peg_expert::way_over_pegs(&world.pose(block.body()));
        let is_low = up > 0.5 * peg_expert::PASS;
        match self.hand_over(world).stage(two, one, world) {
            Stage::Under(_) if is_low => {
                [self.waiting(), bimanual::carried(two, Vector3::z() * up)]
            }
            Stage::Under([two, one]) => [one, two],
            Stage::Over { giver, clear: false } => [bimanual::staying(one), giver],
            Stage::Over { giver, clear: true } => [self.placing().waypoint(one, world), giver],
            Stage::Lost => {
                let at = world.pose(block.body()).translation.vector;
                if PegBoard::is_on(world, block, target) || at.y > two.reach().max.y {
                    [self.placing().waypoint(one, world), bimanual::staying(two)]
                } else {
                    [self.waiting(), self.fetching().waypoint(two, world)]
                }
            }
        }
    }

    /// The hand-over over the midline, beside the target.
    fn hand_over(&self, world: &World) -> HandOver {
        let [one, two] = &self.arms;
        let Layout { block, target } = self.layout;
        let pose = world.pose(block.body());
        let (giver, taker) = (two.scene_from_wrist(), one.scene_from_wrist());
        let held = peg_expert::held_wall(&pose, giver);
        let aside = |wall: &usize| peg_expert::outwards(&pose, *wall).y;
        let taken = (0..Block::WALLS)
            .filter(|wall| *wall != held)
            .max_by(|a, b| aside(a).total_cmp(&aside(b)))
            .expect("a block has walls");

        // Both wrists are as far from the midline as each other.
        let taking = peg_expert::grasp_in_air(&pose, taken, taker);
        let way = Vector3::new(
            PegBoard::peg(target).x - pose.translation.x,
            -0.5 * (giver.translation.y + taking.translation.y),
            peg_expert::way_over_pegs(&pose),
        );
        let offered = Pose::from(way) * pose;
        HandOver {
            object: block.body(),
            offer: Pose::from(way) * giver,
            take: peg_expert::grasp_in_air(&offered, taken, taker),
            together: self.together,
            hover: HOVER,
            by_nearness: self.by_nearness,
        }
    }

    /// Where PSM1 waits while PSM2 fetches the block: beside the target, clear of PSM2.
    fn waiting(&self) -> Waypoint {
        let [one, _] = &self.arms;
        let mut wrist = *one.scene_from_wrist();
        wrist.translation.x = PegBoard::peg(self.layout.target).x;
        wrist.translation.y = WAITING;
        wrist.translation.z = one.reach().max.z;
        (wrist, JAW_OPEN)
    }
}
