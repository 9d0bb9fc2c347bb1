//! Soft bodies against closed forms.

use super::Material;
use super::material::Friction;

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
