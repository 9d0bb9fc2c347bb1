//! Tasks in which one arm picks up an object that lies in the tray and brings it to a goal.
//!
//! What such tasks have in common is [`Picking`]; what is special about one is its object, a [`Pickable`].

use nalgebra::Vector3;
use trocar_proto::builtin::TaskInfo;
use trocar_proto::relative::Relative;
use trocar_proto::spec::{Element, GoalSpec, OptionSpec};
use trocar_proto::{Options, Rejection, Stage};

use super::expert::{ArmView, ExpertInput};
use super::objects;
use super::options::{self, Domain, Preset};
use super::pad::Pad;
use super::pick::Pick;
use super::psm_scene::{self, PaperAction, PsmArm, Station, Turn, WORKSPACE};
use super::relative::{Grasping, Grip};
use super::start::{self, Extent, Start};
use super::theatre;
use super::{Arms, Registered, State, Task};
use crate::render::Scene;
use crate::sim::frames::{Aabb, Pose};
use crate::sim::grasp::Grasp;
use crate::sim::instrument::TIP_OFFSET;
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

/// An object that is picked up.
pub trait Pickable: Clone + Send + Sync + 'static {
    /// What is fixed of its task.
    const INFO: TaskInfo;

    /// What `action = "paper"` turns.
    const PAPER: Turn;

    /// Fields of the state that nothing changes as long as actions are the paper's.
    const CONSTANT_UNDER_PAPER: &'static [&'static str];

    /// What the state calls it, and the place at which it is grasped.
    const NAMES: [&'static str; 2];

    /// What of it is brought to the goal, as the goal calls it.
    const CARRIED: &'static str;

    /// The least and the greatest factor on its lengths.
    const SIZE: [f64; 2];

    /// The world in which it lies, with it; and the pad under it, where there is one.
    fn furnish(preset: Preset, domain: Domain) -> (World, Option<Pad>, Self);

    /// Half the side of the square about the workspace's centre in which its origin lies under `spawn = "narrow"`, m.
    const NARROW: f64;

    /// Its body.
    fn body(&self) -> BodyId;

    /// Factor on its lengths in this episode.
    fn size(&self) -> f64;

    /// Draws mass and size of the episode, if they vary; it must be placed anew.
    fn vary(&mut self, world: &mut World, rng: &Rng);

    /// The area in which it lies at the beginning of an episode.
    fn area() -> Aabb {
        WORKSPACE
    }

    /// Height of what lies under it, m.
    fn support(&self) -> f64;

    /// The lowest height of goals, m.
    fn lowest_goal() -> f64;

    /// A goal under `spawn = "narrow"`, m.
    fn narrow_goal(rng: &mut Rng) -> Vector3<f64>;

    /// Lays it at the beginning of an episode: anywhere, or `narrow`, near the middle.
    fn lay(&mut self, narrow: bool, world: &mut World, rng: &mut Rng);

    /// The place at which it is grasped.
    fn place(&self, world: &World) -> Pose;

    /// What is brought to the goal, m.
    fn carried(&self, world: &World) -> Vector3<f64>;

    /// Whether a tie may hold it under `grasp = "weld"`.
    fn is_lifted(&self, world: &World) -> bool;

    /// The wrist that grasps it, for an arm with its wrist at `wrist`; and how far below that the wrist is sent, m.
    fn grasp(
        &self,
        world: &World,
        pad: Option<&Pad>,
        wrist: &Pose,
        input: &ExpertInput<'_>,
    ) -> (Pose, f64);

    /// Draws it, and the tray with what it has besides the pad.
    fn draw(&self, world: &World, pad: Option<&Pad>, scene: &mut Scene);
}

/// The task of picking up an object.
#[derive(Debug, Clone)]
pub struct Picking<O> {
    pub(super) arm: PsmArm,
    pad: Option<Pad>,
    pub(super) object: O,
    grasp: Grasp,
    start: Start,
    narrow: bool,
    preset: Preset,
    pub(super) goal: Vector3<f64>,
}

impl<O: Pickable> Registered for Picking<O> {
    const INFO: TaskInfo = O::INFO;
    const CONSTANT_UNDER_PAPER: &'static [&'static str] = O::CONSTANT_UNDER_PAPER;

    fn options() -> Vec<OptionSpec> {
        objects::options(1, O::SIZE, [options::spawn(), start::option()], options::pad_rows())
    }

    fn new(options: &Options) -> Result<(Self, World), Rejection> {
        let preset = options::preset_of(options);
        let (mut world, pad, object) = O::furnish(preset, Domain::of(options)?);
        let paper = PaperAction { turn: O::PAPER, jaw: true };
        let start = [WORKSPACE.min.x, WORKSPACE.max.y, WORKSPACE.centre().z + TIP_OFFSET];
        let station = Station::psm1(start, object.support());
        let grasp = Grasp::new(&mut world, options::grasp_of(options), object.body());
        let task = Self {
            arm: PsmArm::insert(&mut world, options, paper, station)?,
            pad,
            object,
            grasp,
            start: Start::of(options),
            narrow: options.text("spawn") == Some("narrow"),
            preset,
            goal: Vector3::zeros(),
        };
        Ok((task, world))
    }
}

impl<O: Pickable> Task for Picking<O> {
    fn action(&self) -> Vec<Element> {
        self.arm.action_elements()
    }

    fn goal(&self) -> Option<GoalSpec> {
        Some(objects::goal_spec(O::CARRIED, self.preset))
    }

    fn relative(&self, _: &[Element]) -> Relative {
        let [object, place] = O::NAMES;
        let grasping = Grasping {
            arms: [&self.arm],
            object,
            places: [place],
            grips: [vec![Grip::at(0, place)]],
            level: None,
            preset: self.preset,
        };
        grasping.features()
    }

    fn begins_prepared(&self) -> bool {
        self.start != Start::Reset
    }

    fn prepare(&mut self, world: &mut World, rng: &mut Rng) {
        let is_there = |task: &Self, world: &World| task.progress(world) >= task.start;
        start::bring_about(self, world, rng, self.arm.rate(), Self::begin, is_there);
    }

    fn vary(&mut self, world: &mut World, rng: &mut Rng, extent: Extent) -> bool {
        let body = self.object.body();
        let (mut wrist, pose) = (*self.arm.true_wrist(), world.pose(body));
        let is_held = self.arm.holds(world, body);
        let (before, size) = (self.grasp_place(world, &wrist), self.object.size());
        if extent.contacts {
            self.object.vary(world, rng);
        }
        let growth = self.object.size() / size;
        // The pad is pressed in by the same part of its travel.
        let sunk = self.pad.as_ref().map_or(0.0, |pad| pad.sunk(world));
        let mut sinks = sunk;
        if let Some(pad) = self.pad.as_mut().filter(|_| extent.contacts) {
            let travel = pad.depth();
            pad.vary(world, rng);
            sinks *= if travel > 0.0 { pad.depth() / travel } else { 0.0 };
            self.arm.give(pad.depth());
            pad.sink(world, sinks);
        }
        // It grows about the point of the support below the grasp; if it is lifted, about the grasp.
        let fixed = Vector3::new(before.x, before.y, self.object.support() - sunk);
        let grown = fixed + (pose.translation.vector - fixed) * growth;
        let grown = Pose::from_parts((grown + Vector3::z() * (sunk - sinks)).into(), pose.rotation);
        world.place(body, &grown);
        let mut way = self.draw_shift(world, rng) * extent.share;
        if self.start == Start::Lift {
            way += before - self.grasp_place(world, &wrist);
        }
        world.place(body, &(Pose::from(way) * grown));
        wrist.translation.vector += self.grasp_place(world, &wrist) - before;
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
            Start::Pick | Start::Lift => self.arm.holds(world, self.object.body()),
            Start::Approach | Start::Reset => self.arm.is_open(world),
        }
    }

    fn reset(&mut self, world: &mut World, rng: &mut Rng) {
        if self.begins_prepared() {
            self.goal = self.draw_goal(rng);
        } else {
            self.begin(world, rng);
        }
    }

    fn objects(&self) -> Vec<(&'static str, BodyId)> {
        vec![(O::NAMES[0], self.object.body())]
    }

    fn set_goal(&mut self, goal: &Vector3<f64>) -> Result<(), Rejection> {
        self.arm.check_goal(goal)?;
        self.goal = *goal;
        Ok(())
    }

    fn command(&mut self, world: &mut World, action: Option<&[f32]>) {
        psm_scene::command([&mut self.arm], world, &mut self.grasp, action);
    }

    fn arms(&mut self) -> Arms<'_> {
        [&mut self.arm].into_iter().collect()
    }

    fn after_step(&mut self, world: &mut World) {
        let is_lifted = self.object.is_lifted(world);
        psm_scene::settle([&mut self.arm], world, &mut self.grasp, is_lifted);
    }

    fn state(&self, world: &World, state: &mut State<'_>) {
        self.arm.state(world, state);
        let object = (O::NAMES[0], &world.pose(self.object.body()));
        let place = (O::NAMES[1], &self.object.place(world));
        objects::state(object, place, self.arm.scene_from_wrist(), self.preset, state);
    }

    fn goals(&self, world: &World, achieved: &mut [f32], desired: &mut [f32]) {
        objects::write_goal(&self.object.carried(world), self.preset, achieved);
        objects::write_goal(&self.goal, self.preset, desired);
    }

    fn scene(&self, world: &World, scene: &mut Scene) {
        theatre::draw(scene, self.arm.model());
        self.object.draw(world, self.pad.as_ref(), scene);
        self.arm.draw(world, scene);
        scene.add_goal(&self.goal, theatre::GOAL_RADIUS);
    }

    fn expert(&self, world: &World, input: &ExpertInput<'_>, action: &mut [f32]) {
        let [view] = ArmView::of([&self.arm], world, input);
        self.pick(world, &view.aim, input).act(&view, world, input, action);
    }

    fn stage(&self, world: &World, input: &ExpertInput<'_>) -> Stage {
        let [view] = ArmView::of([&self.arm], world, input);
        self.pick(world, &view.aim, input).stage(&view, world, input)
    }
}

impl<O: Pickable> Picking<O> {
    /// Lays the object, draws a goal, brings the arm to its start.
    fn begin(&mut self, world: &mut World, rng: &mut Rng) {
        if let Some(pad) = &mut self.pad {
            pad.vary(world, rng);
            self.arm.give(pad.depth());
        }
        self.object.lay(self.narrow, world, rng);
        if let Some(pad) = &self.pad {
            pad.bear(world, self.object.body());
        }
        self.grasp.reset(world, self.object.body());
        self.goal = self.draw_goal(rng);
        self.arm.reset(world, rng);
    }

    fn draw_goal(&self, rng: &mut Rng) -> Vector3<f64> {
        if self.narrow {
            O::narrow_goal(rng)
        } else {
            objects::goal_anywhere(O::lowest_goal(), rng)
        }
    }

    /// The work that is done.
    fn progress(&self, world: &World) -> Start {
        let pick = self.pick(world, &self.arm.seen_wrist(), &ExpertInput::default());
        pick.progress(&self.arm, world)
    }

    /// The wrist that grasps the object, m.
    fn grasp_place(&self, world: &World, wrist: &Pose) -> Vector3<f64> {
        let input = ExpertInput::default();
        self.object.grasp(world, self.pad.as_ref(), wrist, &input).0.translation.vector
    }

    /// A level way that brings the object to another place at which it may lie, m.
    fn draw_shift(&self, world: &World, rng: &mut Rng) -> Vector3<f64> {
        let body = self.object.body();
        let (at, bounds, area) = (world.pose(body).translation, world.bounds(body), O::area());
        let mut along = |axis: usize| {
            let [low, high] = if self.narrow {
                let middle = WORKSPACE.centre()[axis] - at.vector[axis];
                [middle - O::NARROW, middle + O::NARROW]
            } else {
                [area.min[axis] - bounds.min[axis], area.max[axis] - bounds.max[axis]]
            };
            rng.uniform(low.min(0.0), high.max(0.0))
        };
        let (x, y) = (along(0), along(1));
        Vector3::new(x, y, 0.0)
    }

    /// What is to be done now by an arm with its wrist at `wrist`.
    fn pick(&self, world: &World, wrist: &Pose, input: &ExpertInput<'_>) -> Pick {
        let (grasp, press) = self.object.grasp(world, self.pad.as_ref(), wrist, input);
        let carried = self.object.carried(world) + input.position_error;
        Pick { object: self.object.body(), grasp, press, carried, goal: self.goal }
    }
}
