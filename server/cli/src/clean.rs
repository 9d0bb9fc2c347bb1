//! `trocar clean`: remove what crashed servers and clients left in shared memory.

use clap::Args;
use trocar_proto::endpoint::{Endpoint, ServerName, ServerState};

use crate::exit::Exit;

/// Remove what crashed servers and clients left in shared memory.
///
/// Only what no process uses is removed: every participant holds a lock that the kernel drops when
/// the process ends, however it ends. A new server of the same name cleans up by itself, so this is
/// needed only where none follows.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar clean --name lab     one server's leftovers
  trocar clean --all          those of every server of yours

Exit codes: 0 nothing is left (with --all: nothing unused), 4 somebody uses it.")]
pub(crate) struct Clean {
    /// Whose leftovers to remove
    #[arg(long, default_value = "default", conflicts_with = "all")]
    name: ServerName,
    /// Those of every server name of this user
    #[arg(long)]
    all: bool,
}

impl Clean {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        if self.all {
            let endpoints = Endpoint::all()?;
            if endpoints.is_empty() {
                eprintln!("nothing is left in /dev/shm");
            }
            for endpoint in endpoints {
                if let Some(user) = clean(&endpoint)? {
                    eprintln!("{}: {user}", endpoint.name());
                }
            }
            return Ok(());
        }
        let endpoint = Endpoint::new(&self.name);
        match clean(&endpoint)? {
            None => Ok(()),
            Some(user) => Err(Exit::InUse(format!("{}: {user}", self.name)).into()),
        }
    }
}

/// Removes what is left of one server, or says which processes use it.
fn clean(endpoint: &Endpoint) -> anyhow::Result<Option<String>> {
    let name = endpoint.name();
    let files = endpoint.files()?.len();
    if endpoint.remove_if_unused()? {
        if files == 0 {
            eprintln!("{name}: nothing is left");
        } else {
            eprintln!("{name}: removed {files} files");
        }
        return Ok(None);
    }
    Ok(Some(match endpoint.server_state() {
        ServerState::Running { pid, .. } => {
            format!("in use: its server runs (process {pid}); `trocar stop --name {name}` ends it")
        }
        ServerState::Ending { pid, .. } => format!("in use: its server (process {pid}) is ending"),
        ServerState::Closed { .. } | ServerState::Absent => {
            "in use: its server is gone, but clients of it still live; it is removed with the last \
             of them"
                .into()
        }
    }))
}
