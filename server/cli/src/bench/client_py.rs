//! Environments in a server, stepped by a Python client: one process for all measurements.

use std::process::Command;
use std::sync::mpsc::{self, Receiver};
use std::time::Duration;

use anyhow::{Context, bail};
use serde_json::{Value, json};

use super::pool::PoolFile;
use super::{Job, Measured, Stopwatch};
use crate::options;
use crate::process::{OwnServer, PYTHON, Process, python};

/// How long it may be silent: the longest measurement, and some.
const PATIENCE: Duration = Duration::from_mins(10);

/// The client's program.
const PROGRAM: &str = include_str!("worker.py");

/// The Python client.
#[derive(Debug)]
pub(super) struct PythonClient {
    process: Process,
    lines: Receiver<(usize, Option<String>)>,
}

impl PythonClient {
    /// Starts it; fails where there is no Python, or none with the package.
    pub(super) fn start(server: &str) -> anyhow::Result<Self> {
        let python = python();
        let mut command = Command::new(&python);
        command.args(["-c", PROGRAM, server]);
        let mut process = Process::start("python", command)?;
        let (sender, lines) = mpsc::channel();
        process.report_to(0, sender);
        let mut client = Self { process, lines };
        match client.hear()? {
            said if said["ready"] == true => Ok(client),
            said => bail!(
                "{}: {}; ${PYTHON} may name a Python that has the package trocar",
                python.display(),
                said["error"].as_str().unwrap_or("it does not answer")
            ),
        }
    }

    /// Measures a job.
    pub(super) fn run(&mut self, server: &OwnServer, job: &Job) -> anyhow::Result<Measured> {
        let given = job.options.0.iter().map(|(name, value)| (name.clone(), options::json(value)));
        let pool = job.pool.as_ref().map(|pool| pool.write()).transpose()?;
        let wanted = json!({
            "actions": pool.as_ref().map(PoolFile::path),
            "task": job.task,
            "options": given.collect::<serde_json::Map<_, _>>(),
            "expert": job.policy.asks_expert(),
            "envs": job.envs,
            "seconds": job.time.as_secs_f64(),
            "warm_up": super::WARM_UP,
            "beginnings": super::BEGINNINGS,
        });
        self.process.tell(&wanted.to_string())?;
        self.hear()?;
        let watch = Stopwatch::start(&[self.process.pid(), server.pid()])?;
        self.process.tell("go")?;
        let said = self.hear()?;
        watch.stop(said["steps"].as_u64().context("the Python client tells no steps")?)
    }

    /// What it says next.
    fn hear(&mut self) -> anyhow::Result<Value> {
        match self.lines.recv_timeout(PATIENCE) {
            Ok((_, Some(line))) => Ok(serde_json::from_str(&line)?),
            Ok((_, None)) => bail!("the Python client has ended; what it said is above"),
            Err(_) => bail!("the Python client says nothing"),
        }
    }
}
