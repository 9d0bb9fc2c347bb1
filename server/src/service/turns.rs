//! Who is next: those who wait for a turn, and guests whose messages others look for.

use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::Thread;

use super::scheduler::Scheduler;

/// Somebody whose work comes by messages and is little, so that others do it along with theirs.
///
/// Either somebody looks for it, or it is armed: then a message wakes its own thread up.
pub(crate) trait Guest: Send + Sync {
    /// Its share of the threads, and its time.
    fn scheduler(&self) -> &Scheduler;
    /// A message lies there that nobody has taken up.
    fn is_due(&self) -> bool;
    /// Takes it up; false where somebody else has. Then comes [`Self::serve`], on the same thread.
    fn claim(&self) -> bool;
    /// Does what the message asks for.
    fn serve(&self);
    /// From now on a message wakes its thread up.
    fn arm(&self);
    /// From now on somebody looks for messages.
    fn disarm(&self);
    /// Wakes its thread up.
    fn wake(&self);
}

thread_local! {
    /// What this thread promises to others.
    pub(super) static PROMISE: Cell<Promise> = const { Cell::new(Promise::None) };
}

/// What a thread does before it sleeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Promise {
    /// It does not look for the work of guests.
    None,
    /// It will, when it has done what it is doing.
    Later,
    /// It will, and soon. It counts among [`Turns::watchers`].
    Soon,
}

/// The threads that are free, and who has a claim to them.
pub(super) struct Turns {
    pub(super) free: usize,
    /// Somebody has gone ahead.
    pub(super) ahead: bool,
    /// In order of arrival.
    pub(super) waiting: Vec<Waiting>,
    /// What the one who had the latest turn had spent before it, ns.
    pub(super) clock: u64,
    /// Those who are not armed.
    pub(super) guests: Vec<Arc<dyn Guest>>,
    /// Threads that will soon look for their messages.
    pub(super) watchers: usize,
    /// Threads that do pieces of work which take long.
    pub(super) slow: usize,
}

impl Turns {
    /// Whose turn is next: who had the threads for the least time, of those who may have one more.
    pub(super) fn next(&self) -> Option<usize> {
        let waiting = self.waiting.iter().enumerate();
        let may_run = waiting.filter(|(_, each)| each.share.left() > 0);
        may_run.min_by_key(|(_, each)| each.spent).map(|(next, _)| next)
    }

    /// Whether somebody will soon look for messages: a watcher, or whoever is the next to end its turn.
    pub(super) fn are_watched(&self) -> bool {
        self.watchers > 0 || (self.free == 0 && self.slow == 0)
    }

    /// Notes what this thread promises.
    pub(super) fn promise(&mut self, new: Promise) {
        let old = PROMISE.replace(new);
        self.watchers -= usize::from(old == Promise::Soon);
        self.watchers += usize::from(new == Promise::Soon);
    }

    /// Leaves guests to their own threads where nobody will soon look for their messages.
    pub(super) fn settle(&mut self) {
        if !self.are_watched() {
            self.dismiss();
        }
    }

    /// Leaves all guests to their own threads.
    pub(super) fn dismiss(&mut self) {
        for guest in self.guests.drain(..) {
            guest.arm();
            if guest.is_due() {
                guest.wake();
            }
        }
    }

    /// Takes up the work of the guest that is next, of those that had less time than `limit`, where
    /// there is a thread for it.
    pub(super) fn take_up(&mut self, limit: u64) -> Option<Arc<dyn Guest>> {
        if self.free == 0 {
            return None;
        }
        let spent = |guest: &Arc<dyn Guest>| guest.scheduler().spent().max(self.clock);
        let may_run = |guest: &&Arc<dyn Guest>| guest.is_due() && guest.scheduler().may_have_more();
        let next = self.guests.iter().filter(may_run).min_by_key(|guest| spent(guest))?;
        (spent(next) <= limit && next.claim()).then(|| Arc::clone(next))
    }

    pub(super) fn enlist(&mut self, guest: &Arc<dyn Guest>) {
        guest.disarm();
        if !self.has(guest) {
            self.guests.push(Arc::clone(guest));
        }
    }

    pub(super) fn has(&self, guest: &Arc<dyn Guest>) -> bool {
        self.guests.iter().any(|other| Arc::ptr_eq(other, guest))
    }

    /// Lets one of those who wait have a thread.
    pub(super) fn call(&mut self, next: usize) -> Arc<Waiter> {
        let Waiting { waiter, share, spent } = self.waiting.remove(next);
        self.clock = self.clock.max(spent);
        share.taken.fetch_add(1, Ordering::Relaxed);
        waiter
    }
}

/// How many threads somebody may have, and has. Read and written under the lock of [`Turns`].
#[derive(Debug)]
pub(super) struct Share {
    pub(super) limit: usize,
    pub(super) taken: AtomicUsize,
}

impl Share {
    pub(super) fn new(limit: usize) -> Arc<Self> {
        Arc::new(Self { limit, taken: AtomicUsize::new(0) })
    }

    pub(super) fn left(&self) -> usize {
        self.limit.saturating_sub(self.taken.load(Ordering::Relaxed))
    }
}

/// Somebody who waits for a turn.
#[derive(Debug)]
pub(super) struct Waiting {
    pub(super) waiter: Arc<Waiter>,
    pub(super) share: Arc<Share>,
    pub(super) spent: u64,
}

#[derive(Debug)]
pub(super) struct Waiter {
    pub(super) thread: Thread,
    pub(super) called: AtomicBool,
}

thread_local! {
    /// This thread, which waits for one turn at a time.
    pub(super) static WAITER: Arc<Waiter> =
        Arc::new(Waiter { thread: std::thread::current(), called: AtomicBool::new(false) });
}
