//! The private server of a process tree.
//!
//! Where no server is named, the processes of a tree share a server of their own. Its name travels in [`VARIABLE`]
//! from parent to child; the process that needs the server first starts it. The server belongs to its clients: it
//! runs as long as one of them lives, detached or orphaned, and ends when the last has been gone for a while.

use std::ffi::OsString;
use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use rustix::fs::{FallocateFlags, FlockOperation, fallocate, flock};
use rustix::io::Errno;
use trocar_proto::Rejection;
use trocar_proto::endpoint::{Endpoint, Membership, ServerName, ServerState};

use crate::error::ConnectError;

/// The environment variable that carries the server's name to child processes.
pub const VARIABLE: &str = "TROCAR_PRIVATE_SERVER";

/// The environment variable with the path of the `trocar` program.
pub const BINARY: &str = "TROCAR_BINARY";

/// Room that its log has for certain, bytes.
const LOG_BYTES: u64 = 16 << 10;

/// How long a starting server may take before its clients give up.
const PATIENCE: Duration = Duration::from_secs(20);

/// A private server: its name, and the program to start.
#[derive(Debug, Clone)]
pub struct PrivateServer {
    name: ServerName,
    binary: PathBuf,
}

impl PrivateServer {
    /// The private server that [`VARIABLE`] names, else one of this process alone. The program is
    /// `$TROCAR_BINARY`, else `trocar` beside this executable, else on the PATH.
    pub fn of_this_process_tree() -> Result<Self, ConnectError> {
        static OWN: OnceLock<String> = OnceLock::new();
        let text = match set(VARIABLE) {
            Some(text) => text.to_string_lossy().into_owned(),
            None => OWN.get_or_init(unique_name).clone(),
        };
        let beside = std::env::current_exe().ok().map(|path| path.with_file_name("trocar"));
        let binary = set(BINARY)
            .map(PathBuf::from)
            .or_else(|| beside.filter(|path| path.is_file()))
            .unwrap_or_else(|| PathBuf::from("trocar"));
        Self::new(&text, &binary)
    }

    /// The private server of that name, run by `binary`.
    pub fn new(name: &str, binary: &Path) -> Result<Self, ConnectError> {
        let name = name.parse().map_err(|refusal: Rejection| ConnectError::Launch {
            reason: format!("{VARIABLE} = {name:?}: {}", refusal.allowed),
        })?;
        Ok(Self { name, binary: binary.into() })
    }

    /// Where it is found.
    pub fn endpoint(&self) -> Endpoint {
        Endpoint::new(&self.name)
    }

    /// Starts the server unless it runs. One process starts it, the others wait for that.
    pub(crate) fn start_if_absent(&self, membership: &Membership) -> Result<(), ConnectError> {
        let failed = |what: &str, reason: &dyn std::fmt::Display| ConnectError::Launch {
            reason: format!("{what}: {reason}"),
        };
        let folder = membership.endpoint().folder();
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).mode(0o600);
        let turn = options
            .clone()
            .truncate(false)
            .open(folder.join("launch.lock"))
            .map_err(|error| failed("launch.lock", &error))?;
        let waited = Instant::now();
        while flock(&turn, FlockOperation::NonBlockingLockExclusive).is_err() {
            if waited.elapsed() > PATIENCE {
                let seconds = PATIENCE.as_secs();
                let reason = format!("another process has been starting it for {seconds} s");
                return Err(failed("launch.lock", &reason));
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        let runs = || matches!(membership.endpoint().server_state(), ServerState::Running { .. });
        if runs() {
            return Ok(());
        }
        let log_path = folder.join("server.log");
        let log =
            options.truncate(true).open(&log_path).map_err(|error| failed("server.log", &error))?;
        // What it says when it cannot start must have room, whatever fills shared memory.
        fallocate(&log, FallocateFlags::KEEP_SIZE, 0, LOG_BYTES)
            .map_err(|error| failed("server.log in /dev/shm", &io::Error::from(error)))?;
        let mut child = Command::new(&self.binary)
            .args(["serve", "--private", self.name.as_str()])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            // A group of its own: Ctrl-C in a terminal is for the trainers.
            .process_group(0)
            .spawn()
            .map_err(|error| {
                let binary = self.binary.display();
                let hint = format!(
                    "install it (the wheel trocar-server), or say in ${BINARY} where it is"
                );
                failed(&format!("{binary}: {hint}"), &error)
            })?;
        let start = Instant::now();
        while !runs() {
            if let Some(status) = end_of(&mut child).map_err(|error| failed("wait", &error))? {
                let mut log = String::new();
                File::open(&log_path).and_then(|mut file| file.read_to_string(&mut log)).ok();
                return Err(failed(&format!("it ended with {status}"), &log.trim()));
            }
            if start.elapsed() > PATIENCE {
                return Err(failed("it did not come up", &log_path.display()));
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        keep(child);
        Ok(())
    }
}

/// Exit status of a process that has ended, in words; `None` while the process runs. The kernel keeps no status for a
/// parent that ignores SIGCHLD.
fn end_of(child: &mut Child) -> io::Result<Option<String>> {
    match child.try_wait() {
        Ok(status) => Ok(status.map(|status| status.to_string())),
        Err(error) if error.raw_os_error() == Some(Errno::CHILD.raw_os_error()) => {
            Ok(Some("an unknown status, since this process ignores SIGCHLD".into()))
        }
        Err(error) => Err(error),
    }
}

/// The value of an environment variable; an empty one is none.
pub(crate) fn set(variable: &str) -> Option<OsString> {
    std::env::var_os(variable).filter(|value| !value.is_empty())
}

/// Keeps a server that this process started, and collects the exit status of those that ended:
/// without a thread, since Python warns about forking where there are threads.
fn keep(server: Child) {
    static STARTED: Mutex<Vec<Child>> = Mutex::new(Vec::new());
    let mut started = STARTED.lock().unwrap_or_else(PoisonError::into_inner);
    started.retain_mut(|child| matches!(child.try_wait(), Ok(None)));
    started.push(server);
}

/// A name for a private server that no other has.
pub fn unique_name() -> String {
    let mut bytes = [0; 6];
    let filled = File::open("/dev/urandom").and_then(|mut file| file.read_exact(&mut bytes));
    let unique = match filled {
        Ok(()) => bytes.iter().fold(0, |value, byte| value << 8 | u64::from(*byte)),
        // Time and process id are unique on one machine.
        Err(_) => std::time::UNIX_EPOCH.elapsed().map_or(0, |time| time.as_micros() as u64),
    };
    format!("private-{:012x}", unique & 0xffff_ffff_ffff)
}
