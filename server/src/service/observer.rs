//! What is written down of environments while they are stepped: failures, and what a recorder asked for.

use std::collections::VecDeque;
use std::fs;
use std::io;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use trocar_proto::{Code, Rejection};

use crate::env::Env;
use crate::recording::Recorder;

/// Most recordings of failures in a folder: enough to learn from, and no disk is filled.
const MOST_FAILURES: usize = 100;

/// Most bytes that wait for the client that records.
const MOST_WAITING: usize = 4 << 20;

/// A recorder that asks for nothing for so long is gone.
const PATIENCE: Duration = Duration::from_secs(30);

/// Where failures are recorded.
#[derive(Debug)]
pub(super) struct Failures {
    folder: PathBuf,
}

impl Failures {
    pub(super) fn new(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// Writes the episode that led to a failure, unless there are many already.
    pub(super) fn record(&self, env: &Env, what: &str) {
        let task = &env.spec().id;
        let name = format!("{task}-{}-{}-{what}.trocar", env.seed(), env.episode());
        match self.write(env, &name) {
            Ok(Some(path)) => {
                let path = path.display();
                tracing::warn!(task, what, %path, "recorded: `trocar replay` plays it again");
            }
            Ok(None) => {}
            Err(error) => tracing::warn!(task, what, %error, "a failure could not be recorded"),
        }
    }

    fn write(&self, env: &Env, name: &str) -> io::Result<Option<PathBuf>> {
        fs::create_dir_all(&self.folder)?;
        let path = self.folder.join(name);
        let recordings = fs::read_dir(&self.folder)?.filter(|entry| {
            let name = entry.as_ref().map(fs::DirEntry::path);
            name.is_ok_and(|path| path.extension().is_some_and(|extension| extension == "trocar"))
        });
        if recordings.count() >= MOST_FAILURES || path.exists() {
            return Ok(None);
        }
        let bytes = env.export().map_err(io::Error::other)?;
        // Whole or not at all: another process may look meanwhile.
        let partial = path.with_extension("partial");
        fs::write(&partial, bytes)?;
        fs::rename(&partial, &path)?;
        Ok(Some(path))
    }
}

/// What a recorder that attached to a session has asked for and not fetched yet.
#[derive(Debug, Default)]
pub(super) struct LiveRecording {
    /// Looked at in every step, so that the rest costs nothing while no client records.
    running: AtomicBool,
    inner: Mutex<Option<Recording>>,
}

#[derive(Debug)]
struct Recording {
    env: u32,
    recorder: Recorder,
    waiting: VecDeque<Vec<u8>>,
    /// Bytes that wait.
    size: usize,
    /// States that were not kept since the client did not fetch the earlier ones.
    lost: u64,
    fetched: Instant,
}

impl LiveRecording {
    /// Begins to record environment `env`, with a state each `every` steps.
    pub(super) fn start(&self, env: u32, every: u32) {
        *self.lock() = Some(Recording {
            env,
            recorder: Recorder::new(every),
            waiting: VecDeque::new(),
            size: 0,
            lost: 0,
            fetched: Instant::now(),
        });
        self.running.store(true, Ordering::Release);
    }

    /// What was recorded since the last time, at most about `room` bytes, and how many states were lost.
    pub(super) fn fetch(&self, room: usize) -> Result<(Vec<u8>, u64), Rejection> {
        let mut guard = self.lock();
        let Some(recording) = guard.as_mut() else {
            let why = "nobody records it; begin again";
            return Err(Rejection::new(Code::UnknownSession, "recording", "none", why));
        };
        let mut bytes = vec![];
        while let Some(part) = recording.waiting.front()
            && (bytes.is_empty() || bytes.len() + part.len() <= room)
        {
            recording.size -= part.len();
            bytes.extend(recording.waiting.pop_front().unwrap_or_default());
        }
        recording.fetched = Instant::now();
        Ok((bytes, std::mem::take(&mut recording.lost)))
    }

    /// Takes note of a step that environment `id` took.
    pub(super) fn after_step(&self, id: u32, env: &Env) {
        self.note(id, |recorder| recorder.after_step(env));
    }

    /// Takes note of where environment `id` was before it is brought elsewhere.
    pub(super) fn before_leaving(&self, id: u32, env: &Env) {
        self.note(id, |recorder| recorder.before_leaving(env));
    }

    fn note(&self, id: u32, part: impl FnOnce(&mut Recorder) -> Option<Vec<u8>>) {
        if !self.running.load(Ordering::Acquire) {
            return;
        }
        let mut guard = self.lock();
        let Some(recording) = guard.as_mut().filter(|recording| recording.env == id) else {
            return;
        };
        if recording.fetched.elapsed() > PATIENCE {
            *guard = None;
            self.running.store(false, Ordering::Release);
            return;
        }
        let Some(part) = part(&mut recording.recorder) else { return };
        if recording.size + part.len() > MOST_WAITING {
            recording.lost += 1;
            return;
        }
        recording.size += part.len();
        recording.waiting.push_back(part);
    }

    fn lock(&self) -> MutexGuard<'_, Option<Recording>> {
        // Whatever panicked left a queue of whole states.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What looks on while environments are stepped.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StepObserver<'a> {
    pub(super) failures: Option<&'a Failures>,
    pub(super) recording: &'a LiveRecording,
}

impl StepObserver<'_> {
    /// Environment `id` took a step, after which its simulation had failed or not.
    pub(super) fn after_step(self, id: u32, env: &Env, failed: bool) {
        self.recording.after_step(id, env);
        if let Some(failures) = self.failures {
            if failed {
                failures.record(env, "not-finite");
            } else if env.has_just_lost_an_object() {
                failures.record(env, "lost-object");
            }
        }
    }

    /// Environment `id` is about to be reset or brought to another state.
    pub(super) fn before_leaving(self, id: u32, env: &Env) {
        self.recording.before_leaving(id, env);
    }
}
