//! Elastic forces of the lattice.
//!
//! Stable neo-Hookean material (Smith, de Goes, Kim: Stable Neo-Hookean Flesh Simulation, ACM TOG 2018), shifted so that
//! small strains follow Hooke's law with E and ν. With the deformation gradient F, its cofactor matrix C and
//! J = det F:
//!
//! ```text
//! Ψ = μ/2 (|F|² − 3) − μ (J − 1) + λ'/2 (J − 1)²       λ' = λ + μ
//! P = ∂Ψ/∂F = μ F + (λ' (J − 1) − μ) C
//! ```
//!
//! Materials that stiffen as they are sheared have μ (1 + k D) in place of μ, which adds μ k/4 D² to Ψ, with
//! D = max(0, |F|² − 1 − 2J). D is 0 at rest and grows with the square of strain, so small strains stay Hooke's.
//!
//! No term has a singularity: elements that are turned inside out come back.
//!
//! A hexahedron of edge h has one point of integration (Flanagan, Belytschko: Int. J. Numer. Meth. Eng. 17, 1981). Sums and
//! differences of its corners are seven modes, times 8. The linear ones, x, y and z, divided by 4h are the columns of F.
//! The others, xy, xz, yz and xyz, are hourglass modes, which F does not see. They have a stiffness k of their own:
//! **k = E h / 6** makes bending of a layer of one element exact, and μ h / 6 stands for xyz. k is a number, so
//! turning the element turns its forces. The force on the corner with signs σ is
//!
//! ```text
//! f = −h²/4 · P σ − Σ k_m (q_m / 8) σ_m
//! ```
//!
//! An element that is deformed may be stiffer than at rest. With P = μ F + q C, ∂²Ψ/∂F² has the terms λ' C ⊗ C and
//! 2 μ k (F − C) ⊗ (F − C), and others no greater than μ + |q| |F|. At rest the first has the size 3 λ'. So the sum of
//! all, over 3 λ', is a bound of the tangent stiffness relative to that at rest. In what follows it is the *tangent* of an
//! element. The square of the greatest stable time step is at most as many times shorter than at rest.

use wide::f32x8;

use super::lattice::{Form, LANES};

/// Adds the forces on all nodes, N, of a body whose moduli are `stiffness` times those of its form. Returns the greatest
/// tangent of an element.
pub(super) fn add_forces(
    form: &Form,
    stiffness: f32,
    x: &[Vec<f32>; 3],
    forces: &mut [Vec<f32>; 3],
) -> f32 {
    let h = form.grid.spacing as f32;
    let nu = form.material.poissons_ratio as f32;
    let stiffening = form.material.stiffening as f32;
    // μ / (λ + μ) = 1 − 2ν
    let ratio = 1.0 - 2.0 * nu;
    let splat = |number: f32| f32x8::from([number; LANES]);
    let constants = Constants {
        stiffness: splat(stiffness),
        stiffening: splat(stiffening),
        stiffening_tangent: splat(2.0 * stiffening * ratio),
        curved_at_rest: splat(ratio * (1.0 + f32::sqrt(3.0))),
        gradient: splat(1.0 / (4.0 * h)),
        area: splat(-h * h / 4.0),
        // E = 2 μ (1 + ν); modes are 8 times their amplitude.
        bending: splat(-2.0 * (1.0 + nu) * h / 48.0),
        twisting: splat(-h / 48.0),
    };
    let [_, row, layer] = form.grid.strides();
    let [fx, fy, fz] = forces;
    let forces = [fx.as_mut_slice(), fy.as_mut_slice(), fz.as_mut_slice()];
    let [nx, ny, nz] = &form.grid.cells;
    let mut most = splat(0.0);
    for first in (0..*nz).map(|k| k * layer) {
        let last = first + (ny - 1) * row + nx;
        let mut element = first;
        while element < last {
            // Past the last row of a layer there are elements of the next, or none.
            let count = (last - element).min(LANES);
            let mu = lanes(&form.mu, element, count);
            let lambda = lanes(&form.lambda, element, count);
            let rows = [element, element + row, element + layer, element + layer + row];
            let modes = [0, 1, 2].map(|axis| modes(&x[axis], rows));
            let (force_modes, tangent) = force_modes(&constants, mu, lambda, &modes);
            most = most.max(tangent);
            for axis in 0..3 {
                scatter(forces[axis], rows, &force_modes[axis]);
            }
            element += LANES;
        }
    }
    most.to_array().into_iter().fold(0.0, f32::max) / 3.0
}

/// Numbers that all elements have in common.
struct Constants {
    stiffness: f32x8,
    /// k, and 2 k μ/λ'.
    stiffening: f32x8,
    stiffening_tangent: f32x8,
    /// (μ + |q| |F|) / λ' at rest.
    curved_at_rest: f32x8,
    gradient: f32x8,
    area: f32x8,
    bending: f32x8,
    twisting: f32x8,
}

/// Sums of the eight corners with the signs of x, y, z, xy, xz, yz, xyz.
type Modes = [f32x8; 7];

/// The first `count` lanes of an array from a place on; the others are 0.
#[inline]
fn lanes(numbers: &[f32], first: usize, count: usize) -> f32x8 {
    if count == LANES {
        return load(numbers, first);
    }
    let mut lanes = [0.0; LANES];
    lanes[..count].copy_from_slice(&numbers[first..first + count]);
    f32x8::from(lanes)
}

#[inline]
fn load(numbers: &[f32], first: usize) -> f32x8 {
    let lanes: &[f32; LANES] = numbers[first..first + LANES].try_into().expect("eight lanes");
    f32x8::from(*lanes)
}

#[inline]
fn modes(x: &[f32], rows: [usize; 4]) -> Modes {
    // Along x: sum and difference in each of the four rows of corners.
    let [a, b, c, d] = rows.map(|row| {
        let (first, second) = (load(x, row), load(x, row + 1));
        [first + second, second - first]
    });
    // Along y: lower and upper layer.
    let along_y = |near: [f32x8; 2], far: [f32x8; 2]| {
        [near[0] + far[0], far[0] - near[0], near[1] + far[1], far[1] - near[1]]
    };
    let (lower, upper) = (along_y(a, b), along_y(c, d));
    let [sum_lower, y_lower, x_lower, xy_lower] = lower;
    let [sum_upper, y_upper, x_upper, xy_upper] = upper;
    [
        x_lower + x_upper,
        y_lower + y_upper,
        sum_upper - sum_lower,
        xy_lower + xy_upper,
        x_upper - x_lower,
        y_upper - y_lower,
        xy_upper - xy_lower,
    ]
}

/// The coefficients of the forces' modes, of each component; and three times the tangent.
#[inline]
fn force_modes(
    constants: &Constants,
    mu: f32x8,
    lambda: f32x8,
    modes: &[Modes; 3],
) -> ([Modes; 3], f32x8) {
    let one = f32x8::from([1.0; LANES]);
    let (mu, lambda) = (mu * constants.stiffness, lambda * constants.stiffness);
    let [a, b, c] = [0, 1, 2]
        .map(|component| [0, 1, 2].map(|axis: usize| modes[component][axis] * constants.gradient));
    let cofactors = [cross(b, c), cross(c, a), cross(a, b)];
    let det = a[0] * cofactors[0][0] + a[1] * cofactors[0][1] + a[2] * cofactors[0][2];
    let zero = f32x8::from([0.0; LANES]);
    let square = |rows: [[f32x8; 3]; 3]| {
        let [p, q, r] = rows.map(|row| row[0] * row[0] + row[1] * row[1] + row[2] * row[2]);
        p + q + r
    };
    let (f_square, c_square) = (square([a, b, c]), square(cofactors));
    let sheared = (f_square - one - det - det).max(zero);
    let (bending, twisting) = (constants.bending * mu, constants.twisting * mu);
    let mu = mu * (one + constants.stiffening * sheared);
    let pressure = lambda * (det - one) - mu;
    // |F − C|² = |F|² − 6 J + |C|². Nothing is stiff where there is no element.
    let six = f32x8::from([6.0; LANES]);
    let tangent = c_square + constants.stiffening_tangent * (f_square - six * det + c_square);
    let curved = (mu + pressure.abs() * f_square.sqrt()) / lambda;
    let tangent = tangent + (curved - constants.curved_at_rest).max(zero);
    let tangent = lambda.simd_gt(zero).select(tangent, zero);
    let gradient = [a, b, c];
    let force_modes = [0, 1, 2].map(|component: usize| {
        let stress = |axis: usize| {
            let stress = mu * gradient[component][axis] + pressure * cofactors[component][axis];
            stress * constants.area
        };
        let hourglass = &modes[component];
        [
            stress(0),
            stress(1),
            stress(2),
            bending * hourglass[3],
            bending * hourglass[4],
            bending * hourglass[5],
            twisting * hourglass[6],
        ]
    });
    (force_modes, tangent)
}

#[inline]
fn cross(a: [f32x8; 3], b: [f32x8; 3]) -> [f32x8; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Adds to each corner the sum of modes with its signs.
#[inline]
fn scatter(forces: &mut [f32], rows: [usize; 4], modes: &Modes) {
    let [x, y, z, xy, xz, yz, xyz] = *modes;
    // Along z: what is multiplied by the sign along x, and what is not, each with both signs along y.
    let layer = |z: f32x8, x: f32x8, y: f32x8, xy: f32x8| [[z - y, x - xy], [z + y, x + xy]];
    let zero = f32x8::from([0.0; LANES]);
    let lower = layer(zero - z, x - xz, y - yz, xy - xyz);
    let upper = layer(z, x + xz, y + yz, xy + xyz);
    for (row, [even, odd]) in rows.into_iter().zip(lower.into_iter().chain(upper)) {
        add(forces, row, even - odd);
        add(forces, row + 1, even + odd);
    }
}

#[inline]
fn add(forces: &mut [f32], first: usize, by: f32x8) {
    let lanes: &mut [f32; LANES] =
        (&mut forces[first..first + LANES]).try_into().expect("eight lanes");
    *lanes = (f32x8::from(*lanes) + by).to_array();
}
