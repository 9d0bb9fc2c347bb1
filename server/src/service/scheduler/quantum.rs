//! Quanta: how long a session's environments run on which threads.
//!
//! A message's work runs chunk by chunk for about two milliseconds. Then the worker queues for another permit, if
//! another session waits. A message that finds free permits runs on more threads. None of this changes any result.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use super::Scheduler;
use super::run_queue::{Entity, Parked, Runnable};
use super::work_queue::{Splittable, WorkQueue};
use crate::clock::thread_time;

/// How long a session may keep a permit while others wait, and one chunk more. With half of it, 64 clients of
/// 16 NeedlePick environments on one core had 0.92 of the rate (seven alternating pairs), with twice as
/// much 0.97 (five).
const QUANTUM: Duration = Duration::from_millis(2);

/// Work that is taken up at once.
const CHUNK: Duration = Duration::from_micros(200);

/// Work that is worth another thread: waking one up costs about half of it.
pub(super) const WORTH: Duration = Duration::from_micros(50);

/// A permit to compute that a worker has for a session, while it answers a message.
pub(crate) struct Quantum<'a> {
    scheduler: &'a Arc<Scheduler>,
    entity: &'a Arc<Entity>,
    parked: &'a Arc<Parked>,
    /// False after the permit was given to others, with nothing left to compute.
    permitted: bool,
    stopwatch: Stopwatch,
    /// CPU time until `stopwatch` began, of this thread.
    computed: Duration,
    /// CPU time of other threads, ns.
    helped: AtomicU64,
}

impl<'a> Quantum<'a> {
    /// One with a permit, or without: then it queues for the first work.
    pub(super) fn begin(
        scheduler: &'a Arc<Scheduler>,
        entity: &'a Arc<Entity>,
        parked: &'a Arc<Parked>,
        permitted: bool,
    ) -> Self {
        let (computed, helped) = (Duration::ZERO, AtomicU64::new(0));
        let stopwatch = Stopwatch::start();
        Self { scheduler, entity, parked, permitted, stopwatch, computed, helped }
    }

    /// Whether it has a permit that is still to be given back, and the CPU time that the message took.
    pub(super) fn end(mut self) -> (bool, Duration) {
        self.charge();
        let helped = Duration::from_nanos(self.helped.load(Ordering::Relaxed));
        (self.permitted, self.computed + helped)
    }

    /// Whether there are several threads.
    pub(crate) fn is_parallel(&self) -> bool {
        self.scheduler.is_parallel()
    }

    /// Does `work`, quantum by quantum. `cost` is the time that one piece is expected to take.
    pub(crate) fn run<W: Splittable>(&mut self, work: W, cost: Duration) {
        let each = cost.as_nanos().max(1);
        let queue = WorkQueue::new(work, (CHUNK.as_nanos() / each) as usize);
        loop {
            let left = queue.len();
            if left == 0 {
                return;
            }
            if !self.permitted {
                self.wait_for_permit();
            }
            let most = (each * left as u128 / WORTH.as_nanos()).clamp(1, left as u128) as usize;
            let more = match most {
                1 => 0,
                most => self.scheduler.lock().queue.take_more(self.entity, most - 1),
            };
            queue.expect(1 + more);
            if more == 0 {
                self.work_off(&queue);
                if queue.len() > 0 {
                    self.wait_for_permit();
                }
            } else {
                self.charge();
                self.permitted = false;
                let Self { scheduler, entity, helped, .. } = &*self;
                let helper = Helper { scheduler, entity, helped, permits: 1 + more };
                scheduler.pool.install(|| helper.share_out(&queue));
                self.stopwatch = Stopwatch::start();
            }
        }
    }

    /// Works on this thread until the quantum is over. It gets at least one chunk done.
    fn work_off<W: Splittable>(&mut self, queue: &WorkQueue<W>) {
        while let Some(work) = queue.take() {
            work.run();
            if self.stopwatch.start.elapsed() >= QUANTUM {
                self.charge();
                if !self.scheduler.renew(self.entity) {
                    break;
                }
            }
        }
    }

    /// Gives the permit back, if there is one, and waits for the next.
    fn wait_for_permit(&mut self) {
        self.charge();
        let held = std::mem::take(&mut self.permitted);
        self.scheduler.update(|queue| {
            if held {
                queue.give_back(self.entity, 1);
            }
            queue.push(self.entity, Runnable::Worker(Arc::clone(self.parked)));
        });
        self.parked.park();
        self.permitted = true;
        self.stopwatch = Stopwatch::start();
    }

    fn charge(&mut self) {
        self.computed += self.stopwatch.charge(self.scheduler, self.entity);
    }
}

/// Threads that work on a message together. Their permits are given back when this is dropped, also by a panic.
struct Helper<'a> {
    scheduler: &'a Arc<Scheduler>,
    entity: &'a Entity,
    helped: &'a AtomicU64,
    permits: usize,
}

impl Helper<'_> {
    /// Half of the threads, where there are several.
    fn split_off(&mut self) -> Option<Self> {
        let half = self.permits / 2;
        self.permits -= half;
        (half > 0).then_some(Self { permits: half, ..*self })
    }

    /// Works on all of its threads, which the current pool has. Each permit is given back by itself: others
    /// need not wait for the last one.
    fn share_out<W: Splittable>(mut self, queue: &WorkQueue<W>) {
        match self.split_off() {
            Some(half) => {
                rayon::join(|| self.share_out(queue), || half.share_out(queue));
            }
            None => self.work_off(queue),
        }
    }

    /// Works on this thread, which is its only one, until its quantum is over.
    fn work_off<W: Splittable>(self, queue: &WorkQueue<W>) {
        let mut stopwatch = Stopwatch::start();
        let mut goes_on = true;
        while goes_on && let Some(work) = queue.take() {
            work.run();
            if stopwatch.start.elapsed() >= QUANTUM {
                self.charge(&mut stopwatch);
                goes_on = self.scheduler.renew(self.entity);
            }
        }
        self.charge(&mut stopwatch);
    }

    fn charge(&self, stopwatch: &mut Stopwatch) {
        let computed = stopwatch.charge(self.scheduler, self.entity).as_nanos() as u64;
        self.helped.fetch_add(computed, Ordering::Relaxed);
    }
}

impl Drop for Helper<'_> {
    fn drop(&mut self) {
        self.scheduler.update(|queue| queue.give_back(self.entity, self.permits));
    }
}

/// When a thread began to work.
struct Stopwatch {
    start: Instant,
    computed: Duration,
}

impl Stopwatch {
    fn start() -> Self {
        Self { start: Instant::now(), computed: thread_time() }
    }

    /// Charges `entity` with what this thread has computed since then, returns that, and begins anew. No entity is
    /// charged for time in which the kernel lets others have the processor.
    fn charge(&mut self, scheduler: &Scheduler, entity: &Entity) -> Duration {
        let Self { start, computed } = std::mem::replace(self, Self::start());
        let taken = self.start.duration_since(start).as_nanos() as u64;
        scheduler.busy.fetch_add(taken, Ordering::Relaxed);
        let computed = self.computed.saturating_sub(computed);
        entity.vruntime.fetch_add(computed.as_nanos() as u64, Ordering::Relaxed);
        computed
    }
}
