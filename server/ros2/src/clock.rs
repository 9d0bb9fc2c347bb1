//! A world's time in that of the system's clock.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// For how long the least delay is remembered, twice that at most.
const SPAN: Duration = Duration::from_secs(1);

/// Tells when something was, of whose time in the world an arm has told.
///
/// A tick is seen some time after it has passed. The least delay of the latest seconds says how the two clocks are
/// apart. So the clocks may drift, and the world may be late for a while.
#[derive(Debug)]
pub(crate) struct WorldClock {
    speed: f64,
    /// Least difference between both clocks, ns: in this span and in the one before.
    least: [i64; 2],
    since: Instant,
    late: u32,
}

impl WorldClock {
    /// The clock of a world so many times as fast as life.
    pub(crate) fn new(speed: f64) -> Self {
        Self { speed, least: [i64::MAX; 2], since: Instant::now(), late: 0 }
    }

    /// Takes note that the world's time is `stamp`, ns, and that it has left out so many ticks.
    pub(crate) fn see(&mut self, stamp: u64, late: u32) {
        self.see_at(stamp, late, now(), Instant::now());
    }

    fn see_at(&mut self, stamp: u64, late: u32, system: i64, now: Instant) {
        if late != self.late {
            (self.late, self.least, self.since) = (late, [i64::MAX; 2], now);
        } else if now - self.since > SPAN {
            (self.least, self.since) = ([i64::MAX, self.least[0]], now);
        }
        self.least[0] = self.least[0].min(system - self.scaled(stamp));
    }

    /// The system's time when the world's was `stamp`, ns since 1970.
    pub(crate) fn system(&self, stamp: u64) -> i64 {
        self.least[0].min(self.least[1]).saturating_add(self.scaled(stamp))
    }

    fn scaled(&self, stamp: u64) -> i64 {
        (stamp as f64 / self.speed) as i64
    }
}

/// The system's time, ns since 1970.
pub(crate) fn now() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_do_not_shift_stamps_and_lateness_does() {
        let mut clock = WorldClock::new(2.0);
        let at = Instant::now();
        // The world began at 1000 ns; a look comes 30 ns late, the next 5 ns.
        clock.see_at(100, 0, 1080, at);
        assert_eq!(clock.system(100), 1080);
        clock.see_at(200, 0, 1105, at);
        assert_eq!((clock.system(100), clock.system(200)), (1055, 1105));
        // What is slow for long is so: the delays before are forgotten.
        clock.see_at(300, 0, 1200, at + 2 * SPAN);
        assert_eq!(clock.system(300), 1155);
        clock.see_at(400, 0, 1250, at + 4 * SPAN);
        assert_eq!(clock.system(400), 1250);
        // Time that the world leaves out is not made up for.
        clock.see_at(500, 3, 9000, at + 4 * SPAN);
        assert_eq!(clock.system(500), 9000);
    }
}
