//! One substep: what touches what, what moves and how, what falls asleep.
//!
//! The engine finds contacts. This module does the rest, since few bodies move: moving bodies are sorted into islands, and
//! the islands are solved one after the other.

use arrayvec::ArrayVec;
use rapier3d::geometry::ContactManifold;
use rapier3d::math::{Rotation, Vector};
use rapier3d::prelude::{ColliderHandle, RigidBodyHandle};

use super::attachment::Attachment;
use super::constraint::{Constraints, ContactPoint, ContactSide, Friction, SolverBody, Spatial};
use super::points::{self, Point};
use super::{PREDICTION, RESTING_SPEED, SUBSTEPS_PER_SECOND, Solver, World, gravity};
use crate::sim::frames::{self, SCALE};

/// Distance up to which a point of a contact counts as the same as one of the substep before, m.
const SAME_POINT: f64 = 0.3e-3;

/// Length of a substep, s.
const DT: f32 = (1.0 / SUBSTEPS_PER_SECOND) as f32;

/// What two bodies did to each other at a point in the last substep, engine units.
#[derive(Debug, Clone, Copy)]
pub(super) struct ContactImpulse {
    colliders: [ColliderHandle; 2],
    pub bodies: [RigidBodyHandle; 2],
    /// In the first collider.
    local: Vector,
    /// World frame.
    pub point: Vector,
    /// From the first to the second.
    pub normal: Vector,
    /// Along the normal, in all of the substep.
    pub impulse: f32,
    /// The coefficient.
    pub friction: f32,
    /// The impulse of the last iteration, and friction of the whole manifold.
    last: f32,
    last_friction: Friction,
}

/// Two parts that touch or nearly do.
struct Touching<'a> {
    /// Which of the bodies that are awake; one of the two, at least.
    awake: [Option<usize>; 2],
    any: usize,
    colliders: [ColliderHandle; 2],
    bodies: [RigidBodyHandle; 2],
    manifold: &'a ContactManifold,
}

impl World {
    /// Lets one substep pass for all bodies that are rigid.
    pub(super) fn advance_rigid(&mut self) {
        self.start_driven();
        self.find_contacts();
        self.wake_touched();
        let mut awake = std::mem::take(&mut self.workspace.awake);
        awake.clear();
        awake.extend(self.moving().filter(|body| {
            let body = &self.bodies[**body];
            body.is_enabled() && !body.is_sleeping()
        }));
        // What has passed the substep is not solved.
        awake.retain(|body| !self.passed.iter().any(|passed| passed.body == *body));
        let free = awake.len();
        let hinged = self.hinges.iter().filter(|hinge| hinge.passed.is_none());
        let hinged = hinged.map(|hinge| hinge.body);
        awake.extend(hinged.filter(|body| self.bodies[*body].is_enabled()));
        self.solve(&awake);
        self.finish_driven();
        self.finish_passed();
        awake.truncate(free);
        awake.extend(self.passed.iter().map(|passed| passed.body));
        self.let_sleep(&awake);
        self.bodies.propagate_modified_body_positions_to_colliders(&mut self.colliders);
        self.workspace.awake = awake;
    }

    /// Gives driven bodies the velocities that bring them to where they are to be.
    fn start_driven(&mut self) {
        for (handle, next) in &self.driven {
            let body = &self.bodies[*handle];
            let velocity = next.map_or([Vector::ZERO; 2], |next| {
                let turn = next.rotation * body.position().rotation.inverse();
                let way = next.translation - body.position().translation;
                [way / DT, frames::rotation_vector(turn) / DT]
            });
            if velocity != [body.linvel(), body.angvel()] {
                let body = &mut self.bodies[*handle];
                body.set_linvel(velocity[0], false);
                body.set_angvel(velocity[1], false);
            }
        }
    }

    fn finish_driven(&mut self) {
        for (handle, next) in &mut self.driven {
            if let Some(next) = next.take() {
                self.bodies[*handle].set_position(next, false);
            }
        }
    }

    /// Finds contacts, up to as far ahead as any point of a body moves in the substep.
    fn find_contacts(&mut self) {
        let fastest = self.free.iter().map(|body| self.speed(*body)).fold(0.0, f32::max);
        self.workspace.collisions.step(
            ((PREDICTION * SCALE) as f32).max(fastest * DT),
            &mut self.islands,
            &mut self.broad_phase,
            &mut self.narrow_phase,
            &mut self.bodies,
            &mut self.colliders,
            &(),
            &(),
        );
    }

    /// No point of a body is faster.
    fn speed(&self, body: RigidBodyHandle) -> f32 {
        let body = &self.bodies[body];
        if !body.is_moving() {
            return 0.0;
        }
        let extents = body.colliders().iter().map(|part| {
            let part = &self.colliders[*part];
            let sphere = part.shape().compute_bounding_sphere(part.position());
            (sphere.center() - body.center_of_mass()).length() + sphere.radius()
        });
        body.linvel().length() + body.angvel().length() * extents.fold(0.0, f32::max)
    }

    /// Solves and moves all bodies that are `awake`, and takes note of their contacts.
    fn solve(&mut self, awake: &[RigidBodyHandle]) {
        let mut constraints = std::mem::take(&mut self.workspace.constraints);
        let mut impulses = std::mem::take(&mut self.workspace.impulses);
        let mut solved = std::mem::take(&mut self.workspace.solved);
        let mut attached = vec![];
        impulses.clear();
        solved.clear();
        let touching = self.touching(awake);
        let islands = islands(awake.len(), &touching);
        for island in (0..awake.len()).filter(|index| islands[*index] == *index) {
            constraints.clear();
            let members = || (0..awake.len()).filter(|index| islands[*index] == island);
            for index in members() {
                let number = constraints.add_body(self.solver_body(awake[index]));
                self.add_joints(awake[index], number, &mut constraints);
            }
            let number = |index: usize| members().position(|member| member == index);
            let first = impulses.len();
            for contact in touching.iter().filter(|contact| islands[contact.any] == island) {
                self.add_contact(contact, number, &mut constraints, &mut impulses);
            }
            let rests = members().all(|index| self.is_slow_object(awake[index]))
                && !impulses[first..].iter().any(|contact| self.is_by_instrument(contact));
            constraints.solve(DT, if rests { &Solver::RESTING } else { &self.solver });
            for (contact, point) in impulses[first..].iter_mut().zip(constraints.point_impulses()) {
                (contact.impulse, contact.last) = (point.total, point.last);
                contact.last_friction = point.friction;
            }
            let mut locks = constraints.lock_impulses();
            for attachment in members().flat_map(|index| self.attachments_of(awake[index])) {
                let impulses =
                    std::array::from_fn(|_| locks.next().expect("six for each attachment"));
                attached.push((attachment.id, impulses));
            }
            let bodies = members().zip(constraints.bodies());
            solved.extend(bodies.map(|(index, body)| (awake[index], *body)));
        }
        drop(touching);
        for (id, impulses) in attached {
            for attachment in self.attachments.iter_mut().filter(|attachment| attachment.id == id) {
                attachment.impulses = impulses;
            }
        }
        for (handle, body) in &solved {
            self.move_body(*handle, body);
        }
        // What sleeps presses as it did when it fell asleep.
        let is_asleep =
            |contact: &&ContactImpulse| !contact.bodies.iter().any(|body| awake.contains(body));
        impulses.extend(self.impulses.iter().filter(is_asleep));
        self.workspace.impulses = std::mem::replace(&mut self.impulses, impulses);
        self.workspace.constraints = constraints;
        self.workspace.solved = solved;
    }

    /// Whether a body is a free object whose impact would ask for no more than [`Solver::RESTING`].
    fn is_slow_object(&self, body: RigidBodyHandle) -> bool {
        let speed = f64::from(self.bodies[body].linvel().length());
        speed < RESTING_SPEED * SCALE && self.free.contains(&body)
    }

    /// Whether one of both bodies is driven, or hangs on one that is.
    fn is_by_instrument(&self, contact: &ContactImpulse) -> bool {
        contact.bodies.iter().any(|body| {
            self.bodies[*body].is_kinematic() || self.hinges.iter().any(|hinge| hinge.body == *body)
        })
    }

    /// The parts that touch and of which rows move at least one.
    fn touching(&self, awake: &[RigidBodyHandle]) -> Vec<Touching<'_>> {
        let mut touching = vec![];
        for pair in self.narrow_phase.contact_pairs() {
            let colliders = [pair.collider1, pair.collider2];
            let bodies = colliders.map(|part| {
                self.colliders[part].parent().expect("every collider belongs to a body")
            });
            let awake = bodies.map(|body| awake.iter().position(|one| *one == body));
            let Some(any) = awake[0].or(awake[1]) else { continue };
            if self.are_joined(bodies) {
                continue;
            }
            for manifold in pair.manifolds() {
                if !manifold.data.solver_contacts.is_empty() {
                    touching.push(Touching { awake, any, colliders, bodies, manifold });
                }
            }
        }
        touching
    }

    /// Whether a joint bears one of two bodies on the other: then they do not touch.
    fn are_joined(&self, bodies: [RigidBodyHandle; 2]) -> bool {
        let [one, other] = bodies;
        let joined = |pair| pair == [one, other] || pair == [other, one];
        self.hinges.iter().any(|hinge| joined([hinge.carrier, hinge.body]))
            || self.springs.iter().any(|spring| joined([spring.base, spring.body]))
            || self.attachments.iter().any(|attachment| joined(attachment.id.bodies()))
    }

    /// What rows can do to a body.
    fn solver_body(&self, handle: RigidBodyHandle) -> SolverBody {
        let body = &self.bodies[handle];
        if let Some(hinge) = self.hinges.iter().find(|hinge| hinge.body == handle) {
            return hinge.solver_body(body);
        }
        let properties = body.mass_properties();
        let (mass, inertia) =
            (properties.effective_inv_mass, properties.effective_world_inv_inertia);
        let weight = gravity() * body.gravity_scale();
        SolverBody {
            velocity: Spatial::new(body.linvel(), body.angvel_with_gyroscopic_forces(DT)),
            acceleration: Spatial::new(
                weight + mass * body.user_force(),
                inertia * body.user_torque(),
            ),
            inverse_mass: mass,
            inverse_inertia: inertia,
            displacement: Spatial::default(),
            is_pushed: false,
        }
    }

    fn add_joints(&self, body: RigidBodyHandle, number: usize, constraints: &mut Constraints) {
        for hinge in self.hinges.iter().filter(|hinge| hinge.body == body) {
            self.add_hinge(hinge, number, constraints);
        }
        for spring in self.springs.iter().filter(|spring| spring.body == body) {
            self.add_spring(spring, number, constraints);
        }
        for attachment in self.attachments_of(body) {
            self.add_attachment(attachment, number, constraints);
        }
    }

    pub(super) fn attachments_of(
        &self,
        object: RigidBodyHandle,
    ) -> impl Iterator<Item = &Attachment> {
        self.attachments.iter().filter(move |attachment| attachment.id.bodies()[1] == object)
    }

    /// Adds the rows of a contact, if it has any, and a note of each of its points.
    fn add_contact(
        &self,
        contact: &Touching<'_>,
        number: impl Fn(usize) -> Option<usize>,
        constraints: &mut Constraints,
        impulses: &mut Vec<ContactImpulse>,
    ) {
        let Touching { awake, colliders, bodies, manifold, .. } = contact;
        let normal = manifold.data.normal;
        let sides: [ContactSide; 2] = std::array::from_fn(|side| {
            let body = &self.bodies[bodies[side]];
            ContactSide {
                body: awake[side].and_then(&number),
                centre: body.center_of_mass(),
                velocity: Spatial::new(body.linvel(), body.angvel()),
            }
        });
        let poses = colliders.map(|part| self.colliders[part].position());
        let mut found = points::distinct(manifold, poses);
        found.retain(|point| {
            let [one, other] = bodies.map(|body| self.bodies[body].velocity_at_point(point.middle));
            let approach = (one - other).dot(normal).max(0.0);
            point.distance <= (points::NEAR * SCALE) as f32 + approach * DT
        });
        let mut coefficient = manifold.data.friction;
        if !bodies.iter().any(|body| self.free.contains(body)) {
            let least = (points::MOVABLE / (SCALE * SCALE * SCALE)) as f32;
            found.retain(|point| constraints.mobility(&sides, point.middle, normal) >= least);
            // Otherwise friction would jam the finger, and the impulses would have no limit.
            if found
                .iter()
                .any(|point| constraints.is_self_locking(&sides, point.middle, normal, coefficient))
            {
                coefficient = 0.0;
            }
        }
        if found.is_empty() {
            return;
        }
        let mut friction = Friction::default();
        let mut rows: ArrayVec<ContactPoint, 4> = ArrayVec::new();
        for point in &found {
            let Point { local, middle, distance } = *point;
            let before = self.impulse_at(*colliders, local);
            if let Some(before) = before {
                let share = 1.0 / found.len() as f32;
                friction.tangent += before.last_friction.tangent * share;
                friction.twist += before.last_friction.twist * share;
            }
            let impulse = before.map_or(0.0, |before| before.last);
            rows.push(ContactPoint { point: middle, distance, impulse });
            impulses.push(ContactImpulse {
                colliders: *colliders,
                bodies: *bodies,
                local,
                point: middle,
                normal,
                impulse: 0.0,
                friction: coefficient,
                last: 0.0,
                last_friction: Friction::default(),
            });
        }
        constraints.add_manifold(sides, normal, coefficient, &rows, &friction);
    }

    /// What was borne at a point of the first of two colliders, or next to it, in the last substep.
    fn impulse_at(&self, colliders: [ColliderHandle; 2], local: Vector) -> Option<&ContactImpulse> {
        let distance = |contact: &ContactImpulse| contact.local.distance_squared(local);
        let contacts = self.impulses.iter().filter(|contact| contact.colliders == colliders);
        let nearest = contacts.min_by(|one, other| distance(one).total_cmp(&distance(other)));
        let reach = (SAME_POINT * SCALE) as f32;
        nearest.filter(|contact| distance(contact) < reach * reach)
    }

    /// Moves a body by what was solved.
    fn move_body(&mut self, handle: RigidBodyHandle, solved: &SolverBody) {
        let body = &mut self.bodies[handle];
        let [mut way, turn] = [solved.displacement.linear(), solved.displacement.angular()];
        if !solved.is_pushed {
            // It falls by ½·g·t²; iterations make of it as much more as they are coarse.
            way = 0.5 * DT * (body.linvel() + solved.velocity.linear());
        }
        body.set_linvel(solved.velocity.linear(), false);
        body.set_angvel(solved.velocity.angular(), false);
        let centre = body.center_of_mass() + way;
        let mut pose = *body.position();
        if turn != Vector::ZERO {
            pose.rotation = (Rotation::from_scaled_axis(turn) * pose.rotation).normalize();
        }
        let local = body.mass_properties().local_mprops.local_com;
        pose.translation = centre - pose.rotation.mul_vec3(local);
        body.set_position(pose, false);
    }
}

/// For each body the first one of its island: of those that touch each other, directly or by others.
fn islands(bodies: usize, touching: &[Touching<'_>]) -> Vec<usize> {
    let mut islands: Vec<usize> = (0..bodies).collect();
    for contact in touching {
        let [Some(one), Some(other)] = contact.awake else { continue };
        let [one, other] = [islands[one], islands[other]];
        for island in &mut islands {
            if *island == one.max(other) {
                *island = one.min(other);
            }
        }
    }
    islands
}
