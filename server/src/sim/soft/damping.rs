//! Damping: deformation dies out, and motion as a whole does not.
//!
//! Velocities relative to those of a rigid body with the same momentum and angular momentum become smaller at the rate
//! of the material. So a body that flies or spins keeps both momenta. One with nodes that are held is damped
//! against the world in which they are.
//!
//! It acts in every substep alike: velocities that are scaled down every few substeps only excite the fastest modes.

use nalgebra::{Matrix3, Vector3};

use super::lattice::Lattice;

/// The part of a velocity that is left after `seconds` at `rate`, 1/s.
pub(super) fn kept(rate: f64, seconds: f32) -> f32 {
    1.0 / (1.0 + rate as f32 * seconds)
}

/// Lets the deformation of a body that nothing holds die out at `rate` (1/s) for `seconds`.
pub(super) fn damp(lattice: &mut Lattice, rate: f64, seconds: f32) {
    let keep = kept(rate, seconds);
    let rigid = Rigid::of(lattice);
    let [vx, vy, vz] = &mut lattice.v;
    let [x, y, z] = &lattice.x;
    for (node, inverse_mass) in lattice.form.inverse_mass.iter().enumerate() {
        if *inverse_mass == 0.0 {
            continue;
        }
        let at = rigid.at([x[node], y[node], z[node]]);
        for (velocity, at) in [&mut vx[node], &mut vy[node], &mut vz[node]].into_iter().zip(at) {
            *velocity = at + keep * (*velocity - at);
        }
    }
}

/// The motion of a rigid body.
struct Rigid {
    centre: [f32; 3],
    velocity: [f32; 3],
    rate: [f32; 3],
}

impl Rigid {
    /// That with the momenta of a lattice.
    fn of(lattice: &Lattice) -> Self {
        let vector = |numbers: &[Vec<f32>; 3], node: usize| {
            Vector3::new(numbers[0][node], numbers[1][node], numbers[2][node]).cast::<f64>()
        };
        let masses = || lattice.form.mass.iter().map(|mass| f64::from(*mass)).enumerate();
        let mut mass = 0.0;
        let (mut first, mut momentum) = (Vector3::zeros(), Vector3::zeros());
        for (node, each) in masses() {
            mass += each;
            first += each * vector(&lattice.x, node);
            momentum += each * vector(&lattice.v, node);
        }
        let (centre, velocity) = (first / mass, momentum / mass);
        let (mut inertia, mut spin) = (Matrix3::zeros(), Vector3::zeros());
        for (node, each) in masses() {
            let arm = vector(&lattice.x, node) - centre;
            inertia += each * (Matrix3::identity() * arm.norm_squared() - arm * arm.transpose());
            spin += each * arm.cross(&vector(&lattice.v, node));
        }
        let rate = inertia.try_inverse().map_or_else(Vector3::zeros, |inverse| inverse * spin);
        let [centre, velocity, rate] =
            [centre, velocity, rate].map(|vector| vector.cast::<f32>().into());
        Self { centre, velocity, rate }
    }

    #[inline]
    fn at(&self, x: [f32; 3]) -> [f32; 3] {
        let [a, b, c] = [0, 1, 2].map(|axis: usize| x[axis] - self.centre[axis]);
        let [p, q, r] = self.rate;
        let turning = [q * c - r * b, r * a - p * c, p * b - q * a];
        [0, 1, 2].map(|axis: usize| self.velocity[axis] + turning[axis])
    }
}
