//! Who is next: the queue for the threads that step environments.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::thread::Thread;

use trocar_proto::bell::Bells;

/// How many threads there are, who has them and who wants one.
#[derive(Debug)]
pub(super) struct Turns {
    count: usize,
    pub(super) free: usize,
    /// Threads that those have who needed more than little.
    pub(super) long: usize,
    /// Somebody has gone ahead.
    pub(super) ahead: bool,
    /// In order of arrival.
    pub(super) waiting: Vec<Waiting>,
    /// What the one who had the latest turn had spent before it, ns.
    pub(super) clock: u64,
}

/// Threads that somebody has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Grant {
    pub(super) threads: usize,
    /// They are for little work.
    pub(super) little: bool,
    /// It is one more than there are.
    pub(super) ahead: bool,
}

/// Somebody who takes turns.
#[derive(Debug)]
pub(super) struct User {
    pub(super) share: Arc<Share>,
    /// CPU time, on the clock of [`Turns`], ns.
    pub(super) spent: AtomicU64,
    /// It was woken up with a thread and did not take it up yet. Written under the lock of [`Turns`].
    granted: AtomicBool,
    /// It is expected to need little for the next message. Written under the same lock.
    little: AtomicBool,
}

/// How many threads somebody may have, and has. Read and written under the lock of [`Turns`].
#[derive(Debug)]
pub(super) struct Share {
    limit: usize,
    taken: AtomicUsize,
}

/// Somebody who waits for a turn, or for a message that asks for one.
#[derive(Debug)]
pub(super) struct Waiting {
    user: Arc<User>,
    place: Place,
    /// It needs little.
    little: bool,
}

/// Where somebody waits.
#[derive(Debug)]
enum Place {
    /// In the queue.
    Queue(Arc<Waiter>),
    /// At a session's bell, which was rung `seen` times up to here. Who rings does not wake it up.
    Bell { bells: Arc<Bells>, seen: u32 },
}

/// Somebody who has got a thread and does not know it yet.
pub(super) struct Called(Place);

impl Called {
    pub(super) fn wake(self) {
        match self.0 {
            Place::Queue(waiter) => waiter.thread.unpark(),
            Place::Bell { bells, .. } => bells.request().wake(),
        }
    }
}

/// A thread that waits in the queue.
#[derive(Debug)]
pub(super) struct Waiter {
    pub(super) thread: Thread,
    pub(super) called: AtomicBool,
}

impl User {
    /// Somebody who has had no turn yet.
    pub(super) fn new(share: Arc<Share>) -> Arc<Self> {
        Arc::new(Self {
            share,
            spent: AtomicU64::new(0),
            granted: AtomicBool::new(false),
            little: AtomicBool::new(false),
        })
    }

    /// Whether a thread waits for it.
    pub(super) fn is_granted(&self) -> bool {
        self.granted.load(Ordering::Relaxed)
    }
}

impl Share {
    pub(super) fn new(limit: usize) -> Arc<Self> {
        Arc::new(Self { limit, taken: AtomicUsize::new(0) })
    }

    pub(super) fn left(&self) -> usize {
        self.limit.saturating_sub(self.taken.load(Ordering::Relaxed))
    }
}

impl Waiting {
    /// Whether it has something to do by now.
    fn asks(&self) -> bool {
        match &self.place {
            Place::Queue(_) => true,
            Place::Bell { bells, seen } => bells.request().count() != *seen,
        }
    }

    /// What it has spent. Who arrives now, at this `clock`, has saved nothing up.
    fn spent(&self, clock: u64) -> u64 {
        let spent = self.user.spent.load(Ordering::Relaxed);
        if matches!(self.place, Place::Bell { .. }) { spent.max(clock) } else { spent }
    }

    fn is(&self, waiter: &Arc<Waiter>) -> bool {
        matches!(&self.place, Place::Queue(this) if Arc::ptr_eq(this, waiter))
    }
}

impl Turns {
    /// `count` threads, all of them free.
    pub(super) fn new(count: usize) -> Self {
        Self { count, free: count, long: 0, ahead: false, waiting: vec![], clock: 0 }
    }

    /// Whether every thread is taken.
    pub(super) fn is_busy(&self) -> bool {
        self.free == 0
    }

    /// Whether every thread has somebody who needs more than little.
    fn is_long(&self) -> bool {
        self.long == self.count
    }

    /// Up to `most` threads that are free, if there are any that `user` may have.
    pub(super) fn take(&mut self, user: &User, most: usize, little: bool) -> Option<Grant> {
        self.withdraw(user);
        // Whoever waits while threads are free has taken all of its share.
        let threads = self.free.min(most).min(user.share.left());
        let grant = Grant { threads, little, ahead: false };
        (threads > 0).then(|| {
            self.free -= threads;
            self.note(user, grant);
            self.rouse();
            grant
        })
    }

    /// Puts `user` into the queue. True where it goes ahead at once.
    pub(super) fn queue(&mut self, user: &Arc<User>, waiter: &Arc<Waiter>, little: bool) -> bool {
        user.spent.fetch_max(self.clock, Ordering::Relaxed);
        let place = Place::Queue(Arc::clone(waiter));
        self.waiting.push(Waiting { user: Arc::clone(user), place, little });
        // Who needs more than little may keep its thread for longer than patience lasts. A client of
        // NeedleReach beside seven of BiPegTransfer has a p99 of 8.2 ms so, of 11.3 ms where it is patient
        // (ten alternating pairs).
        little && self.is_long() && self.go_ahead(waiter)
    }

    /// Lets `waiter` have a thread more than there are, where it is next and nobody else has done so.
    pub(super) fn go_ahead(&mut self, waiter: &Arc<Waiter>) -> bool {
        let next = self.next().filter(|next| self.waiting[*next].is(waiter));
        let Some(next) = next.filter(|_| !self.ahead) else { return false };
        self.call(next);
        self.ahead = true;
        true
    }

    /// How many have their turn before `waiter`, of those who may run; 0 if it does not wait.
    pub(super) fn before(&self, waiter: &Arc<Waiter>) -> usize {
        let index = self.waiting.iter().position(|each| each.is(waiter));
        let Some(index) = index else { return 0 };
        let mine = (self.waiting[index].spent(self.clock), index);
        self.candidates().filter(|other| *other < mine).count()
    }

    /// Lets `user` sleep at its bell, where nobody who rings has to wake it up: whoever ends a turn looks
    /// there. False where there are free threads, so that a ring has to.
    pub(super) fn rest(
        &mut self,
        user: &Arc<User>,
        bells: &Arc<Bells>,
        seen: u32,
        little: bool,
    ) -> bool {
        if !self.is_busy() {
            return false;
        }
        user.little.store(little, Ordering::Relaxed);
        let place = Place::Bell { bells: Arc::clone(bells), seen };
        self.waiting.push(Waiting { user: Arc::clone(user), place, little });
        self.rouse();
        true
    }

    /// `user`, who slept at its bell, is awake.
    pub(super) fn rise(&mut self, user: &Arc<User>) {
        self.waiting.retain(|each| !Arc::ptr_eq(&each.user, user));
    }

    /// Gives back the thread with which `user` was woken up, if it did not take it up.
    pub(super) fn withdraw(&mut self, user: &User) {
        if user.granted.swap(false, Ordering::Relaxed) {
            user.share.taken.fetch_sub(1, Ordering::Relaxed);
            self.long -= usize::from(!user.little.load(Ordering::Relaxed));
            self.free += 1;
        }
    }

    /// Gives back what `user` got.
    pub(super) fn give_back(&mut self, user: &User, grant: Grant) {
        user.share.taken.fetch_sub(grant.threads, Ordering::Relaxed);
        self.long -= if grant.little { 0 } else { grant.threads };
        if grant.ahead {
            self.ahead = false;
        } else {
            self.free += grant.threads;
        }
    }

    /// Whether `user`, whose turn is over, may keep its threads: nobody waits who could have them, and none
    /// are free that could help.
    pub(super) fn renew(&mut self, user: &User, grant: Grant) -> bool {
        let all_in_use = self.free.min(user.share.left()) == 0;
        let goes_on = !grant.ahead && all_in_use && self.next().is_none();
        if goes_on {
            self.clock = self.clock.max(user.spent.load(Ordering::Relaxed));
        }
        goes_on
    }

    /// Gives a free thread to who is next, if there is one: wake it up with the lock released.
    pub(super) fn pass_on(&mut self) -> Option<Called> {
        let next = if self.is_busy() { None } else { self.next() };
        let called = next.map(|next| {
            self.free -= 1;
            let Waiting { user, place, .. } = self.call(next);
            match &place {
                Place::Queue(waiter) => waiter.called.store(true, Ordering::Release),
                Place::Bell { .. } => user.granted.store(true, Ordering::Relaxed),
            }
            Called(place)
        });
        self.rouse();
        called
    }

    /// From now on a ring wakes up those at their bells who need not wait for the end of a turn: all where
    /// threads are free, else who would go ahead.
    fn rouse(&mut self) {
        let idle = !self.is_busy();
        if !(idle || self.is_long() && !self.ahead) {
            return;
        }
        let least = self.candidates().min().map_or(u64::MAX, |(spent, _)| spent);
        let clock = self.clock;
        self.waiting.retain(|each| match &each.place {
            Place::Bell { bells, .. } if idle || (each.little && each.spent(clock) <= least) => {
                bells.request().arm();
                if each.asks() {
                    // It was rung before who rings could know that.
                    bells.request().wake();
                }
                false
            }
            _ => true,
        });
    }

    /// Whose turn is next: who had the threads for the least time, of those who may have one more.
    fn next(&self) -> Option<usize> {
        self.candidates().min().map(|(_, next)| next)
    }

    /// Those who wait and may have a thread: what each has spent, and which one it is.
    fn candidates(&self) -> impl Iterator<Item = (u64, usize)> {
        let waiting = self.waiting.iter().enumerate();
        let may_run = waiting.filter(|(_, each)| each.user.share.left() > 0 && each.asks());
        may_run.map(|(index, each)| (each.spent(self.clock), index))
    }

    /// Lets one of those who wait have a thread.
    fn call(&mut self, next: usize) -> Waiting {
        let waiting = self.waiting.remove(next);
        let grant = Grant { threads: 1, little: waiting.little, ahead: false };
        self.note(&waiting.user, grant);
        waiting
    }

    /// Takes note of what `user` got.
    fn note(&mut self, user: &User, grant: Grant) {
        let spent = user.spent.fetch_max(self.clock, Ordering::Relaxed);
        self.clock = self.clock.max(spent);
        user.share.taken.fetch_add(grant.threads, Ordering::Relaxed);
        self.long += if grant.little { 0 } else { grant.threads };
    }
}
