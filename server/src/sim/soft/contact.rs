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
//! the sample. Contacts are solved one after the other (projected Gauss–Seidel), [`SWEEPS`] times. They begin with the
//! impulses of the substep before: without that friction creeps.

use std::cell::Cell;

use nalgebra::Vector3;
use wide::f32x4;

use super::lattice::{CORNERS, Lattice};
use super::material::Friction;
use super::proxy::{PartProxy, Proxy};
use super::skin::{MaterialPoint, Samples, Skin};

/// How often all contacts with what moves are solved in a substep.
const SWEEPS: usize = 8;

/// Those with what stands still are solved in each of so many sweeps: they hardly act on each other.
const STATIC_EVERY: usize = 4;

/// Distance from which on contacts are looked at in a substep, m.
const REACH: f32 = 0.3e-3;

/// Part of an overlap that is undone in a substep.
const UNDONE: f32 = 0.02;

/// Greatest speed with which overlaps are undone, m/s.
const RECOVERY: f32 = 0.02;

/// Overlap that is left alone, m.
const SLOP: f32 = 0.01e-3;

/// Weight of a corner that counts: more than rounding. Otherwise a sample between nodes that are held would be as heavy
/// as the weight of its free ones is small.
const LEAST_WEIGHT: f32 = 1e-4;

/// A sample that may touch a part in this step.
#[derive(Debug, Clone)]
struct Candidate {
    key: u64,
    proxy: u16,
    part: u16,
    friction: f32,
    /// The nodes that count, as slots of the solver, and how much.
    count: u8,
    slots: [u16; CORNERS],
    weights: [f32; CORNERS],
}

impl Candidate {
    /// Takes the corners of a sample's element that count.
    fn set_corners(&mut self, lattice: &Lattice, place: &MaterialPoint, solver: &mut Solver) {
        let offsets = lattice.form.grid.corner_offsets();
        for (weight, offset) in place.weights().into_iter().zip(offsets) {
            if weight.abs() > LEAST_WEIGHT {
                self.slots[self.count as usize] = solver.slot(place.element as usize + offset);
                self.weights[self.count as usize] = weight;
                self.count += 1;
            }
        }
    }

    /// Where the sample is, from the lattice's origin on, m; `nodes` has the node of each slot.
    fn point(&self, lattice: &Lattice, nodes: &[u32]) -> Vector3<f32> {
        let mut point = Vector3::zeros();
        for (slot, weight) in self.slots.iter().zip(&self.weights).take(self.count as usize) {
            let node = nodes[*slot as usize] as usize;
            for axis in 0..3 {
                point[axis] += weight * lattice.x[axis][node];
            }
        }
        point
    }
}

/// A contact of this substep.
#[derive(Debug, Clone)]
struct Contact {
    candidate: u32,
    proxy: u16,
    count: u8,
    is_static: bool,
    slots: [u16; CORNERS],
    weights: [f32; CORNERS],
    /// Weight over mass.
    mobilities: [f32; CORNERS],
    friction: f32,
    /// Least velocity along the normal.
    least: f32,
    arm: Vector3<f32>,
    /// Normal and tangents.
    axes: [Vector3<f32>; 3],
    effective_mass: [f32; 3],
    impulse: [f32; 3],
}

/// An impulse of the substep before, N·s, axes of the world.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Warm {
    key: u64,
    impulse: Vector3<f32>,
}

/// The contacts of a body.
#[derive(Debug, Default)]
pub(super) struct Contacts {
    /// What the last substep left, and how long that was, s: all that is state.
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
    candidates: Vec<Candidate>,
    contacts: Vec<Contact>,
    solver: Solver,
}

thread_local! {
    static WORK: Cell<Work> = Cell::default();
}

/// The nodes near contacts.
#[derive(Debug, Default)]
struct Solver {
    /// The slot of each node, or [`NONE`].
    slot_of: Vec<u16>,
    nodes: Vec<u32>,
    velocities: Vec<f32x4>,
}

const NONE: u16 = u16::MAX;

/// Added to the number of a sample between those that meet a static body.
const FINE: usize = 1 << 23;

impl Solver {
    fn slot(&mut self, node: usize) -> u16 {
        let slot = &mut self.slot_of[node];
        if *slot == NONE {
            *slot = self.nodes.len() as u16;
            self.nodes.push(node as u32);
        }
        *slot
    }

    fn clear(&mut self, nodes: usize) {
        if self.slot_of.len() == nodes {
            for node in self.nodes.drain(..) {
                self.slot_of[node as usize] = NONE;
            }
        } else {
            self.nodes.clear();
            self.slot_of = vec![NONE; nodes];
        }
    }
}

impl Contacts {
    /// Forgets what was touched.
    pub(super) fn clear(&mut self) {
        self.warm.clear();
        self.touches_moving = false;
    }

    /// Finds the samples that may touch a part before `reach` (m) is covered.
    pub(super) fn find_candidates(
        &mut self,
        lattice: &Lattice,
        skin: &Skin,
        friction: &Friction,
        proxies: &[Proxy],
        reach: f32,
    ) {
        self.work = WORK.take();
        let Work { candidates, solver, .. } = &mut self.work;
        candidates.clear();
        solver.clear(lattice.form.mass.len());
        for (number, proxy) in proxies.iter().enumerate() {
            let friction = if proxy.is_profiled { friction.profiled } else { friction.smooth };
            for (part_number, part) in proxy.parts.iter().enumerate() {
                let key = u64::from(proxy.key()) << 32 | (part_number as u64) << 24;
                let mut add = |index: usize, place: &MaterialPoint| {
                    if part.gap(&lattice.local(place).into(), reach).is_none() {
                        return;
                    }
                    let mut candidate = Candidate {
                        key: key | index as u64,
                        proxy: number as u16,
                        part: part_number as u16,
                        friction: friction as f32,
                        count: 0,
                        slots: [0; CORNERS],
                        weights: [0.0; CORNERS],
                    };
                    candidate.set_corners(lattice, place, solver);
                    candidates.push(candidate);
                };
                let near = Near::new(part, reach);
                if proxy.is_static {
                    near.samples(lattice, &skin.coarse, |_| true, &mut add);
                    let is_sharp = |element: &Box3| part.is_sharp_near(element, skin.spacing);
                    let mut add_fine = |index, place: &_| add(index | FINE, place);
                    near.samples(lattice, &skin.fine, is_sharp, &mut add_fine);
                } else {
                    near.samples(lattice, &skin.fine, |_| true, &mut add);
                }
            }
        }
    }

    /// Ends a step.
    pub(super) fn finish(&mut self) {
        if !self.are_possible() {
            self.clear();
        }
        WORK.set(std::mem::take(&mut self.work));
    }

    /// Whether anything may be touched in this step.
    pub(super) fn are_possible(&self) -> bool {
        !self.work.candidates.is_empty()
    }

    /// Changes velocities of the body and of rigid ones by what contacts do in a substep.
    pub(super) fn solve(&mut self, lattice: &mut Lattice, proxies: &mut [Proxy], seconds: f32) {
        self.detect(lattice, proxies, seconds);
        let nodes = std::mem::take(&mut self.work.solver.nodes);
        let velocities = &mut self.work.solver.velocities;
        velocities.clear();
        velocities.extend(nodes.iter().map(|node| {
            let [x, y, z] = [0, 1, 2].map(|axis: usize| lattice.v[axis][*node as usize]);
            f32x4::from([x, y, z, 0.0])
        }));
        self.start_warm(proxies, seconds);
        let velocities = &mut self.work.solver.velocities;
        for sweep in 0..SWEEPS {
            for contact in &mut self.work.contacts {
                if !contact.is_static || sweep % STATIC_EVERY == 0 {
                    contact.solve(velocities, &mut proxies[contact.proxy as usize]);
                }
            }
        }
        for (node, velocity) in nodes.iter().zip(&*velocities) {
            for (axis, velocity) in velocity.to_array().into_iter().take(3).enumerate() {
                lattice.v[axis][*node as usize] = velocity;
            }
        }
        self.work.solver.nodes = nodes;
        self.report(proxies);
        self.warm_seconds = seconds;
    }

    fn detect(&mut self, lattice: &Lattice, proxies: &[Proxy], seconds: f32) {
        let nodes = &self.work.solver.nodes;
        self.work.contacts.clear();
        for (number, candidate) in (0_u32..).zip(&self.work.candidates) {
            let proxy = &proxies[candidate.proxy as usize];
            let part = &proxy.parts[candidate.part as usize];
            let point = candidate.point(lattice, nodes);
            let Some(gap) = part.gap(&point, REACH) else { continue };
            let least = if gap.distance > 0.0 {
                -gap.distance / seconds
            } else {
                (UNDONE * (-gap.distance - SLOP).max(0.0) / seconds).min(RECOVERY)
            };
            let arm = point - proxy.centre;
            let mut contact = Contact {
                candidate: number,
                proxy: candidate.proxy,
                count: candidate.count,
                is_static: proxy.is_static,
                slots: candidate.slots,
                weights: candidate.weights,
                mobilities: [0.0; CORNERS],
                friction: candidate.friction,
                least,
                arm,
                axes: axes(&gap.normal),
                effective_mass: [0.0; 3],
                impulse: [0.0; 3],
            };
            let mut mobility = proxy.inverse_mass;
            for corner in 0..candidate.count as usize {
                let node = nodes[candidate.slots[corner] as usize] as usize;
                let weight = candidate.weights[corner];
                contact.mobilities[corner] = weight * lattice.form.inverse_mass[node];
                mobility += weight * contact.mobilities[corner];
            }
            for (mass, axis) in contact.effective_mass.iter_mut().zip(&contact.axes) {
                let turn = arm.cross(axis);
                let mobility = mobility + turn.dot(&(proxy.inverse_inertia * turn));
                *mass = if mobility > 0.0 { 1.0 / mobility } else { 0.0 };
            }
            self.work.contacts.push(contact);
        }
    }

    /// Begins with the impulses of the substep before, as forces.
    fn start_warm(&mut self, proxies: &mut [Proxy], seconds: f32) {
        let scale = if self.warm_seconds > 0.0 { seconds / self.warm_seconds } else { 1.0 };
        let mut warm = self.warm.iter().peekable();
        let Work { candidates, contacts, solver } = &mut self.work;
        for contact in contacts {
            let key = candidates[contact.candidate as usize].key;
            // Both are in the order of keys.
            while warm.next_if(|each| each.key < key).is_some() {}
            let Some(before) = warm.next_if(|each| each.key == key) else { continue };
            let before = before.impulse * scale;
            let [normal, first, second] = contact.axes.map(|axis| axis.dot(&before));
            contact.impulse[0] = normal.max(0.0);
            let along = contact.held([first, second]);
            contact.impulse = [contact.impulse[0], along[0], along[1]];
            let impulse = contact.vector(contact.impulse);
            contact.apply(&impulse, &mut solver.velocities, &mut proxies[contact.proxy as usize]);
        }
    }

    /// Takes note of what was done to rigid bodies, and keeps it for the next substep.
    fn report(&mut self, proxies: &mut [Proxy]) {
        self.warm.clear();
        self.touches_moving = false;
        for contact in &self.work.contacts {
            if contact.impulse[0] == 0.0 {
                continue;
            }
            let impulse = contact.vector(contact.impulse);
            let key = self.work.candidates[contact.candidate as usize].key;
            self.warm.push(Warm { key, impulse });
            let proxy = &mut proxies[contact.proxy as usize];
            self.touches_moving |= !contact.is_static;
            let (normal, place) = (f64::from(contact.impulse[0]), contact.arm + proxy.centre);
            proxy.load.impulse -= impulse.cast::<f64>();
            proxy.load.angular -= contact.arm.cross(&impulse).cast::<f64>();
            proxy.load.pressing += normal;
            proxy.load.moment += place.cast::<f64>() * normal;
        }
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
    pub(super) fn deepest(&self, lattice: &Lattice, proxies: &[Proxy]) -> f64 {
        let depths = self.work.candidates.iter().filter_map(|candidate| {
            let part = &proxies[candidate.proxy as usize].parts[candidate.part as usize];
            let point = candidate.point(lattice, &self.work.solver.nodes);
            part.gap(&point, 0.0).map(|gap| f64::from(-gap.distance))
        });
        depths.fold(0.0, f64::max)
    }
}

impl Contact {
    /// Tangential impulses that friction can bear.
    #[inline]
    fn held(&self, along: [f32; 2]) -> [f32; 2] {
        let most = self.friction * self.impulse[0];
        let size = (along[0] * along[0] + along[1] * along[1]).sqrt();
        if size > most { along.map(|impulse| impulse * (most / size)) } else { along }
    }

    fn vector(&self, along: [f32; 3]) -> Vector3<f32> {
        self.axes[0] * along[0] + self.axes[1] * along[1] + self.axes[2] * along[2]
    }

    fn solve(&mut self, velocities: &mut [f32x4], proxy: &mut Proxy) {
        let mut sum = f32x4::from([0.0; 4]);
        let corners = self.slots.iter().zip(&self.weights).take(self.count as usize);
        for (slot, weight) in corners {
            sum += velocities[*slot as usize] * f32x4::from([*weight; 4]);
        }
        let [x, y, z, _] = sum.to_array();
        let mut velocity = Vector3::new(x, y, z);
        if !self.is_static {
            velocity -= proxy.velocity + proxy.rate.cross(&self.arm);
        }
        let [normal, first, second] = self.axes.map(|axis| axis.dot(&velocity));
        let before = self.impulse;
        let [m, m_first, m_second] = self.effective_mass;
        self.impulse[0] = (before[0] + (self.least - normal) * m).max(0.0);
        let along = self.held([before[1] - first * m_first, before[2] - second * m_second]);
        self.impulse = [self.impulse[0], along[0], along[1]];
        let change = [0, 1, 2].map(|axis: usize| self.impulse[axis] - before[axis]);
        if change != [0.0; 3] {
            self.apply(&self.vector(change), velocities, proxy);
        }
    }

    #[inline]
    fn apply(&self, impulse: &Vector3<f32>, velocities: &mut [f32x4], proxy: &mut Proxy) {
        let lanes = f32x4::from([impulse.x, impulse.y, impulse.z, 0.0]);
        for (slot, mobility) in self.slots.iter().zip(&self.mobilities).take(self.count as usize) {
            velocities[*slot as usize] += lanes * f32x4::from([*mobility; 4]);
        }
        if !self.is_static {
            proxy.velocity -= impulse * proxy.inverse_mass;
            proxy.rate -= proxy.inverse_inertia * self.arm.cross(impulse);
        }
    }
}

/// A normal and two tangents.
fn axes(normal: &Vector3<f32>) -> [Vector3<f32>; 3] {
    let seed = if normal.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let tangent = normal.cross(&seed);
    let tangent = tangent / tangent.norm();
    [*normal, tangent, normal.cross(&tangent)]
}

/// A box, m from the lattice's origin, axes of the world.
struct Box3 {
    min: Vector3<f32>,
    max: Vector3<f32>,
}

/// A box around a part, in which samples are looked for.
struct Near(Box3);

impl Near {
    fn new(part: &PartProxy, reach: f32) -> Self {
        let [centre, half] = part.shape.bounds();
        let centre = part.at.origin + part.at.axes * centre;
        let half = part.at.axes.abs() * half + Vector3::repeat(reach);
        Self(Box3 { min: centre - half, max: centre + half })
    }

    /// Visits the samples in elements that meet the box and that `counts` does not leave out.
    fn samples(
        &self,
        lattice: &Lattice,
        samples: &Samples,
        counts: impl Fn(&Box3) -> bool,
        mut visit: impl FnMut(usize, &MaterialPoint),
    ) {
        let offsets = lattice.form.grid.corner_offsets();
        for (element, range) in &samples.elements {
            let (mut min, mut max) =
                (Vector3::repeat(f32::INFINITY), Vector3::repeat(f32::NEG_INFINITY));
            for axis in 0..3 {
                let x = &lattice.x[axis];
                for offset in offsets {
                    let at = x[*element as usize + offset];
                    (min[axis], max[axis]) = (min[axis].min(at), max[axis].max(at));
                }
            }
            let meets =
                (0..3).all(|axis| min[axis] <= self.0.max[axis] && max[axis] >= self.0.min[axis]);
            if meets && counts(&Box3 { min, max }) {
                for index in range.clone() {
                    visit(index as usize, &samples.places[index as usize]);
                }
            }
        }
    }
}

impl PartProxy {
    /// Whether its surface has an edge within `reach` of a box, or is curved as narrowly as that.
    fn is_sharp_near(&self, near: &Box3, reach: f32) -> bool {
        let middle = self.at.axes.tr_mul(&(0.5 * (near.min + near.max) - self.at.origin));
        self.shape.is_sharp_near(&middle, reach + 0.5 * (near.max - near.min).norm())
    }
}
