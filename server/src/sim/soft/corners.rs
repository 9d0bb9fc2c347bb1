//! What a sample of the skin has of the nodes around it, and what it does to them.

use wide::f32x4;

use super::lattice::{CORNERS, Form, Lattice};
use super::skin::MaterialPoint;

/// Weight of a corner that counts: more than rounding.
const LEAST_WEIGHT: f32 = 1e-4;

/// Sum of the weights of free nodes below which a sample counts as held: they would have to move more than four times as
/// fast as what pushes it.
const LEAST_FREE: f32 = 0.25;

/// The corners of a sample's element that count.
#[derive(Debug, Clone)]
pub(super) struct Corners {
    count: u8,
    /// Their nodes, how much each counts, and that over its mass, 1/kg.
    nodes: [u16; CORNERS],
    weights: [f32; CORNERS],
    mobilities: [f32; CORNERS],
    /// Σ w²/m, 1/kg; 0, where the sample is held.
    pub mobility: f32,
}

impl Corners {
    /// Those of a sample at `place`.
    pub(super) fn new(form: &Form, place: &MaterialPoint) -> Self {
        let mut corners = Self {
            count: 0,
            nodes: [0; CORNERS],
            weights: [0.0; CORNERS],
            mobilities: [0.0; CORNERS],
            mobility: 0.0,
        };
        let mut free = 0.0;
        for (weight, offset) in place.weights().into_iter().zip(form.grid.corner_offsets()) {
            if weight.abs() > LEAST_WEIGHT {
                let node = place.element as usize + offset;
                let index = corners.count as usize;
                let mobility = weight * form.inverse_mass[node];
                corners.nodes[index] = node as u16;
                corners.weights[index] = weight;
                corners.mobilities[index] = mobility;
                corners.mobility += weight * mobility;
                corners.count += 1;
                free += if mobility == 0.0 { 0.0 } else { weight };
            }
        }
        if free < LEAST_FREE {
            corners.mobility = 0.0;
            corners.mobilities = [0.0; CORNERS];
        }
        corners
    }

    /// The same where all nodes have this part of the mass.
    pub(super) fn with_mass(mut self, part: f32) -> Self {
        if part != 1.0 {
            self.mobility /= part;
            self.mobilities.iter_mut().for_each(|mobility| *mobility /= part);
        }
        self
    }

    /// Its nodes, how much each counts, and that over its mass, 1/kg.
    pub(super) fn nodes(&self) -> &[u16] {
        &self.nodes[..self.count as usize]
    }

    /// See [`Self::nodes`].
    pub(super) fn weights(&self) -> &[f32] {
        &self.weights[..self.count as usize]
    }

    /// See [`Self::nodes`].
    pub(super) fn mobilities(&self) -> &[f32] {
        &self.mobilities[..self.count as usize]
    }

    /// Whether the sample is held where it is.
    pub(super) fn is_held(&self) -> bool {
        self.mobility == 0.0
    }

    /// What the sample has of something that nodes have.
    #[inline(always)]
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

    /// Gives an impulse to the nodes: x, y and z.
    #[inline(always)]
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

/// The nodes of a lattice as corners need them: all where a step begins, and those in use in its substeps.
#[derive(Debug, Default)]
pub(super) struct Nodes {
    /// Where they are, m from the lattice's origin, and how they move, m/s.
    pub places: Vec<f32x4>,
    pub velocities: Vec<f32x4>,
    /// Which blocks of nodes are in use, and their numbers.
    is_in_use: Vec<bool>,
    in_use: Vec<u16>,
}

/// Nodes that are taken over together.
const BLOCK: usize = 4;

/// The blocks of the numbers of nodes along one axis.
fn blocks(numbers: &[f32]) -> &[[f32; BLOCK]] {
    numbers.as_chunks().0
}

impl Nodes {
    /// Takes over where a body's nodes are.
    pub(super) fn begin(&mut self, lattice: &Lattice) {
        let count = blocks(&lattice.x[0]).len();
        for vectors in [&mut self.places, &mut self.velocities] {
            vectors.resize(count * BLOCK, f32x4::ZERO);
        }
        for block in 0..count {
            *chunk(&mut self.places, block) = gathered(&lattice.x, block);
        }
    }

    /// Takes note of the nodes that substeps need.
    pub(super) fn mark<'a>(&mut self, corners: impl Iterator<Item = &'a Corners>) {
        self.is_in_use.clear();
        self.is_in_use.resize(self.places.len() / BLOCK, false);
        for node in corners.flat_map(Corners::nodes) {
            self.is_in_use[*node as usize / BLOCK] = true;
        }
        let blocks = (0_u16..).zip(&self.is_in_use).filter(|(_, is)| **is).map(|(block, _)| block);
        self.in_use.clear();
        self.in_use.extend(blocks);
    }

    /// Takes over where those in use are. Returns by how much the farthest has moved since that was done before, m.
    #[inline(always)]
    pub(super) fn load_places(&mut self, lattice: &Lattice) -> f32 {
        let mut farthest = f32x4::ZERO;
        for block in &self.in_use {
            let block = *block as usize;
            let now = gathered(&lattice.x, block);
            let there = chunk(&mut self.places, block);
            for (before, now) in there.iter().zip(now) {
                farthest = farthest.fast_max((now - *before).abs());
            }
            *there = now;
        }
        let [x, y, z, _] = farthest.to_array();
        (x * x + y * y + z * z).sqrt()
    }

    /// Takes over how those in use move.
    #[inline(always)]
    pub(super) fn load_velocities(&mut self, lattice: &Lattice) {
        for block in &self.in_use {
            let block = *block as usize;
            *chunk(&mut self.velocities, block) = gathered(&lattice.v, block);
        }
    }

    /// Hands back how those in use move.
    #[inline(always)]
    pub(super) fn store_velocities(&self, lattice: &mut Lattice) {
        let [x, y, z] = lattice.v.each_mut().map(|v| v.as_chunks_mut::<BLOCK>().0);
        let from = self.velocities.as_chunks::<BLOCK>().0;
        for block in &self.in_use {
            let block = *block as usize;
            let rows = f32x4::transpose(from[block]);
            x[block] = rows[0].to_array();
            y[block] = rows[1].to_array();
            z[block] = rows[2].to_array();
        }
    }
}

/// A block of vectors.
#[inline(always)]
fn chunk(vectors: &mut [f32x4], block: usize) -> &mut [f32x4; BLOCK] {
    &mut vectors.as_chunks_mut().0[block]
}

/// The vectors of the nodes of a block.
#[inline(always)]
fn gathered(vectors: &[Vec<f32>; 3], block: usize) -> [f32x4; BLOCK] {
    let [x, y, z] = vectors.each_ref().map(|numbers| f32x4::from(blocks(numbers)[block]));
    f32x4::transpose([x, y, z, f32x4::ZERO])
}
