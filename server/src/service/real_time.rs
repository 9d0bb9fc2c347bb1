//! The pace of a live world whose time passes by itself.

use std::time::{Duration, Instant};

use trocar_proto::dvrk::TICKS_PER_SECOND;

/// Furthest that a paced world may be behind before it leaves time out.
const LATEST: Duration = Duration::from_millis(100);

/// The pace of a world.
pub(super) struct RealTime {
    ticks_per_second: f64,
    /// When the world had passed `ticks`.
    since: Instant,
    ticks: u64,
    /// Ticks that were left out.
    late: u64,
}

impl RealTime {
    /// That of a world so many times as fast as life, which begins now.
    pub(super) fn new(speed: f64) -> Self {
        let ticks_per_second = TICKS_PER_SECOND as f64 * speed;
        Self { ticks_per_second, since: Instant::now(), ticks: 0, late: 0 }
    }

    /// Ticks that were left out.
    pub(super) fn late(&self) -> u64 {
        self.late
    }

    /// Ticks that are due at `now` in a world that has passed `ticks`.
    pub(super) fn due(&mut self, ticks: u64, now: Instant) -> u64 {
        let elapsed = now.saturating_duration_since(self.since);
        let passed = self.ticks + (elapsed.as_secs_f64() * self.ticks_per_second) as u64;
        let due = passed.saturating_sub(ticks);
        let most = (LATEST.as_secs_f64() * self.ticks_per_second).ceil() as u64;
        if due <= most {
            return due;
        }
        self.late += due - most;
        (self.since, self.ticks) = (now, ticks + most);
        most
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_world_that_is_late_leaves_time_out_and_never_hurries() {
        let since = Instant::now();
        let mut time = RealTime { ticks_per_second: 240.0, since, ticks: 5, late: 0 };
        let after = |seconds| since + Duration::from_secs_f64(seconds);
        assert_eq!(time.due(5, after(0.05)), 12);
        // Of 2400 ticks, a tenth of a second is due.
        assert_eq!((time.due(17, after(10.05)), time.late), (24, 2376));
        // Once these have passed, it goes on from there.
        assert_eq!((time.due(41, after(10.1)), time.late), (12, 2376));
    }
}
