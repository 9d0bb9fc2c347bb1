//! Gauze placement: a PSM lays a soft gauze swab on a spot.
//!
//! # Description
//!
//! A swab of wet gauze of 40 mm × 25 mm × 2.5 mm lies on the pad in the tray. PSM1 is to pick it up, to lay it on a round
//! spot of 12 mm, and to let go of it. Jaws hold it by friction alone. The swab is a lattice of 160 hexahedra
//! ([`soft`](crate::sim::soft)) of the material `gauze` of `assets/materials.csv`, with a Young's modulus of 10 kPa.
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
//! | 3 | turn of the jaws about the vertical | −1 | 1 | 30° |
//! | 4 | jaw: below 0 close, else open to 40° | −1 | 1 | – |
//!
//! The movement starts from the sensed wrist, takes 0.2 s along a smooth profile, and is confined
//! to the workspace: see [`psm_scene`](super::psm_scene).
//!
//! # Observation Space
//!
//! | Num | Meaning | Min | Max | Unit |
//! |---|---|---|---|---|
//! | 0 | wrist x (wrist-yaw axis, as sensed), scene frame | 0.493 | 0.607 | m |
//! | 1 | wrist y | −0.057 | 0.057 | m |
//! | 2 | wrist z | 0.6822 | 0.7742 | m |
//! | 3 | roll of the wrist link; −π/2 under `paper` | −π | π | rad |
//! | 4 | pitch; 0 under `paper` | −π/2 | π/2 | rad |
//! | 5 | yaw | −π | π | rad |
//! | 6 | jaw angle: the opening between the fingers | −0.1 | 1.6 | rad |
//! | 7–9 | middle of the gauze x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 10–12 | the same less wrist x, y, z, scene frame | −0.313, −0.323, −0.1722 | 0.213, 0.323, 0.2158 | m |
//! | 13–15 | point 1 of its outline x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 16–18 | point 2 of its outline x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 19–21 | point 3 of its outline x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 22–24 | point 4 of its outline x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 25–27 | point 5 of its outline x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 28–30 | point 6 of its outline x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 31–33 | point 7 of its outline x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 34–36 | point 8 of its outline x, y, z, scene frame | 0.292, −0.268, 0.6 | 0.708, 0.268, 0.9 | m |
//! | 37–38 | how hard each finger is pressed | 0 | 20 | N |
//! | 39 | the share of the spot that the gauze covers | 0 | 1 | 1 |
//!
//! The angles are extrinsic XYZ Euler angles, R = Rz(yaw)·Ry(pitch)·Rx(roll), of the wrist-yaw link, whose y axis points along
//! the jaws and whose z axis is their hinge. The points are corners and middles of edges, in turn. What is outside its
//! range is shown at its end.
//!
//! # Goal
//!
//! | Num | Part | Achieved | Desired | Reached within | 1 in the dense reward |
//! |---|---|---|---|---|---|
//! | 0–2 | `gauze` | the middle of the gauze x, y, z, m | where that is when it lies on the spot | 5 mm | 10 mm |
//! | 3 | `covered` | the share of the spot below the gauze | 1 | 0.1 | 1 |
//! | 4 | `released` | the share of the last three steps after which no finger presses on the gauze | 1 | 0.1 | 1 |
//!
//! The share is that of 64 points spread over the spot.
//!
//! # Rewards
//!
//! `sparse` (default): 0 where every part of the goal is reached, −1 otherwise. `dense`: minus the sum of all parts'
//! distances, each over what the table says. Both are functions of the goals alone.
//!
//! # Starting State
//!
//! The wrist at the corner (0.50, 0.05, 0.7202) m, jaws closed and straight down. The gauze lies flat, at rest, anywhere
//! wholly in the 10 cm workspace, its long side within 30° of x. The spot is 25 mm or more from its middle, where the
//! gauze may lie, too.
//!
//! # Episode End
//!
//! Truncated after 60 steps; never terminated.
//!
//! # Options
//!
//! `reward`, `action`, `observation`, and:
//!
//! - `instrument`: `tissue_forceps`: jaws 5 mm broad and profiled; `needle_driver`: 1.8 mm broad and smooth.
//! - `squeeze`: force with which each finger squeezes, 0.5 to 4 N; 1 N.
//! - `arm = "si"`: the arm of the S and Si in place of the first generation's, see [`psm_scene`](super::psm_scene).
//! - `grasp = "approx"`: the skin between closed jaws, or up to `grasp_distance` (2 mm) from there, is attached to the wrist
//!   without friction until the jaws open.
//! - `domain`: `modulus` (5,000 to 20,000 Pa; Young's modulus), `thickness` (1.5 to 4 mm, in m; 2.5 mm), `friction`
//!   (coefficient of profiled jaws on the gauze), and `observation_noise`, `joint_offset`, `latency` and the others that all PSM tasks have.
//! - `setup`: `base` (x, y, z in m and turn in rad of the arm's base), `table_height` (m). The arm
//!   must reach the whole workspace.
//!
//! # Version History
//!
//! - v0: first version.

use std::f64::consts::FRAC_PI_6;
use std::sync::Arc;

use nalgebra::{Point3, UnitQuaternion, Vector3};
use trocar_proto::builtin::{self, TaskInfo};
use trocar_proto::goal::SuccessRule;
use trocar_proto::relative::Relative;
use trocar_proto::spec::{Element, GoalSpec, OptionSpec};
use trocar_proto::{Options, Rejection, Stage};

use super::expert::{ArmView, ExpertInput};
use super::exposure;
use super::objects::{self, THEATRE, TOLERANCE};
use super::options::{Domain, Preset};
use super::pick;
use super::psm_scene::{PaperAction, PsmArm, Turn, WORKSPACE};
use super::relative;
use super::soft_grasp::{self, SoftGrasp};
use super::theatre;
use super::tissue::{self, Substance};
use super::tissue_task::{self, HOLD};
use super::tray;
use super::{Arms, Registered, State, Task};
use crate::render::Scene;
use crate::sim::frames::{Aabb, Pose};
use crate::sim::instrument::{JAW_CLOSED, JAW_OPEN, TIP_OFFSET};
use crate::sim::random::Rng;
use crate::sim::soft::{Form, MaterialPoint, Skin, SoftBody, box_distance};
use crate::sim::world::{SoftId, World};

/// Thickness where `domain` has none, m.
const THICKNESS: f64 = 2.5e-3;

/// Half extents then, m.
const HALF: Vector3<f64> = Vector3::new(0.02, 0.0125, 0.5 * THICKNESS);

/// Edge of an element, m.
const SPACING: f64 = 2.5e-3;

/// Colour in pictures.
const COLOUR: [f32; 3] = [0.96, 0.96, 0.94];

/// What it is made of, and the Young's moduli that `domain` may have, Pa.
const SUBSTANCE: Substance = Substance {
    material: "gauze",
    modulus: 10e3,
    moduli: [5e3, 20e3],
    thickness: THICKNESS,
    thicknesses: [1.5e-3, 4e-3],
};

/// How far its long side is turned from x, at most, rad.
const TURNED: f64 = FRAC_PI_6;

/// Radius of the spot, m.
const RADIUS: f64 = 6e-3;

/// How far the spot is from the middle of the gauze, at least, m.
const APART: f64 = 25e-3;

/// Share of the spot that may be bare, exclusive, and how much less than always counts as released.
const BARE: f32 = 0.1;
const RELEASED: f32 = 0.1;

/// How far the tips go under the upper face, m.
const DEPTH: f64 = 1.5e-3;

/// How far above the grasp the jaws open, m, and above the pad they carry the gauze, m.
const HOVER: f64 = 8e-3;
const CARRIED: f64 = 20e-3;

/// How far beside the grasp the wrist may be when it goes down, m, and how far while the jaws close.
const ALIGNED: f64 = 1.5e-3;
const CLOSING: f64 = 4e-3;

/// How far the jaws may be turned from where they are to close, rad.
const SKEWED: f64 = 0.15;

/// How low the wrist must be for the jaws to close, m above the grasp, and where it was held up.
const LOW: f64 = 0.5e-3;
const LOW_ENOUGH: f64 = 1.5e-3;

/// How far beside the spot the gauze is let down, m, and with its middle how far above where it is to lie it is let go, m.
const OVER: f64 = 1.5e-3;
const DOWN: f64 = 2.5e-3;

/// The task; see the module's description.
#[derive(Debug, Clone)]
pub struct GauzePlace {
    arm: PsmArm,
    gauze: SoftId,
    grasp: SoftGrasp,
    domain: Domain,
    middle: MaterialPoint,
    outline: Vec<MaterialPoint>,
    /// Where the middle is when the gauze lies on the spot, m.
    goal: Vector3<f64>,
    /// Thickness of this episode's gauze, m.
    thickness: f64,
    covered: f64,
    /// Steps in a row at whose ends no finger pressed on the gauze.
    free: u32,
}

impl Registered for GauzePlace {
    const INFO: TaskInfo = builtin::GAUZE_PLACE;
    const CONSTANT_UNDER_PAPER: &'static [&'static str] = &["wrist link roll", "wrist link pitch"];

    fn options() -> Vec<OptionSpec> {
        tissue_task::options(SUBSTANCE.rows())
    }

    fn new(options: &Options) -> Result<(Self, World), Rejection> {
        let domain = Domain::of(options)?;
        let bounds = Aabb { min: -HALF, max: HALF };
        let form = SUBSTANCE.form(&domain, |material| {
            Form::carved(&bounds, SPACING, material, box_distance(&HALF))
        })?;
        let skin = Skin::new(&form, &bounds, SPACING, box_distance(&HALF));
        let point =
            |[x, y]: [f64; 2]| MaterialPoint::of(&form, &Point3::new(x * HALF.x, y * HALF.y, 0.0));
        let ends = [[-1.0, -1.0], [0.0, -1.0], [1.0, -1.0], [1.0, 0.0]];
        let outline = ends.into_iter().chain(ends.map(|[x, y]| [-x, -y])).map(point).collect();
        let middle = point([0.0, 0.0]);
        let mut world = tray::furnished_world(Preset::Paper);
        let body = SoftBody::new("gauze", COLOUR, Arc::new(form), Arc::new(skin), &resting());
        let gauze = world.insert_soft(body);
        tissue::settle(&mut world);
        let paper = PaperAction { turn: Turn::Vertical, jaw: true };
        let arm = PsmArm::insert(&mut world, options, paper, tissue_task::station(options))?;
        let goal = resting().translation.vector;
        let (thickness, covered, free) = (SUBSTANCE.thickness, 0.0, 0);
        let grasp = SoftGrasp::new(options, gauze);
        let task =
            Self { arm, gauze, grasp, domain, middle, outline, goal, thickness, covered, free };
        Ok((task, world))
    }
}

/// Where it lies, undeformed, in the middle of the workspace.
fn resting() -> Pose {
    let centre = WORKSPACE.centre();
    Pose::translation(centre.x, centre.y, tray::pad().max.z + HALF.z)
}

impl Task for GauzePlace {
    fn action(&self) -> Vec<Element> {
        self.arm.action_elements()
    }

    fn goal(&self) -> Option<GoalSpec> {
        let mut elements = objects::position_elements("gauze", &THEATRE, Preset::Paper);
        elements.push(Element::new("covered", "", "1", 0.0, 1.0));
        elements.push(Element::new("released", "", "1", 0.0, 1.0));
        let success = SuccessRule::Parts(vec![
            tissue_task::part("gauze", 0..3, TOLERANCE as f32, tissue_task::LENGTH),
            tissue_task::part("covered", 3..4, BARE, 1.0),
            tissue_task::part("released", 4..5, RELEASED, 1.0),
        ]);
        Some(GoalSpec { elements, success })
    }

    fn relative(&self, state: &[Element]) -> Relative {
        relative::handling(&self.arm, ("outline", self.outline.len()), "gauze", state, 5)
    }

    fn reset(&mut self, world: &mut World, rng: &mut Rng) {
        self.thickness = SUBSTANCE.vary(&self.domain, self.gauze, &resting(), world, rng);
        // A gauze that is turned stays within a circle.
        let half = HALF.xy().norm();
        let mut along =
            |axis: usize| rng.uniform(WORKSPACE.min[axis] + half, WORKSPACE.max[axis] - half);
        let at = Vector3::new(along(0), along(1), tray::pad().max.z + 0.5 * self.thickness);
        self.goal = at;
        while (self.goal - at).norm() < APART {
            self.goal = Vector3::new(along(0), along(1), at.z);
        }
        let turn =
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.uniform(-TURNED, TURNED));
        let mut laid = Pose::from_parts(at.into(), turn);
        laid.translation.z = resting().translation.z;
        world.soft_mut(self.gauze).carry(&(laid * resting().inverse()));
        (self.covered, self.free) = (0.0, HOLD);
        self.arm.reset(world, rng);
    }

    fn set_goal(&mut self, goal: &Vector3<f64>) -> Result<(), Rejection> {
        self.arm.check_goal(goal)?;
        self.goal = *goal;
        Ok(())
    }

    fn command(&mut self, world: &mut World, action: Option<&[f32]>) {
        self.arm.command(action);
        self.grasp.command(&self.arm, world);
    }

    fn arms(&mut self) -> Arms<'_> {
        [&mut self.arm].into_iter().collect()
    }

    fn after_step(&mut self, world: &mut World) {
        self.grasp.after_step(&mut self.arm, world);
        let is_free = self.grasp.is_free(&self.arm, world);
        self.free = if is_free { (self.free + 1).min(HOLD) } else { 0 };
        let spot = self.spot();
        let above = spot + Vector3::z();
        self.covered = 1.0 - exposure::share(&above, &spot, RADIUS, world.soft(self.gauze));
    }

    fn state(&self, world: &World, state: &mut State<'_>) {
        tissue_task::arm_state(&self.arm, world, state);
        let (middle, wrist) = (self.at(world), self.arm.scene_from_wrist());
        objects::position_and_from_wrist("gauze", &middle, wrist, Preset::Paper, state);
        for (index, at) in world.soft(self.gauze).points(&self.outline).enumerate() {
            let name = format!("outline {}", index + 1);
            objects::position(&name, &THEATRE, Preset::Paper, &at.coords, state);
        }
        tissue_task::pressures(&self.arm, world, state);
        state.field(|| Element::new("covered", "", "1", 0.0, 1.0), self.covered);
    }

    fn goals(&self, world: &World, achieved: &mut [f32], desired: &mut [f32]) {
        objects::write_goal(&self.at(world), Preset::Paper, &mut achieved[..3]);
        objects::write_goal(&self.goal, Preset::Paper, &mut desired[..3]);
        achieved[3] = self.covered as f32;
        achieved[4] = self.free as f32 / HOLD as f32;
        desired[3..].fill(1.0);
    }

    fn scene(&self, world: &World, scene: &mut Scene) {
        theatre::draw(scene, self.arm.model());
        tray::draw(scene);
        tissue_task::draw_disc("spot", &self.spot(), RADIUS, scene);
        self.arm.draw(world, scene);
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

impl GauzePlace {
    /// The middle of the gauze, m.
    fn at(&self, world: &World) -> Vector3<f64> {
        world.soft(self.gauze).lattice().point(&self.middle).coords
    }

    /// The middle of the spot, on the pad, m.
    fn spot(&self) -> Vector3<f64> {
        self.goal - Vector3::z() * (0.5 * self.thickness)
    }

    /// What a scripted expert does now: where the wrist goes for it, and the angle of the jaws, rad. It takes the gauze in
    /// its middle across its short side, carries it over the spot, lets it down and lets go.
    fn plan(
        &self,
        arm: &ArmView<'_>,
        world: &World,
        input: &ExpertInput<'_>,
    ) -> (Stage, Pose, f64) {
        let middle = self.at(world) + input.position_error;
        let way = self.goal - middle;
        let rise = |height: f64| Pose::from(Vector3::z() * height);
        if self.grasp.has_closed(arm, world, input.sees, &middle, 2.0 * CLOSING) {
            let low = self.goal.z + CARRIED - middle.z;
            if way.xy().norm() > OVER {
                let (x, y) = if low > 0.5 * CARRIED { (0.0, 0.0) } else { (way.x, way.y) };
                let carry = Pose::from(Vector3::new(x, y, low));
                return (Stage::Carry, carry * arm.wrist, JAW_CLOSED);
            }
            let is_down = -way.z < DOWN || arm.is_held_up() || arm.is_lowest();
            let jaw = if is_down { JAW_OPEN } else { JAW_CLOSED };
            let down = Pose::from(Vector3::new(way.x, way.y, way.z.min(0.0)));
            return (Stage::Carry, down * arm.wrist, jaw);
        }
        if way.norm() < TOLERANCE && (arm.is_open() || !arm.closes()) {
            // It lies where it is to.
            let up = if arm.is_open() { rise(CARRIED) } else { Pose::identity() };
            return (Stage::Carry, up * arm.wrist, JAW_OPEN);
        }
        let half = 0.5 * self.thickness;
        let top = middle.z.clamp(self.goal.z, self.goal.z + 2.0 * half) + half;
        let wrist = Vector3::new(middle.x, middle.y, top - DEPTH + TIP_OFFSET);
        let [first, second] = [3, 7].map(|index| self.outline[index]);
        let lattice = world.soft(self.gauze).lattice();
        let long = lattice.point(&first) - lattice.point(&second);
        let short = Vector3::z().cross(&long);
        let grasp = Pose::from_parts(wrist.into(), pick::jaws_across(&short, &arm.wrist));
        let off = arm.aim.translation.vector - wrist;
        let is_turned = arm.aim.rotation.angle_to(&grasp.rotation) < SKEWED;
        let is_aligned = off.xy().norm() < if off.z < HOVER { CLOSING } else { ALIGNED };
        let is_low = off.z < LOW || off.z < LOW_ENOUGH && arm.is_held_up();
        let is_closing = arm.closes() && off.norm() < CLOSING && !arm.is_closed();
        let is_about = is_aligned && is_turned && arm.is_open() && !arm.closes();
        soft_grasp::go_for(&grasp, is_about, is_closing || is_about && is_low, HOVER + 1e-3)
    }
}
