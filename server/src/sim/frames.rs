//! Poses and boxes in metres and f64, and their conversion to the engine's scaled f32.
//!
//! Frames are named in the code: `world_from_tip` takes coordinates in the tip frame to
//! coordinates in the world, so that `world_from_base * base_from_tip` checks itself.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rapier3d::math::{Pose as EnginePose, Rotation as EngineRotation, Vector as EngineVector};

use rapier3d::parry::query::details::closest_points_segment_segment_with_locations;
use rapier3d::parry::shape::Segment;

/// A rigid transform, translation in m.
pub type Pose = Isometry3<f64>;

/// Engine lengths per metre. The engine's search for the nearest points of two parts stops where
/// twice the area of a triangle between their features is below 1.1e-3 (parry, `gjk::eps_tol`). In
/// centimetres that is 0.1 mm × 1.1 mm. In metres it is 30 mm × 37 mm, and the edges of jaws would
/// pass through wires. 30 to 1000 behave alike.
pub(super) const SCALE: f64 = 100.0;

/// A pose in a body that is `size` times as large.
pub fn scaled(pose: &Pose, size: f64) -> Pose {
    Pose::from_parts((pose.translation.vector * size).into(), pose.rotation)
}

/// The pose at `position` (m) with the orientation of extrinsic XYZ Euler angles (rad), that is
/// Rz(yaw)·Ry(pitch)·Rx(roll).
pub fn pose(position: [f64; 3], roll_pitch_yaw: [f64; 3]) -> Pose {
    let [roll, pitch, yaw] = roll_pitch_yaw;
    Isometry3::from_parts(
        Translation3::from(Vector3::from(position)),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    )
}

/// The extrinsic XYZ Euler angles (roll, pitch, yaw) of a rotation, rad: R = Rz(yaw)·Ry(pitch)·Rx(roll),
/// roll and yaw in [−π, π[, pitch in [−π/2, π/2]. At a pitch of ±π/2, where only their sum or difference
/// counts, the roll is 0.
pub fn euler_xyz(rotation: &UnitQuaternion<f64>) -> [f64; 3] {
    /// From 1, the sine of a pitch that counts as π/2: further from it than rounding.
    const SINGULAR: f64 = 1e-12;
    /// From π, an angle that counts as it, rad: further from it than rounding.
    const HALF_TURN: f64 = 1e-9;
    let matrix: Rotation3<f64> = rotation.to_rotation_matrix();
    let sine = -matrix[(2, 0)];
    let [roll, pitch, yaw] = if sine.abs() > 1.0 - SINGULAR {
        let yaw = libm::atan2(-matrix[(0, 1)], matrix[(1, 1)]);
        [0.0, FRAC_PI_2.copysign(sine), yaw]
    } else {
        let (roll, pitch, yaw) = matrix.euler_angles();
        [roll, pitch, yaw]
    };
    let wrapped = |angle: f64| if angle > PI - HALF_TURN { -PI } else { angle };
    [wrapped(roll), pitch, wrapped(yaw)]
}

/// Rotation vector (axis times angle, rad) of the shorter of the two arcs that a unit quaternion stands for: the angle is in
/// [0, π]. `q` and `−q` are the same rotation, but the engine reads the angle of `q` from its scalar part and gives up to 2π.
pub(super) fn rotation_vector(rotation: EngineRotation) -> EngineVector {
    let shorter = if rotation.w < 0.0 { -rotation } else { rotation };
    shorter.to_scaled_axis()
}

/// Moves from `start` (0) to `end` (1): straight in position, along the shorter arc in rotation.
pub fn interpolate(start: &Pose, end: &Pose, fraction: f64) -> Pose {
    let translation = start.translation.vector.lerp(&end.translation.vector, fraction);
    let rotation =
        start.rotation.try_slerp(&end.rotation, fraction, 1e-12).unwrap_or(start.rotation); // half a turn in one step: there is no shorter arc
    Isometry3::from_parts(translation.into(), rotation)
}

/// The distance of two segments, given by their ends, m.
pub fn segment_distance(one: &[Point3<f64>; 2], other: &[Point3<f64>; 2]) -> f64 {
    let segment = |ends: &[Point3<f64>; 2]| {
        Segment::new(to_engine_vector(&ends[0].coords), to_engine_vector(&ends[1].coords))
    };
    let (one, other) = (segment(one), segment(other));
    let (at, other_at) =
        closest_points_segment_segment_with_locations(&EnginePose::IDENTITY, &one, &other);
    let between = one.point_at(&at) - other.point_at(&other_at);
    f64::from(between.length()) / SCALE
}

/// An axis-aligned box, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aabb {
    /// Corner with the smallest coordinates.
    pub min: Vector3<f64>,
    /// Corner with the largest coordinates.
    pub max: Vector3<f64>,
}

impl Aabb {
    /// The box from `min` to `max`, m.
    pub const fn new(min: [f64; 3], max: [f64; 3]) -> Self {
        let [x, y, z] = min;
        let min = Vector3::new(x, y, z);
        let [x, y, z] = max;
        Self { min, max: Vector3::new(x, y, z) }
    }

    /// The smallest box around `points`; inside out where there are none.
    pub fn around(points: impl IntoIterator<Item = Point3<f64>>) -> Self {
        let empty = Self::new([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        points.into_iter().fold(empty, |aabb, point| Self {
            min: aabb.min.inf(&point.coords),
            max: aabb.max.sup(&point.coords),
        })
    }

    /// The smallest box around both.
    #[must_use]
    pub fn merged(&self, other: &Self) -> Self {
        Self { min: self.min.inf(&other.min), max: self.max.sup(&other.max) }
    }

    /// The box with every face moved outwards by `margin`, m.
    #[must_use]
    pub fn grown(&self, margin: f64) -> Self {
        let margin = Vector3::repeat(margin);
        Self { min: self.min - margin, max: self.max + margin }
    }

    /// Whether the boxes have a point in common.
    pub fn meets(&self, other: &Self) -> bool {
        (0..3).all(|axis| self.min[axis] <= other.max[axis] && other.min[axis] <= self.max[axis])
    }

    /// The smallest box around this one where it is put by `pose`.
    #[must_use]
    pub fn placed(&self, pose: &Pose) -> Self {
        let centre = pose.transform_point(&self.centre().into()).coords;
        let half = pose.rotation.to_rotation_matrix().matrix().abs() * (0.5 * self.extents());
        Self { min: centre - half, max: centre + half }
    }

    /// The middle.
    pub fn centre(&self) -> Vector3<f64> {
        (self.min + self.max) * 0.5
    }

    /// The lengths of the edges, m.
    pub fn extents(&self) -> Vector3<f64> {
        self.max - self.min
    }

    /// The nearest point of the box.
    pub fn clamp(&self, point: &Vector3<f64>) -> Vector3<f64> {
        point.sup(&self.min).inf(&self.max)
    }

    /// The eight corners.
    pub fn corners(&self) -> impl Iterator<Item = Point3<f64>> + use<> {
        let bounds = [self.min, self.max];
        (0..8).map(move |index: usize| {
            let along = |axis: usize| bounds[index >> axis & 1][axis];
            Point3::new(along(0), along(1), along(2))
        })
    }
}

/// A vector in m (or m/s, …) as the engine's.
pub(super) fn to_engine_vector(vector: &Vector3<f64>) -> EngineVector {
    let scaled = vector * SCALE;
    EngineVector::new(scaled.x as f32, scaled.y as f32, scaled.z as f32)
}

/// The engine's vector in m (or m/s, …).
pub(super) fn from_engine_vector(vector: EngineVector) -> Vector3<f64> {
    Vector3::new(f64::from(vector.x), f64::from(vector.y), f64::from(vector.z)) / SCALE
}

/// A pose as the engine's.
pub(super) fn to_engine(pose: &Pose) -> EnginePose {
    let r = pose.rotation.coords;
    let rotation = EngineRotation::from_xyzw(r.x as f32, r.y as f32, r.z as f32, r.w as f32);
    EnginePose::from_parts(to_engine_vector(&pose.translation.vector), rotation.normalize())
}

/// The engine's pose in m.
pub(super) fn from_engine(pose: &EnginePose) -> Pose {
    let r = pose.rotation;
    let rotation = nalgebra::Quaternion::new(r.w.into(), r.x.into(), r.y.into(), r.z.into());
    Isometry3::from_parts(
        from_engine_vector(pose.translation).into(),
        UnitQuaternion::from_quaternion(rotation),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn euler_angles_make_the_rotation_they_came_from() {
        let angles = [-1.2, 0.4, 2.5];
        let rotation = pose([0.0; 3], angles).rotation;
        for (found, expected) in euler_xyz(&rotation).iter().zip(angles) {
            assert!((found - expected).abs() < 1e-12);
        }
        let x = Rotation3::from_axis_angle(&Vector3::x_axis(), angles[0]);
        let y = Rotation3::from_axis_angle(&Vector3::y_axis(), angles[1]);
        let z = Rotation3::from_axis_angle(&Vector3::z_axis(), angles[2]);
        assert!((z * y * x).angle_to(&rotation.to_rotation_matrix()) < 1e-12);
    }

    #[test]
    fn euler_angles_are_determined_where_the_pitch_is_a_quarter_turn() {
        for pitch in [-FRAC_PI_2, FRAC_PI_2] {
            for rounding in [0.0, 1e-10, -1e-10] {
                let angles = [0.0, pitch + rounding, -1.0];
                let found = euler_xyz(&pose([0.0; 3], angles).rotation);
                for (found, expected) in found.iter().zip(angles) {
                    assert!((found - expected).abs() < 1e-9, "{found} for {expected}");
                }
            }
        }
    }

    #[test]
    fn half_a_turn_has_one_sign_however_it_is_rounded() {
        for rounding in [0.0, 1e-12, -1e-12] {
            let [roll, _, _] = euler_xyz(&pose([0.0; 3], [PI + rounding, 0.3, 1.0]).rotation);
            assert!((roll + PI).abs() < 1e-9, "{roll}");
        }
    }

    #[test]
    fn the_engine_gets_scaled_lengths_and_gives_back_metres() {
        let there = pose([0.55, -0.02, 0.68], [0.1, -0.2, 0.3]);
        let engine = to_engine(&there);
        assert!((engine.translation.x - 55.0).abs() < 1e-5);
        let back = from_engine(&engine);
        assert!((back.translation.vector - there.translation.vector).norm() < 1e-7);
        assert!(back.rotation.angle_to(&there.rotation) < 1e-6);
    }

    #[test]
    fn interpolation_starts_and_ends_at_its_ends() {
        let start = pose([0.0; 3], [0.0, 0.0, 3.0]);
        let end = pose([0.1, 0.0, 0.0], [0.0, 0.0, -3.0]);
        assert!(interpolate(&start, &end, 0.0).rotation.angle_to(&start.rotation) < 1e-9);
        assert!(interpolate(&start, &end, 1.0).rotation.angle_to(&end.rotation) < 1e-9);
        let middle = interpolate(&start, &end, 0.5);
        assert!((middle.translation.x - 0.05).abs() < 1e-15);
        // The shorter arc leads through π, not through 0.
        assert!((middle.rotation.angle() - std::f64::consts::PI).abs() < 1e-9);
    }

    #[test]
    fn segments_are_as_far_apart_as_their_nearest_points() {
        let along = |axis: usize, z: f64| {
            let mut step = Vector3::zeros();
            step[axis] = 0.01;
            [-step, step].map(|end| Point3::new(0.0, 0.0, z) + end)
        };
        assert!((segment_distance(&along(0, 0.0), &along(1, 0.005)) - 0.005).abs() < 1e-8);
        let shifted = along(0, 0.0).map(|end| end + Vector3::new(0.03, 0.0, 0.0));
        assert!((segment_distance(&along(0, 0.0), &shifted) - 0.01).abs() < 1e-8);
    }

    #[test]
    fn boxes_meet_and_clamp() {
        let aabb = Aabb::new([0.0; 3], [1.0; 3]);
        assert!(aabb.meets(&aabb.grown(-0.4)));
        assert!(!aabb.meets(&Aabb::new([1.1, 0.0, 0.0], [2.0; 3])));
        assert_eq!(aabb.clamp(&Vector3::new(2.0, 0.5, -1.0)), Vector3::new(1.0, 0.5, 0.0));
        assert_eq!(Aabb::around(aabb.corners()), aabb);
    }

    #[test]
    fn a_placed_box_is_around_its_corners() {
        let aabb = Aabb::new([-0.3, 0.1, 0.2], [0.1, 0.2, 1.0]);
        let there = pose([0.4, -0.1, 0.2], [0.3, -2.0, 1.0]);
        let placed = aabb.placed(&there);
        let around = Aabb::around(aabb.corners().map(|corner| there * corner));
        assert!(
            (placed.min - around.min).norm() < 1e-12 && (placed.max - around.max).norm() < 1e-12
        );
    }
}
