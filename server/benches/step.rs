//! Environment steps per second of every registered task on one core, in-process, without IPC.
//!
//! `cargo bench -p trocar-server --bench step` reports each task under random actions and under
//! its expert, resets included, and prints the ratio of both; then what it takes to begin an episode,
//! to take a snapshot amid one, and to go on from it.

use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use trocar_proto::Options;
use trocar_server::Registry;
use trocar_server::env::Env;
use trocar_server::sim::random::Rng;

/// Steps in one measured batch: 20 episodes.
const STEPS: u64 = 1000;

#[derive(Clone, Copy)]
enum Policy {
    Random,
    Expert,
}

/// Runs [`STEPS`] steps, with the resets that they need.
fn run(env: &mut Env, rng: &mut Rng, policy: Policy, action: &mut [f32]) {
    for _ in 0..STEPS {
        if env.needs_reset() {
            env.reset(None);
        }
        match policy {
            Policy::Random => action.fill_with(|| rng.uniform(-1.0, 1.0) as f32),
            Policy::Expert => env.expert(action),
        }
        env.step(action).expect("a checked action");
    }
}

fn steps(criterion: &mut Criterion) {
    let registry = Registry::builtin();
    let mut group = criterion.benchmark_group("step");
    group.throughput(Throughput::Elements(STEPS)).sample_size(20);
    let mut lines = vec![];
    for id in registry.ids() {
        let mut rates = vec![];
        for (name, policy) in [("random", Policy::Random), ("expert", Policy::Expert)] {
            let mut env = registry.make(id, &Options::new()).expect("a registered task");
            let mut rng = Rng::new(0, 0);
            let mut action = vec![0.0; env.spec().action_dim()];
            let (mut done, mut taken) = (0, Duration::ZERO);
            group.bench_function(BenchmarkId::new(id, name), |bencher| {
                bencher.iter_custom(|batches| {
                    let start = Instant::now();
                    for _ in 0..batches {
                        run(&mut env, &mut rng, policy, &mut action);
                    }
                    done += batches * STEPS;
                    taken += start.elapsed();
                    start.elapsed()
                });
            });
            // A filter leaves tasks out.
            if done > 0 {
                rates.push(done as f64 / taken.as_secs_f64());
            }
        }
        if let [random, expert] = rates[..] {
            lines.push(format!(
                "{id}: {random:.0} steps/s random, {expert:.0} expert, ratio {:.2}",
                expert / random
            ));
        }
    }
    group.finish();
    for line in lines {
        eprintln!("{line}");
    }
}

/// So many seeds leave none of the states unmade in which episodes begin.
const BEGINNINGS: u64 = 1024;

/// Steps of the expert before a snapshot: an object is in the jaws, where there is one.
const AMID: u32 = 25;

fn copies(criterion: &mut Criterion) {
    let registry = Registry::builtin();
    let mut group = criterion.benchmark_group("copy");
    for id in registry.ids() {
        let mut env = registry.make(id, &Options::new()).expect("a registered task");
        // The states in which episodes begin are made once, each when it is first needed.
        (0..BEGINNINGS).for_each(|seed| env.reset(Some(seed)));
        group.bench_function(BenchmarkId::new(id, "reset"), |bencher| {
            bencher.iter(|| env.reset(None));
        });
        env.reset(Some(0));
        let mut action = vec![0.0; env.spec().action_dim()];
        while env.steps() < AMID {
            env.expert(&mut action);
            env.step(&action).expect("a checked action");
        }
        group.bench_function(BenchmarkId::new(id, "snapshot"), |bencher| {
            bencher.iter(|| env.clone());
        });
        let mut other = env.clone();
        group.bench_function(BenchmarkId::new(id, "restore"), |bencher| {
            bencher.iter(|| other.clone_from(&env));
        });
        let bytes = env.export().expect("it was reset");
        group.bench_function(BenchmarkId::new(id, "export"), |bencher| {
            bencher.iter(|| env.export());
        });
        group.sample_size(10).bench_function(BenchmarkId::new(id, "import"), |bencher| {
            bencher.iter(|| other.import(&bytes));
        });
        eprintln!("{id}: {} bytes exported", bytes.len());
    }
    group.finish();
}

criterion_group!(benches, steps, copies);
criterion_main!(benches);
