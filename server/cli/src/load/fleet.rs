//! The clients of a load: processes that are started, heard, stopped, killed and replaced.

use std::collections::BTreeSet;
use std::process::Command;
use std::sync::mpsc::{self, Receiver, Sender};
use std::time::{Duration, Instant};

use anyhow::Context;
use hdrhistogram::Histogram;
use rustix::process::Signal;
use trocar_proto::endpoint::ServerName;
use trocar_server::sim::random::Rng;

use super::checker::{self, Line};
use super::report::Tally;
use super::twin::Twin;
use super::worker::Report;
use super::{DIGITS, Load, PATIENCE};
use crate::process::{PYTHON, Process, python};
use crate::usage;

/// The program of the Python clients, twin of [`super::worker`].
const PYTHON_CLIENT: &str = include_str!("worker.py");

/// How long a client is stopped, s: around the quarter of a second after which the server looks for
/// dead clients, and several of these.
const STOPPED: (f64, f64) = (0.1, 1.0);

/// What a client is written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Language {
    Rust,
    Python,
}

impl Language {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Rust => "Rust",
            Self::Python => "Python",
        }
    }
}

/// One client after the other: a killed one is followed by another.
#[derive(Debug)]
pub(super) struct Slot {
    pub(super) language: Language,
    pub(super) steps: u64,
    /// Latencies of its messages, ns.
    pub(super) latencies: Histogram<u64>,
    /// Time that its twins took for as many, s; 0 where they are not in the client.
    pub(super) twin_seconds: f64,
    /// Time in which its clients had sessions and were not stopped, s.
    seconds: f64,
    /// CPU time of its clients that have ended, s.
    ended_cpu_seconds: f64,
    pub(super) killed: u64,
    pub(super) stopped: u64,
    /// Sessions that its clients have opened.
    pub(super) sessions: u64,
    running: Option<Running>,
}

impl Slot {
    /// Environment steps per second of its clients; `None` where there were none.
    pub(super) fn rate(&self) -> Option<f64> {
        (self.seconds > 0.0).then(|| self.steps as f64 / self.seconds)
    }

    fn runs(&self, number: usize) -> bool {
        self.running.as_ref().is_some_and(|client| client.number == number)
    }

    /// CPU time of its clients, s.
    pub(super) fn cpu_seconds(&self) -> f64 {
        self.ended_cpu_seconds + self.running.as_ref().map_or(0.0, |client| client.cpu_seconds)
    }
}

/// A client that runs.
#[derive(Debug)]
struct Running {
    number: usize,
    process: Process,
    heard: Instant,
    /// It has said that it is ready.
    ready: bool,
    /// It has said that it ends, and why.
    parting: bool,
    /// When it was stopped, and until when it shall be.
    stopped: Option<(Instant, Instant)>,
    /// For how long it was stopped since it was last heard, s.
    frozen: f64,
    sessions: u64,
    cpu_seconds: f64,
}

/// A client that was killed: its session is to be given up by the server.
#[derive(Debug)]
pub(super) struct Killed {
    pub(super) pid: u32,
    pub(super) at: Instant,
}

/// All clients.
pub(super) struct Fleet<'a> {
    load: &'a Load,
    server: ServerName,
    pub(super) slots: Vec<Slot>,
    reports: Receiver<Line>,
    sender: Sender<Line>,
    /// Clients that were started so far.
    started: usize,
    /// Those of which more may be heard.
    open: BTreeSet<usize>,
    /// Process ids of all of them.
    pub(super) pids: BTreeSet<u32>,
}

impl<'a> Fleet<'a> {
    /// Starts all clients; they wait for [`Self::begin`].
    pub(super) fn start(load: &'a Load, server: &ServerName) -> anyhow::Result<Self> {
        let (sender, reports) = mpsc::channel();
        let language = if load.python { Language::Python } else { Language::Rust };
        let latencies: Histogram<u64> = Histogram::new(DIGITS)?;
        let slot = || Slot {
            language,
            steps: 0,
            latencies: latencies.clone(),
            twin_seconds: 0.0,
            seconds: 0.0,
            ended_cpu_seconds: 0.0,
            killed: 0,
            stopped: 0,
            sessions: 0,
            running: None,
        };
        let mut fleet = Self {
            load,
            server: server.clone(),
            slots: (0..load.clients).map(|_| slot()).collect(),
            reports,
            sender,
            started: 0,
            open: BTreeSet::new(),
            pids: BTreeSet::new(),
        };
        (0..fleet.slots.len()).try_for_each(|index| fleet.start_client(index))?;
        Ok(fleet)
    }

    fn start_client(&mut self, index: usize) -> anyhow::Result<()> {
        let (load, number) = (self.load, self.started);
        let task = load.task_of(index);
        // No two environments of a load have the same seed.
        let seed = load.seed.wrapping_add(number as u64 * u64::from(load.envs));
        let language = self.slots[index].language;
        let mut command = match language {
            Language::Rust => {
                let mut command = Command::new(std::env::current_exe()?);
                command.arg("load-client");
                command
            }
            Language::Python => {
                let mut command = Command::new(python());
                command.args(["-c", PYTHON_CLIENT]);
                command
            }
        };
        command.args(["--server", self.server.as_str(), "--task", task]);
        command.args(["--envs", &load.envs.to_string(), "--seed", &seed.to_string()]);
        if load.restart_server.is_some() {
            command.arg("--reconnect");
        }
        let mut process = Process::start("client", command)?;
        match language {
            Language::Rust => process.report_to(number, self.sender.clone()),
            Language::Python => {
                let (sender, lines) = mpsc::channel();
                process.report_to(number, sender);
                let twin = Twin::new(task, load.envs, seed)?;
                checker::start(twin, lines, self.sender.clone());
            }
        }
        self.started += 1;
        self.open.insert(number);
        self.pids.insert(process.pid());
        self.slots[index].running = Some(Running {
            number,
            process,
            heard: Instant::now(),
            ready: false,
            parting: false,
            stopped: None,
            frozen: 0.0,
            sessions: 0,
            cpu_seconds: 0.0,
        });
        Ok(())
    }

    /// Whether every client that runs is ready.
    pub(super) fn is_ready(&self) -> bool {
        self.running().all(|client| client.ready)
    }

    /// Whether no client runs, and nothing more is to be heard.
    pub(super) fn has_ended(&self) -> bool {
        self.open.is_empty()
    }

    /// Number of clients that run.
    pub(super) fn count(&self) -> usize {
        self.running().count()
    }

    /// Lets all clients begin.
    pub(super) fn begin(&mut self) -> anyhow::Result<()> {
        self.running_mut().try_for_each(|client| client.process.tell("go"))
    }

    /// Lets all clients go on, finish their step and end.
    pub(super) fn end(&mut self) -> anyhow::Result<()> {
        for client in self.running_mut() {
            client.go_on()?;
            client.process.end_input();
        }
        Ok(())
    }

    /// Hears what clients say, for at most `patience`.
    pub(super) fn hear(&mut self, patience: Duration, tally: &mut Tally) {
        let mut next = self.reports.recv_timeout(patience).ok();
        while let Some((number, line)) = next {
            match line {
                Some(line) => self.take_down(number, &line, tally),
                None => self.see_off(number, tally),
            }
            next = self.reports.try_recv().ok();
        }
        for slot in &mut self.slots {
            let is_silent = |client: &mut Running| {
                let waits = client.stopped.is_none() && client.heard.elapsed() > PATIENCE;
                // One that has ended is still compared with its twin.
                waits && client.process.check().is_ok()
            };
            if let Some(client) = slot.running.take_if(is_silent) {
                // It is killed here, and seen off when its pipe ends.
                let number = client.number + 1;
                tally.errors.add(format!("client {number} said nothing for {PATIENCE:?}"));
                slot.ended_cpu_seconds += client.cpu_seconds;
            }
        }
    }

    /// Counts what client `number` reports.
    fn take_down(&mut self, number: usize, line: &str, tally: &mut Tally) {
        let report: Report = match serde_json::from_str(line) {
            Ok(report) => report,
            // One that was killed may have been saying something.
            Err(_) if !self.slots.iter().any(|slot| slot.runs(number)) => return,
            Err(error) => {
                return tally.errors.add(format!("client {} said {line:?}: {error}", number + 1));
            }
        };
        if let Some(mismatch) = report.mismatch {
            tally.mismatches.add(format!("client {}: {mismatch}", number + 1));
        }
        // A killed one may have said more than was heard by then, and is not counted.
        let Some(slot) = self.slots.iter_mut().find(|slot| slot.runs(number)) else { return };
        let Slot { running: Some(client), steps, seconds, sessions, latencies, .. } = slot else {
            return;
        };
        client.heard = Instant::now();
        client.ready = true;
        client.parting |= report.done;
        if let Some(error) = report.error {
            client.parting = true;
            tally.errors.add(format!("client {}: {error}", number + 1));
        }
        *sessions += report.session.saturating_sub(client.sessions);
        client.sessions = client.sessions.max(report.session);
        if report.seconds > 0.0 {
            *seconds += (report.seconds - std::mem::take(&mut client.frozen)).max(0.0);
        }
        *steps += report.steps;
        slot.twin_seconds += report.twin_seconds;
        for (latency, count) in report.latencies {
            if latencies.record_n(latency, count).is_err() {
                tally.errors.add(format!("client {} took {latency} ns", number + 1));
            }
        }
    }

    /// Nothing more is heard of client `number`.
    fn see_off(&mut self, number: usize, tally: &mut Tally) {
        self.open.remove(&number);
        let Some(slot) = self.slots.iter_mut().find(|slot| slot.runs(number)) else { return };
        let Some(mut client) = slot.running.take() else { return };
        slot.ended_cpu_seconds += client.cpu_seconds;
        let ended = client.process.wait(PATIENCE);
        if let Err(error) = ended {
            tally.errors.add(format!("client {}: {error:#}", number + 1));
        } else if !client.parting {
            tally.errors.add(format!("client {} ended early", number + 1));
        }
    }

    /// Kills one of the clients that work, and starts another in its place.
    pub(super) fn kill_one(&mut self, rng: &mut Rng) -> anyhow::Result<Option<Killed>> {
        let Some(index) = self.choose(rng, |client| client.ready) else { return Ok(None) };
        let slot = &mut self.slots[index];
        let Some(mut client) = slot.running.take() else { return Ok(None) };
        client.look();
        client.process.kill();
        let killed = Killed { pid: client.process.pid(), at: Instant::now() };
        slot.ended_cpu_seconds += client.cpu_seconds;
        slot.killed += 1;
        self.start_client(index)?;
        // It need not wait for the others.
        if let Some(client) = &mut self.slots[index].running {
            client.process.tell("go")?;
        }
        Ok(Some(killed))
    }

    /// Stops one of the clients that work, for a while.
    pub(super) fn stop_one(&mut self, rng: &mut Rng) -> anyhow::Result<bool> {
        let can_be = |client: &Running| client.ready && client.stopped.is_none();
        let Some(index) = self.choose(rng, can_be) else { return Ok(false) };
        let slot = &mut self.slots[index];
        let Some(client) = &mut slot.running else { return Ok(false) };
        client.process.signal(Signal::STOP)?;
        let now = Instant::now();
        let time = Duration::from_secs_f64(rng.uniform(STOPPED.0, STOPPED.1));
        client.stopped = Some((now, now + time));
        slot.stopped += 1;
        Ok(true)
    }

    /// Lets those go on that were stopped for long enough.
    pub(super) fn go_on(&mut self) -> anyhow::Result<()> {
        let now = Instant::now();
        self.running_mut()
            .filter(|client| client.stopped.is_some_and(|(_, until)| until <= now))
            .try_for_each(Running::go_on)
    }

    /// Looks at how much CPU time clients have used.
    pub(super) fn look(&mut self) {
        self.running_mut().for_each(Running::look);
    }

    /// The place of one of the clients of which `can_be` holds and that do not end by themselves.
    fn choose(&self, rng: &mut Rng, can_be: impl Fn(&Running) -> bool) -> Option<usize> {
        let fits = |slot: &Slot| {
            slot.running.as_ref().is_some_and(|client| !client.parting && can_be(client))
        };
        let fitting: Vec<usize> =
            (0..self.slots.len()).filter(|index| fits(&self.slots[*index])).collect();
        (!fitting.is_empty()).then(|| fitting[rng.index(fitting.len())])
    }

    fn running(&self) -> impl Iterator<Item = &Running> {
        self.slots.iter().filter_map(|slot| slot.running.as_ref())
    }

    fn running_mut(&mut self) -> impl Iterator<Item = &mut Running> {
        self.slots.iter_mut().filter_map(|slot| slot.running.as_mut())
    }
}

impl Running {
    fn go_on(&mut self) -> anyhow::Result<()> {
        if let Some((since, _)) = self.stopped.take() {
            self.process.signal(Signal::CONT)?;
            self.frozen += since.elapsed().as_secs_f64();
            self.heard = Instant::now();
        }
        Ok(())
    }

    fn look(&mut self) {
        // Where it has just ended, what was seen before stays.
        if let Ok(seconds) = usage::cpu_seconds(&[self.process.pid()]) {
            self.cpu_seconds = seconds;
        }
    }
}

/// An error where Python clients cannot be had.
pub(super) fn check_python() -> anyhow::Result<()> {
    let python = python();
    let hint = format!("${PYTHON} may name a Python that has the package trocar");
    let tried = Command::new(&python)
        .args(["-c", "import trocar"])
        .output()
        .with_context(|| format!("{}; {hint}", python.display()))?;
    let said = String::from_utf8_lossy(&tried.stderr);
    let reason = said.lines().last().unwrap_or("it says nothing");
    anyhow::ensure!(tried.status.success(), "{}: {reason}; {hint}", python.display());
    Ok(())
}
