//! What the load has found.

use serde::Serialize;

use super::Load;
use super::fleet::Slot;
use crate::output;

/// What a quantum of another client counts at least, µs: half of what the server's quanta last.
const QUANTUM_US: f64 = 1000.0;

/// How many problems of a kind are told in words.
const TOLD: usize = 5;

/// What happened so far, over all clients.
#[derive(Debug, Default)]
pub(super) struct Tally {
    pub(super) killed: u64,
    pub(super) reclaimed: u64,
    pub(super) stopped: u64,
    pub(super) restarts: u64,
    pub(super) errors: Problems,
    pub(super) mismatches: Problems,
    pub(super) leaked: Problems,
}

/// How often something went wrong, and what the first ones were.
#[derive(Debug, Default)]
pub(super) struct Problems {
    count: u64,
    first: Vec<String>,
}

impl Problems {
    pub(super) fn add(&mut self, what: impl Into<String>) {
        self.count += 1;
        if self.first.len() < TOLD {
            self.first.push(what.into());
        }
    }

    fn tell(&self, kind: &str) {
        for what in &self.first {
            eprintln!("{kind}: {what}");
        }
        let more = self.count - self.first.len() as u64;
        if more > 0 {
            eprintln!("{kind}: … and {more} more");
        }
    }
}

/// What the server used.
#[derive(Debug, Default)]
pub(super) struct ServerUse {
    /// CPU time of all of its runs, s.
    pub(super) cpu_seconds: f64,
    /// Resident memory of the present run by time: s, bytes.
    pub(super) memory: Vec<(f64, f64)>,
}

/// The line for scripts; design §7 names the keys.
#[derive(Debug, Serialize)]
pub(super) struct Summary {
    clients: usize,
    envs: u32,
    steps: u64,
    steps_per_second: f64,
    p50_us: f64,
    p99_us: f64,
    jain: f64,
    killed: u64,
    reclaimed: u64,
    stopped: u64,
    restarts: u64,
    errors: u64,
    mismatches: u64,
    leaked: u64,
    server_memory_bytes: Option<u64>,
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    beside: Option<Beside>,
}

/// How the first client fares beside others that have another task.
#[derive(Debug, Serialize)]
struct Beside {
    /// 99th percentile of its latencies, µs.
    first_p99_us: f64,
    /// What its share of the threads implies, µs.
    share_us: f64,
    #[serde(skip)]
    /// What a quantum of the others takes, µs.
    quantum: f64,
}

impl Beside {
    /// In the worst case every other client has a quantum before the first one's message has its own. A quantum
    /// counts [`QUANTUM_US`], or as long as one environment of the others takes for a step if that is more.
    fn new(slots: &[Slot], envs: u32, threads: usize) -> Option<Self> {
        let (first, others) = slots.split_first()?;
        let messages: u64 = others.iter().map(|slot| slot.latencies.len()).sum();
        let seconds: f64 = others.iter().map(|slot| slot.twin_seconds).sum();
        if first.latencies.is_empty() || messages == 0 || seconds == 0.0 {
            return None;
        }
        let own_us = first.twin_seconds * 1e6 / first.latencies.len() as f64;
        let step_us = seconds * 1e6 / (messages as f64 * f64::from(envs));
        let quantum = step_us.max(QUANTUM_US);
        Some(Self {
            first_p99_us: first.latencies.value_at_quantile(0.99) as f64 / 1000.0,
            share_us: own_us + others.len() as f64 * quantum / threads as f64,
            quantum,
        })
    }
}

impl Summary {
    /// What a load of `seconds` has found.
    pub(super) fn new(
        load: &Load,
        slots: &[Slot],
        tally: &Tally,
        server: &ServerUse,
        seconds: f64,
    ) -> Self {
        let steps = slots.iter().map(|slot| slot.steps).sum();
        let mut latencies = slots[0].latencies.clone();
        for slot in &slots[1..] {
            latencies.add(&slot.latencies).expect("all have the same range and digits");
        }
        let micros = |quantile| latencies.value_at_quantile(quantile) as f64 / 1000.0;
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        let rates: Vec<f64> = slots.iter().filter_map(Slot::rate).collect();
        Self {
            clients: slots.len(),
            envs: load.envs,
            steps,
            steps_per_second: steps as f64 / seconds,
            p50_us: micros(0.5),
            p99_us: micros(0.99),
            jain: jain(&rates),
            killed: tally.killed,
            reclaimed: tally.reclaimed,
            stopped: tally.stopped,
            restarts: tally.restarts,
            errors: tally.errors.count,
            mismatches: tally.mismatches.count,
            leaked: tally.leaked.count,
            server_memory_bytes: server.memory.last().map(|(_, bytes)| *bytes as u64),
            beside: load.others.as_ref().and_then(|_| Beside::new(slots, load.envs, threads)),
        }
    }

    /// What makes the load a failure, in words.
    pub(super) fn failure(&self) -> Option<String> {
        let Self { errors, mismatches, leaked, .. } = self;
        let unclaimed = self.killed - self.reclaimed;
        (errors + mismatches + leaked + unclaimed > 0).then(|| {
            format!(
                "{errors} errors, {mismatches} mismatches, {leaked} leaks, {unclaimed} killed \
                 clients whose sessions stay"
            )
        })
    }

    /// A table for people, and the first problems in words.
    pub(super) fn show(&self, slots: &[Slot], tally: &Tally, server: &ServerUse, seconds: f64) {
        let header = ["client", "language", "steps", "steps/s", "CPU"];
        let header = header.into_iter().chain(["killed", "stopped", "sessions"]);
        let mut table = output::table(&header.collect::<Vec<_>>(), 2);
        for (index, slot) in slots.iter().enumerate() {
            table.add_row([
                (index + 1).to_string(),
                slot.language.name().into(),
                slot.steps.to_string(),
                slot.rate().map_or("–".into(), |rate| format!("{rate:.0}")),
                share(slot.cpu_seconds(), seconds),
                slot.killed.to_string(),
                slot.stopped.to_string(),
                slot.sessions.to_string(),
            ]);
        }
        table.add_row([
            "all".into(),
            String::new(),
            self.steps.to_string(),
            format!("{:.0}", self.steps_per_second),
            share(slots.iter().map(Slot::cpu_seconds).sum(), seconds),
            self.killed.to_string(),
            self.stopped.to_string(),
            slots.iter().map(|slot| slot.sessions).sum::<u64>().to_string(),
        ]);
        eprintln!("{table}");
        eprintln!(
            "latency of a message: p50 {:.0} µs, p99 {:.0} µs; fairness (Jain) {:.3}",
            self.p50_us, self.p99_us, self.jain
        );
        if let Some(Beside { first_p99_us, share_us, quantum }) = &self.beside {
            let times = first_p99_us / share_us;
            eprintln!(
                "client 1 beside the others: p99 {first_p99_us:.0} µs, {times:.1} × the \
                 {share_us:.0} µs that its share implies (quanta of {quantum:.0} µs)"
            );
        }
        let memory = self.server_memory_bytes.map_or("–".into(), output::mebibytes);
        let slope = slope(&server.memory).map_or(String::new(), |slope| {
            // Per hour, in the unit of the other figure.
            format!(" changing by {:+.1} MiB/h,", slope * 3600.0 / f64::from(1 << 20))
        });
        eprintln!(
            "server: CPU {}, memory {memory},{slope} {} restarts",
            share(server.cpu_seconds, seconds),
            self.restarts
        );
        eprintln!(
            "{} clients killed, the sessions of {} reclaimed; {} stopped and let go on",
            self.killed, self.reclaimed, self.stopped
        );
        eprintln!(
            "{} errors, {} mismatches with the in-process twins, {} leaks",
            self.errors, self.mismatches, self.leaked
        );
        tally.errors.tell("error");
        tally.mismatches.tell("mismatch");
        tally.leaked.tell("leak");
    }
}

/// CPU time as a share of one core.
fn share(cpu_seconds: f64, seconds: f64) -> String {
    format!("{:.0} %", 100.0 * cpu_seconds / seconds)
}

/// Jain's index: 1 where all rates are equal, 1/n where one has everything.
fn jain(rates: &[f64]) -> f64 {
    let squares: f64 = rates.iter().map(|rate| rate * rate).sum();
    let sum: f64 = rates.iter().sum();
    if squares > 0.0 { sum * sum / (rates.len() as f64 * squares) } else { 0.0 }
}

/// How long a run of a server takes to have all the memory that it keeps, s.
const WARM_UP: f64 = 60.0;

/// The shortest span from which a slope is told, s: the pages of one session more or less are no slope.
const LEAST_SPAN: f64 = 30.0;

/// The slope of the straight line through the points past [`WARM_UP`], by least squares, where they
/// cover [`LEAST_SPAN`].
fn slope(points: &[(f64, f64)]) -> Option<f64> {
    let begin = points.first()?.0 + WARM_UP;
    let points = &points[points.partition_point(|point| point.0 < begin)..];
    if points.last()?.0 - begin < LEAST_SPAN {
        return None;
    }
    let count = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (x, y) = (mean(|point| point.0), mean(|point| point.1));
    let spread: f64 = points.iter().map(|point| (point.0 - x).powi(2)).sum();
    let rise: f64 = points.iter().map(|point| (point.0 - x) * (point.1 - y)).sum();
    (spread > 0.0).then(|| rise / spread)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fairness_is_one_for_equals_and_a_share_for_one_alone() {
        assert_eq!(jain(&[3.0, 3.0, 3.0]), 1.0);
        assert_eq!(jain(&[5.0, 0.0, 0.0, 0.0]), 0.25);
        assert_eq!(jain(&[]), 0.0);
    }

    #[test]
    fn growth_at_the_beginning_is_no_slope() {
        // From when on there are points, until when, and what grows until when, per second.
        let grown = |from: u32, to: u32, until: u32| -> Vec<(f64, f64)> {
            (from..to).map(|at| (at.into(), 2.0 * f64::from(at.min(until)))).collect()
        };
        assert_eq!(slope(&grown(0, 100, 60)), Some(0.0));
        let steady = slope(&grown(0, 100, 100)).unwrap();
        assert!((steady - 2.0).abs() < 1e-9, "{steady}");
        // A server that was restarted has to warm up again.
        assert_eq!(slope(&grown(200, 300, 260)), Some(0.0));
        assert_eq!(slope(&grown(0, 80, 80)), None);
        assert_eq!(slope(&[]), None);
    }

    #[test]
    fn only_the_first_problems_are_kept() {
        let mut problems = Problems::default();
        for number in 0..10 {
            problems.add(number.to_string());
        }
        assert_eq!((problems.count, problems.first.len()), (10, TOLD));
    }
}
