//! # Description
//!
//! PSM1 holds the 40 mm needle near its swage. It hands the needle over in the air to PSM2, which
//! grasps it near its point and brings it there, held by PSM2 alone, within 5 mm of a goal. Fingers
//! and needle touch by friction alone: nothing ever ties the needle to the jaws.

use std::f64::consts::PI;

use nalgebra::{UnitQuaternion, Vector3};
use trocar_proto::goal::Reward;
use trocar_proto::spec::OptionSpec;
use trocar_proto::{Options, Rejection, TaskSpec};

use super::Task;
use super::bimanual::{self, HandOver, Stage, Waypoint};
use super::objects;
use super::options::{self, Preset};
use super::psm_scene::{
    self, MAX_STEPS, PITCH_LIMIT, PaperAction, PsmArm, SECONDS_PER_STEP, Station, Turn,
    pitch_across, pitched,
};
use super::tray::{self, Needle};
use crate::assets::Model;
use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::grasp::{Grasp, GraspMode};
use crate::sim::instrument::{JAW_OPEN, TIP_OFFSET};
use crate::sim::random::Rng;
use crate::sim::world::World;

/// Where the tips of PSM1 and PSM2 would work if their jaws pointed down, m. Source: the original.
const WORKSPACES: [Aabb; 2] = [
    Aabb::new([0.55, 0.01, 0.695], [0.60, 0.08, 0.745]),
    Aabb::new([0.55, -0.08, 0.695], [0.60, -0.01, 0.745]),
];

/// Pitch of both arms at the start, before PSM1 takes the needle, rad. Source: the original.
const START_PITCH: f64 = -PITCH_LIMIT;

/// The frames of the needle that are observed and grasped: first that of PSM2, near the point, then
/// that of PSM1, near the swage. Source: the original (its links 4 and 5).
const PLACES: [&str; 2] = ["point_60", "swage_60"];

/// How far the tip reaches beyond the middle of the wire, m. Source: the original.
const GRASP_DEPTH: f64 = 1.5e-3;

/// Pitch of the needle in PSM1's hand, rad: −90° hangs upright. Source: the original.
const NEEDLE_PITCH: [f64; 2] = [-105.0 * PI / 180.0, -75.0 * PI / 180.0];

/// Steps that PSM1's jaws have to close about the needle, and then that it has to come to rest.
const CLOSING: u32 = 3;
const SETTLING: u32 = 5;

/// Speed below which a held needle is at rest, m/s.
const AT_REST: f64 = 1e-3;

/// How far a needle that is let go may sag in PSM1's jaws, m.
const SAG: f64 = 1e-3;

/// Attempts to put a needle into PSM1's hand, each with another needle.
const ATTEMPTS: u32 = 16;

/// Spread of goals about the middle of where PSM2 works, m. Source: the original.
const GOAL_SPREAD: f64 = 0.005;

/// How far inside the edge of where PSM2 works goals are along x, m: its jaws point along x.
const GOAL_INSET: f64 = 0.01;

/// How far from PSM1's tip the place near the needle's point can be while PSM1 holds the needle, wherever
/// it does, m: 39.2 mm to the end of the swage, and half a finger's width.
const OUTREACH: f64 = 0.0402;

/// The task; see the module's description.
#[derive(Debug, Clone)]
pub struct NeedleRegrasp {
    arms: [PsmArm; 2],
    needle: Needle,
    grasp: Grasp,
    /// Whether jaws have the needle when they close near it (`grasp = "approx"`).
    by_nearness: bool,
    preset: Preset,
    reward: Reward,
    goal: Vector3<f64>,
}

impl Task for NeedleRegrasp {
    const ID: &'static str = "NeedleRegrasp-v0";

    fn options() -> Vec<OptionSpec> {
        let [grasp, grasp_distance] = options::grasp();
        vec![
            options::reward(),
            grasp,
            grasp_distance,
            options::action(),
            options::observation(),
            options::preset(),
            options::domain(),
            options::setup(&PsmArm::setup_rows(2)),
        ]
    }

    fn new(options: &Options) -> Result<(Self, World), Rejection> {
        let preset = options::preset_of(options);
        let mut world = tray::furnished_world(preset);
        let needle = Needle::insert(&mut world, preset);
        let mode = options::grasp_of(options);
        let grasp = Grasp::new(&mut world, mode, needle.body());
        let paper = PaperAction { turn: Turn::Pitch, jaw: true };
        let mut arm = |arm: usize| {
            let workspace = WORKSPACES[arm];
            let at = workspace.centre() + Vector3::z() * TIP_OFFSET;
            let start = Pose::from_parts(at.into(), pitched(arm, START_PITCH));
            let station = Station { arm, workspace, start, support: tray::pad().max.z };
            PsmArm::insert(&mut world, options, paper, station)
        };
        let task = Self {
            arms: [arm(0)?, arm(1)?],
            needle,
            grasp,
            by_nearness: matches!(mode, GraspMode::Approx { .. }),
            preset,
            reward: options::reward_of(options),
            goal: Vector3::zeros(),
        };
        Ok((task, world))
    }

    fn spec(&self) -> TaskSpec {
        let [one, two] = &self.arms;
        let named = |index: usize, arm: &PsmArm| {
            let elements = arm.action_elements().into_iter();
            elements.map(move |mut element| {
                element.name = format!("PSM{} {}", index + 1, element.name);
                element
            })
        };
        let places = ["needle near its point", "needle near its swage"];
        TaskSpec {
            id: Self::ID.into(),
            summary: "Hand a needle from one arm to the other, which brings it to a point.".into(),
            max_steps: MAX_STEPS,
            seconds_per_step: SECONDS_PER_STEP,
            action: named(0, one).chain(named(1, two)).collect(),
            observation: bimanual::observation_elements([one, two], "needle", places, self.preset),
            goal: Some(objects::goal_spec(places[0], self.preset)),
            reward: self.reward,
            options: Self::options(),
        }
    }

    fn begins_prepared(&self) -> bool {
        true
    }

    fn prepare(&mut self, world: &mut World, rng: &mut Rng) {
        let (empty_task, empty_world) = (self.clone(), world.clone());
        for _ in 0..ATTEMPTS {
            self.clone_from(&empty_task);
            world.clone_from(&empty_world);
            if self.put_needle_into_hand(world, rng) {
                return;
            }
        }
        tracing::warn!(task = Self::ID, "the needle does not stay in PSM1's hand at the start");
    }

    fn reset(&mut self, _: &mut World, rng: &mut Rng) {
        let spread = Vector3::from_fn(|_, _| GOAL_SPREAD * rng.normal());
        let centre = WORKSPACES[1].centre() + Vector3::z() * TIP_OFFSET;
        self.goal = self.goals().clamp(&(centre + spread));
    }

    fn apply(&mut self, world: &mut World, action: Option<&[f32]>) {
        let [one, two] = &mut self.arms;
        psm_scene::step([one, two], world, &mut self.grasp, action, |_| true);
    }

    fn observe(
        &self,
        world: &World,
        observation: &mut [f32],
        achieved: &mut [f32],
        desired: &mut [f32],
    ) {
        let [one, two] = &self.arms;
        let needle = world.pose(self.needle.body());
        let places = self.places(world);
        bimanual::observe([one, two], world, &needle, &places, self.preset, observation);
        objects::write_goal(&places[0].translation.vector, self.preset, achieved);
        objects::write_goal(&self.goal, self.preset, desired);
    }

    fn expert(&self, world: &World, action: &mut [f32]) {
        let [one, two] = &self.arms;
        bimanual::act([one, two], &self.waypoints(world), action);
    }
}

impl NeedleRegrasp {
    /// Where the needle is grasped: near its point, near its swage.
    fn places(&self, world: &World) -> [Pose; 2] {
        let scene_from_needle = world.pose(self.needle.body());
        PLACES.map(|place| scene_from_needle * Model::needle().body_from(place))
    }

    /// Where goals are: where PSM2 can bring the needle, and PSM1 cannot, wherever it holds it.
    fn goals(&self) -> Aabb {
        let [one, two] = self.arms.each_ref().map(PsmArm::reach);
        let mut goals = *two;
        goals.min.x += GOAL_INSET;
        goals.max.x -= GOAL_INSET;
        goals.max.y = one.min.y - OUTREACH - objects::TOLERANCE;
        goals
    }

    /// Lets PSM1's jaws close about a needle that is kept in place, then lets it go; false where it
    /// does not stay.
    fn put_needle_into_hand(&mut self, world: &mut World, rng: &mut Rng) -> bool {
        for arm in &mut self.arms {
            arm.reset(world, rng);
        }
        let [low, high] =
            [WORKSPACES[0].min, WORKSPACES[0].max].map(|corner| corner + Vector3::z() * TIP_OFFSET);
        let third = (high - low) / 3.0;
        let at = Vector3::from_fn(|axis, _| {
            rng.uniform(low[axis] + third[axis], high[axis] - third[axis])
        });
        let pitch = rng.uniform(NEEDLE_PITCH[0], NEEDLE_PITCH[1]);
        world.place(self.needle.body(), &frames::pose(at.into(), [0.0, pitch, 0.0]));
        self.grasp.reset(world, self.needle.body());

        let [_, near_swage] = self.places(world);
        let about = grasp_at(0, &near_swage);
        if !self.arms[0].put(&about, JAW_OPEN) {
            return false;
        }
        self.arms[1].hold_fast(world, self.needle.body());
        self.close(world, CLOSING);
        self.arms[1].let_go(world);
        self.close(world, SETTLING);
        let sag = self.places(world)[1].translation.vector - near_swage.translation.vector;
        self.arms[0].holds(world, self.needle.body())
            && world.velocity(self.needle.body()).norm() < AT_REST
            && sag.norm() < SAG
    }

    /// Both arms stay for `steps` with their jaws closed.
    fn close(&mut self, world: &mut World, steps: u32) {
        let mut action = vec![0.0; Task::spec(self).action_dim()];
        for _ in 0..steps {
            let [one, two] = &self.arms;
            let staying = [bimanual::staying(one), bimanual::staying(two)];
            bimanual::act([one, two], &staying, &mut action);
            Task::apply(self, world, Some(&action));
        }
    }

    /// What both arms are to do now.
    fn waypoints(&self, world: &World) -> [Waypoint; 2] {
        let [one, two] = &self.arms;
        let [point, swage] = self.places(world);
        let levelled = levelling(&point.translation.vector, &swage.translation.vector);
        let hand_over = HandOver {
            object: self.needle.body(),
            offer: levelled * one.scene_from_wrist(),
            take: grasp_at(1, &(levelled * point)),
            by_nearness: self.by_nearness,
        };
        match hand_over.stage(one, two, world) {
            Stage::Lost => [bimanual::staying(one), bimanual::staying(two)],
            Stage::Under(waypoints) => waypoints,
            Stage::Over { giver, clear: false } => [giver, bimanual::staying(two)],
            Stage::Over { giver, clear: true } => {
                [giver, bimanual::carried(two, self.goal - point.translation.vector)]
            }
        }
    }
}

/// The wrist of `arm` whose jaws are about the wire at `place`.
fn grasp_at(arm: usize, place: &Pose) -> Pose {
    let rotation = pitched(arm, pitch_across(arm, &(place.rotation * Vector3::y())));
    let tip_from_wrist = Pose::translation(0.0, 0.0, GRASP_DEPTH - TIP_OFFSET);
    Pose::from_parts(place.translation.vector.into(), rotation) * tip_from_wrist
}

/// The motion that brings a needle whose places to grasp are at `point` and `swage` (m) between both
/// arms, so that one arm is as far from the midline as the other and both are level.
fn levelling(point: &Vector3<f64>, swage: &Vector3<f64>) -> Pose {
    let middle = (point + swage) * 0.5;
    let along = point - swage;
    let mut turn = PI - libm::atan2(along.z, along.y);
    turn -= 2.0 * PI * (turn / (2.0 * PI)).round();
    let there = Vector3::new(middle.x, 0.0, middle.z);
    Pose::from(there)
        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), turn)
        * Pose::from(-middle)
}
