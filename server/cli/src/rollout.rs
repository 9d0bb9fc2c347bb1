//! `trocar rollout`: run a policy for some episodes and report how often it succeeds.
//!
//! Episode k is the first episode of seed `--seed + k`, whoever runs it: in this process
//! ([`in_process`]) or in a server ([`served`]), however many at a time. The numbers are the same.

mod in_process;
mod served;

use std::time::Instant;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use serde_json::Value;
use trocar_proto::{Options, seed};

use crate::catalog::Catalog;
use crate::options::{self, Assignment, Given};
use crate::output;
use crate::policy::Chooser;
use crate::process::OwnServer;

/// Run a policy for some episodes and report how often it succeeds.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar rollout                                        every task, its scripted expert, 20 episodes
  trocar rollout --task NeedleReach-v0 --policy random --episodes 200 --envs 64
  trocar rollout --task NeedleReach-v0 --spawn narrow --option domain.latency=0,2
  trocar rollout --policy NeedlePick --episodes 200     one of `trocar policies`
  trocar rollout --policy NeedlePick --view             the same in a browser, as fast as life
  trocar rollout --policy policy.onnx --episodes 200    a policy of `python -m trocar.rl export`
  trocar rollout --server lab --json                    in the server `trocar serve --name lab`

`success` counts episodes whose last step ends in success, `success ever` those with any such step.
Options apply to every chosen task that knows them; `trocar tasks` lists them. With --json:
{task, policy, grasp, episodes, success_rate, success_ever_rate, mean_return, mean_length,
steps_per_second}; grasp and rates are null where a task has none.")]
pub(crate) struct Rollout {
    /// A task id of `trocar tasks`, or all
    #[arg(long, default_value = "all", value_parser = crate::options::task_id)]
    task: String,
    /// The agent: oracle (the task's scripted expert), random, or a trained policy: FILE.onnx, or a name
    /// of `trocar policies`
    #[arg(long, default_value = "oracle")]
    policy: String,
    /// How many episodes of each task
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    episodes: u32,
    /// Episode k has the seed SEED + k
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Most environments at a time
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..))]
    envs: u32,
    /// Run in the server of that name instead of in this process
    #[arg(long, value_name = "NAME")]
    server: Option<String>,
    /// Run in a server of its own, as fast as life, and show the episodes in its viewer
    #[arg(long, conflicts_with = "server")]
    view: bool,
    #[command(flatten)]
    options: Given,
    /// One JSON object per task and line, on stdout
    #[arg(long)]
    json: bool,
}

/// What is to be run of one task.
struct Job<'a> {
    task: &'a str,
    options: Options,
    policy: &'a Chooser,
    episodes: u32,
    seed: u64,
    envs: u32,
    /// No faster than life.
    lifelike: bool,
}

impl Job<'_> {
    /// The seed of episode `k`.
    fn seed_of(&self, k: u32) -> u64 {
        seed::of(u128::from(self.seed) + u128::from(k))
    }
}

/// How an episode went.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Episode {
    length: u32,
    total_reward: f64,
    /// The last step ended in success.
    success: bool,
    /// Some step did.
    success_ever: bool,
    /// The simulation failed and ended the episode.
    failed: bool,
}

impl Episode {
    fn step(&mut self, reward: f32, is_success: bool) {
        self.length += 1;
        self.total_reward += f64::from(reward);
        self.success = is_success;
        self.success_ever |= is_success;
    }

    /// The last step's simulation failed.
    fn fail(&mut self) {
        self.step(0.0, false);
        self.failed = true;
    }
}

/// What is reported of one task.
#[derive(Debug, Serialize)]
struct Row {
    task: String,
    policy: String,
    grasp: Value,
    episodes: u32,
    success_rate: Option<f64>,
    success_ever_rate: Option<f64>,
    mean_return: f64,
    mean_length: f64,
    steps_per_second: f64,
}

/// Runs the episodes of a job.
fn run(catalog: &Catalog, job: &Job<'_>, progress: &ProgressBar) -> anyhow::Result<Vec<Episode>> {
    match catalog {
        Catalog::Builtin(registry) => in_process::run(registry, job, progress),
        Catalog::Server(client) => served::run(client, job, progress),
    }
}

impl Rollout {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        let viewed = self.view.then(start_viewed).transpose()?;
        let name = viewed.as_ref().map(OwnServer::name).or(self.server.as_deref());
        let catalog = Catalog::open(name)?;
        let policy = Chooser::read(&self.policy)?;
        let assignments = policy.with_options(self.options.assignments())?;
        let header = ["task", "policy", "episodes", "success", "success ever", "mean return"];
        let header: Vec<_> = header.into_iter().chain(["mean length", "steps/s"]).collect();
        let mut table = output::table(&header, 2);
        for (task, options) in self.chosen(&catalog, &policy, &assignments)? {
            let row = self.roll_out(&catalog, &task, options, &policy)?;
            if self.json {
                output::json_line(&row)?;
            }
            table.add_row([
                row.task,
                row.policy,
                row.episodes.to_string(),
                output::percent(row.success_rate),
                output::percent(row.success_ever_rate),
                format!("{:.2}", row.mean_return),
                format!("{:.1}", row.mean_length),
                format!("{:.0}", row.steps_per_second),
            ]);
        }
        if !self.json {
            eprintln!("{table}");
        }
        drop(catalog);
        viewed.map_or(Ok(()), OwnServer::stop)
    }

    /// The tasks to run, each with the options that it knows.
    fn chosen(
        &self,
        catalog: &Catalog,
        policy: &Chooser,
        assignments: &[Assignment],
    ) -> anyhow::Result<Vec<(String, Options)>> {
        let ids = policy.tasks(&self.task, || catalog.tasks())?;
        options::for_tasks(assignments, &catalog.specs(&ids)?)
    }

    fn roll_out(
        &self,
        catalog: &Catalog,
        task: &str,
        options: Options,
        policy: &Chooser,
    ) -> anyhow::Result<Row> {
        let spec = catalog.spec(task, &options)?;
        policy.check(&spec)?;
        let grasp = spec
            .options
            .iter()
            .find(|option| option.name == "grasp")
            .map(|option| options::json(options.0.get("grasp").unwrap_or(&option.default)));
        let Self { episodes, seed, envs, view: lifelike, .. } = *self;
        let job = Job { task, options, policy, episodes, seed, envs, lifelike };

        let progress = progress_bar(task, episodes);
        let start = Instant::now();
        let outcomes = run(catalog, &job, &progress)?;
        let seconds = start.elapsed().as_secs_f64();
        progress.finish_and_clear();
        let failed = outcomes.iter().filter(|episode| episode.failed).count();
        if failed > 0 {
            eprintln!("{task}: the simulation of {failed} episodes failed; they count as failures");
        }

        let count = outcomes.len() as f64;
        let mean = |of: fn(&Episode) -> f64| outcomes.iter().map(of).sum::<f64>() / count;
        let has_goal = spec.goal.is_some();
        let mean_length = mean(|episode| episode.length.into());
        Ok(Row {
            task: task.into(),
            policy: policy.to_string(),
            grasp: grasp.unwrap_or(Value::Null),
            episodes,
            success_rate: has_goal.then(|| mean(|episode| episode.success.into())),
            success_ever_rate: has_goal.then(|| mean(|episode| episode.success_ever.into())),
            mean_return: mean(|episode| episode.total_reward),
            mean_length,
            steps_per_second: mean_length * count / seconds,
        })
    }
}

/// A server whose viewer people are told of.
fn start_viewed() -> anyhow::Result<OwnServer> {
    let server = OwnServer::start(&format!("rollout-{}", std::process::id()).parse()?, &[])?;
    eprintln!("Watch it at http://{}", server.viewer()?);
    Ok(server)
}

/// A bar on stderr, which shows nothing where that is not a terminal.
fn progress_bar(task: &str, episodes: u32) -> ProgressBar {
    let style =
        ProgressStyle::with_template("{prefix:18} {bar:40} {pos}/{len} episodes, {eta} left")
            .expect("the template is well-formed");
    ProgressBar::new(episodes.into()).with_style(style).with_prefix(task.to_string())
}
