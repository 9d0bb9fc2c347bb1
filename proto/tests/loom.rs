//! Every order in which two producers and a sleeper can use the doorbell and an event count: no wake-up is lost. And
//! the model finds the loss where a fence is missing, or where the sleeper looks before it announces itself.

use std::process::Command;
use std::time::Duration;

use loom::sync::Arc;
use loom::thread;
use trocar_proto::notify::doorbell::Words;
use trocar_proto::notify::event_count::EventCount;
use trocar_proto::notify::{Model, Platform};

/// The model, without fences.
#[derive(Debug)]
struct Unfenced;

impl Platform for Unfenced {
    type Futex = <Model as Platform>::Futex;
    type Flags = <Model as Platform>::Flags;

    fn fence() {}
}

const FOREVER: Duration = Duration::MAX;

/// Explores `threads` with so many preemptions of each thread as find all known losses.
fn explore(threads: impl Fn() + Send + Sync + 'static) {
    let mut model = loom::model::Builder::new();
    model.preemption_bound = Some(3);
    model.check(threads);
}

/// Whether the exploration that the ignored test `name` makes finds an order in which a thread sleeps on for ever. It
/// ends its process.
fn loses_a_wake_up(name: &str) -> bool {
    let program = std::env::current_exe().unwrap();
    let run = Command::new(program).args(["--ignored", "--exact", "--nocapture", name]).output();
    let output = run.unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() || said.contains("deadlock"), "{said}");
    !output.status.success()
}

/// Two clients ring, and a worker takes both rings.
fn rings<P: Platform>(worker: impl Fn(&Words<P, 1>)) {
    let doorbell = Arc::new(Words::<P, 1>::default());
    let clients = [0, 1].map(|slot| {
        let doorbell = Arc::clone(&doorbell);
        thread::spawn(move || {
            doorbell.ring(slot);
        })
    });
    let mut taken = 0;
    while taken < 2 {
        worker(&doorbell);
        taken += doorbell.take().count();
    }
    for client in clients {
        client.join().unwrap();
    }
}

/// What a worker does that finds nothing, as the scheduler has it.
fn advertise_look_sleep<P: Platform>(doorbell: &Words<P, 1>) {
    let seen = doorbell.wakes();
    doorbell.advertise(true);
    if !doorbell.is_rung() {
        doorbell.sleep(seen, FOREVER);
    }
}

/// The same in the wrong order.
fn look_advertise_sleep<P: Platform>(doorbell: &Words<P, 1>) {
    let seen = doorbell.wakes();
    let rung = doorbell.is_rung();
    doorbell.advertise(true);
    if !rung {
        doorbell.sleep(seen, FOREVER);
    }
}

/// Two workers reply, and the client awaits both replies.
fn replies<P: Platform>() {
    let replies = Arc::new(EventCount::<P>::default());
    let workers = [(), ()].map(|()| {
        let replies = Arc::clone(&replies);
        thread::spawn(move || {
            if replies.signal() {
                replies.wake();
            }
        })
    });
    loop {
        let count = replies.count();
        if count == 2 {
            break;
        }
        replies.wait(count, FOREVER);
    }
    for worker in workers {
        worker.join().unwrap();
    }
}

#[test]
fn no_ring_is_lost() {
    explore(|| rings::<Model>(advertise_look_sleep));
}

#[test]
fn no_reply_is_lost() {
    explore(replies::<Model>);
}

#[test]
fn the_model_finds_what_is_lost() {
    for name in ["ring_without_fence", "ring_where_the_worker_looks_first", "reply_without_fence"] {
        assert!(loses_a_wake_up(name), "{name}");
    }
}

#[test]
#[ignore = "it loses a wake-up, as another test checks"]
fn ring_without_fence() {
    explore(|| rings::<Unfenced>(advertise_look_sleep));
}

#[test]
#[ignore = "it loses a wake-up, as another test checks"]
fn ring_where_the_worker_looks_first() {
    explore(|| rings::<Model>(look_advertise_sleep));
}

#[test]
#[ignore = "it loses a wake-up, as another test checks"]
fn reply_without_fence() {
    explore(replies::<Unfenced>);
}
