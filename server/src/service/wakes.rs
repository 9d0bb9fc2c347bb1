//! Clients that got their replies and sleep: they are woken up several at a time.
//!
//! A client that is woken up on its worker's processor runs at once. One by one, 64 clients on one core cost two
//! changes of threads for each message, and each time other things are in the caches. So small messages that wait are
//! answered first, for a while, and then all of these clients go on.

use std::time::{Duration, Instant};

use trocar_proto::door::{Door, Sleepers};

/// How long a client may have its reply and not know it, because others get theirs.
const LONGEST: Duration = Duration::from_micros(200);

/// The clients that are to be woken up.
#[derive(Debug, Default)]
pub(super) struct Wakes {
    sleepers: Sleepers,
    /// Since when there are some.
    since: Option<Instant>,
}

impl Wakes {
    /// The client of the session at `seat`, too.
    pub(super) fn add(&mut self, seat: u32) {
        self.sleepers.add(seat);
        self.since.get_or_insert_with(Instant::now);
    }

    /// Whether something that takes `cost` may be done before they are woken up.
    pub(super) fn may_wait_for(&self, cost: Duration) -> bool {
        self.since.is_none_or(|since| since.elapsed() + cost <= LONGEST)
    }

    /// Wakes them up.
    pub(super) fn rouse(&mut self, door: &Door) {
        if self.since.take().is_some() {
            door.rouse(&mut self.sleepers);
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.since.is_none()
    }
}
