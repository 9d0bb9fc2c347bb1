//! What tasks share that pick up one object: what is observed of it, where a goal may be.

use nalgebra::Vector3;
use trocar_proto::goal::SuccessRule;
use trocar_proto::spec::{Element, GoalSpec, OptionSpec};

use super::options::{self, Preset};
use super::psm_scene::{PsmArm, REACH, WORKSPACE};
use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::random::Rng;

/// Number of values that [`observe`] writes.
pub const OBSERVED: usize = 12;

/// Where objects are reported, m: the space over the table. One that falls from it is reported at
/// its edge.
pub const THEATRE: Aabb = Aabb::new([0.292, -0.268, 0.60], [0.708, 0.268, 0.90]);

/// Distance below which the goal is reached, m. Source: the paper.
pub const TOLERANCE: f64 = 0.005;

/// The options of tasks in which PSMs, so many of them, grasp an object: those that all have, and `own`.
pub fn options(arms: usize, own: impl IntoIterator<Item = OptionSpec>) -> Vec<OptionSpec> {
    let [grasp, grasp_distance] = options::grasp();
    let mut specs = vec![
        options::reward(),
        grasp,
        grasp_distance,
        options::action(),
        options::observation(),
        options::preset(),
    ];
    specs.extend(own);
    specs.extend([options::grasp_domain(), options::setup(&PsmArm::setup_rows(arms))]);
    specs
}

/// The elements of [`observe`] for the object `object` and its place to grasp `place`.
pub fn observation_elements(object: &str, place: &str, preset: Preset) -> Vec<Element> {
    let relative = Aabb { min: THEATRE.min - REACH.max, max: THEATRE.max - REACH.min };
    let mut elements = options::position_elements(object, "scene", &THEATRE, preset);
    let name = format!("{object} from wrist");
    elements.extend(options::position_elements(&name, "scene", &relative.grown(1e-3), preset));
    elements.extend(options::position_elements(place, "scene", &THEATRE, preset));
    elements.extend(options::euler_elements(place, "scene"));
    elements
}

/// Writes what is observed of an object: its origin (3), that less the wrist's (3), the place to
/// grasp (3) and its extrinsic XYZ Euler angles (3).
pub fn observe(object: &Pose, place: &Pose, wrist: &Pose, preset: Preset, values: &mut [f32]) {
    let scale = options::position_scale(preset);
    let origin = object.translation.vector * scale;
    let relative = origin - wrist.translation.vector * scale;
    let at = place.translation.vector * scale;
    let angles = frames::euler_xyz(&place.rotation);
    let numbers = origin.iter().chain(&relative).chain(&at).chain(&angles);
    for (value, number) in values.iter_mut().zip(numbers) {
        *value = *number as f32;
    }
}

/// The goal of bringing `what` somewhere.
pub fn goal_spec(what: &str, preset: Preset) -> GoalSpec {
    let tolerance = TOLERANCE * options::position_scale(preset);
    GoalSpec {
        elements: options::position_elements(what, "scene", &THEATRE, preset),
        success: SuccessRule::Distance { tolerance: tolerance as f32 },
    }
}

/// Writes a goal, or what is achieved of it.
pub fn write_goal(position: &Vector3<f64>, preset: Preset, values: &mut [f32]) {
    let inside = THEATRE.clamp(position) * options::position_scale(preset);
    for (value, number) in values.iter_mut().zip(inside.iter()) {
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
