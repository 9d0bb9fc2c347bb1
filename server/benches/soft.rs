//! What a soft body costs: time of one core for a simulated millisecond.
//!
//! The slab is that of the comparison with rapier's and MuJoCo's soft bodies: 48 × 48 × 6 mm of 5 kPa in elements of 3 mm, 867
//! nodes and 512 elements.

use std::sync::Arc;

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::Vector3;
use trocar_server::sim::frames::{self, Aabb, Pose};
use trocar_server::sim::instrument::{Instrument, JAW_CLOSED, JAW_OPEN, Jaws, Posture, TIP_OFFSET};
use trocar_server::sim::motion::carry_out;
use trocar_server::sim::soft::{Form, Material, Skin, SoftBody, box_distance};
use trocar_server::sim::world::{SUBSTEPS_PER_SECOND, Solver, World};

fn slab() -> SoftBody {
    let material = Material {
        youngs_modulus: 5e3,
        poissons_ratio: 0.45,
        density: 1000.0,
        ..Material::named("fat").expect("it is in the table")
    };
    let half = Vector3::new(0.024, 0.024, 3e-3);
    let mut form = Form::slab([16, 16, 2], 3e-3, material).expect("it is soft");
    form.hold(|point| point.x < -0.0235);
    let bounds = Aabb { min: -half, max: half };
    let skin = Skin::new(&form, &bounds, 3e-3, box_distance(&half));
    SoftBody::new("slab", [0.9; 3], Arc::new(form), Arc::new(skin), &Pose::identity())
}

fn posture(height: f64, jaw: f64) -> Posture {
    let pose = frames::pose([0.01, 0.0, height + TIP_OFFSET], [std::f64::consts::PI, 0.0, 0.0]);
    Posture { world_from_wrist: pose, jaw }
}

fn soft(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("soft, one simulated 1/240 s");
    let mut world = World::new(Solver::LIGHT);
    let id = world.insert_soft(slab());
    group.bench_function("free", |bencher| {
        bencher.iter(|| {
            world.soft_mut(id).wake();
            world.advance();
        });
    });
    let mut world = World::new(Solver::LIGHT);
    let id = world.insert_soft(slab());
    let start = posture(0.02, JAW_OPEN);
    let mut jaws = Instrument::with_jaws(&mut world, start, 1.0, Jaws::TISSUE_FORCEPS);
    let seconds = |seconds: f64| (seconds * SUBSTEPS_PER_SECOND) as u32;
    // It hangs from one edge: jaws close on it where it is.
    for _ in 0..seconds(0.02) {
        world.advance();
    }
    for end in [posture(-2e-3, JAW_OPEN), posture(-2e-3, JAW_CLOSED), posture(4e-3, JAW_CLOSED)] {
        carry_out([&mut jaws], &mut world, [end], seconds(0.4));
    }
    assert_eq!(jaws.fingers_on(&world, id), 2);
    let held = posture(4e-3, JAW_CLOSED);
    group.bench_function("gripped", |bencher| {
        bencher.iter(|| carry_out([&mut jaws], &mut world, [held], 1));
    });
    group.bench_function("clone", |bencher| bencher.iter(|| world.clone()));
    group.finish();
}

criterion_group!(benches, soft);
criterion_main!(benches);
