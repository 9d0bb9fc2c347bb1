//! Tasks in which one arm takes the free edge of a sheet of fat and brings a point of it somewhere.
//!
//! What such tasks have in common is [`Handling`]; what is special about one is its [`Purpose`].
//!
//! The goal has parts (see [`GoalPart`]): where the point is, whether both fingers have pressed on the sheet at the ends of the
//! last [`HOLD`] steps, the largest pull of the sheet on the jaws so far, and what the purpose adds.

use std::f64::consts::FRAC_PI_2;
use std::fmt::Debug;
use std::ops::Range;

use nalgebra::Vector3;
use trocar_proto::builtin::TaskInfo;
use trocar_proto::goal::{GoalPart, SuccessRule};
use trocar_proto::relative::Relative;
use trocar_proto::spec::{Allowed, Element, GoalSpec, OptionSpec, OptionValue, RowSpec};
use trocar_proto::{Options, Rejection, Stage};

use super::expert::{ArmView, ExpertInput, Sees};
use super::objects::{self, THEATRE};
use super::options::{self, Domain, Preset};
use super::pick;
use super::psm_scene::{PaperAction, PsmArm, RATE, SQUEEZE, Station, Turn, WORKSPACE};
use super::relative;
use super::soft_grasp::{self, SoftGrasp};
use super::theatre;
use super::tissue::{self, Sheet};
use super::tray;
use super::{Arms, Registered, State, Task};
use crate::render::Scene;
use crate::render::material::Material;
use crate::render::mesh::Mesh;
use crate::sim::frames::{self, Pose};
use crate::sim::instrument::{JAW_CLOSED, Jaws, TIP_OFFSET};
use crate::sim::random::Rng;
use crate::sim::soft::MaterialPoint;
use crate::sim::world::World;

/// Steps in a row at whose ends both fingers must press on the sheet.
pub const HOLD: u32 = 3;

/// How much less than always counts as held.
const HELD: f32 = 0.1;

/// Largest pull with which success is one, N, and the pull beyond which it is shown as that, N. Source: 5 N pull a cecum
/// away from its place, and its damage begins at a pinch of 15 N (Heijnsdijk 2004).
const MOST_PULL: f64 = 3.0;

/// Forces beyond this are shown as this, N.
const SHOWN: f64 = 20.0;

/// How far beyond its reach a wrist may be seen, m: instruments give way to tissue by up to 2.4 mm in a step of 0.2 s,
/// 0.05 mm in each 1/240 s.
const BEYOND: f64 = 3e-3;

/// The distance of the point that takes 1 from the dense reward, m.
pub const LENGTH: f32 = 0.01;

/// Where along x jaws take the sheet, m, sheet's frame: one finger is on the free edge's either side.
const GRASP_X: f64 = 28e-3;

/// How far the tips go under the upper face, m: `server/GRASPING.md` has what happens elsewhere.
const DEPTH: f64 = 4e-3;

/// How far above the grasp the jaws open, m.
const HOVER: f64 = 11e-3;

/// How far beside the grasp the wrist may be, m, and how far turned, rad, when it goes down and the jaws close.
const ALIGNED: f64 = 1.5e-3;
const TURNED: f64 = 0.15;

/// How low the wrist must be for the jaws to close, m above the grasp, and where it was held up.
const LOW: f64 = 0.7e-3;
const LOW_ENOUGH: f64 = 2e-3;

/// How far the wrist may be from the grasp while the jaws close, m.
const CLOSING: f64 = 4e-3;

/// What is done with a sheet.
pub trait Purpose: Debug + Clone + Send + Sync + 'static {
    /// What is fixed of its task.
    const INFO: TaskInfo;

    /// What the state calls the point that is brought somewhere.
    const POINT: &'static str;

    /// How near its place that point must be, m.
    const NEAR: f64;

    /// Fields of the state that nothing changes.
    const CONSTANT: &'static [&'static str];

    /// What an arm with these options is to do.
    fn new(options: &Options) -> Result<Self, Rejection>;

    /// Draws what an episode is about: the point, x and y in the sheet's frame, m, and how far its place is from where
    /// it lies, m.
    fn begin(&mut self, rng: &mut Rng) -> ([f64; 2], Vector3<f64>);

    /// Takes note of how the sheet is now.
    fn look(&mut self, sheet: &Sheet, world: &World);

    /// What its goal has besides, with the number of each that is desired: elements, tolerances and units.
    fn parts() -> Vec<(Element, f32, f32)>;

    /// Writes what is achieved of these parts, and what is desired.
    fn goals(&self, achieved: &mut [f32], desired: &mut [f32]);

    /// What its state has besides.
    fn state(&self, state: &mut State<'_>);

    /// Draws what it adds.
    fn draw(&self, point: &Vector3<f64>, scene: &mut Scene);
}

/// A task with a sheet.
#[derive(Debug, Clone)]
pub struct Handling<P> {
    arm: PsmArm,
    sheet: Sheet,
    grasp_mode: SoftGrasp,
    purpose: P,
    /// The point, where it is taken, and where it is to be, m.
    point: MaterialPoint,
    grasp: MaterialPoint,
    goal: Vector3<f64>,
    /// Steps in a row at whose ends both fingers pressed on the sheet.
    held: u32,
    /// Largest pull so far, N.
    pull: f64,
}

/// Numbers of the goal before those of the purpose: the point, whether it is held, the pull.
const COMMON: usize = 5;

/// What may be asked of a task with something soft, whose `domain` has these rows.
pub fn options(rows: Vec<RowSpec>) -> Vec<OptionSpec> {
    let [grasp, distance] = SoftGrasp::options();
    vec![
        options::reward(),
        grasp,
        distance,
        OptionSpec::choice(
            "instrument",
            "tissue_forceps: broad, profiled jaws; needle_driver: narrow, smooth ones.",
            &["tissue_forceps", "needle_driver"],
        ),
        OptionSpec {
            name: "squeeze".into(),
            summary: "Force with which each finger squeezes, N.".into(),
            default: OptionValue::Number(SQUEEZE),
            allowed: Allowed::Range { min: 0.5, max: 4.0 },
        },
        options::action(),
        options::observation(),
        options::arm(),
        RATE.option(5.0),
        Sees::option(),
        options::domain_with(rows.into_iter().chain(options::psm_rows())),
        options::setup(&PsmArm::setup_rows(1)),
    ]
}

/// Where its arm stands and what it has at the end of its wrist.
pub fn station(options: &Options) -> Station {
    let start = [WORKSPACE.min.x, WORKSPACE.max.y, WORKSPACE.centre().z + TIP_OFFSET];
    let jaws = match options.text("instrument") {
        Some("needle_driver") => Jaws::NEEDLE_DRIVER,
        _ => Jaws::TISSUE_FORCEPS,
    };
    let squeeze = options.number("squeeze");
    Station { squeeze, jaws, ..Station::psm1(start, tray::pad().max.z) }
}

/// A part of the goal: these of its numbers, reached within `tolerance`, with `unit` as 1 in the dense reward.
pub fn part(name: &str, numbers: Range<usize>, tolerance: f32, unit: f32) -> GoalPart {
    let Range { start, end } = numbers;
    GoalPart { name: name.into(), start, count: end - start, tolerance, unit }
}

/// The part of a state that is an arm's beside tissue, which may push it out of its reach.
pub fn arm_state(arm: &PsmArm, world: &World, state: &mut State<'_>) {
    arm.state_within(&arm.reach().grown(BEYOND), world, state);
}

/// Goes through the fields that tell how hard each finger is pressed.
pub fn pressures(arm: &PsmArm, world: &World, state: &mut State<'_>) {
    for (finger, pressure) in arm.pressures(world).into_iter().enumerate() {
        let name = format!("pressure on finger {}", finger + 1);
        state.field(|| Element::new(&name, "", "N", 0.0, SHOWN as f32), pressure.min(SHOWN));
    }
}

/// Draws a disc that lies on the pad.
pub fn draw_disc(name: &'static str, at: &Vector3<f64>, radius: f64, scene: &mut Scene) {
    const HALF_THICKNESS: f64 = 0.2e-3;
    scene.begin(name);
    // The axis of the cylinder is y.
    let upright = frames::pose((*at).into(), [FRAC_PI_2, 0.0, 0.0]);
    scene.draw(Mesh::cylinder(HALF_THICKNESS, radius).into(), upright, Material::named("block"));
}

impl<P: Purpose> Registered for Handling<P> {
    const INFO: TaskInfo = P::INFO;
    const CONSTANT: &'static [&'static str] = P::CONSTANT;
    const CONSTANT_UNDER_PAPER: &'static [&'static str] = &["wrist link roll", "wrist link pitch"];

    fn options() -> Vec<OptionSpec> {
        options(Sheet::rows())
    }

    fn new(options: &Options) -> Result<(Self, World), Rejection> {
        let (mut world, sheet) = Sheet::furnish(Domain::of(options)?)?;
        let paper = PaperAction { turn: Turn::Vertical, jaw: true };
        let arm = PsmArm::insert(&mut world, options, paper, station(options))?;
        let middle = sheet.upper_point(&world, [GRASP_X, 0.0]);
        let task = Self {
            arm,
            grasp_mode: SoftGrasp::new(options, sheet.soft()),
            sheet,
            purpose: P::new(options)?,
            point: middle,
            grasp: middle,
            goal: Vector3::zeros(),
            held: 0,
            pull: 0.0,
        };
        Ok((task, world))
    }
}

impl<P: Purpose> Task for Handling<P> {
    fn action(&self) -> Vec<Element> {
        self.arm.action_elements()
    }

    fn goal(&self) -> Option<GoalSpec> {
        let mut elements = objects::position_elements(P::POINT, &THEATRE, Preset::Paper);
        elements.push(Element::new("held", "", "1", 0.0, 1.0));
        elements.push(Element::new("peak pull", "", "N", 0.0, SHOWN as f32));
        let most = MOST_PULL as f32;
        let mut parts = vec![
            part(P::POINT, 0..3, P::NEAR as f32, LENGTH),
            part("held", 3..4, HELD, 1.0),
            part("peak pull", 4..5, most, most),
        ];
        for (element, tolerance, unit) in P::parts() {
            let at = elements.len();
            parts.push(part(&element.name, at..at + 1, tolerance, unit));
            elements.push(element);
        }
        Some(GoalSpec { elements, success: SuccessRule::Parts(parts) })
    }

    fn relative(&self, state: &[Element]) -> Relative {
        let goal_dim = COMMON + P::parts().len();
        let sheet = ("sheet", self.sheet.observed_count());
        relative::handling(&self.arm, sheet, P::POINT, state, goal_dim)
    }

    fn reset(&mut self, world: &mut World, rng: &mut Rng) {
        self.sheet.vary(world, rng);
        let (place, way) = self.purpose.begin(rng);
        self.point = self.sheet.upper_point(world, place);
        self.grasp = self.sheet.upper_point(world, [GRASP_X, place[1]]);
        self.goal = self.sheet.at(world, &self.point) + way;
        (self.held, self.pull) = (0, 0.0);
        self.purpose.look(&self.sheet, world);
        self.arm.reset(world, rng);
    }

    fn set_goal(&mut self, goal: &Vector3<f64>) -> Result<(), Rejection> {
        self.arm.check_goal(goal)?;
        self.goal = *goal;
        Ok(())
    }

    fn command(&mut self, world: &mut World, action: Option<&[f32]>) {
        self.arm.command(action);
        self.grasp_mode.command(&self.arm, world);
    }

    fn arms(&mut self) -> Arms<'_> {
        [&mut self.arm].into_iter().collect()
    }

    fn after_step(&mut self, world: &mut World) {
        let soft = self.sheet.soft();
        self.grasp_mode.after_step(&mut self.arm, world);
        let is_held = self.grasp_mode.holds(&self.arm, world);
        self.held = if is_held { (self.held + 1).min(HOLD) } else { 0 };
        self.pull = self.pull.max(self.arm.pull_of(world, soft).norm().min(SHOWN));
        self.purpose.look(&self.sheet, world);
    }

    fn state(&self, world: &World, state: &mut State<'_>) {
        arm_state(&self.arm, world, state);
        let (point, wrist) = (self.sheet.at(world, &self.point), self.arm.scene_from_wrist());
        objects::position_and_from_wrist(P::POINT, &point, wrist, Preset::Paper, state);
        for (index, at) in self.sheet.observed(world).enumerate() {
            let name = format!("sheet {}", index + 1);
            objects::position(&name, &THEATRE, Preset::Paper, &at, state);
        }
        pressures(&self.arm, world, state);
        self.purpose.state(state);
    }

    fn goals(&self, world: &World, achieved: &mut [f32], desired: &mut [f32]) {
        let (achieved, own) = achieved.split_at_mut(COMMON);
        let (desired, own_desired) = desired.split_at_mut(COMMON);
        objects::write_goal(&self.sheet.at(world, &self.point), Preset::Paper, &mut achieved[..3]);
        objects::write_goal(&self.goal, Preset::Paper, &mut desired[..3]);
        achieved[3] = self.held as f32 / HOLD as f32;
        achieved[4] = self.pull as f32;
        (desired[3], desired[4]) = (1.0, 0.0);
        self.purpose.goals(own, own_desired);
    }

    fn scene(&self, world: &World, scene: &mut Scene) {
        theatre::draw(scene, self.arm.model());
        tray::draw(scene);
        self.purpose.draw(&self.sheet.at(world, &self.point), scene);
        self.arm.draw(world, scene);
        scene.add_goal(&self.goal, theatre::GOAL_RADIUS);
    }

    fn expert(&self, world: &World, input: &ExpertInput<'_>, action: &mut [f32]) {
        let [view] = ArmView::of([&self.arm], world, input);
        let (_, target, jaw) = self.plan(&view, world, input);
        view.act(&target, jaw, action);
    }

    fn stage(&self, world: &World, input: &ExpertInput<'_>) -> Stage {
        let [view] = ArmView::of([&self.arm], world, input);
        self.plan(&view, world, input).0
    }
}

impl<P: Purpose> Handling<P> {
    /// What a scripted expert does now: where the wrist goes for it, and the angle of the jaws, rad. It takes the free
    /// edge beside the point from above, and then moves the wrist as the point is to move.
    fn plan(
        &self,
        arm: &ArmView<'_>,
        world: &World,
        input: &ExpertInput<'_>,
    ) -> (Stage, Pose, f64) {
        let seen = self.sheet.at(world, &self.grasp) + input.position_error;
        let near = 2.0 * tissue::HALF.z;
        if self.grasp_mode.has_closed(arm, world, input.sees, &seen, near) {
            let way = self.goal - self.sheet.at(world, &self.point) - input.position_error;
            return (Stage::Carry, Pose::from(way) * arm.wrist, JAW_CLOSED);
        }
        let mut taken = self.sheet.at(world, &self.grasp);
        // Jaws press it down before they are about it.
        taken.z = taken.z.max(self.sheet.top());
        let mut wrist = taken + input.position_error + Vector3::z() * (TIP_OFFSET - DEPTH);
        let off = arm.aim.translation.vector - wrist;
        // Jaws that go down take the sheet along a little: they go straight on.
        let is_down = off.z < 0.5 * HOVER && off.xy().norm() < CLOSING;
        if is_down {
            (wrist.x, wrist.y) = (arm.aim.translation.x, arm.aim.translation.y);
        }
        let grasp = Pose::from_parts(wrist.into(), pick::jaws_across(&Vector3::y(), &arm.wrist));
        let is_turned = arm.aim.rotation.angle_to(&grasp.rotation) < TURNED;
        let is_aligned = is_down || off.xy().norm() < ALIGNED;
        let is_about = is_aligned && is_turned && arm.is_open() && !arm.closes();
        let is_closing = arm.closes() && is_down && !arm.is_closed();
        let is_low = off.z < LOW || off.z < LOW_ENOUGH && arm.is_held_up();
        soft_grasp::go_for(&grasp, is_about, is_closing || is_about && is_low, HOVER)
    }
}
