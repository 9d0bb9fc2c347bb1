//! Numbers, places, inertias and forms of a URDF, within the ranges in which the engine can compute.

use std::f64::consts::FRAC_PI_2;
use std::ops::RangeInclusive;

use nalgebra::{Matrix3, Point3, Vector3};
use urdf_rs::Geometry;

use super::ModelError;
use crate::sim::frames::{self, Pose};
use crate::sim::world::{Inertia, Part, Shape};

/// Lengths that a world can be made of, m: 10 µm to 100 m.
const LENGTHS: RangeInclusive<f64> = 1e-5..=100.0;

/// Places, along each axis, m.
const PLACES: RangeInclusive<f64> = -1e3..=1e3;

/// Angles, rad.
const ANGLES: RangeInclusive<f64> = -1e3..=1e3;

/// Masses of what has one, kg: 0.1 mg to 10 t.
const MASSES: RangeInclusive<f64> = 1e-7..=1e4;

/// Moments of inertia, kg·m².
const MOMENTS: RangeInclusive<f64> = 0.0..=1e6;

/// The least principal moment of inertia, as a part of the greatest; and the least radius of gyration, as a part of the
/// length of the body's shapes: the first is that of a rod that is 120 times as long as thick.
const THINNEST: f64 = 1e-4;
const SHORTEST: f64 = 1e-3;

/// An error unless the engine can compute with these numbers.
fn check(what: &str, numbers: &[f64], allowed: &RangeInclusive<f64>) -> Result<(), ModelError> {
    match numbers.iter().find(|number| !allowed.contains(number)) {
        None => Ok(()),
        Some(number) => {
            let (least, most) = (allowed.start(), allowed.end());
            let why = format!("{what} of {number}: allowed is {least} to {most}");
            Err(ModelError::NotAModel(why))
        }
    }
}

/// The inertia of a body whose shapes are together so long, m.
pub(super) fn inertia(inertial: &urdf_rs::Inertial, length: f64) -> Result<Inertia, ModelError> {
    let origin = pose(&inertial.origin)?;
    let urdf_rs::Inertia { ixx, ixy, ixz, iyy, iyz, izz } = inertial.inertia;
    let mass = inertial.mass.value;
    if mass != 0.0 {
        check("mass", &[mass], &MASSES)?;
    }
    let most = *MOMENTS.end();
    check("moment of inertia", &[ixx, iyy, izz], &MOMENTS)?;
    check("product of inertia", &[ixy, ixz, iyz], &(-most..=most))?;
    let moments = Matrix3::new(ixx, ixy, ixz, ixy, iyy, iyz, ixz, iyz, izz);
    let eigen = moments.symmetric_eigen();
    let (least, greatest) = (eigen.eigenvalues.min(), eigen.eigenvalues.max());
    // Written with six digits, moments of thin things may come out a little below 0.
    let slack = THINNEST * greatest;
    check("principal moment of inertia", &[least, greatest], &(-slack..=3.0 * most))?;
    // Without any moment a body does not turn; with one that is next to nothing, its inverse is next to infinite.
    let least_of_all = slack.max(mass * (SHORTEST * length).powi(2));
    let moments = if greatest > 0.0 && least < least_of_all {
        let thickened = eigen.eigenvalues.map(|moment| moment.max(least_of_all));
        eigen.eigenvectors * Matrix3::from_diagonal(&thickened) * eigen.eigenvectors.transpose()
    } else {
        moments
    };
    let turn = origin.rotation.to_rotation_matrix();
    Ok(Inertia {
        mass,
        centre: origin.translation.vector.into(),
        moments: turn.matrix() * moments * turn.matrix().transpose(),
    })
}

/// Where something is that a URDF places.
pub(crate) fn pose(origin: &urdf_rs::Pose) -> Result<Pose, ModelError> {
    check("place", &*origin.xyz, &PLACES)?;
    check("angle", &*origin.rpy, &ANGLES)?;
    Ok(frames::pose(*origin.xyz, *origin.rpy))
}

/// A form at `origin` of its link.
pub(super) fn part(geometry: &Geometry, origin: &urdf_rs::Pose) -> Result<Part, ModelError> {
    let body_from_part = pose(origin)?;
    let shape = match geometry {
        Geometry::Box { size } => {
            check("edge", &**size, &LENGTHS)?;
            Shape::Cuboid(Vector3::from(**size) * 0.5)
        }
        Geometry::Capsule { radius, length } => {
            check("radius", &[*radius], &LENGTHS)?;
            check("length", &[*length], &(0.0..=*LENGTHS.end()))?;
            Shape::Capsule {
                a: Point3::new(0.0, 0.0, -0.5 * length),
                b: Point3::new(0.0, 0.0, 0.5 * length),
                radius: *radius,
            }
        }
        Geometry::Cylinder { radius, length } => {
            check("radius", &[*radius], &LENGTHS)?;
            check("length", &[*length], &LENGTHS)?;
            // A URDF's cylinder lies along z.
            let turned = body_from_part * frames::pose([0.0; 3], [FRAC_PI_2, 0.0, 0.0]);
            let shape = Shape::Cylinder { half_height: 0.5 * length, radius: *radius };
            return Ok(Part { body_from_part: turned, shape });
        }
        other => {
            return Err(ModelError::NotAModel(format!(
                "collision shapes are boxes, capsules and cylinders, not {other:?}"
            )));
        }
    };
    Ok(Part { body_from_part, shape })
}
