//! What is solved: bodies, and the rows of joints and contacts between them. All in engine units.

use rapier3d::math::Vector;
use rapier3d::parry::utils::SdpMatrix3;

use super::super::{CONTACT_DAMPING, RECOVERY_SPEED, Solver};
use super::algebra::{Spatial, inverse};
use crate::sim::frames::SCALE;

/// A body that rows move, in engine units.
#[derive(Debug, Clone, Copy)]
pub(in crate::sim::world) struct SolverBody {
    /// Of the centre of mass: at the beginning of the substep, then at its end.
    pub velocity: Spatial,
    /// What forces give.
    pub acceleration: Spatial,
    /// 1/mass along each axis.
    pub inverse_mass: Vector,
    /// Inverse of the inertia, world frame.
    pub inverse_inertia: SdpMatrix3<f32>,
    /// How far it moves in the substep: the way of its centre of mass, and a rotation vector.
    pub displacement: Spatial,
    /// Whether any row pushed it.
    pub is_pushed: bool,
}

/// One direction in which two bodies move against each other.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    /// The second one may be [`STATIC`].
    pub bodies: [usize; 2],
    pub jacobians: [Spatial; 2],
    /// What a unit impulse adds to the velocities: M⁻¹·Jᵀ.
    pub responses: [Spatial; 2],
    /// The part of the velocity that no impulse changes: that of driven bodies.
    pub drift: f32,
    /// J·M⁻¹·Jᵀ, the velocity that a unit impulse gives, and its inverse.
    pub mobility: f32,
    pub mass: f32,
    /// Of a contact's point: the distance of both surfaces at the beginning, and that from the manifold's middle.
    pub distance: f32,
    pub lever: f32,
    /// Of a contact's point: the share of an overlap that is undone in a unit of time, and how much of an impulse stays.
    pub rate: f32,
    pub softness: f32,
    /// The impulse of this iteration.
    pub impulse: f32,
    /// That of all iterations.
    pub total: f32,
}

/// What a row of a joint does.
#[derive(Debug, Clone, Copy)]
pub(in crate::sim::world) enum Joint {
    /// A spring and damper towards `target`; both per inertia, or not.
    Motor { position: f32, target: f32, stiffness: f32, damping: f32, per_inertia: bool },
    /// Keeps the position within limits.
    Limit { position: f32, limits: [f32; 2] },
    /// Keeps the position at 0; with the impulse to begin with.
    Lock { position: f32, impulse: f32 },
}

impl Joint {
    pub(super) fn is_lock(&self) -> bool {
        matches!(self, Self::Lock { .. })
    }
}

/// A row of a joint, with what follows from it and the length of an iteration.
#[derive(Debug, Clone, Copy)]
pub(super) struct JointRow {
    pub row: usize,
    pub joint: Joint,
    /// Share of an error that is undone in a unit of time.
    pub rate: f32,
    /// The velocity by which a unit impulse gives in.
    pub softness: f32,
    /// 1 / (mobility + softness).
    pub mass: f32,
    /// How far both bodies had moved at the beginning of the iteration.
    pub moved: f32,
}

impl JointRow {
    pub(super) fn prepare(&mut self, dt: f32, mobility: f32) {
        (self.rate, self.softness) = match self.joint {
            Joint::Motor { stiffness, damping, per_inertia, .. } => {
                let softness = 1.0 / (dt * (dt * stiffness + damping));
                let scale = if per_inertia { mobility } else { 1.0 };
                (stiffness / (dt * stiffness + damping), scale * softness)
            }
            Joint::Limit { .. } | Joint::Lock { .. } => (1.0 / dt, 0.0),
        };
        self.mass = inverse(mobility + self.softness);
    }
}

/// One of two bodies that touch.
#[derive(Debug, Clone, Copy)]
pub(in crate::sim::world) struct ContactSide {
    /// Its number, if rows move it.
    pub body: Option<usize>,
    /// The point about which it turns.
    pub centre: Vector,
    /// Its velocity, if no row moves it.
    pub velocity: Spatial,
}

/// A point at which two bodies touch.
#[derive(Debug, Clone, Copy)]
pub(in crate::sim::world) struct ContactPoint {
    /// Where, world frame.
    pub point: Vector,
    /// Distance of both surfaces there.
    pub distance: f32,
    /// The impulse to begin with.
    pub impulse: f32,
}

/// What a point of a contact bore.
#[derive(Debug, Clone, Copy)]
pub(in crate::sim::world) struct PointImpulse {
    /// Along the normal, in all of the substep.
    pub total: f32,
    /// Along the normal, in the last iteration.
    pub last: f32,
    /// That of the manifold, in the last iteration.
    pub friction: Friction,
}

/// The impulses of friction of a manifold in one iteration.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::sim::world) struct Friction {
    /// Across the normal, world frame.
    pub tangent: Vector,
    /// About the normal.
    pub twist: f32,
}

/// The rows of two parts that touch: the points, then perhaps the twist, then both tangents.
#[derive(Debug, Clone, Copy)]
pub(super) struct Manifold {
    pub first: usize,
    pub points: usize,
    pub twist: Option<usize>,
    pub tangent: usize,
    pub axes: [Vector; 2],
    /// Inverse of the mobility of both tangents: of each alone, and mixed.
    pub inverse: [f32; 3],
    pub coefficient: f32,
}

/// The number of what no row moves.
pub(super) const STATIC: usize = usize::MAX;

/// What the rows of one iteration have in common.
pub(super) struct Step {
    pub dt: f32,
    pub inverse_dt: f32,
    /// Natural frequency of contacts, rad/s.
    pub omega: f32,
    /// The least stiffness of contacts, engine units.
    pub stiffness: f32,
}

impl Step {
    pub(super) fn new(dt: f32, solver: &Solver) -> Self {
        let dt = dt / solver.iterations as f32;
        Self {
            dt,
            inverse_dt: 1.0 / dt,
            omega: solver.contact_frequency as f32 * std::f32::consts::TAU,
            stiffness: (solver.least_stiffness * SCALE * SCALE * SCALE) as f32,
        }
    }

    /// The share of an overlap that a contact undoes in a unit of time, and how much of its impulse stays: a spring and
    /// damper of natural frequency ω and damping ratio ζ, integrated implicitly.
    pub(super) fn softness(&self, mobility: f32) -> (f32, f32) {
        let omega = (self.stiffness * mobility).sqrt().max(self.omega);
        let damped = 2.0 * CONTACT_DAMPING + self.dt * omega;
        let stiff = self.dt * omega * damped;
        (omega / damped, stiff / (1.0 + stiff))
    }
}

/// No faster than overlaps are undone.
pub(super) fn recovery(speed: f32) -> f32 {
    let most = (RECOVERY_SPEED * SCALE) as f32;
    speed.clamp(-most, most)
}
