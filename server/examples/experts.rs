//! How often scripted experts succeed: a Markdown table of conditions and tasks.
//!
//! ```text
//! cargo run --release --example experts -- --seeds 0..40 --conditions default,rate --tasks NeedlePick
//! ```
//!
//! Success is that of an episode's last step. `--conditions` and `--tasks` take the beginnings of names, `--failures`
//! lists the seeds that failed, `--threads` is 1 unless given. Of tasks with soft bodies it tells what episodes did to them.

use std::collections::BTreeMap;
use std::io::Write;
use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, bail};
use trocar_proto::spec::Allowed;
use trocar_proto::{OptionValue, Options, builtin};
use trocar_server::{Registry, Step};

/// What may be wrong with an arm: rate, Hz, and rows of `domain`.
type Condition = (&'static str, f64, &'static [(&'static str, [f64; 2])]);

/// Conditions whose rows are beside those of the preset `dvrk`.
const DVRK: &str = "dvrk";

/// How far the pad gives, m: of tasks whose object lies on a pad.
const PAD: (&str, [f64; 2]) = ("pad_depth", [0.002; 2]);

/// Actuators that add noise to commands that come late.
const NOISY_AND_LATE: [(&str, [f64; 2]); 2] =
    [("action_noise", [0.5e-3; 2]), ("latency_seconds", [0.06; 2])];

const CONDITIONS: [Condition; 17] = [
    ("default", 5.0, &[]),
    ("rate 10", 10.0, &[]),
    ("rate 20", 20.0, &[]),
    ("rate 30", 30.0, &[]),
    ("rate 40", 40.0, &[]),
    ("rate 60", 60.0, &[]),
    ("noise 0.5 mm", 5.0, &[("action_noise", [0.5e-3; 2])]),
    ("noise 1 mm", 5.0, &[("action_noise", [1e-3; 2])]),
    ("noise 0.5 mm, late 60 ms", 5.0, &NOISY_AND_LATE),
    ("late 60 ms, rate 20", 20.0, &[("latency_seconds", [0.06; 2])]),
    ("late 60 ms, noise 0.5 mm, rate 20", 20.0, &NOISY_AND_LATE),
    ("late 1 step", 5.0, &[("latency", [1.0; 2])]),
    ("offset 0.01", 5.0, &[("joint_offset", [-0.01, 0.01])]),
    ("offset 0.02", 5.0, &[("joint_offset", [-0.02, 0.02])]),
    (
        "together",
        20.0,
        &[
            ("action_noise", [0.5e-3; 2]),
            ("latency_seconds", [0.06; 2]),
            ("joint_offset", [-0.01, 0.01]),
        ],
    ),
    ("dvrk", 5.0, &[]),
    ("dvrk on pad", 5.0, &[PAD]),
];

struct Arguments {
    seeds: Range<u64>,
    conditions: Vec<String>,
    tasks: Vec<String>,
    options: Options,
    threads: usize,
    lists_failures: bool,
}

impl Arguments {
    fn parse(mut words: impl Iterator<Item = String>) -> anyhow::Result<Self> {
        let mut arguments = Self {
            seeds: 0..40,
            conditions: vec![],
            tasks: vec![],
            options: Options::new(),
            threads: 1,
            lists_failures: false,
        };
        while let Some(word) = words.next() {
            let mut value = || words.next().with_context(|| format!("{word} needs a value"));
            let list = |value: String| value.split(',').map(String::from).collect();
            match word.as_str() {
                "--seeds" => {
                    let value = value()?;
                    let (first, end) = value.split_once("..").context("--seeds FIRST..END")?;
                    arguments.seeds = first.parse()?..end.parse()?;
                }
                "--conditions" => arguments.conditions = list(value()?),
                "--tasks" => arguments.tasks = list(value()?),
                "--text" => {
                    let value = value()?;
                    let (name, word) = value.split_once('=').context("--text NAME=WORD")?;
                    arguments.options = arguments.options.with_text(name, word);
                }
                "--threads" => arguments.threads = value()?.parse()?,
                "--failures" => arguments.lists_failures = true,
                _ => bail!("unknown argument {word}"),
            }
        }
        Ok(arguments)
    }
}

/// A task under a condition, and the seeds with which its expert fails.
struct Cell {
    task: &'static str,
    condition: Condition,
    failed: Mutex<Vec<u64>>,
    harms: Mutex<Vec<Harm>>,
}

/// What an episode did to tissue: the greatest of its steps.
#[derive(Debug, Clone, Copy, Default)]
struct Harm {
    pressure: f32,
    overstretched: f32,
    crushed: f32,
}

impl Harm {
    fn add(&mut self, step: &Step) {
        self.pressure = self.pressure.max(step.tissue_pressure);
        self.overstretched = self.overstretched.max(step.overstretched);
        self.crushed = self.crushed.max(step.crushed);
    }
}

impl Cell {
    fn run(&self, options: &Options, seeds: &[u64]) -> anyhow::Result<()> {
        let (name, rate, rows) = self.condition;
        let registry = Registry::builtin();
        let known = registry.spec(self.task, &Options::new())?.options;
        let knows = |row: &str| {
            let domain = known.iter().find(|option| option.name == "domain");
            let Some(Allowed::Table(rows)) = domain.map(|domain| &domain.allowed) else {
                return false;
            };
            rows.iter().any(|known| known.name == row)
        };
        let rows = rows.iter().filter(|(row, _)| *row != PAD.0 || knows(row));
        let rows = rows.map(|(row, range)| (row.to_string(), range.to_vec()));
        let rows: BTreeMap<_, _> = rows.collect();
        let options = options.clone().with("rate", OptionValue::Number(rate));
        let domain = if name.starts_with(DVRK) {
            OptionValue::Preset(DVRK.into(), rows)
        } else {
            OptionValue::Table(rows)
        };
        let mut env = registry.make(self.task, &options.with("domain", domain))?;
        let mut action = vec![0.0; env.spec().action_dim()];
        for seed in seeds {
            env.reset(Some(*seed));
            let (mut is_success, mut harm) = (false, Harm::default());
            while !env.needs_reset() {
                env.expert(&mut action);
                let step = env.step(&action)?;
                is_success = step.is_success;
                harm.add(&step);
            }
            if !is_success {
                self.failed.lock().expect("no thread panics").push(*seed);
            }
            if env.spec().has_tissue {
                self.harms.lock().expect("no thread panics").push(harm);
            }
        }
        Ok(())
    }

    /// What its episodes did to tissue, where there is some.
    fn tell_harms(&self, out: &mut impl Write) -> std::io::Result<()> {
        let harms = self.harms.lock().expect("no thread panics");
        if harms.is_empty() {
            return Ok(());
        }
        let quantile = |share: f64, of: fn(&Harm) -> f32| {
            let mut sorted: Vec<_> = harms.iter().map(of).collect();
            sorted.sort_unstable_by(f32::total_cmp);
            sorted[(share * (sorted.len() - 1) as f64).round() as usize]
        };
        let whole = harms.iter().filter(|harm| harm.overstretched == 0.0).count();
        let share = 100.0 * whole as f64 / harms.len() as f64;
        write!(out, "{} {}: nothing overstretched in {share:.1} %", self.task, self.condition.0)?;
        let percent = |share: f32| 100.0 * share;
        let worst = percent(quantile(1.0, |harm| harm.overstretched));
        let [median, most] = [0.5, 1.0].map(|share| 1e-3 * quantile(share, |harm| harm.pressure));
        let crushed = percent(quantile(0.5, |harm| harm.crushed));
        write!(out, ", at most {worst:.1} % of the elements; pressure {median:.0} kPa (median)")?;
        writeln!(out, ", {most:.0} kPa (most); crushed {crushed:.0} % (median)")
    }
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse(std::env::args().skip(1))?;
    let is_asked = |names: &[String], name: &str| {
        names.is_empty() || names.iter().any(|asked| name.starts_with(asked.as_str()))
    };
    let grasping = builtin::ALL
        .iter()
        .filter(|task| task.has("grasp") || task.has("tissue") || !arguments.tasks.is_empty())
        .map(|task| task.id);
    let tasks: Vec<_> = grasping.filter(|task| is_asked(&arguments.tasks, task)).collect();
    let conditions = CONDITIONS.iter().filter(|each| is_asked(&arguments.conditions, each.0));
    let cells: Vec<_> = conditions
        .flat_map(|condition| tasks.iter().map(|task| (*task, *condition)))
        .map(|(task, condition)| Cell {
            task,
            condition,
            failed: Mutex::default(),
            harms: Mutex::default(),
        })
        .collect();
    let seeds: Vec<_> = arguments.seeds.clone().collect();
    // Few at a time, so that no thread is the last for long.
    let chunks: Vec<_> =
        cells.iter().flat_map(|cell| seeds.chunks(10).map(move |chunk| (cell, chunk))).collect();
    let next = AtomicUsize::new(0);
    let work = || -> anyhow::Result<()> {
        while let Some((cell, seeds)) = chunks.get(next.fetch_add(1, Ordering::Relaxed)) {
            cell.run(&arguments.options, seeds)?;
        }
        Ok(())
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..arguments.threads).map(|_| scope.spawn(work)).collect();
        workers.into_iter().try_for_each(|worker| worker.join().expect("no thread panics"))
    })?;

    let mut out = std::io::stdout().lock();
    writeln!(out, "| condition | {} |", tasks.join(" | "))?;
    writeln!(out, "|---|{}", "---|".repeat(tasks.len()))?;
    for row in cells.chunks(tasks.len().max(1)) {
        write!(out, "| {} |", row[0].condition.0)?;
        for cell in row {
            let failed = cell.failed.lock().expect("no thread panics").len();
            let share = 1.0 - failed as f64 / seeds.len() as f64;
            write!(out, " {:.1} % |", 100.0 * share)?;
        }
        writeln!(out)?;
    }
    for cell in &cells {
        cell.tell_harms(&mut out)?;
    }
    for cell in cells.iter().filter(|_| arguments.lists_failures) {
        let mut failed = cell.failed.lock().expect("no thread panics").clone();
        failed.sort_unstable();
        writeln!(out, "{} {}: {failed:?}", cell.task, cell.condition.0)?;
    }
    Ok(())
}
