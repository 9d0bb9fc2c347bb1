//! `trocar status`: running servers, their clients and how fast they run.

use std::collections::BTreeMap;
use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use clap::Args;
use trocar_client::{Client, ConnectError, ServerStatus};
use trocar_proto::endpoint::{Endpoint, ServerName, ServerState};

use crate::exit::Exit;
use crate::{output, usage};

/// How often `--watch` looks.
const INTERVAL: Duration = Duration::from_secs(1);

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Show running servers: their clients and how fast they run.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar status                          every server of yours, private ones included
  trocar status --name lab --watch       one server, once a second until Ctrl-C
  trocar status --name lab --json        {name, pid, epoch, uptime_s, sessions, memory_bytes}

CPU is the load of the server's process since the last look, or since its start. Memory is the
memory that counts for sessions, and the memory of the process in RAM. Latencies are the server's
times for one message (a step of all environments of a session), without the way through shared
memory.")]
pub(crate) struct Status {
    /// The server to show [default: every running server of this user]
    #[arg(long)]
    name: Option<ServerName>,
    /// Show it again every second until Ctrl-C
    #[arg(long)]
    watch: bool,
    /// One JSON object per server and line, on stdout
    #[arg(long)]
    json: bool,
}

impl Status {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        let mut cpu_times = CpuTimes::default();
        if !self.watch {
            return self.show(&self.statuses()?, &mut cpu_times);
        }
        ctrlc::set_handler(|| INTERRUPTED.store(true, Ordering::Release))?;
        while !INTERRUPTED.load(Ordering::Acquire) {
            let start = Instant::now();
            let statuses = self.statuses()?;
            if !self.json && std::io::stderr().is_terminal() {
                // Clear the screen and go to its corner.
                write!(std::io::stderr(), "\x1b[2J\x1b[H")?;
            }
            self.show(&statuses, &mut cpu_times)?;
            while start.elapsed() < INTERVAL && !INTERRUPTED.load(Ordering::Acquire) {
                std::thread::sleep(Duration::from_millis(50));
            }
        }
        Ok(())
    }

    fn statuses(&self) -> anyhow::Result<Vec<ServerStatus>> {
        if let Some(name) = &self.name {
            return Ok(vec![Client::connect(name.as_str())?.status()?]);
        }
        let mut statuses = Vec::new();
        for endpoint in Endpoint::all()? {
            if !matches!(endpoint.server_state(), ServerState::Running { .. }) {
                continue;
            }
            match Client::connect(endpoint.name().as_str()) {
                Ok(client) => statuses.push(client.status()?),
                // It ended between the look and the call.
                Err(ConnectError::NoServer { .. }) => {}
                Err(error) => return Err(error.into()),
            }
        }
        if statuses.is_empty() {
            let hint = "no server is running; start one with `trocar serve --name lab`";
            return Err(Exit::NoServer(hint.into()).into());
        }
        Ok(statuses)
    }

    fn show(&self, statuses: &[ServerStatus], cpu_times: &mut CpuTimes) -> anyhow::Result<()> {
        for status in statuses {
            if self.json {
                output::json_line(status)?;
            } else {
                show_for_people(status, cpu_times);
            }
        }
        Ok(())
    }
}

/// CPU times of servers when they were last looked at, by the run of the server.
#[derive(Default)]
struct CpuTimes(BTreeMap<u64, (Instant, f64)>);

impl CpuTimes {
    /// Cores that the server was using since the last look, at first since its start.
    fn cores(&mut self, status: &ServerStatus) -> Option<f64> {
        let seconds = usage::cpu_seconds(&[status.pid]).ok()?;
        let now = Instant::now();
        Some(match self.0.insert(status.epoch, (now, seconds)) {
            Some((then, before)) => (seconds - before) / (now - then).as_secs_f64(),
            None => seconds / status.uptime_s,
        })
    }
}

fn show_for_people(status: &ServerStatus, cpu_times: &mut CpuTimes) {
    let ServerStatus { name, pid, sessions, .. } = status;
    let uptime = output::duration(Duration::from_secs_f64(status.uptime_s));
    let memory = output::mebibytes(status.memory_bytes);
    let count = sessions.len();
    let plural = if count == 1 { "" } else { "s" };
    let folder = name.parse().map(|name| Endpoint::new(&name).folder().to_path_buf());
    // The process id is the server's own idea of it: in another namespace it may be another
    // process's.
    let seen = folder.is_ok_and(|folder| usage::holds_files_in(*pid, &folder));
    let cores = if seen { cpu_times.cores(status) } else { None };
    let cpu = cores.map_or(String::new(), |cores| format!(", CPU {:.0} %", cores * 100.0));
    let resident = usage::resident_memory(*pid).filter(|_| seen);
    let resident = resident
        .map_or(String::new(), |bytes| format!(" of budget, {} in RAM", output::mebibytes(bytes)));
    eprintln!(
        "server {name}: process {pid}, up {uptime}{cpu}, {count} session{plural}, {memory}{resident}"
    );
    if sessions.is_empty() {
        return;
    }
    let header = ["task", "session", "process", "envs", "steps/s", "p50 µs", "p99 µs"];
    let mut table = output::table(&header, 1);
    for session in sessions {
        table.add_row([
            session.task.clone(),
            session.id.to_string(),
            session.pid.to_string(),
            session.envs.to_string(),
            format!("{:.0}", session.steps_per_second),
            format!("{:.0}", session.p50_us),
            format!("{:.0}", session.p99_us),
        ]);
    }
    eprintln!("{table}");
}
