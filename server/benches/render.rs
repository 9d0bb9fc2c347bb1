//! Time of a picture: colour, depth and bodies with shadows of the NeedlePick scene through the endoscope and
//! from the overview, on one thread; of a batch on all threads.
//!
//! ```sh
//! cargo bench -p trocar-server --bench render
//! cargo bench -p trocar-server --bench render -- endoscope/128
//! ```

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use rayon::prelude::*;
use trocar_proto::Options;
use trocar_server::Env;
use trocar_server::Registry;
use trocar_server::render::{Lens, Picture, Renderer, Scene, Software};

/// Width and height, as rates are named.
const SIZES: [[usize; 2]; 4] = [[64, 64], [128, 128], [256, 256], [640, 480]];

/// Pictures of a batch.
const BATCH: u64 = 16;

/// An environment in the middle of the expert's episode: the jaws hold the needle.
fn env() -> Env {
    let mut env = Registry::builtin().make("NeedlePick-v0", &Options::new()).expect("a task");
    env.reset(Some(3));
    let mut action = vec![0.0; env.spec().action_dim()];
    for _ in 0..20 {
        env.expert(&mut action);
        env.step(&action).expect("a step of the expert");
    }
    env
}

fn one_picture(criterion: &mut Criterion) {
    let scene = env().scene();
    eprintln!(
        "NeedlePick-v0: {} triangles in {} instances",
        scene.triangles(),
        scene.instances().len()
    );
    let mut group = criterion.benchmark_group("picture");
    for (name, lens) in [("endoscope", Lens::Endoscope), ("overview", Lens::Overview)] {
        for [width, height] in SIZES {
            let camera = scene.camera(lens, width, height).expect("a camera");
            let mut picture = Picture::new(width, height);
            for (kind, renderer) in [
                ("", Software::default()),
                ("/no shadow", Software { shadow: 0, ..Software::default() }),
            ] {
                let id = BenchmarkId::new(format!("{name}{kind}"), format!("{width}x{height}"));
                group.bench_function(id, |bencher| {
                    bencher.iter(|| renderer.render(&scene, &camera, picture.canvas()));
                });
            }
        }
    }
    group.finish();
}

/// The scene too is made anew for each picture, as for observations.
fn batches(criterion: &mut Criterion) {
    let envs = vec![env(); BATCH as usize];
    let mut pictures = vec![Picture::new(128, 128); BATCH as usize];
    let mut group = criterion.benchmark_group("batch");
    group.throughput(Throughput::Elements(BATCH));
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    for threads in [1, 2, 4, 8, 16].into_iter().filter(|threads| *threads <= cores) {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        group.bench_function(
            BenchmarkId::new("128x128", format!("{threads} threads")),
            |bencher| {
                bencher.iter(|| {
                    pool.install(|| {
                        envs.par_iter().zip(&mut pictures).for_each(|(env, picture)| {
                            let scene: Scene = env.scene();
                            let camera = scene.camera(Lens::Endoscope, 128, 128).expect("a camera");
                            Software::default().render(&scene, &camera, picture.canvas());
                        });
                    });
                });
            },
        );
    }
    group.finish();
}

criterion_group!(benches, one_picture, batches);
criterion_main!(benches);
