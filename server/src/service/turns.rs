//! Which session is next: the queue for the threads that step environments.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::thread::Thread;

/// How many threads there are, which users have them and which wait for one.
#[derive(Debug)]
pub(super) struct Turns {
    count: usize,
    pub(super) free: usize,
    /// Threads of users that need so much.
    pub(super) little: usize,
    varied: usize,
    much: usize,
    /// A user has gone ahead.
    pub(super) ahead: bool,
    /// The next one comes last.
    pub(super) waiting: Vec<Waiting>,
    /// How many have ever waited.
    arrivals: u64,
    /// What the user of the latest turn had spent before it, ns.
    clock: u64,
    /// How many turns have begun.
    pub(super) begun: u64,
}

/// What a user is expected to need a thread for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Need {
    /// Little work, always.
    Little,
    /// Little work, but now and then more.
    Varied,
    /// More than that.
    Much,
}

/// A thread that a user has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Grant {
    pub(super) need: Need,
    /// It is one more than there are.
    pub(super) ahead: bool,
}

/// A session, or what else takes turns.
#[derive(Debug)]
pub(super) struct User {
    share: Arc<Share>,
    /// CPU time, on the clock of [`Turns`], ns.
    pub(super) spent: AtomicU64,
}

/// How many threads users may have together, and have. Read and written under the lock of
/// [`Turns`].
#[derive(Debug)]
pub(super) struct Share {
    limit: usize,
    taken: AtomicUsize,
}

/// An entry of the queue: a user that waits for a turn.
#[derive(Debug)]
pub(super) struct Waiting {
    /// What the user has spent, and how many have ever waited before it: the entry with less of
    /// both is next.
    rank: (u64, u64),
    user: Arc<User>,
    pub(super) who: Who,
    pub(super) need: Need,
}

#[derive(Debug)]
pub(super) enum Who {
    /// A worker that is in the middle of a message.
    Worker(Arc<Waiter>),
    /// The session at this seat, whose client has rung.
    Guest(u32),
}

/// A thread that waits for its turn.
#[derive(Debug)]
pub(super) struct Waiter {
    pub(super) thread: Thread,
    pub(super) called: AtomicBool,
    /// The thread that it was called with is one more than there are.
    pub(super) ahead: AtomicBool,
}

impl Need {
    /// Whether it may go ahead of users that need more.
    pub(super) fn is_small(self) -> bool {
        self < Self::Much
    }
}

impl User {
    /// A user that has had no turn yet.
    pub(super) fn new(share: Arc<Share>) -> Arc<Self> {
        Arc::new(Self { share, spent: AtomicU64::new(0) })
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

impl Waiter {
    /// The thread that calls.
    pub(super) fn here() -> Arc<Self> {
        let called = AtomicBool::new(false);
        Arc::new(Self { thread: std::thread::current(), called, ahead: AtomicBool::new(false) })
    }
}

impl Waiting {
    /// Whether it may have one thread more.
    fn may_run(&self) -> bool {
        self.user.share.left() > 0
    }
}

impl Turns {
    /// `count` threads, all of them free.
    pub(super) fn new(count: usize) -> Self {
        Self {
            count,
            free: count,
            little: 0,
            varied: 0,
            much: 0,
            ahead: false,
            waiting: vec![],
            arrivals: 0,
            clock: 0,
            begun: 0,
        }
    }

    /// Whether every thread is taken.
    pub(super) fn is_busy(&self) -> bool {
        self.free == 0
    }

    /// Puts a user into the queue. One that arrives now has saved nothing up.
    pub(super) fn queue(&mut self, user: &Arc<User>, who: Who, need: Need) {
        let spent = user.spent.fetch_max(self.clock, Ordering::Relaxed).max(self.clock);
        let rank = (spent, self.arrivals);
        self.arrivals += 1;
        let place = self.waiting.partition_point(|other| other.rank > rank);
        self.waiting.insert(place, Waiting { rank, user: Arc::clone(user), who, need });
    }

    /// The entry whose turn begins now, if any: the next one, where there is a thread, or where it needs little and
    /// all threads have users that need more. `overdue` says that no turn has begun for so long that this is no
    /// reason to wait any more.
    pub(super) fn due(&self, overdue: bool) -> Option<&Waiting> {
        let next = &self.waiting[self.next()?];
        let goes_ahead = || !self.ahead && next.need.is_small() && (self.is_much() || overdue);
        (!self.is_busy() || goes_ahead()).then_some(next)
    }

    /// Begins the turn of the next one. Only where it is due.
    pub(super) fn begin(&mut self) -> Option<(Waiting, Grant)> {
        let waiting = self.next().map(|next| self.waiting.remove(next))?;
        let ahead = self.is_busy();
        if ahead {
            self.ahead = true;
        } else {
            self.free -= 1;
        }
        self.note(&waiting.user, waiting.need, 1);
        let grant = Grant { need: waiting.need, ahead };
        Some((waiting, grant))
    }

    /// Up to `most` threads more for `user`, of those that no other user waits for.
    pub(super) fn take_more(&mut self, user: &User, most: usize, need: Need) -> usize {
        let unclaimed =
            self.free.saturating_sub(self.waiting.iter().filter(|each| each.may_run()).count());
        let threads = unclaimed.min(most).min(user.share.left());
        self.free -= threads;
        self.note(user, need, threads);
        threads
    }

    /// Gives back what `user` got.
    pub(super) fn give_back(&mut self, user: &User, grant: Grant) {
        user.share.taken.fetch_sub(1, Ordering::Relaxed);
        *self.count_of(grant.need) -= 1;
        if grant.ahead {
            self.ahead = false;
        } else {
            self.free += 1;
        }
    }

    /// Whether `user`, whose turn is over, may keep its thread: no user waits that could have it, and
    /// none are free that could help.
    pub(super) fn renew(&mut self, user: &User, grant: Grant) -> bool {
        let all_in_use = self.free.min(user.share.left()) == 0;
        let goes_on = !grant.ahead && all_in_use && self.next().is_none();
        if goes_on {
            self.clock = self.clock.max(user.spent.load(Ordering::Relaxed));
        }
        goes_on
    }

    /// Whether a message that asks for little is worth waking a worker up for, although all threads are taken.
    pub(super) fn may_go_ahead(&self) -> bool {
        self.is_busy() && !self.ahead && self.varied + self.much > 0
    }

    /// Whether a user that needs little is next, and may go ahead if this lasts.
    pub(super) fn is_tried(&self) -> bool {
        self.may_go_ahead() && self.next().is_some_and(|next| self.waiting[next].need.is_small())
    }

    /// Whether every thread has a user that needs more than little.
    fn is_much(&self) -> bool {
        self.much >= self.count
    }

    /// The next entry: of users that may have one more thread, the one that had the threads for the
    /// least time.
    fn next(&self) -> Option<usize> {
        self.waiting.iter().rposition(Waiting::may_run)
    }

    /// Takes note of what `user` got.
    fn note(&mut self, user: &User, need: Need, threads: usize) {
        let spent = user.spent.fetch_max(self.clock, Ordering::Relaxed);
        self.clock = self.clock.max(spent);
        user.share.taken.fetch_add(threads, Ordering::Relaxed);
        *self.count_of(need) += threads;
        self.begun += 1;
    }

    fn count_of(&mut self, need: Need) -> &mut usize {
        match need {
            Need::Little => &mut self.little,
            Need::Varied => &mut self.varied,
            Need::Much => &mut self.much,
        }
    }
}
