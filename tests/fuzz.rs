//! Hostile bytes sent to a running server, on its control service and on a session's data service:
//! it lives, and a client beside them sees the same bits. `TROCAR_SOAK` sends more.

#[path = "../server/tests/mutation/mod.rs"]
mod mutation;

use std::sync::Arc;

use mutation::Mutator;
use rand::{RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;
use trocar_client::{CallError, SessionRequest};
use trocar_proto::control::ControlRequest;
use trocar_proto::wire::{Header, kind};
use trocar_server::Registry;
use trocar_server::service::{Admission, ServerConfig, Usage};

use crate::harness::{Server, eventually, soak};
use crate::twin::Bystander;

fn count() -> usize {
    if soak() { 50_000 } else { 2_000 }
}

#[test]
fn hostile_control_messages_do_not_harm_a_running_server() {
    let server = Server::start_with(&["--max-envs", "16", "--memory", "64MiB"]);
    let bystander = Bystander::start(&server);
    let client = server.connect();
    let registry = Registry::builtin();
    let ids: Vec<String> = registry.ids().map(str::to_string).collect();
    let ids: Vec<&str> = ids.iter().map(String::as_str).collect();
    let mut mutator = Mutator::new(7, &ids);
    let config = ServerConfig::new(server.name().parse().unwrap());
    let admission = Admission::new(Arc::new(registry), &config, 1);
    for index in 0..count() {
        let message = mutator.next();
        // To end the server is every client's right, so it is no attack.
        let checked = admission.check(&message.header, &message.bytes, &Usage::default());
        if checked.is_ok_and(|message| message.request == ControlRequest::Shutdown) {
            continue;
        }
        if let Err(error) = client.send_raw(message.header, &message.bytes) {
            panic!("message {index} of {message:?}: {error}");
        }
    }
    bystander.finish();
    // Sessions that were opened in the name of clients that do not exist.
    eventually("they are gone", || client.status().unwrap().sessions.is_empty());
    Bystander::start(&server).finish();
}

#[test]
fn hostile_data_messages_harm_nobody_else() {
    let server = Server::start();
    let bystander = Bystander::start(&server);
    let mut session = server.open(&SessionRequest::new("NeedleReach-v0").envs(3));
    session.reset().unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let (mut refused, mut done) = (0, 0);
    for _ in 0..count() {
        let mut header = Header {
            kind: [kind::STEP, kind::RESET, rng.next_u32() % 9][rng.next_u32() as usize % 3],
            flags: rng.next_u32(),
            session: session.info().session,
            epoch: session.info().epoch,
            rows: rng.next_u32() % 5,
            ..Header::new(0)
        };
        match rng.next_u32() % 16 {
            0 => header.kind = rng.next_u32(),
            1 => header.rows = rng.next_u32(),
            2 => header.session = rng.next_u64(),
            3 => header.magic = rng.next_u32(),
            4 => header.protocol = rng.next_u32(),
            5 => header.length = rng.next_u32(),
            6 => header.status = rng.next_u32(),
            _ => {}
        }
        let garbage = rng.next_u32() % 4;
        let result = session.call_raw(header, |payload| match garbage {
            0 => rng.fill_bytes(payload),
            1 => payload.fill(0xff),
            2 => payload[64..].fill(0),
            _ => {
                payload.fill(0);
                for (at, id) in [(0, 0_u8), (4, 1), (8, 2)] {
                    payload[at] = id;
                }
            }
        });
        match result {
            Ok(_) => done += 1,
            Err(CallError::Refused(_)) => refused += 1,
            Err(other) => panic!("{header:?}: {other}"),
        }
    }
    assert!(refused > count() / 10 && done > count() / 10, "{refused}, {done}");
    bystander.finish();
}
