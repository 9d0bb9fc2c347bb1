//! Distances from a point to the surface of rigid parts.

use nalgebra::Vector3;

use super::lanes::length;
use crate::sim::world;

/// The form of a part, in a frame in which it lies straight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::sim) enum Shape {
    /// A box by its half extents.
    Cuboid(Vector3<f32>),
    /// Within `radius` of a segment.
    Capsule { a: Vector3<f32>, b: Vector3<f32>, radius: f32 },
    /// About the y axis.
    Cylinder { half_height: f32, radius: f32 },
}

/// How far a point is from a surface, below 0 inside, and the direction out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Gap {
    pub distance: f32,
    pub normal: Vector3<f32>,
}

impl From<&world::Shape> for Shape {
    fn from(shape: &world::Shape) -> Self {
        match *shape {
            world::Shape::Cuboid(half) => Self::Cuboid(half.cast()),
            world::Shape::Capsule { a, b, radius } => {
                Self::Capsule { a: a.coords.cast(), b: b.coords.cast(), radius: radius as f32 }
            }
            world::Shape::Cylinder { half_height, radius } => {
                Self::Cylinder { half_height: half_height as f32, radius: radius as f32 }
            }
        }
    }
}

impl Shape {
    /// The middle and the half extents of the box around it.
    pub(super) fn bounds(&self) -> [Vector3<f32>; 2] {
        match self {
            Self::Cuboid(half) => [Vector3::zeros(), *half],
            Self::Capsule { a, b, radius } => {
                [0.5 * (a + b), 0.5 * (b - a).abs() + Vector3::repeat(*radius)]
            }
            Self::Cylinder { half_height, radius } => {
                [Vector3::zeros(), Vector3::new(*radius, *half_height, *radius)]
            }
        }
    }

    /// Whether the surface has an edge within `reach` of a point that is at it, or is curved as narrowly as that.
    pub(super) fn is_sharp_near(&self, point: &Vector3<f32>, reach: f32) -> bool {
        match self {
            Self::Cuboid(half) => {
                (point.abs() - half).iter().filter(|out| **out > -reach).count() > 1
            }
            Self::Capsule { radius, .. } => *radius < 2.0 * reach,
            Self::Cylinder { half_height, radius } => {
                let across = (point.x * point.x + point.z * point.z).sqrt();
                let is_at_rim = across > radius - reach && point.y.abs() > half_height - reach;
                *radius < 2.0 * reach || is_at_rim
            }
        }
    }

    /// The gap between a point of the part's frame and its surface, where it is less than `reach`.
    #[inline(always)]
    pub(super) fn gap(&self, point: &Vector3<f32>, reach: f32) -> Option<Gap> {
        match self {
            Self::Cuboid(half) => {
                let outside = point.abs() - half;
                if outside.max() > reach {
                    return None;
                }
                box_gap(point, &outside, reach)
            }
            Self::Capsule { a, b, radius } => {
                let (along, from) = (b - a, point - a);
                let length = along.norm_squared();
                let part = if length > 0.0 { from.dot(&along) / length } else { 0.0 };
                let away = from - along * part.clamp(0.0, 1.0);
                let square = away.norm_squared();
                let far = radius + reach;
                if square > far * far {
                    return None;
                }
                let distance = square.sqrt();
                let normal = if distance > 0.0 { away / distance } else { Vector3::x() };
                Some(Gap { distance: distance - radius, normal })
            }
            Self::Cylinder { half_height, radius } => {
                let across = (point.x * point.x + point.z * point.z).sqrt();
                let outward = if across > 0.0 {
                    Vector3::new(point.x / across, 0.0, point.z / across)
                } else {
                    Vector3::x()
                };
                // A box in the plane of the axis and the point.
                let flat = Vector3::new(across, point.y, 0.0);
                let outside = Vector3::new(across - radius, point.y.abs() - half_height, f32::MIN);
                let gap = box_gap(&flat, &outside, reach)?;
                let normal = outward * gap.normal.x + Vector3::y() * gap.normal.y;
                Some(Gap { normal, ..gap })
            }
        }
    }
}

/// The gap to a box beyond whose faces a point is by `outside` (below 0 within), if less than `reach`.
#[inline(always)]
fn box_gap(point: &Vector3<f32>, outside: &Vector3<f32>, reach: f32) -> Option<Gap> {
    let sign = |axis: usize| if point[axis] < 0.0 { -1.0 } else { 1.0 };
    let nearest = outside.imax();
    if outside[nearest] <= 0.0 {
        let mut normal = Vector3::zeros();
        normal[nearest] = sign(nearest);
        return Some(Gap { distance: outside[nearest], normal });
    }
    let away = Vector3::from([0, 1, 2].map(|axis: usize| outside[axis].max(0.0) * sign(axis)));
    let distance = length(&away);
    (distance <= reach).then(|| Gap { distance, normal: away / distance })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_those_of_the_surfaces_and_point_out() {
        let shapes = [
            Shape::Cuboid(Vector3::new(1.0, 2.0, 3.0)),
            Shape::Capsule { a: -Vector3::y() * 2.0, b: Vector3::y(), radius: 1.0 },
            Shape::Cylinder { half_height: 2.0, radius: 1.5 },
        ];
        let mut random = crate::sim::random::Rng::new(1, 0);
        for shape in shapes {
            for _ in 0..2000 {
                let point = Vector3::from_fn(|_, _| random.uniform(-4.0, 4.0) as f32);
                let gap = shape.gap(&point, 10.0).unwrap();
                assert!((gap.normal.norm() - 1.0).abs() < 1e-5);
                // From there straight to the surface it is as far as it says.
                let foot = point - gap.normal * gap.distance;
                let there = shape.gap(&foot, 10.0).unwrap();
                assert!(there.distance.abs() < 1e-4, "{shape:?} {point}: {there:?}");
                assert!(gap.distance < 0.02 || shape.gap(&point, gap.distance - 0.01).is_none());
            }
        }
    }
}
