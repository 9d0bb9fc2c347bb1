//! `trocar stop`: end a server and wait until it has ended.

use std::thread;
use std::time::{Duration, Instant};

use anyhow::bail;
use clap::Args;
use rustix::process::{Pid, Signal, kill_process};
use trocar_client::{CallError, Client, ConnectError};
use trocar_proto::endpoint::{Endpoint, ServerName, ServerState};

use crate::usage::holds_files_in;

/// How long a server may take to end after it was asked, and again after a signal.
const PATIENCE: Duration = Duration::from_secs(5);

/// End a server and wait until it has ended; its clients are told.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar stop --name lab            asks it to end; after 5 s sends SIGTERM
  trocar stop --name lab --force    and if that does not help either, kills it

Exit codes: 0 it has ended, 1 it still runs, 3 no server of that name runs.")]
pub(crate) struct Stop {
    /// The server to end
    #[arg(long, default_value = "default")]
    name: ServerName,
    /// Kill it if it does not end otherwise; its clients then get ServerLost
    #[arg(long)]
    force: bool,
}

impl Stop {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        let name = &self.name;
        let endpoint = Endpoint::new(name);
        let ServerState::Running { pid, epoch } = endpoint.server_state() else {
            return Err(ConnectError::NoServer { name: name.to_string() }.into());
        };
        let server = Running { endpoint: &endpoint, pid, epoch };
        // A server that is stuck does not answer, so the wait is for its end, not for the answer.
        let asked = thread::spawn({
            let name = name.clone();
            move || ask(&name)
        });
        let mut ended = server.ends_within(PATIENCE);
        if !ended {
            eprintln!("server {name} has not ended yet: sending SIGTERM to process {pid}");
            ended = server.signal(Signal::TERM)?;
        }
        if !ended && self.force {
            eprintln!("server {name} still has not ended: killing process {pid}");
            ended = server.signal(Signal::KILL)?;
        }
        if !ended {
            bail!(
                "server {name} (process {pid}) still runs; end it with `trocar stop --name {name} --force`"
            );
        }
        // Its connection ends with the server's; the last one out removes what is left.
        if let Ok(Err(error)) = asked.join() {
            eprintln!("server {name} could not be asked to end: {error:#}");
        }
        endpoint.remove_if_unused()?;
        eprintln!("server {name} has ended");
        Ok(())
    }
}

fn ask(name: &ServerName) -> anyhow::Result<()> {
    match Client::connect(name.as_str()) {
        Ok(client) => match client.shut_down() {
            // It was gone before it could say so.
            Ok(()) | Err(CallError::ServerLost { .. }) => Ok(()),
            Err(error) => Err(error.into()),
        },
        Err(ConnectError::NoServer { .. }) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

/// The run of a server that is to end; another one of its name may follow at once.
struct Running<'a> {
    endpoint: &'a Endpoint,
    pid: u32,
    epoch: u64,
}

impl Running<'_> {
    fn ends_within(&self, patience: Duration) -> bool {
        let start = Instant::now();
        while self.runs() {
            if start.elapsed() > patience {
                return false;
            }
            thread::sleep(Duration::from_millis(10));
        }
        true
    }

    fn runs(&self) -> bool {
        let state = self.endpoint.server_state();
        matches!(state, ServerState::Running { epoch, .. } if epoch == self.epoch)
            || holds_files_in(self.pid, self.endpoint.folder())
    }

    /// Sends a signal and waits. The process id is the server's own idea of it; in another
    /// namespace it may be another process's. So the process must be seen to hold the server's
    /// files.
    fn signal(&self, signal: Signal) -> anyhow::Result<bool> {
        let pid = self.pid;
        let process = i32::try_from(pid).ok().and_then(Pid::from_raw);
        let Some(process) = process.filter(|_| holds_files_in(pid, self.endpoint.folder())) else {
            bail!(
                "process {pid} is not the server as seen from here (another container, or another \
                 process namespace); end it where it was started"
            );
        };
        kill_process(process, signal)?;
        Ok(self.ends_within(PATIENCE))
    }
}
