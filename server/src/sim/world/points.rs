//! Where the solver has contacts, and what they bear.
//!
//! Where a capsule lies on a face, the engine finds each end of their common line twice, and the deeper one a
//! third time. Three of the five are solved, not the same ones in every substep; the others keep what they
//! bore when they were solved last, and pass it on as a start. So contacts of fingers are reduced to
//! one for each place, always the same one, and what is borne is read from those that are solved.
//!
//! A finger is as good as immovable but about its hinge. Where furniture is in its way otherwise, no contact could
//! help, and the impulses with which one would try are enormous; begun with in the next substep, from a
//! little further on, they turned a finger at 2,000 rad/s, and what it touched flew away at 3.6 m/s. Such
//! contacts are left out: that instruments stop at furniture is the business of [`motion`](crate::sim::motion).

use rapier3d::geometry::{
    ContactData, ContactManifold, NEW_CONTACT_BIT, SolverContact, TrackedContact,
};
use rapier3d::math::Vector;
use rapier3d::parry::shape::PackedFeatureId;
use rapier3d::prelude::{
    ContactModificationContext, ModifiableContacts, PhysicsHooks, RigidBody, RigidBodyHandle,
};

use crate::sim::frames::SCALE;

/// Distance below which points are one place, m: far above rounding, far below what is between the ends
/// of a line on a finger.
const PLACE: f64 = 1e-6;

/// Distance up to which the solver has a contact of a finger with what it holds, m: far above what slides or
/// rolls in a grip within a substep.
const NEAR: f64 = 0.3e-3;

/// How much a push must move two bodies for the solver to have a contact between them, 1/kg: a finger's is as much
/// 2.6 mm from its hinge.
const MOVABLE: f64 = 10.0;

type Point = TrackedContact<ContactData>;

/// Leaves the solver one contact of a finger for each place, if it could help, and of what is held only
/// those that are near.
pub(super) struct Needed<'a> {
    /// The objects that nothing but the two fingers that grip them could move, in this substep.
    pub held: &'a [RigidBodyHandle],
}

impl PhysicsHooks for Needed<'_> {
    fn modify_solver_contacts(&self, context: &mut ContactModificationContext) {
        let handles = [context.rigid_body1, context.rigid_body2];
        let bodies = handles.map(|handle| handle.and_then(|handle| context.bodies.get(handle)));
        let is_held = handles.iter().flatten().any(|handle| self.held.contains(handle));
        let reach = if is_held { (NEAR * SCALE) as f32 } else { f32::INFINITY };
        let least = (MOVABLE / (SCALE * SCALE * SCALE)) as f32;
        let ModifiableContacts::Rigid(rigid) = &mut context.contacts else { return };
        let points = &rigid.manifold.points;
        let is_needed = |contact: &SolverContact| {
            let bodies = bodies.iter().flatten();
            let moved: f32 =
                bodies.map(|body| mobility(body, contact.anchor1, *rigid.normal)).sum();
            contact.dist <= reach && moved >= least
        };
        let mut kept = 0;
        for index in 0..rigid.solver_contacts.len() {
            let mut contact = rigid.solver_contacts[index];
            let point = last_at_place_of(points, index_of(&contact));
            let is_kept = rigid.solver_contacts[..kept].iter().any(|one| index_of(one) == point);
            if is_kept || !is_needed(&contact) {
                continue;
            }
            let is_new = points[point].data.impulse == 0.0;
            contact.contact_id = [point as u32 | if is_new { NEW_CONTACT_BIT } else { 0 }];
            rigid.solver_contacts[kept] = contact;
            kept += 1;
        }
        rigid.solver_contacts.truncate(kept);
    }
}

/// By how much a push at a point moves that in the direction of the push, engine's units of 1/kg.
fn mobility(body: &RigidBody, at: Vector, direction: Vector) -> f32 {
    let properties = body.mass_properties();
    let moment = (at - body.center_of_mass()).cross(direction);
    direction.dot(properties.effective_inv_mass * direction)
        + moment.dot(properties.effective_world_inv_inertia * moment)
}

/// The point at the place of another whose data the engine passes on to the next substep's: the last one of
/// those that it can tell apart.
fn last_at_place_of(points: &[Point], found: usize) -> usize {
    let apart = (PLACE * SCALE) as f32;
    let is_at_place = |point: &Point| {
        point.fid1 != PackedFeatureId::UNKNOWN
            && point.local_p1.distance_squared(points[found].local_p1) < apart * apart
    };
    points.iter().rposition(is_at_place).unwrap_or(found)
}

fn index_of(contact: &SolverContact) -> usize {
    contact.contact_indices()[0] as usize
}

/// The points at which two parts pressed on each other in the last substep.
pub(super) fn pressing(manifold: &ContactManifold) -> impl Iterator<Item = &Point> {
    let solved = manifold.data.solver_contacts.iter();
    let points = solved.map(|contact| &manifold.points[index_of(contact)]);
    points.filter(|point| point.data.impulse > 0.0)
}
