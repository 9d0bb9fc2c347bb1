//! Pieces of shared memory that a process has begun and never finished: it was killed there, or a call of the kernel
//! failed. The transport (iceoryx2 0.10.0) waits without end for one that has no size yet, so a thread that does not
//! use the transport removes them; it is told then that there is none, and goes on.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use trocar_proto::endpoint::Endpoint;

use super::liveness;
use crate::clock::thread_time;

/// How long a piece may be unfinished: finishing takes microseconds, unless its process gets no processor.
const LONGEST: Duration = Duration::from_secs(1);

/// The thread that removes them, until this is dropped.
pub(super) struct Remover {
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Remover {
    pub(super) fn start(endpoint: Endpoint) -> io::Result<Self> {
        let (stop, stopped) = channel();
        let thread = std::thread::Builder::new()
            .name("trocar-remover".into())
            .spawn(move || watch(&endpoint, &stopped))?;
        Ok(Self { stop: Some(stop), thread: Some(thread) })
    }
}

impl Drop for Remover {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

fn watch(endpoint: &Endpoint, stopped: &Receiver<()>) {
    let mut seen = BTreeMap::new();
    let mut pause = liveness::INTERVAL;
    while stopped.recv_timeout(pause) == Err(RecvTimeoutError::Timeout) {
        let computed = thread_time();
        // What cannot be listed now is at the next look.
        if let Ok(unfinished) = endpoint.unfinished() {
            remove_old(&mut seen, unfinished, Instant::now());
        }
        pause = liveness::pause(thread_time().saturating_sub(computed));
    }
}

/// Removes what has been unfinished for too long, of what is now; `seen` has since when.
fn remove_old(
    seen: &mut BTreeMap<(PathBuf, u64), Instant>,
    unfinished: Vec<(PathBuf, u64)>,
    now: Instant,
) {
    seen.retain(|piece, _| unfinished.contains(piece));
    for piece in unfinished {
        let since = *seen.entry(piece.clone()).or_insert(now);
        if now - since > LONGEST {
            tracing::warn!(path = %piece.0.display(), "removed: its process never finished it");
            fs::remove_file(&piece.0).ok();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_unfinished_for_too_long_is_removed_and_nothing_else() {
        let folder = std::env::temp_dir().join(format!("trocar-unfinished-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let pieces = ["old", "new"].map(|name| (folder.join(name), 1));
        for (path, _) in &pieces {
            fs::write(path, "").unwrap();
        }
        let [old, new] = &pieces;
        let (mut seen, start) = (BTreeMap::new(), Instant::now());
        remove_old(&mut seen, vec![old.clone()], start);
        assert!(old.0.exists());
        let later = start + LONGEST + Duration::from_millis(1);
        remove_old(&mut seen, vec![old.clone(), new.clone()], later);
        assert!(!old.0.exists() && new.0.exists());
        // Another file of that name is another piece; one that was finished meanwhile is none.
        remove_old(&mut seen, vec![(new.0.clone(), 2)], later + LONGEST * 2);
        remove_old(&mut seen, vec![], later + LONGEST * 3);
        assert!(new.0.exists() && seen.is_empty());
        fs::remove_dir_all(folder).unwrap();
    }
}
