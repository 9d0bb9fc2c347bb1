//! The server under load: asked again and again for its sessions, restarted, and looked at for what
//! the load leaves behind.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::bail;
use trocar_client::{Client, ServerStatus};
use trocar_proto::endpoint::{Endpoint, ServerName};

use super::PATIENCE;
use crate::process::OwnServer;
use crate::usage;

/// How often the server is asked.
const INTERVAL: Duration = Duration::from_millis(50);

/// The server under load.
pub(super) struct Target {
    name: ServerName,
    endpoint: Endpoint,
    /// Its process, where that is seen from here.
    pid: Option<u32>,
    own: Option<OwnServer>,
    observer: Observer,
}

impl Target {
    /// The server of that name, else one of its own, which ends with this value.
    pub(super) fn new(named: Option<&ServerName>) -> anyhow::Result<Self> {
        let (name, own) = if let Some(name) = named {
            (name.clone(), None)
        } else {
            let name = format!("load-{}", std::process::id()).parse()?;
            let own = OwnServer::start(&name, &[])?;
            (name, Some(own))
        };
        let client = Client::connect(name.as_str())?;
        let endpoint = Endpoint::new(&name);
        // The process id is the server's own idea of it: in another namespace it may be another
        // process's.
        let pid =
            Some(client.server().pid).filter(|pid| usage::holds_files_in(*pid, endpoint.folder()));
        Ok(Self { name, endpoint, pid, own, observer: Observer::start(client) })
    }

    pub(super) fn name(&self) -> &ServerName {
        &self.name
    }

    /// The server's process, where it is seen from here.
    pub(super) fn pid(&self) -> Option<u32> {
        self.pid
    }

    /// Kills its own server, and starts another under the same name.
    pub(super) fn restart(&mut self) -> anyhow::Result<()> {
        self.observer.tell_to_end();
        drop(self.own.take());
        // A server that is started meanwhile would inherit the connection's open files.
        self.observer.end();
        let own = OwnServer::start(&self.name, &[])?;
        self.pid = Some(own.pid());
        self.own = Some(own);
        self.observer = Observer::start(Client::connect(self.name.as_str())?);
        Ok(())
    }

    /// What the server's latest answer says; an error where it does not answer, or no more.
    pub(super) fn seen(&self) -> anyhow::Result<Seen> {
        let seen = self.observer.seen();
        if let Some(error) = &seen.error {
            bail!("the server's status: {error}");
        }
        if seen.asked.elapsed() > PATIENCE {
            bail!("the server has not answered for {} s", PATIENCE.as_secs());
        }
        Ok(seen)
    }

    /// What there is of the server and its clients, `ours` being processes of the load; `None`
    /// before its first answer to a question asked after `since`.
    pub(super) fn footprint(
        &self,
        ours: &BTreeSet<u32>,
        since: Instant,
    ) -> anyhow::Result<Option<Footprint>> {
        let seen = self.seen()?;
        let Some(status) = seen.status.filter(|_| seen.asked > since) else { return Ok(None) };
        let sessions = status.sessions.iter().filter(|session| ours.contains(&session.pid)).count();
        let segments = self.endpoint.folder().with_file_name("trocar-");
        let segments = segments.to_str().expect("the name is ASCII");
        let entries = |folder: &str| {
            let folder = self.endpoint.folder().join(folder);
            std::fs::read_dir(folder).map_or(0, Iterator::count)
        };
        let remains = self.endpoint.remains()?;
        // Sizes, not what is committed: that depends on which pages of pools were ever used.
        let size = |path: &PathBuf| std::fs::metadata(path).map_or(0, |metadata| metadata.len());
        Ok(Some(Footprint {
            others: status.sessions.len() - sessions,
            counts: [
                sessions as u64,
                remains.len() as u64,
                (entries("nodes") + entries("services")) as u64,
                remains.iter().filter(|path| path.is_file()).map(size).sum(),
                self.pid.map_or(0, usage::open_files) as u64,
                self.pid.map_or(0, |pid| usage::mappings(pid, segments)) as u64,
            ],
        }))
    }

    /// Ends its own server in order; returns what is left of it in shared memory.
    pub(super) fn finish(mut self) -> anyhow::Result<Vec<String>> {
        let Some(own) = self.own.take() else { return Ok(vec![]) };
        let endpoint = self.endpoint.clone();
        self.observer.tell_to_end();
        own.stop()?;
        drop(self);
        let left = endpoint.remains()?;
        Ok(left.into_iter().map(|path| format!("{} is left", path.display())).collect())
    }
}

impl Drop for Target {
    fn drop(&mut self) {
        drop(self.own.take());
        self.observer.end();
        // Clients that were killed may have been the last ones of a server that is gone.
        self.endpoint.remove_if_unused().ok();
    }
}

/// What there is of a server and its clients.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Footprint {
    /// Sessions of processes that are not of the load.
    others: usize,
    counts: [u64; COUNTED.len()],
}

const COUNTED: [&str; 6] = [
    "sessions",
    "files in /dev/shm",
    "entries in the server's folder",
    "bytes of shared memory",
    "open files of the server",
    "mappings of shared memory in the server",
];

impl Footprint {
    /// What there is more than there was before. Where others use the server, only sessions tell.
    pub(super) fn beyond(&self, before: &Self) -> Vec<String> {
        let told = if self.others + before.others > 0 { 1 } else { COUNTED.len() };
        let pairs = self.counts.iter().zip(before.counts).zip(COUNTED).take(told);
        pairs
            .filter(|((now, before), _)| *now > before)
            .map(|((now, before), what)| format!("{what}: {now}, before the load {before}"))
            .collect()
    }
}

/// An answer of the server.
#[derive(Debug, Clone)]
pub(super) struct Seen {
    /// When it was asked.
    pub(super) asked: Instant,
    /// The answer; `None` before the first one.
    pub(super) status: Option<ServerStatus>,
    error: Option<String>,
}

impl Seen {
    /// Whether the server was asked after `since`, and has no session of process `pid`.
    pub(super) fn lacks(&self, pid: u32, since: Instant) -> bool {
        let Some(status) = &self.status else { return false };
        self.asked > since && status.sessions.iter().all(|session| session.pid != pid)
    }
}

/// Asks on a thread of its own: a server that does not answer holds no other thread up.
struct Observer {
    seen: Arc<Mutex<Seen>>,
    told_to_end: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Observer {
    /// How long an answer may be waited for when it is not wanted any more.
    const PARTING: Duration = Duration::from_secs(5);

    fn start(client: Client) -> Self {
        let seen = Seen { asked: Instant::now(), status: None, error: None };
        let seen = Arc::new(Mutex::new(seen));
        let told_to_end = Arc::new(AtomicBool::new(false));
        let thread = thread::spawn({
            let (seen, told_to_end) = (Arc::clone(&seen), Arc::clone(&told_to_end));
            move || {
                while !told_to_end.load(Ordering::Acquire) {
                    let asked = Instant::now();
                    let (status, error) = match client.status() {
                        Ok(status) => (Some(status), None),
                        Err(error) => (None, Some(error.to_string())),
                    };
                    let failed = error.is_some();
                    *seen.lock().unwrap_or_else(PoisonError::into_inner) =
                        Seen { asked, status, error };
                    if failed {
                        return;
                    }
                    thread::sleep(INTERVAL);
                }
            }
        });
        Self { seen, told_to_end, thread }
    }

    fn seen(&self) -> Seen {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn tell_to_end(&self) {
        self.told_to_end.store(true, Ordering::Release);
    }

    /// Waits for its connection to end, lest it is taken for something that is left.
    fn end(&self) {
        self.tell_to_end();
        let start = Instant::now();
        while !self.thread.is_finished() && start.elapsed() < Self::PARTING {
            thread::sleep(Duration::from_millis(1));
        }
    }
}

impl Drop for Observer {
    fn drop(&mut self) {
        self.end();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_the_load_can_have_left_counts() {
        let before = Footprint { others: 0, counts: [0, 5, 5, 4096, 20, 7] };
        assert!(before.beyond(&before).is_empty());
        let after = Footprint { counts: [1, 4, 5, 8192, 21, 7], ..before.clone() };
        let beyond = after.beyond(&before);
        assert_eq!(beyond.len(), 3, "{beyond:?}");
        assert!(beyond[0].contains("sessions: 1") && beyond[1].contains("8192"));
        assert_eq!(Footprint { others: 1, ..after }.beyond(&before), beyond[..1]);
    }
}
