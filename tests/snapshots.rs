//! Snapshot, restore and fork through a session: the same bits as in-process, at any moment, in
//! every autoreset mode; snapshots as bytes go to another server; what cannot be is refused.

use rand::{RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;
use trocar_client::{Autoreset, CallError, Code, Options, Session, SessionRequest};
use trocar_server::{Env, Registry};

use crate::harness::{Server, eventually, tasks};
use crate::rows::{Policy, Row, act, policies};
use crate::twin::{Bystander, Twin};

const ENVS: u32 = 3;
const ALL: [u32; 3] = [0, 1, 2];

/// Steps after which everything must still be the same.
const AFTER: usize = 10;

/// A session, and the same environments in-process.
struct Pair {
    session: Session,
    twin: Twin,
    mode: Autoreset,
    policies: Vec<Policy>,
    rows: Vec<Row>,
}

impl Pair {
    fn new(server: &Server, task: &str, mode: Autoreset) -> Self {
        let request = SessionRequest::new(task).envs(ENVS).seed(40).autoreset(mode);
        let mut session = server.open(&request);
        let mut twin = Twin::new(task, &Options::new(), ENVS as usize, 40).autoreset(mode);
        let rows = Row::all(&session.reset().unwrap(), mode);
        assert_eq!(rows, twin.reset(&ALL, None));
        Self { session, twin, mode, policies: policies(3, ENVS as usize), rows }
    }

    /// Steps both, and finds the same.
    fn step(&mut self) {
        let actions = act(&mut self.policies, &self.rows);
        match self.session.step(&actions) {
            Ok(reply) => {
                self.rows = Row::all(&reply, self.mode);
                drop(reply);
                assert_eq!(self.rows, self.twin.step(&ALL, &actions).unwrap());
            }
            Err(CallError::Refused(refusal)) if refusal.code == Code::ResetNeeded => {
                assert_eq!(self.twin.step(&ALL, &actions), Err(Code::ResetNeeded));
                self.rows = Row::all(&self.session.reset().unwrap(), self.mode);
                assert_eq!(self.rows, self.twin.reset(&ALL, None));
            }
            Err(other) => panic!("{other}"),
        }
    }

    fn steps(&mut self, count: usize) -> Vec<Vec<Row>> {
        (0..count)
            .map(|_| {
                self.step();
                self.rows.clone()
            })
            .collect()
    }
}

#[test]
fn what_follows_a_restore_is_what_followed_the_snapshot() {
    let server = Server::start();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for task in tasks() {
        for mode in [Autoreset::NextStep, Autoreset::SameStep, Autoreset::Disabled] {
            let mut pair = Pair::new(&server, task, mode);
            // Any moment, and the one between the end of an episode and its reset.
            let last = pair.twin.spec().max_steps as usize;
            for steps in [rng.next_u32() as usize % last, last - 1 - rng.next_u32() as usize % 5, 5]
            {
                pair.steps(steps);
                let (twin, rows) = (pair.twin.clone(), pair.rows.clone());
                let snapshot = pair.session.snapshot().unwrap();
                let policies = pair.policies.clone();
                let first = pair.steps(AFTER);

                let shown = Row::all(&pair.session.restore(&snapshot).unwrap(), mode);
                assert_eq!(shown, pair.twin.go_on_from(&twin, &ALL, &ALL), "{task} {mode:?}");
                assert!(
                    shown.iter().zip(&rows).all(|(now, then)| now.observation == then.observation)
                );
                (pair.rows, pair.policies) = (rows, policies);
                assert_eq!(pair.steps(AFTER), first, "{task} {mode:?}");
            }
        }
    }
}

#[test]
fn the_end_of_an_episode_is_part_of_a_snapshot() {
    let server = Server::start();
    for mode in [Autoreset::NextStep, Autoreset::Disabled] {
        let mut pair = Pair::new(&server, "EcmReach-v0", mode);
        let max_steps = pair.twin.spec().max_steps as usize;
        pair.steps(max_steps);
        assert!(pair.rows.iter().all(|row| row.truncated));
        let (snapshot, twin) = (pair.session.snapshot().unwrap(), pair.twin.clone());
        pair.session.reset().unwrap();
        pair.session.restore(&snapshot).unwrap();
        pair.twin = twin;
        pair.step(); // resets, or is refused, as its twin's
        assert!(pair.rows.iter().all(|row| (row.steps, row.episode) == (0, 1)));
    }
}

#[test]
fn one_environment_goes_on_in_many_and_many_in_any_order() {
    let server = Server::start();
    for task in tasks() {
        let mut pair = Pair::new(&server, task, Autoreset::NextStep);
        pair.steps(12);
        let mode = pair.mode;
        let before = pair.twin.clone();
        // A rotation: what counts is the state before the fork.
        let shown = Row::all(&pair.session.fork(&[2, 0, 1], &ALL).unwrap(), mode);
        pair.rows = pair.twin.go_on_from(&before, &[2, 0, 1], &ALL);
        assert_eq!(shown, pair.rows);
        pair.steps(5);
        let before = pair.twin.clone();
        let shown = Row::all(&pair.session.fork(&[1], &[0, 2]).unwrap(), mode);
        assert_eq!(shown, pair.twin.go_on_from(&before, &[1, 1], &[0, 2]));
        pair.rows = vec![shown[0].clone(), pair.rows[1].clone(), shown[1].clone()];
        pair.steps(5);
        // The same by a snapshot of one, and by one state of a snapshot of three.
        let (one, three) =
            (pair.session.snapshot_envs(&[1]).unwrap(), pair.session.snapshot().unwrap());
        let before = pair.twin.clone();
        pair.steps(5);
        for snapshot in [one, three.select(&[1])] {
            let shown = Row::all(&pair.session.restore(&snapshot).unwrap(), mode);
            assert_eq!(shown, pair.twin.go_on_from(&before, &[1, 1, 1], &ALL));
        }
        pair.rows = pair.twin.go_on_from(&before, &[1, 1, 1], &ALL);
        pair.steps(AFTER);
    }
}

#[test]
fn exported_states_go_on_in_another_server() {
    let (first, second) = (Server::start(), Server::start());
    let bystander = Bystander::start(&second);
    for task in tasks() {
        let mut pair = Pair::new(&first, task, Autoreset::NextStep);
        pair.steps(17);
        let snapshot = pair.session.snapshot().unwrap();
        let bytes = pair.session.export(&snapshot).unwrap();
        assert!(bytes.len() < 8192, "{} bytes", bytes.len());
        let mut other = Pair::new(&second, task, Autoreset::NextStep);
        other.steps(3);
        let imported = other.session.import(&bytes).unwrap();
        assert_eq!(imported.len(), 3);
        // Imported states are exported again as they came, restored or not.
        assert_eq!(other.session.export(&imported).unwrap(), bytes);
        other.session.restore(&imported).unwrap();
        assert_eq!(other.session.export(&imported).unwrap(), bytes);
        other.rows = other.twin.go_on_from(&pair.twin, &ALL, &ALL);
        other.policies.clone_from(&pair.policies);
        assert_eq!(other.steps(40), pair.steps(40), "{task}");
        // And in-process.
        let part = pair.session.export(&snapshot.select(&[2])).unwrap();
        let mut env = Registry::builtin().make(task, &Options::new()).unwrap();
        env = env.import(&part).unwrap();
        env.reset(None);
        assert_eq!((env.seed(), env.episode()), (42, 1));
    }
    bystander.finish();
}

/// Fails unless it was refused with `code`, in a text that has all of `parts`.
fn refused<T>(result: Result<T, CallError>, code: Code, parts: &[&str]) {
    match result {
        Err(CallError::Refused(refusal)) => {
            assert_eq!(refusal.code, code, "{refusal}");
            let text = refusal.to_string();
            assert!(parts.iter().all(|part| text.contains(part)), "{text:?}: {parts:?}");
        }
        Err(error) => panic!("{error}"),
        Ok(_) => panic!("not refused: {parts:?}"),
    }
}

#[test]
fn what_cannot_be_saved_or_restored_is_refused_and_changes_nothing() {
    let server = Server::start();
    let mut pair = Pair::new(&server, "EcmReach-v0", Autoreset::NextStep);
    let mut other = Pair::new(&server, "EcmReach-v0", Autoreset::NextStep);
    pair.steps(3);
    let snapshot = pair.session.snapshot().unwrap();
    let bytes = pair.session.export(&snapshot).unwrap();
    let foreign = ["snapshot", "of session", "export"];
    refused(other.session.restore(&snapshot), Code::UnknownSnapshot, &foreign);
    refused(other.session.export(&snapshot), Code::UnknownSnapshot, &foreign);
    refused(
        pair.session.restore_envs(&[0, 1], &snapshot),
        Code::InvalidEnvIds,
        &["env_ids", "2 environments", "of 3 goes into 3"],
    );
    refused(pair.session.snapshot_envs(&[2, 1]), Code::InvalidEnvIds, &["env_ids", "below 3"]);
    refused(pair.session.fork(&[3], &[0]), Code::InvalidEnvIds, &["source", "3", "below 3"]);
    refused(
        pair.session.fork(&[0, 1], &ALL),
        Code::InvalidEnvIds,
        &["source", "2 numbers", "or 3"],
    );

    let snapshot_of = |session: &mut Session, change: fn(&mut Vec<u8>)| {
        let mut bytes = bytes.clone();
        change(&mut bytes);
        session.import(&bytes)
    };
    let invalid = Code::InvalidSnapshot;
    refused(
        snapshot_of(&mut pair.session, |all| all.truncate(100)),
        invalid,
        &["snapshot", "cut off"],
    );
    refused(snapshot_of(&mut pair.session, Vec::clear), invalid, &["snapshot", "cut off"]);
    refused(snapshot_of(&mut pair.session, |all| all[40] ^= 4), invalid, &["snapshot.checksum"]);
    refused(snapshot_of(&mut pair.session, |all| all[0] = 0), invalid, &["snapshot.magic"]);
    refused(
        snapshot_of(&mut pair.session, |all| all[8] += 1),
        Code::VersionMismatch,
        &["snapshot.protocol version", "export it again"],
    );
    let mut reach = server.open(&SessionRequest::new("NeedleReach-v0"));
    refused(reach.import(&bytes), invalid, &["snapshot.task", "EcmReach-v0", "NeedleReach-v0"]);
    let options = Options::new().with_text("reward", "dense");
    let mut dense = server.open(&SessionRequest::new("EcmReach-v0").options(options));
    refused(dense.import(&bytes), invalid, &["snapshot.options.reward", "sparse", "dense"]);

    let mut fresh = server.open(&SessionRequest::new("EcmReach-v0").envs(2));
    refused(fresh.snapshot(), Code::ResetNeeded, &["env", "never reset"]);
    refused(fresh.fork(&[0], &[1]), Code::ResetNeeded, &["env", "never reset"]);

    // What is under way is neither saved, nor restored, nor a source.
    let action = vec![0.0; 3];
    pair.session.send(&[1], &action).unwrap();
    let busy = ["env_ids", "under way"];
    refused(pair.session.start_snapshot(None), Code::InvalidEnvIds, &busy);
    refused(pair.session.start_restore(None, &snapshot), Code::InvalidEnvIds, &busy);
    refused(pair.session.start_fork(&[1], Some(&[0])), Code::InvalidEnvIds, &busy);
    // The others may be.
    pair.session.start_snapshot(Some(&[0, 2])).unwrap();
    pair.session.recv().unwrap();
    assert_eq!(pair.session.recv().unwrap().into_snapshot().unwrap().len(), 2);
    pair.twin.step(&[1], &action).unwrap();
    pair.steps(10);
    other.steps(10);
}

#[test]
fn a_number_of_another_session_is_unknown_even_where_it_is_guessed() {
    let server = Server::start();
    let mut one = Pair::new(&server, "EcmReach-v0", Autoreset::NextStep);
    let mut two = Pair::new(&server, "EcmReach-v0", Autoreset::NextStep);
    let _kept = one.session.snapshot().unwrap();
    let info = two.session.info().clone();
    let layout = trocar_proto::wire::RequestLayout::new(ENVS as usize, &info.spec);
    for number in 0..20 {
        let header = trocar_proto::wire::Header {
            session: info.session,
            epoch: info.epoch,
            rows: 1,
            ..trocar_proto::wire::Header::new(trocar_proto::wire::kind::RESTORE)
        };
        let sent = two.session.call_raw(header, |payload| {
            layout.env_ids.view_mut::<u32>(payload, 1)[0] = 0;
            layout.numbers.view_mut::<u64>(payload, 1)[0] = number;
        });
        let Err(CallError::Refused(refusal)) = sent else { panic!("{number} was restored") };
        assert_eq!((refusal.code, refusal.value), (Code::UnknownSnapshot, number.to_string()));
    }
    two.steps(3);
}

#[test]
fn snapshots_count_against_the_budget_until_they_are_dropped() {
    let budget = 16 << 20;
    let server = Server::start_with(&["--memory", "16MiB"]);
    let client = server.connect();
    let mut pair = Pair::new(&server, "EcmReach-v0", Autoreset::NextStep);
    let taken = client.status().unwrap().memory_bytes;
    let mut kept = vec![];
    let refusal = loop {
        match pair.session.snapshot() {
            Ok(snapshot) => kept.push(snapshot),
            Err(CallError::Refused(refusal)) => break refusal,
            Err(other) => panic!("{other}"),
        }
        assert!(kept.len() < 1000);
    };
    assert_eq!((refusal.code, refusal.field.as_str()), (Code::MemoryBudget, "snapshots"));
    assert!(refusal.allowed.contains("16.0 MiB") && refusal.allowed.contains("--memory"));
    let held = kept.len() as u64 * u64::from(ENVS) * Env::MEMORY_BYTES;
    assert_eq!(client.status().unwrap().memory_bytes, taken + held);
    assert!(taken + held <= budget);
    // Nor is there room for another session.
    let full = client.open(&SessionRequest::new("EcmReach-v0").envs(4));
    assert!(matches!(full, Err(CallError::Refused(refusal)) if refusal.code == Code::MemoryBudget));
    pair.session.restore(&kept[0]).unwrap();
    let last = kept.len() - 1;
    let (clone, part) = (kept[last].clone(), kept[last].select(&[1]));
    drop((kept, clone));
    let one = pair.session.snapshot().unwrap();
    let left = client.status().unwrap().memory_bytes - taken;
    assert_eq!(left, 4 * Env::MEMORY_BYTES, "three of one, one that is still selected");
    drop((part, one));
    drop(pair);
    // They end with their session.
    eventually("the session is closed", || client.status().unwrap().memory_bytes == 0);
}
