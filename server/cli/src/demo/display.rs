//! Live progress: bars on a terminal, a line now and then in a log.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};

use super::{Part, Progress};
use crate::output;

/// How often a client gets a line in a log.
const LOG_INTERVAL: Duration = Duration::from_secs(2);

/// What is shown while the clients work.
pub(super) enum Display {
    Bars(Vec<ProgressBar>),
    Log { labels: Vec<String>, shown: Vec<Option<Instant>> },
}

impl Display {
    /// Shows nothing yet. The clients work for `seconds`.
    pub(super) fn new(parts: &[Part], seconds: f64) -> Self {
        let label = |part: &Part| format!("{:9} {:15}", part.name, part.task);
        if !std::io::stderr().is_terminal() {
            let labels = parts.iter().map(label).collect();
            return Self::Log { labels, shown: vec![None; parts.len()] };
        }
        let style = ProgressStyle::with_template("{prefix} {bar:24} {msg}")
            .expect("the template is well-formed");
        let all = MultiProgress::new();
        let bar = |part: &Part| {
            let bar = ProgressBar::new((seconds * 1000.0) as u64).with_style(style.clone());
            all.add(bar.with_prefix(label(part)))
        };
        Self::Bars(parts.iter().map(bar).collect())
    }

    /// Shows what client `index` reported.
    pub(super) fn show(&mut self, index: usize, progress: &Progress) {
        let text = if progress.steps == 0 {
            "ready".into()
        } else {
            format!(
                "{:6} episodes, {:>7} success, {:7.0} steps/s, p50 {:.2} ms",
                progress.episodes,
                output::percent(progress.success_rate()),
                progress.steps_per_second(),
                progress.p50_us / 1000.0
            )
        };
        match self {
            Self::Bars(bars) => {
                bars[index].set_position((progress.seconds * 1000.0) as u64);
                bars[index].set_message(text);
            }
            Self::Log { labels, shown } => {
                let recent = shown[index].is_some_and(|last| last.elapsed() < LOG_INTERVAL);
                if progress.done || !recent {
                    shown[index] = Some(Instant::now());
                    eprintln!("{} {:5.1} s {text}", labels[index], progress.seconds);
                }
            }
        }
    }

    /// Leaves the bars as they are.
    pub(super) fn finish(&self) {
        if let Self::Bars(bars) = self {
            bars.iter().for_each(ProgressBar::abandon);
        }
    }
}
