//! Bodies that hang on driven ones by a hinge with a motor: the fingers of jaws.
//!
//! The carrier bears all but the turn about the hinge, whatever pushes. So the solver gives a hinged body that one
//! degree of freedom, with its inertia about the hinge and a motor. The rest is kept by velocities: at the start of a
//! substep the body gets those that bring it to where its carrier will be.
//!
//! Two fingers of an instrument are turned by one [`JawMotor`]. Fingers on a soft body pass the substep beside that
//! body, in its shorter substeps, with the same motor (`soft.rs`).

use nalgebra::{Unit, UnitQuaternion, Vector3};
use rapier3d::math::Vector as EngineVector;
use rapier3d::parry::utils::SdpMatrix3;
use rapier3d::prelude::{
    Group, InteractionGroups, InteractionTestMode, MassProperties, RigidBody, RigidBodyBuilder,
    RigidBodyHandle,
};

use super::constraint::{Constraints, Joint, SolverBody, Spatial};
use super::soft::Passed;
use super::{BodyId, Part, SUBSTEPS_PER_SECOND, World, collider};
use crate::sim::frames::{self, Pose, SCALE};

/// Stiffness of the motor per inertia, 1/s²: its frequency is about half the rate of the solver's
/// iterations over 2π.
pub(super) const STIFFNESS: f64 = 1e6;

/// Distance from a limit below which the solver has a row for it, rad. Nothing turns a finger by as much within
/// a substep.
const NEAR_LIMIT: f64 = 0.15;

/// What a hinged body is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hinge {
    /// The axis, through the origin of both bodies.
    pub axis: Unit<Vector3<f64>>,
    /// Where turning ends, rad.
    pub limits: [f64; 2],
    /// Mass of what hangs on it, kg.
    pub mass: f64,
    /// Moment of inertia about the axis, kg·m².
    pub inertia: f64,
    /// Friction coefficient of its parts.
    pub friction: f64,
}

impl Hinge {
    /// How far the motor's target must be off for it to turn with `torque` (N·m), rad.
    pub fn deflection(&self, torque: f64) -> f64 {
        torque / (self.inertia * STIFFNESS)
    }
}

/// A body on a hinge with a motor; see [`World::insert_hinged`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HingedId {
    body: BodyId,
    axis: Unit<Vector3<f64>>,
}

/// A hinge, in engine units.
#[derive(Debug, Clone)]
pub(super) struct Hung {
    pub carrier: RigidBodyHandle,
    pub body: RigidBodyHandle,
    pub axis: EngineVector,
    pub inertia: f32,
    pub limits: [f32; 2],
    pub is_near_limit: bool,
    pub angle: f32,
    pub target: f32,
    /// What came of the substep, where it passed beside a soft body.
    pub passed: Option<Passed>,
}

/// What turns a pair of fingers, whose angles grow as they open.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JawMotor {
    /// Half the opening that is asked for, rad.
    pub opening: f64,
    /// How far the motors' targets may be from where the fingers are, rad: it bounds the torque.
    pub deflection: f64,
    /// The same for what keeps both about the middle.
    pub most_aside: f64,
    /// Whether the fingers open, whatever is asked for.
    pub opens: bool,
}

impl JawMotor {
    /// The angles to which fingers turn that are at these angles, rad.
    pub fn targets(&self, [left, right]: [f64; 2]) -> [f64; 2] {
        let (opening, aside) = (0.5 * (left + right), 0.5 * (left - right));
        if !opening.is_finite() {
            return [left, right]; // the step fails by name
        }
        // Closed fingers lie on each other: nothing closes them further.
        let least = if opening < 0.0 { 0.0 } else { opening - self.deflection };
        let most = (opening + self.deflection).max(least);
        let opening = if self.opens { most } else { f64::clamp(self.opening, least, most) };
        let most = self.most_aside;
        let aside = if self.opens { aside } else { f64::clamp(0.0, aside - most, aside + most) };
        [opening + aside, opening - aside]
    }
}

impl Hung {
    /// Where the body is when its carrier is there and it is turned by `angle`, rad.
    pub(super) fn pose(&self, world_from_carrier: &Pose, angle: f64) -> Pose {
        world_from_carrier * UnitQuaternion::from_axis_angle(&self.id().axis, angle)
    }

    fn id(&self) -> HingedId {
        let axis = Vector3::new(self.axis.x, self.axis.y, self.axis.z).cast();
        HingedId { body: BodyId(self.body), axis: Unit::new_unchecked(axis) }
    }

    /// What rows can do to the body: they turn it about the hinge.
    pub(super) fn solver_body(&self, body: &RigidBody) -> SolverBody {
        let axis = body.rotation().mul_vec3(self.axis);
        let turn = axis / self.inertia;
        SolverBody {
            velocity: Spatial::new(body.linvel(), body.angvel()),
            acceleration: Spatial::default(),
            inverse_mass: EngineVector::ZERO,
            inverse_inertia: SdpMatrix3 {
                m11: turn.x * axis.x,
                m12: turn.x * axis.y,
                m13: turn.x * axis.z,
                m22: turn.y * axis.y,
                m23: turn.y * axis.z,
                m33: turn.z * axis.z,
            },
            displacement: Spatial::default(),
            is_pushed: true, // its velocity is that of its carrier
        }
    }
}

impl HingedId {
    /// The body.
    pub fn body(&self) -> BodyId {
        self.body
    }
}

impl World {
    /// Hangs a body on the driven body `carrier`. It meets everything but its carrier and what else
    /// hangs on that.
    pub fn insert_hinged(&mut self, carrier: BodyId, hinge: &Hinge, parts: &[Part]) -> HingedId {
        // It turns about the hinge, so that is where its centre of mass is for the engine.
        let mass = MassProperties::new(
            EngineVector::ZERO,
            (hinge.mass * f64::powi(SCALE, 3)) as f32,
            EngineVector::splat((hinge.inertia * f64::powi(SCALE, 5)) as f32),
        );
        let body = RigidBodyBuilder::dynamic()
            .pose(*self.bodies[carrier.0].position())
            .additional_mass_properties(mass)
            .can_sleep(false);
        let body = self.bodies.insert(body);
        let own = self.group_of(carrier);
        let groups =
            InteractionGroups::new(own, Group::ALL.difference(own), InteractionTestMode::And);
        for part in parts {
            let collider = collider(&part.shape)
                .position(frames::to_engine(&part.body_from_part))
                .density(0.0)
                .friction(hinge.friction as f32)
                .collision_groups(groups);
            self.colliders.insert_with_parent(collider, body, &mut self.bodies);
        }
        self.hinges.push(Hung {
            carrier: carrier.0,
            body,
            axis: unscaled(&hinge.axis),
            inertia: (hinge.inertia * f64::powi(SCALE, 5)) as f32,
            limits: hinge.limits.map(|limit| limit as f32),
            is_near_limit: false,
            angle: 0.0,
            target: 0.0,
            passed: None,
        });
        HingedId { body: BodyId(body), axis: hinge.axis }
    }

    /// Adds the rows of a hinge: the motor, and the limits where it is near one.
    pub(super) fn add_hinge(&self, hinge: &Hung, number: usize, constraints: &mut Constraints) {
        let axis = self.bodies[hinge.body].rotation().mul_vec3(hinge.axis);
        let jacobian = Spatial::new(EngineVector::ZERO, axis);
        let rate = self.bodies[hinge.carrier].angvel().dot(axis);
        let (position, target, limits) = (hinge.angle, hinge.target, hinge.limits);
        let (stiffness, damping) = (STIFFNESS as f32, DAMPING as f32);
        let motor = Joint::Motor { position, target, stiffness, damping, per_inertia: true };
        constraints.add_joint(number, jacobian, rate, motor);
        if hinge.is_near_limit {
            constraints.add_joint(number, jacobian, rate, Joint::Limit { position, limits });
        }
    }

    /// The collision group of what hangs on `carrier`: each carrier has its own, from the second on.
    fn group_of(&self, carrier: BodyId) -> Group {
        let mut carriers: Vec<_> = self.joints().map(|[carrier, _]| carrier).collect();
        carriers.dedup();
        let index = carriers.iter().position(|each| *each == carrier).unwrap_or(carriers.len());
        Group::from_bits_retain(Group::GROUP_2.bits() << index)
    }

    /// Sets where a hinged body is, at once. It does not turn about its hinge.
    pub fn place_hinged(&mut self, hinged: &HingedId, world_from_body: &Pose) {
        let rate = self.bodies[self.carrier(hinged).0].angvel();
        let body = &mut self.bodies[hinged.body.0];
        body.set_position(frames::to_engine(world_from_body), false);
        body.set_angvel(rate, false);
    }

    /// Makes a hinged body that is turned by `angle` (rad) go along with its carrier, which will be at
    /// `world_from_carrier` a substep later.
    pub fn carry_hinged(&mut self, hinged: &HingedId, angle: f64, world_from_carrier: &Pose) {
        let now = self.pose(hinged.body);
        let [own, carriers] = [hinged.body, self.carrier(hinged)].map(|body| {
            let rate = self.bodies[body.0].angvel();
            Vector3::new(rate.x, rate.y, rate.z).cast::<f64>()
        });
        let rate = (own - carriers).dot(&(now.rotation * *hinged.axis));
        let then = angle + rate / SUBSTEPS_PER_SECOND;
        let then = UnitQuaternion::from_axis_angle(&hinged.axis, then);
        let turn = world_from_carrier.rotation * then * now.rotation.inverse();
        let way = world_from_carrier.translation.vector - now.translation.vector;
        let body = &mut self.bodies[hinged.body.0];
        body.set_linvel(frames::to_engine_vector(&(way * SUBSTEPS_PER_SECOND)), false);
        body.set_angvel(unscaled(&(turn.scaled_axis() * SUBSTEPS_PER_SECOND)), false);
    }

    /// The angle to which the motor of a hinged body turns it, from the angle where it is, rad.
    pub fn turn_hinged(&mut self, hinged: &HingedId, angle: f64, target: f64) {
        let hinge = self.hinges.iter_mut().find(|hinge| hinge.body == hinged.body.0);
        let hinge = hinge.expect("hinges stay");
        let [least, most] = hinge.limits.map(f64::from);
        hinge.is_near_limit = angle < least + NEAR_LIMIT || angle > most - NEAR_LIMIT;
        (hinge.angle, hinge.target) = (angle as f32, target as f32);
    }

    /// How far a hinged body is turned, rad.
    pub fn hinge_angle(&self, hinged: &HingedId) -> f64 {
        let carrier_from_body =
            self.pose(self.carrier(hinged)).rotation.inverse() * self.pose(hinged.body).rotation;
        let q = carrier_from_body.quaternion();
        let (sine, cosine) = (q.imag().dot(&hinged.axis), q.scalar());
        // The shorter way round: both signs of a quaternion are the same rotation.
        2.0 * if cosine < 0.0 { libm::atan2(-sine, -cosine) } else { libm::atan2(sine, cosine) }
    }

    /// The same of a hinge.
    pub(super) fn hung_angle(&self, hung: &Hung) -> f64 {
        self.hinge_angle(&hung.id())
    }

    fn carrier(&self, hinged: &HingedId) -> BodyId {
        let hinge = self.hinges.iter().find(|hinge| hinge.body == hinged.body.0);
        BodyId(hinge.expect("hinges stay").carrier)
    }

    /// The pairs of bodies that a joint connects, springs aside.
    pub fn joints(&self) -> impl Iterator<Item = [BodyId; 2]> {
        let hinged = self.hinges.iter().map(|hinge| [BodyId(hinge.carrier), BodyId(hinge.body)]);
        hinged.chain(self.attachments.iter().map(|attachment| attachment.id.bodies().map(BodyId)))
    }
}

/// What has no lengths in it that the engine would scale: a direction, a rate of turning.
pub(super) fn unscaled(rate: &Vector3<f64>) -> EngineVector {
    EngineVector::new(rate.x as f32, rate.y as f32, rate.z as f32)
}

/// Damping of the motor per inertia, 1/s: critical.
pub(super) const DAMPING: f64 = 2.0 * 1e3;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_motor_is_critically_damped() {
        assert!((DAMPING * DAMPING / 4.0 - STIFFNESS).abs() < 1e-6);
    }
}
