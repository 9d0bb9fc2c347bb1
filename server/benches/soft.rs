//! What a soft body costs on one core: time for a substep of the world, 1/240 s.
//!
//! The slab has 48 × 48 × 6 mm of 5 kPa in elements of 3 mm: 867 nodes and 512 elements. One edge is held. It hangs
//! from that edge, or lies on a table, from which a tissue forceps lifts it.
//!
//! rapier's own soft bodies hang from the same edge: with the fewest iterations that do not let it fall apart, without a
//! collider. `make bench-soft` compares both with MuJoCo.
//!
//! `cargo bench -p trocar-server --bench soft`

use std::sync::Arc;

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::Vector3;
use rapier3d::prelude::{
    BroadPhaseBvh, CCDSolver, ColliderSet, ImpulseJointSet, IntegrationParameters, IslandManager,
    MultibodyJointSet, NarrowPhase, PhysicsPipeline, RigidBodySet, SoftBodyBuilder,
    SoftBodyCellModel, SoftBodyMaterial, SoftBodySet, Vector,
};
use trocar_server::sim::frames::{self, Aabb, Pose};
use trocar_server::sim::instrument::{Instrument, JAW_CLOSED, JAW_OPEN, Jaws, Posture, TIP_OFFSET};
use trocar_server::sim::motion::carry_out;
use trocar_server::sim::soft::{Form, Material, Skin, SoftBody, box_distance};
use trocar_server::sim::world::{Motion, Part, SUBSTEPS_PER_SECOND, Shape, Solver, World};

/// Half extents of the slab, m.
const HALF: Vector3<f64> = Vector3::new(0.024, 0.024, 3e-3);

/// Where the tips are when the jaws close, and to where they lift the slab: height above its middle, m.
const GRASP: f64 = -2e-3;
const LIFTED: f64 = 0.012;

fn slab() -> SoftBody {
    let material = Material {
        youngs_modulus: 5e3,
        poissons_ratio: 0.45,
        density: 1000.0,
        stiffening: 0.0,
        ..Material::named("fat").expect("it is in the table")
    };
    let mut form = Form::slab([16, 16, 2], 3e-3, material).expect("it is soft");
    form.hold(|point| point.x < 0.5e-3 - HALF.x);
    let bounds = Aabb { min: -HALF, max: HALF };
    let skin = Skin::new(&form, &bounds, 3e-3, box_distance(&HALF));
    SoftBody::new("slab", [0.9; 3], Arc::new(form), Arc::new(skin), &Pose::identity())
}

/// The same slab as a soft body of rapier, of which a step is a substep of the world.
///
/// Lengths are in cm: the engine computes in single precision, and its tolerances are made for bodies of some units.
fn step_of_rapier() -> impl FnMut() {
    const CM: f32 = 100.0;
    let parameters = IntegrationParameters {
        dt: 1.0 / SUBSTEPS_PER_SECOND as f32,
        length_unit: 0.01 * CM,
        num_solver_iterations: 4,
        ..IntegrationParameters::default()
    };
    let half = Vector::new(HALF.x as f32, HALF.y as f32, HALF.z as f32) * CM;
    let material = SoftBodyMaterial {
        young_modulus: 5e3 * CM * CM,
        poisson_ratio: 0.45,
        ..SoftBodyMaterial::default()
    };
    let slab = SoftBodyBuilder::cuboid(Vector::ZERO, half, 17, 17, 3)
        .material(material)
        .cell_model(SoftBodyCellModel::NeoHookean)
        .mass(1000.0 * 8.0 * (HALF.x * HALF.y * HALF.z) as f32 * CM.powi(3))
        .linear_damping(8.0)
        .can_sleep(false)
        .no_surface_collider();
    let held = slab.particle_positions().iter().map(|point| point.x < 1e-3 - half.x);
    let held: Vec<u32> =
        held.enumerate().filter(|(_, is_held)| *is_held).map(|(index, _)| index as u32).collect();
    let (mut bodies, mut colliders) = (RigidBodySet::new(), ColliderSet::new());
    let mut soft = SoftBodySet::new();
    soft.insert(slab.pinned_particles(held), &mut bodies, &mut colliders);
    let mut pipeline = PhysicsPipeline::new();
    let (mut islands, mut pairs) = (IslandManager::new(), BroadPhaseBvh::default());
    let (mut contacts, mut ccd) = (NarrowPhase::new(), CCDSolver::new());
    let (mut joints, mut multibodies) = (ImpulseJointSet::new(), MultibodyJointSet::new());
    move || {
        pipeline.step(
            Vector::new(0.0, 0.0, -9.81 * CM),
            &parameters,
            &mut islands,
            &mut pairs,
            &mut contacts,
            &mut bodies,
            &mut colliders,
            &mut joints,
            &mut multibodies,
            &mut soft,
            &mut ccd,
            &(),
            &(),
        );
    }
}

/// A tissue forceps from above, its tips at this height above the middle of the slab at rest.
fn posture(height: f64, jaw: f64) -> Posture {
    let pose = frames::pose([0.01, 0.0, height + TIP_OFFSET], [std::f64::consts::PI, 0.0, 0.0]);
    Posture { world_from_wrist: pose, jaw }
}

fn soft(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("soft");
    let mut world = World::new(Solver::LIGHT);
    let id = world.insert_soft(slab());
    group.bench_function("hanging", |bencher| {
        bencher.iter(|| {
            world.soft_mut(id).wake();
            world.advance();
        });
    });

    group.bench_function("hanging in rapier", |bencher| {
        let mut step = step_of_rapier();
        bencher.iter(&mut step);
    });

    let mut world = World::new(Solver::LIGHT);
    let table = Part {
        body_from_part: Pose::translation(0.0, 0.0, -HALF.z - 0.01),
        shape: Shape::Cuboid(Vector3::new(0.1, 0.1, 0.01)),
    };
    world.insert(Motion::Fixed, &Pose::identity(), 1.0, &[table]);
    let id = world.insert_soft(slab());
    group.bench_function("lying", |bencher| {
        bencher.iter(|| {
            world.soft_mut(id).wake();
            world.advance();
        });
    });

    let above = posture(0.02, JAW_OPEN);
    let mut jaws = Instrument::with_jaws(&mut world, above, 1.0, Jaws::TISSUE_FORCEPS);
    let lifted = posture(LIFTED, JAW_CLOSED);
    for end in [posture(GRASP, JAW_OPEN), posture(GRASP, JAW_CLOSED), lifted] {
        carry_out([&mut jaws], &mut world, [end], (0.4 * SUBSTEPS_PER_SECOND) as u32);
    }
    assert_eq!(jaws.fingers_on(&world, id), 2, "both fingers hold it");
    group.bench_function("gripped", |bencher| {
        bencher.iter(|| carry_out([&mut jaws], &mut world, [lifted], 1));
    });
    assert_eq!(jaws.fingers_on(&world, id), 2, "it is held until the end");
    group.bench_function("clone", |bencher| bencher.iter(|| world.clone()));
    group.finish();
}

criterion_group!(benches, soft);
criterion_main!(benches);
