//! What tasks share that pick up one object: what is observed of it, where a goal may be.

use nalgebra::Vector3;
use trocar_proto::goal::SuccessRule;
use trocar_proto::spec::{Element, GoalSpec, OptionSpec, RowSpec};

use super::expert::Sees;
use super::options::{self, Preset, Variation};
use super::psm_scene::{PsmArm, RATE, REACH, WORKSPACE};
use super::state::State;
use crate::assets::{Model, Scaled};
use crate::render::Scene;
use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

/// Where objects are reported, m: the space over the table. One that falls from it is reported at
/// its edge.
pub const THEATRE: Aabb = Aabb::new([0.292, -0.268, 0.60], [0.708, 0.268, 0.90]);

/// Distance below which the goal is reached, m. Source: the paper.
pub const TOLERANCE: f64 = 0.005;

/// A free object in the world.
#[derive(Debug, Clone, Copy)]
pub struct Object {
    body: BodyId,
    /// Its shapes and frames in this episode.
    form: Scaled<'static>,
    /// What it weighs where no episode varies it, kg.
    mass: f64,
}

impl Object {
    /// Puts an object like `model` into the world, at rest, but of `mass`, kg.
    pub fn insert(world: &mut World, model: &'static Model, mass: f64, at: &Pose) -> Self {
        Self { body: model.insert(world, mass, at), form: model.scaled(1.0), mass }
    }

    /// The body in the world.
    pub fn body(&self) -> BodyId {
        self.body
    }

    /// Its shapes and frames in this episode.
    pub fn form(&self) -> &Scaled<'static> {
        &self.form
    }

    /// Draws it as a body `name`.
    pub fn draw(&self, world: &World, name: &'static str, scene: &mut Scene) {
        scene.begin(name);
        scene.draw_scaled(&self.form, &world.pose(self.body), |material| material);
    }

    /// Makes of it what an episode makes of its objects; it must be laid anew.
    pub fn vary(&mut self, world: &mut World, Variation { mass, size }: Variation) {
        self.form = self.form.resized(size);
        world.reshape(self.body, self.form.parts());
        let mass = self.mass * mass * (size * size * size);
        world.set_inertia(self.body, &self.form.inertia().with_mass(mass));
    }
}

/// The options of tasks in which PSMs, so many of them, grasp an object of a `size` between two
/// factors: those that all have, and `own`; `rows` are rows of `domain` that the task has besides.
pub fn options(
    arms: usize,
    size: [f64; 2],
    own: impl IntoIterator<Item = OptionSpec>,
    rows: impl IntoIterator<Item = RowSpec>,
) -> Vec<OptionSpec> {
    let [grasp, grasp_distance] = options::grasp();
    let mut specs = vec![
        options::reward(),
        grasp,
        grasp_distance,
        options::action(),
        options::observation(),
        options::preset(),
        options::arm(),
        RATE.option(5.0),
        Sees::option(),
    ];
    specs.extend(own);
    let own = std::iter::once(options::friction_row()).chain(options::object_rows(size));
    let rows = own.chain(rows);
    specs.extend([
        options::domain_with(rows.chain(options::psm_rows())),
        options::setup(&PsmArm::setup_rows(arms)),
    ]);
    specs
}

/// The elements of a position that an object takes along where it is lost, within `bounds` (m).
pub fn position_elements(name: &str, bounds: &Aabb, preset: Preset) -> Vec<Element> {
    let elements = options::position_elements(name, "scene", bounds, preset);
    elements.into_iter().map(Element::saturating).collect()
}

/// What a state has of an object: its origin (3), that less the wrist's (3), the place to grasp (3) and its extrinsic XYZ
/// Euler angles (3). `object` and `place` are names and where both are, `wrist` is the wrist as sensed.
pub fn state(
    (object, scene_from_object): (&str, &Pose),
    (place, scene_from_place): (&str, &Pose),
    wrist: &Pose,
    preset: Preset,
    state: &mut State<'_>,
) {
    position_and_from_wrist(object, &scene_from_object.translation.vector, wrist, preset, state);
    position(place, &THEATRE, preset, &scene_from_place.translation.vector, state);
    state.angles(place, "scene", frames::euler_xyz(&scene_from_place.rotation));
}

/// What a state has of a position `at` (m) that an object takes along where it is lost: that (3), and that less the wrist's as sensed (3).
pub fn position_and_from_wrist(
    name: &str,
    at: &Vector3<f64>,
    wrist: &Pose,
    preset: Preset,
    state: &mut State<'_>,
) {
    position(name, &THEATRE, preset, at, state);
    let scale = options::position_scale(preset);
    let less_wrist = at * scale - wrist.translation.vector * scale;
    let elements = || {
        let relative = Aabb { min: THEATRE.min - REACH.max, max: THEATRE.max - REACH.min };
        position_elements(&format!("{name} from wrist"), &relative.grown(1e-3), preset)
    };
    state.fields(elements, less_wrist.iter().copied());
}

/// A position `at` (m) that an object takes along where it is lost, within `bounds` (m).
pub fn position(
    name: &str,
    bounds: &Aabb,
    preset: Preset,
    at: &Vector3<f64>,
    state: &mut State<'_>,
) {
    let at = at * options::position_scale(preset);
    state.fields(|| position_elements(name, bounds, preset), at.iter().copied());
}

/// The goal of bringing `what` somewhere.
pub fn goal_spec(what: &str, preset: Preset) -> GoalSpec {
    let tolerance = TOLERANCE * options::position_scale(preset);
    GoalSpec {
        elements: position_elements(what, &THEATRE, preset),
        success: SuccessRule::Distance { tolerance: tolerance as f32 },
    }
}

/// Writes a goal, or what is achieved of it.
pub fn write_goal(position: &Vector3<f64>, preset: Preset, values: &mut [f32]) {
    let scaled = position * options::position_scale(preset);
    for (value, number) in values.iter_mut().zip(scaled.iter()) {
        *value = *number as f32;
    }
}

/// A goal anywhere in the workspace from the height `low` on, m.
pub fn goal_anywhere(low: f64, rng: &mut Rng) -> Vector3<f64> {
    let mut along = |axis: usize, low: f64| rng.uniform(low, WORKSPACE.max[axis]);
    let (x, y) = (along(0, WORKSPACE.min.x), along(1, WORKSPACE.min.y));
    Vector3::new(x, y, along(2, low))
}

/// A goal at `height` (m): normal about the workspace's middle with `sigma` (m) along x and y, within
/// the workspace.
pub fn goal_near_the_middle(sigma: f64, height: f64, rng: &mut Rng) -> Vector3<f64> {
    let centre = WORKSPACE.centre();
    let mut along = |axis: usize| {
        let number: f64 = centre[axis] + sigma * rng.normal();
        number.clamp(WORKSPACE.min[axis], WORKSPACE.max[axis])
    };
    Vector3::new(along(0), along(1), height)
}
