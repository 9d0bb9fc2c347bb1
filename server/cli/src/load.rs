//! `trocar load`: many clients at once, some of them killed or stopped, each compared bit by bit
//! with the same environments in-process.
//!
//! | file | holds |
//! |---|---|
//! | `course.rs` | what happens when |
//! | `twin.rs` | the same environments without a server, and what clients do in them |
//! | `worker.rs`, `worker.py` | a client, in Rust and in Python |
//! | `checker.rs` | the twin of a Python client, in this process |
//! | `fleet.rs` | the clients' processes |
//! | `target.rs` | the server under load, and what there is of it in shared memory |
//! | `report.rs` | counts, latencies, fairness; the table and the JSON line |

mod checker;
mod course;
mod fleet;
mod report;
mod target;
mod twin;
pub(crate) mod worker;

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::bail;
use clap::Args;
use trocar_proto::Options;
use trocar_proto::endpoint::ServerName;
use trocar_server::Registry;

use course::Course;

/// How long clients and servers may take for what takes milliseconds on an idle machine.
const PATIENCE: Duration = Duration::from_mins(1);

/// Decimal digits of latencies that are kept.
const DIGITS: u8 = 3;

/// Load a server with many clients at once, and see that every bit is right and nothing is left.
///
/// Each client is a process with a session of its own. It compares all that its environments show
/// with the same environments in-process, so about half of the CPU time goes into that. Killed clients
/// are replaced by new ones; stopped ones go on after 0.1 to 1 s.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar load                                            8 clients of 4 environments, for 10 s
  trocar load --clients 16 --seconds 600 --kill-every 2 --stop-every 5
  trocar load --seconds 60 --restart-server 3            kill the server, too
  trocar load --server lab --task NeedlePick-v0 --json   a server that runs already
  trocar load --others BiPegTransfer-v0                  one client beside seven that compute much
  TROCAR_PYTHON=.venv/bin/python trocar load --python    clients in Python

A message steps all environments of a client; its latency is seen from the client. Fairness is
Jain's index of environment steps per second in which a client had a session and was not stopped:
1 is even. A mismatch is a session that departs from its twin. A leak is what there is more at the
end than before the first client: sessions, files in /dev/shm and memory behind them, open files
and mappings of the server. Beside other clients, only sessions are looked at. Half of the
environments follow the scripted expert, the others act at random.

With --others, the share of the first client implies that a message takes its own computation and
one quantum of each other client, on as many threads as there are cores; a quantum counts as a
step of one of their environments, but at least 1 ms. Both are measured in the twins, that is
under the same load.

With --json: {clients, envs, steps, steps_per_second, p50_us, p99_us,
jain, killed, reclaimed, stopped, restarts, errors, mismatches, leaked, server_memory_bytes}; with
--others also {first_p99_us, share_us}.

Exit codes: 0 all was right, 1 errors, mismatches, leaks or sessions of killed clients that stay,
2 wrong usage, 3 no server of that name runs.")]
pub(crate) struct Load {
    /// The server to load [default: one of its own, which ends with the load]
    #[arg(long, value_name = "NAME")]
    server: Option<ServerName>,
    /// How many clients at a time
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=500))]
    clients: u32,
    /// Environments of each client
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    envs: u32,
    /// A task id of `trocar tasks`
    #[arg(long, default_value = "NeedleReach-v0")]
    task: String,
    /// Another task for all clients but the first, whose latency is then compared with its share
    #[arg(long, value_name = "TASK")]
    others: Option<String>,
    /// How long the load lasts, s
    #[arg(long, default_value_t = 10.0, value_parser = seconds)]
    seconds: f64,
    /// Kill a client about every so many seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    kill_every: Option<f64>,
    /// Stop a client for a while about every so many seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    stop_every: Option<f64>,
    /// Kill the server and start another about every so many seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds, conflicts_with = "server")]
    restart_server: Option<f64>,
    /// Clients in Python instead of Rust
    #[arg(long)]
    python: bool,
    /// Environments have the seeds from SEED on; it also decides which clients are killed and
    /// stopped
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// One JSON object on stdout
    #[arg(long)]
    json: bool,
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (0.01..1e6).contains(&seconds) => Ok(seconds),
        _ => Err("expected a number of seconds, at least 0.01".into()),
    }
}

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

impl Load {
    /// The task of client `index`.
    fn task_of(&self, index: usize) -> &str {
        self.others.as_deref().filter(|_| index > 0).unwrap_or(&self.task)
    }

    pub(crate) fn run(self) -> anyhow::Result<()> {
        // What cannot work is refused before anything is started.
        for task in [Some(&self.task), self.others.as_ref()].into_iter().flatten() {
            Registry::builtin().spec(task, &Options::new())?;
        }
        if self.python {
            fleet::check_python()?;
        }
        ctrlc::set_handler(|| INTERRUPTED.store(true, Ordering::Release))?;
        let summary = Course::new(&self)?.run(self.json)?;
        match summary.failure() {
            Some(failure) => bail!(failure),
            None => Ok(()),
        }
    }
}
