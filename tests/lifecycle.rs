//! Whichever process is killed or stopped, the others go on with the same bits, and nothing is
//! left.

use std::io::Write;
use std::time::{Duration, Instant};

use rustix::process::Signal;
use trocar_client::{CallError, Client, SessionRequest, private};
use trocar_proto::endpoint::ServerState;

use crate::harness::{
    PATIENCE, Process, Server, Watchdog, assert_nothing_is_left, binary, client, client_command,
    count_files, endpoint, eventually,
};
use crate::twin::{Bystander, digest};

/// Sessions that the server knows of.
fn sessions(client: &Client) -> usize {
    client.status().expect("the server runs").sessions.len()
}

/// Kills a client of that role, `delay` after it is ready, and waits until its session is gone.
fn kill_client(role: &str, delay: Duration) {
    let server = Server::start();
    let bystander = Bystander::start(&server);
    let observer = server.connect();
    let mut victim = client(server.name(), role);
    assert_eq!(victim.line(), "ready");
    std::thread::sleep(delay);
    let killed = Instant::now();
    victim.kill();
    eventually("its session is gone", || sessions(&observer) == 1);
    report(&format!("client killed ({role}): session gone"), killed);
    bystander.finish();
}

fn report(what: &str, since: Instant) {
    eprintln!("{what} after {} ms", since.elapsed().as_millis());
}

#[test]
fn a_client_killed_before_it_opens_a_session_is_forgotten() {
    kill_client("connect", Duration::ZERO);
}

#[test]
fn a_client_killed_while_it_opens_sessions_is_reclaimed() {
    for delay in [0, 3, 7, 11, 19] {
        kill_client("open", Duration::from_millis(delay));
    }
}

#[test]
fn a_client_killed_while_it_steps_is_reclaimed() {
    for delay in [0, 5, 50] {
        kill_client("step", Duration::from_millis(delay));
    }
}

#[test]
fn a_client_killed_with_replies_in_its_hands_is_reclaimed() {
    kill_client("hold", Duration::ZERO);
}

#[test]
fn a_client_killed_with_requests_in_flight_is_reclaimed() {
    kill_client("in-flight", Duration::ZERO);
}

#[test]
fn many_clients_killed_at_once_are_all_reclaimed() {
    let server = Server::start();
    let bystander = Bystander::start(&server);
    let observer = server.connect();
    let roles = ["step", "hold", "open", "in-flight", "step", "hold", "open", "in-flight"];
    let mut victims: Vec<Process> = roles.map(|role| client(server.name(), role)).into();
    for victim in &mut victims {
        assert_eq!(victim.line(), "ready");
    }
    let killed = Instant::now();
    drop(victims);
    eventually("their sessions are gone", || sessions(&observer) == 1);
    report("8 clients killed: sessions gone", killed);
    bystander.finish();
}

#[test]
fn clients_of_a_killed_server_are_told_and_a_new_one_starts_at_once() {
    let mut server = Server::start();
    let name = server.name().to_string();
    let mut steppers: Vec<Process> = (0..4).map(|_| client(&name, "until-lost")).collect();
    let mut holder = client(&name, "hold");
    for client in steppers.iter_mut().chain([&mut holder]) {
        assert_eq!(client.line(), "ready");
    }
    let mut session = server.open(&SessionRequest::new("EcmReach-v0"));
    session.reset().unwrap();
    let connected = server.connect();
    let killed = Instant::now();
    server.process().kill();
    for stepper in &mut steppers {
        assert_eq!(stepper.line(), "died");
        report("server killed: client told", killed);
    }
    let error = session.step(&[0.0; 3]).unwrap_err();
    assert!(matches!(error, CallError::ServerLost { closed: false, .. }), "{error}");
    // However often it tries, it sends nothing: no server would take it.
    for _ in 0..10 {
        assert!(matches!(session.step(&[0.0; 3]), Err(CallError::ServerLost { .. })));
        assert!(matches!(connected.status(), Err(CallError::ServerLost { .. })));
    }

    let successor = Server::start_named(&name, &[]);
    report("server killed: successor runs", killed);
    let bystander = Bystander::start(&successor);
    let error = session.reset().unwrap_err();
    assert!(matches!(error, CallError::ServerLost { closed: false, .. }), "{error}");
    drop((session, connected));
    assert!(holder.finish().0.success());
    for stepper in &mut steppers {
        assert!(stepper.finish().0.success());
    }
    bystander.finish();
    drop(successor);
    // The first server's harness would look for remains, too.
    drop(server);
}

#[test]
fn those_who_look_for_a_server_keep_none_from_starting() {
    let mut server = Server::start();
    let name = server.name().to_string();
    // Keeps the file of the killed server's lock, at which everybody looks.
    let connected = server.connect();
    server.process().kill();
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                let (start, endpoint) = (Instant::now(), endpoint(&name));
                let runs = || matches!(endpoint.server_state(), ServerState::Running { .. });
                while !runs() && start.elapsed() < PATIENCE {}
            });
        }
        let successor = Server::start_named(&name, &[]);
        drop(connected);
        drop(successor);
    });
}

#[test]
fn the_last_client_of_a_killed_server_leaves_nothing() {
    let mut server = Server::start();
    let mut session = server.open(&SessionRequest::new("NeedleReach-v0").envs(2));
    let reply = session.reset().unwrap();
    server.process().kill();
    let error = session.reset().unwrap_err();
    assert!(matches!(error, CallError::ServerLost { closed: false, .. }), "{error}");
    drop(session);
    // A reply outlives everything, and still reads what it did.
    assert_eq!(reply.steps(), [0, 0]);
    assert!(!server.endpoint().remains().unwrap().is_empty());
    drop(reply);
    assert_nothing_is_left(server.name());
}

#[test]
fn a_terminated_server_tells_its_clients_and_ends_in_order() {
    let mut server = Server::start();
    let mut steppers: Vec<Process> = (0..6).map(|_| client(server.name(), "until-lost")).collect();
    for stepper in &mut steppers {
        assert_eq!(stepper.line(), "ready");
    }
    server.process().signal(Signal::TERM);
    for stepper in &mut steppers {
        assert_eq!(stepper.line(), "closed");
        assert!(stepper.finish().0.success());
    }
    assert_eq!(server.process().wait().code(), Some(0));
    assert_nothing_is_left(server.name());
}

#[test]
fn a_client_can_shut_the_server_down() {
    let mut server = Server::start();
    let mut session = server.open(&SessionRequest::new("EcmReach-v0"));
    server.connect().shut_down().unwrap();
    assert_eq!(server.process().wait().code(), Some(0));
    let error = session.reset().unwrap_err();
    assert!(matches!(error, CallError::ServerLost { closed: true, .. }), "{error}");
}

#[test]
fn a_name_can_be_used_again_while_its_last_server_still_ends() {
    let mut server = Server::start();
    let sessions: Vec<_> =
        (0..8).map(|_| server.open(&SessionRequest::new("EcmReach-v0"))).collect();
    server.process().signal(Signal::TERM);
    let lost = server.endpoint();
    eventually("it says that it ends", || {
        !matches!(lost.server_state(), ServerState::Running { .. })
    });
    let successor = Server::start_named(server.name(), &[]);
    Bystander::start(&successor).finish();
    drop(sessions);
}

#[test]
fn a_stopped_server_holds_its_clients_up_and_then_goes_on() {
    let mut server = Server::start();
    let mut waiting = Waiting::client(&server);
    server.process().signal(Signal::STOP);
    waiting.step();
    std::thread::sleep(Duration::from_secs(2));
    server.process().signal(Signal::CONT);
    assert_eq!(waiting.0.line(), "stepped");
}

#[test]
fn a_stopped_client_keeps_its_session() {
    let server = Server::start();
    let observer = server.connect();
    let mut waiting = Waiting::client(&server);
    waiting.0.signal(Signal::STOP);
    // Several of the server's looks for dead clients.
    std::thread::sleep(Duration::from_secs(2));
    assert_eq!(sessions(&observer), 1);
    waiting.0.signal(Signal::CONT);
    waiting.step();
    assert_eq!(waiting.0.line(), "stepped");
}

#[test]
fn an_idle_session_is_closed_at_the_limit_and_its_client_told() {
    let server = Server::start_with(&["--idle-limit", "1s"]);
    let observer = server.connect();
    let mut waiting = Waiting::client(&server);
    eventually("the session is closed", || sessions(&observer) == 0);
    waiting.step();
    let said = waiting.0.line();
    for part in ["session", "closed", "--idle-limit", "open another"] {
        assert!(said.contains(part), "{said:?} does not name {part:?}");
    }
}

/// A client that takes a step when told to.
struct Waiting(Process);

impl Waiting {
    fn client(server: &Server) -> Self {
        let mut process = client(server.name(), "until-told");
        assert_eq!(process.line(), "ready");
        Self(process)
    }

    fn step(&mut self) {
        writeln!(self.0.input(), "step").expect("the client reads its input");
    }
}

/// Eight processes that share a private server.
struct Family {
    name: String,
    members: Vec<Process>,
    _watchdog: Watchdog,
}

impl Family {
    fn start() -> Self {
        let watchdog = Watchdog::start();
        let name = private::unique_name();
        let mut members: Vec<Process> = (0..8)
            .map(|_| {
                let mut command = client_command("-", "private");
                command.env(private::VARIABLE, &name).env(private::BINARY, binary());
                Process::spawn(command.env("TROCAR_SERVER", "")) // empty, that is none
            })
            .collect();
        let said: Vec<String> = members.iter_mut().map(Process::line).collect();
        assert!(said[0].starts_with(&name), "{said:?}");
        assert!(said.iter().all(|line| *line == said[0]), "{said:?}");
        Self { name, members, _watchdog: watchdog }
    }

    fn runs(&self) -> bool {
        matches!(endpoint(&self.name).server_state(), ServerState::Running { .. })
    }

    fn leave(&mut self) {
        for member in &mut self.members {
            assert!(member.finish().0.success());
        }
    }
}

#[test]
fn a_private_server_ends_after_its_last_client() {
    let mut family = Family::start();
    // The process that started the server may go first, however it goes.
    for mut member in family.members.drain(..4) {
        member.kill();
    }
    std::thread::sleep(Duration::from_secs(4));
    assert!(family.runs());
    family.leave();
    eventually("nothing is left", || endpoint(&family.name).remains().unwrap().is_empty());
}

#[test]
fn a_private_server_that_was_killed_is_started_again() {
    let watchdog = Watchdog::start();
    let server = private::PrivateServer::new(&private::unique_name(), binary()).unwrap();
    let mut runs = vec![];
    for _ in 0..3 {
        let client = Client::launch(&server, "rust").unwrap();
        let info = client.server().clone();
        let pid = rustix::process::Pid::from_raw(info.pid.cast_signed()).unwrap();
        rustix::process::kill_process(pid, Signal::KILL).unwrap();
        eventually("the server is gone", || client.status().is_err());
        runs.push(info.epoch);
    }
    assert!(runs[0] != runs[1] && runs[1] != runs[2]);
    eventually("nothing is left", || server.endpoint().remains().unwrap().is_empty());
    drop(watchdog);
}

#[test]
fn opening_and_closing_many_sessions_uses_nothing_up() {
    let server = Server::start();
    let mut churn = client(server.name(), "churn");
    let folder = server.endpoint().folder().to_path_buf();
    let own =
        |churn: &mut Process| churn.line().parse::<usize>().expect("the number of open files");
    let held = || {
        let remains = server.endpoint().remains().unwrap().len();
        let entries = count_files(&folder.join("nodes")) + count_files(&folder.join("services"));
        (server.open_files(), remains, entries)
    };
    let (first, before) = (own(&mut churn), held());
    churn.input().write_all(b"again\n").unwrap();
    assert_eq!(own(&mut churn), first, "open files of the client");
    // The server opens files for moments, when it lists the nodes that are alive.
    eventually("the server has as much as before", || held() == before);
}

#[test]
fn clients_that_come_at_once_are_all_served() {
    let server = Server::start();
    let start = Instant::now();
    let mut clients: Vec<Process> = (0..32).map(|_| client(server.name(), "digest")).collect();
    let expected = digest();
    for client in &mut clients {
        assert_eq!(client.line(), expected);
    }
    report("32 clients at once: all served", start);
    for client in &mut clients {
        assert!(client.finish().0.success());
    }
}
