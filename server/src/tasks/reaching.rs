//! Tasks in which the closed jaws of one arm go to a point just above an object.
//!
//! What such tasks have in common is [`Reaching`]; what is special about one is its object, a [`Reachable`].

use nalgebra::Vector3;
use trocar_proto::builtin::TaskInfo;
use trocar_proto::goal::SuccessRule;
use trocar_proto::relative::Relative;
use trocar_proto::spec::{Element, GoalSpec, OptionSpec};
use trocar_proto::{Options, Rejection};

use super::expert::{ArmView, ExpertInput, Sees};
use super::objects;
use super::options::{self, Domain, Preset};
use super::psm_scene::{PaperAction, PsmArm, RATE, REACH, STEP_LENGTH, Station, Turn, WORKSPACE};
use super::relative;
use super::theatre;
use super::tray;
use super::{Arms, Registered, State, Task};
use crate::render::Scene;
use crate::sim::frames::Pose;
use crate::sim::instrument::{JAW_CLOSED, TIP_OFFSET};
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

/// Distance below which the goal is reached, m. Source: the paper.
const TOLERANCE: f64 = 0.005;

/// The expert rests within this distance of the goal, m, and moves by this part of a full action.
/// Source: the original.
const EXPERT_TOLERANCE: f64 = 0.003;
const EXPERT_SPEED: f64 = 0.3;

/// Height of the goal above what is reached, m. Source: the original.
pub(super) const GOAL_HEIGHT: f64 = 0.005;

/// An object that is reached.
pub trait Reachable: Clone + Send + Sync + 'static {
    /// What is fixed of its task.
    const INFO: TaskInfo;

    /// What people call it.
    const NAME: &'static str;

    /// The least and the greatest factor on its lengths.
    const SIZE: [f64; 2];

    /// Puts it into the world.
    fn insert(world: &mut World, preset: Preset, domain: Domain) -> Self;

    /// Its body.
    fn body(&self) -> BodyId;

    /// Lays it at the beginning of an episode: anywhere, or `narrow`, near the middle.
    fn lay(&mut self, narrow: bool, world: &mut World, rng: &mut Rng);

    /// The point of it above which the goal is, m.
    fn reached(&self, world: &World) -> Vector3<f64>;

    /// Draws it.
    fn draw(&self, world: &World, scene: &mut Scene);
}

/// The task of reaching an object.
#[derive(Debug, Clone)]
pub struct Reaching<O> {
    pub(super) arm: PsmArm,
    pub(super) object: O,
    narrow: bool,
    preset: Preset,
    pub(super) goal: Vector3<f64>,
}

impl<O: Reachable> Registered for Reaching<O> {
    const INFO: TaskInfo = O::INFO;
    const CONSTANT: &'static [&'static str] = &["jaw"];
    const CONSTANT_UNDER_PAPER: &'static [&'static str] =
        &["wrist link roll", "wrist link pitch", "wrist link yaw"];

    fn options() -> Vec<OptionSpec> {
        vec![
            options::reward(),
            options::action(),
            options::observation(),
            options::preset(),
            options::arm(),
            options::spawn(),
            RATE.option(5.0),
            Sees::option(),
            options::domain_with(
                options::object_rows(O::SIZE).into_iter().chain(options::psm_rows()),
            ),
            options::setup(&PsmArm::setup_rows(1)),
        ]
    }

    fn new(options: &Options) -> Result<(Self, World), Rejection> {
        let preset = options::preset_of(options);
        let mut world = tray::furnished_world(preset);
        let object = O::insert(&mut world, preset, Domain::of(options)?);
        let paper = PaperAction { turn: Turn::Nothing, jaw: false };
        let start = [WORKSPACE.min.x, WORKSPACE.max.y, WORKSPACE.max.z + TIP_OFFSET];
        let task = Self {
            arm: PsmArm::insert(
                &mut world,
                options,
                paper,
                Station::psm1(start, tray::pad().max.z),
            )?,
            object,
            narrow: options.text("spawn") == Some("narrow"),
            preset,
            goal: Vector3::zeros(),
        };
        Ok((task, world))
    }
}

impl<O: Reachable> Task for Reaching<O> {
    fn action(&self) -> Vec<Element> {
        self.arm.action_elements()
    }

    fn goal(&self) -> Option<GoalSpec> {
        // The tip of jaws in any direction from a wrist within its reach.
        let tip = REACH.grown(TIP_OFFSET + 1e-3);
        let tolerance = TOLERANCE * options::position_scale(self.preset);
        Some(GoalSpec {
            elements: options::position_elements("tip", "scene", &tip, self.preset),
            success: SuccessRule::Distance { tolerance: tolerance as f32 },
        })
    }

    fn relative(&self, _: &[Element]) -> Relative {
        relative::reaching(&self.arm, self.preset)
    }

    fn reset(&mut self, world: &mut World, rng: &mut Rng) {
        self.object.lay(self.narrow, world, rng);
        self.objects_placed(world);
        self.arm.reset(world, rng);
    }

    fn objects(&self) -> Vec<(&'static str, BodyId)> {
        vec![(O::NAME, self.object.body())]
    }

    fn objects_placed(&mut self, world: &World) {
        self.goal = self.object.reached(world) + Vector3::z() * GOAL_HEIGHT;
    }

    fn set_goal(&mut self, goal: &Vector3<f64>) -> Result<(), Rejection> {
        self.arm.check_goal(goal)?;
        self.goal = *goal;
        Ok(())
    }

    fn command(&mut self, _: &mut World, action: Option<&[f32]>) {
        self.arm.command(action);
    }

    fn arms(&mut self) -> Arms<'_> {
        [&mut self.arm].into_iter().collect()
    }

    fn state(&self, world: &World, state: &mut State<'_>) {
        self.arm.state(world, state);
    }

    fn goals(&self, _: &World, achieved: &mut [f32], desired: &mut [f32]) {
        objects::write_goal(&self.arm.tip(), self.preset, achieved);
        objects::write_goal(&self.goal, self.preset, desired);
    }

    fn scene(&self, world: &World, scene: &mut Scene) {
        theatre::draw(scene, self.arm.model());
        tray::draw(scene);
        self.object.draw(world, scene);
        self.arm.draw(world, scene);
        scene.add_goal(&self.goal, theatre::GOAL_RADIUS);
    }

    fn expert(&self, world: &World, input: &ExpertInput<'_>, action: &mut [f32]) {
        let [view] = ArmView::of([&self.arm], world, input);
        let tip = (view.aim * Pose::translation(0.0, 0.0, TIP_OFFSET)).translation.vector;
        let error = self.goal - tip;
        let step = if error.norm() < EXPERT_TOLERANCE {
            Vector3::zeros()
        } else {
            error * (EXPERT_SPEED * STEP_LENGTH * self.arm.rate().scale() / error.amax())
        };
        view.act(&(Pose::from(step) * view.aim), JAW_CLOSED, action);
    }
}
