//! Bodies on vertical springs: a support that gives.
//!
//! Such a body moves up and down only, from where it is put to a hard stop below. The engine solves spring
//! and damper together with the contacts, so what lies on it sinks by its weight over the stiffness.

use rapier3d::math::Vector;
use rapier3d::prelude::{LockedAxes, RigidBodyBuilder, RigidBodyHandle};

use super::constraint::{Constraints, Joint, Spatial};
use super::{BodyId, Part, SLEEP_AFTER, World, collider};
use crate::sim::frames::{self, Pose, SCALE};

/// A vertical spring with a damper, critical for the body that it bears.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spring {
    /// Force per length, N/m.
    pub stiffness: f64,
    /// How far down the body can be pressed, m.
    pub travel: f64,
}

impl Spring {
    /// How far it gives under a `load` (N) at rest, m.
    pub fn sag(&self, load: f64) -> f64 {
        (load / self.stiffness).clamp(0.0, self.travel)
    }
}

/// A body on a vertical spring; see [`World::insert_sprung`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SprungId {
    body: BodyId,
    /// Its mass, kg.
    mass: f64,
    /// What it is pressed against in the end.
    stop: BodyId,
    /// Where the stop would be for a spring that does not give.
    world_from_stop: Pose,
}

/// A spring, in engine units.
#[derive(Debug, Clone)]
pub(super) struct Sprung {
    pub base: RigidBodyHandle,
    pub body: RigidBodyHandle,
    /// Height of the body without load.
    pub rest: f32,
    pub stiffness: f32,
    pub damping: f32,
}

impl SprungId {
    /// The body.
    pub fn body(&self) -> BodyId {
        self.body
    }
}

impl World {
    /// Puts a body of `mass` (kg) on a spring that stands on the fixed body `base`, which it does not meet. At
    /// `world_from_body` the spring is without load: its own weight counts as balanced. It is no object.
    pub fn insert_sprung(
        &mut self,
        base: BodyId,
        spring: Spring,
        mass: f64,
        world_from_body: &Pose,
        friction: f64,
        parts: &[Part],
    ) -> SprungId {
        let up_and_down = LockedAxes::all().difference(LockedAxes::TRANSLATION_LOCKED_Z);
        let builder = RigidBodyBuilder::dynamic()
            .pose(frames::to_engine(world_from_body))
            .additional_mass((mass * f64::powi(SCALE, 3)) as f32)
            .gravity_scale(0.0)
            .locked_axes(up_and_down)
            .sleeping(true);
        let body = self.bodies.insert(builder);
        self.bodies[body].activation_mut().time_until_sleep = SLEEP_AFTER;
        for part in parts {
            let collider = collider(&part.shape)
                .position(frames::to_engine(&part.body_from_part))
                .density(0.0)
                .friction(friction as f32);
            self.colliders.insert_with_parent(collider, body, &mut self.bodies);
        }
        let height = parts.iter().map(|part| part.aabb(&Pose::identity()));
        let height =
            height.reduce(|all, part| all.merged(&part)).map_or(0.0, |all| all.extents().z);
        let world_from_stop = Pose::translation(0.0, 0.0, -height) * world_from_body;
        let stop = self.bodies.insert(RigidBodyBuilder::fixed());
        for part in parts {
            let collider = collider(&part.shape).position(frames::to_engine(&part.body_from_part));
            self.colliders.insert_with_parent(collider, stop, &mut self.bodies);
        }
        let rest = frames::to_engine_vector(&world_from_body.translation.vector).z;
        self.springs.push(Sprung { base: base.0, body, rest, stiffness: 0.0, damping: 0.0 });
        let (body, stop) = (BodyId(body), BodyId(stop));
        let sprung = SprungId { body, mass, stop, world_from_stop };
        self.set_spring(&sprung, spring);
        sprung
    }

    /// Adds the rows of a spring: spring and damper, and the stop above, where it has no load.
    pub(super) fn add_spring(&self, spring: &Sprung, number: usize, constraints: &mut Constraints) {
        let jacobian = Spatial::new(Vector::Z, Vector::ZERO);
        let position = self.bodies[spring.body].translation().z - spring.rest;
        let Sprung { stiffness, damping, .. } = *spring;
        let motor = Joint::Motor { position, target: 0.0, stiffness, damping, per_inertia: false };
        constraints.add_joint(number, jacobian, 0.0, motor);
        let limits = [f32::NEG_INFINITY, 0.0];
        constraints.add_joint(number, jacobian, 0.0, Joint::Limit { position, limits });
    }

    /// Gives a body another spring.
    pub fn set_spring(&mut self, sprung: &SprungId, Spring { stiffness, travel }: Spring) {
        let damping = 2.0 * (stiffness * sprung.mass).sqrt();
        // An engine force is SCALE³ (mass) · SCALE (length) of the real one.
        let [stiffness, damping] =
            [stiffness, damping].map(|number| (number * f64::powi(SCALE, 3)) as f32);
        let own = self.springs.iter_mut().find(|spring| spring.body == sprung.body.0);
        let own = own.expect("springs stay");
        (own.stiffness, own.damping) = (stiffness, damping);
        self.place(sprung.stop, &(Pose::translation(0.0, 0.0, -travel) * sprung.world_from_stop));
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::sim::world::{GRAVITY, Motion, SUBSTEPS_PER_SECOND, Shape, Solver};

    const SPRING: Spring = Spring { stiffness: 200.0, travel: 2e-3 };

    fn cuboid(half: Vector3<f64>) -> Part {
        Part { body_from_part: Pose::identity(), shape: Shape::Cuboid(half) }
    }

    /// A plate with its top at 0 on a spring, and a block of `mass` (kg) on it.
    fn loaded(solver: Solver, mass: f64) -> (World, SprungId, BodyId) {
        let mut world = World::new(solver);
        let down = |z: f64| Pose::translation(0.0, 0.0, -z);
        let (base, plate) = (Vector3::new(0.05, 0.05, 5e-3), Vector3::new(0.05, 0.05, 1.5e-3));
        let base = world.insert(Motion::Fixed, &down(0.02), 1.0, &[cuboid(base)]);
        let plate = world.insert_sprung(base, SPRING, 0.03, &down(plate.z), 1.0, &[cuboid(plate)]);
        let half = Vector3::new(5e-3, 5e-3, 2e-3);
        let block = world.insert(Motion::Free { mass }, &down(-half.z), 1.0, &[cuboid(half)]);
        (world, plate, block)
    }

    fn run(world: &mut World, seconds: f64) -> Vec<f64> {
        let height =
            |world: &World| world.pose(BodyId(world.springs[0].body)).translation.z + 1.5e-3;
        let substeps = (seconds * SUBSTEPS_PER_SECOND) as u32;
        (0..substeps).map(|_| (world.advance(), height(world)).1).collect()
    }

    #[test]
    fn a_weight_sinks_by_itself_over_the_stiffness_and_no_deeper_than_to_the_stop() {
        for solver in [Solver::LIGHT, Solver::HEAVY] {
            for mass in [0.4e-3, 0.01, 0.03, 0.1] {
                let (mut world, _, block) = loaded(solver, mass);
                world.wake(block);
                let heights = run(&mut world, 2.0);
                let sag = SPRING.sag(mass * GRAVITY);
                let sunk = -heights[heights.len() - 1];
                assert!(
                    (sunk - sag).abs() < 0.001 * sag + 5e-6,
                    "{solver:?}, {mass}: {sunk}, {sag}"
                );
                let block = world.pose(block).translation.z - 2e-3;
                assert!((block + sunk).abs() < 10e-6, "{solver:?}, {mass}: {block}");
                assert!(world.at_rest(), "{solver:?}, {mass}");
            }
        }
    }

    #[test]
    fn relieved_of_its_load_it_comes_back_without_ringing_and_rests() {
        let (mut world, plate, block) = loaded(Solver::LIGHT, 0.03);
        world.wake(block);
        run(&mut world, 1.0);
        let away = Pose::translation(0.03, 0.0, 0.2);
        world.place(block, &away);
        world.withdraw(block);
        world.wake(plate.body());
        let heights = run(&mut world, 1.0);
        assert!(heights.windows(2).all(|pair| pair[1] >= pair[0] - 1e-8));
        assert!(heights.iter().all(|height| *height < 2e-6));
        assert!(heights[heights.len() - 1].abs() < 1e-6);
        // ω = √(k/m) = 82/s: (1 + ωt)·exp(−ωt) of 1.47 mm after 20 ms.
        let (omega, time): (f64, f64) = (81.65, 5.0 / SUBSTEPS_PER_SECOND);
        let expected = -SPRING.sag(0.03 * GRAVITY) * (1.0 + omega * time) * (-omega * time).exp();
        assert!((heights[4] - expected).abs() < 0.1e-3, "{} {expected}", heights[4]);
    }

    #[test]
    fn a_clone_of_a_loaded_spring_goes_on_bit_by_bit_like_the_original() {
        let (mut world, _, block) = loaded(Solver::LIGHT, 0.02);
        world.wake(block);
        run(&mut world, 0.02);
        let mut clone = world.clone();
        assert!(run(&mut world, 0.3) == run(&mut clone, 0.3));
        assert!(world.bits().eq(clone.bits()));
    }
}
