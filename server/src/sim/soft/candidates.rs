//! Samples of the skin that may touch a rigid part before a step of the world ends: found once a step.
//!
//! What moves meets all samples, [`Skin::fine`]. What stands still is mostly large and flat and meets the vertices,
//! [`Skin::coarse`]; all samples, where it has an edge or is narrow. What is beside a flat face of it is
//! [`resting`](super::resting).

use nalgebra::Vector3;
use wide::f32x4;

use super::lattice::{CORNERS, Lattice};
use super::material::Friction;
use super::proxy::{PartProxy, Proxy};
use super::resting::Resting;
use super::shape::Shape;
use super::skin::{MaterialPoint, Samples, Skin};

/// Weight of a corner that counts: more than rounding.
const LEAST_WEIGHT: f32 = 1e-4;

/// Sum of the weights of free nodes below which a sample counts as held: they would have to move more than four times as
/// fast as what pushes it.
const LEAST_FREE: f32 = 0.25;

/// Added to the number of a sample between those that meet a static body.
const FINE: usize = 1 << 23;

/// A sample that may touch a part in this step.
#[derive(Debug, Clone)]
pub(super) struct Candidate {
    /// Tells the pair of sample and part from others, from step to step.
    pub key: u64,
    pub proxy: u16,
    pub part: u16,
    pub friction: f32,
    /// For how much of the skin it stands, m².
    pub area: f32,
    /// The nodes that count, by their numbers among [`Nodes`]; how much, and that over their masses.
    count: u8,
    nodes: [u16; CORNERS],
    weights: [f32; CORNERS],
    mobilities: [f32; CORNERS],
    /// Σ w²/m, 1/kg; 0, where it is held.
    pub mobility: f32,
    /// The impulse of the substep before, N·s, axes of the world.
    pub impulse: Vector3<f32>,
    /// Whether the part has pressed on it in this step.
    pub pressed: bool,
    /// How far it is from the part, at least, m: until that is used up, nothing has to be computed.
    pub clear: f32,
}

impl Candidate {
    /// A sample beside a part; `key`, `proxy`, `part`, `friction` and `area` are to be set.
    fn new(lattice: &Lattice, place: &MaterialPoint, nodes: &mut Nodes) -> Self {
        let mut candidate = Self {
            key: 0,
            proxy: 0,
            part: 0,
            friction: 0.0,
            area: 0.0,
            count: 0,
            nodes: [0; CORNERS],
            weights: [0.0; CORNERS],
            mobilities: [0.0; CORNERS],
            mobility: 0.0,
            impulse: Vector3::zeros(),
            pressed: false,
            clear: 0.0,
        };
        let (offsets, mut free) = (lattice.form.grid.corner_offsets(), 0.0);
        for (weight, offset) in place.weights().into_iter().zip(offsets) {
            if weight.abs() > LEAST_WEIGHT {
                let node = place.element as usize + offset;
                let index = candidate.count as usize;
                let mobility = weight * lattice.form.inverse_mass[node];
                candidate.nodes[index] = nodes.number(node);
                candidate.weights[index] = weight;
                candidate.mobilities[index] = mobility;
                candidate.mobility += weight * mobility;
                candidate.count += 1;
                free += if mobility == 0.0 { 0.0 } else { weight };
            }
        }
        if free < LEAST_FREE {
            candidate.mobility = 0.0;
            candidate.mobilities = [0.0; CORNERS];
        }
        candidate
    }

    /// Whether it is held where it is.
    pub(super) fn is_held(&self) -> bool {
        self.mobility == 0.0
    }

    /// What the sample has of something that its nodes have.
    #[inline]
    pub(super) fn mean(&self, of: &[f32x4]) -> f32x4 {
        let part =
            |corner: usize| of[self.nodes[corner] as usize] * f32x4::splat(self.weights[corner]);
        if self.count as usize == CORNERS {
            // In pairs: no sum waits for all others.
            return ((part(0) + part(1)) + (part(2) + part(3)))
                + ((part(4) + part(5)) + (part(6) + part(7)));
        }
        let mut sum = f32x4::ZERO;
        for corner in 0..self.count as usize {
            sum += part(corner);
        }
        sum
    }

    /// Gives an impulse to its nodes: x, y and z.
    #[inline]
    pub(super) fn push(&self, impulse: f32x4, velocities: &mut [f32x4]) {
        let mut push = |corner: usize| {
            velocities[self.nodes[corner] as usize] +=
                impulse * f32x4::splat(self.mobilities[corner]);
        };
        if self.count as usize == CORNERS {
            (0..CORNERS).for_each(push);
            return;
        }
        for corner in 0..self.count as usize {
            push(corner);
        }
    }
}

/// The nodes near contacts.
#[derive(Debug, Default)]
pub(super) struct Nodes {
    /// The number of each node, or [`NONE`].
    number_of: Vec<u16>,
    /// Which of the lattice's they are.
    in_lattice: Vec<u32>,
    /// Where they are, m from the lattice's origin, and how they move, m/s.
    pub places: Vec<f32x4>,
    pub velocities: Vec<f32x4>,
}

const NONE: u16 = u16::MAX;

impl Nodes {
    fn number(&mut self, node: usize) -> u16 {
        let number = &mut self.number_of[node];
        if *number == NONE {
            *number = self.in_lattice.len() as u16;
            self.in_lattice.push(node as u32);
        }
        *number
    }

    fn clear(&mut self, nodes: usize) {
        self.places.clear();
        if self.number_of.len() == nodes {
            for node in self.in_lattice.drain(..) {
                self.number_of[node as usize] = NONE;
            }
        } else {
            self.in_lattice.clear();
            self.number_of = vec![NONE; nodes];
        }
    }

    /// Takes over where they are and how they move. Returns by how much the farthest has moved since that was done before, m.
    pub(super) fn load(&mut self, lattice: &Lattice) -> f32 {
        let Self { in_lattice, places, velocities, .. } = self;
        let of = |[x, y, z]: &[Vec<f32>; 3], node: u32| {
            let node = node as usize;
            f32x4::from([x[node], y[node], z[node], 0.0])
        };
        velocities.clear();
        velocities.extend(in_lattice.iter().map(|node| of(&lattice.v, *node)));
        if places.is_empty() {
            places.extend(in_lattice.iter().map(|node| of(&lattice.x, *node)));
            return f32::INFINITY;
        }
        let mut farthest = f32x4::ZERO;
        for (place, node) in places.iter_mut().zip(in_lattice) {
            let now = of(&lattice.x, *node);
            farthest = farthest.fast_max((now - *place).abs());
            *place = now;
        }
        let [x, y, z, _] = farthest.to_array();
        (x * x + y * y + z * z).sqrt()
    }

    /// Hands back how they move.
    pub(super) fn store(&self, lattice: &mut Lattice) {
        for (node, velocity) in self.in_lattice.iter().zip(&self.velocities) {
            let [x, y, z, _] = velocity.to_array();
            for (axis, velocity) in [x, y, z].into_iter().enumerate() {
                lattice.v[axis][*node as usize] = velocity;
            }
        }
    }
}

/// The candidates of a step, each kind in the order of keys.
#[derive(Debug, Default)]
pub(super) struct Candidates {
    /// Beside flat faces of what stands still in this step.
    pub resting: Vec<Resting>,
    /// Beside edges and curved faces of it.
    pub fixed: Vec<Candidate>,
    /// Beside what moves.
    pub moving: Vec<Candidate>,
    pub nodes: Nodes,
    boxes: Boxes,
}

impl Candidates {
    /// Whether anything may be touched in this step.
    pub(super) fn are_none(&self) -> bool {
        self.resting.is_empty() && self.fixed.is_empty() && self.moving.is_empty()
    }

    /// Finds the samples that may touch a part before `reach` (m) is covered.
    pub(super) fn find(
        &mut self,
        lattice: &Lattice,
        skin: &Skin,
        friction: &Friction,
        proxies: &[Proxy],
        reach: f32,
    ) {
        let Self { resting, fixed, moving, nodes, boxes } = self;
        resting.clear();
        fixed.clear();
        moving.clear();
        nodes.clear(lattice.form.mass.len());
        if proxies.is_empty() {
            return;
        }
        boxes.load(lattice);
        for (number, proxy) in proxies.iter().enumerate() {
            let friction = if proxy.is_profiled { friction.profiled } else { friction.smooth };
            let found = if proxy.is_static { &mut *fixed } else { &mut *moving };
            for (part_number, part) in proxy.parts.iter().enumerate() {
                let key = u64::from(proxy.key()) << 32 | (part_number as u64) << 24;
                let mut add = |index: usize, place: &MaterialPoint, area: f32| {
                    let point = Vector3::from(lattice.local(place));
                    let Some(gap) = part.gap(&point, reach) else { return };
                    let is_flat = proxy.is_static && part.is_flat_near(&point, 2.0 * reach);
                    let sample = Candidate {
                        key: key | index as u64,
                        proxy: number as u16,
                        part: part_number as u16,
                        friction: friction as f32,
                        area,
                        ..Candidate::new(lattice, place, nodes)
                    };
                    if is_flat {
                        resting.push(Resting::new(sample, &point, &gap.normal, gap.distance));
                    } else {
                        found.push(sample);
                    }
                };
                let near = Region::around(part, reach);
                if proxy.is_static {
                    near.samples(boxes, &skin.coarse, |_| true, &mut add);
                    let is_sharp = |element: &Region| part.is_sharp_near(element, skin.spacing);
                    let add_fine = |index, place: &_, area| add(index | FINE, place, area);
                    near.samples(boxes, &skin.fine, is_sharp, add_fine);
                } else {
                    near.samples(boxes, &skin.fine, |_| true, add);
                }
            }
        }
    }
}

/// A box, m from the lattice's origin, axes of the world.
struct Region {
    min: Vector3<f32>,
    max: Vector3<f32>,
}

impl Region {
    fn around(part: &PartProxy, reach: f32) -> Self {
        let [centre, half] = part.shape.bounds();
        let centre = part.at.origin + part.at.axes * centre;
        let half = part.at.axes.abs() * half + Vector3::repeat(reach);
        Self { min: centre - half, max: centre + half }
    }

    fn meets(&self, other: &Self) -> bool {
        (0..3).all(|axis| self.min[axis] <= other.max[axis] && self.max[axis] >= other.min[axis])
    }

    /// Visits the samples in elements that meet it and that `counts` does not leave out.
    fn samples(
        &self,
        boxes: &Boxes,
        samples: &Samples,
        counts: impl Fn(&Self) -> bool,
        mut visit: impl FnMut(usize, &MaterialPoint, f32),
    ) {
        for (element, range) in &samples.elements {
            let region = boxes.of(*element as usize);
            if region.meets(self) && counts(&region) {
                for index in range.clone() {
                    let index = index as usize;
                    visit(index, &samples.places[index], samples.areas[index]);
                }
            }
        }
    }
}

/// Boxes around all elements, by their numbers.
#[derive(Debug, Default)]
struct Boxes {
    min: [Vec<f32>; 3],
    max: [Vec<f32>; 3],
}

impl Boxes {
    fn load(&mut self, lattice: &Lattice) {
        let corners = lattice.form.grid.corner_offsets();
        let least = |one: f32, other: f32| if one < other { one } else { other };
        let most = |one: f32, other: f32| if one > other { one } else { other };
        for (axis, x) in lattice.x.iter().enumerate() {
            spread(&mut self.min[axis], x, corners, least);
            spread(&mut self.max[axis], x, corners, most);
        }
    }

    fn of(&self, element: usize) -> Region {
        let of = |numbers: &[Vec<f32>; 3]| {
            Vector3::new(numbers[0][element], numbers[1][element], numbers[2][element])
        };
        Region { min: of(&self.min), max: of(&self.max) }
    }
}

/// Makes each of `numbers` the `chosen` one of those of `x` at the corners of its element: along one axis of the lattice
/// after the other.
fn spread(
    numbers: &mut Vec<f32>,
    x: &[f32],
    corners: [usize; CORNERS],
    chosen: impl Fn(f32, f32) -> f32,
) {
    numbers.clear();
    numbers.extend_from_slice(x);
    for offset in [corners[1], corners[2], corners[4]] {
        let count = numbers.len() - offset;
        for element in 0..count {
            numbers[element] = chosen(numbers[element], numbers[element + offset]);
        }
        numbers.truncate(count);
    }
}

impl PartProxy {
    /// Whether its surface is a flat face within `reach` of a point that is at it.
    fn is_flat_near(&self, point: &Vector3<f32>, reach: f32) -> bool {
        let local = self.at.axes.tr_mul(&(point - self.at.origin));
        matches!(self.shape, Shape::Cuboid(_)) && !self.shape.is_sharp_near(&local, reach)
    }

    /// Whether its surface has an edge within `reach` of a region, or is curved as narrowly as that.
    fn is_sharp_near(&self, near: &Region, reach: f32) -> bool {
        let middle = self.at.axes.tr_mul(&(0.5 * (near.min + near.max) - self.at.origin));
        self.shape.is_sharp_near(&middle, reach + 0.5 * (near.max - near.min).norm())
    }
}
