//! What bodies do to each other where they touch: forces and overlaps of the last substep.

use nalgebra::{Point3, Vector3};
use rapier3d::parry::bounding_volume::BoundingVolume;
use rapier3d::parry::query;
use rapier3d::prelude::{ColliderHandle, ContactPair, RigidBodyHandle};

use super::soft::SoftTouch;
use super::substep::ContactImpulse;
use super::{BodyId, PREDICTION, SUBSTEPS_PER_SECOND, World};
use crate::sim::frames::{self, Pose, SCALE};

/// What the rest of the world does to an instrument.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Push {
    /// Sum of the contact forces, N; a squeeze from two sides cancels.
    pub force: Vector3<f64>,
    /// Force at the contact that bears most, N.
    pub strongest: f64,
    /// Where that is; the origin where nothing touches.
    pub point: Point3<f64>,
    /// Deepest overlap of an object that touches; of that with the bodies asked for, where they squeeze
    /// the object from two sides, only what is beyond [`SQUEEZED`] counts.
    pub overlap: Overlap,
    /// Whether the bodies asked for press deeper than [`SQUEEZED`] into what they squeeze; locked jaws, whether
    /// anything is between them.
    pub crushes: bool,
}

/// A place where two bodies pressed on each other in the last substep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// The body that feels the force: the free object of both, where only one is.
    pub on: BodyId,
    /// The body that exerts it.
    pub by: BodyId,
    /// Where, m.
    pub point: Point3<f64>,
    /// The force along the contact's normal, N, world frame; friction is not in it.
    pub force: Vector3<f64>,
}

/// How far jaws may press into what they squeeze, m: a needle gives in by a fifth of a millimetre to 1 N.
const SQUEEZED: f64 = 0.3e-3;

/// Deepest overlap of a body with an obstacle.
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
        crushes: false,
    };

    /// What two bodies feel together.
    #[must_use]
    pub fn with(self, other: Self) -> Self {
        let stronger = if other.strongest > self.strongest { other } else { self };
        Self {
            force: self.force + other.force,
            overlap: self.overlap.or(other.overlap),
            crushes: self.crushes || other.crushes,
            ..stronger
        }
    }
}

impl World {
    /// How hard everything together pressed on a body in the last substep, from whatever side, N.
    pub fn pressure(&self, body: BodyId) -> f64 {
        let newtons = SUBSTEPS_PER_SECOND / f64::powi(SCALE, 4);
        let touches = self.impulses.iter().filter(|touch| touch.bodies.contains(&body.0));
        let rigid = touches.map(|touch| newtons * f64::from(touch.impulse));
        rigid.chain(self.soft_touches_of(body).map(|touch| touch.pressure)).sum()
    }

    /// Whether a soft body pressed on a body in the last substep.
    pub fn touches_soft(&self, body: BodyId) -> bool {
        self.soft_touches_of(body).any(|touch| touch.pressure > 0.0)
    }

    fn soft_touches_of(&self, body: BodyId) -> impl Iterator<Item = &SoftTouch> {
        self.soft_touches.iter().filter(move |touch| touch.body == body.0)
    }

    /// Largest force that any one body, but for those of `own`, exerted on `body` in the last substep, N: along the
    /// normals, summed over where both touch. Friction is not in it.
    pub fn strongest_contact(&self, body: BodyId, own: &[BodyId]) -> f64 {
        let newtons = SUBSTEPS_PER_SECOND / f64::powi(SCALE, 4);
        let other = |touch: &ContactImpulse| match touch.bodies {
            [one, other] if one == body.0 => Some(other),
            [one, other] if other == body.0 => Some(one),
            _ => None,
        };
        let pressing = || self.impulses.iter().filter(|touch| touch.impulse > 0.0);
        let mut strongest: f64 = 0.0;
        for (index, touch) in pressing().enumerate() {
            let Some(by) = other(touch).filter(|by| own.iter().all(|each| each.0 != *by)) else {
                continue;
            };
            // Bodies come in any order: each is summed up where it is first met.
            if pressing().take(index).any(|before| other(before) == Some(by)) {
                continue;
            }
            let sum = pressing().filter(|touch| other(touch) == Some(by)).fold(
                Vector3::zeros(),
                |sum, touch| {
                    let normal =
                        if touch.bodies[0] == body.0 { -touch.normal } else { touch.normal };
                    let normal = Vector3::new(normal.x, normal.y, normal.z).cast::<f64>();
                    sum + normal * f64::from(touch.impulse)
                },
            );
            strongest = strongest.max(newtons * sum.norm());
        }
        self.soft_touches_of(body).map(|touch| touch.pressure).fold(strongest, f64::max)
    }

    /// Where bodies pressed on each other in the last substep, to look at. What sleeps presses as it did
    /// when it fell asleep; what was never moved is not known to press on anything.
    pub fn contacts(&self) -> impl Iterator<Item = Contact> {
        let newtons = SUBSTEPS_PER_SECOND / (SCALE * SCALE * SCALE);
        let pressing = self.impulses.iter().filter(|touch| touch.impulse > 0.0);
        pressing.map(move |touch| {
            let is_free = touch.bodies.map(|owner| self.free.contains(&owner));
            // Normals point from the first to the second.
            let (feels, sign) =
                if is_free[1] && !is_free[0] { (1, newtons) } else { (0, -newtons) };
            Contact {
                on: BodyId(touch.bodies[feels]),
                by: BodyId(touch.bodies[1 - feels]),
                point: frames::from_engine_vector(touch.point).into(),
                force: frames::from_engine_vector(touch.normal) * (sign * f64::from(touch.impulse)),
            }
        })
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

    /// What the rest of the world did in the last substep to bodies of one instrument, taken as one:
    /// what they do to each other does not count.
    pub fn push_on(&self, instrument: &[BodyId]) -> Push {
        // An engine force is SCALE³ (mass) · SCALE (length) of the real one.
        let newtons = SUBSTEPS_PER_SECOND / (SCALE * SCALE * SCALE);
        let mut push = Push::NONE;
        let is_own = |body| instrument.iter().any(|own| own.0 == body);
        let mut met: Vec<RigidBodyHandle> = vec![];
        for touch in self.impulses.iter().filter(|touch| touch.impulse > 0.0) {
            let own = touch.bodies.map(is_own);
            if own[0] == own[1] {
                continue;
            }
            // Normals point from the first to the second.
            let (sign, other) = if own[0] { (-newtons, 1) } else { (newtons, 0) };
            let normal = frames::from_engine_vector(touch.normal);
            let force = normal * (sign * f64::from(touch.impulse));
            push.force += force;
            if force.norm() > push.strongest {
                push.strongest = force.norm();
                push.point = frames::from_engine_vector(touch.point).into();
            }
            let other = touch.bodies[other];
            if !met.contains(&other) {
                met.push(other);
            }
        }
        for touch in instrument.iter().flat_map(|own| self.soft_touches_of(*own)) {
            push.force += touch.force;
            if touch.force.norm() > push.strongest {
                (push.strongest, push.point) = (touch.force.norm(), touch.point);
            }
        }
        for (_, overlap) in self.soft_obstacles.iter().filter(|(body, _)| is_own(*body)) {
            push.overlap = push.overlap.or(*overlap);
        }
        for body in met {
            let (overlap, crushes) = self.overlap_of(body, instrument);
            push.overlap = push.overlap.or(overlap);
            push.crushes |= crushes;
        }
        push
    }

    /// Deepest overlap of a body with static bodies after `motion`. The depth is below 0 where the shapes are apart, and −∞
    /// beyond the distance from which on contacts count.
    pub(crate) fn meets_static(&self, body: BodyId, motion: &Pose) -> Overlap {
        self.meets(body, motion, self.fixed.iter().copied())
    }

    /// The same with driven bodies and bodies on hinges, except `own`: wrists and fingers of other instruments.
    pub(crate) fn meets_instruments(&self, body: BodyId, motion: &Pose, own: &[BodyId]) -> Overlap {
        let driven = self.driven.iter().map(|(driven, _)| *driven);
        let moving = driven.chain(self.hinges.iter().map(|hinge| hinge.body));
        let others = moving.filter(|other| own.iter().all(|each| each.0 != *other));
        self.meets(body, motion, others)
    }

    fn meets(
        &self,
        body: BodyId,
        motion: &Pose,
        others: impl Iterator<Item = RigidBodyHandle> + Clone,
    ) -> Overlap {
        let motion = frames::to_engine(motion);
        let margin = (PREDICTION * SCALE) as f32;
        let mut deepest = Overlap { depth: f64::NEG_INFINITY, ..Overlap::NONE };
        let body = &self.bodies[body.0];
        let obstacles = others.flat_map(|other| self.bodies[other].colliders());
        for part in body.colliders().iter().map(|handle| &self.colliders[*handle]) {
            let body_from_part =
                part.position_wrt_parent().expect("every collider belongs to a body");
            // Colliders of a body that was just placed follow at the next substep.
            let moved = motion * (*body.position() * *body_from_part);
            let region = part.shape().compute_aabb(&moved).loosened(margin);
            for other in obstacles.clone().map(|handle| &self.colliders[*handle]) {
                if !region.intersects(&other.compute_aabb()) {
                    continue;
                }
                let (at, shape) = (other.position(), other.shape());
                let contact = query::contact(&moved, part.shape(), at, shape, margin);
                // Shapes between which the engine knows no contact do not overlap either.
                let Ok(Some(contact)) = contact else { continue };
                let depth = -f64::from(contact.dist) / SCALE;
                if depth > deepest.depth {
                    let point = frames::from_engine_vector(contact.point2).into();
                    let into = frames::from_engine_vector(contact.normal1) * SCALE;
                    deepest = Overlap { depth, point, into };
                }
            }
        }
        deepest
    }

    /// Whether two bodies pressed on each other in the last substep.
    pub fn touch(&self, one: BodyId, other: BodyId) -> bool {
        self.impulses.iter().any(|touch| {
            touch.impulse > 0.0 && touch.bodies.contains(&one.0) && touch.bodies.contains(&other.0)
        })
    }

    /// Deepest overlap of any part of `body`; of that with the bodies of
    /// `instrument`, where these squeeze it, only what is beyond [`SQUEEZED`]. And whether any is.
    fn overlap_of(&self, body: RigidBodyHandle, instrument: &[BodyId]) -> (Overlap, bool) {
        let touching = instrument.iter().filter(|each| self.touch(**each, BodyId(body)));
        let is_squeezed = touching.count() > 1;
        let is_instruments = |part: ColliderHandle| {
            let parent = self.colliders[part].parent();
            instrument.iter().any(|body| Some(body.0) == parent)
        };
        let is_object = self.free.contains(&body);
        let mut deepest = Overlap::NONE;
        let mut is_crushed = false;
        for part in self.bodies[body].colliders() {
            for pair in self.narrow_phase.contact_pairs_with(*part) {
                let first = pair.collider1 == *part;
                let other = if first { pair.collider2 } else { pair.collider1 };
                let by_instrument = is_instruments(other);
                // Furniture and arms are not pressed into what else touches them.
                if !is_object && !by_instrument {
                    continue;
                }
                let allowed = if by_instrument && is_squeezed { SQUEEZED } else { 0.0 };
                // Normals point from the first collider to the second. What moves is the instrument, and
                // the object with it.
                let sign = if first == by_instrument { -1.0 } else { 1.0 };
                let at = self.colliders[*part].position();
                for manifold in pair.manifolds() {
                    for contact in &manifold.points {
                        let depth = -f64::from(contact.dist) / SCALE - allowed;
                        is_crushed |= by_instrument && is_squeezed && depth > 0.0;
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
        (deepest, is_crushed)
    }
}
