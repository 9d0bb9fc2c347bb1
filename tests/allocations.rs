//! What a step allocates: nothing, neither in an environment nor on either side of a session. The
//! transport itself (iceoryx2 0.10) takes memory from the heap for each request, of a fixed size and
//! number, whatever the request holds: the state of a message that is being written, and the
//! server's count of replies. That is counted, and must not become more.
//!
//! Server and client run in this process, so that one allocator counts for both, thread by thread.

#![expect(clippy::unwrap_used, reason = "a panic is a test's report, in its helpers too")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::Duration;

use trocar_client::{Autoreset, Client, Options, Session, SessionRequest};
use trocar_proto::spec::OptionValue;
use trocar_server::service::{ServerConfig, StopSignal, serve};
use trocar_server::{Env, Registry};

/// What the transport allocates for each request.
const TRANSPORT_IN_CLIENT: u64 = 1;
const TRANSPORT_IN_SERVER: u64 = 2;

/// Threads that can be told apart.
const THREADS: usize = 64;

/// Allocations of each thread, in the order in which they allocated first.
static ALLOCATIONS: [AtomicU64; THREADS] = [const { AtomicU64::new(0) }; THREADS];
static SEEN: AtomicUsize = AtomicUsize::new(0);

thread_local! {
    static THREAD: Cell<Option<usize>> = const { Cell::new(None) };
}

/// The system's allocator, which counts.
struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The number of this thread.
fn this_thread() -> usize {
    THREAD.with(|thread| {
        let number = thread.get().unwrap_or_else(|| SEEN.fetch_add(1, Ordering::Relaxed));
        thread.set(Some(number));
        number
    })
}

fn count() {
    ALLOCATIONS[this_thread() % THREADS].fetch_add(1, Ordering::Relaxed);
}

#[allow(unsafe_code)]
// SAFETY: every call goes to the system's allocator as it came; counting allocates nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller's promises are the system allocator's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: as above.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: as above.
        unsafe { System.realloc(memory, layout, size) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(memory, layout) }
    }
}

/// Allocations of those threads that are `counted`, by their numbers, while `act` runs.
fn allocations(counted: impl Fn(usize) -> bool, act: impl FnOnce()) -> u64 {
    let count = || {
        let threads = ALLOCATIONS.iter().enumerate().filter(|(thread, _)| counted(*thread));
        threads.map(|(_, count)| count.load(Ordering::Relaxed)).sum::<u64>()
    };
    let before = count();
    act();
    count() - before
}

/// Tasks whose steps need no contacts and no camera under `wander`, and options under which steps take
/// other paths. The engine allocates where things touch; that is not counted here.
fn cases() -> Vec<(&'static str, Options)> {
    let domain = |row: &str, low, high| {
        let rows = [(row.to_string(), vec![low, high])];
        Options::new().with("domain", OptionValue::Table(rows.into()))
    };
    vec![
        ("EcmReach-v0", Options::new()),
        ("NeedleReach-v0", Options::new()),
        ("NeedlePick-v0", Options::new()),
        ("NeedlePick-v0", domain("latency", 2.0, 2.0)),
        ("NeedlePick-v0", domain("observation_noise", 0.001, 0.001)),
        ("MisOrient-v0", Options::new()),
    ]
}

/// Actions that keep every arm where it begins, above everything.
fn wander(actions: &mut [f32], step: usize) {
    actions.fill(if step.is_multiple_of(2) { 0.3 } else { -0.3 });
}

/// One test, so that no thread of another begins to allocate meanwhile.
#[test]
fn steps_allocate_nothing_but_what_the_transport_does() {
    in_process();
    through_a_session();
}

fn in_process() {
    for (task, options) in cases() {
        let mut env: Env = Registry::builtin().make(task, &options).unwrap();
        env.reset(Some(1));
        let mut action = vec![0.0; env.spec().action_dim()];
        let mut step = |env: &mut Env, number| {
            wander(&mut action, number);
            env.step(&action).unwrap();
        };
        (0..10).for_each(|number| step(&mut env, number));
        let here = this_thread();
        let count = allocations(
            |thread| thread == here,
            || {
                (10..40).for_each(|number| step(&mut env, number));
            },
        );
        assert_eq!(count, 0, "{task} {options:?}");
    }
}

/// Steps `session` so many times, by one message a step or by one for each of two groups.
fn run(session: &mut Session, actions: &mut [f32], groups: Option<[&[u32]; 2]>, steps: usize) {
    for step in 0..steps {
        wander(actions, step);
        let Some([first, second]) = groups else {
            session.step(actions).unwrap();
            continue;
        };
        let (one, other) = actions.split_at(first.len() * session.spec().action_dim());
        session.send(first, one).unwrap();
        session.send(second, other).unwrap();
        session.recv().unwrap();
        session.recv().unwrap();
    }
}

/// Ends a server, also where the test fails: its thread would else be waited for without end.
struct StopAtEnd<'a>(&'a StopSignal);

impl Drop for StopAtEnd<'_> {
    fn drop(&mut self) {
        self.0.set();
    }
}

fn through_a_session() {
    const ENVS: u32 = 8;
    let name = format!("t{}-alloc", std::process::id());
    let mut config = ServerConfig::new(name.parse().unwrap());
    config.threads = 1;
    let signal = StopSignal::default();
    // The thread that answers control messages, and looks for dead clients.
    let control = AtomicUsize::new(THREADS);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            control.store(this_thread(), Ordering::Relaxed);
            serve(Registry::builtin(), &config, &signal, || {}).unwrap();
        });
        let _stop = StopAtEnd(&signal);
        let client = loop {
            match Client::connect(&name) {
                Ok(client) => break client,
                Err(_) => std::thread::sleep(Duration::from_millis(5)),
            }
        };
        for (task, options) in cases() {
            let request = SessionRequest::new(task)
                .envs(ENVS)
                .autoreset(Autoreset::Disabled)
                .options(options.clone());
            let mut session = client.open(&request).unwrap();
            let (here, control) = (this_thread(), control.load(Ordering::Relaxed));
            let mut actions = vec![0.0; session.envs() * session.spec().action_dim()];
            let ids: Vec<u32> = (0..ENVS).collect();
            for groups in [None, Some([&ids[..3], &ids[3..]])] {
                const STEPS: usize = 8;
                session.reset().unwrap();
                run(&mut session, &mut actions, groups, STEPS);
                // The last request is let go of when its reply is on its way; an earlier session may be, too.
                let settle = || std::thread::sleep(Duration::from_millis(20));
                settle();
                let mut in_client = 0;
                // Whichever of its threads answers; when one more is started meanwhile, it allocates once.
                let in_server = (0..4).map(|_| {
                    allocations(
                        |thread| ![here, control].contains(&thread),
                        || {
                            in_client = allocations(
                                |thread| thread == here,
                                || {
                                    run(&mut session, &mut actions, groups, STEPS);
                                },
                            );
                            settle();
                        },
                    )
                });
                let in_server = in_server.min().expect("it was counted");
                let requests = STEPS as u64 * if groups.is_some() { 2 } else { 1 };
                let what = format!("{task} {options:?}, {groups:?}");
                assert_eq!(in_client, TRANSPORT_IN_CLIENT * requests, "client: {what}");
                assert_eq!(in_server, TRANSPORT_IN_SERVER * requests, "server: {what}");
            }
        }
    });
}
