//! Bad input is refused by an error that names the field, its value and what is allowed; its client
//! can go on, and so can all others.

use std::fmt::Debug;

use trocar_client::{
    Autoreset, CallError, Client, Code, ConnectError, OptionValue, Options, Rejection, Session,
    SessionRequest,
};
use trocar_proto::PROTOCOL_VERSION;
use trocar_proto::control::ControlReply;
use trocar_proto::wire::{Header, kind};
use trocar_server::Registry;

use crate::harness::{Process, Server, eventually, serve, unique_name};
use crate::rows::{Row, act, policies};
use crate::twin::{Bystander, Twin};

fn refused<T: Debug>(result: Result<T, CallError>) -> Rejection {
    match result {
        Err(CallError::Refused(refusal)) => refusal,
        other => panic!("not refused: {other:?}"),
    }
}

/// Fails unless the refusal has the code and its text names all of `parts`.
fn assert_names(refusal: &Rejection, code: Code, parts: &[&str]) {
    assert_eq!(refusal.code, code, "{refusal}");
    let text = refusal.to_string();
    for part in parts {
        assert!(text.contains(part), "{text:?} does not name {part:?}");
    }
}

/// Fails unless a session of two environments goes on as its twin does.
fn assert_goes_on(session: &mut Session) {
    let mut twin = Twin::new(&session.spec().id, &Options::new(), 2, 0);
    let mut policies = policies(0, 2);
    let mut rows = Row::all(&session.reset_envs(&[0, 1], Some(&[5, 6])).unwrap(), MODE);
    assert_eq!(rows, twin.reset(&[0, 1], Some(&[5, 6])));
    for _ in 0..5 {
        let actions = act(&mut policies, &rows);
        rows = Row::all(&session.step(&actions).unwrap(), MODE);
        assert_eq!(rows, twin.step(&[0, 1], &actions).unwrap());
    }
}

const MODE: Autoreset = Autoreset::NextStep;

#[test]
fn sessions_that_make_no_sense_are_refused_by_name() {
    let server = Server::start();
    let bystander = Bystander::start(&server);
    let client = server.connect();
    let reach = || SessionRequest::new("EcmReach-v0");
    let with = |name: &str, value: OptionValue| reach().options(Options::new().with(name, value));
    let text = |value: &str| OptionValue::Text(value.into());
    let cases: Vec<(SessionRequest, Code, &[&str])> = vec![
        (
            SessionRequest::new("EcmReach-v9"),
            Code::UnknownTask,
            &["task", "EcmReach-v9", "EcmReach-v0", "NeedleReach-v0"],
        ),
        (SessionRequest::new(""), Code::UnknownTask, &["task", "\"\"", "EcmReach-v0"]),
        (with("rewards", text("dense")), Code::UnknownOption, &["rewards", "reward"]),
        (with("reward", text("shiny")), Code::InvalidOption, &["reward", "shiny", "sparse"]),
        (with("reward", OptionValue::Number(1.0)), Code::InvalidOption, &["reward", "1", "dense"]),
        (reach().envs(0), Code::InvalidEnvCount, &["envs", "0", "1 to 4096"]),
        (reach().envs(4097), Code::InvalidEnvCount, &["envs", "4097", "1 to 4096"]),
        (reach().envs(u32::MAX), Code::InvalidEnvCount, &["envs", "4294967295", "1 to 4096"]),
    ];
    for (request, code, parts) in cases {
        assert_names(&refused(client.open(&request)), code, parts);
        if request.envs == 1 {
            assert_names(&refused(client.describe(&request.task, &request.options)), code, parts);
        }
    }
    assert_goes_on(&mut open(&client));
    bystander.finish();
}

fn open(client: &Client) -> Session {
    let mut session = client.open(&SessionRequest::new("NeedleReach-v0").envs(2)).unwrap();
    session.want_expert(true);
    session
}

#[test]
fn bad_actions_are_refused_and_nothing_moves() {
    let server = Server::start();
    let bystander = Bystander::start(&server);
    let mut session = open(&server.connect());
    let dim = session.spec().action_dim();
    assert_names(
        &refused(session.step(&vec![0.0; 2 * dim])),
        Code::ResetNeeded,
        &["env", "0", "reset it before the first step"],
    );
    session.reset().unwrap();
    for length in [0, 1, 2 * dim - 1, 2 * dim + 1] {
        let found = format!("{length} numbers");
        let expected = format!("expected {}", 2 * dim);
        assert_names(
            &refused(session.step(&vec![0.0; length])),
            Code::InvalidAction,
            &["actions", &found, &expected],
        );
    }
    for (value, name) in [(f32::NAN, "NaN"), (f32::INFINITY, "inf"), (f32::NEG_INFINITY, "-inf")] {
        let mut actions = vec![0.0; 2 * dim];
        actions[dim + 2] = value;
        let refusal = refused(session.step(&actions));
        let element = session.spec().action[2].name.clone();
        assert_names(&refusal, Code::InvalidAction, &["actions[env 1][2]", name, &element]);
        // Among few, the environment is named and not the row.
        let refusal = refused(session.send(&[1], &actions[dim..]).and_then(|()| session.recv()));
        assert_names(&refusal, Code::InvalidAction, &["actions[env 1][2]", name]);
    }
    let reply = session.step(&vec![0.0; 2 * dim]).unwrap();
    assert_eq!(reply.steps(), [1, 1]);
    drop(reply);
    assert_goes_on(&mut session);
    bystander.finish();
}

#[test]
fn bad_environment_numbers_are_refused() {
    let server = Server::start();
    let mut session = open(&server.connect());
    session.reset().unwrap();
    let dim = session.spec().action_dim();
    let cases: [&[u32]; 5] = [&[], &[1, 0], &[0, 0], &[2], &[0, u32::MAX]];
    for ids in cases {
        let shown = format!("{ids:?}");
        let parts = ["env_ids", &shown, "increasing numbers below 2"];
        let actions = vec![0.0; ids.len() * dim];
        assert_names(&refused(session.send(ids, &actions)), Code::InvalidEnvIds, &parts);
        assert_names(&refused(session.reset_envs(ids, None)), Code::InvalidEnvIds, &parts);
    }
    let refusal = refused(session.reset_envs(&[0, 1], Some(&[1])));
    assert_names(&refusal, Code::InvalidEnvIds, &["seeds", "1 numbers", "expected 2"]);
    assert_goes_on(&mut session);
}

#[test]
fn requests_that_no_client_of_ours_sends_are_refused() {
    let server = Server::start();
    let bystander = Bystander::start(&server);
    let mut session = open(&server.connect());
    session.reset().unwrap();
    let good = Header {
        session: session.info().session,
        epoch: session.info().epoch,
        rows: 2,
        ..Header::new(kind::STEP)
    };
    let cases: [(Header, Code, &[&str]); 8] = [
        (Header { rows: 0, ..good }, Code::Malformed, &["header.rows", "0", "1 to 2"]),
        (Header { rows: 3, ..good }, Code::Malformed, &["header.rows", "3", "1 to 2"]),
        (Header { rows: u32::MAX, ..good }, Code::Malformed, &["header.rows", "4294967295"]),
        (Header { kind: 77, ..good }, Code::Malformed, &["header.kind", "77"]),
        (Header { magic: 7, ..good }, Code::Malformed, &["header.magic", "0x00000007"]),
        (Header { protocol: 99, ..good }, Code::VersionMismatch, &["protocol version", "99"]),
        (Header { epoch: 5, ..good }, Code::StaleSession, &["session", "0000000000000005"]),
        (Header { session: 500, ..good }, Code::StaleSession, &["session", "500"]),
    ];
    for (header, code, parts) in cases {
        assert_names(&refused(session.call_raw(header, |_| ())), code, parts);
    }
    let garbage = |payload: &mut [u8]| payload.fill(0xff);
    assert_names(&refused(session.call_raw(good, garbage)), Code::InvalidEnvIds, &["env_ids"]);
    assert_goes_on(&mut session);
    bystander.finish();
}

#[test]
fn another_protocol_version_is_refused_with_both_named() {
    let server = Server::start();
    let client = server.connect();
    let header = Header { protocol: 77, ..Header::new(2) };
    match client.send_raw(header, &[1]).unwrap() {
        ControlReply::Refused(refusal) => {
            let ours = format!("version {PROTOCOL_VERSION}");
            let parts = ["protocol version", "77", &ours, "install the same release"];
            assert_names(&refusal, Code::VersionMismatch, &parts);
        }
        other => panic!("not refused: {other:?}"),
    }
    assert_eq!(client.tasks().unwrap().len(), Registry::builtin().ids().count());
}

#[test]
fn a_full_memory_budget_refuses_new_sessions_only() {
    let server = Server::start_with(&["--memory", "4MiB"]);
    let client = server.connect();
    let mut first = open(&client);
    let refusal = refused(client.open(&SessionRequest::new("NeedleReach-v0").envs(64)));
    let parts = ["envs", "64", "NeedleReach-v0", "4.0 MiB", "serve --memory"];
    assert_names(&refusal, Code::MemoryBudget, &parts);
    let mut others = vec![];
    let refusal = loop {
        match client.open(&SessionRequest::new("EcmReach-v0")) {
            Ok(session) => others.push(session),
            Err(CallError::Refused(refusal)) => break refusal,
            Err(other) => panic!("{other}"),
        }
    };
    assert_names(&refusal, Code::MemoryBudget, &["EcmReach-v0", "4.0 MiB"]);
    let count = others.len();
    assert_eq!(client.status().unwrap().sessions.len(), 1 + count);
    // What was given back can be had again at once.
    drop(others);
    others =
        (0..count).map(|_| client.open(&SessionRequest::new("EcmReach-v0")).unwrap()).collect();
    assert_goes_on(&mut first);
    drop(others);
}

#[test]
fn holding_on_to_too_many_replies_is_an_error_that_passes() {
    let server = Server::start();
    let mut session = open(&server.connect());
    let mut held = vec![session.reset().unwrap()];
    let actions = vec![0.0; 2 * session.spec().action_dim()];
    let error = loop {
        match session.step(&actions) {
            Ok(reply) => held.push(reply),
            Err(error) => break error,
        }
        assert!(held.len() < 1000);
    };
    assert!(matches!(error, CallError::TooManyHeld), "after {}: {error}", held.len());
    assert!(held.len() >= trocar_proto::wire::MAX_HELD_REPLIES, "{}", held.len());
    let steps: Vec<u32> = held.iter().map(|reply| reply.steps()[0]).collect();
    assert_eq!(steps, (0..held.len() as u32).collect::<Vec<_>>());
    drop(held);
    // The step was carried out, and its reply is still to be had.
    assert_eq!(session.recv().unwrap().steps()[0] as usize, steps.len());
    assert_goes_on(&mut session);
}

#[test]
fn connecting_without_a_server_says_how_to_start_one() {
    let name = unique_name();
    let error = Client::connect(&name).unwrap_err();
    assert!(matches!(error, ConnectError::NoServer { .. }));
    assert!(error.to_string().contains(&format!("trocar serve --name {name}")), "{error}");
    for name in ["", "no/slash", "twenty-five-characters-lon", "ünïcode"] {
        match Client::connect(name).unwrap_err() {
            ConnectError::Refused(refusal) => {
                assert_names(&refusal, Code::InvalidOption, &["server name", name, "1 to 24"]);
            }
            other => panic!("{other}"),
        }
    }
}

#[test]
fn a_second_server_of_the_same_name_ends_and_the_first_goes_on() {
    let mut server = Server::start();
    let bystander = Bystander::start(&server);
    let output = serve(server.name()).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success());
    let pid = server.process().pid().to_string();
    for part in [server.name(), &pid, "is running already"] {
        assert!(said.contains(part), "{said:?} does not name {part:?}");
    }
    bystander.finish();
}

#[test]
fn bad_arguments_end_the_server_with_a_reason() {
    for (arguments, reason) in [
        (["--threads", "0"], "--threads = 0: allowed is 1 to"),
        (["--max-envs", "0"], "--max-envs = 0: allowed is 1 to"),
        (["--memory", "12"], "--memory = 12: allowed is"),
        (["--memory", "1XB"], "allowed units are"),
        (["--idle-limit", "0s"], "--idle-limit = 0: allowed is 1 to"),
    ] {
        let output = serve(&unique_name()).args(arguments).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && said.contains(reason), "{arguments:?}: {said}");
    }
    let mut bad_name = Process::spawn(&mut serve("a/b"));
    assert!(!bad_name.wait().success());
}

#[test]
fn threads_may_share_one_client() {
    let server = Server::start();
    let client = server.connect();
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                for _ in 0..25 {
                    let mut session = open(&client);
                    session.reset().unwrap();
                    client.status().unwrap();
                }
            });
        }
    });
    eventually("every session is closed", || client.status().unwrap().sessions.is_empty());
}
