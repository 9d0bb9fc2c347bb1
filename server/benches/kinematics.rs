//! Kinematics of both arms: forward, inverse, Jacobian, and the cost of the inverse relative to
//! the forward kinematics in the same run.
//!
//! `cargo bench -p trocar-server --bench kinematics`

use criterion::Criterion;
use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::hint::black_box;
use std::time::{Duration, Instant};
use trocar_server::robots::{Ecm, JointLimit, Psm};

/// Configurations that the timed loops walk through, so that no branch is learnt.
const CONFIGURATIONS: usize = 1024;

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    psm(&mut criterion);
    ecm(&mut criterion);
    criterion.final_summary();
}

fn psm(criterion: &mut Criterion) {
    let arm = Psm::CLASSIC;
    let joints = configurations(arm.limits());
    let poses: Vec<_> =
        joints.iter().map(|q| (arm.base_from_wrist(q), q.map(|value| value + 0.003))).collect();
    let forward = bench(criterion, "psm/forward", &joints, |q| arm.base_from_wrist(q));
    let inverse = bench(criterion, "psm/inverse", &poses, |(pose, seed)| arm.inverse(pose, seed));
    bench(criterion, "psm/jacobian", &joints, |q| arm.jacobian(q));
    ratio("psm", inverse, forward);
}

fn ecm(criterion: &mut Criterion) {
    let arm = Ecm::CLASSIC;
    let joints = configurations(arm.limits());
    let positions: Vec<(Vector3<f64>, [f64; 4])> =
        joints.iter().map(|q| (arm.base_from_camera(q).translation.vector, *q)).collect();
    let forward = bench(criterion, "ecm/forward", &joints, |q| arm.base_from_camera(q));
    let inverse = bench(criterion, "ecm/inverse_position", &positions, |(position, seed)| {
        arm.inverse_position(position, seed)
    });
    bench(criterion, "ecm/jacobian", &joints, |q| arm.jacobian(q));
    ratio("ecm", inverse, forward);
}

fn configurations<const N: usize>(limits: &[JointLimit; N]) -> Vec<[f64; N]> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    (0..CONFIGURATIONS)
        .map(|_| limits.map(|limit| rng.random_range(limit.min..=limit.max)))
        .collect()
}

/// Benchmarks `f` over `inputs` in turn; returns the mean time of one call over all of criterion's
/// samples, or `None` when criterion's filter leaves this benchmark out.
fn bench<I, O>(
    criterion: &mut Criterion,
    name: &str,
    inputs: &[I],
    mut f: impl FnMut(&I) -> O,
) -> Option<f64> {
    let (mut spent, mut calls) = (Duration::ZERO, 0);
    criterion.bench_function(name, |bencher| {
        bencher.iter_custom(|count| {
            let start = Instant::now();
            for input in inputs.iter().cycle().take(count as usize) {
                black_box(f(black_box(input)));
            }
            let elapsed = start.elapsed();
            spent += elapsed;
            calls += count;
            elapsed
        });
    });
    (calls > 0).then(|| spent.as_secs_f64() / calls as f64)
}

fn ratio(arm: &str, inverse: Option<f64>, forward: Option<f64>) {
    if let (Some(inverse), Some(forward)) = (inverse, forward) {
        eprintln!("{arm}: inverse / forward = {:.2}\n", inverse / forward);
    }
}
