//! Which session is next: the queue for the threads that step environments.
//!
//! The entry whose entity has consumed the least CPU time is next, and idle time saves nothing up (start-time fair
//! queueing, Goyal et al. 1996). So sessions share the threads evenly, whatever their size.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::thread::Thread;

use super::SlotId;

/// The permits to compute, one for each thread, and the entries that wait for one.
#[derive(Debug)]
pub(super) struct RunQueue {
    /// Permits that no entity has.
    pub(super) free: usize,
    /// The next one comes last.
    waiting: Vec<Entry>,
    /// How many entries there have been.
    arrivals: u64,
    /// `vruntime` of the entity that last got a permit, before it did, ns.
    clock: u64,
}

/// A session, or what else shares the threads.
#[derive(Debug)]
pub(in crate::service) struct Entity {
    quota: Arc<ThreadQuota>,
    /// CPU time that it has consumed, on the clock of [`RunQueue`], ns.
    pub(super) vruntime: AtomicU64,
}

/// How many permits the sessions of a client may have together, and have. It changes under the lock of
/// [`RunQueue`].
#[derive(Debug)]
pub(in crate::service) struct ThreadQuota {
    limit: usize,
    used: AtomicUsize,
}

/// An entity that waits for a permit.
#[derive(Debug)]
struct Entry {
    /// `vruntime`, and how many entries there were before it. The entry with the least of both is next.
    rank: (u64, u64),
    entity: Arc<Entity>,
    runnable: Runnable,
}

/// What goes on with a permit.
#[derive(Debug)]
pub(super) enum Runnable {
    /// The session of this slot, which a worker has to poll.
    Slot(SlotId),
    /// A worker in the middle of a message.
    Worker(Arc<Parked>),
}

/// A worker that waits for a permit.
#[derive(Debug)]
pub(super) struct Parked {
    thread: Thread,
    permitted: AtomicBool,
}

impl Entity {
    /// An entity that has consumed nothing.
    pub(in crate::service) fn new(quota: &Arc<ThreadQuota>) -> Arc<Self> {
        Arc::new(Self { quota: Arc::clone(quota), vruntime: AtomicU64::new(0) })
    }
}

impl ThreadQuota {
    pub(in crate::service) fn new(limit: usize) -> Arc<Self> {
        Arc::new(Self { limit, used: AtomicUsize::new(0) })
    }

    fn left(&self) -> usize {
        self.limit.saturating_sub(self.used.load(Ordering::Relaxed))
    }
}

impl Parked {
    /// The thread that calls.
    pub(super) fn here() -> Arc<Self> {
        Arc::new(Self { thread: std::thread::current(), permitted: AtomicBool::new(false) })
    }

    /// It has a permit and goes on.
    pub(super) fn unpark(&self) {
        self.permitted.store(true, Ordering::Release);
        self.thread.unpark();
    }

    /// Sleeps until it has a permit. Only on its own thread.
    pub(super) fn park(&self) {
        while !self.permitted.swap(false, Ordering::Acquire) {
            std::thread::park();
        }
    }
}

impl RunQueue {
    /// A queue for this many threads.
    pub(super) fn new(threads: usize) -> Self {
        Self { free: threads, waiting: vec![], arrivals: 0, clock: 0 }
    }

    /// Has an entity wait for a permit.
    pub(super) fn push(&mut self, entity: &Arc<Entity>, runnable: Runnable) {
        let vruntime = entity.vruntime.fetch_max(self.clock, Ordering::Relaxed).max(self.clock);
        let rank = (vruntime, self.arrivals);
        self.arrivals += 1;
        let place = self.waiting.partition_point(|other| other.rank > rank);
        self.waiting.insert(place, Entry { rank, entity: Arc::clone(entity), runnable });
    }

    /// What goes on next, if there is a permit for it.
    pub(super) fn peek(&self) -> Option<&Runnable> {
        let next = self.next().filter(|_| self.free > 0)?;
        Some(&self.waiting[next].runnable)
    }

    /// Takes what is next out of the queue, with a permit.
    pub(super) fn pop(&mut self) -> Option<Runnable> {
        let next = self.next().filter(|_| self.free > 0)?;
        let Entry { entity, runnable, .. } = self.waiting.remove(next);
        self.give(&entity, 1);
        Some(runnable)
    }

    /// Up to `most` permits more for `entity`, of those that nothing else waits for.
    pub(super) fn take_more(&mut self, entity: &Entity, most: usize) -> usize {
        let claimed = self.waiting.iter().filter(|entry| entry.may_run()).count();
        let permits = self.free.saturating_sub(claimed).min(most).min(entity.quota.left());
        self.give(entity, permits);
        permits
    }

    /// Takes back permits of `entity`.
    pub(super) fn give_back(&mut self, entity: &Entity, permits: usize) {
        entity.quota.used.fetch_sub(permits, Ordering::Relaxed);
        self.free += permits;
    }

    /// Whether `entity`, whose quantum is over, keeps its permit: nothing waits that could have it, and no permit is
    /// free with which another thread could help.
    pub(super) fn renew(&mut self, entity: &Entity) -> bool {
        let renewed = self.next().is_none() && self.free.min(entity.quota.left()) == 0;
        if renewed {
            self.clock = self.clock.max(entity.vruntime.load(Ordering::Relaxed));
        }
        renewed
    }

    fn next(&self) -> Option<usize> {
        self.waiting.iter().rposition(Entry::may_run)
    }

    fn give(&mut self, entity: &Entity, permits: usize) {
        let vruntime = entity.vruntime.fetch_max(self.clock, Ordering::Relaxed);
        self.clock = self.clock.max(vruntime);
        entity.quota.used.fetch_add(permits, Ordering::Relaxed);
        self.free -= permits;
    }
}

impl Entry {
    /// Whether its client may have one permit more.
    fn may_run(&self) -> bool {
        self.entity.quota.left() > 0
    }
}

#[cfg(test)]
impl RunQueue {
    pub(super) fn waiting(&self) -> usize {
        self.waiting.len()
    }
}
