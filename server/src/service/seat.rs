//! Where a session waits for its client.
//!
//! To wake a thread up, and for that thread to find that others are before it, costs more than a small step.
//! So a session that sleeps while all threads are taken is not woken up when its client rings. It lies in the
//! queue of [`Turns`](super::turns::Turns), where whoever ends a turn looks at its bell, and it is woken up when it
//! is next, with a thread. 64 clients of 16 EcmReach environments each on one core got 1.36 times as many steps done with
//! this, and what else was done at the same time to messages (ten alternating pairs, 1.17 to 1.66).

use std::sync::Arc;
use std::time::Duration;

use trocar_proto::bell::Bells;

use super::scheduler::{Scheduler, is_little};

/// The place of a session's thread at its bells.
#[derive(Debug)]
pub(super) struct Seat {
    scheduler: Scheduler,
    bells: Arc<Bells>,
}

impl Seat {
    /// The place of one who takes turns by `scheduler`, which is its own.
    pub(super) fn new(scheduler: Scheduler, bells: Arc<Bells>) -> Self {
        Self { scheduler, bells }
    }

    /// Sleeps until there is a ring more than those `seen`, at most for `limit`; `cost` is the time that the
    /// next message is expected to ask for. It may wake up with a thread, which is for the next work that its
    /// scheduler runs.
    pub(super) fn sleep(&self, seen: u32, cost: Duration, limit: Duration) {
        self.decline();
        let user = &self.scheduler.user;
        let bell = self.bells.request();
        if self.scheduler.lock().rest(user, &self.bells, seen, is_little(cost, 1)) {
            bell.wait(seen, limit);
            self.scheduler.lock().rise(user);
            bell.disarm();
        } else {
            bell.sleep(seen, limit);
        }
    }

    /// Gives back the thread with which it woke up, if nothing needed it.
    pub(super) fn decline(&self) {
        if self.scheduler.user.is_granted() {
            self.scheduler.free(|turns| turns.withdraw(&self.scheduler.user));
        }
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.decline();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
    use std::thread;
    use std::time::Instant;

    use trocar_proto::endpoint::{Endpoint, Membership};

    use super::super::pile::Divisible;
    use super::*;

    const LONG: Duration = Duration::from_mins(1);
    /// What is little work, and what is not.
    const SMALL: Duration = Duration::from_micros(20);
    const LARGE: Duration = Duration::from_millis(20);

    /// Work of so many pieces, each a call.
    struct Calls<'a>(&'a (dyn Fn() + Sync), usize);

    impl Divisible for Calls<'_> {
        fn len(&self) -> usize {
            self.1
        }

        fn split_at(self, at: usize) -> (Self, Self) {
            (Self(self.0, at), Self(self.0, self.1 - at))
        }

        fn run(self) {
            (0..self.1).for_each(|_| (self.0)());
        }
    }

    /// A server's sessions, with the bells as their clients have them.
    struct House {
        membership: Membership,
        scheduler: Scheduler,
    }

    impl House {
        fn new(label: &str, threads: usize) -> Self {
            let name = format!("t-seat-{label}-{}", std::process::id());
            let membership = Endpoint::new(&name.parse().unwrap()).join().unwrap();
            Self { membership, scheduler: Scheduler::new(threads).unwrap() }
        }

        fn session(&self, number: u64) -> (Seat, Bells) {
            let endpoint = self.membership.endpoint();
            let bells = Arc::new(Bells::make(endpoint, 7, number).unwrap());
            let opened = Bells::open(endpoint, 7, number).unwrap();
            (Seat::new(self.scheduler.separate(), bells), opened)
        }

        /// Waits until so many sleep or queue.
        fn await_waiting(&self, count: usize) {
            while self.scheduler.lock().waiting.len() != count {
                thread::yield_now();
            }
        }
    }

    /// Runs `meanwhile` while somebody has a thread.
    fn beside(house: &House, cost: Duration, meanwhile: impl FnOnce()) {
        let (begun, over) = (AtomicBool::new(false), AtomicBool::new(false));
        let hold = || {
            begun.store(true, Ordering::SeqCst);
            while !over.load(Ordering::SeqCst) {
                thread::yield_now();
            }
        };
        thread::scope(|scope| {
            let other = house.scheduler.separate();
            scope.spawn(move || other.run(Calls(&hold, 1), &mut { cost }));
            while !begun.load(Ordering::SeqCst) {
                thread::yield_now();
            }
            meanwhile();
            over.store(true, Ordering::SeqCst);
        });
    }

    #[test]
    fn a_ring_wakes_nobody_whose_turn_it_is_not_and_the_end_of_a_turn_wakes_who_was_rung() {
        let house = House::new("turn", 1);
        let [(rung, client), (silent, other_client)] = [1, 2].map(|number| house.session(number));
        thread::scope(|scope| {
            let mut sleepers = None;
            beside(&house, LARGE, || {
                let rung = &rung;
                let silent = &silent;
                let sleeper = scope.spawn(move || rung.sleep(0, LARGE, LONG));
                let other = scope.spawn(move || silent.sleep(0, LARGE, LONG));
                house.await_waiting(2);
                assert!(!client.request().ring(), "who rings calls no kernel");
                thread::sleep(Duration::from_millis(20));
                assert!(!sleeper.is_finished());
                sleepers = Some((sleeper, other));
            });
            let (sleeper, other) = sleepers.unwrap();
            sleeper.join().unwrap();
            assert!(rung.scheduler.user.is_granted());
            assert!(house.scheduler.is_busy(), "it has the thread");
            // Nothing asked for it.
            rung.decline();
            assert!(!house.scheduler.is_busy());
            // Where threads are free, a ring wakes up.
            house.await_waiting(0);
            while !other_client.request().ring() {}
            other.join().unwrap();
            assert!(!silent.scheduler.user.is_granted());
        });
    }

    #[test]
    fn who_needs_little_is_woken_up_beside_a_long_turn_where_it_would_be_next() {
        let house = House::new("little", 1);
        let (seat, client) = house.session(1);
        beside(&house, LARGE, || {
            thread::scope(|scope| {
                let sleeper = scope.spawn(|| seat.sleep(0, SMALL, LONG));
                while !sleeper.is_finished() {
                    client.request().ring();
                    thread::yield_now();
                }
            });
            let done = AtomicBool::new(false);
            let call = || done.store(true, Ordering::SeqCst);
            seat.scheduler.run(Calls(&call, 1), &mut { SMALL });
            assert!(done.into_inner(), "it goes ahead");
        });
    }

    #[test]
    fn a_thread_that_nobody_took_up_goes_to_the_next() {
        let house = House::new("next", 1);
        let users = thread::scope(|scope| {
            let mut sleepers = vec![];
            beside(&house, LARGE, || {
                let mut clients = vec![];
                for number in [1, 2] {
                    let (seat, client) = house.session(number);
                    clients.push(client);
                    sleepers.push(scope.spawn(move || {
                        seat.sleep(0, LARGE, LONG);
                        assert!(seat.scheduler.user.is_granted());
                        // Dropped, it gives the thread back.
                        Arc::clone(&seat.scheduler.user)
                    }));
                }
                house.await_waiting(2);
                assert!(clients.iter().all(|client| !client.request().ring()));
            });
            sleepers.into_iter().map(|sleeper| sleeper.join().unwrap()).collect::<Vec<_>>()
        });
        assert!(users.iter().all(|user| !user.is_granted()));
        assert!(!house.scheduler.is_busy());
    }

    #[test]
    fn no_ring_is_missed_whoever_has_the_threads() {
        const SESSIONS: u64 = 6;
        const ROUNDS: u32 = 400;
        for threads in [1, 2] {
            let house = House::new(&format!("rings-{threads}"), threads);
            let done = AtomicU32::new(0);
            let call = || {
                done.fetch_add(1, Ordering::SeqCst);
            };
            let start = Instant::now();
            thread::scope(|scope| {
                for number in 1..=SESSIONS {
                    let (seat, client) = house.session(number);
                    let call = &call;
                    // Every other one is expected to need little.
                    let cost = if number % 2 == 0 { SMALL } else { LARGE };
                    scope.spawn(move || {
                        for round in 0..ROUNDS {
                            while seat.bells.request().count() == round {
                                seat.sleep(round, cost, LONG);
                                assert!(start.elapsed() < LONG, "a ring was missed");
                            }
                            seat.scheduler.run(Calls(call, 3), &mut { cost });
                            seat.decline();
                            seat.bells.reply().ring();
                        }
                    });
                    scope.spawn(move || {
                        for round in 0..ROUNDS {
                            client.request().ring();
                            while client.reply().count() == round {
                                client.reply().sleep(round, LONG);
                            }
                        }
                    });
                }
            });
            assert_eq!(done.into_inner(), 3 * ROUNDS * SESSIONS as u32);
            let turns = house.scheduler.lock();
            assert_eq!((turns.free, turns.long, turns.waiting.len()), (threads, 0, 0));
        }
    }
}
