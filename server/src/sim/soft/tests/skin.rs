//! The skin of carved bodies.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};

use super::super::{Form, Lattice, Material, Skin, box_distance};
use crate::sim::frames::{self, Aabb};

fn fat() -> Material {
    Material::named("fat").unwrap()
}

/// The volume that triangles enclose, m³.
fn volume(points: &[Point3<f64>], triangles: &[[u32; 3]]) -> f64 {
    let tetrahedra = triangles.iter().map(|each| {
        let [a, b, c] = each.map(|vertex| points[vertex as usize].coords);
        a.dot(&b.cross(&c)) / 6.0
    });
    tetrahedra.sum()
}

/// Whether each edge belongs to two triangles, one in each direction.
fn is_closed(triangles: &[[u32; 3]]) -> bool {
    let mut edges: Vec<_> =
        triangles.iter().flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]]).collect();
    edges.sort_unstable();
    let twice = edges.windows(2).any(|pair| pair[0] == pair[1]);
    !twice && edges.iter().all(|[a, b]| edges.binary_search(&[*b, *a]).is_ok())
}

#[test]
fn the_skin_of_a_box_is_the_box_where_its_lattice_is() {
    let half = Vector3::new(0.02, 0.012, 4e-3);
    let bounds = Aabb { min: -half, max: half };
    let form = Form::carved(&bounds, 4e-3, fat(), box_distance(&half)).unwrap();
    let skin = Skin::new(&form, &bounds, 2e-3, box_distance(&half));
    assert!(is_closed(&skin.rest.triangles));
    let there = frames::pose([0.5, 0.1, 0.2], [0.2, 0.3, -1.0]);
    let lattice = Lattice::new(Arc::new(form), &there);
    let (points, normals) = skin.surface(&lattice);
    let distance = box_distance(&half);
    let back = |point: &Point3<f64>| there.inverse() * point;
    assert!(points.iter().all(|point| distance(&back(point)).abs() < 1e-7));
    let enclosed = volume(&points, &skin.rest.triangles);
    assert!((enclosed / (8.0 * half.x * half.y * half.z) - 1.0).abs() < 1e-4, "{enclosed}");
    for (point, normal) in points.iter().zip(&normals) {
        assert!(distance(&back(&(point + normal * 1e-3))) > 5e-4);
    }
    // Samples are a millimetre apart and on the box.
    let area = 8.0 * (half.x * half.y + half.y * half.z + half.z * half.x);
    let samples = &skin.fine.places;
    assert!((samples.len() as f64 * 1e-6 / area - 1.0).abs() < 0.01, "{}", samples.len());
    assert!(samples.iter().all(|place| distance(&back(&lattice.point(place))).abs() < 1e-7));
}

#[test]
fn the_skin_of_a_ball_is_smooth_and_follows_what_the_lattice_does() {
    let radius = 0.012;
    let bounds = Aabb::new([-radius; 3], [radius; 3]);
    let ball = |point: &Point3<f64>| point.coords.norm() - radius;
    let form = Form::carved(&bounds, 3e-3, fat(), ball).unwrap();
    let skin = Skin::new(&form, &bounds, 2e-3, ball);
    assert!(is_closed(&skin.rest.triangles));
    let mut lattice = Lattice::new(Arc::new(form), &frames::pose([0.0; 3], [0.0; 3]));
    let (points, normals) = skin.surface(&lattice);
    for (point, normal) in points.iter().zip(&normals) {
        assert!(ball(point).abs() < 0.15e-3, "{}", ball(point));
        assert!(point.coords.normalize().dot(normal) > 0.97);
    }
    // Linear deformations are exact wherever a point is embedded.
    lattice.displace(|point| Vector3::new(0.1 * point.x + 0.05 * point.z, 0.0, -0.2 * point.y));
    let (moved, _) = skin.surface(&lattice);
    for (point, moved) in points.iter().zip(&moved) {
        let by = Vector3::new(0.1 * point.x + 0.05 * point.z, 0.0, -0.2 * point.y);
        assert!((moved - point - by).norm() < 1e-8);
    }
}
