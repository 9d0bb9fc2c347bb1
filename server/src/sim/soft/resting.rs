//! Samples beside flat faces of what stands still: most of the contacts of tissue that lies on something.
//!
//! The law is that of [`contact`](super::contact). Here nothing turns and the normal stays, so that vectors take the place
//! of rows: the effective mass is 1 / (Σ w²/m) in every direction. A face of the lattice has samples of one node, or of two
//! where it lies between them. Samples side by side have nodes side by side, so [`LANES`] of them are solved at once.

use nalgebra::Vector3;
use wide::f32x4;

use super::candidates::Candidate;
use super::contact::{self, vector};
use super::corners::Corners;
use super::lanes::{LANES, Lanes, with_widest_registers};
use super::lattice::Lattice;
use super::proxy::Proxy;

/// Nodes of a sample, at most.
const NODES: usize = 2;

/// A number of each sample in a row.
type Numbers = [f32; LANES];

/// The samples of a body that may touch flat faces in this step.
#[derive(Debug, Default)]
pub(super) struct Resting {
    /// In the order of keys.
    samples: Vec<Sample>,
    /// In the order of rows: proxy, part, first node and number of each.
    order: Vec<(u16, u16, u16, u32)>,
    rows: Vec<Row>,
}

/// A sample, and the face that it is beside.
#[derive(Debug, Clone)]
struct Sample {
    candidate: Candidate,
    /// Out of the face, axes of the world.
    normal: Vector3<f32>,
    /// How far the face is from the lattice's origin along the normal, m.
    offset: f32,
}

/// Samples beside one face that share no node. What is left of the lanes is 0.
#[derive(Debug, Clone, Default)]
struct Row {
    count: usize,
    normal: [f32; 3],
    friction: f32,
    /// The nodes of the first sample, how many it has, and of each sample how much these count, and that over their mass.
    nodes: [usize; NODES],
    node_count: usize,
    weights: [Numbers; NODES],
    mobilities: [Numbers; NODES],
    offset: Numbers,
    /// kg; 0, where a sample is held.
    mass: Numbers,
    /// The impulse of this substep, N·s; the sum of those of this step, and of their parts along the normal.
    impulse: [Numbers; 3],
    given: [Numbers; 3],
    pressing: Numbers,
}

impl Resting {
    /// Forgets the samples of the step before.
    pub(super) fn clear(&mut self) {
        self.samples.clear();
    }

    /// Whether there is no sample.
    pub(super) fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    /// Whether a sample may be one of a row: its nodes are fewer and farther from each other than those of its neighbours.
    pub(super) fn fits(corners: &Corners) -> bool {
        let nodes = corners.nodes();
        nodes.len() <= NODES && nodes.windows(2).all(|two| two[1] - two[0] >= LANES as u16)
    }

    /// Adds a sample at `point` that fits, beside a face to which it has this distance (m). Keys go up.
    pub(super) fn push(
        &mut self,
        candidate: Candidate,
        point: &Vector3<f32>,
        normal: &Vector3<f32>,
        distance: f32,
    ) {
        let offset = normal.dot(point) - distance;
        self.samples.push(Sample { candidate, normal: *normal, offset });
    }

    /// The samples in the order of keys.
    pub(super) fn candidates(&self) -> impl Iterator<Item = &Candidate> {
        self.samples.iter().map(|sample| &sample.candidate)
    }

    /// The same, to change them before a step begins.
    pub(super) fn candidates_mut(&mut self) -> impl Iterator<Item = &mut Candidate> {
        self.samples.iter_mut().map(|sample| &mut sample.candidate)
    }

    /// How far each is beyond its face, m.
    pub(super) fn distances(&self, places: &[f32x4]) -> impl Iterator<Item = f32> {
        self.samples.iter().map(|Sample { candidate, normal, offset }| {
            normal.dot(&vector(candidate.corners.mean(places))) - offset
        })
    }

    /// Begins a step with the impulses of the step before.
    pub(super) fn begin(&mut self) {
        let Self { samples, order, rows } = self;
        order.clear();
        order.extend((0..).zip(&*samples).map(|(number, Sample { candidate, .. })| {
            let Candidate { proxy, part, corners, .. } = candidate;
            (*proxy, *part, corners.nodes().first().copied().unwrap_or_default(), number)
        }));
        order.sort_unstable();
        rows.clear();
        let mut before: Option<&Sample> = None;
        for (.., number) in order {
            let sample = &samples[*number as usize];
            match rows.last_mut() {
                Some(row) if before.is_some_and(|before| row.goes_on(before, sample)) => {
                    row.add(sample);
                }
                _ => rows.push(Row::of(sample)),
            }
            before = Some(sample);
        }
    }

    /// Begins a substep with the impulses of the one before, `scale` times as large.
    pub(super) fn start(&mut self, lattice: &mut Lattice, scale: f32) {
        let (rows, velocities) = (&mut *self.rows, &mut lattice.v);
        start_rows(rows, velocities, scale);
    }

    /// Changes velocities by what faces do to samples in a substep.
    pub(super) fn solve(&mut self, lattice: &mut Lattice, seconds: f32) {
        let (rows, places, velocities) = (&mut *self.rows, &lattice.x, &mut lattice.v);
        solve_rows(rows, places, velocities, seconds);
    }

    /// Ends a step: keeps what the next begins with, and tells what has faces what was done to it.
    pub(super) fn finish(&mut self, places: &[f32x4], proxies: &mut [Proxy]) {
        let mut order = self.order.iter();
        for row in &self.rows {
            for (lane, (.., number)) in order.by_ref().take(row.count).enumerate() {
                let candidate = &mut self.samples[*number as usize].candidate;
                let at = |numbers: [Numbers; 3]| Vector3::from(numbers.map(|each| each[lane]));
                candidate.impulse = at(row.impulse);
                if row.pressing[lane] != 0.0 {
                    let proxy = &mut proxies[candidate.proxy as usize];
                    let point = vector(candidate.corners.mean(places));
                    proxy.load.add(&at(row.given), &point, &proxy.centre, row.pressing[lane]);
                }
            }
        }
    }
}

impl Row {
    /// A row that begins with a sample.
    fn of(sample: &Sample) -> Self {
        let Sample { candidate, normal, .. } = sample;
        let own = candidate.corners.nodes();
        let mut nodes = [0; NODES];
        for (node, own) in nodes.iter_mut().zip(own) {
            *node = *own as usize;
        }
        let mut row = Self {
            normal: (*normal).into(),
            friction: candidate.friction,
            nodes,
            node_count: own.len(),
            ..Self::default()
        };
        row.add(sample);
        row
    }

    /// Whether a sample is the next of this row, whose last is the one `before`.
    fn goes_on(&self, before: &Sample, sample: &Sample) -> bool {
        let [(last, last_nodes), (next, nodes)] =
            [before, sample].map(|each| (&each.candidate, each.candidate.corners.nodes()));
        self.count < LANES
            && (last.proxy, last.part) == (next.proxy, next.part)
            && before.normal == sample.normal
            && last_nodes.iter().map(|node| node + 1).eq(nodes.iter().copied())
    }

    fn add(&mut self, Sample { candidate, offset, .. }: &Sample) {
        let (lane, corners) = (self.count, &candidate.corners);
        self.count += 1;
        for index in 0..self.node_count {
            self.weights[index][lane] = corners.weights()[index];
            self.mobilities[index][lane] = corners.mobilities()[index];
        }
        self.offset[lane] = *offset;
        self.mass[lane] = if corners.is_held() { 0.0 } else { 1.0 / corners.mobility };
        for (numbers, impulse) in self.impulse.iter_mut().zip(candidate.impulse.iter()) {
            numbers[lane] = *impulse;
        }
    }

    /// What the samples have of something that nodes have. Loops, not closures: those would not be inlined.
    #[inline(always)]
    fn mean<L: Lanes>(&self, of: &[Vec<f32>; 3]) -> [L; 3] {
        let mut mean = [L::splat(0.0); 3];
        for axis in 0..3 {
            for index in 0..self.node_count {
                let there = L::load(&of[axis][self.nodes[index]..]);
                mean[axis] = mean[axis] + there * L::new(self.weights[index]);
            }
        }
        mean
    }

    /// Gives impulses to the nodes.
    #[inline(always)]
    fn push<L: Lanes>(&self, impulse: [L; 3], velocities: &mut [Vec<f32>; 3]) {
        for axis in 0..3 {
            for index in 0..self.node_count {
                let there = &mut velocities[axis][self.nodes[index]..];
                (L::load(there) + impulse[axis] * L::new(self.mobilities[index])).store(there);
            }
        }
    }

    #[inline(always)]
    fn start<L: Lanes>(&mut self, velocities: &mut [Vec<f32>; 3], scale: f32) {
        let mut impulse = [L::splat(0.0); 3];
        for (impulse, kept) in impulse.iter_mut().zip(&mut self.impulse) {
            *impulse = L::new(*kept).times(scale);
            *kept = impulse.numbers();
        }
        self.push(impulse, velocities);
    }

    #[inline(always)]
    fn solve<L: Lanes>(&mut self, x: &[Vec<f32>; 3], v: &mut [Vec<f32>; 3], seconds: f32) {
        let [a, b, c] = self.normal;
        let normal = [L::splat(a), L::splat(b), L::splat(c)];
        let distance = dot(normal, self.mean(x)) - L::new(self.offset);
        let least = contact::least_velocities(distance, seconds);
        let velocity: [L; 3] = self.mean(v);
        // What was wanted becomes, step by step, what friction can bear of it.
        let mut impulse = [L::splat(0.0); 3];
        for axis in 0..3 {
            let missing = normal[axis] * least - velocity[axis];
            impulse[axis] = L::new(self.impulse[axis]) + missing * L::new(self.mass);
        }
        let along = dot(normal, impulse);
        for axis in 0..3 {
            impulse[axis] = impulse[axis] - normal[axis] * along;
        }
        let pressing = along.max(L::splat(0.0));
        let pressing = pressing - pressing.where_positive(distance.plus(-contact::REACH));
        let size = dot(impulse, impulse).sqrt().max(L::splat(f32::MIN_POSITIVE));
        let part = (pressing.times(self.friction) / size).min(L::splat(1.0));
        let mut change = impulse;
        for axis in 0..3 {
            impulse[axis] = normal[axis] * pressing + impulse[axis] * part;
            change[axis] = impulse[axis] - L::new(self.impulse[axis]);
            self.impulse[axis] = impulse[axis].numbers();
            self.given[axis] = (L::new(self.given[axis]) + impulse[axis]).numbers();
        }
        self.pressing = (L::new(self.pressing) + pressing).numbers();
        self.push(change, v);
    }
}

#[inline(always)]
fn dot<L: Lanes>([a, b, c]: [L; 3], [x, y, z]: [L; 3]) -> L {
    a * x + b * y + c * z
}

fn start_rows(rows: &mut [Row], velocities: &mut [Vec<f32>; 3], scale: f32) {
    with_widest_registers!(start_rows_in_lanes(
        rows: &mut [Row],
        velocities: &mut [Vec<f32>; 3],
        scale: f32
    ) -> ());
}

#[inline(always)]
fn start_rows_in_lanes<L: Lanes>(rows: &mut [Row], velocities: &mut [Vec<f32>; 3], scale: f32) {
    for row in rows {
        row.start::<L>(velocities, scale);
    }
}

fn solve_rows(rows: &mut [Row], x: &[Vec<f32>; 3], v: &mut [Vec<f32>; 3], seconds: f32) {
    with_widest_registers!(solve_rows_in_lanes(
        rows: &mut [Row],
        x: &[Vec<f32>; 3],
        v: &mut [Vec<f32>; 3],
        seconds: f32
    ) -> ());
}

#[inline(always)]
fn solve_rows_in_lanes<L: Lanes>(
    rows: &mut [Row],
    x: &[Vec<f32>; 3],
    v: &mut [Vec<f32>; 3],
    seconds: f32,
) {
    for row in rows {
        row.solve::<L>(x, v, seconds);
    }
}
