//! Sessions that survive the loss of their server: where they go on, and with which bits.

use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use trocar_client::{
    Autoreset, CallError, Client, Code, ConnectError, Options, ReconnectError, Reply, Resumed,
    Session, SessionRequest, private,
};

use crate::harness::{PATIENCE, Server, Watchdog, binary, eventually};
use crate::rows::{Row, act, policies};
use crate::twin::Twin;

const MODE: Autoreset = Autoreset::NextStep;
const ALL: [u32; 3] = [0, 1, 2];

fn request() -> SessionRequest {
    SessionRequest::new("NeedleReach-v0").envs(3).seed(5)
}

fn twin() -> Twin {
    Twin::new("NeedleReach-v0", &Options::new(), 3, 5)
}

/// Steps a session and its twin, and finds the same bits; `rows` is what they show.
fn steps(session: &mut Session, twin: &mut Twin, rows: &mut Vec<Row>, count: usize) {
    let mut policies = policies(9, 3);
    for _ in 0..count {
        let actions = act(&mut policies, rows);
        *rows = Row::all(&session.step(&actions).unwrap(), MODE);
        assert_eq!(*rows, twin.step(&ALL, &actions).unwrap());
    }
}

fn assert_lost<T: std::fmt::Debug>(result: &Result<T, CallError>) {
    assert!(matches!(result, Err(CallError::ServerLost { .. })), "{result:?}");
}

fn from_snapshot(resumed: Resumed) -> Reply {
    match resumed {
        Resumed::FromSnapshot(reply) => reply,
        Resumed::FromReset(_) => panic!("the checkpoint was not used"),
    }
}

fn from_reset(resumed: Resumed) -> Reply {
    match resumed {
        Resumed::FromReset(reply) => reply,
        Resumed::FromSnapshot(_) => panic!("no checkpoint was made"),
    }
}

#[test]
fn a_session_goes_on_from_its_checkpoint_with_its_twin_s_bits() {
    let server = Server::start();
    let name = server.name().to_string();
    let (mut session, mut twin) = (server.open(&request()), twin());
    let mut rows = Row::all(&session.reset().unwrap(), MODE);
    twin.reset(&ALL, None);
    // Past the end of an episode.
    steps(&mut session, &mut twin, &mut rows, 60);
    session.checkpoint().unwrap();
    let saved = (twin.clone(), rows.clone());
    steps(&mut session, &mut twin, &mut rows, 7);
    let mut servers = vec![server];
    for _ in 0..2 {
        servers.last_mut().unwrap().process().kill();
        assert_lost(&session.step(&[0.0; 15]));
        // A user starts another, some time later.
        let starter = std::thread::spawn({
            let name = name.clone();
            move || {
                std::thread::sleep(Duration::from_millis(300));
                Server::start_named(&name, &[])
            }
        });
        let reply = from_snapshot(session.reconnect(PATIENCE).unwrap());
        servers.push(starter.join().unwrap());
        assert_eq!(reply.steps(), [9, 9, 9], "of the second episode");
        drop(reply);
        let (mut twin, mut rows) = saved.clone();
        steps(&mut session, &mut twin, &mut rows, 60);
    }
    drop(session);
    // The last one first: the others look for remains.
    while servers.pop().is_some() {}
}

#[test]
fn without_a_checkpoint_a_session_begins_anew() {
    let mut server = Server::start();
    let name = server.name().to_string();
    let (mut session, mut twin) = (server.open(&request()), twin());
    session.reset().unwrap();
    session.step(&[0.2; 15]).unwrap();
    // Also where it ends in order.
    server.process().signal(Signal::TERM);
    server.process().wait();
    assert_lost(&session.step(&[0.2; 15]));
    let successor = Server::start_named(&name, &[]);
    let reply = from_reset(session.reconnect(PATIENCE).unwrap());
    let mut rows = Row::all(&reply, MODE);
    assert_eq!(rows, twin.reset(&ALL, None));
    drop(reply);
    steps(&mut session, &mut twin, &mut rows, 5);
    drop(session);
    drop((successor, server));
}

#[test]
fn requests_in_flight_when_the_server_dies_are_never_done() {
    let mut server = Server::start();
    let mut session = server.open(&request());
    session.reset().unwrap();
    session.checkpoint().unwrap();
    server.process().stop();
    session.send(&[0], &[0.5; 5]).unwrap();
    session.send(&[1], &[0.5; 5]).unwrap();
    server.process().kill();
    let successor = Server::start_named(server.name(), &[]);
    assert_lost(&session.recv());
    let reply = from_snapshot(session.reconnect(PATIENCE).unwrap());
    assert_eq!(reply.steps(), [0, 0, 0]);
    assert!(matches!(session.recv(), Err(CallError::NothingInFlight)));
    drop((reply, session));
    drop((successor, server));
}

#[test]
fn where_no_server_comes_back_the_wait_ends_and_can_be_repeated() {
    let mut server = Server::start();
    let mut session = server.open(&request());
    session.reset().unwrap();
    session.checkpoint().unwrap();
    server.process().kill();
    let error = session.reconnect(Duration::from_millis(50)).unwrap_err();
    assert!(matches!(error, ReconnectError::Connect(ConnectError::NoServer { .. })), "{error}");
    assert_lost(&session.step(&[0.2; 15]));
    // Nor one that does not open the session.
    let mut narrow = Server::start_named(server.name(), &["--max-envs", "2"]);
    match session.reconnect(PATIENCE).unwrap_err() {
        ReconnectError::Call(CallError::Refused(refusal)) => {
            assert_eq!(refusal.code, Code::InvalidEnvCount);
        }
        other => panic!("{other}"),
    }
    narrow.process().kill();
    let successor = Server::start_named(server.name(), &[]);
    drop(from_snapshot(session.reconnect(PATIENCE).unwrap()));
    drop(session);
    drop((successor, narrow, server));
}

#[test]
fn a_private_server_is_started_again() {
    let watchdog = Watchdog::start();
    let server = private::PrivateServer::new(&private::unique_name(), binary()).unwrap();
    let client = Client::launch(&server, "rust").unwrap();
    let mut session = client.open(&request()).unwrap();
    session.want_expert(true);
    session.reset().unwrap();
    session.checkpoint().unwrap();
    let pid = Pid::from_raw(client.server().pid.cast_signed()).unwrap();
    kill_process(pid, Signal::KILL).unwrap();
    assert_lost(&session.step(&[0.2; 15]));
    let reply = from_snapshot(session.reconnect(PATIENCE).unwrap());
    let mut rows = Row::all(&reply, MODE);
    let mut twin = twin();
    assert_eq!(rows, twin.reset(&ALL, None));
    drop(reply);
    steps(&mut session, &mut twin, &mut rows, 5);
    drop((session, client));
    eventually("nothing is left", || server.endpoint().remains().unwrap().is_empty());
    drop(watchdog);
}
