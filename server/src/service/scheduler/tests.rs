//! A scheduler whose sessions' messages are numbers, and entities without sessions.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicU32, AtomicUsize};
use std::thread;
use std::time::Instant;

use trocar_proto::endpoint::{Endpoint, Membership};

use super::*;

/// How long anything may take that takes no time.
const PATIENCE: Duration = Duration::from_mins(1);

/// What is little work, and what is not.
const LITTLE: Duration = Duration::from_micros(20);
const LONG: Duration = Duration::from_millis(20);

/// A scheduler with a doorbell of its own.
pub(in crate::service) struct TestScheduler {
    pub(in crate::service) scheduler: Arc<Scheduler>,
    membership: Membership,
}

impl TestScheduler {
    pub(in crate::service) fn new(label: &str, threads: usize) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("t-{label}-{}-{number}", std::process::id());
        let membership = Endpoint::new(&name.parse().unwrap()).join().unwrap();
        let doorbell = Doorbell::make(membership.endpoint(), 7).unwrap();
        Self { scheduler: Scheduler::new(threads, doorbell).unwrap(), membership }
    }

    /// Lets `act` compute on this thread for an entity that has no session.
    pub(in crate::service) fn compute<R>(
        &self,
        entity: &Arc<Entity>,
        act: impl FnOnce(&mut Quantum<'_>) -> R,
    ) -> R {
        let parked = Parked::here();
        let mut quantum = Quantum::begin(&self.scheduler, entity, &parked, false);
        let done = catch_unwind(AssertUnwindSafe(|| act(&mut quantum)));
        if quantum.end().0 {
            self.scheduler.update(|queue| queue.give_back(entity, 1));
        }
        done.unwrap_or_else(|panic| resume_unwind(panic))
    }

    /// The doorbell as its clients have it.
    fn doorbell(&self) -> Doorbell {
        Doorbell::open(self.membership.endpoint(), 7).unwrap()
    }

    /// A session whose messages take three pieces of `work`, which should take `cost` each.
    fn open(&self, cost: Duration, work: impl Fn() + Send + Sync + 'static) -> Client {
        let slot = self.scheduler.reserve().unwrap();
        let id = slot.id;
        let mail = Arc::new(Mail::default());
        let session = Session { mail: Arc::clone(&mail), cost, work: Box::new(work), _slot: slot };
        let entity = Entity::new(&ThreadQuota::new(usize::MAX));
        self.scheduler.occupy(id, Arc::clone(&entity), Box::new(session));
        let (scheduler, doorbell) = (Arc::clone(&self.scheduler), self.doorbell());
        Client { scheduler, doorbell, slot: id, mail, entity }
    }

    /// Permits that are free, and entries that wait.
    fn state(&self) -> (usize, usize) {
        let state = self.scheduler.lock();
        (state.queue.free, state.queue.waiting())
    }

    /// Waits until a worker sleeps at the doorbell and none is awake.
    fn await_sleep(&self) {
        eventually(|| self.scheduler.lock().advertised);
    }
}

impl Drop for TestScheduler {
    fn drop(&mut self) {
        if !thread::panicking() {
            // Its sessions have ended, and workers end with the last of them.
            eventually(|| Arc::strong_count(&self.scheduler) == 1);
        }
    }
}

/// What a client and its session share.
#[derive(Debug, Default)]
struct Mail {
    sent: AtomicU32,
    answered: AtomicU32,
    ends: AtomicBool,
    gone: AtomicBool,
}

struct Client {
    scheduler: Arc<Scheduler>,
    doorbell: Doorbell,
    slot: SlotId,
    mail: Arc<Mail>,
    entity: Arc<Entity>,
}

impl Client {
    /// Sends a message; whether a worker had to be woken up.
    fn send(&self) -> bool {
        self.mail.sent.fetch_add(1, Ordering::SeqCst);
        self.doorbell.ring(self.slot.0)
    }

    fn end(&self) {
        self.mail.ends.store(true, Ordering::SeqCst);
        self.scheduler.schedule(self.slot);
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
        self.end();
    }
}

struct Session {
    mail: Arc<Mail>,
    cost: Duration,
    work: Box<dyn Fn() + Send + Sync>,
    _slot: SlotReservation,
}

impl Poll for Session {
    fn poll(&mut self, quantum: &mut Quantum<'_>) -> Polled {
        let Mail { sent, answered, ends, .. } = &*self.mail;
        if ends.load(Ordering::SeqCst) {
            return Polled::Closed;
        }
        let number = answered.load(Ordering::SeqCst);
        if sent.load(Ordering::SeqCst) == number {
            return Polled::Idle;
        }
        quantum.run(Calls(&*self.work, 3), self.cost);
        answered.store(number + 1, Ordering::SeqCst);
        Polled::Answered { slept: false, more: sent.load(Ordering::SeqCst) > number + 1 }
    }

    fn computed(&mut self, _: Duration) {}

    fn failed(&mut self) {}
}

impl Drop for Session {
    fn drop(&mut self) {
        self.mail.gone.store(true, Ordering::SeqCst);
    }
}

/// Work of so many pieces, each a call.
struct Calls<'a>(&'a (dyn Fn() + Sync), usize);

impl Splittable for Calls<'_> {
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

/// Work that counts each piece, and how many threads are at it.
struct Count<'a> {
    cells: &'a mut [u32],
    running: &'a AtomicUsize,
    most: &'a AtomicUsize,
}

impl Splittable for Count<'_> {
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
            thread::yield_now();
        }
        self.running.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Where work waits.
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
        assert!(start.elapsed() < PATIENCE, "it does not come about");
        thread::yield_now();
    }
}

#[test]
fn a_ring_is_answered_and_so_is_a_message_without_one() {
    let test = TestScheduler::new("rings", 1);
    let client = test.open(LITTLE, || {});
    for _ in 0..3 {
        client.send();
        client.await_answer();
    }
    test.await_sleep();
    assert!(client.send(), "a worker that sleeps is woken up");
    client.await_answer();
    // A client that is broken, or dies before it rings, costs time and nothing else: the control loop scans.
    client.mail.sent.fetch_add(1, Ordering::SeqCst);
    eventually(|| {
        test.scheduler.scan();
        client.is_answered()
    });
}

#[test]
fn a_ring_wakes_no_worker_while_all_permits_are_taken_and_the_least_consumed_comes_first() {
    let test = TestScheduler::new("order", 1);
    let gate = Arc::new(Gate::default());
    let at_gate = Arc::clone(&gate);
    let busy = test.open(LONG, move || at_gate.pass());
    let order = Arc::new(Mutex::new(vec![]));
    let clients = [3, 1, 2].map(|seconds| {
        let order = Arc::clone(&order);
        (test.open(LONG, move || order.lock().unwrap().push(seconds)), seconds)
    });
    test.await_sleep();
    busy.send();
    gate.await_arrival();
    let clients = clients.map(|(client, seconds)| {
        client.entity.vruntime.store(seconds * 1_000_000_000, Ordering::SeqCst);
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
fn no_ring_is_missed() {
    const ROUNDS: u32 = 400;
    for threads in [1, 2] {
        let test = TestScheduler::new("all", threads);
        let done = Arc::new(AtomicU32::new(0));
        let clients = [LITTLE, LONG, LITTLE, LONG, LITTLE, LONG].map(|cost| {
            let done = Arc::clone(&done);
            test.open(cost, move || {
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
        eventually(|| test.state() == (threads, 0));
    }
}

#[test]
fn a_client_that_rings_for_all_without_end_stops_no_session() {
    for threads in [1, 2] {
        let test = TestScheduler::new("noise", threads);
        let clients = [LITTLE, LONG].map(|cost| test.open(cost, || {}));
        let over = AtomicBool::new(false);
        thread::scope(|scope| {
            scope.spawn(|| {
                let doorbell = test.doorbell();
                while !over.load(Ordering::SeqCst) {
                    for slot in 0..SLOTS as u32 {
                        doorbell.ring(slot);
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
fn a_session_that_panics_is_gone_and_others_are_polled() {
    let test = TestScheduler::new("panic", 1);
    let bad = test.open(LITTLE, || panic!("a fault"));
    let good = test.open(LITTLE, || {});
    bad.send();
    good.send();
    good.await_answer();
    eventually(|| bad.mail.gone.load(Ordering::SeqCst));
    eventually(|| test.state().0 == 1);
    // Its slot is for others.
    eventually(|| matches!(test.scheduler.lock().slots[bad.slot.0 as usize], Slot::Free));
    bad.send();
    good.send();
    good.await_answer();
}

#[test]
fn workers_end_with_the_last_session() {
    let test = TestScheduler::new("end", 2);
    let [first, other] = [(); 2].map(|()| test.open(LITTLE, || {}));
    first.send();
    first.await_answer();
    first.end();
    eventually(|| first.mail.gone.load(Ordering::SeqCst));
    other.send();
    other.await_answer();
    drop([first, other]);
    eventually(|| Arc::strong_count(&test.scheduler) == 1);
    // Other workers come when they are needed again.
    let late = test.open(LITTLE, || {});
    late.send();
    late.await_answer();
}

#[test]
fn work_that_panics_gives_its_permits_back() {
    let test = TestScheduler::new("panics", 2);
    for pieces in [1, 8] {
        let fails = || panic!("work that fails");
        let entity = Entity::new(&ThreadQuota::new(2));
        let run = || test.compute(&entity, |quantum| quantum.run(Calls(&fails, pieces), LITTLE));
        assert!(catch_unwind(AssertUnwindSafe(run)).is_err());
        assert_eq!(test.state(), (2, 0));
        // All of the quota is there again.
        let ran = AtomicUsize::new(0);
        let counts = || {
            ran.fetch_add(1, Ordering::SeqCst);
        };
        test.compute(&entity, |quantum| quantum.run(Calls(&counts, 8), LONG));
        assert_eq!(ran.into_inner(), 8);
    }
}

#[test]
fn idle_time_saves_nothing_up() {
    let test = TestScheduler::new("idle", 1);
    let quota = ThreadQuota::new(usize::MAX);
    let [busy, idle] = [(); 2].map(|()| Entity::new(&quota));
    busy.vruntime.store(10_000_000_000, Ordering::SeqCst);
    for entity in [&busy, &idle] {
        test.compute(entity, |quantum| quantum.run(Calls(&|| {}, 1), LITTLE));
    }
    assert!(idle.vruntime.load(Ordering::SeqCst) >= 10_000_000_000);
}

#[test]
fn every_piece_is_done_once_and_on_no_more_threads_than_there_are_permits() {
    for threads in [1, 2, 3] {
        let test = TestScheduler::new("pieces", threads);
        let quota = ThreadQuota::new(usize::MAX);
        let (running, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let mut cells = vec![vec![0; 257]; 8];
        thread::scope(|scope| {
            for cells in &mut cells {
                let (running, most, test, quota) = (&running, &most, &test, &quota);
                scope.spawn(move || {
                    let entity = Entity::new(quota);
                    for _ in 0..20 {
                        let work = Count { cells, running, most };
                        test.compute(&entity, |quantum| quantum.run(work, LITTLE));
                    }
                });
            }
        });
        assert!(cells.iter().flatten().all(|cell| *cell == 20));
        assert!(most.into_inner() <= threads);
        assert_eq!(test.state(), (threads, 0));
    }
}

#[test]
fn a_quota_is_not_exceeded_and_the_rest_is_for_others() {
    let test = TestScheduler::new("quotas", 3);
    let (small, large) = (ThreadQuota::new(1), ThreadQuota::new(usize::MAX));
    let (running, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let (others, most_others) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let mut cells = vec![vec![0; 129]; 8];
    thread::scope(|scope| {
        for (index, cells) in cells.iter_mut().enumerate() {
            let (quota, running, most) = match index % 2 {
                0 => (&small, &running, &most),
                _ => (&large, &others, &most_others),
            };
            let test = &test;
            scope.spawn(move || {
                let work = Count { cells, running, most };
                test.compute(&Entity::new(quota), |quantum| quantum.run(work, LITTLE));
            });
        }
    });
    assert!(cells.iter().flatten().all(|cell| *cell == 1));
    assert_eq!(most.into_inner(), 1);
    assert!(most_others.into_inner() <= 3);
    assert_eq!(test.state(), (3, 0));
    assert!(test.scheduler.busy() > Duration::ZERO);
}
