//! Environment steps per second of every registered task on one core, in-process, without IPC.
//!
//! `cargo bench -p trocar-server --bench step` reports each task under random actions and under
//! its expert, resets included, and prints the ratio of both.

use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use trocar_proto::Options;
use trocar_server::env::Env;
use trocar_server::sim::random::Rng;
use trocar_server::tasks::Registry;

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
            rates.push(done as f64 / taken.as_secs_f64());
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

criterion_group!(benches, steps);
criterion_main!(benches);
