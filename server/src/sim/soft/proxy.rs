//! Rigid bodies as soft ones meet them, in the substeps of the soft ones.
//!
//! | body | how it moves in a substep | what pushes change |
//! |---|---|---|
//! | fixed, or asleep | not | nothing |
//! | driven | evenly from where it is to where it will be | nothing |
//! | finger on a hinge | with its carrier, and turns by its motor | the rate of turning |
//! | free object | by its velocity, and falls | both velocities |
//!
//! All have a twist (velocity and rate of turning) and an inverse inertia, so contacts need not know which is which.
//! Lengths are relative to the origin of the soft body's lattice.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use rapier3d::prelude::RigidBodyHandle;

use super::lanes::length;
use super::shape::{Gap, Shape};
use crate::sim::world::JawMotor;

/// A rigid body.
#[derive(Debug, Clone)]
pub(in crate::sim) struct Proxy {
    pub handle: RigidBodyHandle,
    /// Whether soft bodies meet it as profiled jaws.
    pub is_profiled: bool,
    /// Whether it stands still in this step, whatever happens.
    pub is_static: bool,
    /// Centre of mass of what is free; of others the body's origin.
    pub centre: Vector3<f32>,
    pub rotation: UnitQuaternion<f32>,
    pub velocity: Vector3<f32>,
    pub rate: Vector3<f32>,
    /// 1/kg.
    pub inverse_mass: f32,
    /// 1/(kg·m²), axes of the world.
    pub inverse_inertia: Matrix3<f32>,
    /// Acceleration of what falls, m/s².
    pub gravity: Vector3<f32>,
    pub hinge: Option<HingeProxy>,
    /// Its forms, relative to the centre.
    pub parts: Vec<PartProxy>,
    /// How far they reach from the centre, at most, m.
    pub radius: f32,
    /// How far they have moved in the last substep, at most, m.
    pub moved: f32,
    pub load: Load,
}

/// The degree of freedom of a finger.
#[derive(Debug, Clone)]
pub(in crate::sim) struct HingeProxy {
    /// In the body's frame.
    pub axis: Vector3<f32>,
    pub angle: f64,
    /// Rate of turning against the carrier, rad/s.
    pub rate: f64,
    /// About the hinge, kg·m².
    pub inertia: f64,
    pub limits: [f64; 2],
    /// The carrier's rate of turning.
    pub carrier_rate: Vector3<f32>,
    /// The angle to which its motor turns it, rad.
    pub target: f64,
    /// Of the motor, per inertia: stiffness, 1/s², and damping, 1/s.
    pub motor: [f64; 2],
}

/// One form of a body.
#[derive(Debug, Clone)]
pub(in crate::sim) struct PartProxy {
    pub centre_from_part: Vector3<f32>,
    pub rotation: UnitQuaternion<f32>,
    pub shape: Shape,
    /// Where it is in this substep.
    pub at: Frame,
}

/// A place and axes, as the columns of a matrix.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::sim) struct Frame {
    pub origin: Vector3<f32>,
    pub axes: Matrix3<f32>,
}

/// What soft bodies did to a rigid one in a step.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::sim) struct Load {
    /// Sum of all impulses, N·s.
    pub impulse: Vector3<f64>,
    /// About the centre that the body had when each acted, N·m·s.
    pub angular: Vector3<f64>,
    /// Sum of the sizes of the normal impulses, N·s.
    pub pressing: f64,
    /// Where they act: sum of places weighted by them, N·s·m.
    pub moment: Vector3<f64>,
    /// Samples that are attached to it, and the sum of their places, m.
    pub attachments: u32,
    pub attached: Vector3<f64>,
    /// Mean pressure over the skin that pressed, Pa; on what does not move it is 0.
    pub pressure: f64,
    /// The deepest overlap with skin that has not given way.
    pub obstacle: Option<Obstacle>,
}

/// Where a rigid body overlaps with skin that is held, or deeper than skin does that can give way.
#[derive(Debug, Clone, Copy)]
pub(in crate::sim) struct Obstacle {
    /// How deep, m.
    pub depth: f32,
    /// Where, m.
    pub point: Vector3<f32>,
    /// The direction into the skin, axes of the world.
    pub into: Vector3<f32>,
}

impl Load {
    /// Adds an impulse (N·s) that acts on the soft body at `point`, `pressing` along the normal, beside a rigid one with this
    /// `centre` (m).
    #[inline(always)]
    pub(super) fn add(
        &mut self,
        impulse: &Vector3<f32>,
        point: &Vector3<f32>,
        centre: &Vector3<f32>,
        pressing: f32,
    ) {
        let normal = f64::from(pressing);
        self.impulse -= impulse.cast::<f64>();
        self.angular -= (point - centre).cross(impulse).cast::<f64>();
        self.pressing += normal;
        self.moment += point.cast::<f64>() * normal;
    }

    /// Takes note of an overlap with skin that has not given way.
    pub(super) fn meet(&mut self, obstacle: Obstacle) {
        if self.obstacle.is_none_or(|deepest| deepest.depth < obstacle.depth) {
            self.obstacle = Some(obstacle);
        }
    }
}

impl PartProxy {
    /// How far it reaches from the body's centre, at most, m.
    pub(in crate::sim) fn radius(&self) -> f32 {
        let [centre, half] = self.shape.bounds();
        (self.centre_from_part + self.rotation * centre).norm() + half.norm()
    }

    /// The gap between a point and its surface, where that is less than `reach` (m); the normal has axes of the world.
    #[inline(always)]
    pub(super) fn gap(&self, point: &Vector3<f32>, reach: f32) -> Option<Gap> {
        let local = self.at.axes.tr_mul(&(point - self.at.origin));
        let gap = self.shape.gap(&local, reach)?;
        Some(Gap { normal: self.at.axes * gap.normal, ..gap })
    }
}

impl Proxy {
    /// Tells it from others, from step to step.
    pub(super) fn key(&self) -> u32 {
        self.handle.into_raw_parts().0
    }

    /// Puts its parts where it is.
    pub(super) fn settle(&mut self) {
        for part in &mut self.parts {
            part.at.origin = self.centre + self.rotation * part.centre_from_part;
            part.at.axes = (self.rotation * part.rotation).to_rotation_matrix().into_inner();
        }
    }

    /// The axis of its hinge now.
    fn axis(&self, hinge: &HingeProxy) -> Vector3<f32> {
        self.rotation * hinge.axis
    }

    /// Gives it the velocities with which a substep begins: what is free falls, motors turn fingers.
    pub(super) fn begin(&mut self, seconds: f32) {
        self.velocity += self.gravity * seconds;
        if let Some(mut hinge) = self.hinge.take() {
            let (axis, dt) = (self.axis(&hinge), f64::from(seconds));
            let [stiffness, damping] = hinge.motor;
            // Implicit, so that it is stable however stiff: to what pushes, too, the finger is as much heavier.
            let heavier = 1.0 + dt * damping + dt * dt * stiffness;
            let turned = dt * stiffness * (hinge.target - hinge.angle);
            hinge.rate = (hinge.rate + turned) / heavier;
            self.rate = hinge.carrier_rate + axis * hinge.rate as f32;
            self.inverse_inertia = axis * axis.transpose() / (hinge.inertia * heavier) as f32;
            self.hinge = Some(hinge);
        }
    }

    /// Velocity of a point at `arm` from the centre, m/s.
    #[inline(always)]
    pub(super) fn velocity_at(&self, arm: &Vector3<f32>) -> Vector3<f32> {
        self.velocity + self.rate.cross(arm)
    }

    /// How far any point of it moves in `seconds` by its velocities, at most, m.
    pub(super) fn reach(&self, seconds: f32) -> f32 {
        (length(&self.velocity) + length(&self.rate) * self.radius) * seconds
    }

    /// Moves it by its velocities.
    pub(super) fn finish(&mut self, seconds: f32) {
        if let Some(mut hinge) = self.hinge.take() {
            let [least, most] = hinge.limits;
            hinge.rate = f64::from((self.rate - hinge.carrier_rate).dot(&self.axis(&hinge)));
            let angle = hinge.angle + f64::from(seconds) * hinge.rate;
            if angle < least || angle > most {
                hinge.rate = 0.0;
            }
            hinge.angle = angle.clamp(least, most);
            self.hinge = Some(hinge);
        }
        if self.is_static {
            return;
        }
        self.moved = self.reach(seconds);
        self.centre += self.velocity * seconds;
        // q' = q + ½ ω q Δt, with no function that a C library would decide.
        let turn = nalgebra::Quaternion::from_imag(self.rate * (0.5 * seconds));
        let turned = self.rotation.into_inner() + turn * self.rotation.into_inner();
        self.rotation = UnitQuaternion::from_quaternion(turned);
        self.settle();
    }
}

/// What turns a pair of fingers, by their numbers among the proxies.
pub(in crate::sim) struct Motor {
    pub fingers: [usize; 2],
    pub motor: JawMotor,
}

impl Motor {
    /// Sets the angles to which both fingers turn.
    pub(super) fn begin(&self, proxies: &mut [Proxy]) {
        let angle = |finger: usize| proxies[finger].hinge.as_ref().map_or(0.0, |hinge| hinge.angle);
        let targets = self.motor.targets(self.fingers.map(angle));
        for (finger, target) in self.fingers.into_iter().zip(targets) {
            if let Some(hinge) = &mut proxies[finger].hinge {
                hinge.target = target;
            }
        }
    }
}
