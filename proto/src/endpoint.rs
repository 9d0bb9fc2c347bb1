//! Where a server is found: its name, its folder, its locks, and how the transport is configured.
//!
//! Both sides build the transport's whole configuration here, in code, so that no file found in a
//! working directory can change it. Everything lives under `/dev/shm`: processes that share only
//! that (containers, say) meet, and one look there shows whether anything is left.
//!
//! | path | is |
//! |---|---|
//! | `/dev/shm/trocar.<uid>.<name>/` | the folder of one server; every participant holds a shared lock on it |
//! | `…/server.lock` | locked exclusively by the running server; holds its process id and epoch |
//! | `/dev/shm/trocar-<hash>.*` | shared memory of that server and its clients |
//!
//! The kernel drops a lock with the process that held it, however that ended. So a process that
//! gets the exclusive lock on the folder knows that no other process uses it, and may remove all of
//! it. That is how a new server starts at once after a crash, and how the last process out leaves
//! nothing behind.

use std::fmt;
use std::fs::{self, File, OpenOptions};
use std::io;
use std::os::unix::fs::{DirBuilderExt, FileExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::{Duration, Instant};

use iceoryx2::config::Config;
use iceoryx2::node::NodeBuilder;
use iceoryx2::prelude::{FileName, SemanticString, SignalHandlingMode, ipc_threadsafe};
use rustix::fs::{FallocateFlags, FlockOperation, fallocate, flock};
use rustix::io::{Errno, retry_on_intr};

use crate::cause;
use crate::error::{Code, Rejection};

/// Where shared memory lives on Linux.
const SHARED_MEMORY: &str = "/dev/shm";

/// How the names of files go on after the prefix by which server and clients notify each other.
const NOTIFY: &str = "notify.";

/// The flavour of transport that both sides use; its ports may move between threads.
pub type Transport = ipc_threadsafe::Service;

/// A participant of the transport.
pub type Node = iceoryx2::node::Node<Transport>;

/// How long another process may take to remove an endpoint's remains.
const JOINING: Duration = Duration::from_secs(8);

/// Shared memory that a client takes beside its sessions, bytes: room for its control requests, and bookkeeping.
pub const CLIENT_BYTES: u64 = 256 << 10;

/// Most clients that one server serves at a time.
pub const MAX_CLIENTS: usize = 512;

/// Shortest wait at a bell: the transport counts in whole microseconds (`timeval`), and the kernel
/// takes none of them for a wait without end (socket(7), `SO_RCVTIMEO`).
pub const LEAST_WAIT: Duration = Duration::from_micros(1);

/// The name of a server: 1 to 24 letters, digits, `-` or `_`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ServerName(String);

impl ServerName {
    /// Longest name: socket paths in the server's folder must stay below 108 bytes.
    pub const MAX_LENGTH: usize = 24;

    /// The name as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for ServerName {
    type Err = Rejection;

    fn from_str(name: &str) -> Result<Self, Rejection> {
        let allowed = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if (1..=Self::MAX_LENGTH).contains(&name.len()) && name.chars().all(allowed) {
            return Ok(Self(name.into()));
        }
        Err(Rejection::new(
            Code::InvalidOption,
            "server name",
            format!("{name:?}"),
            format!("allowed are 1 to {} of A-Z a-z 0-9 - _", Self::MAX_LENGTH),
        ))
    }
}

impl fmt::Display for ServerName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// The folder and the shared memory of one server name, for this user.
#[derive(Debug, Clone)]
pub struct Endpoint {
    name: ServerName,
    folder: PathBuf,
    /// Kept, so that looking whether the server runs allocates nothing.
    server_lock: PathBuf,
    prefix: String,
}

impl Endpoint {
    /// The endpoint of `name` for the user this process runs as.
    pub fn new(name: &ServerName) -> Self {
        let folder_name = format!("{}{name}", folder_prefix());
        // FNV-1a, 32 bits: short, and the same in every build.
        let hash = folder_name
            .bytes()
            .fold(0x811c_9dc5_u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
        let folder = Path::new(SHARED_MEMORY).join(folder_name);
        Self {
            name: name.clone(),
            server_lock: folder.join("server.lock"),
            folder,
            prefix: format!("trocar-{hash:08x}."),
        }
    }

    /// Every endpoint of this user of which a folder exists, by name.
    pub fn all() -> io::Result<Vec<Self>> {
        let prefix = folder_prefix();
        let mut names = Vec::new();
        for entry in fs::read_dir(SHARED_MEMORY)? {
            let file_name = entry?.file_name();
            let name = file_name.to_str().and_then(|text| text.strip_prefix(&prefix));
            names.extend(name.and_then(|name| name.parse::<ServerName>().ok()));
        }
        names.sort();
        Ok(names.iter().map(Self::new).collect())
    }

    /// The server's name.
    pub fn name(&self) -> &ServerName {
        &self.name
    }

    /// The folder with the server's lock and bookkeeping.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Joins the endpoint: creates the folder where it is missing and holds a shared lock on it. A
    /// process that finds itself alone removes what crashed predecessors left.
    pub fn join(&self) -> io::Result<Membership> {
        loop {
            match fs::DirBuilder::new().mode(0o700).create(&self.folder) {
                Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
                _ => {}
            }
            let Some(membership) = self.open_folder()? else { continue };
            if try_lock(&membership.lock, FlockOperation::NonBlockingLockExclusive)? {
                if !membership.is_current() {
                    continue;
                }
                membership.endpoint.remove_contents()?;
            }
            let waited = Instant::now();
            while !try_lock(&membership.lock, FlockOperation::NonBlockingLockShared)? {
                if waited.elapsed() > JOINING {
                    let why = "another process has been removing the server's folder for too long";
                    return Err(io::Error::new(io::ErrorKind::TimedOut, why));
                }
                std::thread::sleep(Duration::from_millis(1));
            }
            // Turning one lock into another is not atomic: another process may have removed the
            // folder.
            if membership.is_current() {
                return Ok(membership);
            }
        }
    }

    /// Removes all that is left under this name, unless a process uses it. Returns whether it did.
    pub fn remove_if_unused(&self) -> io::Result<bool> {
        match self.open_folder()? {
            Some(membership) => membership.leave(),
            None => Ok(true),
        }
    }

    /// Every file in shared memory that belongs to this endpoint, its folder first.
    pub fn files(&self) -> io::Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        if self.folder.exists() {
            files.push(self.folder.clone());
        }
        for entry in fs::read_dir(SHARED_MEMORY)? {
            let entry = entry?;
            if entry.file_name().to_str().is_some_and(|name| name.starts_with(&self.prefix)) {
                files.push(entry.path());
            }
        }
        Ok(files)
    }

    /// As [`Self::look`]; where that fails, no server is there.
    pub fn server_state(&self) -> ServerState {
        self.look().unwrap_or(ServerState::Absent)
    }

    /// Whether a server runs, and which: one non-blocking lock, a few microseconds. An error where that cannot be found
    /// out, since this process may open no more files, for example.
    pub fn look(&self) -> io::Result<ServerState> {
        let file = match File::open(&self.server_lock) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Ok(ServerState::Absent);
            }
            Err(error) => return Err(error),
        };
        let locked = !try_lock(&file, FlockOperation::NonBlockingLockShared)?;
        Ok(match (locked, read_words(&file)?) {
            (true, [pid, epoch, CLOSED]) => ServerState::Ending { pid: pid as u32, epoch },
            (false, [_, epoch, CLOSED]) => ServerState::Closed { epoch },
            (true, [pid, epoch, _]) => ServerState::Running { pid: pid as u32, epoch },
            (false, _) => ServerState::Absent,
        })
    }

    /// Everything that exists under this name: the folder and pieces of shared memory.
    pub fn remains(&self) -> io::Result<Vec<PathBuf>> {
        let mut paths = self.segments()?;
        paths.extend(self.folder.exists().then(|| self.folder.clone()));
        Ok(paths)
    }

    /// Free shared memory, bytes.
    pub fn free_memory() -> io::Result<u64> {
        let status = rustix::fs::statvfs(SHARED_MEMORY)?;
        Ok(status.f_bavail.saturating_mul(status.f_frsize))
    }

    /// An error that says so unless `bytes` of shared memory are free for `what`.
    pub fn check_free(what: &str, bytes: u64) -> io::Result<()> {
        let free = Self::free_memory()?;
        if free >= bytes {
            return Ok(());
        }
        let [free, needed] = [free, bytes].map(|bytes| bytes >> 10);
        Err(io::Error::new(
            io::ErrorKind::StorageFull,
            format!(
                "{free} KiB of /dev/shm are free, and {what} needs {needed} KiB; remove what fills it, or give the \
                 container more (docker run --shm-size)"
            ),
        ))
    }

    /// Allocates what of the endpoint's shared memory is only promised: a process that first wrote to such a page
    /// while `/dev/shm` is full would be ended by a signal. `what` is named where there is not enough.
    pub fn allocate(&self, what: &str) -> io::Result<()> {
        let mut missing = 0;
        for path in self.segments()? {
            let Ok(metadata) = fs::metadata(&path) else { continue }; // removed meanwhile
            let promised = metadata.len().saturating_sub(metadata.blocks() * 512);
            if promised == 0 {
                continue;
            }
            let Ok(file) = OpenOptions::new().write(true).open(&path) else { continue };
            let all = || fallocate(&file, FallocateFlags::empty(), 0, metadata.len());
            if let Err(error) = retry_on_intr(all) {
                if error != Errno::NOSPC {
                    return Err(error.into());
                }
                missing += promised;
            }
        }
        if missing == 0 {
            return Ok(());
        }
        Self::check_free(what, missing)?;
        Err(io::ErrorKind::StorageFull.into())
    }

    /// The pieces that a process has begun and not finished: until then, the transport lets no process read them. Each with
    /// the number of its file.
    pub fn unfinished(&self) -> io::Result<Vec<(PathBuf, u64)>> {
        const OWNER_READS: u32 = 0o400;
        let mut paths = Vec::new();
        for path in self.segments()? {
            // Removed meanwhile: then it is not one of them.
            let Ok(metadata) = fs::metadata(&path) else { continue };
            if metadata.mode() & OWNER_READS == 0 {
                paths.push((path, metadata.ino()));
            }
        }
        Ok(paths)
    }

    /// Shared memory that the server and its clients really take, bytes: pages count once they
    /// were written to.
    pub fn committed_memory(&self) -> io::Result<u64> {
        let blocks = |path: PathBuf| fs::metadata(path).map_or(0, |metadata| metadata.blocks());
        Ok(self.segments()?.into_iter().map(blocks).sum::<u64>() * 512)
    }

    /// The pieces of shared memory of the server and its clients.
    fn segments(&self) -> io::Result<Vec<PathBuf>> {
        let mut paths = Vec::new();
        for entry in fs::read_dir(SHARED_MEMORY)? {
            let entry = entry?;
            if entry.file_name().to_str().is_some_and(|name| name.starts_with(&self.prefix)) {
                paths.push(entry.path());
            }
        }
        Ok(paths)
    }

    /// The event count of the replies of a session, of the run `epoch` of the server.
    pub(crate) fn reply_event(&self, epoch: u64, session: u64) -> PathBuf {
        let name = format!("{}{NOTIFY}{epoch:016x}.{session}", self.prefix);
        Path::new(SHARED_MEMORY).join(name)
    }

    /// The doorbell of the run `epoch` of the server.
    pub(crate) fn doorbell(&self, epoch: u64) -> PathBuf {
        let name = format!("{}{NOTIFY}{epoch:016x}.doorbell", self.prefix);
        Path::new(SHARED_MEMORY).join(name)
    }

    /// The doorbells and event counts that there are.
    pub(crate) fn notify_files(&self) -> io::Result<Vec<PathBuf>> {
        let start = format!("{}{NOTIFY}", self.prefix);
        let mut paths = self.segments()?;
        paths.retain(|path| {
            path.file_name()
                .and_then(|name| name.to_str())
                .is_some_and(|name| name.starts_with(&start))
        });
        Ok(paths)
    }

    fn open_folder(&self) -> io::Result<Option<Membership>> {
        match File::open(&self.folder) {
            Ok(lock) => {
                Ok(Some(Membership { endpoint: self.clone(), lock, process: std::process::id() }))
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn remove_contents(&self) -> io::Result<()> {
        for path in self.segments()? {
            fs::remove_file(path)?;
        }
        for entry in fs::read_dir(&self.folder)? {
            let path = entry?.path();
            if path.is_dir() { fs::remove_dir_all(path)? } else { fs::remove_file(path)? }
        }
        Ok(())
    }
}

fn folder_prefix() -> String {
    format!("trocar.{}.", rustix::process::getuid().as_raw())
}

/// A shared lock on an endpoint's folder: as long as it is held, no process removes the folder. The
/// process that drops the last one removes it; so drop it after everything that uses shared memory.
#[derive(Debug)]
pub struct Membership {
    endpoint: Endpoint,
    lock: File,
    /// A forked child has a copy of this value, and of the lock, that are not its own.
    process: u32,
}

impl Membership {
    /// The endpoint that was joined.
    pub fn endpoint(&self) -> &Endpoint {
        &self.endpoint
    }

    /// Takes the single-instance lock for the run `epoch` of a server; `Err` holds the process id
    /// of the one that runs already.
    pub fn become_server(&self, epoch: u64) -> io::Result<Result<ServerLock, u32>> {
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            .open(&self.endpoint.server_lock)?;
        if !try_lock(&file, FlockOperation::NonBlockingLockExclusive)? {
            return Ok(Err(read_words(&file)?[0] as u32));
        }
        let lock = ServerLock { file, epoch };
        lock.write(0)?;
        Ok(Ok(lock))
    }

    /// Creates this process's participant of the transport. Only a server removes the resources
    /// of dead participants, after it has taken note of their death.
    pub fn node(&self) -> Result<Node, iceoryx2::node::NodeCreationFailure> {
        cause::keep();
        cause::forget();
        NodeBuilder::new()
            .config(&self.config())
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Transport>()
    }

    /// The transport's configuration for this endpoint.
    pub fn config(&self) -> Config {
        const FITS: &str = "the folder's and the prefix's length are bounded by the name's";
        let mut config = Config::default();
        let folder = self.endpoint.folder.to_str().expect("the folder's name is ASCII");
        let path = iceoryx2::prelude::Path::new(folder.as_bytes()).expect(FITS);
        config.global.set_root_path(&path);
        config.global.prefix = FileName::new(self.endpoint.prefix.as_bytes()).expect(FITS);
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        config
    }

    /// Removes everything if no other process is there; returns whether it did.
    fn leave(&self) -> io::Result<bool> {
        if self.process != std::process::id()
            || !try_lock(&self.lock, FlockOperation::NonBlockingLockExclusive)?
        {
            return Ok(false);
        }
        if self.is_current() {
            self.endpoint.remove_contents()?;
            fs::remove_dir(&self.endpoint.folder)?;
        }
        Ok(true)
    }

    /// Whether the folder that is locked is still the one that the path leads to.
    fn is_current(&self) -> bool {
        let identity = |metadata: fs::Metadata| (metadata.dev(), metadata.ino());
        let locked = self.lock.metadata().map(identity).ok();
        locked.is_some() && locked == fs::metadata(&self.endpoint.folder).map(identity).ok()
    }
}

impl Drop for Membership {
    fn drop(&mut self) {
        // What cannot be removed now, the next one to come or go removes.
        self.leave().ok();
    }
}

/// What [`Endpoint::server_state`] found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ServerState {
    /// A server runs.
    Running {
        /// Its process id, in its own process namespace; 0 while it starts.
        pid: u32,
        /// Which run of the server it is.
        epoch: u64,
    },
    /// A server is about to end: it answers what it was asked, and takes nothing new.
    Ending {
        /// Its process id, in its own process namespace.
        pid: u32,
        /// Which run of the server it is.
        epoch: u64,
    },
    /// The last server ended in order.
    Closed {
        /// Which run of the server it was.
        epoch: u64,
    },
    /// No server runs; the last one, if any, died.
    Absent,
}

/// The single-instance lock of a running server.
#[derive(Debug)]
pub struct ServerLock {
    file: File,
    epoch: u64,
}

/// Third word of the lock file from the beginning of an orderly end.
const CLOSED: u64 = 1;

impl ServerLock {
    /// The run of the server that holds the lock.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Leaves word that the server ends in order, before its clients notice that it does. The
    /// lock is held on until this is dropped.
    pub fn announce_end(&self) -> io::Result<()> {
        self.write(CLOSED)
    }

    fn write(&self, closed: u64) -> io::Result<()> {
        let words = [u64::from(std::process::id()), self.epoch, closed];
        self.file.write_all_at(&words.map(u64::to_le_bytes).concat(), 0)
    }
}

/// The three words of a lock file: process id, epoch, closed. Zeros where it is shorter.
fn read_words(file: &File) -> io::Result<[u64; 3]> {
    let mut bytes = [0; 24];
    match file.read_exact_at(&mut bytes, 0) {
        Ok(()) => Ok([0, 8, 16].map(|at| {
            u64::from_le_bytes(bytes[at..at + 8].try_into().expect("a word has 8 bytes"))
        })),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok([0; 3]),
        Err(error) => Err(error),
    }
}

/// Takes a lock, if no other process has one that excludes it.
fn try_lock(file: &File, operation: FlockOperation) -> io::Result<bool> {
    match retry_on_intr(|| flock(file, operation)) {
        Ok(()) => Ok(true),
        Err(Errno::WOULDBLOCK) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// Name of the control service and of the event service that announces control messages. Every
/// run of the server has its own: clients of a run that died may hold on to theirs.
pub fn control_service(epoch: u64) -> String {
    format!("control/{epoch:016x}")
}

/// Name of a session's data service.
pub fn data_service(epoch: u64, session: u64) -> String {
    format!("session/{epoch:016x}/{session}/data")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unique(label: &str) -> Endpoint {
        let name = format!("t-{label}-{}", std::process::id());
        Endpoint::new(&name.parse().unwrap())
    }

    #[test]
    fn names_are_checked() {
        for bad in ["", "a/b", "a.b", "ä", "abcdefghijklmnopqrstuvwxy", ".."] {
            let refusal = bad.parse::<ServerName>().unwrap_err();
            assert!(refusal.to_string().contains("allowed"), "{refusal}");
        }
        assert!("abcdefghijklmnopqrstuvwx".parse::<ServerName>().is_ok());
    }

    #[test]
    fn the_last_one_out_removes_everything() {
        let endpoint = unique("last");
        let first = endpoint.join().unwrap();
        let second = endpoint.join().unwrap();
        let stray = Path::new(SHARED_MEMORY).join(format!("{}stray", endpoint.prefix));
        fs::write(&stray, "left by a crash").unwrap();
        drop(first);
        assert!(endpoint.folder().exists() && stray.exists());
        assert!(!endpoint.remove_if_unused().unwrap());
        assert_eq!(endpoint.remains().unwrap(), [stray.as_path(), endpoint.folder()]);
        drop(second);
        assert!(endpoint.remains().unwrap().is_empty());
    }

    #[test]
    fn one_server_at_a_time() {
        let endpoint = unique("single");
        let membership = endpoint.join().unwrap();
        assert_eq!(endpoint.server_state(), ServerState::Absent);
        let lock = membership.become_server(7).unwrap().unwrap();
        let pid = std::process::id();
        assert_eq!(endpoint.server_state(), ServerState::Running { pid, epoch: 7 });
        assert_eq!(membership.become_server(8).unwrap().unwrap_err(), pid);
        drop(lock);
        assert_eq!(endpoint.server_state(), ServerState::Absent);
        let lock = membership.become_server(8).unwrap().unwrap();
        lock.announce_end().unwrap();
        assert_eq!(endpoint.server_state(), ServerState::Ending { pid, epoch: 8 });
        assert_eq!(membership.become_server(9).unwrap().unwrap_err(), pid);
        drop(lock);
        assert_eq!(endpoint.server_state(), ServerState::Closed { epoch: 8 });
    }

    #[test]
    fn whoever_comes_first_clears_what_a_crash_left() {
        let endpoint = unique("crash");
        fs::create_dir(endpoint.folder()).unwrap();
        fs::write(endpoint.folder().join("stale"), "").unwrap();
        let _membership = endpoint.join().unwrap();
        assert!(!endpoint.folder().join("stale").exists());
    }
}
