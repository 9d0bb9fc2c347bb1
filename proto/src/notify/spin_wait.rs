//! Waiting awake, where that pays.

use std::time::{Duration, Instant};

/// Waiting awake for the other side's next message: the core is offered to others between looks.
/// That saves a wake-up, which costs more than a small step, and the system calls at the bell. Where
/// the message comes late, because it takes long or because others kept the core that was offered,
/// the next waits are slept through, the more of them the more often that happens.
#[derive(Debug)]
pub struct SpinWait {
    start: Instant,
    /// How long it lasts.
    longest: Duration,
    /// Waits that are still to be slept through.
    asleep: u32,
    /// How many it was after the last late message, less one for each that came soon.
    penalty: u32,
}

impl SpinWait {
    /// How long it lasts where the other side is awake.
    const LONGEST: Duration = Duration::from_micros(50);

    /// How much longer where it had to be woken up, which takes that long where its processor slept. Without that,
    /// each side finds the other one asleep whenever it tries to be awake, and both go on sleeping.
    const WAKING: Duration = Duration::from_micros(100);

    /// What a wake-up that is saved is worth: a message that is as late as that costs one of the next waits. Others keep
    /// a core for milliseconds.
    const WORTH: Duration = Duration::from_micros(8);
    /// Most waits that are slept through.
    const MOST: u32 = 8192;

    /// One that has to find out whether it pays.
    pub fn new() -> Self {
        Self { start: Instant::now(), longest: Self::LONGEST, asleep: 0, penalty: 0 }
    }

    /// The wait for the other side's message begins; `slept` says whether that side had to be woken
    /// up.
    pub fn begin(&mut self, slept: bool) {
        self.start = Instant::now();
        self.longest = if slept { Self::LONGEST + Self::WAKING } else { Self::LONGEST };
    }

    /// The message is there.
    pub fn end(&mut self) {
        let waited = self.start.elapsed();
        if self.asleep > 0 {
            self.asleep -= 1;
        } else if waited < self.longest {
            self.penalty = self.penalty.saturating_sub(1);
        } else {
            let cost = (waited.as_nanos() / Self::WORTH.as_nanos()) as u32;
            self.penalty = self.penalty.saturating_mul(2).saturating_add(cost).min(Self::MOST);
            self.asleep = self.penalty;
        }
    }

    /// Offers the core to others and returns true; false where it is time to sleep.
    pub fn spin(&self) -> bool {
        let spins = self.asleep == 0 && self.start.elapsed() < self.longest;
        if spins {
            std::thread::yield_now();
        }
        spins
    }
}

impl Default for SpinWait {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wait that began so long ago.
    fn waiting(spin_wait: &mut SpinWait, slept: bool, ago: Duration) {
        spin_wait.begin(slept);
        spin_wait.start = Instant::now().checked_sub(ago).unwrap();
    }

    #[test]
    fn a_late_message_costs_the_next_waits_and_not_if_its_sender_had_to_be_woken_up() {
        let late = SpinWait::LONGEST + SpinWait::WAKING / 2;
        let cost = late.as_micros() / SpinWait::WORTH.as_micros();
        let mut spin_wait = SpinWait::new();
        // A pause of this thread may be longer than what is left, but not each time.
        let kept = (0..1000).any(|_| {
            waiting(&mut spin_wait, true, late);
            spin_wait.spin()
        });
        assert!(kept);
        waiting(&mut spin_wait, false, late);
        assert!(!spin_wait.spin());
        spin_wait.end();
        for _ in 0..cost {
            spin_wait.begin(true);
            assert!(!spin_wait.spin(), "it sleeps");
            spin_wait.end();
        }
        let kept = (0..SpinWait::MOST).any(|_| {
            spin_wait.begin(true);
            let kept = spin_wait.spin();
            spin_wait.end();
            kept
        });
        assert!(kept);
    }
}
