//! One step through a server process, beside the same step in-process in the same run: mean by
//! criterion, percentiles, and their ratio.
//!
//! `cargo bench -p trocar-tests --bench round_trip`

#[allow(dead_code, clippy::unwrap_used)] // Made for the tests, which need more of it.
#[path = "../harness.rs"]
mod harness;

use std::time::{Duration, Instant};

use criterion::Criterion;
use trocar_client::{Autoreset, Options, SessionRequest};
use trocar_server::{Env, Registry};

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    let server = harness::Server::start();
    for (task, envs) in [("EcmReach-v0", 1), ("EcmReach-v0", 64), ("NeedleReach-v0", 64)] {
        let alone = in_process(&mut criterion, task, envs);
        let through = round_trip(&mut criterion, &server, task, envs);
        if let (Some(alone), Some(through)) = (alone, through) {
            let ratio = through.p50 / alone.p50;
            eprintln!(
                "{task} × {envs}: in-process {alone}, round trip {through}; p50 ratio {ratio:.2}"
            );
        }
    }
    criterion.final_summary();
}

/// Steps `envs` environments in this process, one after the other.
fn in_process(criterion: &mut Criterion, task: &str, envs: u32) -> Option<Latencies> {
    let env = Registry::builtin().make(task, &Options::new()).expect("the task is registered");
    let mut envs: Vec<Env> = vec![env; envs as usize];
    for env in &mut envs {
        env.reset(None);
    }
    let mut action = vec![0.0; envs[0].spec().action_dim()];
    let mut step = 0_u32;
    bench(criterion, &format!("{task}/{}/in_process", envs.len()), || {
        step += 1;
        wander(&mut action, step);
        for env in &mut envs {
            if env.needs_reset() {
                env.reset(None);
            } else {
                env.step(&action).expect("the action is finite");
            }
        }
    })
}

/// Steps a session of `envs` environments.
fn round_trip(
    criterion: &mut Criterion,
    server: &harness::Server,
    task: &str,
    envs: u32,
) -> Option<Latencies> {
    let request = SessionRequest::new(task).envs(envs).autoreset(Autoreset::NextStep);
    let mut session = server.connect().open(&request).expect("the request is good");
    session.reset().expect("the server runs");
    let mut actions = vec![0.0; session.envs() * session.spec().action_dim()];
    let mut step = 0_u32;
    bench(criterion, &format!("{task}/{envs}/round_trip"), || {
        step += 1;
        wander(&mut actions, step);
        session.step(&actions).expect("the server runs");
    })
}

/// Actions that change from step to step, and keep every arm inside its range.
fn wander(actions: &mut [f32], step: u32) {
    actions.fill(if step % 16 < 8 { 0.5 } else { -0.5 });
}

/// Time per call, µs.
struct Latencies {
    p50: f64,
    p99: f64,
}

impl std::fmt::Display for Latencies {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "p50 {:.1} µs, p99 {:.1} µs", self.p50, self.p99)
    }
}

/// Benchmarks `call`; `None` where criterion's filter leaves it out.
fn bench(criterion: &mut Criterion, name: &str, mut call: impl FnMut()) -> Option<Latencies> {
    let mut micros: Vec<f64> = vec![];
    criterion.bench_function(name, |bencher| {
        bencher.iter_custom(|count| {
            let mut total = Duration::ZERO;
            for _ in 0..count {
                let start = Instant::now();
                call();
                let elapsed = start.elapsed();
                micros.push(elapsed.as_secs_f64() * 1e6);
                total += elapsed;
            }
            total
        });
    });
    micros.sort_by(f64::total_cmp);
    let at = |quantile: f64| micros.get((micros.len() as f64 * quantile) as usize).copied();
    Some(Latencies { p50: at(0.5)?, p99: at(0.99)? })
}
