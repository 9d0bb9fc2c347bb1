//! A solid texture: lobules, vessels and mottles in a cube of texels that repeats itself along each axis.
//!
//! The cube is computed once in the program's life, from hashes of whole numbers and arithmetic alone, so that it has the
//! same bits on every machine. Lobules are the cells of scattered points (Worley: A cellular texture basis function, SIGGRAPH
//! 1996): high in their middles, low where two of them meet. Vessels lie where smooth noise passes its mean: on a
//! surface these are winding lines. Smaller cubes have the means of eight texels each, for what is far away.

use std::sync::LazyLock;

use wide::{f32x8, i32x8};

use super::raster::LANES;

/// Texels along each edge of the largest cube; a power of two.
pub(super) const EDGE: usize = 64;

/// Number of cubes; each has half the edge of the one before.
pub(super) const LEVELS: usize = 5;

/// Lobules along the edge.
const LOBULES: i32 = 8;

/// Added to places so that they are above 0: a multiple of all edges.
const ABOVE: f32 = 2048.0;

/// What the texture is at eight places.
#[derive(Debug, Clone, Copy)]
pub(super) struct Texels {
    /// 0 between lobules, 1 in their middles.
    pub(super) height: f32x8,
    /// How the height changes along x, y and z, per texel of the largest cube.
    pub(super) slope: [f32x8; 3],
    /// 1 on vessels, 0 beside them.
    pub(super) vessel: f32x8,
    /// Spots of all sizes, 0 to 1.
    pub(super) mottle: f32x8,
}

/// The cubes, the largest first: height, vessel and mottle as the three lowest bytes of a texel.
#[derive(Debug)]
pub(super) struct Texture([Vec<u32>; LEVELS]);

impl Texture {
    pub(super) fn shared() -> &'static Self {
        static SHARED: LazyLock<Texture> = LazyLock::new(Texture::new);
        &SHARED
    }

    fn new() -> Self {
        let mut cubes = [(); LEVELS].map(|()| vec![]);
        cubes[0] = places(EDGE).map(texel).collect();
        for level in 1..LEVELS {
            cubes[level] = halved(&cubes[level - 1], EDGE >> (level - 1));
        }
        Self(cubes)
    }

    /// What is at eight places, in texels of the largest cube, as a cube shows it whose texels are 2^`level` times as large:
    /// linear between the middles of texels.
    pub(super) fn at(&self, place: [f32x8; 3], level: usize) -> Texels {
        let shrunk = 1.0 / (1 << level) as f32;
        let place = place.map(|at| at * f32x8::splat(shrunk) + f32x8::splat(ABOVE - 0.5));
        let cell = place.map(f32x8::fast_trunc_int);
        let part: [f32x8; 3] = std::array::from_fn(|axis| place[axis] - cell[axis].round_float());
        // The edge of each cube is a power of two.
        let bits = EDGE.trailing_zeros() as i32 - level as i32;
        let last = i32x8::splat((1 << bits) - 1);
        let [x, y, z] = [0, 1, 2].map(|axis: usize| {
            let next = cell[axis] + i32x8::splat(1);
            [cell[axis], next].map(|at| (at & last) << (bits * axis as i32))
        });
        let texels = &self.0[level];
        let within = texels.len() - 1;
        let corners: [[i32; LANES]; 8] = std::array::from_fn(|corner| {
            let index = x[corner & 1] + y[corner >> 1 & 1] + z[corner >> 2];
            index.to_array().map(|index| texels[index as usize & within] as i32)
        });
        let corners = corners.map(i32x8::new);
        let byte = |low: i32| {
            let bytes = i32x8::splat(0xff);
            corners.map(|corner| ((corner >> low) & bytes).round_float())
        };
        let over = f32x8::splat(1.0 / 255.0);
        let (height, slope) = with_slope(&byte(0), &part);
        let per_texel = f32x8::splat(shrunk) * over;
        Texels {
            height: height * over,
            slope: slope.map(|slope| slope * per_texel),
            vessel: between(&byte(8), &part) * over,
            mottle: between(&byte(16), &part) * over,
        }
    }
}

fn lerp(from: f32x8, to: f32x8, part: f32x8) -> f32x8 {
    from + (to - from) * part
}

/// A number between those at the corners of a cube; x changes fastest.
fn between(corners: &[f32x8; 8], [x, y, z]: &[f32x8; 3]) -> f32x8 {
    let [a, b, c, d] = [0, 2, 4, 6].map(|low| lerp(corners[low], corners[low + 1], *x));
    lerp(lerp(a, b, *y), lerp(c, d, *y), *z)
}

/// The same, and how it changes along x, y and z.
fn with_slope(corners: &[f32x8; 8], [x, y, z]: &[f32x8; 3]) -> (f32x8, [f32x8; 3]) {
    let rises = [0, 2, 4, 6].map(|low| corners[low + 1] - corners[low]);
    let [a, b, c, d] = [0, 1, 2, 3].map(|at| corners[2 * at] + rises[at] * *x);
    let along_x = lerp(lerp(rises[0], rises[1], *y), lerp(rises[2], rises[3], *y), *z);
    let (low, high) = (a + (b - a) * *y, c + (d - c) * *y);
    let along_y = lerp(b - a, d - c, *z);
    (low + (high - low) * *z, [along_x, along_y, high - low])
}

/// The places of a cube's texels, x changing fastest.
fn places(edge: usize) -> impl Iterator<Item = [usize; 3]> {
    (0..edge.pow(3)).map(move |index| [index % edge, index / edge % edge, index / (edge * edge)])
}

/// A cube of half the edge.
fn halved(cube: &[u32], edge: usize) -> Vec<u32> {
    let mean = |[x, y, z]: [usize; 3]| {
        let eight = (0..8).map(|corner| {
            let [x, y, z] =
                [2 * x + (corner & 1), 2 * y + (corner >> 1 & 1), 2 * z + (corner >> 2)];
            cube[x + edge * (y + edge * z)]
        });
        let mut sums = [4; 3];
        for texel in eight {
            for (sum, byte) in sums.iter_mut().zip(texel.to_le_bytes()) {
                *sum += u32::from(byte);
            }
        }
        let [a, b, c] = sums.map(|sum| (sum / 8) as u8);
        u32::from_le_bytes([a, b, c, 0])
    };
    places(edge / 2).map(mean).collect()
}

/// A texel of the largest cube.
fn texel(place: [usize; 3]) -> u32 {
    // The middle of the texel, as a part of the edge.
    let at = place.map(|at| (at as f32 + 0.5) / EDGE as f32);
    let bent: [f32; 3] =
        std::array::from_fn(|axis| at[axis] + 0.05 * (noise(at, 4, 10 + axis as u32) - 0.5));
    let ([near, next], shade) = nearest_two(bent);
    let seam = smooth((next - near) / 0.42);
    let height = seam * (1.0 - 0.45 * near * near);
    let spots = 0.45 * noise(at, 3, 1) + 0.2 * noise(at, 7, 2) + 0.15 * noise(at, 16, 3);
    let mottle = spots + 0.2 * shade;
    let line = |cells: i32, salt: u32, width: f32| {
        let value = 0.75 * noise(bent, cells, salt) + 0.25 * noise(bent, 3 * cells, salt + 1);
        smooth(1.0 - (value - 0.5).abs() / width)
    };
    // Thick ones fade where the spots are dark, fine ones where they are bright.
    let vessel = (line(2, 20, 0.030) * smooth(3.0 * mottle - 0.7))
        .max(0.7 * line(5, 30, 0.040) * smooth(2.2 - 3.0 * mottle));
    let byte = |number: f32| (number.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    u32::from_le_bytes([byte(height), byte(vessel), byte(mottle), 0])
}

/// Distances to the nearest two of points that are scattered one in each cell, in edges of a cell; and a number of the
/// nearest, 0 to 1.
fn nearest_two(at: [f32; 3]) -> ([f32; 2], f32) {
    let at = at.map(|at| at * LOBULES as f32);
    let cell = at.map(|at| at.floor() as i32);
    let (mut two, mut nearest) = ([f32::INFINITY; 2], cell);
    for index in 0..27 {
        let [x, y, z] = [index % 3 - 1, index / 3 % 3 - 1, index / 9 - 1];
        let there = [cell[0] + x, cell[1] + y, cell[2] + z];
        let around = there.map(|cell| cell.rem_euclid(LOBULES));
        let apart = [0, 1, 2].map(|axis: usize| {
            let scattered = 0.15 + 0.7 * unit(hash(around, 40 + axis as u32));
            there[axis] as f32 + scattered - at[axis]
        });
        let distance = apart.iter().map(|part| part * part).sum::<f32>().sqrt();
        if distance < two[0] {
            (two, nearest) = ([distance, two[0]], around);
        } else if distance < two[1] {
            two[1] = distance;
        }
    }
    (two, unit(hash(nearest, 43)))
}

/// Smooth noise with so many cells along the edge, 0 to 1; `at` in edges.
fn noise(at: [f32; 3], cells: i32, salt: u32) -> f32 {
    let at = at.map(|at| at * cells as f32);
    let low = at.map(|at| at.floor() as i32);
    let part: [f32; 3] = std::array::from_fn(|axis| smooth(at[axis] - low[axis] as f32));
    let corner = |number: i32| {
        let offset = [number & 1, number >> 1 & 1, number >> 2];
        unit(hash([0, 1, 2].map(|axis| (low[axis] + offset[axis]).rem_euclid(cells)), salt))
    };
    let along = |from: f32, to: f32, part: f32| from + (to - from) * part;
    let [a, b, c, d] = [0, 2, 4, 6].map(|low| along(corner(low), corner(low + 1), part[0]));
    along(along(a, b, part[1]), along(c, d, part[1]), part[2])
}

/// 0 below 0, 1 above 1, and no edge in between.
fn smooth(number: f32) -> f32 {
    let t = number.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// A number whose bits seem to have nothing to do with the place.
fn hash(place: [i32; 3], salt: u32) -> u32 {
    let mut mixed = salt.wrapping_mul(0x9e37_79b9);
    for number in place {
        // The finaliser of MurmurHash3.
        mixed ^= number as u32;
        mixed = (mixed ^ (mixed >> 16)).wrapping_mul(0x85eb_ca6b);
        mixed = (mixed ^ (mixed >> 13)).wrapping_mul(0xc2b2_ae35);
        mixed ^= mixed >> 16;
    }
    mixed
}

/// 0 to 1, without 1.
fn unit(hash: u32) -> f32 {
    (hash >> 8) as f32 / (1 << 24) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texels(place: [f32; 3], level: usize) -> [f32; 3] {
        let Texels { height, vessel, mottle, .. } =
            Texture::shared().at(place.map(f32x8::splat), level);
        [height, vessel, mottle].map(|eight| eight.to_array()[3])
    }

    #[test]
    fn it_repeats_itself_and_has_no_jumps() {
        for place in [[0.2, 63.9, 30.0], [-17.3, 5.5, 64.0], [100.0, -64.0, 0.0]] {
            let before = texels(place, 0);
            let there = place.map(|at| at + EDGE as f32);
            for (one, other) in before.iter().zip(texels(there, 0)) {
                assert!((one - other).abs() < 1e-3, "{place:?}");
            }
            let beside = place.map(|at| at + 0.01);
            for (one, other) in before.iter().zip(texels(beside, 0)) {
                assert!((one - other).abs() < 0.03, "{place:?}");
            }
        }
    }

    #[test]
    fn its_slope_is_that_of_its_height() {
        let place = [10.3, 20.4, 30.6];
        let found = Texture::shared().at(place.map(f32x8::splat), 0).slope;
        for axis in 0..3 {
            let mut ahead = place;
            ahead[axis] += 0.1;
            let slope = (texels(ahead, 0)[0] - texels(place, 0)[0]) / 0.1;
            assert!((found[axis].to_array()[0] - slope).abs() < 1e-2, "{axis}: {slope}");
        }
    }

    #[test]
    fn what_is_far_away_has_the_same_mean() {
        let mean = |level: usize| {
            let places = places(EDGE >> level).map(|place| {
                texels(place.map(|at| (at as f32 + 0.5) * (1 << level) as f32), level)
            });
            let sum = places.fold([0.0; 3], |sum: [f64; 3], texel| {
                std::array::from_fn(|at| sum[at] + f64::from(texel[at]))
            });
            sum.map(|sum| sum / (EDGE >> level).pow(3) as f64)
        };
        let near = mean(0);
        // Something of everything.
        assert!(near.iter().all(|mean| (0.03..0.97).contains(mean)), "{near:?}");
        for level in 1..LEVELS {
            let far = mean(level);
            for (near, far) in near.iter().zip(far) {
                assert!((near - far).abs() < 0.01, "{level}: {near} and {far}");
            }
        }
    }
}
