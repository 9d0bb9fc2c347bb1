//! Bodies that hang on driven ones by a hinge with a motor: the fingers of jaws.
//!
//! The carrier bears all but the turn about the hinge, whatever pushes. So a hinged body has its centre of
//! mass on the hinge, and its inertia is the real one only where it turns; for all else it is so heavy that
//! nothing moves it. What it does to an object is then governed by its motor, the only row that the solver has
//! for a hinge. The rest is kept by velocities: at the start of a substep the body gets those that bring it
//! to where its carrier will be. (With five more rows, NeedleRegrasp's random steps took 1.28 times as long.)

use nalgebra::{Unit, UnitQuaternion, Vector3};
use rapier3d::math::Vector as EngineVector;
use rapier3d::prelude::{
    ActiveHooks, GenericJointBuilder, Group, ImpulseJointHandle, InteractionGroups,
    InteractionTestMode, JointAxesMask, JointAxis, MassProperties, MotorModel, RigidBodyBuilder,
};

use super::{BodyId, Part, SUBSTEPS_PER_SECOND, World, collider};
use crate::sim::frames::{self, Pose, SCALE};

/// How much heavier than it is a hinged body is for what its carrier bears. The engine takes what has no finite
/// mass for what nothing turns either.
const BORNE: f64 = 1e6;

/// Stiffness of the motor per inertia, 1/s²: its frequency is about half the rate of the solver's
/// iterations over 2π.
const STIFFNESS: f64 = 1e6;

/// Distance from a limit below which the solver has a row for it, rad. Nothing turns a finger by as much within
/// a substep.
const NEAR_LIMIT: f64 = 0.15;

/// Contacts of hinged bodies are looked through by [`points`](super::points), and so computed afresh in every
/// substep. The engine keeps those of bodies that hardly move against each other as they were *in the world*
/// until both have turned by 11°; a jaw that turns with what it holds would press and drag along stale
/// normals, and what is held creeps out of it.
const LOOKED_THROUGH: ActiveHooks = ActiveHooks::MODIFY_SOLVER_CONTACTS;

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
    joint: ImpulseJointHandle,
    axis: Unit<Vector3<f64>>,
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
        // The axis is one of the body's, so its inertia is diagonal.
        let factors = Vector3::repeat(BORNE) - hinge.axis.abs() * (BORNE - 1.0);
        let mass = MassProperties::new(
            EngineVector::ZERO,
            (hinge.mass * BORNE * f64::powi(SCALE, 3)) as f32,
            unscaled(&(factors * (hinge.inertia * f64::powi(SCALE, 5)))),
        );
        let body = RigidBodyBuilder::dynamic()
            .pose(*self.bodies[carrier.0].position())
            .additional_mass_properties(mass)
            .gravity_scale(0.0)
            .gyroscopic_forces_enabled(false) // none about the hinge, where both other moments are alike
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
                .collision_groups(groups)
                .active_hooks(LOOKED_THROUGH);
            self.colliders.insert_with_parent(collider, body, &mut self.bodies);
        }
        let axis = unscaled(&hinge.axis);
        let joint = GenericJointBuilder::new(JointAxesMask::empty())
            .local_axis1(axis)
            .local_axis2(axis)
            .contacts_enabled(false)
            .limits(JointAxis::AngX, hinge.limits.map(|limit| limit as f32))
            .motor_model(JointAxis::AngX, MotorModel::AccelerationBased)
            .motor_position(JointAxis::AngX, 0.0, STIFFNESS as f32, DAMPING as f32);
        let joint = self.impulse_joints.insert(carrier.0, body, joint, true);
        HingedId { body: BodyId(body), joint, axis: hinge.axis }
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
        let joint =
            &mut self.impulse_joints.get_mut(hinged.joint, false).expect("joints stay").data;
        joint.set_motor_position(JointAxis::AngX, target as f32, STIFFNESS as f32, DAMPING as f32);
        let limits = joint.limits[JointAxis::AngX as usize];
        let [least, most] = [limits.min, limits.max].map(f64::from);
        let is_near = angle < least + NEAR_LIMIT || angle > most - NEAR_LIMIT;
        joint.limit_axes.set(JointAxesMask::ANG_X, is_near);
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

    fn carrier(&self, hinged: &HingedId) -> BodyId {
        BodyId(self.impulse_joints.get(hinged.joint).expect("joints stay").body1())
    }

    /// The pairs of bodies that a joint ties together, springs aside.
    pub fn joints(&self) -> impl Iterator<Item = [BodyId; 2]> {
        let pairs = self.impulse_joints.iter();
        let pairs = pairs.map(|(_, joint)| [BodyId(joint.body1()), BodyId(joint.body2())]);
        pairs.filter(|[_, body]| !self.sprung.contains(&body.0))
    }
}

/// What has no lengths in it that the engine would scale: a direction, a rate of turning.
fn unscaled(rate: &Vector3<f64>) -> EngineVector {
    EngineVector::new(rate.x as f32, rate.y as f32, rate.z as f32)
}

/// Damping of the motor per inertia, 1/s: critical.
const DAMPING: f64 = 2.0 * 1e3;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_motor_is_critically_damped() {
        assert!((DAMPING * DAMPING / 4.0 - STIFFNESS).abs() < 1e-6);
    }
}
