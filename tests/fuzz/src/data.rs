//! A session's messages: headers and payloads, in a server of this process.

use std::sync::{Mutex, PoisonError};

use trocar_client::{Autoreset, CallError, Options, SessionRequest};
use trocar_proto::spec::OptionValue;
use trocar_proto::wire::{Header, flag, kind};

use crate::control::check;
use crate::hosted::{self, Known};
use crate::input::Input;

/// Most messages of an input.
const MOST_MESSAGES: usize = 6;

/// Sessions of the server; one is opened anew once it has snapshots, which would fill its memory.
static SESSIONS: Mutex<[Option<Known>; 3]> = Mutex::new([const { None }; 3]);

/// A byte that says which session, and messages: a kind, flags, rows, and what is unusual about them.
pub(crate) fn run(data: &[u8]) {
    let server = hosted::server();
    let mut input = Input::new(data);
    let number = input.byte() as usize % 3;
    let mut sessions = SESSIONS.lock().unwrap_or_else(PoisonError::into_inner);
    let known = sessions[number].get_or_insert_with(|| server.open(&request(number)));
    let mut is_full = false;
    for _ in 0..MOST_MESSAGES {
        if input.is_empty() {
            break;
        }
        is_full |= message(known, &mut input);
    }
    known.check();
    if is_full {
        sessions[number] = None;
    }
}

fn request(number: usize) -> SessionRequest {
    let size = OptionValue::Numbers(vec![16.0, 16.0]);
    let joints = Options::new().with_text("action", "joint");
    match number {
        0 => SessionRequest::new("EcmReach-v0").envs(3),
        1 => SessionRequest::new("NeedleReach-v0").envs(2).autoreset(Autoreset::SameStep),
        _ => SessionRequest::new("NeedleReach-v0")
            .options(joints)
            .autoreset(Autoreset::Disabled)
            .view(Options::new().with("image_size", size)),
    }
}

const HAS_HEADER: u8 = 16;
const HAS_EDITS: u8 = 32;

/// Sends a message; whether it took snapshots.
fn message(known: &mut Known, input: &mut Input<'_>) -> bool {
    let session = &mut known.session;
    let (form, flags, rows) = (input.byte(), input.byte(), input.byte());
    let info = session.info();
    let mut header = Header {
        flags: flags.into(),
        session: info.session,
        epoch: info.epoch,
        rows: u32::from(rows) % (info.envs + 2),
        ..Header::new(u32::from(form % 8))
    };
    if form & HAS_HEADER != 0 {
        unusual(&mut header, input);
    }
    let mut edits = vec![];
    if form & HAS_EDITS != 0 {
        for _ in 0..=input.byte() % 4 {
            let (at, count) = (input.u16() as usize, input.byte() as usize % 33);
            edits.push((at, input.take(count)));
        }
    }
    let envs = info.envs;
    let sent = session.call_raw(header, |payload| {
        payload.fill(0);
        for (place, env) in payload.chunks_exact_mut(4).zip(0..envs) {
            place.copy_from_slice(&env.to_le_bytes());
        }
        for (at, bytes) in edits {
            let at = at % payload.len();
            let room = bytes.len().min(payload.len() - at);
            payload[at..at + room].copy_from_slice(&bytes[..room]);
        }
    });
    match sent {
        Ok(reply) => {
            assert!(reply.rows() <= envs as usize);
            header.kind == kind::SNAPSHOT
        }
        Err(CallError::Refused(refusal)) => {
            check(&refusal);
            false
        }
        Err(other) => panic!("{header:?}: {other}"),
    }
}

/// Gives some of the header's fields any value.
fn unusual(header: &mut Header, input: &mut Input<'_>) {
    let mask = input.byte();
    for (bit, field) in [
        &mut header.kind,
        &mut header.flags,
        &mut header.rows,
        &mut header.magic,
        &mut header.protocol,
        &mut header.length,
    ]
    .into_iter()
    .enumerate()
    {
        if mask & 1 << bit != 0 {
            *field = input.u32();
        }
    }
    for (bit, field) in [(6, &mut header.session), (7, &mut header.epoch)] {
        if mask & 1 << bit != 0 {
            *field = input.u64();
        }
    }
}

pub(crate) fn seeds() -> Vec<Vec<u8>> {
    let mut seeds = vec![last_episode()];
    for session in 0..3 {
        let all = 1 + session % 2;
        // A reset, a step, snapshots, a fork.
        seeds.push(vec![session, 1, 0, all, 2, 1, all, 3, 0, 1, 5, 1, 1]);
        for kind in 1..8 {
            // After a reset: parts of environments, actions, numbers and episodes are set.
            let edits = [
                edit(0, &[0, 0, 0, 0]),
                edit(64, &[0, 0, 0, 63]),
                edit(128, &[1, 0]),
                edit(192, &[1]),
            ];
            let edited = [vec![kind | HAS_EDITS, 3, 1, 3], edits.concat()].concat();
            seeds.push([vec![session, 1, 0, all], edited].concat());
            seeds.push(vec![session, 1, 0, all, kind | HAS_HEADER, 0, 1, kind, 1, 0, 0, 0]);
        }
    }
    seeds
}

/// The last of all episodes, and the one after it.
fn last_episode() -> Vec<u8> {
    let seeded = vec![kind::RESET as u8 | HAS_EDITS, flag::HAS_SEEDS as u8, 1, 0];
    [vec![0], seeded, edit(192, &[0xff; 8]), vec![kind::RESET as u8, 0, 1]].concat()
}

/// Bytes of the payload.
fn edit(at: u16, bytes: &[u8]) -> Vec<u8> {
    [&at.to_le_bytes(), [bytes.len() as u8].as_slice(), bytes].concat()
}
