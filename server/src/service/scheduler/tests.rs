//! Turns of users without sessions: each takes them on a thread of its own.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Mutex;
use std::sync::atomic::AtomicUsize;

use super::*;
use crate::service::hall::tests::{Calls, House};

impl Scheduler {
    /// A user that is no session takes turns on this thread.
    pub(in crate::service) fn alone<R>(
        &self,
        user: &Arc<User>,
        act: impl FnOnce(&mut Turn<'_>) -> R,
    ) -> R {
        let (waiter, mut wakes) = (Waiter::here(), Wakes::default());
        let mut turn = Turn::begin(&self.hall, user, &waiter, None, Watch::start(), &mut wakes);
        let done = catch_unwind(AssertUnwindSafe(|| act(&mut turn)));
        let (grant, ..) = turn.end();
        if let Some(grant) = grant {
            self.hall.free(|turns| turns.give_back(user, grant));
        }
        done.unwrap_or_else(|panic| resume_unwind(panic))
    }
}

struct Count<'a> {
    cells: &'a mut [u32],
    running: &'a AtomicUsize,
    most: &'a AtomicUsize,
}

impl Divisible for Count<'_> {
    fn len(&self) -> usize {
        self.cells.len()
    }

    fn split_at(self, at: usize) -> (Self, Self) {
        let (first, second) = self.cells.split_at_mut(at);
        let Self { running, most, .. } = self;
        (Self { cells: first, running, most }, Self { cells: second, running, most })
    }

    fn run(self) {
        let running = self.running.fetch_add(1, Ordering::SeqCst) + 1;
        self.most.fetch_max(running, Ordering::SeqCst);
        for cell in self.cells {
            *cell += 1;
            std::thread::yield_now();
        }
        self.running.fetch_sub(1, Ordering::SeqCst);
    }
}

/// What is little work, and what is not.
const LITTLE: Duration = Duration::from_micros(100);
const LONG: Duration = Duration::from_millis(100);

/// Runs `act` with a thread for work that takes `cost`, and says whether it went ahead.
fn one_turn(
    scheduler: &Scheduler,
    user: &Arc<User>,
    cost: Duration,
    act: impl Fn() + Sync,
) -> bool {
    scheduler.alone(user, |turn| {
        turn.run(Calls(&act, 1), cost);
        turn.grant.is_some_and(|grant| grant.ahead)
    })
}

/// Waits until so many are in the queue.
fn await_waiting(scheduler: &Scheduler, count: usize) {
    while scheduler.hall.lock().turns.waiting.len() != count {
        std::thread::yield_now();
    }
}

/// Runs `meanwhile` while `user` has a thread for work that takes `cost`.
fn beside(scheduler: &Scheduler, user: &Arc<User>, cost: Duration, meanwhile: impl FnOnce()) {
    let (begun, over) = (AtomicUsize::new(0), AtomicUsize::new(0));
    std::thread::scope(|scope| {
        scope.spawn(|| {
            one_turn(scheduler, user, cost, || {
                begun.store(1, Ordering::SeqCst);
                while over.load(Ordering::SeqCst) == 0 {
                    std::thread::yield_now();
                }
            })
        });
        while begun.load(Ordering::SeqCst) == 0 {
            std::thread::yield_now();
        }
        meanwhile();
        over.store(1, Ordering::SeqCst);
    });
}

/// Threads that are free, a thread that is one more than there are, and the users that wait.
fn state(scheduler: &Scheduler) -> (usize, bool, usize) {
    let state = scheduler.hall.lock();
    (state.turns.free, state.turns.ahead, state.turns.waiting.len())
}

#[test]
fn work_that_panics_gives_its_threads_back() {
    let house = House::new("panics", 2);
    for pieces in [1, 8] {
        let fails = || panic!("work that fails");
        let user = house.scheduler.user();
        let turn = || house.scheduler.alone(&user, |turn| turn.run(Calls(&fails, pieces), LITTLE));
        assert!(catch_unwind(AssertUnwindSafe(turn)).is_err());
        assert_eq!(state(&house.scheduler), (2, false, 0));
        assert_eq!(house.scheduler.share.left(), usize::MAX);
    }
}

#[test]
fn who_had_the_threads_for_less_time_comes_first_and_idle_time_saves_nothing_up() {
    let house = House::new("order", 1);
    let scheduler = &house.scheduler;
    let [running, heavy, light, idle] = [10_000, 30_000, 20_000, 0].map(|milliseconds| {
        let user = scheduler.user();
        user.spent.store(milliseconds * 1_000_000, Ordering::Relaxed);
        user
    });
    let order = Mutex::new(vec![]);
    std::thread::scope(|scope| {
        beside(scheduler, &running, LONG, || {
            let users = [(&heavy, "heavy"), (&light, "light"), (&idle, "idle")];
            for (count, (user, name)) in users.into_iter().enumerate() {
                let order = &order;
                scope.spawn(move || {
                    one_turn(scheduler, user, LONG, || order.lock().unwrap().push(name));
                });
                await_waiting(scheduler, count + 1);
            }
        });
    });
    assert_eq!(*order.lock().unwrap(), ["idle", "light", "heavy"]);
    assert!(idle.spent.load(Ordering::Relaxed) >= 10_000_000_000);
}

#[test]
fn a_queue_of_small_ones_goes_ahead_of_a_long_turn_whoever_has_computed_least_first() {
    let house = House::new("ahead", 1);
    let scheduler = &house.scheduler;
    let [long, first] = [(); 2].map(|()| scheduler.user());
    // They arrive from the last to the first.
    let spent = [5_000, 4_000, 3_000, 2_000, 1_000];
    let done = Mutex::new(vec![]);
    beside(scheduler, &long, LONG, || {
        std::thread::scope(|scope| {
            beside(scheduler, &first, LITTLE, || {
                assert_eq!(state(scheduler), (0, true, 0));
                for (index, spent) in spent.into_iter().enumerate() {
                    let small = scheduler.user();
                    small.spent.store(spent * 1_000_000, Ordering::Relaxed);
                    let done = &done;
                    scope.spawn(move || {
                        let note = || done.lock().unwrap().push((spent, index));
                        assert!(one_turn(scheduler, &small, LITTLE, note), "it goes ahead");
                    });
                    await_waiting(scheduler, index + 1);
                }
            });
        });
    });
    let order = [(1_000, 4), (2_000, 3), (3_000, 2), (4_000, 1), (5_000, 0)];
    assert_eq!(done.into_inner().unwrap(), order);
    assert_eq!(state(scheduler), (1, false, 0));
}

#[test]
fn many_small_ones_of_a_share_are_ahead_one_at_a_time_and_a_large_one_waits() {
    let house = House::new("share", 1);
    let (scheduler, quota) = (&house.scheduler, house.scheduler.limited(1));
    let [one, other] = [(); 2].map(|()| quota.user());
    let (long, large) = (scheduler.user(), scheduler.user());
    large.spent.store(1_000_000_000, Ordering::Relaxed);
    std::thread::scope(|scope| {
        beside(scheduler, &long, LONG, || {
            beside(&quota, &one, LITTLE, || {
                scope.spawn(|| assert!(one_turn(&quota, &other, LITTLE, || {})));
                scope.spawn(|| assert!(!one_turn(scheduler, &large, LONG, || {})));
                await_waiting(scheduler, 2);
                std::thread::sleep(4 * TURN);
                assert_eq!(state(scheduler), (0, true, 2));
            });
            await_waiting(scheduler, 1);
        });
    });
    assert_eq!(state(scheduler), (1, false, 0));
    assert_eq!((quota.share.left(), scheduler.share.left()), (1, usize::MAX));
}

#[test]
fn a_share_is_not_exceeded_and_the_rest_is_for_others() {
    let house = House::new("shares", 3);
    let (scheduler, small) = (&house.scheduler, house.scheduler.limited(1));
    let (running, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let (free, most_free) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let mut cells = vec![vec![0; 129]; 4];
    let mut others = vec![vec![0; 129]; 4];
    std::thread::scope(|scope| {
        let mine = cells.iter_mut().map(|cells| (&small, cells, &running, &most));
        let free = others.iter_mut().map(|cells| (scheduler, cells, &free, &most_free));
        for (scheduler, cells, running, most) in mine.chain(free) {
            scope.spawn(move || {
                let user = scheduler.user();
                scheduler.alone(&user, |turn| turn.run(Count { cells, running, most }, LITTLE));
            });
        }
    });
    assert!(cells.iter().chain(&others).flatten().all(|cell| *cell == 1));
    assert_eq!(most.into_inner(), 1);
    assert!(most_free.into_inner() <= 4);
    assert_eq!(state(scheduler), (3, false, 0));
    assert_eq!((small.share.left(), scheduler.share.left()), (1, usize::MAX));
    assert!(scheduler.busy() > Duration::ZERO);
}

#[test]
fn every_piece_is_done_once_and_on_at_most_one_thread_more_than_there_are() {
    for threads in [1, 2, 3] {
        let house = House::new("pieces", threads);
        let (running, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let mut cells = vec![vec![0; 257]; 8];
        std::thread::scope(|scope| {
            for cells in &mut cells {
                let (running, most, scheduler) = (&running, &most, &house.scheduler);
                scope.spawn(move || {
                    let user = scheduler.user();
                    for _ in 0..20 {
                        let work = Count { cells, running, most };
                        scheduler.alone(&user, |turn| turn.run(work, LITTLE));
                    }
                });
            }
        });
        assert!(cells.iter().flatten().all(|cell| *cell == 20));
        assert!(most.into_inner() <= threads + 1);
        assert_eq!(state(&house.scheduler), (threads, false, 0));
    }
}
