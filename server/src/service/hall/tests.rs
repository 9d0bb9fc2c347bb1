//! A hall whose guests' messages are numbers.

use std::sync::atomic::{AtomicBool, AtomicU32};
use std::thread;

use trocar_proto::door::Size;
use trocar_proto::endpoint::{Endpoint, Membership};

use super::*;
use crate::service::pile::Divisible;
use crate::service::scheduler::{Scheduler, need};

/// How long anything may take that takes no time.
const PATIENT: Duration = Duration::from_mins(1);

/// What is little work, and what is not.
const LITTLE: Duration = Duration::from_micros(20);
const LONG_WORK: Duration = Duration::from_millis(20);

/// A server's hall.
pub(in crate::service) struct House {
    pub(in crate::service) scheduler: Scheduler,
    membership: Membership,
}

impl House {
    pub(in crate::service) fn new(label: &str, threads: usize) -> Self {
        static HOUSES: AtomicU32 = AtomicU32::new(0);
        let number = HOUSES.fetch_add(1, Ordering::Relaxed);
        let name = format!("t-{label}-{}-{number}", std::process::id());
        let membership = Endpoint::new(&name.parse().unwrap()).join().unwrap();
        let door = Door::make(membership.endpoint(), 7).unwrap();
        let hall = Hall::open(threads, door).unwrap();
        Self { scheduler: Scheduler::new(hall), membership }
    }

    fn hall(&self) -> &Arc<Hall> {
        self.scheduler.hall()
    }

    /// The door as its clients have it.
    fn door(&self) -> Door {
        Door::open(self.membership.endpoint(), 7).unwrap()
    }

    /// Takes a seat for a guest whose messages take three pieces of `work`, which should take `cost`
    /// each.
    fn admit(&self, cost: Duration, work: impl Fn() + Send + Sync + 'static) -> Client {
        let seat = self.hall().keep_seat().unwrap();
        let number = seat.number;
        let mail = Arc::new(Mail::default());
        let player = Player { mail: Arc::clone(&mail), cost, work: Box::new(work), _seat: seat };
        let user = self.scheduler.user();
        let outlook = Outlook { need: need(3 * cost, 3 * cost), cost: 3 * cost };
        self.hall().admit(number, Arc::clone(&user), outlook, Box::new(player));
        let size = if cost == LITTLE { Size::Small } else { Size::Large };
        Client { hall: Arc::clone(self.hall()), door: self.door(), seat: number, size, mail, user }
    }

    /// Whether all of its threads are free and nothing waits.
    fn is_idle(&self, threads: usize) -> bool {
        let Turns { free, little, ahead, waiting, .. } = &self.hall().lock().turns;
        (*free, *little, *ahead, waiting.is_empty()) == (threads, 0, false, true)
    }

    /// Waits until no worker is awake.
    fn await_sleep(&self) {
        eventually(|| {
            let state = self.hall().lock();
            state.polling == 0
                && !state.turns.is_busy()
                && state.turns.waiting.is_empty()
                && state.asleep[Listener::Any as usize].posted
        });
    }
}

impl Drop for House {
    fn drop(&mut self) {
        if !thread::panicking() {
            // Its guests have left, and workers end with the last of them.
            eventually(|| Arc::strong_count(self.hall()) == 1);
        }
    }
}

/// What a client and its guest share.
#[derive(Debug, Default)]
struct Mail {
    sent: AtomicU32,
    answered: AtomicU32,
    leaves: AtomicBool,
    gone: AtomicBool,
}

struct Client {
    hall: Arc<Hall>,
    door: Door,
    seat: u32,
    size: Size,
    mail: Arc<Mail>,
    user: Arc<User>,
}

impl Client {
    /// Sends a message; whether a worker had to be woken up.
    fn send(&self) -> bool {
        self.mail.sent.fetch_add(1, Ordering::SeqCst);
        self.door.ring(self.seat, self.size)
    }

    fn leave(&self) {
        self.mail.leaves.store(true, Ordering::SeqCst);
        self.hall.call(self.seat);
    }

    fn await_answer(&self) {
        eventually(|| self.is_answered());
    }

    fn is_answered(&self) -> bool {
        self.mail.answered.load(Ordering::SeqCst) == self.mail.sent.load(Ordering::SeqCst)
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        self.leave();
    }
}

struct Player {
    mail: Arc<Mail>,
    cost: Duration,
    work: Box<dyn Fn() + Send + Sync>,
    _seat: Seat,
}

impl Guest for Player {
    fn attend(&mut self, turn: &mut Turn<'_>) -> Attended {
        let Mail { sent, answered, leaves, .. } = &*self.mail;
        if leaves.load(Ordering::SeqCst) {
            return Attended::Over;
        }
        let number = answered.load(Ordering::SeqCst);
        if sent.load(Ordering::SeqCst) == number {
            return Attended::Nothing;
        }
        turn.run(Calls(&*self.work, 3), self.cost);
        answered.store(number + 1, Ordering::SeqCst);
        Attended::Answered { slept: false, more: sent.load(Ordering::SeqCst) > number + 1 }
    }

    fn outlook(&mut self, _: Duration) -> Outlook {
        Outlook { need: need(3 * self.cost, 3 * self.cost), cost: 3 * self.cost }
    }

    fn failed(&mut self) {}
}

impl Drop for Player {
    fn drop(&mut self) {
        self.mail.gone.store(true, Ordering::SeqCst);
    }
}

/// Work of so many pieces, each a call.
pub(in crate::service) struct Calls<'a>(
    pub(in crate::service) &'a (dyn Fn() + Sync),
    pub(in crate::service) usize,
);

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

/// A gate at which work waits.
#[derive(Default)]
struct Gate {
    reached: AtomicBool,
    open: AtomicBool,
}

impl Gate {
    fn pass(&self) {
        self.reached.store(true, Ordering::SeqCst);
        eventually(|| self.open.load(Ordering::SeqCst));
    }

    fn await_arrival(&self) {
        eventually(|| self.reached.load(Ordering::SeqCst));
    }

    fn open(&self) {
        self.open.store(true, Ordering::SeqCst);
    }
}

fn eventually(is: impl Fn() -> bool) {
    let start = Instant::now();
    while !is() {
        assert!(start.elapsed() < PATIENT, "it does not come about");
        thread::yield_now();
    }
}

#[test]
fn a_ring_is_answered_as_are_two_at_once_and_what_was_sent_without_one() {
    let house = House::new("rings", 1);
    let client = house.admit(LITTLE, || {});
    for _ in 0..3 {
        client.send();
        client.await_answer();
    }
    house.await_sleep();
    client.mail.sent.fetch_add(1, Ordering::SeqCst);
    assert!(client.send(), "who sleeps is woken up");
    client.await_answer();
    // A client that is broken, or dies before it rings, costs time and nothing else.
    house.await_sleep();
    client.mail.sent.fetch_add(1, Ordering::SeqCst);
    client.await_answer();
}

#[test]
fn a_ring_wakes_nobody_while_threads_are_taken_and_who_ends_a_turn_attends_to_all() {
    let house = House::new("turn", 1);
    let gate = Arc::new(Gate::default());
    let at_gate = Arc::clone(&gate);
    let busy = house.admit(LONG_WORK, move || at_gate.pass());
    let order = Arc::new(Mutex::new(vec![]));
    let clients = [3, 1, 2].map(|spent| {
        let order = Arc::clone(&order);
        (house.admit(LONG_WORK, move || order.lock().unwrap().push(spent)), spent)
    });
    house.await_sleep();
    busy.send();
    gate.await_arrival();
    let clients = clients.map(|(client, spent)| {
        client.user.spent.store(spent * 1_000_000_000, Ordering::SeqCst);
        client
    });
    assert!(clients.iter().all(|client| !client.send()));
    thread::sleep(Duration::from_millis(20));
    assert!(!clients.iter().any(Client::is_answered));
    gate.open();
    clients.iter().for_each(Client::await_answer);
    assert_eq!(*order.lock().unwrap(), [1, 1, 1, 2, 2, 2, 3, 3, 3]);
}

#[test]
fn who_needs_little_is_heard_beside_a_message_that_has_all_threads_for_long() {
    for threads in [1, 2] {
        let house = House::new("little", threads);
        let gate = Arc::new(Gate::default());
        let at_gate = Arc::clone(&gate);
        let long = house.admit(LONG_WORK, move || at_gate.pass());
        let small: Vec<_> = (0..5).map(|_| house.admit(LITTLE, || {})).collect();
        house.await_sleep();
        long.send();
        gate.await_arrival();
        eventually(|| house.hall().lock().turns.is_busy());
        for _ in 0..3 {
            for client in &small {
                client.send();
            }
            small.iter().for_each(Client::await_answer);
        }
        assert!(!long.is_answered());
        gate.open();
        long.await_answer();
        eventually(|| house.is_idle(threads));
    }
}

#[test]
fn no_ring_is_missed_whoever_has_the_threads() {
    const ROUNDS: u32 = 400;
    for threads in [1, 2] {
        let house = House::new("all", threads);
        let done = Arc::new(AtomicU32::new(0));
        // Every other one is expected to need little.
        let clients = [LITTLE, LONG_WORK, LITTLE, LONG_WORK, LITTLE, LONG_WORK].map(|cost| {
            let done = Arc::clone(&done);
            house.admit(cost, move || {
                done.fetch_add(1, Ordering::SeqCst);
            })
        });
        thread::scope(|scope| {
            for client in &clients {
                scope.spawn(move || {
                    for round in 0..ROUNDS {
                        client.send();
                        // Two in flight, now and then.
                        if round % 5 == 0 {
                            client.send();
                        }
                        client.await_answer();
                        if round % 100 == 0 {
                            thread::sleep(Duration::from_millis(2));
                        }
                    }
                });
            }
        });
        assert_eq!(done.load(Ordering::SeqCst), 6 * 3 * (ROUNDS + ROUNDS / 5));
        eventually(|| house.is_idle(threads));
    }
}

#[test]
fn who_rings_for_everybody_without_end_stops_nobody() {
    for threads in [1, 2] {
        let house = House::new("noise", threads);
        let clients = [LITTLE, LONG_WORK].map(|cost| house.admit(cost, || {}));
        let over = AtomicBool::new(false);
        thread::scope(|scope| {
            scope.spawn(|| {
                let door = house.door();
                while !over.load(Ordering::SeqCst) {
                    for seat in 0..SEATS as u32 {
                        door.ring(seat, Size::Small);
                    }
                }
            });
            for client in clients.iter().cycle().take(40) {
                client.send();
                client.await_answer();
            }
            over.store(true, Ordering::SeqCst);
        });
    }
}

#[test]
fn who_panics_is_gone_and_others_are_attended_to() {
    let house = House::new("panic", 1);
    let bad = house.admit(LITTLE, || panic!("a fault"));
    let good = house.admit(LITTLE, || {});
    bad.send();
    good.send();
    good.await_answer();
    eventually(|| bad.mail.gone.load(Ordering::SeqCst));
    eventually(|| house.hall().lock().turns.free == 1);
    // Its seat is for others.
    eventually(|| matches!(house.hall().lock().places[bad.seat as usize], Place::Free));
    bad.send();
    good.send();
    good.await_answer();
}

#[test]
fn a_guest_that_leaves_is_let_go_of_and_workers_end_with_the_last() {
    let house = House::new("leave", 2);
    let [first, other] = [(); 2].map(|()| house.admit(LITTLE, || {}));
    first.send();
    first.await_answer();
    first.leave();
    eventually(|| first.mail.gone.load(Ordering::SeqCst));
    other.send();
    other.await_answer();
    drop([first, other]);
    eventually(|| Arc::strong_count(house.hall()) == 1);
    // Other workers come when they are needed again.
    let late = house.admit(LITTLE, || {});
    late.send();
    late.await_answer();
}
