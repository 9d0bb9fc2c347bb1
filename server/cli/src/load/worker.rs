//! One Rust client of the load: it compares everything it sees with its twin. `worker.py` does the
//! same in Python, where [`super::checker`] compares.

use std::io::Read;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use hdrhistogram::Histogram;
use rustix::process::{Signal, set_parent_process_death_signal};
use serde::{Deserialize, Serialize};
use trocar_client::{CallError, Client, Code, ConnectError, Reply, SessionRequest};

use super::twin::Twin;
use crate::output;

/// How often it reports.
const INTERVAL: Duration = Duration::from_millis(200);

/// How long it looks for a server that is being restarted.
const PATIENCE: Duration = Duration::from_mins(1);

/// How often it looks.
const PAUSE: Duration = Duration::from_millis(10);

/// What a client says, as a JSON line; all counts since it last said something.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct Report {
    /// How many sessions it has opened since it started.
    pub(super) session: u64,
    /// Steps of all environments of that session since it was opened.
    pub(super) rounds: u64,
    /// Environment steps.
    pub(super) steps: u64,
    /// Time in which it had a session, s.
    pub(super) seconds: f64,
    /// Latencies of messages, ns, each with how often it was seen.
    pub(super) latencies: Vec<(u64, u64)>,
    /// Time that its twin took for the same steps, s.
    pub(super) twin_seconds: f64,
    /// Where it does not compare by itself: the checksum of all that its session has shown.
    pub(super) checksum: Option<u32>,
    /// What is not as in its twin; said once in a session.
    pub(super) mismatch: Option<String>,
    /// Why it gives up.
    pub(super) error: Option<String>,
    /// Whether it ends because it was told to.
    pub(super) done: bool,
}

/// One client of the load.
#[derive(Debug, Args)]
pub(crate) struct LoadClient {
    /// The server to connect to
    #[arg(long)]
    server: String,
    /// The task
    #[arg(long)]
    task: String,
    /// How many environments
    #[arg(long)]
    envs: u32,
    /// Environment i begins with seed SEED + i
    #[arg(long)]
    seed: u64,
    /// Open another session when the server was restarted
    #[arg(long)]
    reconnect: bool,
}

/// Whether it was told to end.
static TOLD_TO_END: AtomicBool = AtomicBool::new(false);

impl LoadClient {
    /// Says when it is ready, begins at a line on its stdin, and ends with its stdin.
    pub(crate) fn run(self) -> anyhow::Result<()> {
        // Whatever ends the parent, no client stays: not even one that is stopped.
        set_parent_process_death_signal(Some(Signal::KILL))?;
        let mut work = Work::new(&self)?;
        match work.run(&self) {
            Ok(()) => work.report.done = true,
            Err(error) => work.report.error = Some(format!("{error:#}")),
        }
        work.say()
    }
}

/// What a client has at hand while it works.
struct Work {
    twin: Twin,
    report: Report,
    latencies: Histogram<u64>,
    /// When the counts of the report began.
    since: Instant,
    begun: bool,
    /// The session differs from its twin, which was said.
    differs: bool,
}

impl Work {
    fn new(client: &LoadClient) -> anyhow::Result<Self> {
        Ok(Self {
            twin: Twin::new(&client.task, client.envs, client.seed)?,
            report: Report::default(),
            latencies: Histogram::new(super::DIGITS)?,
            since: Instant::now(),
            begun: false,
            differs: false,
        })
    }

    /// Works in one session after the other until it is told to end.
    fn run(&mut self, client: &LoadClient) -> anyhow::Result<()> {
        let mut lost = Instant::now();
        loop {
            let session = self.report.session;
            let Err(error) = self.session(client) else { return Ok(()) };
            if self.report.session > session {
                self.say()?;
                lost = Instant::now();
            }
            if !client.reconnect || !is_loss(&error) || lost.elapsed() > PATIENCE {
                return Err(error);
            }
            if TOLD_TO_END.load(Ordering::Acquire) {
                return Ok(());
            }
            thread::sleep(PAUSE);
        }
    }

    /// Works in one session.
    fn session(&mut self, client: &LoadClient) -> anyhow::Result<()> {
        let request = SessionRequest::new(&client.task).envs(client.envs).seed(client.seed);
        let mut session = Client::connect(&client.server)?.open(&request)?;
        session.want_expert(true);
        self.twin.reset();
        let reply = session.reset()?;
        self.report.session += 1;
        self.report.rounds = 0;
        self.differs = false;
        self.compare(&reply);
        drop(reply);
        if !self.begun {
            self.begun = true;
            self.since = Instant::now();
            self.say()?;
            await_the_word()?;
        }
        self.since = Instant::now();
        while !TOLD_TO_END.load(Ordering::Acquire) {
            let sent = Instant::now();
            let reply = session.step(self.twin.actions())?;
            self.latencies.record(sent.elapsed().as_nanos() as u64)?;
            let start = Instant::now();
            self.twin.step()?;
            self.report.twin_seconds += start.elapsed().as_secs_f64();
            self.report.rounds += 1;
            // A row with 0 steps is the reset that follows an episode.
            self.report.steps +=
                reply.steps().iter().map(|steps| u64::from(*steps > 0)).sum::<u64>();
            self.compare(&reply);
            drop(reply);
            if self.since.elapsed() > INTERVAL {
                self.say()?;
            }
        }
        Ok(())
    }

    fn compare(&mut self, reply: &Reply) {
        if self.differs {
            return;
        }
        self.report.mismatch = self.twin.difference(reply);
        self.differs = self.report.mismatch.is_some();
        if self.differs {
            // The next comparison must not take it back.
            self.say().ok();
        }
    }

    /// Says what there is to say, and counts anew.
    fn say(&mut self) -> anyhow::Result<()> {
        let now = Instant::now();
        self.report.seconds = (now - self.since).as_secs_f64();
        let counted = self.latencies.iter_recorded();
        self.report.latencies =
            counted.map(|value| (value.value_iterated_to(), value.count_at_value())).collect();
        output::json_line(&self.report)?;
        let Report { session, rounds, .. } = self.report;
        self.report = Report { session, rounds, ..Report::default() };
        self.latencies.reset();
        self.since = now;
        Ok(())
    }
}

/// Waits for the first line on stdin; from then on its end is the word to end.
fn await_the_word() -> anyhow::Result<()> {
    if std::io::stdin().read_line(&mut String::new())? == 0 {
        TOLD_TO_END.store(true, Ordering::Release);
        return Ok(());
    }
    thread::spawn(|| {
        std::io::stdin().read_to_end(&mut Vec::new()).ok();
        TOLD_TO_END.store(true, Ordering::Release);
    });
    Ok(())
}

/// Whether an error says no more than that the server is gone.
fn is_loss(error: &anyhow::Error) -> bool {
    match (error.downcast_ref(), error.downcast_ref()) {
        (Some(ConnectError::NoServer { .. }), _) | (_, Some(CallError::ServerLost { .. })) => true,
        (_, Some(CallError::Refused(refusal))) => {
            matches!(refusal.code, Code::StaleSession | Code::ShuttingDown)
        }
        _ => false,
    }
}
