//! The world: bodies, gravity, contacts and time. The only owner of the physics pipeline.
//!
//! The engine computes lengths scaled by [`frames`](super::frames)' factor. Gravity, masses and
//! forces scale with it, so the motion is the real one; every number in this interface is SI.

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};
use rapier3d::math::{Pose as EnginePose, Vector as EngineVector};
use rapier3d::prelude::{
    BroadPhaseBvh, ColliderBuilder, ColliderHandle, ColliderSet, CollisionPipeline, IslandManager,
    NarrowPhase, RigidBodyBuilder, RigidBodyHandle, RigidBodySet, RigidBodyType,
};

use super::frames::{self, Aabb, Pose, SCALE};

mod attachment;
mod constraint;
mod contact;
mod hinge;
mod inertia;
mod non_rigid;
mod points;
mod rest;
mod rolling;
mod sleep;
mod soft;
mod spring;
mod substep;
#[cfg(test)]
mod tests;

pub use attachment::AttachmentId;
pub use contact::{Contact, Overlap, Push};
pub use hinge::{Hinge, HingedId, JawMotor};
pub use inertia::Inertia;
pub use non_rigid::{NonRigid, RestSurface, Surface};
pub use soft::SoftId;
pub use spring::{Spring, SprungId};

/// Acceleration of free fall, m/s².
pub const GRAVITY: f64 = 9.81;

/// Substeps in a second.
pub const SUBSTEPS_PER_SECOND: f64 = 240.0;

/// How hard the solver works; stiffness of contacts is per mass, so light objects need more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solver {
    /// Solver iterations in a substep.
    pub iterations: usize,
    /// How often all rows are solved in each half of an iteration.
    pub sweeps: usize,
    /// Natural frequency of contacts, Hz; at most 0.8/2π of the rate of iterations.
    pub contact_frequency: f64,
    /// Contacts are at least as stiff, N/m, however light what moves is.
    pub least_stiffness: f64,
}

impl Solver {
    /// For objects of about 10 g.
    pub const HEAVY: Self =
        Self { iterations: 16, sweeps: 1, contact_frequency: 270.0, least_stiffness: 0.0 };
    /// For real instruments' objects, from 0.4 g on.
    pub const LIGHT: Self =
        Self { iterations: 16, sweeps: 1, contact_frequency: 500.0, least_stiffness: 2e3 };

    /// For what no instrument touches and what is not fast: objects bear no more than their own weight, under
    /// which they sink by g/ω² = 4 µm at 250 Hz, and what they run into they enter by at most v/ω.
    const RESTING: Self =
        Self { iterations: 8, sweeps: 1, contact_frequency: 250.0, least_stiffness: 0.0 };
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
    /// The points within `radius` of the y axis and within `half_height` of the origin along it.
    Cylinder {
        /// Half the distance between its flat ends.
        half_height: f64,
        /// Distance from the axis.
        radius: f64,
    },
}

impl Shape {
    /// The same form, `size` times as large.
    #[must_use]
    pub fn scaled(self, size: f64) -> Self {
        match self {
            Self::Cuboid(half) => Self::Cuboid(half * size),
            Self::Capsule { a, b, radius } => {
                Self::Capsule { a: a * size, b: b * size, radius: radius * size }
            }
            Self::Cylinder { half_height, radius } => {
                Self::Cylinder { half_height: half_height * size, radius: radius * size }
            }
        }
    }

    /// Its volume, m³.
    fn volume(&self) -> f64 {
        match self {
            Self::Cuboid(half) => 8.0 * half.x * half.y * half.z,
            Self::Capsule { a, b, radius } => {
                PI * radius * radius * ((b - a).norm() + 4.0 / 3.0 * radius)
            }
            Self::Cylinder { half_height, radius } => PI * radius * radius * 2.0 * half_height,
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
    /// The same part of a body `size` times as large.
    #[must_use]
    pub fn scaled(&self, size: f64) -> Self {
        Self {
            body_from_part: frames::scaled(&self.body_from_part, size),
            shape: self.shape.scaled(size),
        }
    }

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
            Shape::Cylinder { half_height, radius } => {
                let axis = world_from_part.rotation * Vector3::y();
                // A disc reaches as far along each direction as that is across the axis.
                let across = axis.map(|along| radius * (1.0 - along * along).max(0.0).sqrt());
                let half = axis.abs() * *half_height + across;
                let centre = world_from_part.translation.vector;
                Aabb { min: centre - half, max: centre + half }
            }
        }
    }
}

/// What moves a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion {
    /// Nothing.
    Fixed,
    /// Calls of [`World::drive`]; no force stops it.
    Driven,
    /// Forces.
    Free {
        /// Mass, kg, shared by the parts by their volume.
        mass: f64,
    },
}

/// A body as its collision shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct Solid {
    /// Which it is.
    pub body: BodyId,
    /// What moves it.
    pub motion: Motion,
    /// Where it is.
    pub world_from_body: Pose,
    /// Its collision shapes.
    pub parts: Vec<Part>,
}

/// A body in the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BodyId(RigidBodyHandle);

/// Bodies, joints, contacts and the time that passes for them. A clone goes on bit by bit like
/// the original.
#[derive(Clone)]
pub struct World {
    solver: Solver,
    islands: IslandManager,
    broad_phase: BroadPhaseBvh,
    narrow_phase: NarrowPhase,
    bodies: RigidBodySet,
    colliders: ColliderSet,
    hinges: Vec<hinge::Hung>,
    springs: Vec<spring::Sprung>,
    attachments: Vec<attachment::Attachment>,
    /// Driven bodies, and where each is to be at the end of the substep.
    driven: Vec<(RigidBodyHandle, Option<EnginePose>)>,
    /// What bodies did to each other in the last substep.
    impulses: Vec<substep::ContactImpulse>,
    free: Vec<RigidBodyHandle>,
    /// The bodies that are not rigid.
    others: Vec<Box<dyn NonRigid>>,
    /// Which of them passes the substep now.
    advancing: usize,
    /// What soft bodies did to rigid ones in the last substep.
    soft_touches: Vec<soft::SoftTouch>,
    /// Where rigid bodies were in skin that has not given way.
    soft_obstacles: Vec<(RigidBodyHandle, Overlap)>,
    /// The free objects that passed this substep beside soft bodies.
    passed: Vec<soft::PassedObject>,
    /// What turns pairs of fingers.
    grips: Vec<soft::Grip>,
    /// The bodies that soft ones meet as profiled jaws.
    profiled: Vec<RigidBodyHandle>,
    /// Greatest speed of a free object in any substep, engine units.
    fastest: f32,
    fixed: Vec<RigidBodyHandle>,
    /// The boxes of all parts of fixed bodies, m.
    static_boxes: Vec<Aabb>,
    workspace: Workspace,
}

/// Memory that is used again from substep to substep and that holds no state.
#[derive(Default)]
struct Workspace {
    collisions: CollisionPipeline,
    constraints: constraint::Constraints,
    awake: Vec<RigidBodyHandle>,
    solved: Vec<(RigidBodyHandle, constraint::SolverBody)>,
    impulses: Vec<substep::ContactImpulse>,
    /// Where a pair of fingers pressed on a free object.
    touches: Vec<rolling::Touch>,
}

impl Clone for Workspace {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl World {
    /// A world with nothing in it.
    pub fn new(solver: Solver) -> Self {
        Self {
            solver,
            islands: IslandManager::new(),
            broad_phase: BroadPhaseBvh::default(),
            narrow_phase: NarrowPhase::new(),
            bodies: RigidBodySet::new(),
            colliders: ColliderSet::new(),
            hinges: Vec::new(),
            springs: Vec::new(),
            attachments: Vec::new(),
            driven: Vec::new(),
            impulses: Vec::new(),
            free: Vec::new(),
            others: Vec::new(),
            advancing: 0,
            soft_touches: Vec::new(),
            soft_obstacles: Vec::new(),
            passed: Vec::new(),
            grips: Vec::new(),
            profiled: Vec::new(),
            fastest: 0.0,
            fixed: Vec::new(),
            static_boxes: Vec::new(),
            workspace: Workspace::default(),
        }
    }

    /// Sets how hard the solver works from now on.
    pub fn set_solver(&mut self, solver: Solver) {
        self.solver = solver;
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
            Motion::Driven => (RigidBodyBuilder::kinematic_velocity_based(), 0.0),
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
            Motion::Fixed => {
                self.fixed.push(body);
                self.survey(body);
            }
            Motion::Driven => self.driven.push((body, None)),
        }
        BodyId(body)
    }

    /// Sets where a body is, at once; it must lie at rest there if it is free.
    pub fn place(&mut self, body: BodyId, world_from_body: &Pose) {
        self.bodies[body.0].set_position(frames::to_engine(world_from_body), false);
        self.survey(body.0);
    }

    /// Gives a body the forms of `parts` in place of its own, one for one; its mass stays.
    pub fn reshape(&mut self, body: BodyId, parts: impl IntoIterator<Item = Part>) {
        for (handle, part) in self.bodies[body.0].colliders().iter().zip(parts) {
            let shape = collider(&part.shape).shape;
            let collider = &mut self.colliders[*handle];
            collider.set_shape(shape);
            collider.set_position_wrt_parent(frames::to_engine(&part.body_from_part));
        }
        self.survey(body.0);
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
        let next = Some(frames::to_engine(world_from_body));
        let driven = self.driven.iter_mut().find(|(handle, _)| *handle == body.0);
        driven.expect("it is a driven body").1 = next;
    }

    /// Lets one substep pass.
    pub fn advance(&mut self) {
        self.advance_others();
        self.advance_rigid();
        for body in &self.free {
            self.fastest = self.fastest.max(self.bodies[*body].linvel().length());
        }
        self.end_grips();
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

    /// The free objects, in the order in which they were put into the world.
    pub fn objects(&self) -> impl Iterator<Item = BodyId> {
        self.free.iter().map(|body| BodyId(*body))
    }

    /// All bodies that take part, as their collision shapes, in the order in which they were put into the
    /// world.
    pub fn bodies(&self) -> impl Iterator<Item = Solid> {
        self.bodies.iter().filter(|(_, body)| body.is_enabled()).map(|(handle, body)| Solid {
            body: BodyId(handle),
            motion: match body.body_type() {
                RigidBodyType::Fixed => Motion::Fixed,
                RigidBodyType::Dynamic if self.moving().any(|body| *body == handle) => {
                    Motion::Free { mass: f64::from(body.mass()) / (SCALE * SCALE * SCALE) }
                }
                _ => Motion::Driven,
            },
            world_from_body: frames::from_engine(body.position()),
            parts: body.colliders().iter().filter_map(|part| self.part(*part)).collect(),
        })
    }

    /// A collider as it was put into the world.
    fn part(&self, handle: ColliderHandle) -> Option<Part> {
        let collider = &self.colliders[handle];
        let point = |at| Point3::from(frames::from_engine_vector(at));
        let shape = if let Some(cuboid) = collider.shape().as_cuboid() {
            Shape::Cuboid(frames::from_engine_vector(cuboid.half_extents))
        } else if let Some(cylinder) = collider.shape().as_cylinder() {
            let [half_height, radius] =
                [cylinder.half_height, cylinder.radius].map(|length| f64::from(length) / SCALE);
            Shape::Cylinder { half_height, radius }
        } else {
            let capsule = collider.shape().as_capsule()?;
            let (a, b) = (point(capsule.segment.a), point(capsule.segment.b));
            Shape::Capsule { a, b, radius: f64::from(capsule.radius) / SCALE }
        };
        let body_from_part = collider.position_wrt_parent().map(frames::from_engine)?;
        Some(Part { body_from_part, shape })
    }

    /// Greatest speed of the centre of mass of any free object in all substeps so far, m/s.
    pub fn fastest(&self) -> f64 {
        f64::from(self.fastest) / SCALE
    }

    /// All that forces move: the free objects, then the bodies on springs.
    fn moving(&self) -> impl Iterator<Item = &RigidBodyHandle> {
        self.free.iter().chain(self.springs.iter().map(|spring| &spring.body))
    }

    /// Whether everything that forces move, of whatever kind, rests: then nothing changes until something touches one.
    pub fn at_rest(&self) -> bool {
        self.moving().all(|body| self.bodies[*body].is_sleeping())
            && self.others.iter().all(|other| other.at_rest())
    }

    /// Whether the box of any part of what forces move, of whatever kind, meets `region`.
    pub fn object_in(&self, region: &Aabb) -> bool {
        self.moving().any(|body| self.boxes(*body).any(|part| region.meets(&part)))
            || self.others.iter().any(|other| region.meets(&other.bounds()))
    }

    /// Whether the box of any part of a fixed body meets `region`.
    pub fn static_in(&self, region: &Aabb) -> bool {
        self.static_boxes.iter().any(|part| region.meets(part))
    }

    /// Takes note of where a body is now, if it is a fixed one.
    fn survey(&mut self, body: RigidBodyHandle) {
        if self.fixed.contains(&body) {
            self.static_boxes = self.fixed.iter().flat_map(|body| self.boxes(*body)).collect();
        }
    }

    /// The boxes around the parts of a body, m.
    fn boxes(&self, body: RigidBodyHandle) -> impl Iterator<Item = Aabb> {
        let body = &self.bodies[body];
        body.colliders().iter().map(|handle| {
            let collider = &self.colliders[*handle];
            let body_from_part =
                collider.position_wrt_parent().expect("every collider belongs to a body");
            let part = collider.shape().compute_aabb(&(*body.position() * *body_from_part));
            Aabb {
                min: frames::from_engine_vector(part.mins),
                max: frames::from_engine_vector(part.maxs),
            }
        })
    }

    /// Positions and velocities of all free objects and bodies on springs, as bits; then those of bodies of
    /// other kinds.
    pub fn bits(&self) -> impl Iterator<Item = u32> {
        let rigid = self.moving().flat_map(|body| {
            let body = &self.bodies[*body];
            let (turned, velocity, rate) = (body.rotation(), body.linvel(), body.angvel());
            let position = body.translation();
            let numbers = [position.to_array(), velocity.to_array(), rate.to_array()];
            turned.to_array().into_iter().chain(numbers.concat()).map(f32::to_bits)
        });
        rigid.chain(self.others.iter().flat_map(|other| other.bits()))
    }

    /// Whether positions and velocities of all that forces move are finite numbers.
    pub fn is_finite(&self) -> bool {
        self.moving().all(|body| {
            let body = &self.bodies[*body];
            body.position().is_finite() && body.linvel().is_finite() && body.angvel().is_finite()
        }) && self.others.iter().all(|other| other.is_finite())
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

/// Speed from which on an impact asks for the whole stiffness of contacts, m/s: at 250 Hz, what is slower
/// enters what it meets by less than 0.13 mm, a quarter of the radius of a needle's wire.
const RESTING_SPEED: f64 = 0.2;

/// Acceleration of free fall, engine units.
fn gravity() -> EngineVector {
    frames::to_engine_vector(&Vector3::new(0.0, 0.0, -GRAVITY))
}

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
        Shape::Cylinder { half_height, radius } => {
            ColliderBuilder::cylinder((half_height * SCALE) as f32, (radius * SCALE) as f32)
        }
    }
}
