//! Turns: which session's environments run on which threads.
//!
//! A session that has a turn runs its environments bite by bite for about two milliseconds, and queues again if another
//! session waits. The next turn is for the session that has had the threads for the least time, and idle time saves
//! nothing up (start-time fair queueing, Goyal et al. 1996). So sessions share the threads evenly whatever their size.
//! A session that needs less than its share hardly waits, and one that finds idle threads uses them too.
//!
//! A turn can last much longer: one environment's step may take milliseconds, and the kernel may give
//! the processor to others meanwhile. A session that is next and needs little does not wait for its end but
//! goes ahead, on one thread more, one at a time. It does so at once where every thread has a session that needs more,
//! else when no turn has begun for a millisecond. None of this changes any result.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use super::hall::Hall;
use super::pile::{Divisible, MOST_LONG, Pile};
use super::turns::{Grant, Need, Share, User, Waiter, Who};
use super::wakes::Wakes;
use crate::clock::thread_time;

#[cfg(test)]
mod tests;

/// How long a session may keep a thread while others wait, and one bite more. With half of it, 64 clients of
/// 16 NeedlePick environments on one core had 0.92 of the rate (seven alternating pairs), with twice as
/// much 0.97 (five).
const TURN: Duration = Duration::from_millis(2);

/// Work that is taken up at once.
const BITE: Duration = Duration::from_micros(200);

/// Work that is worth another thread: waking one up costs about half of it.
pub(super) const WORTH: Duration = Duration::from_micros(50);

/// The threads that step environments, and how many of them users of this may have at a time.
#[derive(Debug, Clone)]
pub(super) struct Scheduler {
    hall: Arc<Hall>,
    share: Arc<Share>,
}

impl Scheduler {
    /// The threads of `hall`, all of them.
    pub(super) fn new(hall: Arc<Hall>) -> Self {
        Self { hall, share: Share::new(usize::MAX) }
    }

    /// The same threads, of which users of this one may have at most `limit` at a time.
    pub(super) fn limited(&self, limit: usize) -> Self {
        Self { hall: Arc::clone(&self.hall), share: Share::new(limit) }
    }

    /// A user whose time counts separately.
    pub(super) fn user(&self) -> Arc<User> {
        User::new(Arc::clone(&self.share))
    }

    /// Time for which threads were taken, all together.
    pub(super) fn busy(&self) -> Duration {
        Duration::from_nanos(self.hall.busy.load(Ordering::Relaxed))
    }

    pub(super) fn hall(&self) -> &Arc<Hall> {
        &self.hall
    }
}

/// What a message needs that is expected to take `cost`, where others took `peak` at most.
pub(super) fn need(cost: Duration, peak: Duration) -> Need {
    match (cost <= BITE, peak <= BITE) {
        (true, true) => Need::Little,
        (true, false) => Need::Varied,
        (false, _) => Need::Much,
    }
}

/// What `count` pieces need that are expected to take `cost` each; there is no more to go by.
fn need_of(count: usize, cost: Duration) -> Need {
    let little = cost.as_nanos().max(1) * count as u128 <= BITE.as_nanos();
    if little { Need::Varied } else { Need::Much }
}

/// A thread that a worker has for a user, while it answers a message.
pub(crate) struct Turn<'a> {
    hall: &'a Arc<Hall>,
    user: &'a Arc<User>,
    waiter: &'a Arc<Waiter>,
    /// `None` after the thread was given to others, with nothing left to compute.
    grant: Option<Grant>,
    watch: Watch,
    wakes: &'a mut Wakes,
    /// CPU time until `watch` began, of this thread.
    computed: Duration,
    /// CPU time of other threads, ns.
    helped: AtomicU64,
}

impl<'a> Turn<'a> {
    pub(super) fn begin(
        hall: &'a Arc<Hall>,
        user: &'a Arc<User>,
        waiter: &'a Arc<Waiter>,
        grant: Option<Grant>,
        watch: Watch,
        wakes: &'a mut Wakes,
    ) -> Self {
        let (computed, helped) = (Duration::ZERO, AtomicU64::new(0));
        Self { hall, user, waiter, grant, watch, wakes, computed, helped }
    }

    /// Has the client of the session at `seat` woken up soon, which sleeps.
    pub(super) fn wake(&mut self, seat: u32) {
        self.wakes.add(seat);
    }

    /// Wakes clients up at once.
    pub(super) fn rouse(&mut self) {
        self.wakes.rouse(&self.hall.door);
    }

    /// The thread, if it was not given back before, and the CPU time that the message took; from then on counts
    /// the watch.
    pub(super) fn end(mut self) -> (Option<Grant>, Duration, Watch) {
        self.charge();
        let helped = Duration::from_nanos(self.helped.load(Ordering::Relaxed));
        (self.grant, self.computed + helped, self.watch)
    }

    /// Whether there are several threads.
    pub(crate) fn is_parallel(&self) -> bool {
        self.hall.is_parallel()
    }

    /// Does `work`, turn by turn. `cost` is the time that one piece is expected to take.
    pub(crate) fn run<W: Divisible>(&mut self, work: W, cost: Duration) {
        if work.first_long().is_some() {
            self.work_through::<W, MOST_LONG>(work, cost);
        } else {
            self.work_through::<W, 0>(work, cost);
        }
    }

    fn work_through<W: Divisible, const LONG: usize>(&mut self, work: W, cost: Duration) {
        let each = cost.as_nanos().max(1);
        let pile = Pile::<W, LONG>::new(work, (BITE.as_nanos() / each) as usize);
        loop {
            let left = pile.len();
            if left == 0 {
                return;
            }
            let grant = self.grant.unwrap_or_else(|| self.queue(need_of(left, cost)));
            let most = (each * left as u128 / WORTH.as_nanos()).clamp(1, left as u128) as usize;
            let more = if most > 1 && !grant.ahead {
                self.hall.lock().turns.take_more(self.user, most - 1, grant.need)
            } else {
                0
            };
            pile.expect(1 + more);
            if more == 0 {
                self.work_off(&pile, grant);
                if pile.len() > 0 {
                    self.queue(need_of(pile.len(), cost));
                }
            } else {
                self.charge();
                self.rouse();
                self.grant = None;
                let Self { hall, user, helped, .. } = &*self;
                let part = Part { hall, user, helped, grant, threads: 1 + more };
                hall.pool.install(|| part.share_out(&pile));
                self.watch = Watch::start();
            }
        }
    }

    /// Works on this thread until the turn is over. It gets at least one bite done.
    fn work_off<W: Divisible, const LONG: usize>(&mut self, pile: &Pile<W, LONG>, grant: Grant) {
        while let Some(work) = pile.take() {
            work.run();
            if self.watch.start.elapsed() >= TURN {
                self.charge();
                self.rouse();
                if !self.hall.renew(self.user, grant) {
                    break;
                }
            }
        }
    }

    /// Lets others have the thread, if it has one, and waits for the next turn.
    fn queue(&mut self, need: Need) -> Grant {
        self.charge();
        self.rouse();
        self.waiter.called.store(false, Ordering::Relaxed);
        let held = self.grant.take();
        self.hall.free(|turns| {
            if let Some(grant) = held {
                turns.give_back(self.user, grant);
            }
            turns.queue(self.user, Who::Worker(Arc::clone(self.waiter)), need);
        });
        while !self.waiter.called.load(Ordering::Acquire) {
            std::thread::park();
        }
        self.watch = Watch::start();
        *self.grant.insert(Grant { need, ahead: self.waiter.ahead.load(Ordering::Relaxed) })
    }

    /// Takes note of the time that it took, and begins anew.
    fn charge(&mut self) {
        self.computed += self.watch.charge(self.hall, self.user);
    }
}

/// Threads that a message has besides the one that it began with, or all of them. They are given back when this
/// is dropped, also by a panic.
struct Part<'a> {
    hall: &'a Arc<Hall>,
    user: &'a User,
    helped: &'a AtomicU64,
    grant: Grant,
    threads: usize,
}

impl Part<'_> {
    /// Half of the threads, where there are several.
    fn split_off(&mut self) -> Option<Self> {
        let half = self.threads / 2;
        self.threads -= half;
        (half > 0).then_some(Self { threads: half, ..*self })
    }

    /// Works on all of its threads, which the current pool has. Each is given back by itself: others
    /// need not wait for the last one.
    fn share_out<W: Divisible, const LONG: usize>(mut self, pile: &Pile<W, LONG>) {
        match self.split_off() {
            Some(half) => {
                rayon::join(|| self.share_out(pile), || half.share_out(pile));
            }
            None => self.work_off(pile),
        }
    }

    /// Works on this thread, which is its only one, until its turn is over.
    fn work_off<W: Divisible, const LONG: usize>(self, pile: &Pile<W, LONG>) {
        let mut watch = Watch::start();
        let mut goes_on = true;
        while goes_on && let Some(work) = pile.take() {
            work.run();
            if watch.start.elapsed() >= TURN {
                self.charge(&mut watch);
                goes_on = self.hall.renew(self.user, self.grant);
            }
        }
        self.charge(&mut watch);
    }

    fn charge(&self, watch: &mut Watch) {
        let computed = watch.charge(self.hall, self.user).as_nanos() as u64;
        self.helped.fetch_add(computed, Ordering::Relaxed);
    }
}

impl Drop for Part<'_> {
    fn drop(&mut self) {
        self.hall
            .free(|turns| (0..self.threads).for_each(|_| turns.give_back(self.user, self.grant)));
    }
}

/// When a thread began to work.
pub(super) struct Watch {
    start: Instant,
    computed: Duration,
}

impl Watch {
    pub(super) fn start() -> Self {
        Self { start: Instant::now(), computed: thread_time() }
    }

    /// Charges `user` with what this thread has computed since then, gives that, and begins anew. No user is
    /// charged for time in which the kernel lets others have the processor.
    fn charge(&mut self, hall: &Hall, user: &User) -> Duration {
        let Self { start, computed } = std::mem::replace(self, Self::start());
        let taken = self.start.duration_since(start).as_nanos() as u64;
        hall.busy.fetch_add(taken, Ordering::Relaxed);
        let computed = self.computed.saturating_sub(computed);
        user.spent.fetch_add(computed.as_nanos() as u64, Ordering::Relaxed);
        computed
    }
}
