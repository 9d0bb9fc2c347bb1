//! Damping: deformation dies out, and motion as a whole does not.
//!
//! Two kinds act on velocities relative to those of a rigid body with the same momentum and angular momentum. So a body
//! that flies or spins keeps both. One with nodes that are held is damped against the world in which they are.
//!
//! - In proportion to **mass**: velocities become smaller at the rate of the material. This ends what one sees.
//! - In proportion to **stiffness** K, as in a material of Kelvin and Voigt: elastic forces are those of where nodes will
//!   be a time τ later, f(x + τ v) ≈ f(x) − τ K v. A mode of ω loses τ ω²/2 of its amplitude in a second. This ends
//!   what contacts stir up among neighbours. A mode that one sees hardly feels it.
//!
//! They act in every substep alike: velocities that are scaled down every few substeps only excite the fastest modes.

use nalgebra::{Matrix3, Vector3};

use super::lattice::{Form, Lattice};

/// τ, as a part of the time step. The fastest mode of a lattice then has a damping ratio of 0.08.
pub(super) const VISCOSITY: f64 = 0.1;

/// The part of a velocity that is left after `seconds` at `rate`, 1/s.
pub(super) fn kept(rate: f64, seconds: f32) -> f32 {
    1.0 / (1.0 + rate as f32 * seconds)
}

/// Scales velocities relative to those of a rigid body, or of the world, by `keep`.
#[inline(always)]
pub(super) fn damp(
    form: &Form,
    x: &[Vec<f32>; 3],
    v: &mut [Vec<f32>; 3],
    rigid: Option<&Rigid>,
    keep: f32,
) {
    let Some(rigid) = rigid else {
        v.iter_mut().flatten().for_each(|velocity| *velocity *= keep);
        return;
    };
    let ([x, y, z], [vx, vy, vz]) = (x, v);
    for (node, inverse_mass) in form.inverse_mass.iter().enumerate() {
        if *inverse_mass == 0.0 {
            continue;
        }
        let at = rigid.at([x[node], y[node], z[node]]);
        for (velocity, at) in [&mut vx[node], &mut vy[node], &mut vz[node]].into_iter().zip(at) {
            *velocity = at + keep * (*velocity - at);
        }
    }
}

/// Writes where nodes will be after `lag` (s), as far as they do not move as a rigid body.
#[inline(always)]
pub(super) fn look_ahead(
    x: &[Vec<f32>; 3],
    v: &[Vec<f32>; 3],
    rigid: Option<&Rigid>,
    lag: f32,
    ahead: &mut [Vec<f32>; 3],
) {
    for ((ahead, x), v) in ahead.iter_mut().zip(x).zip(v) {
        ahead.resize(x.len(), 0.0);
        for ((ahead, x), v) in ahead.iter_mut().zip(x).zip(v) {
            *ahead = x + lag * v;
        }
    }
    let Some(rigid) = rigid else { return };
    let [x, y, z] = x;
    let [first, second, third] = ahead;
    for node in 0..x.len() {
        let [a, b, c] = rigid.at([x[node], y[node], z[node]]);
        first[node] -= lag * a;
        second[node] -= lag * b;
        third[node] -= lag * c;
    }
}

/// The motion of a rigid body.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rigid {
    centre: [f32; 3],
    velocity: [f32; 3],
    rate: [f32; 3],
}

impl Rigid {
    /// That with the momenta of a lattice.
    pub(super) fn of(lattice: &Lattice) -> Self {
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
