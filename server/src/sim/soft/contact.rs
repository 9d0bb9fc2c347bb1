//! Contacts of a soft body with rigid ones: found in every substep, solved as impulses.
//!
//! A contact is a sample of the skin near a rigid part. With the velocity u of the sample against the part, along
//! the normal n out of the part and along two tangents:
//!
//! | | law | impulse |
//! |---|---|---|
//! | open by g | u_n ≥ −g / Δt | λ_n ≥ 0 |
//! | overlapping by d | u_n ≥ min([`UNDONE`] (d − [`SLOP`]) / Δt, [`RECOVERY`]) | λ_n ≥ 0 |
//! | friction (Coulomb) | u_t = 0, or sliding | \|λ_t\| ≤ μ λ_n |
//!
//! The effective mass of a row along d is 1 / (Σ w²/m + 1/M + (r × d)·I⁻¹(r × d)). w are the weights of the corners of the
//! sample's element and m their masses; M and I are mass and inertia of the rigid body, and r points from its centre to
//! the sample. Contacts begin with the impulses of the substep before: without that friction creeps. Those with what moves
//! are solved one after the other (projected Gauss–Seidel), [`SWEEPS`] times; those with what stands still once before,
//! since they hardly act on each other.

use std::cell::Cell;

use nalgebra::Vector3;
use wide::f32x4;

use super::candidates::{Candidate, Candidates};
use super::lattice::Lattice;
use super::material::Friction;
use super::proxy::Proxy;
use super::skin::Skin;

/// How often all contacts with what moves are solved in a substep.
const SWEEPS: usize = 8;

/// Distance from which on contacts are looked at in a substep, m.
const REACH: f32 = 0.3e-3;

/// Part of an overlap that is undone in a substep.
const UNDONE: f32 = 0.02;

/// What moves by less for an impulse counts as immovable, 1/kg: a node that is held, against a finger that is pushed along
/// itself. Nodes have some 10,000 1/kg, fingers some 50 across.
const LEAST_MOBILITY: f32 = 1.0;

/// Greatest speed with which overlaps are undone, m/s.
const RECOVERY: f32 = 0.02;

/// Overlap that is left alone, m.
const SLOP: f32 = 0.01e-3;

/// An impulse of the substep before, N·s, axes of the world.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Warm {
    key: u64,
    impulse: Vector3<f32>,
}

/// The contacts of a body.
#[derive(Debug, Default)]
pub(super) struct Contacts {
    /// What the last substep left, in the order of keys, and how long that was, s: all that is state.
    warm: Vec<Warm>,
    warm_seconds: f32,
    work: Work,
    /// Whether what may move was touched in the last substep.
    pub touches_moving: bool,
}

impl Clone for Contacts {
    fn clone(&self) -> Self {
        Self {
            warm: self.warm.clone(),
            warm_seconds: self.warm_seconds,
            touches_moving: self.touches_moving,
            ..Self::default()
        }
    }
}

/// Memory that holds no state: between steps it is the thread's.
#[derive(Debug, Default)]
struct Work {
    candidates: Candidates,
    fixed: Vec<Contact>,
    moving: Vec<Contact>,
}

thread_local! {
    static WORK: Cell<Work> = Cell::default();
}

impl Contacts {
    /// Forgets what was touched.
    pub(super) fn clear(&mut self) {
        self.warm.clear();
        self.touches_moving = false;
    }

    /// Begins a step: finds the samples that may touch a part before `reach` (m) is covered.
    pub(super) fn begin(
        &mut self,
        lattice: &Lattice,
        skin: &Skin,
        friction: &Friction,
        proxies: &[Proxy],
        reach: f32,
    ) {
        self.work = WORK.take();
        let candidates = &mut self.work.candidates;
        candidates.find(lattice, skin, friction, proxies, reach);
        for kind in [&mut candidates.fixed, &mut candidates.moving] {
            let mut warm = self.warm.iter().peekable();
            for candidate in kind {
                while warm.next_if(|each| each.key < candidate.key).is_some() {}
                if let Some(before) = warm.next_if(|each| each.key == candidate.key) {
                    candidate.impulse = before.impulse;
                }
            }
        }
    }

    /// Ends a step of `seconds`: keeps what the next begins with, and tells moving bodies the pressure on them.
    pub(super) fn finish(&mut self, proxies: &mut [Proxy], seconds: f64) {
        self.warm.clear();
        let Candidates { fixed, moving, .. } = &self.work.candidates;
        note_pressures(moving, proxies, seconds);
        for Candidate { key, impulse, .. } in fixed.iter().chain(moving) {
            if *impulse != Vector3::zeros() {
                self.warm.push(Warm { key: *key, impulse: *impulse });
            }
        }
        self.warm.sort_unstable_by_key(|warm| warm.key);
        self.touches_moving = moving.iter().any(|each| each.impulse != Vector3::zeros());
        WORK.set(std::mem::take(&mut self.work));
    }

    /// Whether anything may be touched in this step.
    pub(super) fn are_possible(&self) -> bool {
        !self.work.candidates.are_none()
    }

    /// Changes velocities of the body and of rigid ones by what contacts do in a substep.
    pub(super) fn solve(&mut self, lattice: &mut Lattice, proxies: &mut [Proxy], seconds: f32) {
        let Work { candidates, fixed, moving } = &mut self.work;
        let Candidates { fixed: beside_fixed, moving: beside_moving, nodes, .. } = candidates;
        nodes.load(lattice);
        let (places, velocities) = (&nodes.places, &mut nodes.velocities);
        detect::<true>(beside_fixed, fixed, places, proxies, seconds);
        detect::<false>(beside_moving, moving, places, proxies, seconds);
        let scale = if self.warm_seconds > 0.0 { seconds / self.warm_seconds } else { 1.0 };
        self.warm_seconds = seconds;
        for contact in &mut *fixed {
            contact.start::<true>(beside_fixed, scale, velocities, proxies);
        }
        for contact in &mut *moving {
            contact.start::<false>(beside_moving, scale, velocities, proxies);
        }
        for contact in &mut *fixed {
            contact.solve::<true>(beside_fixed, velocities, proxies);
        }
        for _ in 0..SWEEPS {
            for contact in &mut *moving {
                contact.solve::<false>(beside_moving, velocities, proxies);
            }
        }
        nodes.store(lattice);
        report(beside_fixed, fixed, proxies);
        report(beside_moving, moving, proxies);
    }

    /// The impulses that are kept, as bits.
    pub(super) fn bits(&self) -> impl Iterator<Item = u32> {
        let impulses = self.warm.iter().flat_map(|warm| {
            let [x, y, z] = <[f32; 3]>::from(warm.impulse).map(f32::to_bits);
            [(warm.key >> 32) as u32, warm.key as u32, x, y, z]
        });
        std::iter::once(self.warm_seconds.to_bits()).chain(impulses)
    }

    /// Memory that its state takes, bytes.
    pub(super) fn memory_bytes(&self) -> u64 {
        (self.warm.capacity() * size_of::<Warm>()) as u64
    }

    /// How deep samples are in rigid parts, m: that of the deepest.
    pub(super) fn deepest(&mut self, lattice: &Lattice, proxies: &[Proxy]) -> f64 {
        let Candidates { fixed, moving, nodes, .. } = &mut self.work.candidates;
        nodes.load(lattice);
        let depths = fixed.iter().chain(moving.iter()).filter_map(|candidate| {
            let part = &proxies[candidate.proxy as usize].parts[candidate.part as usize];
            let point = candidate.mean(&nodes.places);
            part.gap(&point, 0.0).map(|gap| f64::from(-gap.distance))
        });
        depths.fold(0.0, f64::max)
    }
}

/// A contact of this substep.
#[derive(Debug, Clone)]
struct Contact {
    candidate: u32,
    /// Least velocity along the normal.
    least: f32,
    arm: Vector3<f32>,
    /// Normal and tangents.
    axes: [Vector3<f32>; 3],
    effective_mass: [f32; 3],
    impulse: [f32; 3],
}

/// Finds the contacts of this substep. `FIXED` says that what candidates are beside stands still.
fn detect<const FIXED: bool>(
    candidates: &mut [Candidate],
    contacts: &mut Vec<Contact>,
    places: &[f32x4],
    proxies: &[Proxy],
    seconds: f32,
) {
    contacts.clear();
    for (number, candidate) in (0_u32..).zip(candidates) {
        let proxy = &proxies[candidate.proxy as usize];
        let part = &proxy.parts[candidate.part as usize];
        let point = candidate.mean(places);
        let Some(gap) = part.gap(&point, REACH) else {
            candidate.impulse = Vector3::zeros();
            continue;
        };
        let least = if gap.distance > 0.0 {
            -gap.distance / seconds
        } else {
            (UNDONE * (-gap.distance - SLOP).max(0.0) / seconds).min(RECOVERY)
        };
        let arm = point - proxy.centre;
        let axes = axes(&gap.normal);
        let mass = |mobility: f32| if mobility > LEAST_MOBILITY { 1.0 / mobility } else { 0.0 };
        let effective_mass = if FIXED {
            [mass(candidate.mobility); 3]
        } else {
            axes.map(|axis| {
                let turn = arm.cross(&axis);
                let turning = turn.dot(&(proxy.inverse_inertia * turn));
                mass(candidate.mobility + proxy.inverse_mass + turning)
            })
        };
        let impulse = [0.0; 3];
        contacts.push(Contact { candidate: number, least, arm, axes, effective_mass, impulse });
    }
}

/// Takes note of what was done to rigid bodies, and keeps it for the next substep.
fn report(candidates: &mut [Candidate], contacts: &[Contact], proxies: &mut [Proxy]) {
    for contact in contacts {
        let candidate = &mut candidates[contact.candidate as usize];
        let impulse = contact.vector(contact.impulse);
        candidate.impulse = impulse;
        if contact.impulse[0] == 0.0 {
            continue;
        }
        let proxy = &mut proxies[candidate.proxy as usize];
        let (normal, place) = (f64::from(contact.impulse[0]), contact.arm + proxy.centre);
        proxy.load.impulse -= impulse.cast::<f64>();
        proxy.load.angular -= contact.arm.cross(&impulse).cast::<f64>();
        proxy.load.pressing += normal;
        proxy.load.moment += place.cast::<f64>() * normal;
        candidate.pressed = true;
    }
}

/// Takes note of the mean pressure on each body in a step of `seconds`, over the samples that were pressed. Neighbouring
/// samples share a force by chance, so what each bears means nothing.
fn note_pressures(candidates: &[Candidate], proxies: &mut [Proxy], seconds: f64) {
    for skin in candidates.chunk_by(|one, other| one.proxy == other.proxy) {
        let pressed = skin.iter().filter(|each| each.pressed);
        let area: f64 = pressed.map(|each| f64::from(each.area)).sum();
        if area > 0.0 {
            let load = &mut proxies[skin[0].proxy as usize].load;
            load.pressure = load.pressing / (area * seconds);
        }
    }
}

impl Contact {
    /// Tangential impulses that friction can bear.
    #[inline]
    fn held(&self, friction: f32, along: [f32; 2]) -> [f32; 2] {
        let most = friction * self.impulse[0];
        let square = along[0] * along[0] + along[1] * along[1];
        if square > most * most {
            let part = most / square.sqrt();
            along.map(|impulse| impulse * part)
        } else {
            along
        }
    }

    #[inline]
    fn vector(&self, along: [f32; 3]) -> Vector3<f32> {
        self.axes[0] * along[0] + self.axes[1] * along[1] + self.axes[2] * along[2]
    }

    /// Begins with the impulse of the substep before, as a force.
    #[inline]
    fn start<const FIXED: bool>(
        &mut self,
        candidates: &[Candidate],
        scale: f32,
        velocities: &mut [f32x4],
        proxies: &mut [Proxy],
    ) {
        let candidate = &candidates[self.candidate as usize];
        if candidate.impulse == Vector3::zeros() {
            return;
        }
        let before = candidate.impulse * scale;
        let [normal, first, second] = self.axes.map(|axis| axis.dot(&before));
        self.impulse[0] = normal.max(0.0);
        let along = self.held(candidate.friction, [first, second]);
        self.impulse = [self.impulse[0], along[0], along[1]];
        let impulse = self.vector(self.impulse);
        self.apply::<FIXED>(candidate, &impulse, velocities, proxies);
    }

    #[inline]
    fn solve<const FIXED: bool>(
        &mut self,
        candidates: &[Candidate],
        velocities: &mut [f32x4],
        proxies: &mut [Proxy],
    ) {
        let candidate = &candidates[self.candidate as usize];
        let mut velocity = candidate.mean(velocities);
        if !FIXED {
            let proxy = &proxies[candidate.proxy as usize];
            velocity -= proxy.velocity + proxy.rate.cross(&self.arm);
        }
        let [normal, first, second] = self.axes.map(|axis| axis.dot(&velocity));
        let before = self.impulse;
        let [m, m_first, m_second] = self.effective_mass;
        self.impulse[0] = (before[0] + (self.least - normal) * m).max(0.0);
        let along = [before[1] - first * m_first, before[2] - second * m_second];
        let along = self.held(candidate.friction, along);
        self.impulse = [self.impulse[0], along[0], along[1]];
        let change = [0, 1, 2].map(|axis: usize| self.impulse[axis] - before[axis]);
        if change != [0.0; 3] {
            self.apply::<FIXED>(candidate, &self.vector(change), velocities, proxies);
        }
    }

    #[inline]
    fn apply<const FIXED: bool>(
        &self,
        candidate: &Candidate,
        impulse: &Vector3<f32>,
        velocities: &mut [f32x4],
        proxies: &mut [Proxy],
    ) {
        candidate.push(impulse, velocities);
        if !FIXED {
            let proxy = &mut proxies[candidate.proxy as usize];
            proxy.velocity -= impulse * proxy.inverse_mass;
            proxy.rate -= proxy.inverse_inertia * self.arm.cross(impulse);
        }
    }
}

/// A normal and two tangents.
#[inline]
fn axes(normal: &Vector3<f32>) -> [Vector3<f32>; 3] {
    let seed = if normal.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let tangent = normal.cross(&seed);
    let tangent = tangent / tangent.norm();
    [*normal, tangent, normal.cross(&tangent)]
}
