//! Which face each pixel shows: tile by tile, four pixels at a time.
//!
//! Every pixel of a tile is decided by the faces in their order, so the result does not depend on who draws
//! which tile.

use wide::{f32x4, f32x8};

use super::project::Face;

/// Pixels of a tile along each side: its keys and faces fit into a core's nearest cache.
pub(super) const TILE: usize = 64;

/// Pixels that are shaded at a time.
pub(super) const LANES: usize = 8;

/// Pixels that are decided at a time: most faces are narrower than eight.
const FOUR: usize = 4;

const ACROSS: usize = TILE / FOUR;

/// 0 to 7.
pub(super) const STEPS: f32x8 = f32x8::new([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);

/// 0 to 3.
const FOUR_STEPS: f32x4 = f32x4::new([0.0, 1.0, 2.0, 3.0]);

/// What the pixels of a tile show. Those of a row lie side by side, in groups of four.
pub(super) struct Tile {
    /// Column and row of its first pixel.
    pub(super) origin: [usize; 2],
    keys: [f32x4; ACROSS * TILE],
    /// The bits of the number of a face plus one; 0 for none.
    faces: [f32x4; ACROSS * TILE],
}

impl Tile {
    /// A tile in which nothing is seen.
    pub(super) fn new() -> Self {
        let zero = f32x4::new([0.0; FOUR]);
        Self { origin: [0, 0], keys: [zero; ACROSS * TILE], faces: [zero; ACROSS * TILE] }
    }

    /// Forgets what is seen. Only keys above `least` are.
    pub(super) fn clear(&mut self, origin: [usize; 2], least: f32) {
        self.origin = origin;
        self.keys.fill(f32x4::splat(least));
        self.faces.fill(f32x4::splat(0.0));
    }

    /// Draws `faces[number]` where it is nearer than what is there.
    pub(super) fn draw(&mut self, faces: &[Face], number: u32) {
        self.cover::<true>(&faces[number as usize], number + 1);
    }

    /// Takes note of the keys of `face` where it is nearer than what is there, but not of which face it is.
    pub(super) fn draw_keys(&mut self, face: &Face) {
        self.cover::<false>(face, 0);
    }

    fn cover<const NUMBERED: bool>(&mut self, face: &Face, number: u32) {
        let number = f32x4::splat(f32::from_bits(number));
        let [left, top] = self.origin;
        let [first, last] = face.columns.map(usize::from);
        let (first, last) = (first.max(left) - left, last.min(left + TILE - 1) - left);
        let [start, end] = face.rows.map(usize::from);
        let (start, end) = (start.max(top) - top, end.min(top + TILE - 1) - top);
        let is_wide = last - first >= 2 * LANES;
        let over_slopes = if is_wide { face.edges.map(|edge| 1.0 / edge[0]) } else { [0.0; 3] };
        let least = face.least.map(f32x4::splat);
        let slopes = face.edges.map(|edge| f32x4::splat(edge[0]));
        let key_slope = f32x4::splat(face.key[0]);
        for row in start..=end {
            let y = (top + row) as f32;
            let offsets = face.edges.map(|[_, b, c]| f32x4::splat(b * y + c));
            let key = face.key[2] + face.key[1] * (y - face.origin[1]);
            let key = f32x4::splat(key);
            let (first, last) = if is_wide {
                let span = span(face, &over_slopes, y);
                // `as` takes what is below 0 for 0.
                let start = (span[0] - left as f32) as usize;
                let end = (span[1] - left as f32 + 1.0) as usize;
                (first.max(start), (last + 1).min(end))
            } else {
                (first, last + 1)
            };
            for group in first / FOUR..last.div_ceil(FOUR) {
                let x = f32x4::splat((left + group * FOUR) as f32) + FOUR_STEPS;
                let inside = (slopes[0] * x + offsets[0]).simd_gt(least[0])
                    & (slopes[1] * x + offsets[1]).simd_gt(least[1])
                    & (slopes[2] * x + offsets[2]).simd_gt(least[2]);
                let index = row * ACROSS + group;
                let here = key + key_slope * (x - f32x4::splat(face.origin[0]));
                let seen = inside & here.simd_gt(self.keys[index]);
                self.keys[index] = seen.bitselect(here, self.keys[index]);
                if NUMBERED {
                    self.faces[index] = seen.bitselect(number, self.faces[index]);
                }
            }
        }
    }

    /// The keys of eight pixels, at this row and group of columns of the tile.
    pub(super) fn keys(&self, row: usize, group: usize) -> f32x8 {
        f32x8::new(eight(&self.keys, row, group))
    }

    /// The faces of eight pixels: numbers plus one, 0 for none.
    pub(super) fn faces(&self, row: usize, group: usize) -> [u32; LANES] {
        eight(&self.faces, row, group).map(f32::to_bits)
    }
}

fn eight(fours: &[f32x4; ACROSS * TILE], row: usize, group: usize) -> [f32; LANES] {
    let index = row * ACROSS + group * (LANES / FOUR);
    let ([a, b, c, d], [e, f, g, h]) = (fours[index].to_array(), fours[index + 1].to_array());
    [a, b, c, d, e, f, g, h]
}

/// Between which columns a row of a face lies, and a little to each side: no less than what is drawn.
fn span(face: &Face, over_slopes: &[f32; 3], y: f32) -> [f32; 2] {
    /// Rounding of an edge's value, over the largest of its terms.
    const ROUNDING: f32 = 1e-6;
    let mut span = [0.0, f32::MAX];
    for (edge, over_slope) in face.edges.iter().zip(over_slopes) {
        let [a, b, c] = *edge;
        let at = -(b * y + c) * over_slope;
        let beside = 1.0 + ((b * y).abs() + c.abs()) * ROUNDING * over_slope.abs();
        if a > 0.0 {
            span[0] = span[0].max(at - beside);
        } else if a < 0.0 {
            span[1] = span[1].min(at + beside);
        }
    }
    span
}

/// The faces of each tile of a picture, in order. Kept from picture to picture for its memory.
#[derive(Debug, Default)]
pub(super) struct Bins {
    /// Tiles along a row.
    columns: usize,
    lists: Vec<Vec<u32>>,
    count: usize,
}

impl Bins {
    /// Sorts faces into the tiles of a picture of this size.
    pub(super) fn sort(&mut self, size: [usize; 2], faces: &[Face]) {
        let [columns, rows] = size.map(|pixels| pixels.div_ceil(TILE));
        (self.columns, self.count) = (columns, columns * rows);
        if self.lists.len() < self.count {
            self.lists.resize_with(self.count, Vec::new);
        }
        self.lists.iter_mut().for_each(Vec::clear);
        for (number, face) in faces.iter().enumerate() {
            let [left, right] = face.columns.map(|column| usize::from(column) / TILE);
            let [top, bottom] = face.rows.map(|row| usize::from(row) / TILE);
            for row in top..=bottom {
                for column in left..=right {
                    self.lists[row * columns + column].push(number as u32);
                }
            }
        }
    }

    /// Number of tiles.
    pub(super) fn len(&self) -> usize {
        self.count
    }

    /// First pixel and faces of a tile.
    pub(super) fn tile(&self, index: usize) -> ([usize; 2], &[u32]) {
        let origin = [index % self.columns * TILE, index / self.columns * TILE];
        (origin, &self.lists[index])
    }
}
