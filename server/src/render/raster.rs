//! Which face each pixel shows: tile by tile, four pixels at a time.
//!
//! Every pixel of a tile is decided by the faces in their order, so the result does not depend on which
//! thread draws which tile.

use wide::{f32x4, f32x8};

use super::project::Face;

/// Pixels of a tile along each side: its keys and faces fit into a core's nearest cache.
pub(super) const TILE: usize = 64;

/// Pixels that are shaded at a time.
pub(super) const LANES: usize = 8;

/// Pixels that are decided at a time: most faces are narrower than eight.
const FOUR: usize = 4;

const ACROSS: usize = TILE / FOUR;

/// More columns than a picture has.
const MOST_COLUMN: f32 = 65536.0;

/// Columns of a face above which each row's ends are looked for.
const NARROW: usize = 16;

/// 0 to 7.
const STEPS: f32x8 = f32x8::new([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);

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
        let lines = Lines::of(face);
        let xs = |group: usize| f32x4::splat((left + group * FOUR) as f32) + FOUR_STEPS;
        let mut draw = |index: usize, inside: f32x4, key: f32x4| {
            let seen = inside & key.simd_gt(self.keys[index]);
            self.keys[index] = seen.bitselect(key, self.keys[index]);
            if NUMBERED {
                self.faces[index] = seen.bitselect(number, self.faces[index]);
            }
        };
        if last - first < NARROW {
            // Most faces: high and narrow ones of what is round. All rows of one group after the other.
            for group in first / FOUR..=last / FOUR {
                let along = lines.along(xs(group));
                for row in start..=end {
                    let (inside, key) = lines.at(&along, (top + row) as f32);
                    draw(row * ACROSS + group, inside, key);
                }
            }
        } else {
            let ends = Ends::of(face, (top + end) as f32);
            for row in start..=end {
                let y = (top + row) as f32;
                let [from, to] = ends.at(y).map(|column| (column - left as f32) as i32);
                // Numbers below 0 are no columns of the tile.
                let from = first.max(from.max(0) as usize);
                let to = (last + 1).min(to.saturating_add(1).max(0) as usize);
                for group in from / FOUR..to.div_ceil(FOUR) {
                    let (inside, key) = lines.at(&lines.along(xs(group)), y);
                    draw(row * ACROSS + group, inside, key);
                }
            }
        }
    }

    /// The keys of eight pixels, at this row and group of columns of the tile.
    pub(super) fn keys(&self, row: usize, group: usize) -> f32x8 {
        f32x8::new(eight(&self.keys, row, group))
    }
}

/// What eight pixels of a tile, side by side, show.
pub(super) struct Shown {
    /// Where they lie in the picture.
    pub(super) columns: f32x8,
    pub(super) row: f32,
    /// Numbers of faces plus one, 0 for none.
    pub(super) faces: [u32; LANES],
    /// Where there is one.
    pub(super) seen: f32x8,
    /// One over the key.
    pub(super) depth: f32x8,
}

impl Shown {
    #[inline]
    pub(super) fn of(tile: &Tile, row: usize, group: usize) -> Self {
        let faces = eight(&tile.faces, row, group).map(f32::to_bits);
        Self {
            columns: f32x8::splat((tile.origin[0] + group * LANES) as f32) + STEPS,
            row: (tile.origin[1] + row) as f32,
            faces,
            seen: mask(faces.map(|face| face > 0)),
            depth: f32x8::splat(1.0) / tile.keys(row, group),
        }
    }

    /// Eight squares of two pixels by two, side by side, as if each were one pixel; none where a square shows
    /// more than one face.
    pub(super) fn squares(tile: &Tile, row: usize, group: usize) -> Option<Self> {
        let line = |numbers, row| [eight(numbers, row, group), eight(numbers, row, group + 1)];
        let [upper, lower] = [row, row + 1].map(|row| line(&tile.faces, row));
        // As bits: a number's may be those of something that is not equal to itself.
        let [upper, lower] = [&upper, &lower].map(|line| line.as_flattened());
        let face = |square: usize| upper[2 * square].to_bits();
        let is_one = |square: usize| {
            let others = [upper[2 * square + 1], lower[2 * square], lower[2 * square + 1]];
            others.iter().all(|other| other.to_bits() == face(square))
        };
        if !(0..LANES).all(is_one) {
            return None;
        }
        let [upper, lower] = [row, row + 1].map(|row| line(&tile.keys, row));
        let [upper, lower] = [&upper, &lower].map(|line| line.as_flattened());
        // Along a face, keys are linear.
        let key = |square: usize| {
            let [left, right] = [2 * square, 2 * square + 1];
            0.25 * (upper[left] + upper[right] + lower[left] + lower[right])
        };
        let faces = std::array::from_fn(face);
        let first = (tile.origin[0] + group * LANES) as f32 + 0.5;
        Some(Self {
            columns: f32x8::splat(first) + f32x8::splat(2.0) * STEPS,
            row: (tile.origin[1] + row) as f32 + 0.5,
            faces,
            seen: mask(faces.map(|face| face > 0)),
            depth: f32x8::splat(1.0) / f32x8::new(std::array::from_fn(key)),
        })
    }

    /// Whether no pixel shows a face.
    pub(super) fn is_nothing(&self) -> bool {
        self.faces == [0; LANES]
    }

    /// Whether all show the same, or nothing.
    pub(super) fn is_one(&self) -> bool {
        self.faces == [self.faces[0]; LANES]
    }
}

/// All bits of a pixel where it is true.
pub(super) fn mask(pixels: [bool; LANES]) -> f32x8 {
    f32x8::new(pixels.map(|is_set| f32::from_bits(if is_set { u32::MAX } else { 0 })))
}

fn eight(fours: &[f32x4; ACROSS * TILE], row: usize, group: usize) -> [f32; LANES] {
    let index = row * ACROSS + group * (LANES / FOUR);
    let ([a, b, c, d], [e, f, g, h]) = (fours[index].to_array(), fours[index + 1].to_array());
    [a, b, c, d, e, f, g, h]
}

/// What of a face is the same for four pixels side by side.
struct Lines {
    /// Slopes along x and y and value at 0 of the edges.
    edges: [[f32x4; 3]; 3],
    least: [f32x4; 3],
    key: [f32x4; 3],
    origin: [f32x4; 2],
}

impl Lines {
    fn of(face: &Face) -> Self {
        Self {
            edges: face.edges.map(|edge| edge.map(f32x4::splat)),
            least: face.least.map(f32x4::splat),
            key: face.key.map(f32x4::splat),
            origin: face.origin.map(f32x4::splat),
        }
    }

    /// What the columns add to the edges and to the key.
    fn along(&self, x: f32x4) -> [f32x4; 4] {
        let [one, two, three] = &self.edges;
        [one[0] * x, two[0] * x, three[0] * x, self.key[0] * (x - self.origin[0])]
    }

    /// Which of the pixels lie in the face, and their keys, at this row.
    fn at(&self, along: &[f32x4; 4], y: f32) -> (f32x4, f32x4) {
        let y = f32x4::splat(y);
        let inside = |edge: usize| {
            let [_, b, c] = self.edges[edge];
            (along[edge] + (b * y + c)).simd_gt(self.least[edge])
        };
        let key = (self.key[2] + self.key[1] * (y - self.origin[1])) + along[3];
        (inside(0) & inside(1) & inside(2), key)
    }
}

/// Between which columns the rows of a face lie, and a little to each side: no less than what is drawn.
struct Ends {
    /// Slope along y and value at 0 of the columns of up to two edges at the left and two at the right.
    lefts: [[f32; 2]; 2],
    rights: [[f32; 2]; 2],
}

impl Ends {
    /// `last` is the last row.
    fn of(face: &Face, last: f32) -> Self {
        /// Rounding of an edge's value, over the largest of its terms.
        const ROUNDING: f32 = 1e-6;
        /// Columns per row of an edge that says little about where a row ends.
        const FLAT: f32 = 1e6;
        let mut ends = Self { lefts: [[0.0, 0.0]; 2], rights: [[0.0, MOST_COLUMN]; 2] };
        let (mut lefts, mut rights) = (ends.lefts.iter_mut(), ends.rights.iter_mut());
        for [a, b, c] in face.edges {
            if a.abs() * FLAT <= b.abs() {
                continue;
            }
            let line = if a > 0.0 { lefts.next() } else { rights.next() };
            let beside = 1.0 + (b.abs() * last + c.abs()) / a.abs() * ROUNDING;
            if let Some(line) = line {
                *line = [-b / a, -c / a - beside.copysign(a)];
            }
        }
        ends
    }

    fn at(&self, y: f32) -> [f32; 2] {
        let [left, right] =
            [self.lefts, self.rights].map(|lines| lines.map(|[slope, at]| slope * y + at));
        [
            if left[0] > left[1] { left[0] } else { left[1] },
            if right[0] < right[1] { right[0] } else { right[1] },
        ]
    }
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
