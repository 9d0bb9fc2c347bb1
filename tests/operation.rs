//! What operators rely on: quotas, metrics, logs, an end in order.

use std::fs::File;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};

use rustix::process::Signal;
use serde_json::Value;
use trocar_client::{Autoreset, CallError, Client, Code, ConnectError, Rejection, SessionRequest};
use trocar_proto::endpoint::ServerState;
use trocar_proto::wire::MAX_IN_FLIGHT;
use trocar_proto::{OptionValue, Options};

use crate::harness::{Server, assert_nothing_is_left, client, eventually, serve, unique_name};
use crate::twin::Bystander;

fn reach(envs: u32) -> SessionRequest {
    SessionRequest::new("EcmReach-v0").envs(envs)
}

fn refused<T: std::fmt::Debug>(result: Result<T, CallError>) -> Rejection {
    match result {
        Err(CallError::Refused(refusal)) => refusal,
        other => panic!("not refused: {other:?}"),
    }
}

/// Fails unless the refusal names its field, its value, and all of `parts`.
fn assert_names(refusal: &Rejection, code: Code, field: &str, value: &str, parts: &[&str]) {
    assert_eq!(refusal.code, code, "{refusal}");
    assert_eq!((refusal.field.as_str(), refusal.value.as_str()), (field, value), "{refusal}");
    for part in parts {
        assert!(refusal.allowed.contains(part), "{refusal} does not name {part:?}");
    }
}

#[test]
fn a_client_has_no_more_sessions_and_environments_than_its_quota() {
    let server = Server::start_with(&["--client-sessions", "2", "--client-envs", "6"]);
    let limits = server.connect().limits().unwrap();
    assert_eq!((limits.sessions, limits.envs, limits.memory_bytes), (Some(2), Some(6), None));
    assert!(limits.session_envs > 6 && limits.threads.is_none());
    let pid = format!("process {}", std::process::id());
    // Connections of a process have its quota together.
    let one = server.connect().open(&reach(3)).unwrap();
    let refusal = refused(server.connect().open(&reach(4)));
    let parts = [pid.as_str(), "3 of the 6", "--client-envs"];
    assert_names(&refusal, Code::InvalidEnvCount, "envs", "4", &parts);
    let two = server.connect().open(&reach(2)).unwrap();
    let refusal = refused(server.connect().open(&reach(1)));
    let parts = [pid.as_str(), "2 at a time", "--client-sessions"];
    assert_names(&refusal, Code::TooManySessions, "sessions", "3", &parts);
    // Other processes have their own.
    let mut other = client(server.name(), "step");
    assert_eq!(other.line(), "ready");
    // What was closed counts no more.
    drop(one);
    let three = server.connect().open(&reach(4)).unwrap();
    drop((two, three));
}

#[test]
fn a_client_takes_no_more_memory_than_its_quota() {
    let server = Server::start_with(&["--client-memory", "8MiB", "--memory", "1GiB"]);
    let client = server.connect();
    let mut session = client.open(&reach(4)).unwrap();
    let refusal = refused(client.open(&reach(40)));
    let parts = ["of the 8.0 MiB", "--client-memory"];
    assert_names(&refusal, Code::MemoryBudget, "envs", "40", &parts);
    session.reset().unwrap();
    let mut kept = vec![];
    let refusal = loop {
        match session.snapshot() {
            Ok(snapshot) => kept.push(snapshot),
            Err(CallError::Refused(refusal)) => break refusal,
            Err(error) => panic!("{error}"),
        }
    };
    let parts = ["of 8.0 MiB", "--client-memory"];
    assert_names(&refusal, Code::MemoryBudget, "snapshots", "4", &parts);
    // Its snapshots leave no room for another session of its own, but others have theirs.
    let refusal = refused(client.open(&reach(4)));
    assert_eq!(refusal.code, Code::MemoryBudget, "{refusal}");
    let mut other = crate::harness::client(server.name(), "step");
    assert_eq!(other.line(), "ready");
    kept.clear();
    session.snapshot().unwrap();
}

#[test]
fn a_share_of_threads_changes_no_bit() {
    let server = Server::start_with(&["--threads", "3", "--client-threads", "1"]);
    let bystanders = [Bystander::start(&server), Bystander::start(&server)];
    bystanders.into_iter().for_each(Bystander::finish);
}

#[test]
fn quotas_that_make_no_sense_are_refused_by_name() {
    for (option, value) in [
        ("--client-sessions", "0"),
        ("--client-envs", "0"),
        ("--client-memory", "1KiB"),
        ("--client-threads", "0"),
        ("--metrics", "somewhere"),
        ("--view", "somewhere"),
        ("--log", "a=b=c"),
        ("--log-format", "xml"),
    ] {
        let output = serve(&unique_name()).args([option, value]).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{option}: {said}");
        assert!(said.contains(option), "{said}");
    }
}

/// A server that logs to a file of its own.
pub(crate) struct Logged {
    pub(crate) server: Server,
    log: PathBuf,
}

impl Logged {
    pub(crate) fn start(arguments: &[&str]) -> Self {
        let name = unique_name();
        let log = Path::new(env!("CARGO_TARGET_TMPDIR")).join(&name);
        let mut command = serve(&name);
        command.env_remove("TROCAR_LOG").args(["--log-format", "json"]).args(arguments);
        command.stderr(File::create(&log).unwrap());
        Self { server: Server::start_command(&name, &mut command), log }
    }

    /// The first line with this message.
    pub(crate) fn line(&self, message: &str) -> Value {
        let mut found = None;
        eventually(&format!("{message:?} is logged"), || {
            let log = std::fs::read_to_string(&self.log).unwrap();
            let mut lines = log.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
            found = lines.find(|line| line["message"] == message);
            found.is_some()
        });
        found.unwrap()
    }
}

impl Drop for Logged {
    fn drop(&mut self) {
        std::fs::remove_file(&self.log).ok();
    }
}

/// The answer to `GET path`.
pub(crate) fn get(address: &str, path: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

/// The value of a metric, with its labels as they are written.
fn value(page: &str, metric: &str) -> f64 {
    let line = page.lines().find_map(|line| line.strip_prefix(metric)?.strip_prefix(' '));
    line.unwrap_or_else(|| panic!("no {metric} in {page}")).parse().unwrap()
}

#[test]
fn metrics_and_logs_tell_what_was_done() {
    let logged = Logged::start(&["--metrics", "0", "--client-envs", "8", "--threads", "2"]);
    let server = &logged.server;
    let serving = logged.line("serving");
    let address = serving["metrics"].as_str().unwrap();
    assert!(address.starts_with("127.0.0.1:"), "{address}");
    assert_eq!(serving["threads"], 2);
    let client = server.connect();
    let request = reach(3).autoreset(Autoreset::NextStep);
    let mut session = client.open(&request).unwrap();
    session.reset().unwrap();
    let steps = session.spec().max_steps + 1;
    for _ in 0..steps {
        session.step(&[0.1; 9]).unwrap();
    }
    session.step(&[f32::NAN; 9]).unwrap_err();
    refused(client.open(&reach(6)));

    let page = get(address, "/metrics");
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("openmetrics-text"), "{page}");
    let task = "{task=\"EcmReach-v0\"}";
    // In the last message episodes began anew, which is no step.
    let expected = [
        ("trocar_sessions", 1.0),
        ("trocar_envs", 3.0),
        ("trocar_clients", 1.0),
        ("trocar_threads", 2.0),
        ("trocar_sessions_opened_total", 1.0),
        ("trocar_refusals_total{kind=\"InvalidAction\"}", 1.0),
        ("trocar_refusals_total{kind=\"InvalidEnvCount\"}", 1.0),
        (&format!("trocar_steps_total{task}"), 3.0 * f64::from(steps - 1)),
        (&format!("trocar_resets_total{task}"), 6.0),
        (&format!("trocar_failed_envs_total{task}"), 0.0),
        (&format!("trocar_step_latency_seconds_count{task}"), f64::from(steps)),
        ("trocar_memory_bytes", client.status().unwrap().memory_bytes as f64),
    ];
    for (metric, expected) in expected {
        assert_eq!(value(&page, metric), expected, "{metric} in {page}");
    }
    assert!(value(&page, "trocar_threads_busy_seconds_total") > 0.0);
    assert!(value(&page, "trocar_resident_memory_bytes") > f64::from(1 << 20));
    assert!(get(address, "/").starts_with("HTTP/1.1 404"));

    let pid = std::process::id();
    let opened = logged.line("session opened");
    assert_eq!((&opened["pid"], &opened["task"]), (&pid.into(), &"EcmReach-v0".into()));
    assert_eq!((&opened["envs"], &opened["language"]), (&3.into(), &"rust".into()));
    let refusal = logged.line("session refused");
    assert_eq!((&refusal["pid"], &refusal["field"]), (&pid.into(), &"envs".into()));
    assert!(refusal["allowed"].as_str().unwrap().contains("--client-envs"), "{refusal}");
    drop(session);
    let closed = logged.line("session closed");
    assert_eq!((&closed["reason"], &closed["steps"]), (&"closed".into(), &150.into()));

    let mut victim = crate::harness::client(server.name(), "hold");
    assert_eq!(victim.line(), "ready");
    victim.kill();
    let reclaimed = "trocar_sessions_closed_total{reason=\"reclaimed\"} 1";
    eventually("it is reclaimed", || get(address, "/metrics").contains(reclaimed));
    assert_eq!(logged.line("client is gone")["pid"], victim.pid());
    eventually("it is not counted any more", || {
        value(&get(address, "/metrics"), "trocar_sessions") == 0.0
    });
}

#[test]
fn metrics_where_nobody_can_listen_are_no_server() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let name = unique_name();
    let output = serve(&name).args(["--metrics", &address]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("--metrics") && said.contains(&address), "{said}");
    assert_nothing_is_left(&name);
}

#[test]
fn a_terminated_server_answers_the_steps_that_it_is_at() {
    let mut server = Server::start();
    let mut session = server.connect().open(&reach(2)).unwrap();
    session.reset().unwrap();
    // Stopped, so that the steps are under way when it is told to end.
    server.process().stop();
    session.send(&[0], &[0.3; 3]).unwrap();
    session.send(&[1], &[0.3; 3]).unwrap();
    server.process().signal(Signal::TERM);
    server.process().signal(Signal::CONT);
    for env in [0, 1] {
        let reply = session.recv().unwrap();
        assert_eq!((reply.env_id(0), reply.steps()), (env, [1].as_slice()));
    }
    let endpoint = server.endpoint();
    eventually("it says that it ends", || {
        !matches!(endpoint.server_state(), ServerState::Running { .. })
    });
    let nobody = Client::connect(server.name()).err();
    assert!(matches!(nobody, Some(ConnectError::NoServer { .. })), "{nobody:?}");
    // A session may see so many more requests as a client could have had in flight.
    let mut steps = (0..=MAX_IN_FLIGHT).map(|_| session.step(&[0.3; 6]).err());
    let error = steps.find_map(|error| error).expect("an ending server takes no more steps");
    assert!(matches!(error, CallError::ServerLost { closed: true, .. }), "{error}");
    assert_eq!(server.process().wait().code(), Some(0));
}

/// Signals during a reset that takes seconds, with a picture of each environment: the server must not wait for it.
fn cut_short(arguments: &[&str], signals: usize) {
    let mut server = Server::start_with(arguments);
    let rgb = OptionValue::Texts(vec!["state".into(), "rgb".into()]);
    let options = Options::new().with("observation", rgb);
    let request = SessionRequest::new("NeedleRegrasp-v0").envs(512).options(options);
    let mut session = server.connect().open(&request).unwrap();
    session.start_reset(None, None).unwrap();
    let endpoint = server.endpoint();
    for _ in 0..signals {
        server.process().signal(Signal::TERM);
        eventually("it says that it ends", || {
            !matches!(endpoint.server_state(), ServerState::Running { .. })
        });
    }
    assert_eq!(server.process().wait().code(), Some(0));
    let error = session.recv().unwrap_err();
    assert!(matches!(error, CallError::ServerLost { closed: true, .. }), "{error}");
}

#[test]
fn a_second_signal_ends_a_server_at_once() {
    cut_short(&["--drain-limit", "10min"], 2);
}

#[test]
fn what_takes_longer_than_the_limit_is_not_waited_for() {
    cut_short(&["--drain-limit", "0s"], 1);
}
