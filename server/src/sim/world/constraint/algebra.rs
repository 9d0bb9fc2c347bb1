//! Vectors of six numbers, and what else of algebra the solver needs.

use rapier3d::glamx::Vec4;
use rapier3d::math::Vector;

/// A linear and an angular vector: a velocity, or what a row makes of one. The fourth numbers are 0.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::sim::world) struct Spatial {
    linear: Vec4,
    angular: Vec4,
}

impl Spatial {
    pub(in crate::sim::world) fn new(linear: Vector, angular: Vector) -> Self {
        Self { linear: linear.extend(0.0), angular: angular.extend(0.0) }
    }

    pub(in crate::sim::world) fn linear(&self) -> Vector {
        self.linear.truncate()
    }

    pub(in crate::sim::world) fn angular(&self) -> Vector {
        self.angular.truncate()
    }

    pub(super) fn add_scaled(&mut self, other: &Self, factor: f32) {
        self.linear += other.linear * factor;
        self.angular += other.angular * factor;
    }

    /// What is to be summed up for the scalar product.
    pub(super) fn products(&self, other: &Self) -> Vec4 {
        self.linear * other.linear + self.angular * other.angular
    }

    pub(super) fn dot(&self, other: &Self) -> f32 {
        sum(self.products(other))
    }
}

/// In the same order on every processor.
pub(super) fn sum(numbers: Vec4) -> f32 {
    (numbers.x + numbers.z) + (numbers.y + numbers.w)
}

/// Mobility up to which a row moves nothing, engine units: that of a ton.
const IMMOVABLE: f32 = 1e-9;

/// Share of the trace's square up to which a determinant counts as 0: ten times what rounding leaves.
const SINGULAR: f32 = 1e-6;

/// 1 / mobility; 0 of what does not move.
pub(super) fn inverse(mobility: f32) -> f32 {
    if mobility > IMMOVABLE { 1.0 / mobility } else { 0.0 }
}

/// The inverse of a symmetric matrix by its diagonal and the number beside it. Where what it stands for moves along one
/// line only, the pseudoinverse.
pub(super) fn inverse_of([one, other, mixed]: [f32; 3]) -> [f32; 3] {
    let determinant = one * other - mixed * mixed;
    let trace = one + other;
    if determinant > SINGULAR * trace * trace {
        let inverse = 1.0 / determinant;
        return [other * inverse, one * inverse, -mixed * inverse];
    }
    let inverse = inverse(trace);
    [one, other, mixed].map(|number| number * inverse * inverse)
}

/// Two directions across another one; a right-handed frame with it (Duff et al. 2017).
pub(super) fn tangents(direction: Vector) -> [Vector; 2] {
    let sign = 1.0_f32.copysign(direction.z);
    let a = -1.0 / (sign + direction.z);
    let b = direction.x * direction.y * a;
    let first =
        Vector::new(1.0 + sign * direction.x * direction.x * a, sign * b, -sign * direction.x);
    [first, direction.cross(first)]
}
