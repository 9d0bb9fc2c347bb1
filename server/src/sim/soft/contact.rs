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
//! are solved one after the other (projected Gauss–Seidel) and back, up to [`SWEEPS`] times in all; on the way back those that
//! still change. Those with what stands still are solved once, since they hardly act on each other, and last: where an
//! instrument presses skin into a wall, the wall has its way. Most of these are [`resting`](super::resting) on a flat face.
//!
//! A sample that is held only stops a finger: it undoes no overlap, begins with no impulse, and is solved once. A finger
//! between two of them can obey neither, and impulses would grow without end. What has not given way to an instrument, since it
//! is held, or pressed on something else, is an [`Obstacle`] to that: impulses tell so not at all, or too late.

use std::cell::Cell;

use nalgebra::Vector3;
use wide::f32x4;

use super::candidates::{Candidate, Candidates};
use super::lanes::{Lanes, length, with_widest_instructions};
use super::lattice::Lattice;
use super::material::Friction;
use super::proxy::{Obstacle, Proxy};
use super::skin::Skin;

/// How often all contacts with what moves are solved in a substep, at most.
const SWEEPS: usize = 24;

/// They are solved no more once that has changed no sample's velocity by more than this, m/s. A part of the impulses would
/// not do: where jaws press hard, errors of some tenths of a per cent shake nodes of some 0.1 g.
const SETTLED: f32 = 0.5e-3;

/// Distance from which on contacts are looked at in a substep, m.
pub(super) const REACH: f32 = 0.3e-3;

/// Distance from which on it is computed, m: below it is known, and what is as far is not looked at for a while.
const LOOK: f32 = 2e-3;

/// How many times as far as its nodes a sample moves, at most: those beyond the lattice have weights below 0.
const SPREAD: f32 = 2.0;

/// Part of an overlap that is undone in a substep.
const UNDONE: f32 = 0.02;

/// What moves by less for an impulse counts as immovable, 1/kg: a node that is held, against a finger that is pushed along
/// itself. Nodes have some 10,000 1/kg, fingers some 50 across.
pub(super) const LEAST_MOBILITY: f32 = 1.0;

/// Overlap from which on skin is an [`Obstacle`], m; where it is held any overlap is. What can give way overlaps less.
const OBSTRUCTS: f32 = 0.2e-3;

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
        let mut candidates = std::mem::take(&mut self.work.candidates);
        candidates.find(lattice, skin, friction, proxies, reach);
        self.warm_up(candidates.resting.candidates_mut());
        candidates.resting.begin();
        self.warm_up(candidates.fixed.iter_mut());
        self.warm_up(candidates.moving.iter_mut());
        self.work.candidates = candidates;
    }

    /// Gives candidates, in the order of keys, the impulses of the step before.
    fn warm_up<'a>(&self, candidates: impl Iterator<Item = &'a mut Candidate>) {
        let mut warm = self.warm.iter().peekable();
        for candidate in candidates {
            while warm.next_if(|each| each.key < candidate.key).is_some() {}
            if let Some(before) = warm.next_if(|each| each.key == candidate.key) {
                candidate.impulse = before.impulse;
            }
        }
    }

    /// Ends a step of `seconds`: keeps what the next begins with, and tells moving bodies the pressure on them.
    pub(super) fn finish(&mut self, proxies: &mut [Proxy], seconds: f64) {
        self.warm.clear();
        let Candidates { resting, fixed, moving, nodes, .. } = &mut self.work.candidates;
        resting.finish(&nodes.places, proxies);
        note_pressures(moving, proxies, seconds);
        let resting = resting.candidates();
        for Candidate { key, impulse, .. } in resting.chain(&*fixed).chain(&*moving) {
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

    /// Changes velocities of the body and of rigid ones by what contacts do in a substep. Skin that is attached is no
    /// obstacle to what carries it, unless it is held.
    pub(super) fn solve(
        &mut self,
        lattice: &mut Lattice,
        proxies: &mut [Proxy],
        seconds: f32,
        is_attached: bool,
    ) {
        let contacts = self;
        let obstructs = if is_attached { f32::INFINITY } else { OBSTRUCTS };
        with_widest_instructions!(solve(
            contacts: &mut Contacts,
            lattice: &mut Lattice,
            proxies: &mut [Proxy],
            seconds: f32,
            obstructs: f32
        ));
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

    /// Whether a moving part comes as near as `reach` (m) to a sample within `seconds` in which no node moves.
    pub(super) fn are_approached(&self, proxies: &[Proxy], seconds: f32, reach: f32) -> bool {
        let Candidates { moving, nodes, .. } = &self.work.candidates;
        moving.iter().any(|candidate| {
            let proxy = &proxies[candidate.proxy as usize];
            let point = vector(candidate.corners.mean(&nodes.places));
            let gap = proxy.parts[candidate.part as usize].gap(&point, f32::INFINITY);
            gap.is_some_and(|gap| {
                let approach = proxy.velocity_at(&(point - proxy.centre)).dot(&gap.normal);
                gap.distance - approach.max(0.0) * seconds < reach
            })
        })
    }

    /// How deep samples are in rigid parts, m: that of the deepest.
    pub(super) fn deepest(&self, proxies: &[Proxy]) -> f64 {
        let Candidates { resting, fixed, moving, nodes, .. } = &self.work.candidates;
        let depths_of_resting =
            resting.distances(&nodes.places).map(|distance| f64::from(-distance));
        let depths = fixed.iter().chain(moving.iter()).filter_map(|candidate| {
            let part = &proxies[candidate.proxy as usize].parts[candidate.part as usize];
            let point = vector(candidate.corners.mean(&nodes.places));
            part.gap(&point, 0.0).map(|gap| f64::from(-gap.distance))
        });
        depths.chain(depths_of_resting).fold(0.0, f64::max)
    }
}

#[inline(always)]
fn solve(
    contacts: &mut Contacts,
    lattice: &mut Lattice,
    proxies: &mut [Proxy],
    seconds: f32,
    obstructs: f32,
) {
    let Work { candidates, fixed, moving } = &mut contacts.work;
    let Candidates { resting, fixed: beside_fixed, moving: beside_moving, nodes, .. } = candidates;
    let moved = nodes.load_places(lattice);
    detect::<true>(beside_fixed, fixed, &nodes.places, moved, proxies, seconds, obstructs);
    detect::<false>(beside_moving, moving, &nodes.places, moved, proxies, seconds, obstructs);
    let scale = if contacts.warm_seconds > 0.0 { seconds / contacts.warm_seconds } else { 1.0 };
    contacts.warm_seconds = seconds;
    resting.start(lattice, scale);
    nodes.load_velocities(lattice);
    let velocities = &mut nodes.velocities;
    for contact in &mut *fixed {
        contact.start::<true>(beside_fixed, scale, velocities, proxies);
    }
    for contact in &mut *moving {
        contact.start::<false>(beside_moving, scale, velocities, proxies);
    }
    for sweep in 0..SWEEPS {
        let mut most: f32 = 0.0;
        let is_way_back = sweep % 2 == 1;
        for step in 0..moving.len() {
            // There and back: sweeps in one direction push neighbours along it. The way back is that of those that change.
            let number = if is_way_back { moving.len() - 1 - step } else { step };
            let contact = &mut moving[number];
            let is_idle = contact.is_held || is_way_back && contact.changed < SETTLED;
            if sweep == 0 || !is_idle {
                contact.solve::<false>(beside_moving, velocities, proxies);
                most = most.max(contact.changed);
            }
        }
        if most < SETTLED {
            break;
        }
    }
    for contact in &mut *fixed {
        contact.solve::<true>(beside_fixed, velocities, proxies);
    }
    nodes.store_velocities(lattice);
    resting.solve(lattice, seconds);
    report(beside_fixed, fixed, proxies);
    report(beside_moving, moving, proxies);
}

/// A contact of this substep.
#[derive(Debug, Clone)]
struct Contact {
    candidate: u32,
    /// Whether the sample is held, and beside a finger.
    is_held: bool,
    /// Least velocity along the normal.
    least: f32,
    arm: Vector3<f32>,
    /// Normal and tangents: x, y and z of each.
    axes: [f32x4; 3],
    /// The same as rows: normal and tangents of x, of y and of z.
    rows: [f32x4; 3],
    /// How an impulse along each changes the rate of turning of the rigid body.
    turns: [f32x4; 3],
    /// Along normal and tangents: how an impulse changes the velocity of the sample against the part, 1/kg.
    mobility: f32x4,
    /// One by that, or 0 for what counts as immovable, kg.
    effective_mass: f32x4,
    /// Along normal and tangents.
    impulse: f32x4,
    /// By how much the sample's velocity changed when it was solved last, m/s: the greatest of the three.
    changed: f32,
}

/// Three numbers, and a fourth that is 0.
#[inline(always)]
pub(super) fn lanes(vector: &Vector3<f32>) -> f32x4 {
    f32x4::from([vector.x, vector.y, vector.z, 0.0])
}

/// The first three numbers.
#[inline(always)]
pub(super) fn vector(lanes: f32x4) -> Vector3<f32> {
    let [x, y, z, _] = lanes.to_array();
    Vector3::new(x, y, z)
}

/// The sum of three columns, each so many times.
#[inline(always)]
fn combined(columns: &[f32x4; 3], [a, b, c]: [f32; 3]) -> f32x4 {
    columns[0] * f32x4::splat(a) + columns[1] * f32x4::splat(b) + columns[2] * f32x4::splat(c)
}

/// Least velocity along the normal of what is at a `distance` (m, below 0 inside) from a face, m/s.
#[inline(always)]
fn least_velocity(distance: f32, seconds: f32) -> f32 {
    if distance > 0.0 {
        -distance / seconds
    } else {
        (UNDONE * (-distance - SLOP).max(0.0) / seconds).min(RECOVERY)
    }
}

/// The same of several.
#[inline(always)]
pub(super) fn least_velocities<L: Lanes>(distances: L, seconds: f32) -> L {
    let seconds = L::splat(seconds);
    let undone = (-distances).plus(-SLOP).max(L::splat(0.0)).times(UNDONE) / seconds;
    // What is outside undoes nothing.
    (-distances / seconds).where_positive(distances) + undone.min(L::splat(RECOVERY))
}

/// Finds the contacts of this substep. `FIXED` says that what candidates are beside stands still; no node has moved by more
/// than `moved` (m) since the substep before. Skin that is not held is an obstacle from an overlap of `obstructs` (m) on.
#[inline(always)]
fn detect<const FIXED: bool>(
    candidates: &mut [Candidate],
    contacts: &mut Vec<Contact>,
    places: &[f32x4],
    moved: f32,
    proxies: &mut [Proxy],
    seconds: f32,
    obstructs: f32,
) {
    contacts.clear();
    for (number, candidate) in (0_u32..).zip(candidates) {
        let proxy = &mut proxies[candidate.proxy as usize];
        candidate.clear -= SPREAD * moved + proxy.moved;
        if candidate.clear > REACH {
            continue;
        }
        let part = &proxy.parts[candidate.part as usize];
        let point = vector(candidate.corners.mean(places));
        let gap = part.gap(&point, LOOK);
        candidate.clear = gap.map_or(LOOK, |gap| gap.distance);
        let Some(gap) = gap.filter(|gap| gap.distance <= REACH) else {
            candidate.impulse = Vector3::zeros();
            continue;
        };
        let is_held = candidate.corners.is_held();
        let (depth, into) = (-gap.distance, gap.normal);
        if !FIXED && depth > if is_held { 0.0 } else { obstructs } {
            proxy.load.meet(Obstacle { depth, point, into });
        }
        let axes = axes(&gap.normal);
        let least = least_velocity(gap.distance, seconds);
        let is_held = is_held && proxy.hinge.is_some();
        let least = if is_held { least.min(0.0) } else { least };
        let arm = point - proxy.centre;
        let (mut mobility, mut turns) = ([candidate.corners.mobility; 3], [f32x4::ZERO; 3]);
        if !FIXED {
            for (axis, (own, turn)) in axes.iter().zip(mobility.iter_mut().zip(&mut turns)) {
                let moment = arm.cross(axis);
                let turned = proxy.inverse_inertia * moment;
                *own += proxy.inverse_mass + moment.dot(&turned);
                *turn = lanes(&turned);
            }
        }
        let masses = mobility.map(|each| if each > LEAST_MOBILITY { 1.0 / each } else { 0.0 });
        let [normal, first, second] = &axes;
        contacts.push(Contact {
            candidate: number,
            is_held,
            least,
            arm,
            axes: axes.each_ref().map(lanes),
            rows: [0, 1, 2]
                .map(|axis: usize| f32x4::from([normal[axis], first[axis], second[axis], 0.0])),
            turns,
            mobility: lanes(&mobility.into()),
            effective_mass: lanes(&masses.into()),
            impulse: f32x4::ZERO,
            changed: 0.0,
        });
    }
}

/// Takes note of what was done to rigid bodies, and keeps it for the next substep.
#[inline(always)]
fn report(candidates: &mut [Candidate], contacts: &[Contact], proxies: &mut [Proxy]) {
    for contact in contacts {
        let candidate = &mut candidates[contact.candidate as usize];
        let [normal, first, second, _] = contact.impulse.to_array();
        let impulse = vector(combined(&contact.axes, [normal, first, second]));
        candidate.impulse = if contact.is_held { Vector3::zeros() } else { impulse };
        if normal == 0.0 {
            continue;
        }
        let proxy = &mut proxies[candidate.proxy as usize];
        proxy.load.add(&impulse, &(contact.arm + proxy.centre), &proxy.centre, normal);
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
    /// Impulses along normal and tangents as contact and friction can bear them.
    #[inline(always)]
    fn borne(friction: f32, wanted: f32x4) -> f32x4 {
        // The numbers stay in one register: what is put together in memory would have to be waited for.
        let pressing = wanted.fast_max(f32x4::from([0.0, f32::MIN, f32::MIN, f32::MIN]));
        let [normal, first, second, _] = pressing.to_array();
        let most = friction * normal;
        let square = first * first + second * second;
        let part = if square > most * most { most / square.sqrt() } else { 1.0 };
        let along = f32x4::from([1.0, 0.0, 0.0, 0.0]);
        let across = f32x4::from([0.0, 1.0, 1.0, 1.0]);
        pressing * (along + across * f32x4::splat(part))
    }

    /// Begins with the impulse of the substep before, as a force.
    #[inline(always)]
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
        let before = combined(&self.rows, (candidate.impulse * scale).into());
        self.impulse = Self::borne(candidate.friction, before);
        self.apply::<FIXED>(candidate, self.impulse, velocities, proxies);
    }

    #[inline(always)]
    fn solve<const FIXED: bool>(
        &mut self,
        candidates: &[Candidate],
        velocities: &mut [f32x4],
        proxies: &mut [Proxy],
    ) {
        let candidate = &candidates[self.candidate as usize];
        let mut velocity = vector(candidate.corners.mean(velocities));
        if !FIXED {
            let proxy = &proxies[candidate.proxy as usize];
            velocity -= proxy.velocity_at(&self.arm);
        }
        let least = f32x4::from([self.least, 0.0, 0.0, 0.0]);
        let missing = least - combined(&self.rows, velocity.into());
        let before = self.impulse;
        let after = Self::borne(candidate.friction, before + missing * self.effective_mass);
        let change = after - before;
        self.impulse = after;
        self.changed = 0.0;
        if change != f32x4::ZERO {
            self.apply::<FIXED>(candidate, change, velocities, proxies);
            let [normal, first, second, _] = (change.abs() * self.mobility).to_array();
            self.changed = normal.max(first).max(second);
        }
    }

    #[inline(always)]
    fn apply<const FIXED: bool>(
        &self,
        candidate: &Candidate,
        along: f32x4,
        velocities: &mut [f32x4],
        proxies: &mut [Proxy],
    ) {
        let [normal, first, second, _] = along.to_array();
        let impulse = combined(&self.axes, [normal, first, second]);
        candidate.corners.push(impulse, velocities);
        if !FIXED {
            let proxy = &mut proxies[candidate.proxy as usize];
            if proxy.inverse_mass > 0.0 {
                proxy.velocity -= vector(impulse) * proxy.inverse_mass;
            }
            proxy.rate -= vector(combined(&self.turns, [normal, first, second]));
        }
    }
}

/// A normal and two tangents.
#[inline(always)]
pub(super) fn axes(normal: &Vector3<f32>) -> [Vector3<f32>; 3] {
    let seed = if normal.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let tangent = normal.cross(&seed);
    let tangent = tangent / length(&tangent);
    [*normal, tangent, normal.cross(&tangent)]
}
