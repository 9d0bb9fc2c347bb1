//! Needle regrasp: a PSM hands a needle to the other, which brings it to a goal.
//!
//! # Description
//!
//! PSM1 holds the 40 mm needle near its swage. It hands the needle over in the air to PSM2, which
//! grasps it near its point and brings that place within 5 mm of a goal. Goals are where PSM1 cannot
//! bring the needle, wherever it holds it. A needle that is there is in PSM2's hand alone. Fingers
//! and needle touch by friction alone: nothing ever attaches the needle to the jaws.
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
//! | 3 | PSM1 pitch: jaws along x turn about x; within ±90° | −1 | 1 | 15° |
//! | 4 | PSM1 jaw: below 0 close, else open to 40° | −1 | 1 | – |
//! | 5–9 | the same of PSM2, whose jaws turn about −x | −1 | 1 | |
//!
//! Both arms move at the same time, from the sensed wrists, in 0.2 s along a smooth profile, each
//! confined to its own workspace: see [`psm_scene`](super::psm_scene). All over it the pitch goes from
//! −90° to at least 60°; further, PSM1's roll may end at its limit.
//!
//! # Observation Space
//!
//! | Num | Meaning | Min | Max | Unit |
//! |---|---|---|---|---|
//! | 0 | PSM1 wrist x (wrist-yaw axis, as sensed), scene frame | 0.526 | 0.624 | m |
//! | 1 | PSM1 wrist y | −0.104 | 0.104 | m |
//! | 2 | PSM1 wrist z | 0.6852 | 0.7912 | m |
//! | 3 | roll of PSM1's wrist link; 0 under `paper` | −π | π | rad |
//! | 4 | pitch | −π/2 | π/2 | rad |
//! | 5 | yaw; −π/2 under `paper` | −π | π | rad |
//! | 6 | PSM1 jaw angle: the opening between the fingers | −0.1 | 1.6 | rad |
//! | 7–13 | the same of PSM2; roll −π and yaw π/2 under `paper`, at a pitch of ±π/2 0 and −π/2 | | | |
//! | 14–16 | needle x, y, z (centre of its arc), scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 17–19 | needle less PSM1's wrist x, y, z, scene frame | −0.332, −0.372, −0.1912 | 0.182, 0.372, 0.2148 | m |
//! | 20–22 | needle less PSM2's wrist x, y, z, scene frame | −0.332, −0.372, −0.1912 | 0.182, 0.372, 0.2148 | m |
//! | 23–25 | needle near its point (60° from the middle of the arc) x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 26–28 | roll, pitch, yaw of the needle there | −π, −π/2, −π | π, π/2, π | rad |
//! | 29–31 | needle near its swage (60° from the middle) x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 32–34 | roll, pitch, yaw of the needle there | −π, −π/2, −π | π, π/2, π | rad |
//!
//! The angles are extrinsic XYZ Euler angles, R = Rz(yaw)·Ry(pitch)·Rx(roll): 3–5 and 10–12 of the
//! wrist-yaw links, whose y axis points along the jaws and whose z axis is their hinge; 26–28 and
//! 32–34 of frames whose x axis points to the centre of the arc and whose y axis lies along the wire,
//! towards the swage. What is outside its range is shown at its end. Achieved goal: the needle near
//! its point (x, y, z, m); desired goal: where that is to be. Both ignore `domain`'s noise and encoder
//! errors.
//!
//! # Rewards
//!
//! `sparse` (default): 0 where the goals are less than 5 mm apart, −1 otherwise. `dense`: minus
//! their distance, m. Both are functions of the goals alone.
//!
//! # Starting State
//!
//! PSM1's closed jaws hold the needle across its wire near its swage, at rest. The centre of the arc is
//! uniform in the middle third, along each axis, of x 0.55 to 0.60, y 0.01 to 0.08, z 0.7052 to
//! 0.7552 m; the needle hangs with its ends up, tilted by up to ±15° about y. PSM2's wrist is in the
//! middle of its workspace, (0.575, −0.045, 0.7302) m, jaws closed, along x, at a pitch of −90°. A
//! session has 64 grasps, brought about by physics. The seed chooses one, draws the centre of the arc and the rows of
//! `domain`, and jaws and needle begin there together, see [`start`](super::start). The goal is normal
//! about (0.575, −0.045, 0.7302) m with 5 mm along each axis, within x 0.556 to 0.594 m and y up
//! to −0.0392 m.
//!
//! # Episode End
//!
//! Truncated after 50 steps; never terminated.
//!
//! # Options
//!
//! `reward`, `action`, `observation`, and:
//!
//! - `grasp = "interact"`: friction alone; `"approx"`, `"weld"`: see [`grasp`](crate::sim::grasp). Under
//!   `weld` an attachment replaces friction as soon as both fingers touch; one arm at a time has it.
//! - `preset = "surrol"`: positions, goals and tolerance in units of 0.2 m (metres × 5), needle of
//!   10 g, gripped with 3 N instead of 0.4 N, `grasp = "weld"` unless given.
//! - `arm = "si"`: the arms of the S and Si in place of the first generation's, see
//!   [`psm_scene`](super::psm_scene); not with `preset = "surrol"`.
//! - `domain`: `mass` (0.5 to 5; factor on the mass, besides what the size makes of it: stiffness
//!   of contacts is per mass, so fingers sink into what is lighter), `size` (0.8 to 1.2; factor on
//!   all lengths) of the needle, `observation_noise` (m, on observed positions), `friction` (of
//!   the jaws), `joint_offset` (rad, on every rotary joint), `latency` (steps; the arms hold until
//!   the first action arrives).
//! - `setup`: `base`, `base_2` (x, y, z in m and turn in rad of PSM1's and PSM2's base),
//!   `table_height` (m). Each arm must reach its whole workspace.
//!
//! `spawn` does not apply: paper and code have the same needle and goals.
//!
//! # Differences from the original
//!
//! - The needle is held by friction from beginning to end; the original fixes it to the wrist as soon
//!   as both fingers touch it.
//! - PSM1 begins with its jaws across the wire, at a pitch of about −30°, instead of −90°, where they
//!   would not hold it.
//! - Goals are clamped so that only PSM2 brings the needle there; in the original, every ninth or so is
//!   where PSM1 could.
//! - Each finger squeezes with 0.4 N: near its ends the light needle bears no more.
//! - Metres instead of metres × 5. The needle weighs 0.36 g (steel) instead of 10 g.
//! - dVRK's joint limits. An instrument that would crush the needle yields; shafts do not pass
//!   through each other.
//! - The expert levels the needle between both arms and hands it over where it is, before it goes to
//!   the goal. Seeds determine the episode.
//!
//! # Version History
//!
//! - v0: first version.

use std::f64::consts::PI;

use nalgebra::{UnitQuaternion, Vector3};
use trocar_proto::builtin::{self, TaskInfo};
use trocar_proto::relative::Relative;
use trocar_proto::spec::{Element, GoalSpec, OptionSpec};
use trocar_proto::{Options, Rejection, Stage};

use super::bimanual::{self, HandOver, Phase, Waypoint};
use super::expert::{ArmView, ExpertInput};
use super::options::{self, Preset};
use super::psm_scene::{
    self, PITCH_LIMIT, PaperAction, PsmArm, Station, Turn, pitch_across, pitched,
};
use super::relative::{Grasping, Grip};
use super::start::Extent;
use super::theatre;
use super::tray::{self, Needle};
use super::{Arms, Registered, State, Task, time};
use super::{goal, objects};
use crate::render::Scene;
use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::grasp::{Grasp, GraspMode};
use crate::sim::instrument::{JAW_OPEN, Jaws, TIP_OFFSET};
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

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

/// What the state calls them.
const PLACE_NAMES: [&str; 2] = ["needle near its point", "needle near its swage"];

/// How far the tip reaches beyond the middle of the wire, m. Source: the original.
const GRASP_DEPTH: f64 = 1.5e-3;

/// How far from the grasp PSM2 opens its jaws, m.
const HOVER: f64 = 0.005;

/// Force with which each finger squeezes, N. What an engine's contact can bear of a needle is least at
/// the needle's ends, where both arms grasp it: with 1 N the fingers sink into the wire.
const SQUEEZE: f64 = 0.4;

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

/// How far from PSM1's tip the place near the needle's point can be, wherever PSM1 holds the needle, m. For a
/// needle of size 1: 39.2 mm to the end of the swage, and half a finger's width.
const OUTREACH: f64 = 0.0402;

/// The task; see the module's description.
#[derive(Debug, Clone)]
pub struct NeedleRegrasp {
    arms: [PsmArm; 2],
    needle: Needle,
    grasp: Grasp,
    /// Whether jaws have the needle when they close near it (`grasp = "approx"`).
    by_nearness: bool,
    /// For how long, s, both arms have held the needle.
    together: f64,
    preset: Preset,
    goal: Vector3<f64>,
}

impl Registered for NeedleRegrasp {
    const INFO: TaskInfo = builtin::NEEDLE_REGRASP;
    const CONSTANT_UNDER_PAPER: &'static [&'static str] =
        &["PSM1 wrist link roll", "PSM1 wrist link yaw"];

    fn options() -> Vec<OptionSpec> {
        objects::options(2, Needle::SIZE, [], [])
    }

    fn new(options: &Options) -> Result<(Self, World), Rejection> {
        let preset = options::preset_of(options);
        let mut world = tray::furnished_world(preset);
        let domain = options::Domain::of(options)?;
        let needle = Needle::insert(&mut world, preset, domain);
        let mode = options::grasp_of(options);
        let grasp = Grasp::new(&mut world, mode, needle.body());
        let paper = PaperAction { turn: Turn::Pitch, jaw: true };
        let mut arm = |arm: usize| {
            let workspace = WORKSPACES[arm];
            let at = workspace.centre() + Vector3::z() * TIP_OFFSET;
            let start = Pose::from_parts(at.into(), pitched(arm, START_PITCH));
            let (support, squeeze) = (tray::pad().max.z, Some(SQUEEZE));
            let station =
                Station { arm, workspace, start, support, squeeze, jaws: Jaws::NEEDLE_DRIVER };
            PsmArm::insert(&mut world, options, paper, station)
        };
        let task = Self {
            arms: [arm(0)?, arm(1)?],
            needle,
            grasp,
            by_nearness: matches!(mode, GraspMode::Approx { .. }),
            together: 0.0,
            preset,
            goal: Vector3::zeros(),
        };
        Ok((task, world))
    }
}

impl Task for NeedleRegrasp {
    fn action(&self) -> Vec<Element> {
        bimanual::action_elements(self.arms.each_ref())
    }

    fn goal(&self) -> Option<GoalSpec> {
        Some(objects::goal_spec(PLACE_NAMES[0], self.preset))
    }

    fn relative(&self, _: &[Element]) -> Relative {
        let grasping = Grasping {
            arms: self.arms.each_ref(),
            object: "needle",
            places: PLACE_NAMES,
            grips: [vec![Grip::at(1, PLACE_NAMES[1])], vec![Grip::at(0, PLACE_NAMES[0])]],
            level: None,
            preset: self.preset,
        };
        grasping.features()
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
        tracing::warn!(
            task = Self::INFO.id,
            "the needle does not stay in PSM1's hand at the start"
        );
    }

    fn vary(&mut self, world: &mut World, rng: &mut Rng, extent: Extent) -> bool {
        let body = self.needle.body();
        let (pose, wrist) = (world.pose(body), *self.arms[0].true_wrist());
        let (before, size) = (self.places(world)[1].translation.vector, self.needle.form().size());
        if extent.contacts {
            self.needle.vary(world, rng);
        }
        let growth = self.needle.form().size() / size;
        // The grasped place stays, and then both go where the centre of the arc is as far as `extent` has it from the
        // prepared place to any in its range.
        let grown = Pose::from(before - self.places(world)[1].translation.vector) * pose;
        let way = (draw_centre(rng) - grown.translation.vector) * extent.share;
        world.place(body, &(Pose::from(way) * grown));
        let [one, two] = &mut self.arms;
        if !one.vary(world, rng, &(Pose::from(way) * wrist), (growth, extent.contacts))
            || !one.is_in_reach()
        {
            return false;
        }
        two.reset(world, rng);
        world.set_velocity(body, &Vector3::zeros());
        true
    }

    fn is_prepared(&self, world: &World) -> bool {
        self.arms[0].holds(world, self.needle.body())
            && world.velocity(self.needle.body()).norm() < AT_REST
    }

    fn objects(&self) -> Vec<(&'static str, BodyId)> {
        vec![("needle", self.needle.body())]
    }

    fn reset(&mut self, _: &mut World, rng: &mut Rng) {
        let spread = Vector3::from_fn(|_, _| GOAL_SPREAD * rng.normal());
        let centre = WORKSPACES[1].centre() + Vector3::z() * TIP_OFFSET;
        self.goal = self.goals().clamp(&(centre + spread));
    }

    fn set_goal(&mut self, goal: &Vector3<f64>) -> Result<(), Rejection> {
        goal::check(goal, &self.goals(), "where PSM2 brings the needle, and PSM1 cannot")?;
        self.goal = *goal;
        Ok(())
    }

    fn command(&mut self, world: &mut World, action: Option<&[f32]>) {
        psm_scene::command(self.arms.each_mut(), world, &mut self.grasp, action);
    }

    fn arms(&mut self) -> Arms<'_> {
        self.arms.each_mut().into()
    }

    fn after_step(&mut self, world: &mut World) {
        psm_scene::settle(self.arms.each_mut(), world, &mut self.grasp, true);
        let (arms, needle) = (self.arms.each_ref(), self.needle.body());
        self.together = bimanual::holding_together(arms, world, needle, self.together);
    }

    fn state(&self, world: &World, state: &mut State<'_>) {
        let needle = ("needle", &world.pose(self.needle.body()));
        let [point, swage] = &self.places(world);
        let places = [(PLACE_NAMES[0], point), (PLACE_NAMES[1], swage)];
        bimanual::state(self.arms.each_ref(), needle, places, self.preset, world, state);
    }

    fn goals(&self, world: &World, achieved: &mut [f32], desired: &mut [f32]) {
        objects::write_goal(&self.places(world)[0].translation.vector, self.preset, achieved);
        objects::write_goal(&self.goal, self.preset, desired);
    }

    fn scene(&self, world: &World, scene: &mut Scene) {
        theatre::draw(scene, self.arms[0].model());
        tray::draw(scene);
        self.needle.draw(world, scene);
        self.arms.iter().for_each(|arm| arm.draw(world, scene));
        scene.add_goal(&self.goal, theatre::GOAL_RADIUS);
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

impl NeedleRegrasp {
    /// Where the needle is grasped: near its point, near its swage.
    fn places(&self, world: &World) -> [Pose; 2] {
        let scene_from_needle = world.pose(self.needle.body());
        PLACES.map(|place| scene_from_needle * self.needle.form().body_from(place))
    }

    /// Where goals are: where PSM2 can bring the needle, and PSM1 cannot, wherever it holds it.
    fn goals(&self) -> Aabb {
        let [one, two] = self.arms.each_ref().map(PsmArm::reach);
        let mut goals = *two;
        goals.min.x += GOAL_INSET;
        goals.max.x -= GOAL_INSET;
        goals.max.y = one.min.y - OUTREACH * self.needle.form().size() - objects::TOLERANCE;
        goals
    }

    /// Closes PSM1's jaws about a needle that is kept in place, then releases the needle; false if the needle does not stay in
    /// the jaws.
    fn put_needle_into_hand(&mut self, world: &mut World, rng: &mut Rng) -> bool {
        for arm in &mut self.arms {
            arm.reset(world, rng);
        }
        self.needle.vary(world, rng);
        let at = draw_centre(rng);
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
        let mut action = vec![0.0; self.action().len()];
        let rate = self.arms[0].rate();
        for _ in 0..rate.steps(steps) {
            let views = ArmView::of(self.arms.each_ref(), world, &ExpertInput::default());
            bimanual::act(&views, &views.each_ref().map(bimanual::staying), &mut action);
            time::step(self, world, Some(&action), rate.substeps());
        }
    }

    /// What is done now, and what both arms do for it.
    fn plan(
        &self,
        [one, two]: &[ArmView<'_>; 2],
        world: &World,
        input: &ExpertInput<'_>,
    ) -> (Stage, [Waypoint; 2]) {
        let places = self.places(world);
        let [point, swage] = places.map(|place| Pose::from(input.position_error) * place);
        let levelled = levelling(&point.translation.vector, &swage.translation.vector);
        let hand_over = HandOver {
            object: self.needle.body(),
            offer: levelled * one.wrist,
            take: [levelled * point, point].map(|place| grasp_at(1, &place)),
            together: self.together,
            hover: HOVER,
            by_nearness: self.by_nearness,
        };
        match hand_over.phase(one, two, world, input) {
            Phase::Lost => (Stage::HandOver, [bimanual::staying(one), bimanual::staying(two)]),
            Phase::Under(waypoints) => (hand_over.giving(one, two, world, input), waypoints),
            Phase::Over { giver, clear: false } => {
                (Stage::HandOver, [giver, bimanual::staying(two)])
            }
            Phase::Over { giver, clear: true } => {
                let way = self.goal - point.translation.vector;
                (Stage::Carry, [giver, bimanual::carried(two, way)])
            }
        }
    }
}

/// The centre of the arc of a needle in PSM1's hand at the beginning, m: anywhere in the middle third along each axis.
fn draw_centre(rng: &mut Rng) -> Vector3<f64> {
    let [low, high] =
        [WORKSPACES[0].min, WORKSPACES[0].max].map(|corner| corner + Vector3::z() * TIP_OFFSET);
    let third = (high - low) / 3.0;
    Vector3::from_fn(|axis, _| rng.uniform(low[axis] + third[axis], high[axis] - third[axis]))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assets::Model;
    use crate::sim::world::{BodyId, Shape};
    use crate::tasks::bimanual::tests::{Watched, act, act_as_expert, count};

    impl Watched for NeedleRegrasp {
        fn both(&self) -> &[PsmArm; 2] {
            &self.arms
        }

        fn object(&self) -> BodyId {
            self.needle.body()
        }
    }

    /// The `index`-th state in which episodes begin.
    fn prepared(options: &Options, index: u64) -> (NeedleRegrasp, World) {
        let (mut task, mut world) = NeedleRegrasp::new(options).unwrap();
        Task::prepare(&mut task, &mut world, &mut Rng::start(index));
        Task::reset(&mut task, &mut world, &mut Rng::new(index, 0));
        (task, world)
    }

    fn holders(task: &NeedleRegrasp, world: &World) -> [bool; 2] {
        task.arms.each_ref().map(|arm| arm.holds(world, task.needle.body()))
    }

    #[test]
    fn episodes_begin_with_the_needle_at_rest_in_the_first_arms_hand() {
        const STAY: [f32; 10] = [0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0];
        for preset in ["paper", "surrol"] {
            let options = Options::new().with_text("preset", preset).with_text("grasp", "interact");
            for index in 0..count(4, 64) {
                let (mut task, mut world) = prepared(&options, index);
                assert_eq!(holders(&task, &world), [true, false], "{preset} {index}");
                let hinges = world.joints().flatten().filter(|body| *body == task.object());
                assert_eq!(hinges.count(), 0);
                assert!(world.velocity(task.object()).norm() < AT_REST);
                // Nothing but PSM1's fingers keeps it there.
                let before = world.pose(task.object());
                for _ in 0..20 {
                    act(&mut task, &mut world, &STAY);
                }
                let moved = before.inv_mul(&world.pose(task.object()));
                assert!(moved.translation.vector.norm() < 0.5e-3, "{preset} {index}: {moved}");
                for _ in 0..4 {
                    act(&mut task, &mut world, &[0.0; 10]);
                }
                let fallen = before.translation.z - world.pose(task.object()).translation.z;
                assert!(fallen > 0.01, "{preset} {index}: {fallen}");
            }
        }
    }

    #[test]
    fn the_expert_ends_with_the_needle_in_the_second_arms_hand_alone() {
        let (mut alone, episodes) = (0, count(16, 500));
        for index in 0..episodes {
            let (mut task, mut world) = prepared(&Options::new(), index);
            for _ in 0..NeedleRegrasp::INFO.steps {
                act_as_expert(&mut task, &mut world);
            }
            let off = task.places(&world)[0].translation.vector - task.goal;
            let there = off.norm() < objects::TOLERANCE;
            alone += u64::from(there && holders(&task, &world) == [false, true]);
        }
        assert!(alone as f64 >= 0.95 * episodes as f64, "{alone} of {episodes}");
    }

    #[test]
    fn the_first_arm_cannot_bring_the_needle_to_a_goal() {
        let (task, _) = NeedleRegrasp::new(&Options::new()).unwrap();
        let near_point = Model::needle().body_from(PLACES[0]).translation.vector;
        let outreach = Model::needle().parts.iter().flat_map(|part| {
            let Shape::Capsule { a, b, radius } = part.shape else { panic!("a wire") };
            [a, b].map(|end| ((part.body_from_part * end).coords - near_point).norm() + radius)
        });
        assert!(outreach.fold(0.0, f64::max) < OUTREACH);
        assert!(task.goals().min.y < task.goals().max.y);
        let nearest = task.arms[0].reach().min.y - OUTREACH;
        assert!(nearest - task.goals().max.y >= objects::TOLERANCE - 1e-12);
    }
}
