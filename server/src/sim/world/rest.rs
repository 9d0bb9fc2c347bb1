//! Whether an object could lie where it is put.

use rapier3d::parry::query;
use rapier3d::prelude::ColliderHandle;

use super::{Aabb, BodyId, SCALE, World};

impl World {
    /// The box around a body, m.
    pub fn bounds(&self, body: BodyId) -> Aabb {
        let empty = Aabb::around([]);
        self.boxes(body.0).fold(empty, |bounds, part| bounds.merged(&part))
    }

    /// How deep `body` is, where it was put, in the other bodies that take part and that `counts`, m; 0 where it
    /// is in none.
    pub fn overlap(&self, body: BodyId, counts: impl Fn(BodyId) -> bool) -> f64 {
        let at = |part: &ColliderHandle| {
            let collider = &self.colliders[*part];
            let owner = collider.parent().expect("every collider belongs to a body");
            let body_from_part =
                collider.position_wrt_parent().expect("every collider belongs to a body");
            (*self.bodies[owner].position() * *body_from_part, collider.shape())
        };
        let others = self.bodies.iter().filter(|(handle, other)| {
            *handle != body.0 && other.is_enabled() && counts(BodyId(*handle))
        });
        let others: Vec<_> = others.flat_map(|(_, other)| other.colliders()).map(at).collect();
        let mut deepest = 0.0_f64;
        for (own_pose, own) in self.bodies[body.0].colliders().iter().map(at) {
            for (pose, shape) in &others {
                // Shapes between which the engine knows no contact do not overlap either.
                if let Ok(Some(contact)) = query::contact(&own_pose, own, pose, *shape, 0.0) {
                    deepest = deepest.max(-f64::from(contact.dist) / SCALE);
                }
            }
        }
        deepest
    }

    /// Whether a body is fixed or a free object.
    pub(in crate::sim) fn is_fixed_or_free(&self, body: BodyId) -> bool {
        self.fixed.contains(&body.0) || self.free.contains(&body.0)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::super::{Motion, Part, Shape, Solver};
    use super::*;
    use crate::sim::frames::Pose;

    #[test]
    fn overlaps_are_as_deep_as_they_are_and_of_bodies_that_count() {
        let mut world = World::new(Solver::LIGHT);
        let cube =
            Part { body_from_part: Pose::identity(), shape: Shape::Cuboid(Vector3::repeat(0.01)) };
        let wall = world.insert(Motion::Fixed, &Pose::identity(), 0.5, &[cube]);
        let free = Motion::Free { mass: 0.001 };
        let object = world.insert(free, &Pose::translation(0.1, 0.0, 0.0), 0.5, &[cube]);
        assert_eq!(world.overlap(object, |_| true).to_bits(), 0);
        world.place(object, &Pose::translation(0.017, 0.0, 0.0));
        assert!((world.overlap(object, |_| true) - 0.003).abs() < 1e-6);
        assert_eq!(world.overlap(object, |other| other != wall).to_bits(), 0);
        world.withdraw(wall);
        assert_eq!(world.overlap(object, |_| true).to_bits(), 0);
        assert!((world.bounds(object).max.x - 0.027).abs() < 1e-6);
    }
}
