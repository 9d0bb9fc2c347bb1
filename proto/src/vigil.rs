//! Waiting awake, where that pays.

use std::time::{Duration, Instant};

/// Waiting awake for the other side's next message: the core is offered to others between looks.
/// That saves a wake-up, which costs more than a small step, and the system calls at the bell. Where
/// the message comes late, because it takes long or because others kept the core that was offered,
/// the next waits are slept through, the more of them the more often that happens.
#[derive(Debug)]
pub struct Vigil {
    start: Instant,
    /// Waits that are still to be slept through.
    asleep: u32,
    /// How many it was after the last late message, less one for each that came soon.
    penalty: u32,
}

impl Vigil {
    /// How long it lasts.
    const LONGEST: Duration = Duration::from_micros(50);

    /// Waits that one late message costs: others keep a core for milliseconds, and a wake-up that is
    /// saved is worth some ten microseconds.
    const LEAST: u32 = 512;
    const MOST: u32 = 8192;

    /// One that has to find out whether it pays.
    pub fn new() -> Self {
        Self { start: Instant::now(), asleep: 0, penalty: 0 }
    }

    /// The wait for a message begins.
    pub fn begin(&mut self) {
        self.start = Instant::now();
    }

    /// The message is there.
    pub fn end(&mut self) {
        if self.asleep > 0 {
            self.asleep -= 1;
        } else if self.start.elapsed() < Self::LONGEST {
            self.penalty = self.penalty.saturating_sub(1);
        } else {
            self.penalty = (2 * self.penalty + Self::LEAST).min(Self::MOST);
            self.asleep = self.penalty;
        }
    }

    /// Offers the core to others and returns true; false where it is time to sleep.
    pub fn keep(&self) -> bool {
        let keep = self.asleep == 0 && self.start.elapsed() < Self::LONGEST;
        if keep {
            std::thread::yield_now();
        }
        keep
    }
}

impl Default for Vigil {
    fn default() -> Self {
        Self::new()
    }
}
