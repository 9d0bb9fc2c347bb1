//! Soft bodies against closed forms.

use nalgebra::{Point3, Vector3};

use super::material::Friction;
use super::{Lattice, Material};

mod contact;
mod elasticity;
mod skin;

/// A material of these numbers: E in Pa, ν, ρ in kg/m³.
fn material(youngs_modulus: f64, poissons_ratio: f64, density: f64) -> Material {
    Material {
        name: "test".into(),
        youngs_modulus,
        poissons_ratio,
        density,
        friction: Friction { smooth: 0.5, profiled: 0.5 },
        ultimate_strain: None,
        stiffening: 0.0,
        damping: 10.0,
    }
}

impl Lattice {
    /// Gives every node that is not held the velocity that `field` has at its place, m/s.
    fn set_velocity(&mut self, field: impl Fn(&Point3<f64>) -> Vector3<f64>) {
        for node in 0..self.form.grid.nodes() {
            if self.form.inverse_mass[node] > 0.0 {
                let velocity = field(&self.node(node));
                for axis in 0..3 {
                    self.v[axis][node] = velocity[axis] as f32;
                }
            }
        }
    }

    /// Moves every node by what `field` has at its place, m.
    fn displace(&mut self, field: impl Fn(&Point3<f64>) -> Vector3<f64>) {
        for node in 0..self.form.grid.nodes() {
            let by = field(&self.node(node));
            for axis in 0..3 {
                self.x[axis][node] += by[axis] as f32;
            }
        }
    }

    /// Momentum and, about the origin of the world, angular momentum, kg·m/s and kg·m²/s.
    fn momentum(&self) -> [Vector3<f64>; 2] {
        let mut sum = [Vector3::zeros(); 2];
        for node in 0..self.form.grid.nodes() {
            let momentum = self.velocity(node) * f64::from(self.form.mass[node]);
            sum[0] += momentum;
            sum[1] += self.node(node).coords.cross(&momentum);
        }
        sum
    }
}
