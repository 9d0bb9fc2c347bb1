//! How regularly states are published (`period_statistics`), once a second.

use ros2_client::Publisher;

use crate::bus::publish;
use crate::messages::{Header, IntervalStatistics, Stamp};

/// Time between two messages, s.
const INTERVAL: f64 = 1.0;

/// Sums of periods since the latest message.
pub(crate) struct Statistics {
    to: Publisher<IntervalStatistics>,
    latest: Option<i64>,
    periods: Vec<f64>,
}

impl Statistics {
    pub(crate) fn new(to: Publisher<IntervalStatistics>) -> Self {
        Self { to, latest: None, periods: vec![] }
    }

    /// Counts a publication at `stamp`, ns since 1970.
    pub(crate) fn count(&mut self, stamp: i64) {
        if let Some(latest) = self.latest.replace(stamp) {
            self.periods.push((stamp - latest) as f64 * 1e-9);
        }
        let interval: f64 = self.periods.iter().sum();
        if interval >= INTERVAL {
            publish(&self.to, summary(&std::mem::take(&mut self.periods), Stamp::of(stamp)));
        }
    }
}

/// Computing takes no time that was measured.
fn summary(periods: &[f64], stamp: Stamp) -> IntervalStatistics {
    let (count, interval) = (periods.len() as f64, periods.iter().sum::<f64>());
    let mean = interval / count;
    let variance = periods.iter().map(|period| (period - mean).powi(2)).sum::<f64>() / count;
    IntervalStatistics {
        header: Header::new(stamp, ""),
        period_avg: mean,
        period_std_dev: variance.sqrt(),
        period_min: periods.iter().copied().fold(f64::INFINITY, f64::min),
        period_max: periods.iter().copied().fold(0.0, f64::max),
        number_of_samples: periods.len() as i64,
        statistics_interval: interval,
        ..IntervalStatistics::default()
    }
}
