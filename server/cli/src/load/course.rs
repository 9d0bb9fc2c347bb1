//! What happens when: clients start, work, are killed and stopped, end, and are looked for.

use std::io::IsTerminal;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::bail;
use indicatif::{ProgressBar, ProgressStyle};
use trocar_server::sim::random::Rng;

use super::fleet::{Fleet, Killed};
use super::report::{ServerUse, Summary, Tally};
use super::target::{Footprint, Target};
use super::{INTERRUPTED, Load};
use crate::{output, usage};

/// How often there is a look at what is due.
const TICK: Duration = Duration::from_millis(20);

/// How often memory and CPU times are looked at.
const LOOK: Duration = Duration::from_millis(500);

/// How often a log gets a line.
const LOG_INTERVAL: Duration = Duration::from_secs(10);

/// How long the server may take to give up what clients have left.
const SETTLING: Duration = Duration::from_secs(30);

/// The course of a load. Declared order is drop order: whatever happens, clients end first.
pub(super) struct Course<'a> {
    fleet: Fleet<'a>,
    target: Target,
    load: &'a Load,
    rng: Rng,
    tally: Tally,
    server: ServerUse,
    /// Clients whose sessions the server has not given up yet.
    unclaimed: Vec<Killed>,
    before: Footprint,
    looked: Instant,
    /// CPU time of the present run of the server when it was last looked at, s.
    server_cpu_seconds: f64,
}

impl<'a> Course<'a> {
    /// Starts the server, where it is to be one of its own, and the clients.
    pub(super) fn new(load: &'a Load) -> anyhow::Result<Self> {
        let target = Target::new(load.server.as_ref())?;
        let start = Instant::now();
        let before = loop {
            match target.footprint(&[].into(), start)? {
                Some(before) => break before,
                None => std::thread::sleep(TICK),
            }
            check_interrupt()?;
        };
        let mut course = Self {
            fleet: Fleet::start(load, target.name())?,
            target,
            load,
            // No environment has the seed of a load and this episode.
            rng: Rng::new(load.seed, u64::MAX),
            tally: Tally::default(),
            server: ServerUse::default(),
            unclaimed: vec![],
            before,
            looked: Instant::now(),
            server_cpu_seconds: 0.0,
        };
        while !course.fleet.is_ready() {
            course.tick()?;
        }
        Ok(course)
    }

    /// Runs all of it, and tells what was found.
    pub(super) fn run(mut self, json: bool) -> anyhow::Result<Summary> {
        let lasted = self.work()?;
        self.end_clients()?;
        let Self { fleet, target, load, mut tally, server, .. } = self;
        for left in target.finish()? {
            tally.leaked.add(left);
        }
        let summary = Summary::new(load, &fleet.slots, &tally, &server, lasted);
        summary.show(&fleet.slots, &tally, &server, lasted);
        if json {
            output::json_line(&summary)?;
        }
        Ok(summary)
    }

    /// Lets clients work, and others suffer, for the time that was asked for; gives it, s.
    fn work(&mut self) -> anyhow::Result<f64> {
        let display = Display::new(self.load.seconds);
        let mut kill = Now::and_then(self.load.kill_every, &mut self.rng);
        let mut stop = Now::and_then(self.load.stop_every, &mut self.rng);
        let mut restart = Now::and_then(self.load.restart_server, &mut self.rng);
        let mut logged = Instant::now();
        self.look(0.0);
        self.server.cpu_seconds = 0.0;
        let start = Instant::now();
        self.fleet.begin()?;
        while start.elapsed().as_secs_f64() < self.load.seconds && self.fleet.count() > 0 {
            self.tick()?;
            if kill.is_due(&mut self.rng)
                && let Some(killed) = self.fleet.kill_one(&mut self.rng)?
            {
                self.tally.killed += 1;
                self.unclaimed.push(killed);
            }
            if stop.is_due(&mut self.rng) && self.fleet.stop_one(&mut self.rng)? {
                self.tally.stopped += 1;
            }
            self.fleet.go_on()?;
            if restart.is_due(&mut self.rng) {
                self.look(start.elapsed().as_secs_f64());
                self.target.restart()?;
                self.tally.restarts += 1;
                self.server.memory.clear();
                self.server_cpu_seconds = 0.0;
            }
            if self.looked.elapsed() > LOOK {
                self.look(start.elapsed().as_secs_f64());
                display.show(start.elapsed(), &self.fleet, &self.tally, &mut logged);
            }
        }
        let lasted = start.elapsed().as_secs_f64();
        self.look(lasted);
        display.finish();
        Ok(lasted)
    }

    /// Ends the clients in order, and looks for what is left of them.
    fn end_clients(&mut self) -> anyhow::Result<()> {
        self.fleet.end()?;
        while !self.fleet.has_ended() {
            self.tick()?;
        }
        let ended = Instant::now();
        loop {
            self.tick()?;
            let Some(now) = self.target.footprint(&self.fleet.pids, ended)? else { continue };
            let left = now.beyond(&self.before);
            if left.is_empty() && self.unclaimed.is_empty() {
                return Ok(());
            }
            if ended.elapsed() > SETTLING {
                for left in left {
                    self.tally.leaked.add(left);
                }
                return Ok(());
            }
        }
    }

    /// Hears what clients say, and sees which sessions of killed ones are gone.
    fn tick(&mut self) -> anyhow::Result<()> {
        check_interrupt()?;
        self.fleet.hear(TICK, &mut self.tally);
        let seen = self.target.seen()?;
        let before = self.unclaimed.len();
        self.unclaimed.retain(|killed| !seen.lacks(killed.pid, killed.at));
        self.tally.reclaimed += (before - self.unclaimed.len()) as u64;
        Ok(())
    }

    /// Looks at memory and CPU times, `seconds` after the beginning.
    fn look(&mut self, seconds: f64) {
        self.looked = Instant::now();
        self.fleet.look();
        let Some(pid) = self.target.pid() else { return };
        if let Some(memory) = usage::resident_memory(pid) {
            self.server.memory.push((seconds, memory as f64));
        }
        if let Ok(cpu_seconds) = usage::cpu_seconds(&[pid]) {
            self.server.cpu_seconds += cpu_seconds - self.server_cpu_seconds;
            self.server_cpu_seconds = cpu_seconds;
        }
    }
}

fn check_interrupt() -> anyhow::Result<()> {
    if INTERRUPTED.load(Ordering::Acquire) {
        bail!("interrupted");
    }
    Ok(())
}

/// Something that happens now and then.
struct Now {
    /// Mean time between two, s; `None` where it never happens.
    every: Option<f64>,
    next: Instant,
}

impl Now {
    fn and_then(every: Option<f64>, rng: &mut Rng) -> Self {
        let mut now = Self { every, next: Instant::now() };
        now.put_off(rng);
        now
    }

    fn is_due(&mut self, rng: &mut Rng) -> bool {
        let due = self.every.is_some() && Instant::now() >= self.next;
        if due {
            self.put_off(rng);
        }
        due
    }

    fn put_off(&mut self, rng: &mut Rng) {
        if let Some(every) = self.every {
            // Never in step with what clients and servers do regularly.
            let pause = every * rng.uniform(0.5, 1.5);
            self.next = Instant::now() + Duration::from_secs_f64(pause);
        }
    }
}

/// Live progress: a bar on a terminal, a line now and then in a log.
struct Display(Option<ProgressBar>);

impl Display {
    fn new(seconds: f64) -> Self {
        Self(std::io::stderr().is_terminal().then(|| {
            let style = ProgressStyle::with_template("{bar:24} {eta} left, {msg}")
                .expect("the template is well-formed");
            ProgressBar::new((seconds * 1000.0) as u64).with_style(style)
        }))
    }

    fn show(&self, elapsed: Duration, fleet: &Fleet<'_>, tally: &Tally, logged: &mut Instant) {
        let steps: u64 = fleet.slots.iter().map(|slot| slot.steps).sum();
        let text = format!(
            "{} clients, {:.0} steps/s, {} killed, {} stopped, {} restarts",
            fleet.count(),
            steps as f64 / elapsed.as_secs_f64(),
            tally.killed,
            tally.stopped,
            tally.restarts
        );
        match &self.0 {
            Some(bar) => {
                bar.set_position(elapsed.as_millis() as u64);
                bar.set_message(text);
            }
            None if logged.elapsed() > LOG_INTERVAL => {
                *logged = Instant::now();
                eprintln!("{:5.0} s: {text}", elapsed.as_secs_f64());
            }
            None => {}
        }
    }

    fn finish(&self) {
        self.0.iter().for_each(ProgressBar::finish_and_clear);
    }
}
