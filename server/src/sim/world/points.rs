//! At which points of a contact the solver has rows.
//!
//! Where a capsule lies on a face, the engine finds each end of their common line twice, and the deeper one a third
//! time. One of each place is enough.
//!
//! A finger turns about its hinge only. Where static bodies are in its way otherwise, no contact could help, and the
//! impulses of one that tried would be enormous. Such points are left out: that instruments stop at static bodies is
//! the business of [`motion`](crate::sim::motion). For the same reason, the substep leaves out friction that would jam a finger.

use arrayvec::ArrayVec;
use rapier3d::geometry::ContactManifold;
use rapier3d::math::{Pose, Vector};

use crate::sim::frames::SCALE;

/// Distance below which points are one place, m: far above rounding, far below what is between the ends of a line on
/// a finger.
const PLACE: f64 = 1e-6;

/// Distance up to which there are rows, beside that by which two surfaces come nearer in a substep, m: far above the
/// 0.09 mm (½·g·t²) that begin to fall in one, and above what slides or rolls in a grip.
pub(super) const NEAR: f64 = 0.3e-3;

/// How much a push must move two bodies that joints bear for there to be a row between them, 1/kg: a finger's is as
/// much 2.6 mm from its hinge.
pub(super) const MOVABLE: f64 = 10.0;

/// A point of a manifold, engine units.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    /// In the first collider.
    pub local: Vector,
    /// Halfway between both surfaces, world frame.
    pub middle: Vector,
    /// Distance of both surfaces, below 0 where they overlap.
    pub distance: f32,
}

/// The points of a manifold of two colliders, one for each place.
pub(super) fn distinct(manifold: &ContactManifold, colliders: [&Pose; 2]) -> ArrayVec<Point, 4> {
    let mut distinct: ArrayVec<Point, 4> = ArrayVec::new();
    for contact in &manifold.data.solver_contacts {
        let found = &manifold.points[contact.contact_indices()[0] as usize];
        let same = |point: &Point| {
            let apart = (PLACE * SCALE) as f32;
            point.local.distance_squared(found.local_p1) < apart * apart
        };
        if distinct.is_full() || distinct.iter().any(same) {
            continue;
        }
        let on_both = [(colliders[0], found.local_p1), (colliders[1], found.local_p2)];
        let [one, other] = on_both.map(|(pose, local)| pose.transform_point(local));
        let middle = 0.5 * (one + other);
        distinct.push(Point { local: found.local_p1, middle, distance: contact.dist });
    }
    distinct
}
