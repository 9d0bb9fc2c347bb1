//! Rubbish in what Trocar shares with its clients, written while others step: the words on which servers and clients
//! sleep, those of all sessions, and the headers and payloads of a client's own requests and replies. `TROCAR_SOAK`
//! goes on for ten minutes.
//!
//! The transport's own bookkeeping and other sessions' payloads are left out: no check between processes of one user
//! could protect them.

use std::fs::{self, OpenOptions};
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rand::{RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;
use trocar_client::{CallError, Session, SessionRequest};
use trocar_proto::endpoint::Endpoint;
use trocar_proto::wire::{Header, MAGIC, ReplyLayout, kind};

use crate::harness::{Server, soak};
use crate::twin::Bystander;

/// Environments of the session whose memory is written to.
const ENVS: usize = 3;

/// How many words are written between two looks at which files there are.
const LOOK: usize = 64;

/// Bytes of a file that may be written to.
struct Place {
    path: PathBuf,
    bytes: Range<u64>,
}

impl Place {
    /// Writes up to 16 bytes of rubbish somewhere into it; a file that is gone by now has no bytes.
    fn spoil(&self, rng: &mut ChaCha8Rng) {
        let Ok(file) = OpenOptions::new().write(true).open(&self.path) else { return };
        let mut rubbish = [[0; 16], [0xff; 16], [0; 16]][rng.next_u32() as usize % 3];
        if rng.next_u32().is_multiple_of(2) {
            rng.fill_bytes(&mut rubbish);
        }
        let at = self.bytes.start + rng.next_u64() % (self.bytes.end - self.bytes.start);
        let length = (self.bytes.end - at).min(1 + rng.next_u64() % 16);
        file.write_all_at(&rubbish[..length as usize], at).ok();
    }
}

/// The words of the server and of all its sessions.
fn words(endpoint: &Endpoint) -> Vec<Place> {
    let named = |path: &Path| path.to_string_lossy().contains(".notify.");
    let files = endpoint.files().unwrap();
    let places = files.into_iter().filter(|path| named(path)).filter_map(|path| {
        let bytes = 0..fs::metadata(&path).ok()?.len();
        (bytes.end > 0).then_some(Place { path, bytes })
    });
    places.collect()
}

/// Where headers of this client, with `payload` bytes after each, lie before or around what is marked: the mark is
/// `offset` bytes after the payload's beginning.
fn messages(endpoint: &Endpoint, mark: &[u8], offset: usize, payload: usize) -> Vec<Place> {
    let before = size_of::<Header>() + offset;
    let mut places = vec![];
    for path in endpoint.files().unwrap().into_iter().filter(|path| path.is_file()) {
        let bytes = fs::read(&path).unwrap_or_default();
        for at in (0..bytes.len()).filter(|at| bytes[*at..].starts_with(mark)) {
            let Some(start) = at.checked_sub(before) else { continue };
            if bytes[start..].starts_with(&MAGIC.to_le_bytes()) {
                let end = start + size_of::<Header>() + payload;
                places.push(Place { path: path.clone(), bytes: start as u64..end as u64 });
            }
        }
    }
    places
}

/// Where requests and replies of this session lie.
fn own_messages(endpoint: &Endpoint, session: &mut Session) -> Vec<Place> {
    let mark: [u64; ENVS] = [0x1234_5678_9abc_def0, 0x0fed_cba9_8765_4321, 0x5a5a_a5a5_3c3c_c3c3];
    let replies = ReplyLayout::new(ENVS, session.spec());
    let bytes = mark.map(u64::to_le_bytes).concat();
    let mut size = 0;
    // More often than there is room for messages, so that each room is used.
    for _ in 0..32 {
        session.reset_envs(&[0, 1, 2], Some(&mark)).unwrap();
        let header = Header {
            session: session.info().session,
            epoch: session.info().epoch,
            rows: ENVS as u32,
            ..Header::new(kind::FORK + 100)
        };
        let refused = session.call_raw(header, |payload| {
            size = payload.len();
            payload[..bytes.len()].copy_from_slice(&bytes);
        });
        assert!(matches!(refused, Err(CallError::Refused(_))), "{refused:?}");
    }
    let requests = messages(endpoint, &bytes, 0, size);
    let answers = messages(endpoint, &bytes, replies.seed.offset, replies.bytes);
    assert!(!requests.is_empty() && !answers.is_empty(), "{} {}", requests.len(), answers.len());
    requests.into_iter().chain(answers).collect()
}

/// Steps, resets, keeps and brings back states; what comes of it is this client's own affair, unless its server is gone.
fn work(session: &mut Session, rng: &mut ChaCha8Rng) -> Result<(), CallError> {
    let actions = vec![0.5; ENVS * session.spec().action_dim()];
    session.step(&actions)?;
    if rng.next_u32().is_multiple_of(16) {
        session.reset()?;
        let snapshot = session.snapshot()?;
        session.restore(&snapshot)?;
        let mut bytes = session.export(&snapshot.select(&[1]))?;
        let at = rng.next_u32() as usize % bytes.len();
        bytes[at] ^= 1 << (rng.next_u32() % 8);
        let spoiled = session.import(&bytes)?;
        session.restore_envs(&[0], &spoiled)?;
    }
    Ok(())
}

#[test]
fn rubbish_in_what_is_shared_harms_nobody_else() {
    let seconds = if soak() { 600 } else { 4 };
    let server = Server::start();
    let endpoint = server.endpoint();
    let others: Vec<Bystander> = (0..2).map(|_| Bystander::start(&server)).collect();
    let mut session = server.open(&SessionRequest::new("NeedleReach-v0").envs(ENVS as u32));
    session.reset().unwrap();
    let own = own_messages(&endpoint, &mut session);
    let (stop, start) = (AtomicBool::new(false), Instant::now());
    let (mut done, mut refused, mut late, mut later) = (0, 0, 0, 0);
    let written = std::thread::scope(|scope| {
        let writer = scope.spawn(|| {
            let mut rng = ChaCha8Rng::seed_from_u64(5);
            let mut written = 0;
            while !stop.load(Ordering::Acquire) {
                let places = words(&endpoint);
                for _ in 0..LOOK {
                    let some = if rng.next_u32().is_multiple_of(2) { &own } else { &places };
                    some[rng.next_u32() as usize % some.len()].spoil(&mut rng);
                    written += 1;
                }
                std::thread::yield_now();
            }
            written
        });
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        while start.elapsed() < Duration::from_secs(seconds) {
            match work(&mut session, &mut rng) {
                Ok(()) => done += 1,
                Err(CallError::ServerLost { .. }) => panic!("the server is gone"),
                Err(CallError::Timeout { .. }) => late += 1,
                Err(_) => refused += 1,
            }
            if rng.next_u32().is_multiple_of(64) {
                // Another opens, steps and closes meanwhile.
                Bystander::start(&server).finish();
                later += 1;
            }
        }
        stop.store(true, Ordering::Release);
        writer.join().unwrap()
    });
    eprintln!(
        "{written} times rubbish; {done} rounds went well, {refused} were refused, {late} were late; {later} others \
         came and went"
    );
    assert!(done > 0 && refused > 0, "{done}, {refused}");
    others.into_iter().for_each(Bystander::finish);
    // Its session is no worse off.
    let open = server.connect().status().unwrap().sessions;
    assert!(open.iter().any(|one| one.id == session.info().session), "{open:?}");
    session.settle(Duration::from_secs(10)).unwrap();
    session.reset().unwrap();
    Bystander::start(&server).finish();
}
