//! Where the lamp's light is stopped: the depth of the nearest surface from the lamp, in a square picture of
//! the stage.

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use wide::f32x8;

use super::camera::Camera;
use super::light::Lamp;
use super::project::{Faces, Projection};
use super::raster::{Bins, LANES, TILE, Tile};
use super::scene::Scene;
use crate::sim::frames::{Aabb, Pose};

/// How far surfaces are taken to be above themselves, in pixels of the shadow map: what is smaller than a
/// pixel does not shade itself.
const OFFSET: f64 = 1.6;

/// The key of where nothing stops the light.
const NOTHING: f32 = f32::NEG_INFINITY;

/// The lamp's picture. Kept from picture to picture for its memory.
#[derive(Debug, Default)]
pub(super) struct ShadowMap {
    /// Pixels along each side.
    size: usize,
    /// Keys of the nearest surfaces; minus the depth from the lamp.
    keys: Vec<f32>,
    faces: Faces,
    bins: Bins,
    lookup: Lookup,
}

/// How places of the world lie in the map.
#[derive(Debug, Default, Clone, Copy)]
struct Lookup {
    /// Rows for column, row and key: of x, y, z, 1 in m of the world.
    rows: [[f32; 4]; 3],
    /// Distance by which surfaces are raised along their normal, m.
    raised: f32,
}

impl ShadowMap {
    /// Draws what the lamp sees of what `camera` can see of the stage. `size` is a multiple of [`TILE`].
    pub(super) fn draw(&mut self, scene: &Scene, camera: &Camera, size: usize, tile: &mut Tile) {
        self.size = size;
        let lamp_from_world = match &scene.light.place {
            Lamp::Far(direction) => lamp_from_world(direction),
            Lamp::AtEndoscope => return,
        };
        let region = region(scene, camera, &lamp_from_world);
        let (middle, extents) = (region.centre(), region.extents());
        // A little more than the region, so that the edges can be blurred.
        let pixel = extents.x.max(extents.y) / (size as f64 - 4.0);
        let half = 0.5 * size as f64 - 0.5;
        let projection = Projection {
            size: [size; 2],
            scale: [(1.0 / pixel) as f32; 2],
            centre: [half as f32; 2],
            near: None,
        };
        let shift = Vector3::new(middle.x, middle.y, region.min.z);
        let lamp_from_world = Pose::from(-shift) * lamp_from_world;
        self.faces.clear();
        for (number, instance) in scene.instances().iter().enumerate() {
            let lamp_from_mesh = lamp_from_world * instance.world_from_mesh;
            let (centre, radius) = instance.ball();
            let centre = lamp_from_mesh * centre;
            let reach = half * pixel + radius;
            if centre.x.abs() < reach && centre.y.abs() < reach {
                let view = rows(&lamp_from_mesh, instance.size);
                self.faces.add(&instance.mesh, number as u32, &view, None, None, &projection);
            }
        }
        self.bins.sort(projection.size, &self.faces.faces);
        self.keys.clear();
        self.keys.resize(size * size, NOTHING);
        for index in 0..self.bins.len() {
            let (origin, list) = self.bins.tile(index);
            if list.is_empty() {
                continue;
            }
            tile.clear(origin, NOTHING);
            for number in list {
                tile.draw_keys(&self.faces.faces[*number as usize]);
            }
            for row in 0..TILE {
                let line = &mut self.keys[(origin[1] + row) * size + origin[0]..][..TILE];
                for (group, eight) in line.chunks_exact_mut(LANES).enumerate() {
                    eight.copy_from_slice(tile.keys(row, group).as_array());
                }
            }
        }
        let world = rows(&lamp_from_world, 1.0);
        let to_pixel = |row: [f32; 4]| {
            let mut row = row.map(|number| number * (1.0 / pixel) as f32);
            row[3] += half as f32;
            row
        };
        self.lookup = Lookup {
            rows: [to_pixel(world[0]), to_pixel(world[1]), world[2].map(|number| -number)],
            raised: (OFFSET * pixel) as f32,
        };
    }

    /// How much of the lamp's light reaches eight places (m) with these unit normals: 0 to 1.
    pub(super) fn light(&self, place: [f32x8; 3], normal: [f32x8; 3]) -> f32x8 {
        let raised = f32x8::splat(self.lookup.raised);
        let [x, y, z] = [0, 1, 2].map(|axis| place[axis] + normal[axis] * raised);
        let [columns, lines, keys] = self.lookup.rows.map(|[a, b, c, d]| {
            f32x8::splat(a) * x + f32x8::splat(b) * y + f32x8::splat(c) * z + f32x8::splat(d)
        });
        let (one, half) = (f32x8::splat(1.0), f32x8::splat(0.5));
        let [first, last] = [1.5, self.size as f32 - 2.5].map(f32x8::splat);
        let is_inside = columns.simd_gt(first)
            & columns.simd_lt(last)
            & lines.simd_gt(first)
            & lines.simd_lt(last);
        // Of the nine pixels about each place, the outer ones count as far as it is near to them.
        let [columns, lines] = [columns, lines].map(|at| at.fast_max(first).fast_min(last) - half);
        let [lefts, tops] = [columns, lines].map(f32x8::fast_trunc_int);
        let [right, low] = [columns - lefts.round_float(), lines - tops.round_float()];
        let (lefts, tops) = (lefts.to_array(), tops.to_array());
        let mut nine = [[[0.0; LANES]; 3]; 3];
        for lane in 0..LANES {
            let left_top = tops[lane] as usize * self.size + lefts[lane] as usize;
            for (row, three) in nine.iter_mut().enumerate() {
                let pixels = &self.keys[left_top + row * self.size..][..3];
                for (key, pixel) in three.iter_mut().zip(pixels) {
                    key[lane] = *pixel;
                }
            }
        }
        let across = [one - right, one, right];
        let down = [one - low, one, low];
        let mut sum = f32x8::splat(0.0);
        for (three, low) in nine.iter().zip(down) {
            let [a, b, c] = [0, 1, 2].map(|at| f32x8::new(three[at]).simd_le(keys) & across[at]);
            sum += (a + b + c) * low;
        }
        is_inside.bitselect(sum * f32x8::splat(0.25), one)
    }
}

/// The lamp's axes: z along its rays.
fn lamp_from_world(towards_lamp: &Vector3<f64>) -> Pose {
    let z = -towards_lamp.normalize();
    let x = Vector3::y().cross(&z).try_normalize(1e-6).unwrap_or_else(Vector3::x);
    let axes = Matrix3::from_columns(&[x, z.cross(&x), z]).transpose();
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Pose::from_parts(Vector3::zeros().into(), turn)
}

/// The box around what the camera can see of the stage, in the lamp's axes; some of it where that is nothing.
fn region(scene: &Scene, camera: &Camera, lamp_from_world: &Pose) -> Aabb {
    let stage = scene.stage.placed(lamp_from_world);
    let corners: Vec<_> = scene.stage.corners().collect();
    let depths = corners.iter().map(|corner| {
        camera.world_from_camera.inverse_transform_point(corner).z.clamp(camera.near, camera.far)
    });
    let (least, most) =
        depths.fold((camera.far, camera.near), |(least, most), z| (z.min(least), z.max(most)));
    let (right, low) = (camera.intrinsics.width as f64, camera.intrinsics.height as f64);
    let seen = [least, most].into_iter().flat_map(|depth| {
        [(0.0, 0.0), (right, 0.0), (0.0, low), (right, low)].map(|(column, row)| {
            let point: Point3<f64> = camera.back_project(column - 0.5, row - 0.5, depth);
            lamp_from_world * point
        })
    });
    let seen = Aabb::around(seen);
    let both = Aabb { min: stage.min.sup(&seen.min), max: stage.max.inf(&seen.max) };
    let is_empty = (0..3).any(|axis| both.min[axis] >= both.max[axis]);
    if is_empty { stage } else { both }
}

/// A pose as rows of numbers for the vertices of a mesh that is `size` times as large.
pub(super) fn rows(pose: &Pose, size: f64) -> [[f32; 4]; 3] {
    let matrix = pose.rotation.to_rotation_matrix();
    let shift = pose.translation.vector;
    std::array::from_fn(|row| {
        let of = |column: usize| (matrix[(row, column)] * size) as f32;
        [of(0), of(1), of(2), shift[row] as f32]
    })
}
