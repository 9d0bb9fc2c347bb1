//! What a server counts, for Prometheus. Sessions count on handles of their own, so that a message
//! costs a few atomic additions.

use std::fs;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use prometheus_client::encoding::{EncodeLabelSet, text};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::{Metric, Registry};
use trocar_proto::Code;

use super::scheduler::Scheduler;

/// Borders between the classes of step latencies, s.
const LATENCIES: [f64; 16] =
    [1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1, 0.3, 1.0, 10.0];

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Task {
    task: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Kind {
    kind: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Reason {
    reason: &'static str,
}

/// Everything that is counted.
#[derive(Debug)]
pub(super) struct Meter {
    registry: Registry,
    scheduler: Arc<Scheduler>,
    /// Processes that have sessions.
    pub(super) clients: Gauge,
    /// Open sessions.
    pub(super) sessions: Gauge,
    /// Environments of all of them.
    pub(super) envs: Gauge,
    /// Memory that counts against the budget, bytes.
    pub(super) memory: Gauge,
    opened: Counter,
    closed: Family<Reason, Counter>,
    refusals: Family<Kind, Counter>,
    steps: Family<Task, Counter>,
    resets: Family<Task, Counter>,
    failures: Family<Task, Counter>,
    latency: Family<Task, Histogram, fn() -> Histogram>,
    busy: Counter<f64, AtomicU64>,
    resident: Gauge,
}

/// What one session counts, together with all others of its task.
#[derive(Debug)]
pub(super) struct TaskMeter {
    /// Environment steps.
    pub(super) steps: Counter,
    /// Episodes that began.
    pub(super) resets: Counter,
    /// Environments whose simulation failed.
    pub(super) failures: Counter,
    /// Time from a step's request to its reply, s.
    pub(super) latency: Histogram,
}

impl Meter {
    /// All at zero, for a server with these threads and this budget of memory.
    pub(super) fn new(scheduler: Arc<Scheduler>, threads: usize, memory_bytes: u64) -> Self {
        let mut registry = Registry::with_prefix("trocar");
        let (thread_count, budget): (Gauge, Gauge) = (Gauge::default(), Gauge::default());
        thread_count.set(threads as i64);
        budget.set(i64::try_from(memory_bytes).unwrap_or(i64::MAX));
        let mut add = Adder(&mut registry);
        add.register("threads", "Threads that step environments", thread_count);
        add.register("memory_budget_bytes", "Memory that sessions and snapshots may take", budget);
        let latency = || Histogram::new(LATENCIES);
        let latency = Family::new_with_constructor(latency as fn() -> Histogram);
        Self {
            clients: add.register("clients", "Processes that have sessions", Gauge::default()),
            sessions: add.register("sessions", "Open sessions", Gauge::default()),
            envs: add.register("envs", "Environments of all sessions", Gauge::default()),
            memory: add.register(
                "memory_bytes",
                "Memory that sessions and snapshots are counted with",
                Gauge::default(),
            ),
            opened: add.register(
                "sessions_opened",
                "Sessions that were opened",
                Counter::default(),
            ),
            closed: add.register(
                "sessions_closed",
                "Sessions that ended, by reason; those of clients that died are reclaimed",
                Family::default(),
            ),
            refusals: add.register("refusals", "Requests that were refused", Family::default()),
            steps: add.register("steps", "Environment steps", Family::default()),
            resets: add.register("resets", "Episodes that began", Family::default()),
            failures: add.register(
                "failed_envs",
                "Environments whose simulation failed",
                Family::default(),
            ),
            latency: add.register(
                "step_latency_seconds",
                "Time that the server takes for one step message",
                latency,
            ),
            busy: add.register(
                "threads_busy_seconds",
                "Time for which threads were taken, all together; its rate by threads is their \
                 busy share",
                Counter::default(),
            ),
            resident: add.register(
                "resident_memory_bytes",
                "Memory of the server's process that is in RAM",
                Gauge::default(),
            ),
            scheduler,
            registry,
        }
    }

    /// The counters of a task.
    pub(super) fn task(&self, id: &str) -> TaskMeter {
        let task = Task { task: id.into() };
        TaskMeter {
            steps: self.steps.get_or_create_owned(&task),
            resets: self.resets.get_or_create_owned(&task),
            failures: self.failures.get_or_create_owned(&task),
            latency: self.latency.get_or_create_owned(&task),
        }
    }

    /// A session was opened.
    pub(super) fn opened(&self) {
        self.opened.inc();
    }

    /// A session ended.
    pub(super) fn closed(&self, reason: &'static str) {
        self.closed.get_or_create(&Reason { reason }).inc();
    }

    /// A request was refused.
    pub(super) fn refused(&self, code: Code) {
        self.refusals.get_or_create(&Kind { kind: format!("{code:?}") }).inc();
    }

    /// All of it as text, as OpenMetrics 1.0 has it.
    pub(super) fn text(&self) -> Result<String, std::fmt::Error> {
        let busy = self.scheduler.busy().as_secs_f64();
        self.busy.inner().store(busy.to_bits(), Ordering::Relaxed);
        self.resident.set(resident_memory().unwrap_or(0));
        let mut text = String::new();
        text::encode(&mut text, &self.registry)?;
        Ok(text)
    }
}

impl TaskMeter {
    /// A step message was answered after `time`.
    pub(super) fn stepped(&self, time: Duration) {
        self.latency.observe(time.as_secs_f64());
    }
}

/// Registers metrics and hands them on.
struct Adder<'a>(&'a mut Registry);

impl Adder<'_> {
    fn register<M: Metric + Clone>(&mut self, name: &str, help: &str, metric: M) -> M {
        self.0.register(name, help, metric.clone());
        metric
    }
}

/// Memory of this process that is in RAM, bytes.
fn resident_memory() -> Option<i64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<i64>().ok()? << 10)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::scheduler::tests::TestScheduler;

    #[test]
    fn what_was_counted_is_told() {
        let test = TestScheduler::new("meter", 2);
        let meter = Meter::new(Arc::clone(&test.scheduler), 2, 1 << 30);
        meter.sessions.set(3);
        meter.closed("reclaimed");
        meter.refused(Code::MemoryBudget);
        let task = meter.task("EcmReach-v0");
        task.steps.inc_by(40);
        task.stepped(Duration::from_micros(30));
        // Another session of the task.
        meter.task("EcmReach-v0").steps.inc_by(2);
        let text = meter.text().unwrap();
        for line in [
            "trocar_sessions 3",
            "trocar_threads 2",
            "trocar_memory_budget_bytes 1073741824",
            "trocar_sessions_closed_total{reason=\"reclaimed\"} 1",
            "trocar_refusals_total{kind=\"MemoryBudget\"} 1",
            "trocar_steps_total{task=\"EcmReach-v0\"} 42",
            "trocar_step_latency_seconds_bucket{le=\"0.00005\",task=\"EcmReach-v0\"} 1",
            "trocar_step_latency_seconds_bucket{le=\"0.00002\",task=\"EcmReach-v0\"} 0",
            "trocar_step_latency_seconds_count{task=\"EcmReach-v0\"} 1",
        ] {
            assert!(text.lines().any(|found| found == line), "{line} in {text}");
        }
        assert!(text.ends_with("# EOF\n"));
    }
}
