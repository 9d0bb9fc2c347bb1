//! The Rust client of the demonstration; `worker.py` is its twin.

use std::time::{Duration, Instant};

use clap::Args;
use hdrhistogram::Histogram;
use trocar_client::{Client, SessionRequest};

use super::Progress;
use crate::output;

/// How often it reports.
const INTERVAL: Duration = Duration::from_millis(200);

/// One client of the demonstration: the scripted expert acts in many environments.
#[derive(Debug, Args)]
pub(crate) struct DemoClient {
    /// The server to connect to
    #[arg(long)]
    server: String,
    /// The task
    #[arg(long)]
    task: String,
    /// How many environments
    #[arg(long)]
    envs: u32,
    /// Environment i begins with seed SEED + i
    #[arg(long)]
    seed: u64,
    /// How long to work, s
    #[arg(long)]
    seconds: f64,
}

impl DemoClient {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        let client = Client::connect(&self.server)?;
        let request = SessionRequest::new(&self.task).envs(self.envs).seed(self.seed);
        let mut session = client.open(&request)?;
        session.want_expert(true);
        let mut actions = session.reset()?.expert_action().to_vec();
        output::json_line(&Progress::default())?;
        std::io::stdin().read_line(&mut String::new())?;

        let mut progress = Progress::default();
        let mut latencies = Histogram::<u64>::new(3)?; // ns
        let start = Instant::now();
        let mut reported = start;
        // Until the time is over, and at least one episode of each environment.
        while progress.seconds < self.seconds || progress.episodes < self.envs.into() {
            let sent = Instant::now();
            let reply = session.step(&actions)?;
            latencies.record(sent.elapsed().as_nanos() as u64)?;
            actions.copy_from_slice(reply.expert_action());
            for row in 0..reply.rows() {
                // A row with 0 steps is the reset that follows an episode.
                progress.steps += u64::from(reply.steps()[row] > 0);
                if reply.terminated()[row] == 1 || reply.truncated()[row] == 1 {
                    progress.episodes += 1;
                    progress.successes += u64::from(reply.is_success()[row]);
                }
            }
            progress.seconds = start.elapsed().as_secs_f64();
            if reported.elapsed() > INTERVAL {
                reported = Instant::now();
                progress.p50_us = latencies.value_at_quantile(0.5) as f64 / 1000.0;
                output::json_line(&progress)?;
            }
        }
        progress.p50_us = latencies.value_at_quantile(0.5) as f64 / 1000.0;
        progress.done = true;
        output::json_line(&progress)
    }
}
