//! A doorbell: clients ring it when they have sent something, and workers of the server sleep at it.
//!
//! Each session has a *slot*, one bit of a bitmap. A client that has sent a message sets its bit. A worker that looks
//! for work takes all bits at once. So messages that arrived together are answered one after another, without a wake-up
//! for each.
//!
//! The server *advertises* while it wants to be woken up. The client that wakes a worker up takes the advertisement
//! away. So one worker is woken up, however many clients ring before it looks. Workers look at every slot several times
//! a second, whatever the words say.

use std::io;
use std::ops::Deref;
use std::sync::atomic::Ordering;
use std::time::Duration;

use super::futex::WaitOutcome;
use super::platform::{FlagWord, FutexWord, Linux, Platform};
use super::shm::{SharedLayout, Shm};
use crate::endpoint::{Endpoint, MAX_CLIENTS};

/// How many sessions can be told apart.
pub const SLOTS: usize = MAX_CLIENTS;

const LINES: usize = SLOTS / 64;

/// The words of a doorbell with `LINES` × 64 slots; zeros at first.
#[derive(Debug)]
#[repr(C, align(64))]
pub struct Words<P: Platform, const LINES: usize> {
    /// A bit for each slot.
    rung: [P::Flags; LINES],
    /// Not 0 where a worker wants to be woken up.
    wanted: P::Futex,
    /// How often one was woken up, modulo 2³². They sleep on it.
    wakes: P::Futex,
    /// How often the server's control loop went round, modulo 2³².
    heartbeat: P::Futex,
}

impl<P: Platform, const LINES: usize> Default for Words<P, LINES> {
    fn default() -> Self {
        let [wanted, wakes, heartbeat] = std::array::from_fn(|_| P::Futex::default());
        Self { rung: std::array::from_fn(|_| P::Flags::default()), wanted, wakes, heartbeat }
    }
}

impl<P: Platform, const LINES: usize> Words<P, LINES> {
    /// Says that the session at `slot` has sent something; any number stands for a slot. Returns whether a worker had
    /// to be woken up.
    pub fn ring(&self, slot: u32) -> bool {
        let slot = slot as usize % (64 * LINES);
        self.rung[slot / 64].raise(1 << (slot % 64), Ordering::Release);
        self.kick()
    }

    /// Wakes a worker up if the server advertises that it wants that. Returns whether it did.
    pub fn kick(&self) -> bool {
        P::fence();
        let wakes =
            self.wanted.load(Ordering::Relaxed) != 0 && self.wanted.swap(0, Ordering::Relaxed) != 0;
        if wakes {
            self.wakes.increment(Ordering::Release);
            self.wakes.wake(1);
        }
        wakes
    }

    /// Wakes all workers up that sleep.
    pub fn wake_all(&self) {
        self.wakes.increment(Ordering::Release);
        self.wakes.wake(i32::MAX as u32);
    }

    /// Says whether a worker wants to be woken up. After it does, look whether a client [has rung](Self::is_rung).
    pub fn advertise(&self, wanted: bool) {
        self.wanted.store(wanted.into(), Ordering::Relaxed);
        P::fence();
    }

    /// Whether the server still advertises.
    pub fn is_advertised(&self) -> bool {
        self.wanted.load(Ordering::Relaxed) != 0
    }

    /// Whether a client has rung since the bits were last taken.
    pub fn is_rung(&self) -> bool {
        self.rung.iter().any(|line| line.load(Ordering::Relaxed) != 0)
    }

    /// The slots of the clients that have rung; their bits are cleared.
    pub fn take(&self) -> impl Iterator<Item = u32> {
        self.rung.iter().zip(0..).flat_map(|(line, number)| {
            let unread = line.load(Ordering::Relaxed) != 0;
            let mut bits = if unread { line.take(Ordering::Acquire) } else { 0 };
            std::iter::from_fn(move || {
                let bit = bits.trailing_zeros();
                bits &= bits.wrapping_sub(1);
                (bit < 64).then_some(64 * number + bit)
            })
        })
    }

    /// How often a worker was woken up. Ask before you advertise.
    pub fn wakes(&self) -> u32 {
        self.wakes.load(Ordering::Acquire)
    }

    /// Sleeps until woken up, at most for `limit`; not at all where a worker was woken up more often than `seen`.
    pub fn sleep(&self, seen: u32, limit: Duration) -> WaitOutcome {
        self.wakes.wait(seen, limit)
    }

    /// Says that the server goes on; its control loop does at least once a second.
    pub fn beat(&self) {
        self.heartbeat.increment(Ordering::Relaxed);
    }

    /// How often it said so, modulo 2³².
    pub fn heartbeat(&self) -> u32 {
        self.heartbeat.load(Ordering::Relaxed)
    }
}

const _: () = assert!(SLOTS.is_multiple_of(64) && size_of::<Words<Linux, LINES>>() == 128);

#[allow(unsafe_code)]
// SAFETY: atomics that are 0 at first.
unsafe impl SharedLayout for Words<Linux, LINES> {}

/// The doorbell of a server. The server makes and removes it, its clients open it.
#[derive(Debug)]
pub struct Doorbell(Shm<Words<Linux, LINES>>);

impl Doorbell {
    /// Makes that of the run `epoch` of the server. It is removed when this is dropped; should the server die
    /// before, with all else under the endpoint's prefix.
    pub fn make(endpoint: &Endpoint, epoch: u64) -> io::Result<Self> {
        Shm::make(endpoint.doorbell(epoch)).map(Self)
    }

    /// Opens that of a server.
    pub fn open(endpoint: &Endpoint, epoch: u64) -> io::Result<Self> {
        Shm::open(&endpoint.doorbell(epoch)).map(Self)
    }
}

impl Deref for Doorbell {
    type Target = Words<Linux, LINES>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;
    use crate::endpoint::Membership;

    const LONG: Duration = Duration::from_mins(1);

    fn pair(label: &str) -> (Membership, Doorbell, Doorbell) {
        let name = format!("t-{label}-{}", std::process::id());
        let endpoint = Endpoint::new(&name.parse().unwrap());
        let membership = endpoint.join().unwrap();
        let made = Doorbell::make(&endpoint, 7).unwrap();
        let opened = Doorbell::open(&endpoint, 7).unwrap();
        (membership, made, opened)
    }

    #[test]
    fn each_ring_is_taken_once() {
        let (_membership, server, client) = pair("doorbell-bits");
        assert!(!server.is_rung());
        let last = SLOTS as u32 - 1;
        for slot in [last, 0, 63, 64, 63] {
            assert!(!client.ring(slot), "no worker sleeps");
        }
        assert!(server.is_rung());
        assert_eq!(server.take().collect::<Vec<_>>(), [0, 63, 64, last]);
        assert_eq!((server.is_rung(), server.take().next()), (false, None));
        // Whatever a client says, it is a slot.
        client.ring(SLOTS as u32 + 5);
        assert_eq!(server.take().collect::<Vec<_>>(), [5]);
    }

    #[test]
    fn one_worker_is_woken_up_while_the_server_advertises() {
        let (_membership, server, client) = pair("doorbell-wanted");
        let seen = server.wakes();
        server.advertise(true);
        assert!(client.ring(1) && !client.ring(2), "one is on its way");
        assert!(!server.is_advertised());
        assert_eq!(server.sleep(seen, LONG), WaitOutcome::Woken);
        let seen = server.wakes();
        assert_eq!(server.sleep(seen, Duration::from_millis(1)), WaitOutcome::TimedOut);
        server.wake_all();
        assert_eq!(server.sleep(seen, LONG), WaitOutcome::Woken);
    }

    #[test]
    fn no_ring_is_missed() {
        const ROUNDS: u32 = 10_000;
        const PLACES: [u32; 3] = [0, 31, 32];
        let (_membership, server, client) = pair("doorbell-rings");
        let replies = PLACES.map(|_| std::sync::atomic::AtomicU32::new(0));
        thread::scope(|scope| {
            for (slot, replies) in PLACES.iter().zip(&replies) {
                let client = &client;
                scope.spawn(move || {
                    for round in 0..ROUNDS {
                        client.ring(*slot);
                        while replies.load(Ordering::Acquire) == round {
                            thread::yield_now();
                        }
                    }
                });
            }
            let mut left = ROUNDS * PLACES.len() as u32;
            while left > 0 {
                let seen = server.wakes();
                server.advertise(true);
                if !server.is_rung() {
                    assert_ne!(server.sleep(seen, LONG), WaitOutcome::TimedOut);
                }
                for slot in server.take() {
                    left -= 1;
                    let index = PLACES.iter().position(|place| *place == slot).unwrap();
                    replies[index].fetch_add(1, Ordering::Release);
                }
            }
        });
    }

    #[test]
    fn it_is_removed_by_its_maker() {
        let (membership, made, opened) = pair("doorbell-file");
        let path = membership.endpoint().doorbell(7);
        drop(opened);
        assert!(membership.endpoint().notify_files().unwrap().contains(&path));
        drop(made);
        assert!(!path.exists());
    }
}
