//! `trocar bench`: environment steps per second, of wall time and of CPU time.
//!
//! The same environments and actions run in this process ([`in_process`]), through a server by a
//! Rust client ([`client_rs`]) and by a Python client ([`client_py`]). What an episode costs depends on
//! what happens in it, so all begin with the same ones. Environments go in step, for
//! whole episodes: an expert's steps do not cost the same from beginning to end. Resets are part of
//! the time and are not counted as steps.

mod client_py;
mod client_rs;
mod cpu;
mod in_process;
mod pool;

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use trocar_proto::Options;
use trocar_server::Registry;

use crate::options::{self, OptionFlags};
use crate::output;
use crate::policy::Policy;
use crate::process::OwnServer;
use client_py::PythonClient;
use cpu::Stopwatch;
use pool::Pool;

/// Least time of one measurement, s; quick ones are shorter.
const SECONDS: f64 = 2.0;
const QUICK_SECONDS: f64 = 0.4;

/// The part of that for which everything runs before it is measured.
const WARM_UP: f64 = 0.2;

/// Episodes that are begun before that. A session makes the states in which episodes begin when it first
/// needs them, by simulating; so many seeds leave none of them
/// ([`COUNT`](trocar_server::tasks::start::COUNT)) to be made while something is measured.
const BEGINNINGS: u32 = 1024;

/// Measure environment steps per second, in this process and through a server.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar bench --quick                                       everything, in a few minutes
  trocar bench --task NeedlePick-v0 --policy oracle --envs 64
  trocar bench --mode in_process --envs 1 --json             what the simulation costs
  trocar bench --threads 2 --option preset=surrol
  trocar bench --mode client_rs --clients 1,8,64 --envs 16   many clients at once

A measurement takes whole episodes, at least one of every environment. A step is one environment's
step; resets take part of the time and are not counted. CPU time is that of the server (or this
process) and of the client, waiting included where it burns any. client_py needs a Python with the
package trocar: $TROCAR_PYTHON, else python3. With --json: {task, mode, policy, envs, clients,
threads, steps_per_second, steps_per_cpu_second, ratio_to_in_process}; the ratio is that of steps
per second, null where in_process was not measured.")]
pub(crate) struct Bench {
    /// A task id of `trocar tasks`, or all
    #[arg(long, default_value = "all", value_parser = crate::options::task_id)]
    task: String,
    /// Where the steps are asked for
    #[arg(long, value_enum, value_delimiter = ',', default_values = ["in_process", "client_rs", "client_py"])]
    mode: Vec<Mode>,
    /// How many environments at a time
    #[arg(long, value_delimiter = ',', default_values_t = [1, 8, 64], value_parser = clap::value_parser!(u32).range(1..=65_536))]
    envs: Vec<u32>,
    /// How many Rust clients at a time, each with so many environments; in-process, one has them all
    #[arg(long, value_delimiter = ',', default_values_t = [1], value_parser = clap::value_parser!(u32).range(1..=256))]
    clients: Vec<u32>,
    /// What chooses the actions
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [Policy::Random, Policy::Oracle])]
    policy: Vec<Policy>,
    /// Threads that step environments
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1024))]
    threads: u32,
    /// Shorter measurements
    #[arg(long)]
    quick: bool,
    #[command(flatten)]
    options: OptionFlags,
    /// One JSON object per measurement and line, on stdout
    #[arg(long)]
    json: bool,
}

/// Where the steps are asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, ValueEnum, Serialize)]
#[value(rename_all = "snake_case")]
#[serde(rename_all = "snake_case")]
enum Mode {
    /// In this process, without a server
    InProcess,
    /// In a server, by a Rust client
    ClientRs,
    /// In a server, by a Python client
    ClientPy,
}

impl Mode {
    /// As it is said on the command line.
    fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_string())
    }
}

/// What is to be measured.
#[derive(Debug, Clone)]
struct Job {
    task: String,
    options: Options,
    policy: Policy,
    /// Environments of each client.
    envs: u32,
    clients: u32,
    threads: u32,
    max_steps: u32,
    /// What is done; `None` where the expert acts.
    pool: Option<Arc<Pool>>,
    /// Least time.
    time: Duration,
}

impl Job {
    /// Runs `step`, which steps every environment by the actions of a round, for whole episodes until
    /// the time is over, and gives how often it was run.
    fn rounds<E>(&self, mut step: impl FnMut(usize) -> Result<(), E>) -> Result<u64, E> {
        let start = Instant::now();
        let mut rounds = 0;
        loop {
            for _ in 0..self.max_steps {
                step(rounds as usize)?;
                rounds += 1;
            }
            if start.elapsed() >= self.time {
                return Ok(rounds);
            }
        }
    }

    /// The random actions of a round in the environments of a client; `None` where the expert acts. Each
    /// client has its own, so that many need not do the same as one: some actions cost more than others.
    fn actions(&self, client: u32, round: usize) -> Option<&[f32]> {
        let first = client as usize * self.max_steps as usize;
        self.pool.as_ref().map(|pool| pool.round(first + round))
    }

    /// Runs `step` for a part of the time.
    fn warm_up<E>(&self, mut step: impl FnMut(usize) -> Result<(), E>) -> Result<(), E> {
        let start = Instant::now();
        let mut round = 0;
        while start.elapsed() < self.time.mul_f64(WARM_UP) {
            step(round)?;
            round += 1;
        }
        Ok(())
    }
}

/// What was measured.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Measured {
    steps: u64,
    seconds: f64,
    cpu_seconds: f64,
}

/// What is reported.
#[derive(Debug, Serialize)]
struct Row<'a> {
    task: &'a str,
    mode: Mode,
    policy: Policy,
    envs: u32,
    clients: u32,
    threads: u32,
    steps_per_second: f64,
    steps_per_cpu_second: f64,
    ratio_to_in_process: Option<f64>,
}

impl Bench {
    pub(crate) fn run(mut self) -> anyhow::Result<()> {
        // In-process comes first: the others are compared with it.
        self.mode.sort_unstable();
        self.mode.dedup();
        let registry = Registry::builtin();
        let mut jobs = self.jobs(&registry)?;
        let name = format!("bench-{}", std::process::id()).parse()?;
        let threads = self.threads.to_string();
        let needs_server = self.mode.iter().any(|mode| *mode != Mode::InProcess);
        let server = needs_server
            .then(|| OwnServer::start(&name, &["--threads", &threads, "--max-envs", "65536"]))
            .transpose()?;
        let mut python = None;
        if self.mode.contains(&Mode::ClientPy) {
            match PythonClient::start(name.as_str()) {
                Ok(client) => python = Some(client),
                Err(reason) => {
                    eprintln!("client_py is left out: {reason:#}");
                    self.mode.retain(|mode| *mode != Mode::ClientPy);
                }
            }
        }

        let header = [
            "task",
            "policy",
            "envs",
            "clients",
            "mode",
            "steps/s",
            "steps/CPU s",
            "of in-process",
        ];
        let mut table = output::table(&header, 5);
        let progress = progress_bar(jobs.len() * self.mode.len());
        for job in &mut jobs {
            let mut in_process = None;
            // Only Rust clients come in numbers.
            let several = job.clients > 1;
            for mode in self.mode.iter().filter(|mode| !several || **mode != Mode::ClientPy) {
                progress.set_message(format!("{} {} {}", job.task, job.policy, mode.name()));
                let measured = match (mode, &server, &mut python) {
                    (Mode::ClientRs, Some(server), _) => client_rs::run(server, job)?,
                    (Mode::ClientPy, Some(server), Some(python)) => python.run(server, job)?,
                    _ => in_process::run(&registry, job)?,
                };
                let rate = measured.steps as f64 / measured.seconds;
                if *mode == Mode::InProcess {
                    in_process = Some(rate);
                }
                let row = Row {
                    task: &job.task,
                    mode: *mode,
                    policy: job.policy,
                    envs: job.envs,
                    clients: job.clients,
                    threads: job.threads,
                    steps_per_second: rate,
                    steps_per_cpu_second: measured.steps as f64 / measured.cpu_seconds,
                    ratio_to_in_process: in_process.map(|reference| rate / reference),
                };
                progress.suspend(|| if self.json { output::json_line(&row) } else { Ok(()) })?;
                table.add_row([
                    row.task.into(),
                    row.policy.to_string(),
                    row.envs.to_string(),
                    row.clients.to_string(),
                    row.mode.name(),
                    format!("{:.0}", row.steps_per_second),
                    format!("{:.0}", row.steps_per_cpu_second),
                    row.ratio_to_in_process.map_or("–".into(), |ratio| format!("{ratio:.2}")),
                ]);
                progress.inc(1);
            }
        }
        progress.finish_and_clear();
        drop(python);
        server.map(OwnServer::stop).transpose().context("ending the server")?;
        eprintln!("{table}");
        Ok(())
    }

    /// Every measurement, in order, whatever the mode.
    fn jobs(&self, registry: &Registry) -> anyhow::Result<Vec<Job>> {
        let ids = if self.task == "all" {
            registry.ids().map(str::to_string).collect()
        } else {
            vec![self.task.clone()]
        };
        let specs = ids.iter().map(|task| registry.spec(task, &Options::new()));
        let specs = specs.collect::<Result<Vec<_>, _>>()?;
        let time = Duration::from_secs_f64(if self.quick { QUICK_SECONDS } else { SECONDS });
        let mut jobs = vec![];
        for (task, options) in options::for_tasks(&self.options.assignments(), &specs)? {
            let spec = registry.spec(&task, &options)?;
            let numbers = || {
                self.envs
                    .iter()
                    .flat_map(|envs| self.clients.iter().map(move |clients| (*envs, *clients)))
            };
            for (policy, (envs, clients)) in self
                .policy
                .iter()
                .flat_map(|policy| numbers().map(move |numbers| (policy, numbers)))
            {
                jobs.push(Job {
                    task: task.clone(),
                    options: options.clone(),
                    policy: *policy,
                    envs,
                    clients,
                    threads: self.threads,
                    max_steps: spec.max_steps,
                    pool: (!policy.asks_expert())
                        .then(|| Arc::new(Pool::new(envs, spec.action_dim()))),
                    time,
                });
            }
        }
        Ok(jobs)
    }
}

/// A bar on stderr, which shows nothing where that is not a terminal.
fn progress_bar(count: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:30} {pos}/{len}, {eta} left  {msg}")
        .expect("the template is well-formed");
    ProgressBar::new(count as u64).with_style(style)
}
