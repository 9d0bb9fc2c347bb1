//! How the mass of bodies is spread.
//!
//! Collision shapes are approximations that overlap; what a model says of its mass comes from its real
//! geometry and density.

use nalgebra::{Matrix3, Point3};
use rapier3d::math::{Matrix as EngineMatrix, Vector as EngineVector};
use rapier3d::prelude::MassProperties;

use super::{BodyId, World};
use crate::sim::frames::{self, SCALE};

/// The mass of a body and how it is spread.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inertia {
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass in the body, m.
    pub centre: Point3<f64>,
    /// Moments of inertia about the centre of mass, along the body's axes, kg·m².
    pub moments: Matrix3<f64>,
}

impl Inertia {
    /// A body of the same density, `size` times as large.
    #[must_use]
    pub fn with_size(self, size: f64) -> Self {
        let volume = size * size * size;
        Self {
            mass: self.mass * volume,
            centre: self.centre * size,
            moments: self.moments * (volume * size * size),
        }
    }

    /// The same body of another density, so that it weighs `mass`, kg.
    #[must_use]
    pub fn with_mass(self, mass: f64) -> Self {
        Self { mass, moments: self.moments * (mass / self.mass), ..self }
    }
}

impl World {
    /// Gives a free body this mass instead of that of its parts.
    pub fn set_inertia(&mut self, body: BodyId, inertia: &Inertia) {
        let body = &mut self.bodies[body.0];
        for handle in body.colliders() {
            self.colliders[*handle].set_mass(0.0);
        }
        let columns = inertia.moments * f64::powi(SCALE, 5);
        let column = |index: usize| {
            let [x, y, z] = columns.column(index).into();
            EngineVector::new(x as f32, y as f32, z as f32)
        };
        let mass = MassProperties::with_inertia_matrix(
            frames::to_engine_vector(&inertia.centre.coords),
            (inertia.mass * f64::powi(SCALE, 3)) as f32,
            EngineMatrix::from_cols(column(0), column(1), column(2)),
        );
        body.set_additional_mass_properties(mass, false);
        body.recompute_mass_properties_from_colliders(&self.colliders);
    }

    /// The mass with which the engine moves a free body.
    pub fn inertia(&self, body: BodyId) -> Inertia {
        let mass = &self.bodies[body.0].mass_properties().local_mprops;
        let moments = mass.reconstruct_inertia_matrix().to_cols_array().map(f64::from);
        Inertia {
            mass: f64::from(mass.mass()) / f64::powi(SCALE, 3),
            centre: frames::from_engine_vector(mass.local_com).into(),
            moments: Matrix3::from_column_slice(&moments) / f64::powi(SCALE, 5),
        }
    }
}
