//! What the endoscope's camera sees of cubes, by geometry alone: no picture is drawn.
//!
//! The picture is square and its coordinates run from −1 to 1, x to the right and y down. The
//! *image axes* of a camera are right, down, forward; dVRK's camera frame is left, up, forward, so
//! they are its x axis and y axis reversed.

use nalgebra::{Matrix2, Point3, UnitQuaternion, Vector2, Vector3};

use crate::sim::frames::Pose;

/// Tangent of half the field of view of 60°. Source: the original.
pub const TAN_HALF_VIEW: f64 = 0.577_350_269_189_625_8;

/// Depth below which nothing is seen, m. Source: the original.
const NEAR: f64 = 0.01;

/// Bound of image coordinates outside of the picture; the picture itself ends at 1.
pub const IMAGE_BOUND: f64 = 2.0;

/// Where on a face of a cube, in halves of its edge, surface samples are: at each pair of these.
const SAMPLES: [f64; 3] = [-0.8, 0.0, 0.8];

/// Area of an outline that counts as nothing, in units of the picture's coordinates.
const NO_AREA: f64 = 1e-12;

/// A cube that can be seen.
#[derive(Debug, Clone, PartialEq)]
pub struct Cube {
    /// Where its centre is (m), turned by `yaw` about the vertical.
    pub centre: Point3<f64>,
    /// Turn about the world's z axis, rad.
    pub yaw: f64,
    /// Length of its edges, m.
    pub edge: f64,
    /// Red, green, blue in 0 to 1.
    pub colour: [f32; 3],
}

impl Cube {
    /// The cube's frame in the world: origin at its centre.
    pub fn world_from_cube(&self) -> Pose {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaw);
        Pose::from_parts(self.centre.into(), turn)
    }

    /// Radius of the sphere around it, m.
    pub fn radius(&self) -> f64 {
        0.5 * self.edge * 3f64.sqrt()
    }
}

/// What is seen of a target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Some sample of its surface is in the picture, and no other cube hides it.
    pub in_view: bool,
    /// Some of its outline is in the picture, hidden or not.
    pub in_picture: bool,
    /// Where it is in the picture: the area centroid of that part of its outline; where it is not
    /// in view the projection of its centre, within ±[`IMAGE_BOUND`].
    pub point: Vector2<f64>,
}

/// A camera at a place.
#[derive(Debug, Clone, Copy)]
pub struct View {
    world_from_camera: Pose,
}

impl View {
    /// The view of a camera (dVRK's frame: left, up, forward).
    pub fn new(world_from_camera: Pose) -> Self {
        Self { world_from_camera }
    }

    /// What is seen of `target` among `others`.
    pub fn sight(&self, target: &Cube, others: &[Cube]) -> Sighting {
        let outline = self.outline(target);
        let in_view = outline.is_some() && self.sees(target, others);
        let point = outline.filter(|_| in_view).unwrap_or_else(|| {
            let centre = self.in_image_axes(&target.centre);
            project(&Vector3::new(centre.x, centre.y, centre.z.max(NEAR)))
                .map(|number| number.clamp(-IMAGE_BOUND, IMAGE_BOUND))
        });
        Sighting { in_view, in_picture: outline.is_some(), point }
    }

    /// Whether all of `cube` is in the picture, hidden or not.
    pub fn holds(&self, cube: &Cube) -> bool {
        let in_picture = |corner: &Vector3<f64>| corner.z > NEAR && project(corner).amax() <= 1.0;
        self.corners(cube).iter().all(in_picture)
    }

    /// A point (m, world frame) in image axes.
    fn in_image_axes(&self, point: &Point3<f64>) -> Vector3<f64> {
        let [x, y, z] = self.world_from_camera.inverse_transform_point(point).coords.into();
        Vector3::new(-x, -y, z)
    }

    /// The corners of `cube` in image axes, numbered by the bits of their indices.
    fn corners(&self, cube: &Cube) -> [Vector3<f64>; 8] {
        let half = 0.5 * cube.edge;
        let world_from_cube = cube.world_from_cube();
        std::array::from_fn(|index| {
            let along = |axis: usize| if index >> axis & 1 == 0 { -half } else { half };
            let corner = world_from_cube * Point3::new(along(0), along(1), along(2));
            self.in_image_axes(&corner)
        })
    }

    /// The area centroid of the part in the picture of the projection of `cube`, a convex polygon.
    fn outline(&self, cube: &Cube) -> Option<Vector2<f64>> {
        let corners = self.corners(cube);
        let mut points: Vec<_> =
            corners.iter().filter(|corner| corner.z > NEAR).map(project).collect();
        if points.is_empty() {
            return None;
        }
        if points.len() < corners.len() {
            points.extend(cut_by_near_plane(&corners).map(|point| project(&point)));
        }
        let whole = points.iter().all(|point| point.amax() <= 1.0);
        let hull = convex_hull(points);
        centroid(&if whole { hull } else { within_picture(hull) })
    }

    /// Whether some sample of the surface of `target` is in the picture and hidden by none of
    /// `others`. The lens is outside of all cubes.
    fn sees(&self, target: &Cube, others: &[Cube]) -> bool {
        let half = 0.5 * target.edge;
        let world_from_target = target.world_from_cube();
        let lens = Point3::from(self.world_from_camera.translation.vector);
        let lens_in_target = world_from_target.inverse_transform_point(&lens);
        (0..3).any(|axis| {
            // Of two faces across an axis, the lens is in front of one, or between both.
            let side = if lens_in_target[axis] > 0.0 { half } else { -half };
            lens_in_target[axis].abs() > half
                && SAMPLES.iter().any(|u| {
                    SAMPLES.iter().any(|v| {
                        let mut sample = Point3::origin();
                        sample[axis] = side;
                        sample[(axis + 1) % 3] = u * half;
                        sample[(axis + 2) % 3] = v * half;
                        let sample = world_from_target * sample;
                        let seen = self.in_image_axes(&sample);
                        seen.z > NEAR
                            && project(&seen).amax() <= 1.0
                            && !others.iter().any(|other| hides(other, &lens, &sample))
                    })
                })
        })
    }
}

/// The picture's turn against the natural line of sight, the view of the camera `reference`, rad in
/// [−π, π]; positive where what is seen appears turned clockwise, and a roll joint turned by as much
/// makes it 0.
///
/// Around the point where the optical axis meets the ground, z = 0, an affine map takes the
/// picture of `camera` to that of `reference`. The angle is that of the rotation in the map's polar
/// decomposition, reversed. Every length of the construction cancels, so that it is finite for a
/// camera that looks above the horizon too.
pub fn misorientation(reference: &Pose, camera: &Pose) -> f64 {
    let axes = |pose: &Pose| {
        let frame = pose.rotation.to_rotation_matrix().into_inner();
        (-frame.column(0), -frame.column(1), frame.column(2).into_owned())
    };
    let (right, down, forward) = axes(camera);
    let height = camera.translation.z;
    // From the reference to the point on the ground, up to a factor that is positive for a camera
    // that looks down.
    let apart = camera.translation.vector - reference.translation.vector;
    let target = forward * height - apart * forward.z;
    // Columns: how the image point moves as the point on the ground goes along the world's x and y,
    // up to positive factors.
    let from_ground = Matrix2::new(right.x, right.y, down.x, down.y);
    let (right, down, forward) = axes(reference);
    let (x, y, depth) = (right.dot(&target), down.dot(&target), forward.dot(&target));
    let reference_from_ground = Matrix2::new(
        depth * right.x - x * forward.x,
        depth * right.y - x * forward.y,
        depth * down.x - y * forward.x,
        depth * down.y - y * forward.y,
    );
    // The inverse, up to a positive factor: seen from above, the ground's axes are mirrored.
    let ground_from =
        Matrix2::new(-from_ground.m22, from_ground.m12, from_ground.m21, -from_ground.m11);
    let map = reference_from_ground * ground_from;
    -libm::atan2(map.m21 - map.m12, map.m11 + map.m22)
}

/// Whether the optical axis of `camera` meets the ground in front of the camera `reference`.
pub fn comparable(reference: &Pose, camera: &Pose) -> bool {
    let forward = camera.rotation * Vector3::z();
    let height = camera.translation.z;
    let apart = camera.translation.vector - reference.translation.vector;
    let target = forward * height - apart * forward.z; // as in `misorientation`
    forward.z < 0.0 && height > 0.0 && (reference.rotation * Vector3::z()).dot(&target) > 0.0
}

/// Image coordinates of a point in image axes in front of the camera.
fn project(point: &Vector3<f64>) -> Vector2<f64> {
    point.xy() / (point.z * TAN_HALF_VIEW)
}

/// The points where edges of a cube with these corners pass through the near plane.
fn cut_by_near_plane(corners: &[Vector3<f64>; 8]) -> impl Iterator<Item = Vector3<f64>> {
    let edges = (0..8).flat_map(|index: usize| (0..3).map(move |axis| (index, index ^ 1 << axis)));
    edges.filter_map(|(behind, ahead)| {
        let (behind, ahead) = (corners[behind], corners[ahead]);
        (behind.z <= NEAR && ahead.z > NEAR)
            .then(|| behind.lerp(&ahead, (NEAR - behind.z) / (ahead.z - behind.z)))
    })
}

/// The corners of the convex hull of `points`, in order around it.
fn convex_hull(mut points: Vec<Vector2<f64>>) -> Vec<Vector2<f64>> {
    points.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let mut hull: Vec<Vector2<f64>> = Vec::with_capacity(points.len() + 1);
    let mut add = |point: Vector2<f64>, least: usize| {
        while hull.len() >= least + 2 {
            let (last, before) = (hull[hull.len() - 1], hull[hull.len() - 2]);
            if (last - before).perp(&(point - before)) > 0.0 {
                break;
            }
            hull.pop();
        }
        hull.push(point);
        hull.len()
    };
    let lower = points.iter().map(|point| add(*point, 0)).last().unwrap_or(0);
    points.iter().rev().skip(1).for_each(|point| {
        add(*point, lower - 1);
    });
    hull.pop(); // the first point again
    hull
}

/// The part of a convex polygon in the picture.
fn within_picture(mut polygon: Vec<Vector2<f64>>) -> Vec<Vector2<f64>> {
    for (axis, side) in [(0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0)] {
        let inside = |point: &Vector2<f64>| 1.0 - side * point[axis];
        let mut kept = Vec::with_capacity(polygon.len() + 1);
        for (index, to) in polygon.iter().enumerate() {
            let from = polygon[(index + polygon.len() - 1) % polygon.len()];
            let (before, now) = (inside(&from), inside(to));
            if (before >= 0.0) != (now >= 0.0) {
                kept.push(from.lerp(to, before / (before - now)));
            }
            if now >= 0.0 {
                kept.push(*to);
            }
        }
        polygon = kept;
    }
    polygon
}

/// The area centroid of a convex polygon; none where it has no area.
fn centroid(polygon: &[Vector2<f64>]) -> Option<Vector2<f64>> {
    let (first, rest) = polygon.split_first()?;
    let (mut area, mut moment) = (0.0, Vector2::zeros());
    for pair in rest.windows(2) {
        let (a, b) = (pair[0] - first, pair[1] - first);
        area += a.perp(&b);
        moment += (a + b) * a.perp(&b);
    }
    (area.abs() > NO_AREA).then(|| first + moment / (3.0 * area))
}

/// Whether `cube` is between two points outside of it.
fn hides(cube: &Cube, from: &Point3<f64>, to: &Point3<f64>) -> bool {
    // Most are far from the line: a sphere tells.
    let (line, centre) = (to - from, cube.centre - from);
    let along = (centre.dot(&line) / line.norm_squared()).clamp(0.0, 1.0);
    if (centre - line * along).norm_squared() > cube.radius() * cube.radius() {
        return false;
    }
    let world_from_cube = cube.world_from_cube();
    let start = world_from_cube.inverse_transform_point(from);
    let line = world_from_cube.inverse_transform_vector(&line);
    let half = 0.5 * cube.edge;
    let (mut enters, mut leaves) = (0.0_f64, 1.0_f64);
    for axis in 0..3 {
        // A line parallel to two faces gives infinities of the right signs.
        let to_face = |face: f64| (face - start[axis]) / line[axis];
        let (one, other) = (to_face(-half), to_face(half));
        enters = enters.max(one.min(other));
        leaves = leaves.min(one.max(other));
    }
    enters < leaves
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use super::*;
    use crate::robots::Ecm;
    use crate::sim::frames;
    use crate::sim::random::Rng;

    fn cube(centre: [f64; 3], yaw: f64) -> Cube {
        Cube { centre: centre.into(), yaw, edge: 0.1, colour: [1.0, 0.0, 0.0] }
    }

    /// 1 m above the origin, looking straight down; the picture's right is the world's x.
    fn from_above() -> View {
        View::new(frames::pose([0.0, 0.0, 1.0], [PI, 0.0, PI]))
    }

    #[test]
    fn right_is_right_and_down_is_down() {
        let view = from_above();
        for (centre, expected) in [([0.2, 0.0, 0.0], [1.0, 0.0]), ([0.0, 0.2, 0.0], [0.0, -1.0])] {
            let point = view.sight(&cube(centre, 0.3), &[]).point;
            assert!(point.dot(&Vector2::from(expected)) > 0.3, "{centre:?}: {point}");
            assert!(point.perp(&Vector2::from(expected)).abs() < 0.01, "{centre:?}: {point}");
        }
    }

    #[test]
    fn a_cube_below_the_lens_is_a_square_in_the_middle() {
        let view = from_above();
        for yaw in [0.0, 0.4, 1.2] {
            let outline = view.outline(&cube([0.0, 0.0, 0.0], yaw)).unwrap();
            assert!(outline.norm() < 1e-12);
        }
        // Its top is 0.95 m away, so that the picture ends 0.5485 m beside its middle.
        assert!(view.holds(&cube([0.498, 0.0, 0.0], 0.0)));
        assert!(!view.holds(&cube([0.499, 0.0, 0.0], 0.0)));
    }

    #[test]
    fn the_centroid_is_that_of_many_points() {
        // The same integral by counting the picture's points that a ray finds inside the cube.
        let mut rng = Rng::new(3, 0);
        for _ in 0..20 {
            let mut within = |low: f64, high: f64| rng.uniform(low, high);
            let target = cube([within(-0.6, 0.6), within(-0.6, 0.6), within(0.0, 0.8)], 0.0);
            let view = from_above();
            let (mut count, mut sum) = (0, Vector2::zeros());
            let side = 400;
            for index in 0..side * side {
                let part = |number: i32| (f64::from(number) + 0.5) / f64::from(side) * 2.0 - 1.0;
                let point = Vector2::new(part(index % side), part(index / side));
                let ray = point * TAN_HALF_VIEW * 3.0;
                let far = view.world_from_camera * Point3::new(-ray.x, -ray.y, 3.0);
                if hides(&target, &Point3::new(0.0, 0.0, 1.0), &far) {
                    count += 1;
                    sum += point;
                }
            }
            match view.outline(&target) {
                None => assert_eq!(count, 0, "{target:?}"),
                Some(outline) if count > 100 => {
                    let off = outline - sum / f64::from(count);
                    assert!(off.norm() < 5e-3, "{target:?}: {off}");
                }
                Some(_) => {}
            }
        }
    }

    #[test]
    fn what_is_behind_the_camera_is_not_seen_and_has_a_bounded_direction() {
        let seen = from_above().sight(&cube([0.1, 0.0, 1.5], 0.0), &[]);
        assert!(!seen.in_view && !seen.in_picture);
        assert!((seen.point - Vector2::new(IMAGE_BOUND, 0.0)).norm() < 1e-9, "{seen:?}");
    }

    #[test]
    fn a_cube_beside_the_lens_is_cut_by_the_near_plane() {
        // From 0.4 m before the lens to 0.4 m behind it, 50 mm to its right: all at the edge.
        let target = Cube { edge: 0.8, ..cube([0.45, 0.0, 1.0], 0.0) };
        let seen = from_above().sight(&target, &[]);
        assert!(seen.in_picture && seen.point.x > 0.2 && seen.point.x < 1.0, "{seen:?}");
        assert!(seen.point.y.abs() < 1e-9);
    }

    #[test]
    fn another_cube_hides_the_target_only_where_it_is_in_between() {
        let (view, target) = (from_above(), cube([0.05, -0.1, 0.05], 0.7));
        let between = Cube { edge: 0.2, ..cube([0.02, -0.04, 0.6], 0.0) };
        let behind = cube([0.05, -0.1, -0.1], 0.0);
        let beside = cube([0.2, -0.1, 0.05], 0.0);
        assert!(view.sight(&target, &[behind.clone(), beside.clone()]).in_view);
        let hidden = view.sight(&target, &[behind, beside, between]);
        assert!(!hidden.in_view && hidden.in_picture);
        let centre = view.in_image_axes(&target.centre);
        assert_eq!(hidden.point, project(&centre));
    }

    /// The misorientation as the original constructs it, with axes of 0.1 mm instead of 0.1 m and
    /// with the rotation of a polar decomposition.
    fn constructed(reference: &Pose, camera: &Pose) -> f64 {
        const AXIS: f64 = 1e-4;
        let forward = camera.rotation * Vector3::z();
        let hit = camera.translation.vector - forward * (camera.translation.z / forward.z);
        let image = |pose: &Pose| {
            let at = |x: f64, y: f64| {
                let point = Point3::from(hit + Vector3::new(x, y, 0.0));
                project(&View::new(*pose).in_image_axes(&point))
            };
            Matrix2::from_columns(&[at(AXIS, 0.0) - at(0.0, 0.0), at(0.0, AXIS) - at(0.0, 0.0)])
        };
        let map = image(reference) * image(camera).try_inverse().unwrap();
        let svd = map.svd(true, true);
        let rotation = svd.u.unwrap() * svd.v_t.unwrap();
        -rotation.m21.atan2(rotation.m11)
    }

    #[test]
    fn misorientation_is_the_polar_rotation_between_the_views() {
        let world_from_base = frames::pose([0.53, 0.0, 0.78], [0.0, 0.5, 0.0])
            * frames::pose([0.0; 3], [0.0, 0.0, -FRAC_PI_2]);
        let at = |joints: [f64; 4]| world_from_base * Ecm::CLASSIC.base_from_camera(&joints);
        let reference = at([0.0; 4]);
        assert!(misorientation(&reference, &reference).abs() < 1e-12);
        let mut rng = Rng::new(1, 0);
        for _ in 0..200 {
            let mut within = |bound: f64| rng.uniform(-bound, bound);
            let joints = [within(0.8), within(0.5), 0.12 + within(0.12), within(0.8)];
            let found = misorientation(&reference, &at(joints));
            let expected = constructed(&reference, &at(joints));
            assert!((found - expected).abs() < 1e-3, "{joints:?}: {found} {expected}");
            // The roll joint takes off what it turns by, and so can bring it to nothing.
            let turned = at([joints[0], joints[1], joints[2], joints[3] + found]);
            assert!(misorientation(&reference, &turned).abs() < 1e-9);
        }
    }

    #[test]
    fn misorientation_is_a_number_for_every_direction() {
        let reference = frames::pose([0.5, 0.0, 0.75], [PI, 0.5, 0.0]);
        for step in 0..400 {
            let angles = [f64::from(step % 20), f64::from(step / 20), 0.3].map(|part| part * 0.314);
            let camera = frames::pose([0.5, 0.1, 0.7], angles);
            assert!(misorientation(&reference, &camera).abs() <= PI);
        }
    }
}
