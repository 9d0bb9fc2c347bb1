//! The scripted expert of tasks in which one arm picks up an object and brings it to a goal.
//!
//! It looks only at the present state, so it picks up again what it has lost: open the jaws above
//! the object, go down, close, lift as high as the goal is, go there and stay. Where they may press on what lies
//! below, how deep a grasp is, is not commanded: the jaws go down until they are as low as they may be, or something
//! holds them up, and press on while they close.

use nalgebra::{UnitQuaternion, Vector3};
use trocar_proto::Stage;

use super::expert::{ArmView, ExpertInput};
use super::psm_scene::{PsmArm, down};
use super::start::Start;
use crate::sim::frames::Pose;
use crate::sim::instrument::{JAW_CLOSED, JAW_OPEN};
use crate::sim::world::{BodyId, World};

/// How far above the grasp the jaws open, m. Source: the original.
const HOVER: f64 = 0.005;

/// How far beside the grasp the wrist may be when it goes down, m, and when the jaws close.
const ALIGNED: f64 = 1.5e-3;
const ABOUT: f64 = 2e-3;

/// How far the jaws may be turned from where they are to close, rad.
const TURNED: f64 = 0.1;

/// How low the wrist must be for the jaws to close, m above the grasp, and where it was held up.
const LOW: f64 = 0.3e-3;
const LOW_ENOUGH: f64 = 1.5e-3;

/// How far the wrist may be from the grasp while the jaws close, m.
const CLOSING: f64 = 3e-3;

/// How far below its goal an object is lifted straight up, m.
const LEVEL: f64 = 0.005;

/// Jaws open at least this far are about the object, and how exactly, rad and m.
const OPEN: f64 = 0.9 * JAW_OPEN;
const EXACTLY: f64 = 0.6e-3;

/// What is to be picked up and where it is to go.
#[derive(Debug, Clone, Copy)]
pub struct Pick {
    /// The object.
    pub object: BodyId,
    /// The wrist that grasps it.
    pub grasp: Pose,
    /// How far below it the wrist is sent, m: what is below stops it.
    pub press: f64,
    /// What of the object is to come to the goal, m.
    pub carried: Vector3<f64>,
    /// Where that is to go, m.
    pub goal: Vector3<f64>,
}

impl Pick {
    /// Writes what an arm is to do now.
    pub fn act(
        &self,
        arm: &ArmView<'_>,
        world: &World,
        input: &ExpertInput<'_>,
        action: &mut [f32],
    ) {
        let (_, target, jaw) = self.plan(arm, world, input);
        arm.act(&target, jaw, action);
    }

    /// What is done now.
    pub fn stage(&self, arm: &ArmView<'_>, world: &World, input: &ExpertInput<'_>) -> Stage {
        self.plan(arm, world, input).0
    }

    /// How far the work is done.
    pub fn progress(&self, arm: &PsmArm, world: &World) -> Start {
        if arm.holds(world, self.object) {
            if self.is_high() { Start::Lift } else { Start::Pick }
        } else {
            let off = arm.seen_wrist().translation.vector - self.grasp.translation.vector;
            let about = off.norm() < EXACTLY && arm.opening(world) > OPEN;
            if about { Start::Approach } else { Start::Reset }
        }
    }

    /// What is done now: where the wrist goes for it, and the angle of the jaws, rad.
    fn plan(
        &self,
        arm: &ArmView<'_>,
        world: &World,
        input: &ExpertInput<'_>,
    ) -> (Stage, Pose, f64) {
        if arm.has(world, self.object, input) {
            let mut way = self.goal - self.carried;
            if !self.is_high() {
                (way.x, way.y) = (0.0, 0.0);
            }
            let stage = if self.is_high() { Stage::Carry } else { Stage::Lift };
            return (stage, Pose::from(way) * arm.wrist, JAW_CLOSED);
        }
        let deep = Pose::from(Vector3::z() * -self.press) * self.grasp;
        let off = arm.aim.translation.vector - self.grasp.translation.vector;
        let turned = (arm.aim.rotation * self.grasp.rotation.inverse()).scaled_axis().z.abs();
        let (aside, is_turned) = (off.xy().norm(), turned < TURNED || !arm.arm().turns());
        let is_low = off.z < LOW || off.z < LOW_ENOUGH && (arm.is_held_up() || arm.is_lowest());
        let is_closing = arm.closes() && off.norm() < CLOSING + self.press && !arm.is_closed();
        let is_about = aside < ABOUT && is_turned && is_low && arm.is_open() && !arm.closes();
        let hover = Pose::from(Vector3::z() * HOVER) * self.grasp;
        let is_aligned = aside < ALIGNED || aside < ABOUT && arm.shortfall(&hover) > 0.0;
        if is_closing || is_about {
            (Stage::Pick, deep, JAW_CLOSED)
        } else if is_aligned && is_turned && arm.is_open() && !arm.closes() {
            (Stage::Approach, deep, JAW_OPEN)
        } else {
            (Stage::Approach, hover, JAW_OPEN)
        }
    }

    /// Whether the object need not be lifted any more.
    fn is_high(&self) -> bool {
        self.goal.z - self.carried.z <= LEVEL
    }
}

/// Jaws straight down that close across the horizontal direction `along`, turned as little as
/// possible from `wrist`.
pub fn jaws_across(along: &Vector3<f64>, wrist: &Pose) -> UnitQuaternion<f64> {
    let angle = |vector: &Vector3<f64>| libm::atan2(vector.y, vector.x);
    let hinge = down() * Vector3::x();
    let now = angle(&(wrist.rotation * Vector3::x())) - angle(&hinge);
    let wanted = angle(along) - angle(&hinge);
    // Either finger may be on either side: half a turn makes no difference.
    let half = std::f64::consts::PI;
    let turn = wanted + half * ((now - wanted) / half).round();
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn) * down()
}
