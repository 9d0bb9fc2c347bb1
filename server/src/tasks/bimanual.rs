//! What tasks share in which one arm hands an object to the other: what is observed of both, and the
//! expert's way of handing over.

use nalgebra::{Point3, Vector3};
use trocar_proto::spec::Element;

use super::objects::THEATRE;
use super::options::{self, Preset};
use super::pick::step_towards;
use super::psm_scene::PsmArm;
use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::instrument::{JAW_CLOSED, JAW_OPEN};
use crate::sim::world::{BodyId, World};

/// The elements of [`observe`]: of both arms, of the object `object`, and of the places `places` at which
/// PSM1 and PSM2 grasp it.
pub fn observation_elements(
    arms: [&PsmArm; 2],
    object: &str,
    places: [&str; 2],
    preset: Preset,
) -> Vec<Element> {
    let mut elements = named(arms.map(PsmArm::observation_elements));
    elements.extend(options::position_elements(object, "scene", &THEATRE, preset));
    for (index, arm) in arms.iter().enumerate() {
        let reach = arm.reach();
        let relative = Aabb { min: THEATRE.min - reach.max, max: THEATRE.max - reach.min };
        let name = format!("{object} from PSM{} wrist", index + 1);
        elements.extend(options::position_elements(&name, "scene", &relative.grown(1e-3), preset));
    }
    for place in places {
        elements.extend(options::position_elements(place, "scene", &THEATRE, preset));
        elements.extend(options::euler_elements(place, "scene"));
    }
    elements
}

/// The elements of an action: those of PSM1, then those of PSM2.
pub fn action_elements(arms: [&PsmArm; 2]) -> Vec<Element> {
    named(arms.map(PsmArm::action_elements))
}

fn named(elements: [Vec<Element>; 2]) -> Vec<Element> {
    let named = |(index, elements): (usize, Vec<Element>)| {
        elements.into_iter().map(move |mut element| {
            element.name = format!("PSM{} {}", index + 1, element.name);
            element
        })
    };
    elements.into_iter().enumerate().flat_map(named).collect()
}

/// Writes what is observed: both arms (7 each), the object's origin (3), that less PSM1's and PSM2's
/// wrist (3 each), and the places at which PSM1 and PSM2 grasp it, each by position (3) and extrinsic
/// XYZ Euler angles (3).
pub fn observe(
    arms: [&PsmArm; 2],
    world: &World,
    object: &Pose,
    places: &[Pose; 2],
    preset: Preset,
    observation: &mut [f32],
) {
    let (first, rest) = observation.split_at_mut(PsmArm::OBSERVED);
    let (second, rest) = rest.split_at_mut(PsmArm::OBSERVED);
    arms[0].observe(world, first);
    arms[1].observe(world, second);
    let scale = options::position_scale(preset);
    let origin = object.translation.vector;
    let relative = arms.map(|arm| origin - arm.scene_from_wrist().translation.vector);
    let places = places.iter().flat_map(|place| {
        let angles = frames::euler_xyz(&place.rotation);
        let at = place.translation.vector * scale;
        at.iter().copied().chain(angles).collect::<Vec<_>>()
    });
    let positions = [origin, relative[0], relative[1]];
    let numbers = positions.iter().flat_map(|position| position.iter().map(|x| x * scale));
    for (value, number) in rest.iter_mut().zip(numbers.chain(places)) {
        *value = number as f32;
    }
}

/// How exactly an arm is where it shall be, m and rad.
const ALIGNED: f64 = 0.3e-3;
const TURNED: f64 = 0.02;

/// How far an object may move jaws that close on it before they open again, m.
const SHIFTED: f64 = 1.5e-3;

/// Jaws open at least this far go to their grasp, rad.
const OPEN: f64 = 0.9 * JAW_OPEN;

/// Jaws that closed to less than this hold nothing, rad.
const EMPTY: f64 = 0.02;

/// Speed below which an object that both arms hold is at rest, m/s.
const AT_REST: f64 = 0.5e-3;

/// Distance of an open jaw's tip from the object at which the arm is clear of it, m.
const CLEAR: f64 = 0.003;

/// How far an arm backs off at once, m.
const BACK: f64 = 0.01;

/// What an arm is to do: where its wrist goes, and its jaw angle, rad.
pub type Waypoint = (Pose, f64);

/// A hand-over as the expert does it. It looks only at the present state.
#[derive(Debug, Clone, Copy)]
pub struct HandOver {
    /// What is handed over.
    pub object: BodyId,
    /// The giving arm's wrist where it offers the object.
    pub offer: Pose,
    /// The taking arm's wrist that grasps the object which is offered; it comes along its jaws.
    pub take: Pose,
    /// How far before its grasp the taking arm opens its jaws, m.
    pub hover: f64,
    /// Whether closed jaws near the object have it as soon as the other arm lets go, whatever they
    /// touch.
    pub by_nearness: bool,
}

/// How far a hand-over is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Stage {
    /// No arm has the object.
    Lost,
    /// It is not over: what giver and taker do now.
    Under([Waypoint; 2]),
    /// The taker alone has the object; what the giver does now. The taker may go when it is clear.
    Over {
        /// What the giver does now.
        giver: Waypoint,
        /// Whether its jaws are clear of the object.
        clear: bool,
    },
}

impl HandOver {
    /// What `giver` and `taker` are to do now.
    pub fn stage(&self, giver: &PsmArm, taker: &PsmArm, world: &World) -> Stage {
        let given = giver.holds(world, self.object);
        let taken = taker.holds(world, self.object)
            || self.by_nearness && given && self.has_closed(taker, world);
        let [giver_wrist, taker_wrist] = [giver, taker].map(|arm| *arm.scene_from_wrist());
        match (given, taken) {
            (false, false) => Stage::Lost,
            (true, false) => {
                let offered = is_at(&giver_wrist, &self.offer);
                let offer = if offered { giver_wrist } else { self.offer };
                Stage::Under([(offer, JAW_CLOSED), self.taking(taker, world, offered)])
            }
            (true, true) => {
                let at_rest = world.velocity(self.object).norm() < AT_REST;
                let giver_jaw = if at_rest { JAW_OPEN } else { JAW_CLOSED };
                Stage::Under([(giver_wrist, giver_jaw), (taker_wrist, JAW_CLOSED)])
            }
            (false, true) => {
                let tip = Point3::from(giver.tip());
                let clear = world.distance(self.object, &tip) > CLEAR;
                let back = if clear { 0.0 } else { -BACK };
                let back = giver_wrist * Pose::translation(0.0, 0.0, back);
                Stage::Over { giver: (back, JAW_OPEN), clear }
            }
        }
    }

    fn taking(&self, taker: &PsmArm, world: &World, offered: bool) -> Waypoint {
        let hover = self.take * Pose::translation(0.0, 0.0, -self.hover);
        let opening = taker.opening(world);
        let off = self.take.inv_mul(taker.scene_from_wrist());
        let turned = off.rotation.angle();
        let aside = off.translation.vector.xy().norm();
        let (aligned, short) = (aside < ALIGNED && turned < TURNED, -off.translation.z);
        let there = aligned && short.abs() < ALIGNED;
        let closing = opening < OPEN && aside.max(short.abs()) < SHIFTED && turned < 2.0 * TURNED;
        if !offered || opening < EMPTY {
            (hover, JAW_OPEN)
        } else if there || closing {
            (*taker.scene_from_wrist(), JAW_CLOSED)
        } else if aligned && opening > OPEN {
            (self.take, JAW_OPEN)
        } else {
            (hover, JAW_OPEN)
        }
    }

    fn has_closed(&self, taker: &PsmArm, world: &World) -> bool {
        is_at(taker.scene_from_wrist(), &self.take) && taker.opening(world) < EMPTY
    }
}

/// Whether a wrist is where it shall be.
fn is_at(wrist: &Pose, target: &Pose) -> bool {
    let off = target.inv_mul(wrist);
    off.translation.vector.norm() < ALIGNED && off.rotation.angle() < TURNED
}

/// Writes the action with which both arms go towards their waypoints.
pub fn act(arms: [&PsmArm; 2], waypoints: &[Waypoint; 2], action: &mut [f32]) {
    let count = action.len() / arms.len();
    let parts = action.chunks_exact_mut(count);
    for ((arm, (target, jaw)), part) in arms.into_iter().zip(waypoints).zip(parts) {
        arm.encode(&step_towards(arm.scene_from_wrist(), target), *jaw, part);
    }
}

/// A wrist moved by `way` (m), jaws closed.
pub fn carried(arm: &PsmArm, way: Vector3<f64>) -> Waypoint {
    (Pose::from(way) * arm.scene_from_wrist(), JAW_CLOSED)
}

/// Where an arm is, with its jaws closed.
pub fn staying(arm: &PsmArm) -> Waypoint {
    carried(arm, Vector3::zeros())
}
