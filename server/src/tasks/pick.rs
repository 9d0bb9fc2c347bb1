//! The scripted expert of tasks in which one arm picks up an object and brings it to a goal.
//!
//! It looks only at the present state, so it picks up again what it has lost: open the jaws above
//! the object, go down, close, lift as high as the goal is, go there and stay.

use nalgebra::{UnitQuaternion, Vector3};
use trocar_proto::Stage;

use super::psm_scene::{PsmArm, STEP_ANGLE, STEP_LENGTH, down};
use super::start::Start;
use crate::sim::frames::Pose;
use crate::sim::instrument::{JAW_CLOSED, JAW_OPEN};
use crate::sim::world::{BodyId, World};

/// How far above the grasp the jaws open, m. Source: the original.
const HOVER: f64 = 0.005;

/// How exactly the wrist is above the grasp before it goes down, m and rad.
const ALIGNED: f64 = 0.3e-3;
const TURNED: f64 = 0.02;

/// How low the wrist must be for the jaws to close, m above the grasp.
const LOW: f64 = 0.3e-3;

/// Jaws open at least this far go down, rad.
const OPEN: f64 = 0.9 * JAW_OPEN;

/// Jaws that closed to less than this hold nothing, rad.
const EMPTY: f64 = 0.02;

/// How far below its goal an object is lifted straight up, m.
const LEVEL: f64 = 0.005;

/// What is to be picked up and where it is to go.
#[derive(Debug, Clone, Copy)]
pub struct Pick {
    /// The object.
    pub object: BodyId,
    /// The wrist that grasps it.
    pub grasp: Pose,
    /// What of the object is to come to the goal, m.
    pub carried: Vector3<f64>,
    /// Where that is to go, m.
    pub goal: Vector3<f64>,
}

impl Pick {
    /// Writes what `arm` is to do now.
    pub fn act(&self, arm: &PsmArm, world: &World, action: &mut [f32]) {
        let (target, jaw) = self.waypoint(arm, world);
        arm.encode(&step_towards(arm, &target), jaw, action);
    }

    /// What is done now.
    pub fn stage(&self, arm: &PsmArm, world: &World) -> Stage {
        if arm.holds(world, self.object) {
            return if self.is_high() { Stage::Carry } else { Stage::Lift };
        }
        if self.is_about(arm) { Stage::Pick } else { Stage::Approach }
    }

    /// How far the work is done.
    pub fn progress(&self, arm: &PsmArm, world: &World) -> Start {
        if arm.holds(world, self.object) {
            if self.is_high() { Start::Lift } else { Start::Pick }
        } else {
            let off = arm.scene_from_wrist().translation.vector - self.grasp.translation.vector;
            let about = off.norm() < ALIGNED + LOW && arm.opening(world) > OPEN;
            if about { Start::Approach } else { Start::Reset }
        }
    }

    fn waypoint(&self, arm: &PsmArm, world: &World) -> (Pose, f64) {
        let wrist = arm.scene_from_wrist();
        let opening = arm.opening(world);
        if arm.holds(world, self.object) {
            let mut way = self.goal - self.carried;
            if way.z > LEVEL {
                (way.x, way.y) = (0.0, 0.0);
            }
            return (Pose::from(way) * wrist, JAW_CLOSED);
        }
        if self.is_about(arm) {
            (self.grasp, if opening < EMPTY { JAW_OPEN } else { JAW_CLOSED })
        } else if self.is_aligned(wrist) && opening > OPEN {
            (self.grasp, JAW_OPEN)
        } else {
            (Pose::from(Vector3::z() * HOVER) * self.grasp, JAW_OPEN)
        }
    }

    /// Whether the object need not be lifted any more.
    fn is_high(&self) -> bool {
        self.goal.z - self.carried.z <= LEVEL
    }

    /// Whether a wrist is straight above the grasp, turned as it must be.
    fn is_aligned(&self, wrist: &Pose) -> bool {
        let off = wrist.translation.vector - self.grasp.translation.vector;
        off.xy().norm() < ALIGNED && wrist.rotation.angle_to(&self.grasp.rotation) < TURNED
    }

    /// Whether the jaws are where they close.
    fn is_about(&self, arm: &PsmArm) -> bool {
        let wrist = arm.scene_from_wrist();
        let height = wrist.translation.z - self.grasp.translation.z;
        self.is_aligned(wrist) && height < LOW
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

/// As far from where `arm` was commanded to `target` as one step goes, along a straight line.
pub(super) fn step_towards(arm: &PsmArm, target: &Pose) -> Pose {
    let (now, scale) = (arm.commanded(), arm.rate().scale());
    let step = target.translation.vector - now.translation.vector;
    let step = step / (step.amax() / (STEP_LENGTH * scale)).max(1.0);
    let turn = (target.rotation * now.rotation.inverse()).scaled_axis();
    let turn = turn / (turn.norm() / (STEP_ANGLE * scale)).max(1.0);
    let rotation = UnitQuaternion::from_scaled_axis(turn) * now.rotation;
    Pose::from_parts((now.translation.vector + step).into(), rotation)
}
