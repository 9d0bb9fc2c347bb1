//! The lattice alone: statics, waves, momenta.

use std::f64::consts::PI;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};

use super::super::{Form, Lattice, Material};
use super::material;
use crate::sim::frames::{self, Pose};
use crate::sim::world::{GRAVITY, SUBSTEPS_PER_SECOND};

/// Where [`Form::slab`] has the least coordinates, half a spacing inside.
fn is_at(axis: usize, end: f64) -> impl Fn(&Point3<f64>) -> bool {
    move |point| (point[axis] - end).abs() < 1e-6
}

/// Lets time pass without contacts; `constrain` corrects velocities.
fn run(lattice: &mut Lattice, seconds: f64, gravity: f64, mut constrain: impl FnMut(&mut Lattice)) {
    for _ in 0..(seconds * SUBSTEPS_PER_SECOND).round() as u32 {
        let mut left = 1.0 / SUBSTEPS_PER_SECOND;
        lattice.begin();
        while left > 1e-8 {
            let dt = lattice.find_forces((gravity / GRAVITY) as f32, left);
            lattice.kick(dt);
            constrain(lattice);
            lattice.drift(dt);
            left -= f64::from(dt);
        }
    }
}

#[test]
fn a_hanging_bar_becomes_longer_by_half_its_weight_over_its_stiffness() {
    let (modulus, density, length, gravity) = (5e3, 1000.0, 0.06, 0.5);
    for stiffness in [1.0, 0.5] {
        let material = material(modulus / stiffness, 0.0, density);
        let mut form = Form::slab([2, 2, 20], 3e-3, material).unwrap();
        form.hold(is_at(2, 0.5 * length));
        let mut bar = Lattice::new(Arc::new(form), &Pose::identity());
        bar.soften(stiffness);
        let end = bar.form().grid.index([1, 1, 0]);
        let before = bar.node(end).z;
        run(&mut bar, 3.0, gravity, |_| ());
        let expected = density * gravity * length * length / (2.0 * modulus);
        let error = (before - bar.node(end).z) / expected - 1.0;
        println!("hanging bar, softened to {stiffness}: {:+.3} %", 100.0 * error);
        assert!(error.abs() < 5e-3, "{error}");
    }
}

#[test]
fn a_bar_swings_along_itself_at_the_speed_of_sound_over_four_lengths() {
    let (modulus, density, cells, h) = (5e3, 1000.0, 60, 3e-3);
    let length = cells as f64 * h;
    let undamped = Material { damping: 0.0, ..material(modulus, 0.0, density) };
    let mut form = Form::slab([1, 1, cells], h, undamped).unwrap();
    form.hold(is_at(2, 0.5 * length));
    let mut bar = Lattice::new(Arc::new(form), &Pose::identity());
    bar.displace(|point| {
        Vector3::z() * (1e-4 * libm::sin(0.5 * PI * (0.5 * length - point.z) / length))
    });
    let rest = -0.5 * length;
    let (mut crossings, mut before, mut passed) = (vec![], 1.0, 0.0);
    while crossings.len() < 21 {
        let dt = f64::from(bar.find_forces(0.0, 1.0));
        bar.kick(dt as f32);
        bar.drift(dt as f32);
        passed += dt;
        let now = bar.node(0).z - rest;
        if (now > 0.0) != (before > 0.0) {
            crossings.push(passed - dt * now / (now - before));
        }
        before = now;
    }
    let frequency = 10.0 / (crossings[20] - crossings[0]);
    let expected = (modulus / density).sqrt() / (4.0 * length);
    let error = frequency / expected - 1.0;
    println!("first mode: {:+.3} %", 100.0 * error);
    assert!(error.abs() < 5e-3, "{error}");
}

/// How much further than in Timoshenko's theory the tip of a beam of square section sinks, as a part.
fn cantilever(layers: usize, nu: f64, thickness: f64) -> f64 {
    let (modulus, density, length, edge) = (5e3, 1000.0, 0.06, 0.012);
    let h = edge / layers as f64;
    let cells = [(length / h).round() as usize, layers, layers];
    let form = Form::slab(cells, h, material(modulus, nu, density)).unwrap();
    let mut form = form.thickened(thickness).unwrap();
    form.has_held_nodes = true; // by what is done below
    let grid = form.grid;
    let mut beam = Lattice::new(Arc::new(form), &Pose::identity());
    // δ = ρ g A l⁴ / (8 E I) + ρ g A l² / (2 κ G A), small against l.
    let area = edge * edge * thickness;
    let inertia = edge.powi(4) * thickness.powi(3) / 12.0;
    let shear = modulus / (2.0 * (1.0 + nu));
    let kappa = 10.0 * (1.0 + nu) / (12.0 + 11.0 * nu);
    let per_gravity = density * area * length.powi(4) / (8.0 * modulus * inertia)
        + density * length * length / (2.0 * kappa * shear);
    let expected = 0.02 * length;
    let section = |i: usize| {
        let places = move |j: usize| (0..=layers).map(move |k| grid.index([i, j, k]));
        (0..=layers).flat_map(places).collect::<Vec<_>>()
    };
    let (root, tip) = (section(0), section(cells[0]));
    let height =
        |beam: &Lattice| tip.iter().map(|node| beam.node(*node).z).sum::<f64>() / tip.len() as f64;
    let before = height(&beam);
    // The root's section stays plane and where it is, and contracts freely.
    run(&mut beam, 3.0, expected / per_gravity, |beam| {
        for axis in 0..3 {
            let mean = root.iter().map(|node| beam.v[axis][*node]).sum::<f32>() / root.len() as f32;
            for node in &root {
                beam.v[axis][*node] = if axis == 0 { 0.0 } else { beam.v[axis][*node] - mean };
            }
        }
    });
    (before - height(&beam)) / expected - 1.0
}

#[test]
fn a_cantilever_sinks_as_timoshenkos_however_many_layers_it_has() {
    for nu in [0.45, 0.3, 0.0] {
        let errors = [1, 2, 3, 4].map(|layers| cantilever(layers, nu, 1.0));
        println!("cantilever, ν {nu}: {:.1?} %", errors.map(|error| 100.0 * error));
        assert!(errors.iter().all(|error| error.abs() < 0.05), "ν {nu}: {errors:?}");
        assert!(errors[3].abs() <= errors[1].abs(), "ν {nu}: {errors:?}");
    }
}

#[test]
fn a_cantilever_of_flat_or_upright_elements_sinks_as_timoshenkos() {
    for thickness in [0.7, 1.25] {
        let error = cantilever(2, 0.3, thickness);
        println!("cantilever, {thickness} times as thick: {:.1} %", 100.0 * error);
        assert!(error.abs() < 0.05, "{thickness}: {error}");
    }
}

#[test]
fn a_free_block_keeps_both_momenta_while_its_deformation_dies_out() {
    let form = Form::slab([5, 3, 2], 4e-3, material(5e3, 0.45, 1000.0)).unwrap();
    let tilted = frames::pose([0.5, -0.1, 0.7], [0.3, -0.5, 1.0]);
    let mut block = Lattice::new(Arc::new(form), &tilted);
    let (speed, rate) = (Vector3::new(0.1, -0.05, 0.02), Vector3::new(3.0, -6.0, 8.0));
    let centre = tilted.translation.vector;
    block.set_velocity(|point| speed + rate.cross(&(point.coords - centre)));
    // It also breathes.
    block.displace(|point| 0.05 * (point.coords - centre));
    let mass = block.form().mass();
    let spin = |block: &Lattice, seconds: f64| {
        let [linear, angular] = block.momentum();
        angular - (centre + speed * seconds).cross(&linear)
    };
    let before = (block.momentum()[0], spin(&block, 0.0));
    run(&mut block, 1.0, 0.0, |_| ());
    let linear = (block.momentum()[0] - before.0).norm() / (mass * speed.norm());
    let angular = (spin(&block, 1.0) - before.1).norm() / before.1.norm();
    println!("momentum {linear:.1e}, angular {angular:.1e}");
    assert!(linear < 1e-5, "{linear}");
    assert!(angular < 1e-3, "{angular}");
    // What is left turns as a whole: no element is strained by more than spinning does.
    let strained = block.form().elements().map(|element| {
        let gradient = block.deformation_gradient(element);
        ((gradient.transpose() * gradient) - nalgebra::Matrix3::identity()).norm()
    });
    let strained = strained.fold(0.0, f64::max);
    assert!(strained < 0.02, "{strained}");
}

#[test]
fn a_block_that_was_squeezed_to_a_tenth_comes_back() {
    let form = Form::slab([3, 3, 2], 4e-3, material(5e3, 0.45, 1000.0)).unwrap();
    let mut block = Lattice::new(Arc::new(form), &Pose::identity());
    block.displace(|point| Vector3::z() * (-0.9 * point.z));
    run(&mut block, 3.0, 0.0, |_| ());
    for element in block.form().elements() {
        let det = block.deformation_gradient(element).determinant();
        assert!((det - 1.0).abs() < 1e-3, "{det}");
    }
}
