//! Pinhole cameras as data, in OpenCV's convention.
//!
//! *Axes* of a camera: x to the right in the picture, y down, z forward along the optical axis. *Pixels*:
//! column u and row v from 0, whole numbers at the centres of pixels, so that a picture reaches from
//! −0.5 to width − 0.5. A point (x, y, z) in the camera's axes is seen at
//!
//! ```text
//! u = fx · x / z + cx        v = fy · y / z + cy
//! ```
//!
//! and has the *depth* z, m: the distance along the optical axis, not along the ray. The *extrinsics* are
//! `world_from_camera`; OpenCV's rotation and translation are those of its inverse.

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use crate::sim::frames::Pose;

/// What a camera is like, wherever it stands; in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Columns of the picture.
    pub width: usize,
    /// Rows of the picture.
    pub height: usize,
    /// Focal length along the rows.
    pub fx: f64,
    /// Focal length along the columns.
    pub fy: f64,
    /// Column of the optical axis.
    pub cx: f64,
    /// Row of the optical axis.
    pub cy: f64,
}

impl Intrinsics {
    /// Square pixels and the optical axis in the middle; `view` is the angle from the upper to the lower
    /// edge of the picture, rad.
    pub fn of_view(width: usize, height: usize, view: f64) -> Self {
        let focal = 0.5 * height as f64 / libm::tan(0.5 * view);
        let middle = |pixels: usize| 0.5 * (pixels as f64 - 1.0);
        Self { width, height, fx: focal, fy: focal, cx: middle(width), cy: middle(height) }
    }

    /// OpenCV's camera matrix.
    pub fn matrix(&self) -> Matrix3<f64> {
        Matrix3::new(self.fx, 0.0, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0)
    }

    /// The same view with `factor` times as many pixels each way.
    #[must_use]
    pub fn finer(&self, factor: usize) -> Self {
        let scale = factor as f64;
        let middle = |old: f64| (old + 0.5) * scale - 0.5;
        Self {
            width: self.width * factor,
            height: self.height * factor,
            fx: self.fx * scale,
            fy: self.fy * scale,
            cx: middle(self.cx),
            cy: middle(self.cy),
        }
    }
}

/// A place from which to look, whatever the size of the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Viewpoint {
    /// Where it is: right, down, forward.
    pub world_from_camera: Pose,
    /// Angle from the upper to the lower edge of the picture, rad.
    pub view: f64,
    /// Least depth that is seen, m.
    pub near: f64,
    /// Greatest depth that is seen, m; what nothing is in front of has this depth.
    pub far: f64,
    /// Whether it is there at every moment of every episode.
    pub is_fixed: bool,
}

impl Viewpoint {
    /// From `eye` towards `target`, m, the world's z axis up in the picture; where it looks straight up or
    /// down, the world's x axis is to the right.
    pub fn towards(eye: [f64; 3], target: [f64; 3], view: f64) -> Self {
        let (eye, target) = (Vector3::from(eye), Vector3::from(target));
        let forward = (target - eye).normalize();
        let right = forward.cross(&Vector3::z()).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        let down = forward.cross(&right);
        let axes = Rotation3::from_basis_unchecked(&[right, down, forward]);
        let turn = UnitQuaternion::from_rotation_matrix(&axes);
        let world_from_camera = Pose::from_parts(eye.into(), turn);
        Self { world_from_camera, view, near: 0.05, far: 20.0, is_fixed: true }
    }

    /// The camera here whose picture has so many pixels.
    pub fn camera(&self, width: usize, height: usize) -> Camera {
        Camera {
            intrinsics: Intrinsics::of_view(width, height, self.view),
            world_from_camera: self.world_from_camera,
            near: self.near,
            far: self.far,
        }
    }

    /// The viewpoint moved to the right in its picture, m.
    #[must_use]
    pub fn moved_right(&self, distance: f64) -> Self {
        let aside = Pose::translation(distance, 0.0, 0.0);
        Self { world_from_camera: self.world_from_camera * aside, ..*self }
    }
}

/// A camera at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Its lens and sensor.
    pub intrinsics: Intrinsics,
    /// Where it is: right, down, forward.
    pub world_from_camera: Pose,
    /// Least depth that is seen, m.
    pub near: f64,
    /// Greatest depth that is seen, m.
    pub far: f64,
}

impl Camera {
    /// Column, row (pixels) and depth (m) of a point of the world, m; none where it is not in front of the
    /// camera.
    pub fn project(&self, point: &Point3<f64>) -> Option<[f64; 3]> {
        let Intrinsics { fx, fy, cx, cy, .. } = self.intrinsics;
        let at = self.world_from_camera.inverse_transform_point(point);
        (at.z > 0.0).then(|| [fx * at.x / at.z + cx, fy * at.y / at.z + cy, at.z])
    }

    /// The point of the world (m) at a column and row (pixels) that has this depth (m).
    pub fn back_project(&self, column: f64, row: f64, depth: f64) -> Point3<f64> {
        let ray = self.ray(column, row);
        self.world_from_camera * Point3::from(ray * depth)
    }

    /// The direction of a pixel in the camera's axes: 1 along the optical axis.
    pub fn ray(&self, column: f64, row: f64) -> Vector3<f64> {
        let Intrinsics { fx, fy, cx, cy, .. } = self.intrinsics;
        Vector3::new((column - cx) / fx, (row - cy) / fy, 1.0)
    }
}

/// The rows of OpenCV's [R | t]: what takes points of the world (m) to the axes of the camera.
pub fn extrinsics(world_from_camera: &Pose) -> [[f64; 4]; 3] {
    let camera_from_world = world_from_camera.inverse().to_homogeneous();
    std::array::from_fn(|row| std::array::from_fn(|column| camera_from_world[(row, column)]))
}

/// A camera's pose from that of dVRK's camera frame, whose axes are left, up, forward.
pub fn from_dvrk(world_from_camera: &Pose) -> Pose {
    let half_turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
    world_from_camera * half_turn
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_3;

    use super::*;

    #[test]
    fn what_is_projected_comes_back() {
        let camera =
            Viewpoint::towards([1.0, -0.5, 1.2], [0.4, 0.1, 0.7], FRAC_PI_3).camera(64, 48);
        let point = Point3::new(0.45, 0.05, 0.75);
        let [column, row, depth] = camera.project(&point).unwrap();
        assert!((camera.back_project(column, row, depth) - point).norm() < 1e-12);
        let seen = camera.intrinsics.matrix() * camera.ray(column, row);
        assert!((seen - Vector3::new(column, row, 1.0)).norm() < 1e-9);
        let behind = camera.back_project(column, row, -depth);
        assert_eq!(camera.project(&behind), None);
    }

    #[test]
    fn up_is_up_and_the_target_is_in_the_middle() {
        let camera =
            Viewpoint::towards([1.0, 0.0, 1.0], [0.0, 0.0, 0.5], FRAC_PI_3).camera(101, 51);
        let at = |point: [f64; 3]| camera.project(&Point3::from(point)).unwrap();
        let [column, row, _] = at([0.0, 0.0, 0.5]);
        assert!((column - 50.0).abs() < 1e-9 && (row - 25.0).abs() < 1e-9);
        assert!(at([0.0, 0.0, 0.6])[1] < row);
        // Seen from +x, +y is to the right.
        assert!(at([0.0, 0.1, 0.5])[0] > column);
    }

    #[test]
    fn from_above_the_picture_is_a_map() {
        let camera = Viewpoint::towards([0.2, 0.3, 2.0], [0.2, 0.3, 0.0], FRAC_PI_3).camera(9, 9);
        let at = |x: f64, y: f64| camera.project(&Point3::new(x, y, 1.0)).unwrap();
        assert!((at(0.2, 0.3)[0] - 4.0).abs() < 1e-12 && (at(0.2, 0.3)[1] - 4.0).abs() < 1e-12);
        assert!(at(0.3, 0.3)[0] > 4.5 && at(0.2, 0.4)[1] < 3.5);
        let [column, row, depth] = at(0.5, 0.1);
        assert!(
            (camera.back_project(column, row, depth) - Point3::new(0.5, 0.1, 1.0)).norm() < 1e-12
        );
    }

    #[test]
    fn the_view_reaches_from_the_upper_to_the_lower_edge() {
        let camera = Viewpoint::towards([1.0, 0.0, 0.0], [0.0; 3], FRAC_PI_3).camera(20, 10);
        let angle = |row: f64| camera.ray(9.5, row).y.atan();
        assert!((angle(9.5) - angle(-0.5) - FRAC_PI_3).abs() < 1e-12);
        let finer = Camera { intrinsics: camera.intrinsics.finer(2), ..camera };
        // The four pixels in place of pixel (3, 2) are about its centre.
        assert!((finer.ray(6.5, 4.5) - camera.ray(3.0, 2.0)).norm() < 1e-12);
    }
}
