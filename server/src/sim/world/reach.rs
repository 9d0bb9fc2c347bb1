//! Contacts that cannot come about within a substep are not solved.
//!
//! The engine looks for contacts some way ahead of what moves ([`PREDICTION`](super::PREDICTION)), and its
//! solver works as hard on those that never close as on those that bear. Between jaws that is every other
//! one: what is gripped hardly moves against the fingers.

use rapier3d::geometry::NEW_CONTACT_BIT;
use rapier3d::prelude::{ContactModificationContext, PhysicsHooks};

use super::SUBSTEPS_PER_SECOND;
use crate::sim::frames::SCALE;

/// How much closer a finger and what it meets come within a substep than their speeds at its start say, m: its
/// motor turns the tip by 0.14 mm for each newton of squeeze, and weight adds 0.17 mm.
const GAIN: f64 = 0.3e-3;

/// Leaves the solver what can be reached, of all contacts of parts whose active hooks ask for it.
pub(super) struct WithinReach;

impl PhysicsHooks for WithinReach {
    fn modify_solver_contacts(&self, context: &mut ContactModificationContext) {
        let bodies =
            [context.rigid_body1, context.rigid_body2].map(|body| context.bodies.get(body?));
        let Some(manifold) = context.rigid_mut() else { return };
        let normal = *manifold.normal;
        manifold.solver_contacts.retain(|contact| {
            // What pressed in the substep before is solved once more: else it would count as pressing still.
            let pressed = contact.contact_id[0] & NEW_CONTACT_BIT == 0;
            let [one, other] = [(bodies[0], contact.anchor1), (bodies[1], contact.anchor2)].map(
                |(body, point)| body.map_or(0.0, |body| body.velocity_at_point(point).dot(normal)),
            );
            let closer = f64::from(one - other) / SUBSTEPS_PER_SECOND;
            pressed || f64::from(contact.dist) < closer + GAIN * SCALE
        });
    }
}
