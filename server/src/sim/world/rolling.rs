//! What is gripped does not roll.
//!
//! Two fingers that press on a wire from both sides keep it from turning about itself by friction: each would
//! have to slip. The engine's solver hardly sees that: its rows of friction, one contact after the other, stop
//! the wire where it touches, and half a millimetre of lever is little beside the 7 mm to a needle's centre of
//! mass. What is left swings like a flag, at some 40 Hz, and creeps under load. So the friction of both sides is
//! solved together here, at the start of a substep, with no more than the fingers can bear.

use rapier3d::math::{Matrix, Vector};
use rapier3d::prelude::RigidBodyHandle;

use super::{BodyId, SUBSTEPS_PER_SECOND, World, gravity};
use crate::sim::frames::SCALE;

/// Length below which contacts count as one point, m.
const POINT: f64 = 0.1e-3;

/// How much of the friction is used here. The engine's rows still have all of it: with both, a wire turns by 9°
/// at 0.9 of the couple that friction at both sides bears, and rolls away at 1.25 of it.
const SHARE: f32 = 0.5;

/// A place where a finger pressed on an object in the last substep, engine units.
pub(super) struct Touch {
    /// The first or the second finger.
    finger: usize,
    point: Vector,
    /// The impulse along the normal.
    impulse: f32,
    /// The most that friction could add.
    friction: f32,
}

impl World {
    /// Makes what both `fingers` pressed on in the last substep roll no faster between them than they turn
    /// themselves, as far as friction goes.
    pub fn resist_rolling(&mut self, fingers: [BodyId; 2]) {
        let rate = fingers.map(|finger| self.bodies[finger.0].angvel());
        let mut touches = std::mem::take(&mut self.workspace.touches);
        for index in 0..self.free.len() {
            let object = self.free[index];
            touches.clear();
            let is_gripped = fingers.iter().enumerate().all(|(number, finger)| {
                let others = touches.len();
                self.touches(object, number, finger.0, &mut touches);
                touches.len() > others
            });
            if is_gripped {
                self.stop_rolling(object, &touches, 0.5 * (rate[0] + rate[1]));
            }
        }
        self.workspace.touches = touches;
    }

    /// Ends what was said of grips for the substep that has passed.
    pub(super) fn end_grips(&mut self) {
        for body in &self.free {
            if self.bodies[*body].user_torque() != Vector::ZERO {
                self.bodies[*body].reset_torques(false);
            }
        }
    }

    /// Where `finger`, the one of this number, pressed on `object`.
    fn touches(
        &self,
        object: RigidBodyHandle,
        number: usize,
        finger: RigidBodyHandle,
        touches: &mut Vec<Touch>,
    ) {
        let pressing = self.impulses.iter().filter(|touch| {
            touch.impulse > 0.0 && touch.bodies.contains(&finger) && touch.bodies.contains(&object)
        });
        touches.extend(pressing.map(|touch| Touch {
            finger: number,
            point: touch.point,
            impulse: touch.impulse,
            friction: touch.friction * touch.impulse,
        }));
    }

    /// Stops an object that turns otherwise than with `rate` about the line along which it is touched, or
    /// about any direction across the grip if that is but a point. For the substep to come, bears what
    /// turns it so: its weight and what pulls at it. Turns about the other directions are what the engine's
    /// rows are good at.
    fn stop_rolling(&mut self, object: RigidBodyHandle, touches: &[Touch], rate: Vector) {
        let mut sides = [(Vector::ZERO, 0.0, 0.0); 2];
        for touch in touches {
            let (moment, impulse, friction) = &mut sides[touch.finger];
            *moment += touch.point * touch.impulse;
            *impulse += touch.impulse;
            *friction += touch.friction;
        }
        let [one, other] = sides.map(|(moment, impulse, _)| moment / impulse);
        let (middle, span) = (0.5 * (one + other), (other - one).length());
        let point = (POINT * SCALE) as f32;
        if span < point {
            return;
        }
        let axis = (other - one) / span;
        let across = |vector: Vector| vector - axis * vector.dot(axis);
        let line = touches.iter().map(|touch| across(touch.point - middle)).fold(
            Vector::ZERO,
            |most, each| if each.length() > most.length() { each } else { most },
        );
        let body = &mut self.bodies[object];
        let rolling = |vector: Vector| {
            if line.length() < point {
                across(vector)
            } else {
                vector.dot(line) / line.length_squared() * line
            }
        };
        // The grip stays where it is, and the centre of mass turns about it.
        let arm = body.center_of_mass() - middle;
        let turn = rolling(rate - body.angvel());
        let gain = turn.cross(arm);
        let rotation = Matrix::from_quat(*body.rotation());
        let properties = &body.mass_properties().local_mprops;
        let inertia = rotation * properties.reconstruct_inertia_matrix() * rotation.transpose();
        let weight = body.mass() * gravity();
        let load = rolling(arm.cross(weight + body.user_force()));
        let borne = load / SUBSTEPS_PER_SECOND as f32;
        let moment = (inertia * turn + body.mass() * arm.cross(gain) - borne).length();
        let [(_, _, friction), (_, _, others)] = sides;
        let most = (SHARE * span) * friction.min(others);
        let share = if moment > most { most / moment } else { 1.0 };
        body.set_linvel(body.linvel() + gain * share, false);
        body.set_angvel(body.angvel() + turn * share, false);
        body.add_torque(-load * share, false);
    }
}
