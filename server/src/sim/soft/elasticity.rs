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
//! Elements may be t times as thick along z at rest. Then the column of z in F is divided by t, and forces are those of t
//! times the volume: along x and y their area is t h²/4. What resists bending follows from strains as above, and
//! is k t, or k/t for what moves along z.
//!
//! An element that is deformed may be stiffer than at rest. With P = μ F + q C, ∂²Ψ/∂F² has the terms λ' C ⊗ C and
//! 2 μ k (F − C) ⊗ (F − C), and others no greater than μ + |q| |F|. At rest the first has the size 3 λ'. So the sum of
//! all, over 3 λ', is a bound of the tangent stiffness relative to that at rest. In what follows it is the *tangent* of an
//! element. The square of the greatest stable time step is at most as many times shorter than at rest.

use super::lanes::{LANES, Lanes};
use super::lattice::Form;

/// Adds the forces on all nodes, N, of a body whose moduli are `stiffness` times those of its form. Returns the greatest
/// tangent of an element.
pub(super) fn add_forces(
    form: &Form,
    stiffness: f32,
    x: &[Vec<f32>; 3],
    forces: &mut [Vec<f32>; 3],
) -> f32 {
    super::lanes::with_widest_registers!(add_forces_in_lanes(
        form: &Form,
        stiffness: f32,
        x: &[Vec<f32>; 3],
        forces: &mut [Vec<f32>; 3]
    ) -> f32)
}

#[inline(always)]
fn add_forces_in_lanes<L: Lanes>(
    form: &Form,
    stiffness: f32,
    x: &[Vec<f32>; 3],
    forces: &mut [Vec<f32>; 3],
) -> f32 {
    let constants = Constants::new(form, stiffness);
    let [_, row, layer] = form.grid.strides();
    let [nx, ny, nz] = form.grid.cells;
    let mut most = L::splat(0.0);
    for first in (0..nz).map(|k| k * layer) {
        let last = first + (ny - 1) * row + nx;
        let mut element = first;
        while element < last {
            // Past the last row of a layer there are elements of the next, or none.
            let count = last - element;
            let mu = L::first(&form.mu[element..], count);
            let lambda = L::first(&form.lambda[element..], count);
            let rows = [element, element + row, element + layer, element + layer + row];
            let modes = [modes(&x[0], rows), modes(&x[1], rows), modes(&x[2], rows)];
            let (strain, tangent) = Strain::new(&constants, mu, lambda, &modes);
            most = most.max(tangent);
            for axis in 0..3 {
                let modes = strain.force_modes(constants.thinness, axis, &modes[axis]);
                scatter(&mut forces[axis], rows, &modes);
            }
            element += LANES;
        }
    }
    most.numbers().into_iter().fold(0.0, f32::max) / 3.0
}

/// Numbers that all elements have in common.
struct Constants {
    stiffness: f32,
    /// k, and 2 k μ/λ'.
    stiffening: f32,
    stiffening_tangent: f32,
    /// (μ + |q| |F|) / λ' at rest.
    curved_at_rest: f32,
    gradient: f32,
    /// The same along z.
    gradient_z: f32,
    /// 1/t, and its square.
    thinness: [f32; 2],
    area: f32,
    bending: f32,
    twisting: f32,
}

impl Constants {
    fn new(form: &Form, stiffness: f32) -> Self {
        let h = form.grid.spacing as f32;
        let nu = form.material.poissons_ratio as f32;
        let stiffening = form.material.stiffening as f32;
        // μ / (λ + μ) = 1 − 2ν
        let ratio = 1.0 - 2.0 * nu;
        let thinness = 1.0 / form.thickness as f32;
        Self {
            stiffness,
            stiffening,
            stiffening_tangent: 2.0 * stiffening * ratio,
            curved_at_rest: ratio * (1.0 + f32::sqrt(3.0)),
            gradient: 1.0 / (4.0 * h),
            gradient_z: 1.0 / (4.0 * h) * thinness,
            thinness: [thinness, thinness * thinness],
            area: -h * h / 4.0,
            // E = 2 μ (1 + ν); modes are 8 times their amplitude.
            bending: -2.0 * (1.0 + nu) * h / 48.0,
            twisting: -h / 48.0,
        }
    }
}

/// Why there are as many nodes as lanes, and one more.
const PADDED: &str = "lanes past the last element have nodes";

/// Sums of the eight corners with the signs of x, y, z, xy, xz, yz, xyz.
type Modes<L> = [L; 7];

/// Sum and difference of both ends of edges along a row of nodes.
#[inline(always)]
fn ends<L: Lanes>(x: &[f32], row: usize) -> [L; 2] {
    let nodes: &[f32; LANES + 1] = x[row..].first_chunk().expect(PADDED);
    let (first, second) = (L::load(nodes), L::load(&nodes[1..]));
    [first + second, second - first]
}

/// Sums of four corners with the signs of nothing, y, x and xy.
#[inline(always)]
fn face<L: Lanes>(near: [L; 2], far: [L; 2]) -> [L; 4] {
    [near[0] + far[0], far[0] - near[0], near[1] + far[1], far[1] - near[1]]
}

#[inline(always)]
fn modes<L: Lanes>(x: &[f32], rows: [usize; 4]) -> Modes<L> {
    let lower: [L; 4] = face(ends(x, rows[0]), ends(x, rows[1]));
    let upper: [L; 4] = face(ends(x, rows[2]), ends(x, rows[3]));
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

/// How elements are deformed, and with what they resist.
struct Strain<L> {
    /// Rows of F, and of its cofactor matrix.
    gradient: [[L; 3]; 3],
    cofactors: [[L; 3]; 3],
    /// P = `shear` F + `pressure` C, both times the area.
    shear: L,
    pressure: L,
    bending: L,
    twisting: L,
}

impl<L: Lanes> Strain<L> {
    /// That of elements with these modes; and three times their tangents.
    #[inline(always)]
    fn new(constants: &Constants, mu: L, lambda: L, modes: &[Modes<L>; 3]) -> (Self, L) {
        let (mu, lambda) = (mu.times(constants.stiffness), lambda.times(constants.stiffness));
        let scale = [constants.gradient, constants.gradient_z];
        let (a, b, c) = (row(&modes[0], scale), row(&modes[1], scale), row(&modes[2], scale));
        let (p, q, r) = (cross(b, c), cross(c, a), cross(a, b));
        let det = dot(a, p);
        let f_square = dot(a, a) + dot(b, b) + dot(c, c);
        let c_square = dot(p, p) + dot(q, q) + dot(r, r);
        let zero = L::splat(0.0);
        let sheared = (f_square.plus(-1.0) - det - det).max(zero);
        let (bending, twisting) = (mu.times(constants.bending), mu.times(constants.twisting));
        let mu = mu * sheared.times(constants.stiffening).plus(1.0);
        let pressure = lambda * det.plus(-1.0) - mu;
        // |F − C|² = |F|² − 6 J + |C|². Nothing is stiff where there is no element.
        let tangent =
            c_square + (f_square - det.times(6.0) + c_square).times(constants.stiffening_tangent);
        let curved = (mu + pressure.abs() * f_square.sqrt()) / lambda;
        let tangent = tangent + curved.plus(-constants.curved_at_rest).max(zero);
        let tangent = tangent.where_positive(lambda);
        let (shear, pressure) = (mu.times(constants.area), pressure.times(constants.area));
        let (gradient, cofactors) = ([a, b, c], [p, q, r]);
        (Self { gradient, cofactors, shear, pressure, bending, twisting }, tangent)
    }

    /// The coefficients of the forces' modes of a component.
    #[inline(always)]
    fn force_modes(
        &self,
        [thinness, its_square]: [f32; 2],
        component: usize,
        modes: &Modes<L>,
    ) -> Modes<L> {
        let (f, c) = (self.gradient[component], self.cofactors[component]);
        let (bending, twisting) = if component == 2 {
            (self.bending.times(its_square), self.twisting.times(its_square))
        } else {
            (self.bending, self.twisting)
        };
        [
            self.shear * f[0] + self.pressure * c[0],
            self.shear * f[1] + self.pressure * c[1],
            (self.shear * f[2] + self.pressure * c[2]).times(thinness),
            bending * modes[3],
            bending * modes[4],
            bending * modes[5],
            twisting * modes[6],
        ]
    }
}

/// A row of the deformation gradient.
#[inline(always)]
fn row<L: Lanes>(modes: &Modes<L>, [scale, scale_z]: [f32; 2]) -> [L; 3] {
    [modes[0].times(scale), modes[1].times(scale), modes[2].times(scale_z)]
}

#[inline(always)]
fn dot<L: Lanes>(a: [L; 3], b: [L; 3]) -> L {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn cross<L: Lanes>(a: [L; 3], b: [L; 3]) -> [L; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Adds to each corner the sum of modes with its signs.
#[inline(always)]
fn scatter<L: Lanes>(forces: &mut [f32], rows: [usize; 4], modes: &Modes<L>) {
    let [x, y, z, xy, xz, yz, xyz] = *modes;
    // Along z: what is multiplied by the sign along x (odd), and what is not (even), each with both signs along y.
    let (x_lower, xy_lower, y_lower, z_lower) = (x - xz, xy - xyz, y - yz, -z);
    let (x_upper, xy_upper, y_upper, z_upper) = (x + xz, xy + xyz, y + yz, z);
    add_ends(forces, rows[0], z_lower - y_lower, x_lower - xy_lower);
    add_ends(forces, rows[1], z_lower + y_lower, x_lower + xy_lower);
    add_ends(forces, rows[2], z_upper - y_upper, x_upper - xy_upper);
    add_ends(forces, rows[3], z_upper + y_upper, x_upper + xy_upper);
}

/// Adds even − odd to the first ends of edges along a row of nodes, and even + odd to their second ends.
#[inline(always)]
fn add_ends<L: Lanes>(forces: &mut [f32], row: usize, even: L, odd: L) {
    let (first, second) = (even - odd, even + odd);
    let (shifted, last) = second.shifted();
    let nodes: &mut [f32; LANES + 1] = forces[row..].first_chunk_mut().expect(PADDED);
    (L::load(nodes) + first + shifted).store(nodes);
    nodes[LANES] += last;
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::sim::frames::Pose;
    use crate::sim::random::Rng;
    use crate::sim::soft::{Lattice, Material};

    #[test]
    fn narrow_and_wide_registers_give_the_same_bits() {
        let mut rng = Rng::new(3, 0);
        for cells in [[15, 15, 2], [5, 3, 4], [1, 1, 1]] {
            let form = Arc::new(Form::slab(cells, 4e-3, Material::named("fat").unwrap()).unwrap());
            let mut lattice = Lattice::new(form.clone(), &Pose::identity());
            for x in lattice.x.iter_mut().flatten() {
                *x += rng.uniform(-2e-3, 2e-3) as f32;
            }
            let none = || [0, 1, 2].map(|_| vec![0.0; form.mass.len()]);
            let (mut narrow, mut chosen) = (none(), none());
            let stiffest = [
                add_forces_in_lanes::<wide::f32x8>(&form, 0.7, &lattice.x, &mut narrow),
                add_forces(&form, 0.7, &lattice.x, &mut chosen),
            ];
            assert_eq!(stiffest[0].to_bits(), stiffest[1].to_bits());
            let bits = |forces: [Vec<f32>; 3]| {
                forces.map(|each| each.into_iter().map(f32::to_bits).collect::<Vec<_>>())
            };
            assert_eq!(bits(narrow), bits(chosen), "{cells:?}");
        }
    }
}
