//! What soft bodies are made of: rows of `assets/materials.csv` that have a modulus.
//!
//! | symbol | what | from E and ν |
//! |---|---|---|
//! | μ | shear modulus, Pa | E / (2 (1 + ν)) |
//! | λ | Lamé's first parameter, Pa | E ν / ((1 + ν)(1 − 2ν)) |
//! | K | bulk modulus, Pa | E / (3 (1 − 2ν)) |
//!
//! Explicit dynamics is stable while ω Δt < 2 for every mode of the lattice. No mode of a lattice is faster than the
//! fastest of an element by itself (Fried: Bounds on the extremal eigenvalues of the finite element stiffness and mass
//! matrices, J. Sound Vib. 22, 1972). That is breathing: ω = 2 √(3K/ρ) / h, with the edge h of an element. So
//! **Δt < h / √(3K/ρ)**, and what needs more than [`MOST_SUBSTEPS`] to keep to [`COURANT`] of that is refused.

use thiserror::Error;

use crate::sim::world::SUBSTEPS_PER_SECOND;

/// Part of the greatest stable time step that a substep takes. Elements that jaws squeeze are stiffer than at rest and
/// need the difference.
const COURANT: f64 = 0.8;

/// Most substeps in the world's substep of 1/240 s: beyond, another method would be cheaper.
pub const MOST_SUBSTEPS: u32 = 72;

/// Most nodes of a lattice, held by the 16-bit numbers that contacts have for them.
pub const MOST_NODES: usize = u16::MAX as usize;

/// Poisson's ratios that the lattice computes with: beyond, waves of pressure are so fast that substeps are wasted
/// on them.
const POISSON: std::ops::RangeInclusive<f64> = 0.0..=0.47;

/// How fast the deformation of a body dies out, 1/s: the amplitude falls to 1/e in 0.2 s.
const DAMPING: f64 = 10.0;

/// What a soft body is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Its name in the table of materials.
    pub name: String,
    /// Young's modulus E, Pa.
    pub youngs_modulus: f64,
    /// Poisson's ratio ν.
    pub poissons_ratio: f64,
    /// Density ρ, kg/m³.
    pub density: f64,
    /// Friction coefficients.
    pub friction: Friction,
    /// Greatest principal strain (of engineers: stretch − 1) that it bears, where a source has it.
    pub ultimate_strain: Option<f64>,
    /// By how much the shear modulus grows with shear: it is μ (1 + k D), where D is about 1.25 at half thickness. 0 where
    /// no source has it.
    pub stiffening: f64,
    /// How fast deformation dies out, 1/s. The motion of the whole body is not damped.
    pub damping: f64,
}

/// Friction coefficients of a soft body: of the pair, not of one of both.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Friction {
    /// On smooth metal and everything else that has no profile.
    pub smooth: f64,
    /// On profiled jaws.
    pub profiled: f64,
}

/// Why no soft body can be made of a material.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum MaterialError {
    /// The table has no such material, or it has no modulus.
    #[error("{0:?} is no soft material")]
    Unknown(String),
    /// A number is not one that the lattice can compute with.
    #[error("{name}: {what} {value} is not in {allowed}")]
    OutOfRange {
        /// The material's name.
        name: String,
        /// Which number.
        what: &'static str,
        /// The number.
        value: f64,
        /// What it must be.
        allowed: String,
    },
    /// Its lattice has more nodes than contacts can number.
    #[error(
        "{name}: with elements of {spacing} m it has {nodes} nodes, and {MOST_NODES} are the most"
    )]
    TooFine {
        /// The material's name.
        name: String,
        /// Edge of an element, m.
        spacing: f64,
        /// Nodes that it would have.
        nodes: usize,
    },
    /// It is too stiff for its density and for the spacing of the lattice.
    #[error(
        "{name}: with elements of {spacing} m it needs {needed} substeps of 1/240 s, and {MOST_SUBSTEPS} are the most"
    )]
    TooStiff {
        /// The material's name.
        name: String,
        /// Edge of an element, m.
        spacing: f64,
        /// Substeps that it would need.
        needed: u32,
    },
}

impl Material {
    /// A soft material of the table.
    pub fn named(name: &str) -> Result<Self, MaterialError> {
        let unknown = || MaterialError::Unknown(name.into());
        let table = include_str!("../../../../assets/materials.csv");
        let mut rows = table.lines().skip(1).map(|line| line.split(',').collect::<Vec<_>>());
        let row = rows.find(|row| row[0] == name).ok_or_else(unknown)?;
        let number = |column: usize| row[column].parse::<f64>().ok();
        let [Some(density), Some(smooth)] = [number(4), number(5)] else { return Err(unknown()) };
        let [Some(youngs_modulus), Some(poissons_ratio), Some(profiled)] = [8, 9, 10].map(number)
        else {
            return Err(unknown());
        };
        Ok(Self {
            name: name.into(),
            youngs_modulus,
            poissons_ratio,
            density,
            friction: Friction { smooth, profiled },
            ultimate_strain: number(11),
            stiffening: number(12).unwrap_or(0.0),
            damping: DAMPING,
        })
    }

    /// The same material with another Young's modulus, Pa.
    #[must_use]
    pub fn with_modulus(self, youngs_modulus: f64) -> Self {
        Self { youngs_modulus, ..self }
    }

    /// The shear modulus μ, Pa.
    pub fn shear_modulus(&self) -> f64 {
        self.youngs_modulus / (2.0 * (1.0 + self.poissons_ratio))
    }

    /// Lamé's first parameter λ, Pa.
    pub fn lame(&self) -> f64 {
        let nu = self.poissons_ratio;
        self.youngs_modulus * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
    }

    /// The greatest stable time step in a lattice of this `spacing` (m), s.
    fn stable_step(&self, spacing: f64) -> f64 {
        // 3K = E / (1 − 2ν)
        let triple_bulk_modulus = self.youngs_modulus / (1.0 - 2.0 * self.poissons_ratio);
        spacing / (triple_bulk_modulus / self.density).sqrt()
    }

    /// Substeps of the world's substep that it needs in a lattice of this `spacing` (m).
    pub fn substeps(&self, spacing: f64) -> Result<u32, MaterialError> {
        let range = |what, value: f64, allowed: std::ops::RangeInclusive<f64>| {
            let (name, text) = (self.name.clone(), format!("{allowed:?}"));
            let error = MaterialError::OutOfRange { name, what, value, allowed: text };
            if allowed.contains(&value) { Ok(()) } else { Err(error) }
        };
        range("Young's modulus", self.youngs_modulus, 1.0..=1e9)?;
        range("Poisson's ratio", self.poissons_ratio, POISSON)?;
        range("density", self.density, 1.0..=1e5)?;
        range("element's edge", spacing, 1e-4..=0.1)?;
        range("stiffening", self.stiffening, 0.0..=10.0)?;
        range("damping", self.damping, 0.0..=100.0)?;
        let most = COURANT * self.stable_step(spacing);
        let needed = (1.0 / (SUBSTEPS_PER_SECOND * most)).ceil() as u32;
        if needed > MOST_SUBSTEPS {
            return Err(MaterialError::TooStiff { name: self.name.clone(), spacing, needed });
        }
        Ok(needed.max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::super::Form;
    use super::*;

    const SOFT: [&str; 6] = ["fat", "liver", "gallbladder", "phantom", "pad", "gauze"];

    #[test]
    fn every_soft_material_of_the_table_can_be_computed_with_elements_of_4_mm() {
        for name in SOFT {
            let material = Material::named(name).unwrap();
            let substeps = material.substeps(4e-3).unwrap();
            let step = 1.0 / (SUBSTEPS_PER_SECOND * f64::from(substeps));
            assert!(step <= COURANT * material.stable_step(4e-3), "{name}: {substeps}");
        }
        assert_eq!(Material::named("fat").unwrap().substeps(4e-3), Ok(7));
    }

    #[test]
    fn what_is_not_soft_or_too_stiff_or_no_number_is_refused_by_name() {
        for name in ["steel", "velvet", ""] {
            assert_eq!(Material::named(name), Err(MaterialError::Unknown(name.into())));
        }
        let fat = || Material::named("fat").unwrap();
        let refused = fat().with_modulus(5e6).substeps(4e-3).unwrap_err().to_string();
        assert!(refused.contains("fat") && refused.contains("substeps"), "{refused}");
        assert!(Material::named("gallbladder").unwrap().substeps(2e-3).is_err());
        for wrong in [f64::NAN, -1.0, 0.0, f64::INFINITY] {
            assert!(fat().with_modulus(wrong).substeps(4e-3).is_err(), "{wrong}");
            assert!(fat().substeps(wrong).is_err(), "{wrong}");
        }
        assert!(Material { poissons_ratio: 0.4999, ..fat() }.substeps(4e-3).is_err());
        let refused = Form::slab([40, 40, 40], 4e-3, fat()).unwrap_err().to_string();
        assert!(refused.contains("fat") && refused.contains("68921 nodes"), "{refused}");
    }

    #[test]
    fn moduli_are_those_of_the_theory_of_elasticity() {
        let material = Material::named("fat").unwrap().with_modulus(6e3);
        let (mu, lambda) = (material.shear_modulus(), material.lame());
        // E = μ (3λ + 2μ) / (λ + μ), ν = λ / (2 (λ + μ)).
        assert!((mu * (3.0 * lambda + 2.0 * mu) / (lambda + mu) - 6e3).abs() < 1e-6);
        assert!((lambda / (2.0 * (lambda + mu)) - material.poissons_ratio).abs() < 1e-12);
    }
}
