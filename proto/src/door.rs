//! A doorbell: where a server and its clients sleep, and what wakes them up. It is words in shared memory that all of
//! them read.
//!
//! Each session has a *seat*, one bit of a bitmap. A client that has sent a message sets its bit. A worker that looks
//! for work takes all bits at once. So messages that arrived together are answered one after another, without a wake-up
//! for each.
//!
//! | a client that rings | a worker that is about to sleep |
//! |---|---|
//! | 1. sets its bit | 1. says that it wants to be woken up, as which [`Listener`] |
//! | 2. reads whether a worker wants to be woken up | 2. reads the bits, and does not sleep if there are any |
//!
//! All four accesses are sequentially consistent, so no ring is missed. A client that wakes a worker up clears the
//! worker's word. So one worker is woken up, however many clients ring before it looks.
//!
//! Clients sleep here as well. Many that got their replies one after another are woken up together: on a processor that
//! they share, the kernel would else change to each of them and back. Their [bells](crate::bell) say whether a reply is
//! there.
//!
//! Every client of a server can write to all of it. A wrong word costs time and nothing else: a bit says that a message
//! may be there and not that one is. Workers look at every seat several times a second, whatever the words say.

use std::io;
use std::num::NonZeroU32;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

use crate::bell::Bell;
use crate::endpoint::{Endpoint, MAX_CLIENTS};
use crate::mapping::{Mapping, Words};
use crate::sleep::{Woken, wait, wait_as, wake_all, wake_one};

/// How many sessions can be told apart.
pub const SEATS: usize = MAX_CLIENTS;

const LINES: usize = SEATS / 64;

/// Clients that sleep on the same word, each as one bit.
const GROUP: usize = 32;
const GROUPS: usize = SEATS / GROUP;

/// How much a session's next request is expected to ask for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Size {
    /// More than little, or not known yet.
    Large = 0,
    /// So little that it need not wait for those that ask for more.
    Small = 1,
}

impl Size {
    /// The one that this word says; any word may stand in shared memory.
    pub(crate) fn of(word: u32) -> Self {
        if word == Self::Small as u32 { Self::Small } else { Self::Large }
    }

    /// The kinds of worker that may be woken up for a request of this size, in order of preference.
    fn listeners(self) -> &'static [Listener] {
        match self {
            Self::Small => &[Listener::Small, Listener::Any],
            Self::Large => &[Listener::Any],
        }
    }
}

/// A worker that sleeps at the door.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Listener {
    /// One that is there for whatever is asked for.
    Any,
    /// One that is there for what is small, while all others are at work.
    Small,
}

/// The words as they lie in shared memory; zeros at first.
#[derive(Debug)]
#[repr(C, align(64))]
struct DoorWords {
    /// A bit for each seat.
    rung: [AtomicU64; LINES],
    /// For each kind of [`Listener`].
    posts: [Post; 2],
    /// How often the server's control loop went round, modulo 2³².
    pulse: AtomicU32,
    replies: Replies,
}

/// Where listeners of a kind sleep.
#[derive(Debug)]
#[repr(C)]
struct Post {
    /// Not 0 where one wants to be woken up.
    alert: AtomicU32,
    /// How often one was woken up, modulo 2³². They sleep on it.
    wakes: AtomicU32,
}

/// How often clients of each group were woken up, modulo 2³². They sleep on it.
#[derive(Debug)]
#[repr(C, align(64))]
struct Replies([AtomicU32; GROUPS]);

const _: () = assert!(SEATS.is_multiple_of(64) && size_of::<DoorWords>() == 192);

/// Clients that are to be woken up.
#[derive(Debug, Default)]
pub struct Sleepers([u32; GROUPS]);

impl Sleepers {
    /// The one of the session at `seat`, too.
    pub fn add(&mut self, seat: u32) {
        let (group, bit) = place(seat);
        self.0[group] |= bit.get();
    }
}

/// Where the client of the session at `seat` sleeps.
fn place(seat: u32) -> (usize, NonZeroU32) {
    let seat = seat as usize % SEATS;
    let bit = NonZeroU32::new(1 << (seat % GROUP)).expect("there are as many bits");
    (seat / GROUP, bit)
}

#[allow(unsafe_code)]
// SAFETY: atomics that are 0 at first.
unsafe impl Words for DoorWords {}

/// The door of a server. It makes and removes it, its clients open it.
#[derive(Debug)]
pub struct Door(Mapping<DoorWords>);

impl Door {
    /// Makes that of the run `epoch` of the server. It is removed when this is dropped; should the server die
    /// before, with all else under the endpoint's prefix.
    pub fn make(endpoint: &Endpoint, epoch: u64) -> io::Result<Self> {
        Mapping::make(endpoint.door(epoch)).map(Self)
    }

    /// Says that the server moves; its control loop does at least once a second.
    pub fn beat(&self) {
        self.0.pulse.fetch_add(1, Ordering::Relaxed);
    }

    /// How often it said so, modulo 2³².
    pub fn pulse(&self) -> u32 {
        self.0.pulse.load(Ordering::Relaxed)
    }

    /// Opens that of a server.
    pub fn open(endpoint: &Endpoint, epoch: u64) -> io::Result<Self> {
        Mapping::open(&endpoint.door(epoch)).map(Self)
    }

    /// Says that the session at `seat` has sent something, whose size is expected to be `size`. Returns whether
    /// a worker had to be woken up for that.
    pub fn ring(&self, seat: u32, size: Size) -> bool {
        let seat = seat as usize % SEATS;
        self.0.rung[seat / 64].fetch_or(1 << (seat % 64), Ordering::SeqCst);
        size.listeners().iter().any(|listener| {
            let alert = &self.post(*listener).alert;
            let wakes = alert.load(Ordering::SeqCst) != 0 && alert.swap(0, Ordering::SeqCst) != 0;
            if wakes {
                self.wake(*listener);
            }
            wakes
        })
    }

    /// Whether a client has rung since the bits were last taken.
    pub fn is_rung(&self) -> bool {
        self.0.rung.iter().any(|line| line.load(Ordering::SeqCst) != 0)
    }

    /// The seats of the clients that have rung; their bits are cleared.
    pub fn take(&self) -> impl Iterator<Item = u32> {
        self.0.rung.iter().zip(0..).flat_map(|(line, number)| {
            let unread = line.load(Ordering::SeqCst) != 0;
            let mut bits = if unread { line.swap(0, Ordering::SeqCst) } else { 0 };
            std::iter::from_fn(move || {
                let bit = bits.trailing_zeros();
                bits &= bits.wrapping_sub(1);
                (bit < 64).then_some(64 * number + bit)
            })
        })
    }

    /// Whether a listener of this kind wants to be woken up.
    pub fn is_alert(&self, listener: Listener) -> bool {
        self.post(listener).alert.load(Ordering::SeqCst) != 0
    }

    /// Says whether one does. Look whether a client has rung before you sleep.
    pub fn set_alert(&self, listener: Listener, alert: bool) {
        self.post(listener).alert.store(alert.into(), Ordering::SeqCst);
    }

    /// How often one of this kind was woken up.
    pub fn wakes(&self, listener: Listener) -> u32 {
        self.post(listener).wakes.load(Ordering::SeqCst)
    }

    /// Wakes one of this kind up.
    pub fn wake(&self, listener: Listener) {
        let wakes = &self.post(listener).wakes;
        wakes.fetch_add(1, Ordering::SeqCst);
        wake_one(wakes);
    }

    /// Sleeps until woken up, at most for `limit`; not at all where one was woken up more often than `seen`.
    pub fn sleep(&self, listener: Listener, seen: u32, limit: Duration) -> Woken {
        wait(&self.post(listener).wakes, seen, limit)
    }

    fn post(&self, listener: Listener) -> &Post {
        &self.0.posts[listener as usize]
    }

    /// Lets the client of the session at `seat` sleep until its `bell` is rung and it is woken up, at most for
    /// `limit`; not at all where it was rung more often than `seen`.
    pub fn await_reply(&self, seat: u32, bell: &Bell, seen: u32, limit: Duration) -> Woken {
        let (group, bit) = place(seat);
        let word = &self.0.replies.0[group];
        // Before it says that it sleeps: a worker that wakes it up from then on changes this, and it does not fall asleep.
        let before = word.load(Ordering::SeqCst);
        bell.set_asleep(true);
        let rung = bell.count() != seen;
        let woken = if rung { Woken::Rung } else { wait_as(word, before, limit, bit) };
        bell.set_asleep(false);
        woken
    }

    /// Wakes clients up whose replies are there, all at once.
    pub fn rouse(&self, sleepers: &mut Sleepers) {
        for (word, bits) in self.0.replies.0.iter().zip(&mut sleepers.0) {
            if let Some(bits) = NonZeroU32::new(std::mem::take(bits)) {
                word.fetch_add(1, Ordering::SeqCst);
                wake_all(word, bits);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;
    use crate::bell::Bells;
    use crate::endpoint::Membership;

    const LONG: Duration = Duration::from_mins(1);

    fn pair(label: &str) -> (Membership, Door, Door) {
        let name = format!("t-{label}-{}", std::process::id());
        let endpoint = Endpoint::new(&name.parse().unwrap());
        let membership = endpoint.join().unwrap();
        let made = Door::make(&endpoint, 7).unwrap();
        let opened = Door::open(&endpoint, 7).unwrap();
        (membership, made, opened)
    }

    #[test]
    fn each_ring_is_taken_once() {
        let (_membership, server, client) = pair("door-bits");
        assert!(!server.is_rung());
        let last = SEATS as u32 - 1;
        for seat in [last, 0, 63, 64, 63] {
            assert!(!client.ring(seat, Size::Small), "no worker sleeps");
        }
        assert!(server.is_rung());
        assert_eq!(server.take().collect::<Vec<_>>(), [0, 63, 64, last]);
        assert_eq!((server.is_rung(), server.take().next()), (false, None));
        // Whatever a client says, it is a seat.
        client.ring(SEATS as u32 + 5, Size::Large);
        assert_eq!(server.take().collect::<Vec<_>>(), [5]);
    }

    #[test]
    fn a_small_request_wakes_the_small_listener_first_and_any_other_one_that_wants_it() {
        use Listener::{Any, Small};
        let (_membership, server, client) = pair("door-alert");
        for (alert, size, woken) in [
            (vec![], Size::Small, None),
            (vec![Small], Size::Large, None),
            (vec![Small], Size::Small, Some(Small)),
            (vec![Any], Size::Large, Some(Any)),
            (vec![Any], Size::Small, Some(Any)),
            (vec![Any, Small], Size::Small, Some(Small)),
            (vec![Any, Small], Size::Large, Some(Any)),
        ] {
            let seen = [Any, Small].map(|listener| {
                server.set_alert(listener, alert.contains(&listener));
                server.wakes(listener)
            });
            assert_eq!(client.ring(1, size), woken.is_some(), "{alert:?} {size:?}");
            for (listener, seen) in [Any, Small].into_iter().zip(seen) {
                let wakes = woken == Some(listener);
                assert_eq!(server.is_alert(listener), alert.contains(&listener) && !wakes);
                let limit = if wakes { LONG } else { Duration::from_millis(1) };
                let how = if wakes { Woken::Rung } else { Woken::Late };
                assert_eq!(server.sleep(listener, seen, limit), how);
            }
        }
    }

    #[test]
    fn no_ring_is_missed_however_many_are_woken_up_at_once() {
        const ROUNDS: u32 = 10_000;
        // Two of them in one group.
        const PLACES: [u32; 3] = [0, 31, 32];
        let (membership, server, client) = pair("door-rings");
        let endpoint = membership.endpoint();
        let bells = PLACES.map(|seat| {
            let session = u64::from(seat);
            (Bells::make(endpoint, 7, session).unwrap(), Bells::open(endpoint, 7, session).unwrap())
        });
        thread::scope(|scope| {
            for (seat, (_, bells)) in PLACES.iter().zip(&bells) {
                let client = &client;
                scope.spawn(move || {
                    for round in 0..ROUNDS {
                        client.ring(*seat, Size::Small);
                        while bells.reply().count() == round {
                            let woken = client.await_reply(*seat, bells.reply(), round, LONG);
                            assert_ne!(woken, Woken::Late);
                        }
                    }
                });
            }
            let mut left = ROUNDS * PLACES.len() as u32;
            while left > 0 {
                let seen = server.wakes(Listener::Any);
                server.set_alert(Listener::Any, true);
                if !server.is_rung() {
                    assert_ne!(server.sleep(Listener::Any, seen, LONG), Woken::Late);
                }
                let mut sleepers = Sleepers::default();
                for seat in server.take() {
                    left -= 1;
                    let index = PLACES.iter().position(|place| *place == seat).unwrap();
                    if bells[index].0.reply().ring() {
                        sleepers.add(seat);
                    }
                }
                server.rouse(&mut sleepers);
            }
        });
    }

    #[test]
    fn a_client_sleeps_in_vain_until_its_time_is_over_and_not_at_all_where_a_reply_is_there() {
        let (membership, _server, client) = pair("door-waits");
        let bells = Bells::make(membership.endpoint(), 7, 1).unwrap();
        let bell = bells.reply();
        assert_eq!(client.await_reply(3, bell, 0, Duration::from_millis(1)), Woken::Late);
        assert!(!bell.ring(), "the client is awake");
        assert_eq!(client.await_reply(3, bell, 0, LONG), Woken::Rung);
    }

    #[test]
    fn it_is_removed_by_its_maker() {
        let (membership, made, opened) = pair("door-file");
        let path = membership.endpoint().door(7);
        drop(opened);
        assert!(membership.endpoint().all_bells().unwrap().contains(&path));
        drop(made);
        assert!(!path.exists());
    }
}
