//! Where the target is in the endoscope's picture: found by its colour, as on a real endoscope.
//!
//! The picture is the one that the observation `rgb` has at 128 × 128 pixels. Of its pixels those are taken
//! that have the *chromaticity* of the target: the parts that red and green have in their light. How much
//! light a surface gets, whether it lies in the shade or faces away from the lamp, leaves these parts nearly
//! alone; what glints is whiter and is left out. The largest region of such pixels that hang together by
//! their sides is the target, and the mean of its pixels the image point. Other cubes that stand before the
//! target hide pixels, and so move the point, as they do in the original.

use std::sync::LazyLock;

use nalgebra::Vector2;

use super::camera::TAN_HALF_VIEW;
use super::track::TARGET_COLOUR;
use crate::render::{Canvas, Lens, Renderer, Scene, Software, material};

/// Rows and columns of the picture in which the target is sought.
pub const SIZE: usize = 128;

/// Largest distance from the target's chromaticity.
const TOLERANCE: f32 = 0.2;

/// Least sum of red, green and blue light, each 0 to 1: what is darker has no colour to speak of.
const LEAST_LIGHT: f32 = 0.01;

/// Least pixels of a region that counts as seen.
const LEAST_PIXELS: usize = 4;

/// The image point (−1 to 1, x to the right and y down) of the target in the endoscope's picture of `scene`;
/// none where its colour is not seen.
pub fn target(scene: &Scene) -> Option<Vector2<f64>> {
    let camera = scene.camera(Lens::Endoscope, SIZE, SIZE)?;
    let mut rgb = vec![0; 3 * SIZE * SIZE];
    let canvas = Canvas { rgb: Some(&mut rgb), ..Canvas::default() };
    Software::default().render(scene, &camera, canvas);
    let [column, row] = find(&rgb)?;
    let ray = camera.ray(column, row);
    Some(ray.xy() / TAN_HALF_VIEW)
}

/// Column and row of the mean of the largest region that has the target's colour; of several, that which
/// begins first. `rgb`: [`SIZE`] × [`SIZE`] × 3, as pictures store it.
fn find(rgb: &[u8]) -> Option<[f64; 2]> {
    let mut is_left: Vec<bool> = rgb
        .chunks_exact(3)
        .map(|pixel| has_target_colour([pixel[0], pixel[1], pixel[2]]))
        .collect();
    let mut largest = Region::default();
    let mut border = vec![];
    for start in 0..is_left.len() {
        if !std::mem::take(&mut is_left[start]) {
            continue;
        }
        let mut region = Region::default();
        border.push(start);
        while let Some(pixel) = border.pop() {
            let (column, row) = (pixel % SIZE, pixel / SIZE);
            region.pixels += 1;
            region.columns += column;
            region.rows += row;
            let sides = [
                (column > 0).then(|| pixel - 1),
                (column + 1 < SIZE).then_some(pixel + 1),
                (row > 0).then(|| pixel - SIZE),
                (row + 1 < SIZE).then_some(pixel + SIZE),
            ];
            for side in sides.into_iter().flatten() {
                if std::mem::take(&mut is_left[side]) {
                    border.push(side);
                }
            }
        }
        if region.pixels > largest.pixels {
            largest = region;
        }
    }
    (largest.pixels >= LEAST_PIXELS).then(|| {
        let mean = |sum: usize| sum as f64 / largest.pixels as f64;
        [mean(largest.columns), mean(largest.rows)]
    })
}

/// Pixels that hang together: how many, and the sums of their columns and rows.
#[derive(Default)]
struct Region {
    pixels: usize,
    columns: usize,
    rows: usize,
}

/// Whether a pixel, as pictures store it, has the target's chromaticity.
fn has_target_colour(pixel: [u8; 3]) -> bool {
    static LIGHT: LazyLock<[f32; 256]> =
        LazyLock::new(|| std::array::from_fn(|byte| material::linear(byte as f32 / 255.0)));
    static TARGET: LazyLock<[f32; 2]> =
        LazyLock::new(|| chromaticity(TARGET_COLOUR.map(material::linear)));
    let light = pixel.map(|byte| LIGHT[usize::from(byte)]);
    let [red, green] = chromaticity(light);
    let off = [red - TARGET[0], green - TARGET[1]];
    light.iter().sum::<f32>() >= LEAST_LIGHT
        && off[0] * off[0] + off[1] * off[1] <= TOLERANCE * TOLERANCE
}

/// The parts of red and green in light.
fn chromaticity([red, green, blue]: [f32; 3]) -> [f32; 2] {
    let sum = (red + green + blue).max(f32::MIN_POSITIVE);
    [red / sum, green / sum]
}
