//! A lattice cut from a form that is given by its distance function.
//!
//! Elements that are partly in the form are as stiff and as heavy as the part that is in it. So masses and
//! stiffness change smoothly with the form, and waves are as fast in such elements as in full ones.

use nalgebra::{Point3, Vector3};

use super::lattice::{Form, Grid};
use super::material::{Material, MaterialError};
use crate::sim::frames::Aabb;

/// Elements of which less is in the form are left out.
const LEAST_FILL: f64 = 0.1;

/// Places along each edge of an element at which the distance is asked for.
const SAMPLES: usize = 4;

impl Form {
    /// The body of the points within `bounds` at which `distance` (m, signed, in the body's frame) is below 0.
    pub fn carved(
        bounds: &Aabb,
        spacing: f64,
        material: Material,
        distance: impl Fn(&Point3<f64>) -> f64,
    ) -> Result<Self, MaterialError> {
        let grid = Grid::around(bounds, spacing);
        Self::new(grid, material, |place| {
            let fill = fill(&grid.node(place), spacing, &distance);
            if fill < LEAST_FILL { 0.0 } else { fill }
        })
    }
}

/// How much of the cube with a corner at `min` and this edge is in the form.
fn fill(min: &Point3<f64>, edge: f64, distance: impl Fn(&Point3<f64>) -> f64) -> f64 {
    let part = edge / SAMPLES as f64;
    let middles = (0..SAMPLES * SAMPLES * SAMPLES).map(|index| {
        let place = [index % SAMPLES, index / SAMPLES % SAMPLES, index / (SAMPLES * SAMPLES)];
        min + Vector3::from(place.map(|count| (count as f64 + 0.5) * part))
    });
    // What a flat face cuts off each part, it cuts off linearly.
    let inside = middles.map(|middle| (0.5 - distance(&middle) / part).clamp(0.0, 1.0));
    inside.sum::<f64>() / (SAMPLES * SAMPLES * SAMPLES) as f64
}

/// Distance to a box around the origin, m, below 0 inside: exact for a form of flat faces.
pub fn box_distance(half: &Vector3<f64>) -> impl Fn(&Point3<f64>) -> f64 + use<> {
    let half = *half;
    move |point| {
        let outside = point.coords.abs() - half;
        outside.map(|out| out.max(0.0)).norm() + outside.max().min(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fat() -> Material {
        Material::named("fat").unwrap()
    }

    #[test]
    fn a_box_between_lattice_planes_has_its_mass() {
        for half in [Vector3::new(0.02, 0.01, 4e-3), Vector3::new(0.021, 0.0113, 3.1e-3)] {
            let bounds = Aabb { min: -half, max: half };
            let form = Form::carved(&bounds, 4e-3, fat(), box_distance(&half)).unwrap();
            let expected = 920.0 * 8.0 * half.x * half.y * half.z;
            assert!((form.mass() / expected - 1.0).abs() < 0.01, "{} of {expected}", form.mass());
        }
    }

    #[test]
    fn a_ball_has_its_mass_and_no_elements_in_corners() {
        let radius = 0.015;
        let bounds = Aabb::new([-radius; 3], [radius; 3]);
        let ball = |point: &Point3<f64>| point.coords.norm() - radius;
        let form = Form::carved(&bounds, 3e-3, fat(), ball).unwrap();
        let expected = 920.0 * 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3);
        assert!((form.mass() / expected - 1.0).abs() < 0.01, "{} of {expected}", form.mass());
        let elements = form.elements().count();
        assert!((500..900).contains(&elements), "{elements} of 1000");
    }
}
