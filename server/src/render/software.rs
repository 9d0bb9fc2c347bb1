//! The renderer that needs nothing but a processor.

use std::cell::Cell;

use rayon::prelude::*;
use wide::f32x8;

use super::Renderer;
use super::camera::Camera;
use super::light::Lamp;
use super::picture::Canvas;
use super::project::{Faces, Projection};
use super::raster::{Bins, LANES, Shown, TILE, Tile};
use super::scene::{BodyNumber, Scene};
use super::shade::{self, Shader};
use super::shadow::{self, ShadowMap};

/// Draws on the calling thread, or on all of the current pool's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Software {
    /// Most pixels of the shadow map along each side, a multiple of 64: it has no more than the picture; 0
    /// for no shadows.
    pub shadow: usize,
    /// Colours are the mean of so many places along each side of a pixel: 1 for none but its middle. With 2, a
    /// pixel whose places all show the same face has the colour of its middle.
    pub samples: usize,
    /// Whether one picture is drawn by many threads: the bytes are the same.
    pub parallel: bool,
}

impl Default for Software {
    fn default() -> Self {
        // Observations are seldom larger; drawing one of 512 took a fifth of a picture of 640×480.
        Self { shadow: 384, samples: 1, parallel: false }
    }
}

impl Software {
    /// For looking at: smooth edges and fine shadows.
    pub fn fine() -> Self {
        Self { shadow: 1024, samples: 3, parallel: true }
    }
}

impl Renderer for Software {
    fn render(&self, scene: &Scene, camera: &Camera, canvas: Canvas<'_>) {
        let size = [camera.intrinsics.width, camera.intrinsics.height];
        assert!(size.iter().all(|pixels| (1..=MOST_PIXELS).contains(pixels)), "1 to 8192 pixels");
        canvas.check(size[0] * size[1]);
        // Taken out, since a thread that waits for others may begin another picture meanwhile.
        let mut scratch = SCRATCH.take().unwrap_or_default();
        self.draw(scene, camera, canvas, &mut scratch);
        SCRATCH.set(Some(scratch));
    }
}

/// Least pixels of a shadow map along a side that is wanted.
const LEAST_SHADOW: usize = 192;

/// Pixels along a side that every number below fits.
const MOST_PIXELS: usize = 8192;

thread_local! {
    static SCRATCH: Cell<Option<Box<Scratch>>> = const { Cell::new(None) };
}

/// Groups of pixels in a row of a tile.
const GROUPS: usize = TILE / LANES;

/// Memory that is kept from picture to picture.
struct Scratch {
    faces: Faces,
    bins: Bins,
    shadow: ShadowMap,
    tile: Tile,
    samples: Vec<f32>,
}

impl Default for Scratch {
    fn default() -> Self {
        Self {
            faces: Faces::default(),
            bins: Bins::default(),
            shadow: ShadowMap::default(),
            tile: Tile::new(),
            samples: Vec::new(),
        }
    }
}

impl Software {
    fn draw(&self, scene: &Scene, camera: &Camera, canvas: Canvas<'_>, scratch: &mut Scratch) {
        let Canvas { mut rgb, depth, mask } = canvas;
        let Scratch { faces, bins, shadow, tile, samples } = scratch;
        let is_far = matches!(scene.light.place, Lamp::Far(_));
        let has_shadow = rgb.is_some() && self.shadow >= TILE && is_far;
        if has_shadow {
            let intrinsics = &camera.intrinsics;
            let size = intrinsics.width.max(intrinsics.height).max(LEAST_SHADOW);
            let size = (size * self.samples.max(1)).min(self.shadow);
            shadow.draw(scene, camera, size.next_multiple_of(TILE), tile);
        }
        let shadow = has_shadow.then_some(&*shadow);
        let several = self.samples.max(1);
        if let Some(rgb) = rgb.as_deref_mut().filter(|_| several > 1) {
            let finer = Camera { intrinsics: camera.intrinsics.finer(several), ..*camera };
            self.draw_mean(scene, &finer, several, rgb, faces, bins, shadow, samples, tile);
        }
        let rgb = rgb.filter(|_| several == 1);
        if rgb.is_none() && depth.is_none() && mask.is_none() {
            return;
        }
        project(scene, camera, rgb.is_some(), faces);
        let size = [camera.intrinsics.width, camera.intrinsics.height];
        bins.sort(size, &faces.faces);
        let shader = Shader::new(scene, camera, faces, shadow);
        let far = camera.far as f32;
        let bands = Bands::of(size, rgb, depth, mask);
        self.each_band(bands, tile, |band, index, tile| {
            let columns = size[0].div_ceil(TILE);
            for tile_index in index * columns..(index + 1) * columns {
                let (origin, list) = bins.tile(tile_index);
                tile.clear(origin, 1.0 / far);
                for number in list {
                    tile.draw(&faces.faces, *number);
                }
                band.write(tile, size[0], far, scene, faces, &shader);
            }
        });
    }

    /// Draws colours as the mean of the finer camera's.
    #[expect(clippy::too_many_arguments, reason = "the parts of the memory that is kept")]
    fn draw_mean(
        &self,
        scene: &Scene,
        finer: &Camera,
        several: usize,
        rgb: &mut [u8],
        faces: &mut Faces,
        bins: &mut Bins,
        shadow: Option<&ShadowMap>,
        samples: &mut Vec<f32>,
        tile: &mut Tile,
    ) {
        project(scene, finer, true, faces);
        let size = [finer.intrinsics.width, finer.intrinsics.height];
        bins.sort(size, &faces.faces);
        let shader = Shader::new(scene, finer, faces, shadow);
        let least = 1.0 / finer.far as f32;
        samples.clear();
        samples.resize(3 * size[0] * size[1], 0.0);
        let bands = samples.chunks_mut(3 * TILE * size[0]).collect();
        self.each_band(bands, tile, |band, index, tile| {
            let columns = size[0].div_ceil(TILE);
            for tile_index in index * columns..(index + 1) * columns {
                let (origin, list) = bins.tile(tile_index);
                tile.clear(origin, least);
                for number in list {
                    tile.draw(&faces.faces, *number);
                }
                for (pair, lines) in band.chunks_mut(6 * size[0]).enumerate() {
                    let mut lines = lines.split_at_mut(3 * size[0]);
                    for pair_of_groups in 0..GROUPS / 2 {
                        let at = [2 * pair, 2 * pair_of_groups];
                        shade_square(&shader, tile, at, several == 2, [&mut lines.0, &mut lines.1]);
                    }
                }
            }
        });
        let (width, share) = (size[0] / several, 1.0 / (several * several) as f32);
        for (row, line) in rgb.chunks_exact_mut(3 * width).enumerate() {
            for (column, pixel) in line.chunks_exact_mut(3).enumerate() {
                let mut sum = [0.0; 3];
                for below in 0..several {
                    let first = 3 * ((row * several + below) * size[0] + column * several);
                    for sample in samples[first..][..3 * several].chunks_exact(3) {
                        sum = std::array::from_fn(|channel| sum[channel] + sample[channel]);
                    }
                }
                pixel.copy_from_slice(&sum.map(|light| shade::byte(light * share)));
            }
        }
    }

    /// Does something with each band of tiles, and its number.
    fn each_band<B: Send>(
        &self,
        bands: Vec<B>,
        tile: &mut Tile,
        work: impl Fn(&mut B, usize, &mut Tile) + Sync,
    ) {
        if self.parallel {
            let fresh = || Box::new(Tile::new());
            let bands = bands.into_par_iter().enumerate();
            bands.for_each_init(fresh, |tile, (index, mut band)| work(&mut band, index, tile));
        } else {
            for (index, mut band) in bands.into_iter().enumerate() {
                work(&mut band, index, tile);
            }
        }
    }
}

/// Shades two rows of two groups of a tile from a row and a group on, and writes their light into two lines of the
/// picture. If `in_squares`, four samples of one face are shaded once, in their middle.
fn shade_square(
    shader: &Shader<'_>,
    tile: &Tile,
    [row, group]: [usize; 2],
    in_squares: bool,
    lines: [&mut [f32]; 2],
) {
    let first = 3 * (tile.origin[0] + group * LANES);
    let squares = if in_squares { Shown::squares(tile, row, group) } else { None };
    if let Some(squares) = squares {
        let [red, green, blue] = shader.colours(&squares).map(f32x8::to_array);
        for line in lines {
            let line = line.get_mut(first..).unwrap_or_default();
            for (lane, two) in line.chunks_exact_mut(6).take(LANES).enumerate() {
                let [red, green, blue] = [red[lane], green[lane], blue[lane]];
                two.copy_from_slice(&[red, green, blue, red, green, blue]);
            }
        }
        return;
    }
    for (row, line) in (row..).zip(lines) {
        let line = line.get_mut(first..).unwrap_or_default();
        for (group, eight) in (group..group + 2).zip(line.chunks_mut(3 * LANES)) {
            let [red, green, blue] =
                shader.colours(&Shown::of(tile, row, group)).map(f32x8::to_array);
            for (lane, pixel) in eight.chunks_exact_mut(3).enumerate() {
                pixel.copy_from_slice(&[red[lane], green[lane], blue[lane]]);
            }
        }
    }
}

/// Projects what the camera can see.
fn project(scene: &Scene, camera: &Camera, with_normals: bool, faces: &mut Faces) {
    let intrinsics = &camera.intrinsics;
    let projection = Projection {
        size: [intrinsics.width, intrinsics.height],
        scale: [intrinsics.fx as f32, intrinsics.fy as f32],
        centre: [intrinsics.cx as f32, intrinsics.cy as f32],
        near: Some(camera.near as f32),
    };
    faces.clear();
    let camera_from_world = camera.world_from_camera.inverse();
    // The picture's edges as planes through the lens, with unit normals that point inwards.
    let corner = |column: f64, row: f64| camera.ray(column - 0.5, row - 0.5);
    let (right, low) = (intrinsics.width as f64, intrinsics.height as f64);
    let corners = [corner(0.0, 0.0), corner(right, 0.0), corner(right, low), corner(0.0, low)];
    let sides: [_; 4] =
        std::array::from_fn(|side| corners[side].cross(&corners[(side + 1) % 4]).normalize());
    for (number, instance) in scene.instances().iter().enumerate() {
        let camera_from_mesh = camera_from_world * instance.world_from_mesh;
        let (centre, radius) = instance.ball();
        let centre = camera_from_mesh * centre;
        let is_between = centre.z > camera.near - radius && centre.z < camera.far + radius;
        if is_between && sides.iter().all(|side| side.dot(&centre.coords) > -radius) {
            let turn = shadow::rows(&instance.world_from_mesh, 1.0).map(|[x, y, z, _]| [x, y, z]);
            let turn = with_normals.then_some(&turn);
            let view = shadow::rows(&camera_from_mesh, instance.size);
            let is_painted = with_normals && instance.paint.is_some();
            let rest = instance.rest.as_deref().filter(|_| is_painted);
            faces.add(&instance.mesh, number as u32, &view, turn, rest, &projection);
        }
    }
}

/// The rows of a picture that lie in one row of tiles.
struct Band<'a> {
    rgb: Option<&'a mut [u8]>,
    depth: Option<&'a mut [f32]>,
    mask: Option<&'a mut [BodyNumber]>,
    rows: usize,
}

struct Bands;

impl Bands {
    fn of<'a>(
        [width, height]: [usize; 2],
        rgb: Option<&'a mut [u8]>,
        depth: Option<&'a mut [f32]>,
        mask: Option<&'a mut [BodyNumber]>,
    ) -> Vec<Band<'a>> {
        let mut rgb = rgb.map(|rgb| rgb.chunks_mut(3 * TILE * width));
        let mut depth = depth.map(|depth| depth.chunks_mut(TILE * width));
        let mut mask = mask.map(|mask| mask.chunks_mut(TILE * width));
        let band = |index: usize| Band {
            rgb: rgb.as_mut().and_then(Iterator::next),
            depth: depth.as_mut().and_then(Iterator::next),
            mask: mask.as_mut().and_then(Iterator::next),
            rows: (height - index * TILE).min(TILE),
        };
        (0..height.div_ceil(TILE)).map(band).collect()
    }
}

impl Band<'_> {
    /// Writes what a tile shows.
    fn write(
        &mut self,
        tile: &Tile,
        width: usize,
        far: f32,
        scene: &Scene,
        faces: &Faces,
        shader: &Shader<'_>,
    ) {
        let left = tile.origin[0];
        let columns = (width - left).min(TILE);
        let body = |number: u32| match number.checked_sub(1) {
            Some(face) => {
                let instance = faces.faces[face as usize].instance;
                scene.instances()[instance as usize].body
            }
            None => 0,
        };
        let mut depths = [[0.0; LANES]; GROUPS];
        let mut bodies = [[0; LANES]; GROUPS];
        let mut colours = [[0; 3 * LANES]; GROUPS];
        for row in 0..self.rows {
            for group in 0..columns.div_ceil(LANES) {
                let shown = Shown::of(tile, row, group);
                if self.depth.is_some() {
                    depths[group] = shown.seen.bitselect(shown.depth, f32x8::splat(far)).to_array();
                }
                if self.mask.is_some() {
                    bodies[group] = match shown.faces {
                        [first, ..] if shown.is_one() => [body(first); LANES],
                        faces => faces.map(body),
                    };
                }
                if self.rgb.is_some() {
                    colours[group] = shade::bytes(&shader.colours(&shown));
                }
            }
            let line = row * width + left..row * width + left + columns;
            if let Some(depth) = &mut self.depth {
                depth[line.clone()].copy_from_slice(&depths.as_flattened()[..columns]);
            }
            if let Some(mask) = &mut self.mask {
                mask[line.clone()].copy_from_slice(&bodies.as_flattened()[..columns]);
            }
            if let Some(rgb) = &mut self.rgb {
                let line = 3 * line.start..3 * line.end;
                rgb[line].copy_from_slice(&colours.as_flattened()[..3 * columns]);
            }
        }
    }
}
