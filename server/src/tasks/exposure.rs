//! How much of a round target on a plane is exposed: seen from the endoscope, with nothing soft before it.

use std::f64::consts::PI;
use std::sync::LazyLock;

use nalgebra::{Point3, Vector2, Vector3};

use super::theatre;
use crate::robots::ArmModel;
use crate::sim::soft::SoftBody;

/// Points of a target that are looked at, spread evenly.
const POINTS: usize = 64;

/// How far below the eye what casts a shadow must be, m.
const BELOW: f64 = 1e-3;

/// Points on a disc of radius 1, of which each stands for as much of its area: a spiral of golden angles (Vogel: A
/// better way to construct the sunflower head, Math. Biosci. 44, 1979).
static DISC: LazyLock<[Vector2<f64>; POINTS]> = LazyLock::new(|| {
    let golden = PI * (3.0 - libm::sqrt(5.0));
    std::array::from_fn(|index| {
        let radius = libm::sqrt((index as f64 + 0.5) / POINTS as f64);
        let angle = golden * index as f64;
        Vector2::new(radius * libm::cos(angle), radius * libm::sin(angle))
    })
});

/// Where the endoscope is that stands beside PSMs of this generation, between both lenses, scene frame, m.
pub fn eye(model: ArmModel) -> Vector3<f64> {
    let (ecm, world_from_rcm) = theatre::endoscope(model);
    (world_from_rcm * ecm.base_from_camera(&theatre::JOINTS)).translation.vector
}

/// The share of a level disc that no triangle of a soft body's skin hides from `eye`. Instruments hide nothing.
pub fn share(eye: &Vector3<f64>, centre: &Vector3<f64>, radius: f64, body: &SoftBody) -> f64 {
    // Where the line from the eye through each vertex meets the plane, from the centre on, in radii.
    let shadow = |point: Point3<f64>| {
        (point.z < eye.z - BELOW).then(|| {
            let along = (eye.z - centre.z) / (eye.z - point.z);
            let at = eye.xy() + (point.coords.xy() - eye.xy()) * along;
            ((at - centre.xy()) / radius, point.z > centre.z)
        })
    };
    let shadows: Vec<_> = body.skin().points(body.lattice()).into_iter().map(shadow).collect();
    let mut hidden = [false; POINTS];
    for triangle in body.skin().triangles() {
        let [Some(a), Some(b), Some(c)] = triangle.map(|vertex| shadows[vertex as usize]) else {
            continue;
        };
        if !(a.1 || b.1 || c.1) {
            continue;
        }
        let corners = [a.0, b.0, c.0];
        let low = corners[0].inf(&corners[1]).inf(&corners[2]);
        let high = corners[0].sup(&corners[1]).sup(&corners[2]);
        if low.max() > 1.0 || high.min() < -1.0 {
            continue;
        }
        for (hidden, point) in hidden.iter_mut().zip(DISC.iter()) {
            *hidden |= is_inside(point, &corners);
        }
    }
    let seen = hidden.iter().filter(|hidden| !**hidden).count();
    seen as f64 / POINTS as f64
}

/// Whether a point is in a triangle, whichever way round that is.
fn is_inside(point: &Vector2<f64>, corners: &[Vector2<f64>; 3]) -> bool {
    let side =
        |from: usize, to: usize| (corners[to] - corners[from]).perp(&(point - corners[from]));
    let sides = [side(0, 1), side(1, 2), side(2, 0)];
    sides.iter().all(|side| *side >= 0.0) || sides.iter().all(|side| *side <= 0.0)
}
