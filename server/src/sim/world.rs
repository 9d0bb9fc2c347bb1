//! The world: bodies, gravity, contacts and time. The only owner of the physics pipeline.
//!
//! The engine computes lengths scaled by [`frames`](super::frames)' factor. Gravity, masses and
//! forces scale with it, so the motion is the real one; every number in this interface is SI.

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};
use rapier3d::dynamics::SpringCoefficients;
use rapier3d::parry::query;
use rapier3d::prelude::{
    BroadPhaseBvh, CCDSolver, ColliderBuilder, ColliderHandle, ColliderSet, ContactPair,
    FrictionModel, ImpulseJointSet, IntegrationParameters, IslandManager, MultibodyJointSet,
    NarrowPhase, PhysicsPipeline, RigidBodyBuilder, RigidBodyHandle, RigidBodySet, SoftBodySet,
};

use super::frames::{self, Aabb, Pose, SCALE};

mod hinge;
mod inertia;
mod tie;

pub use hinge::{Hinge, HingedId};
pub use inertia::Inertia;
pub use tie::TieId;

/// Acceleration of free fall, m/s².
pub const GRAVITY: f64 = 9.81;

/// Substeps in a second.
pub const SUBSTEPS_PER_SECOND: f64 = 240.0;

/// How hard the solver works; stiffness of contacts is per mass, so light objects need more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solver {
    /// Solver iterations in a substep.
    pub iterations: usize,
    /// Natural frequency of contacts, Hz; at most 0.8/2π of the rate of iterations.
    pub contact_frequency: f64,
}

impl Solver {
    /// For objects of about 10 g.
    pub const HEAVY: Self = Self { iterations: 8, contact_frequency: 250.0 };
    /// For real instruments' objects, from 0.4 g on.
    pub const LIGHT: Self = Self { iterations: 16, contact_frequency: 500.0 };
}

/// The form of one part of a body; lengths in m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// A box by its half extents.
    Cuboid(Vector3<f64>),
    /// The points within `radius` of the segment from `a` to `b`.
    Capsule {
        /// One end.
        a: Point3<f64>,
        /// The other.
        b: Point3<f64>,
        /// Distance from the segment.
        radius: f64,
    },
}

impl Shape {
    /// Its volume, m³.
    fn volume(&self) -> f64 {
        match self {
            Self::Cuboid(half) => 8.0 * half.x * half.y * half.z,
            Self::Capsule { a, b, radius } => {
                PI * radius * radius * ((b - a).norm() + 4.0 / 3.0 * radius)
            }
        }
    }
}

/// One part of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// Where it is in the body.
    pub body_from_part: Pose,
    /// Its form.
    pub shape: Shape,
}

impl Part {
    /// The box around it when its body is at `world_from_body`, m.
    pub fn aabb(&self, world_from_body: &Pose) -> Aabb {
        let world_from_part = world_from_body * self.body_from_part;
        match &self.shape {
            Shape::Cuboid(half) => {
                let corners = Aabb { min: -half, max: *half }.corners();
                Aabb::around(corners.map(|corner| world_from_part * corner))
            }
            Shape::Capsule { a, b, radius } => {
                Aabb::around([world_from_part * a, world_from_part * b]).grown(*radius)
            }
        }
    }
}

/// What moves a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion {
    /// Nothing.
    Fixed,
    /// Whoever drives it, see [`World::drive`]; no force stops it.
    Driven,
    /// Forces.
    Free {
        /// Mass, kg, shared by the parts by their volume.
        mass: f64,
    },
}

/// A body in the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BodyId(RigidBodyHandle);

/// What the rest of the world does to an instrument.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Push {
    /// Sum of the contact forces, N; a squeeze from two sides cancels.
    pub force: Vector3<f64>,
    /// Force at the contact that bears most, N.
    pub strongest: f64,
    /// Where that is; the origin where nothing touches.
    pub point: Point3<f64>,
    /// Deepest overlap of an object that touches; that with the bodies asked for does not count where
    /// they squeeze the object from two sides.
    pub overlap: Overlap,
}

/// Where something overlaps with what is in its way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Overlap {
    /// How deep, m.
    pub depth: f64,
    /// Where.
    pub point: Point3<f64>,
    /// The direction into what is in the way.
    pub into: Vector3<f64>,
}

impl Overlap {
    /// Nothing overlaps.
    pub const NONE: Self =
        Self { depth: 0.0, point: Point3::new(0.0, 0.0, 0.0), into: Vector3::new(0.0, 0.0, 0.0) };

    /// The deeper of two.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        if other.depth > self.depth { other } else { self }
    }
}

impl Push {
    /// Nothing touches.
    pub const NONE: Self = Self {
        force: Vector3::new(0.0, 0.0, 0.0),
        strongest: 0.0,
        point: Point3::new(0.0, 0.0, 0.0),
        overlap: Overlap::NONE,
    };

    /// What two bodies feel together.
    #[must_use]
    pub fn with(self, other: Self) -> Self {
        let stronger = if other.strongest > self.strongest { other } else { self };
        Self {
            force: self.force + other.force,
            overlap: self.overlap.or(other.overlap),
            ..stronger
        }
    }
}

/// Bodies, joints, contacts and the time that passes for them. A clone goes on bit by bit like
/// the original.
#[derive(Clone)]
pub struct World {
    parameters: IntegrationParameters,
    islands: IslandManager,
    broad_phase: BroadPhaseBvh,
    narrow_phase: NarrowPhase,
    bodies: RigidBodySet,
    colliders: ColliderSet,
    impulse_joints: ImpulseJointSet,
    multibody_joints: MultibodyJointSet,
    soft_bodies: SoftBodySet,
    free: Vec<RigidBodyHandle>,
    /// Greatest speed of a free object in any substep, engine units.
    fastest: f32,
    fixed: Vec<RigidBodyHandle>,
    workspace: Workspace,
}

/// Memory that the engine reuses from step to step and that holds no state.
#[derive(Default)]
struct Workspace {
    pipeline: PhysicsPipeline,
    ccd: CCDSolver,
}

impl Clone for Workspace {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl World {
    /// A world with nothing in it.
    pub fn new(solver: Solver) -> Self {
        let softness = SpringCoefficients::new(solver.contact_frequency as f32, CONTACT_DAMPING);
        let parameters = IntegrationParameters {
            dt: (1.0 / SUBSTEPS_PER_SECOND) as f32,
            length_unit: (LENGTH_UNIT * SCALE) as f32,
            num_solver_iterations: solver.iterations,
            num_internal_pgs_iterations: 1,
            num_internal_stabilization_iterations: 1,
            contact_softness: softness,
            static_contact_softness: softness,
            friction_model: FrictionModel::Simplified,
            normalized_max_corrective_velocity: (RECOVERY_SPEED / LENGTH_UNIT) as f32,
            normalized_prediction_distance: (PREDICTION / LENGTH_UNIT) as f32,
            friction_in_bias_pass: false,
            warmstart_joints: false,
            contact_recycling: true,
            normalized_contact_recycle_distance: RECYCLE_DISTANCE,
            contact_clustering: false, // `push_on` reads the manifolds
            max_ccd_substeps: 1, // a needle that falls 5 mm moves by more than its wire's radius a substep
            ..IntegrationParameters::default()
        };
        Self {
            parameters,
            islands: IslandManager::new(),
            broad_phase: BroadPhaseBvh::default(),
            narrow_phase: NarrowPhase::new(),
            bodies: RigidBodySet::new(),
            colliders: ColliderSet::new(),
            impulse_joints: ImpulseJointSet::new(),
            multibody_joints: MultibodyJointSet::new(),
            soft_bodies: SoftBodySet::new(),
            free: Vec::new(),
            fastest: 0.0,
            fixed: Vec::new(),
            workspace: Workspace::default(),
        }
    }

    /// Puts a body into the world. A free one starts asleep: it must lie at rest there.
    pub fn insert(
        &mut self,
        motion: Motion,
        world_from_body: &Pose,
        friction: f64,
        parts: &[Part],
    ) -> BodyId {
        let (builder, density) = match motion {
            Motion::Fixed => (RigidBodyBuilder::fixed(), 0.0),
            Motion::Driven => (RigidBodyBuilder::kinematic_position_based(), 0.0),
            Motion::Free { mass } => {
                let volume: f64 = parts.iter().map(|part| part.shape.volume()).sum();
                (RigidBodyBuilder::dynamic().sleeping(true), mass / volume)
            }
        };
        let body = self.bodies.insert(builder.pose(frames::to_engine(world_from_body)));
        for part in parts {
            let mass = density * part.shape.volume();
            let collider = collider(&part.shape)
                .position(frames::to_engine(&part.body_from_part))
                .mass((mass * SCALE * SCALE * SCALE) as f32)
                .friction(friction as f32);
            self.colliders.insert_with_parent(collider, body, &mut self.bodies);
        }
        match motion {
            Motion::Free { .. } => {
                self.bodies[body].activation_mut().time_until_sleep = SLEEP_AFTER;
                self.free.push(body);
            }
            Motion::Fixed => self.fixed.push(body),
            Motion::Driven => {}
        }
        BodyId(body)
    }

    /// Sets where a body is, at once; it must lie at rest there if it is free.
    pub fn place(&mut self, body: BodyId, world_from_body: &Pose) {
        self.bodies[body.0].set_position(frames::to_engine(world_from_body), false);
    }

    /// Takes a body out of all that happens, until it is brought back.
    pub fn withdraw(&mut self, body: BodyId) {
        self.bodies[body.0].set_enabled(false);
    }

    /// Lets a body take part again that was withdrawn.
    pub fn bring_back(&mut self, body: BodyId) {
        self.bodies[body.0].set_enabled(true);
    }

    /// Sets the friction coefficient of all parts of a body.
    pub fn set_friction(&mut self, body: BodyId, friction: f64) {
        for handle in self.bodies[body.0].colliders() {
            self.colliders[*handle].set_friction(friction as f32);
        }
    }

    /// Wakes a free body that would otherwise stay where it is.
    pub fn wake(&mut self, body: BodyId) {
        self.bodies[body.0].wake_up(true);
    }

    /// Sets where a driven body will be at the end of the next substep.
    pub fn drive(&mut self, body: BodyId, world_from_body: &Pose) {
        self.bodies[body.0].set_next_kinematic_position(frames::to_engine(world_from_body));
    }

    /// Lets one substep pass.
    pub fn step(&mut self) {
        self.workspace.pipeline.step(
            frames::to_engine_vector(&Vector3::new(0.0, 0.0, -GRAVITY)),
            &self.parameters,
            &mut self.islands,
            &mut self.broad_phase,
            &mut self.narrow_phase,
            &mut self.bodies,
            &mut self.colliders,
            &mut self.impulse_joints,
            &mut self.multibody_joints,
            &mut self.soft_bodies,
            &mut self.workspace.ccd,
            &(),
            &(),
        );
        for body in &self.free {
            self.fastest = self.fastest.max(self.bodies[*body].linvel().length());
        }
    }

    /// Where a body is.
    pub fn pose(&self, body: BodyId) -> Pose {
        frames::from_engine(self.bodies[body.0].position())
    }

    /// How far a point is from the surface of a body, m; 0 inside.
    pub fn distance(&self, body: BodyId, point: &Point3<f64>) -> f64 {
        let point = frames::to_engine_vector(&point.coords);
        let body = &self.bodies[body.0];
        let parts = body.colliders().iter().map(|handle| {
            let collider = &self.colliders[*handle];
            let body_from_part =
                collider.position_wrt_parent().expect("every collider belongs to a body");
            let pose = *body.position() * *body_from_part;
            f64::from(collider.shape().distance_to_point(&pose, point, true)) / SCALE
        });
        parts.fold(f64::INFINITY, f64::min)
    }

    /// Velocity of a body's centre of mass, m/s.
    pub fn velocity(&self, body: BodyId) -> Vector3<f64> {
        frames::from_engine_vector(self.bodies[body.0].linvel())
    }

    /// Gives a free body this velocity, m/s.
    pub fn set_velocity(&mut self, body: BodyId, velocity: &Vector3<f64>) {
        self.bodies[body.0].set_linvel(frames::to_engine_vector(velocity), true);
    }

    /// Pulls at a free body's centre of mass with this force and no other from now on, N.
    pub fn pull(&mut self, body: BodyId, force: &Vector3<f64>) {
        let body = &mut self.bodies[body.0];
        body.reset_forces(true);
        body.add_force(frames::to_engine_vector(&(force * (SCALE * SCALE * SCALE))), true);
    }

    /// How hard everything together pressed on a body in the last substep, from whatever side, N.
    pub fn pressure(&self, body: BodyId) -> f64 {
        let newtons = SUBSTEPS_PER_SECOND / f64::powi(SCALE, 4);
        let parts = self.bodies[body.0].colliders().iter();
        let pairs = parts.flat_map(|part| self.narrow_phase.contact_pairs_with(*part));
        let contacts = pairs.flat_map(ContactPair::manifolds).flat_map(|each| &each.points);
        contacts.map(|contact| newtons * f64::from(contact.data.impulse)).sum()
    }

    /// The free objects, in the order in which they were put into the world.
    pub fn objects(&self) -> impl Iterator<Item = BodyId> {
        self.free.iter().map(|body| BodyId(*body))
    }

    /// Greatest speed of the centre of mass of any free object in all substeps so far, m/s.
    pub fn fastest(&self) -> f64 {
        f64::from(self.fastest) / SCALE
    }

    /// Deepest overlap of a free object with anything now, m: how far they would have to move apart.
    pub fn deepest_overlap(&self) -> f64 {
        let parts = self.free.iter().flat_map(|body| self.bodies[*body].colliders());
        let pairs = parts.flat_map(|part| self.narrow_phase.contact_pairs_with(*part));
        let overlap = |pair: &ContactPair| {
            let [one, other] = [pair.collider1, pair.collider2].map(|part| &self.colliders[part]);
            // Shapes between which the engine knows no contact do not overlap either.
            let contact =
                query::contact(one.position(), one.shape(), other.position(), other.shape(), 0.0);
            contact.ok().flatten().map_or(0.0, |contact| -f64::from(contact.dist) / SCALE)
        };
        pairs.map(overlap).fold(0.0, f64::max)
    }

    /// Whether every free object sleeps: then nothing changes until something touches one.
    pub fn at_rest(&self) -> bool {
        self.free.iter().all(|body| self.bodies[*body].is_sleeping())
    }

    /// Whether the box of any part of a free object meets `region`.
    pub fn object_in(&self, region: &Aabb) -> bool {
        self.free.iter().any(|body| self.meets(*body, region))
    }

    /// Whether the box of any part of a fixed body meets `region`.
    pub fn furniture_in(&self, region: &Aabb) -> bool {
        self.fixed.iter().any(|body| self.meets(*body, region))
    }

    fn meets(&self, body: RigidBodyHandle, region: &Aabb) -> bool {
        let body = &self.bodies[body];
        body.colliders().iter().any(|handle| {
            let collider = &self.colliders[*handle];
            let body_from_part =
                collider.position_wrt_parent().expect("every collider belongs to a body");
            let part = collider.shape().compute_aabb(&(*body.position() * *body_from_part));
            let (min, max) = (part.mins, part.maxs);
            region.meets(&Aabb {
                min: frames::from_engine_vector(min),
                max: frames::from_engine_vector(max),
            })
        })
    }

    /// What the rest of the world did in the last substep to bodies of one instrument, taken as one:
    /// what they do to each other does not count.
    pub fn push_on(&self, instrument: &[BodyId]) -> Push {
        // An engine force is SCALE³ (mass) · SCALE (length) of the real one.
        let newtons = SUBSTEPS_PER_SECOND / (SCALE * SCALE * SCALE);
        let mut push = Push::NONE;
        for handle in instrument.iter().flat_map(|body| self.bodies[body.0].colliders()) {
            let collider = &self.colliders[*handle];
            for pair in self.narrow_phase.contact_pairs_with(*handle) {
                // Contact normals point from the first collider to the second.
                let first = pair.collider1 == *handle;
                let met = if first { pair.collider2 } else { pair.collider1 };
                let owner = self.colliders[met].parent();
                if instrument.iter().any(|body| Some(body.0) == owner) {
                    continue;
                }
                let sign = if first { -newtons } else { newtons };
                let mut touches = false;
                for manifold in pair.manifolds() {
                    let normal = frames::from_engine_vector(manifold.data.normal);
                    for contact in &manifold.points {
                        let force = normal * (sign * f64::from(contact.data.impulse));
                        push.force += force;
                        touches |= contact.data.impulse > 0.0;
                        if force.norm() > push.strongest {
                            let local = if first { contact.local_p1 } else { contact.local_p2 };
                            let point = collider.position().transform_point(local);
                            push.strongest = force.norm();
                            push.point = frames::from_engine_vector(point).into();
                        }
                    }
                }
                if touches {
                    push.overlap = push.overlap.or(self.overlap_of(met, instrument));
                }
            }
        }
        push
    }

    /// Whether two bodies pressed on each other in the last substep.
    pub fn touch(&self, one: BodyId, other: BodyId) -> bool {
        self.bodies[one.0].colliders().iter().any(|handle| {
            self.narrow_phase.contact_pairs_with(*handle).any(|pair| {
                let met = if pair.collider1 == *handle { pair.collider2 } else { pair.collider1 };
                self.colliders[met].parent() == Some(other.0)
                    && pair
                        .manifolds()
                        .iter()
                        .flat_map(|each| &each.points)
                        .any(|c| c.data.impulse > 0.0)
            })
        })
    }

    /// Deepest overlap of any part of the body that `part` belongs to; without that with the bodies of
    /// `instrument` where these squeeze it.
    fn overlap_of(&self, part: ColliderHandle, instrument: &[BodyId]) -> Overlap {
        let body = self.colliders[part].parent().expect("every collider belongs to a body");
        let touching = instrument.iter().filter(|each| self.touch(**each, BodyId(body)));
        let is_squeezed = touching.count() > 1;
        let is_instruments = |part: ColliderHandle| {
            let parent = self.colliders[part].parent();
            instrument.iter().any(|body| Some(body.0) == parent)
        };
        let mut deepest = Overlap::NONE;
        for part in self.bodies[body].colliders() {
            for pair in self.narrow_phase.contact_pairs_with(*part) {
                let first = pair.collider1 == *part;
                let other = if first { pair.collider2 } else { pair.collider1 };
                let by_instrument = is_instruments(other);
                if by_instrument && is_squeezed {
                    continue;
                }
                // Normals point from the first collider to the second. What moves is the instrument, and
                // the object with it.
                let sign = if first == by_instrument { -1.0 } else { 1.0 };
                let at = self.colliders[*part].position();
                for manifold in pair.manifolds() {
                    for contact in &manifold.points {
                        let depth = -f64::from(contact.dist) / SCALE;
                        if depth > deepest.depth {
                            let local = if first { contact.local_p1 } else { contact.local_p2 };
                            let point =
                                frames::from_engine_vector(at.transform_point(local)).into();
                            let normal = frames::from_engine_vector(manifold.data.normal);
                            deepest = Overlap { depth, point, into: normal * (sign * SCALE) };
                        }
                    }
                }
            }
        }
        deepest
    }

    /// Positions and velocities of all free objects, as bits.
    pub fn bits(&self) -> impl Iterator<Item = u32> {
        self.free.iter().flat_map(|body| {
            let body = &self.bodies[*body];
            let (turned, velocity, rate) = (body.rotation(), body.linvel(), body.angvel());
            let position = body.translation();
            let numbers = [position.to_array(), velocity.to_array(), rate.to_array()];
            turned.to_array().into_iter().chain(numbers.concat()).map(f32::to_bits)
        })
    }

    /// Whether positions and velocities of all free objects are finite numbers.
    pub fn is_finite(&self) -> bool {
        self.free.iter().all(|body| {
            let body = &self.bodies[*body];
            body.is_enabled() // the engine disables bodies whose state is not finite
                && body.position().is_finite()
                && body.linvel().is_finite()
                && body.angvel().is_finite()
        })
    }
}

/// Damping ratio of contacts: above 1, since they must not bounce.
const CONTACT_DAMPING: f32 = 5.0;

/// Speed with which overlaps are undone, m/s. What is far below it (the engine's 0.03 m/s) makes
/// contacts give in: they push no harder however deep the overlap, and jaws sink into the wire that
/// they hold.
const RECOVERY_SPEED: f64 = 0.5;

/// Distance from which on contacts are looked at, m: in a substep a tip moves by 0.5 mm, and the far
/// edge of what lands on its near one by some millimetres.
pub(super) const PREDICTION: f64 = 1e-3;

/// Time after which an object that hardly moves falls asleep, s: what was dropped costs nothing soon.
const SLEEP_AFTER: f32 = 0.25;

/// Size of what is simulated, m: the engine's tolerances are fractions of it.
const LENGTH_UNIT: f64 = 0.01;

/// Relative drift up to which contacts are kept, in units of [`LENGTH_UNIT`]: 50 µm.
const RECYCLE_DISTANCE: f32 = 0.005;

fn collider(shape: &Shape) -> ColliderBuilder {
    match shape {
        Shape::Cuboid(half) => {
            let half = frames::to_engine_vector(half);
            ColliderBuilder::cuboid(half.x, half.y, half.z)
        }
        Shape::Capsule { a, b, radius } => ColliderBuilder::capsule_from_endpoints(
            frames::to_engine_vector(&a.coords),
            frames::to_engine_vector(&b.coords),
            (radius * SCALE) as f32,
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube(half: f64) -> Part {
        Part { body_from_part: Pose::identity(), shape: Shape::Cuboid(Vector3::repeat(half)) }
    }

    fn at(z: f64) -> Pose {
        frames::pose([0.0, 0.0, z], [0.0; 3])
    }

    #[test]
    fn an_object_falls_as_it_really_would() {
        let mut world = World::new(Solver::LIGHT);
        world.insert(Motion::Fixed, &at(-0.01), 1.0, &[cube(0.01)]);
        let (height, half) = (0.02, 0.005);
        let body =
            world.insert(Motion::Free { mass: 0.001 }, &at(height + half), 1.0, &[cube(half)]);
        world.wake(body);
        let mut landed = None;
        for substep in 1..=48 {
            world.step();
            let time = f64::from(substep) / SUBSTEPS_PER_SECOND;
            let fallen = height + half - world.pose(body).translation.z;
            let expected = 0.5 * GRAVITY * time * time;
            if expected < height {
                assert!((fallen - expected).abs() < 0.02 * height, "{fallen} after {time} s");
            } else if landed.is_none() {
                landed = Some(time);
            }
        }
        // √(2h/g) = 63.9 ms, seen at the end of a substep of 4.2 ms.
        let landed = landed.unwrap();
        assert!((landed - 0.0639).abs() < 1.0 / SUBSTEPS_PER_SECOND, "{landed}");
        assert!(world.velocity(body).norm() < 1e-3);
        assert!((world.pose(body).translation.z - half).abs() < 1e-5);
    }

    #[test]
    fn a_resting_object_weighs_what_it_weighs_and_falls_asleep() {
        let mut world = World::new(Solver::HEAVY);
        let plate = world.insert(Motion::Driven, &at(-0.01), 1.0, &[cube(0.01)]);
        let body = world.insert(Motion::Free { mass: 0.01 }, &at(0.001), 1.0, &[cube(0.001)]);
        world.wake(body);
        for _ in 0..100 {
            world.step();
        }
        let push = world.push_on(&[plate]);
        assert!((push.force.z + 0.01 * GRAVITY).abs() < 0.002, "{push:?}");
        for _ in 0..140 {
            world.step();
        }
        assert!(world.at_rest());
    }

    #[test]
    fn a_driven_body_wakes_and_moves_what_it_meets() {
        let mut world = World::new(Solver::HEAVY);
        world.insert(Motion::Fixed, &at(-0.1), 0.5, &[cube(0.1)]);
        let object = world.insert(Motion::Free { mass: 0.01 }, &at(0.002), 0.5, &[cube(0.002)]);
        let start = frames::pose([-0.02, 0.0, 0.0055], [0.0; 3]);
        let pusher = world.insert(Motion::Driven, &start, 0.5, &[cube(0.005)]);
        assert!(world.at_rest());
        for substep in 0..240 {
            let mut pose = start;
            pose.translation.x += 0.03 * f64::from(substep) / 240.0;
            world.drive(pusher, &pose);
            world.step();
        }
        let moved = world.pose(object).translation.x;
        assert!((moved - (0.01 + 0.005 + 0.002)).abs() < 5e-4, "{moved}");
    }

    #[test]
    fn a_clone_goes_on_bit_by_bit_like_the_original() {
        let mut world = World::new(Solver::LIGHT);
        world.insert(Motion::Fixed, &at(-0.01), 1.0, &[cube(0.01)]);
        let tilted = frames::pose([0.0, 0.0, 0.004], [0.3, 0.5, 0.1]);
        let body = world.insert(Motion::Free { mass: 0.001 }, &tilted, 0.3, &[cube(0.001)]);
        world.wake(body);
        let mut bits = vec![];
        for substep in 0..40 {
            let mut clone = world.clone();
            for world in [&mut world, &mut clone] {
                world.step();
                bits.push((substep, world.pose(body).to_homogeneous().map(f64::to_bits)));
            }
        }
        for pair in bits.chunks(2) {
            assert_eq!(pair[0], pair[1]);
        }
    }
}
