//! `trocar demo`: a moving picture of a task; then one server, a Rust and two Python clients at work at the same time.
//!
//! Every client is a process of its own. It says when it is ready, begins at a line on its stdin,
//! and reports [`Progress`] as JSON lines on its stdout, which are drawn here.

pub(crate) mod client;
mod display;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::Args;
use serde::{Deserialize, Serialize};
use trocar_proto::endpoint::{Endpoint, ServerName};

use crate::output;
use crate::process::{self, OwnServer, Process};
use display::Display;

/// How long clients may be silent.
const PATIENCE: Duration = Duration::from_mins(1);

/// Show a robot at work, and one server with a Rust and two Python clients.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  python -m trocar demo                         the clients run in this Python
  trocar demo --python .venv/bin/python         a Python that has the package trocar
  trocar demo --seconds 600 --envs 256          time enough to watch it in the viewer
  make demo                                     builds all that is needed, then runs this

Nothing but the picture is left behind, however the demonstration ends.")]
pub(crate) struct Demo {
    /// How long the clients work, s
    #[arg(long, default_value_t = 5.0)]
    seconds: f64,
    /// Environments of each client
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..))]
    envs: u32,
    /// The Python that has the package trocar [default: $TROCAR_PYTHON, else python3]
    #[arg(long, value_name = "PATH")]
    python: Option<PathBuf>,
    /// The file of the moving picture
    #[arg(long, value_name = "FILE.gif", default_value = "trocar-demo.gif")]
    out: PathBuf,
    /// Also one JSON object per client and line, on stdout
    #[arg(long)]
    json: bool,
}

/// The task of the moving picture.
const PICTURED: &str = "NeedlePick-v0";

/// The program of the Python clients, twin of [`client`].
const PYTHON_CLIENT: &str = include_str!("demo/worker.py");

/// One client of the demonstration.
#[derive(Debug, Clone, Copy)]
struct Part {
    name: &'static str,
    language: &'static str,
    task: &'static str,
    seed: u64,
}

const PARTS: [Part; 3] = [
    Part { name: "rust", language: "Rust", task: "NeedleReach-v0", seed: 0 },
    Part { name: "python-1", language: "Python", task: "EcmReach-v0", seed: 100_000 },
    Part { name: "python-2", language: "Python", task: "NeedleReach-v0", seed: 200_000 },
];

/// What a client reports: all counts since it began.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Progress {
    /// Whether this is its last report.
    pub(crate) done: bool,
    /// Time since it began, s.
    pub(crate) seconds: f64,
    /// Episodes that ended.
    pub(crate) episodes: u64,
    /// Episodes that ended in success.
    pub(crate) successes: u64,
    /// Environment steps.
    pub(crate) steps: u64,
    /// Median time from sending the actions of a step to having its observations, µs.
    pub(crate) p50_us: f64,
}

impl Progress {
    fn success_rate(&self) -> Option<f64> {
        (self.episodes > 0).then(|| self.successes as f64 / self.episodes as f64)
    }

    fn steps_per_second(&self) -> f64 {
        if self.seconds > 0.0 { self.steps as f64 / self.seconds } else { 0.0 }
    }
}

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

impl Demo {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        ctrlc::set_handler(|| INTERRUPTED.store(true, Ordering::Release))?;
        let this = std::env::current_exe()?;
        self.draw(&this)?;
        let name: ServerName = format!("demo-{}", std::process::id()).parse()?;
        let endpoint = Endpoint::new(&name);
        let played = self.play(&this, &name);
        // Whatever happened, every process has ended by now.
        endpoint.remove_if_unused()?;
        let last = played?;
        self.show(&last)?;
        let left = endpoint.files()?;
        if !left.is_empty() {
            bail!("left in /dev/shm: {left:?}");
        }
        eprintln!(
            "The server and its {} clients have ended; nothing is left in /dev/shm.

The moving picture is {}: open it in a browser. Then try
  python -m trocar demo --seconds 600                            to watch it in the viewer
  python -m trocar render --task PegTransfer-v0 --out peg.gif    another task's picture
  python -m trocar tasks                                         what there is to learn
and, in Python, gym.make(\"trocar:trocar/{PICTURED}\").",
            PARTS.len(),
            std::path::absolute(&self.out)?.display(),
        );
        Ok(())
    }

    /// Lets `trocar render` draw the moving picture.
    fn draw(&self, this: &Path) -> anyhow::Result<()> {
        eprintln!("Drawing the scripted expert of {PICTURED} (trocar render).");
        let mut render = Command::new(this);
        render.args(["render", "--task", PICTURED, "--out"]).arg(&self.out);
        let drawn = render.status()?.success();
        if INTERRUPTED.load(Ordering::Acquire) {
            bail!("interrupted");
        }
        if !drawn {
            bail!("{} could not be drawn; --out may name another file", self.out.display());
        }
        Ok(())
    }

    /// Runs the server and its clients; returns every client's last report.
    fn play(&self, this: &Path, name: &ServerName) -> anyhow::Result<Vec<Progress>> {
        eprintln!(
            "Starting one server, and {} client processes of {} environments each, for {} s.",
            PARTS.len(),
            self.envs,
            self.seconds
        );
        let server = OwnServer::start(name, &[])?;
        eprintln!("Watch it meanwhile at http://{}", server.viewer()?);

        let (sender, reports) = mpsc::channel();
        let mut workers = Vec::new();
        for (index, part) in PARTS.iter().enumerate() {
            let command = self.command(this, *part, name);
            let mut worker = Process::start(part.name, command)?;
            worker.report_to(index, sender.clone());
            workers.push(worker);
        }
        drop(sender);

        let mut display = Display::new(&PARTS, self.seconds);
        let mut last = [None; PARTS.len()];
        let mut begun = false;
        while !last.iter().all(|progress| matches!(progress, Some(Progress { done: true, .. }))) {
            let (index, line) = next_report(&reports)?;
            let part = PARTS[index];
            let Some(line) = line else {
                if matches!(last[index], Some(Progress { done: true, .. })) {
                    continue;
                }
                bail!("client {} ended early; what it said is above", part.name);
            };
            let progress: Progress = serde_json::from_str(&line)
                .with_context(|| format!("client {} said {line:?}", part.name))?;
            last[index] = Some(progress);
            display.show(index, &progress);
            if !begun && last.iter().all(Option::is_some) {
                begun = true;
                workers.iter_mut().try_for_each(|worker| worker.tell("go"))?;
            }
        }
        display.finish();
        for mut worker in workers {
            worker.wait(PATIENCE)?;
        }
        server.stop()?;
        Ok(last.into_iter().flatten().collect())
    }

    /// The program of one client.
    fn command(&self, this: &Path, part: Part, server: &ServerName) -> Command {
        let mut command = if part.language == "Rust" {
            let mut command = Command::new(this);
            command.arg("demo-client");
            command
        } else {
            let mut command = Command::new(self.python.clone().unwrap_or_else(process::python));
            command.args(["-c", PYTHON_CLIENT]);
            command
        };
        command.args(["--server", server.as_str(), "--task", part.task]);
        command.args(["--envs", &self.envs.to_string(), "--seed", &part.seed.to_string()]);
        command.args(["--seconds", &self.seconds.to_string()]);
        command
    }

    fn show(&self, last: &[Progress]) -> anyhow::Result<()> {
        let header = ["client", "language", "task", "envs", "episodes", "success", "steps/s"];
        let header: Vec<_> = header.into_iter().chain(["p50 step latency"]).collect();
        let mut table = output::table(&header, 3);
        for (part, progress) in PARTS.iter().zip(last) {
            if self.json {
                output::json_line(&serde_json::json!({
                    "client": part.name,
                    "language": part.language,
                    "task": part.task,
                    "envs": self.envs,
                    "episodes": progress.episodes,
                    "success_rate": progress.success_rate(),
                    "steps_per_second": progress.steps_per_second(),
                    "p50_us": progress.p50_us,
                }))?;
            }
            table.add_row([
                part.name.into(),
                part.language.into(),
                part.task.into(),
                self.envs.to_string(),
                progress.episodes.to_string(),
                output::percent(progress.success_rate()),
                format!("{:.0}", progress.steps_per_second()),
                format!("{:.2} ms", progress.p50_us / 1000.0),
            ]);
        }
        eprintln!("{table}");
        Ok(())
    }
}

/// The next line that a client said, or `None` for its end.
fn next_report(
    reports: &mpsc::Receiver<(usize, Option<String>)>,
) -> anyhow::Result<(usize, Option<String>)> {
    let start = Instant::now();
    loop {
        match reports.recv_timeout(Duration::from_millis(100)) {
            Ok(report) => return Ok(report),
            Err(RecvTimeoutError::Disconnected) => bail!("every client has ended early"),
            Err(RecvTimeoutError::Timeout) if INTERRUPTED.load(Ordering::Acquire) => {
                bail!("interrupted")
            }
            Err(RecvTimeoutError::Timeout) if start.elapsed() > PATIENCE => {
                bail!("no client has said anything for {} s", PATIENCE.as_secs())
            }
            Err(RecvTimeoutError::Timeout) => {}
        }
    }
}
