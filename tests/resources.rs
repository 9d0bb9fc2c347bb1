//! What can run out: open files, shared memory, the server's patience and its clients'.

use std::process::Command;
use std::time::Duration;

use rustix::process::Signal;
use trocar_client::{CallError, Client, ConnectError, SessionRequest};
use trocar_proto::open_files::SESSION_FILES;

use crate::harness::{Server, Watchdog, binary, client, eventually, soak, unique_name};
use crate::namespaces::unshare;
use crate::twin::Bystander;

/// A server that may have so many files open.
fn narrow(files: u32) -> Server {
    let name = unique_name();
    let mut command = Command::new("sh");
    command.args(["-c", "ulimit -n $0; exec \"$@\"", &files.to_string()]).arg(binary());
    command.args(["serve", "--name", &name, "--threads", "2"]).env("TROCAR_LOG", "warn");
    Server::start_command(&name, &mut command)
}

/// Files that a session really takes, and that a server keeps for control.
const SESSION_FILES_MEASURED: usize = 7;
const CONTROL_FILES: usize = 64;

fn assert_names(said: &str, parts: &[&str]) {
    for part in parts {
        assert!(said.contains(part), "{said:?} does not name {part:?}");
    }
}

#[test]
fn a_client_that_opens_sessions_without_end_is_refused_and_others_go_on() {
    let rounds = if soak() { 100 } else { 1 };
    for files in [256, 1024, 4096] {
        let server = narrow(files);
        let before = {
            let _client = server.connect();
            server.open_files()
        };
        let mut took = vec![];
        for _ in 0..rounds {
            took.push(outdo_a_greedy_client(&server, files));
            // What the round itself has had.
            eventually("nothing is open any more", || server.open_files() <= before);
        }
        took.sort();
        let (median, worst) = (took[took.len() / 2], took[took.len() - 1]);
        eprintln!(
            "{files} files, {rounds} times: all is back after {median:?} (median), {worst:?} (worst)"
        );
    }
}

/// Lets others go on while a client opens sessions without end, kills it, and says how long the server takes to have
/// all back.
fn outdo_a_greedy_client(server: &Server, files: u32) -> Duration {
    let others: Vec<Bystander> = (0..3).map(|_| Bystander::start(server)).collect();
    let few = server.open_files();
    let mut greedy = client(server.name(), "greedy");
    let said = greedy.line();
    if files < 4096 {
        let limit = format!("of the {files}");
        assert_names(&said, &["open files", &limit, "a session takes 8", "ulimit -n"]);
    } else {
        assert_names(&said, &["sessions of 512", "kept for other processes"]);
    }
    // Later clients have room, too.
    let late: Vec<Client> = (0..2).map(|_| server.connect()).collect();
    for client in &late {
        let mut session = client.open(&SessionRequest::new("EcmReach-v0")).unwrap();
        session.reset().unwrap();
    }
    let observer = server.connect();
    let sessions = observer.status().unwrap().sessions;
    let held = sessions.iter().filter(|session| session.pid == greedy.pid()).count();
    assert!(held > 8, "{held}");
    if files < 4096 {
        // Three quarters at most of what there was for sessions, also where it opens them faster than they take files.
        let (took, most) = (held * SESSION_FILES_MEASURED, files as usize - CONTROL_FILES - few);
        assert!(4 * took <= 3 * most, "{took} files of {most}");
    }
    greedy.kill();
    // The connections of the observer and the later clients are there still.
    let took = eventually("all is back", || {
        let left = observer.status().unwrap().sessions.len();
        left <= others.len() && server.open_files() < few + SESSION_FILES * 3
    });
    others.into_iter().for_each(Bystander::finish);
    drop(observer.open(&SessionRequest::new("EcmReach-v0")).unwrap());
    took
}

#[test]
fn clients_of_a_server_that_stands_still_are_told_and_go_on_with_it() {
    let mut server = Server::start();
    let client = server.connect();
    let mut session = client.open(&SessionRequest::new("EcmReach-v0")).unwrap();
    session.reset().unwrap();
    server.process().stop();
    let actions = vec![0.5; session.spec().action_dim()];
    let said = |error: CallError| match error {
        CallError::Timeout { .. } => error.to_string(),
        other => panic!("{other}"),
    };
    let name = server.name().to_string();
    let connection = std::thread::spawn(move || Client::connect(&name).unwrap_err());
    let waiting = client.clone();
    let status = std::thread::spawn(move || waiting.status().unwrap_err());
    assert_names(&said(session.step(&actions).unwrap_err()), &["step", "stopped"]);
    assert_names(&said(status.join().unwrap()), &["the status", "stopped"]);
    let refused = connection.join().unwrap();
    assert!(matches!(refused, ConnectError::Timeout { .. }), "{refused}");
    server.process().signal(Signal::CONT);
    assert_eq!(session.recv().unwrap().steps(), [1], "the step was carried out");
    assert_eq!(session.step(&actions).unwrap().steps(), [2]);
    assert_eq!(client.status().unwrap().sessions.len(), 1);
}

/// A shell's script, with a `/dev/shm` of its own of so many KiB; `None` where this user may not do that.
fn with_shared_memory(kibibytes: u32, script: &str, name: &str) -> Option<Command> {
    let mut command = unshare()?;
    let mount = format!("mount -t tmpfs -o size={kibibytes}k tmpfs /dev/shm || exit 1; {script}");
    command.args(["sh", "-c", &mount]).arg(binary()).arg(name);
    Some(command)
}

#[test]
fn a_server_that_begins_in_little_shared_memory_says_so() {
    let _watchdog = Watchdog::start();
    for free in [0, 32, 64, 1024] {
        let size = 8192;
        let script = format!(
            "head -c {} /dev/zero > /dev/shm/filler; \"$0\" serve --name \"$1\" 2>&1; echo $?",
            (size - free) * 1024
        );
        let Some(mut command) = with_shared_memory(size, &script, &unique_name()) else { return };
        let output = command.output().unwrap();
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(said.trim_end().ends_with("\n1"), "{free} KiB: {said:?}");
        let room = ["No space left on device", "KiB of /dev/shm are free"];
        assert!(room.iter().any(|words| said.contains(words)), "{free} KiB: {said:?}");
    }
}

/// Lets so many clients open 50 sessions each and be killed; returns the server's memory after that, bytes.
fn memory_after(server: &Server, clients: usize, files: usize) -> u64 {
    for _ in 0..clients {
        let mut fifty = client(server.name(), "fifty");
        assert_eq!(fifty.line(), "ready");
        fifty.kill();
        eventually("its sessions are gone", || server.open_files() <= files);
    }
    // At least once a second, the server looks what it can give back.
    std::thread::sleep(Duration::from_secs(2));
    server.memory()
}

/// What a server keeps after a thousand sessions is all that it keeps after a hundred thousand.
#[test]
fn sessions_of_killed_clients_leave_no_memory_behind() {
    let (looks, clients) = if soak() { (100, 20) } else { (3, 4) };
    let server = Server::start();
    // Once a client is connected, the server has opened all that it keeps open.
    let _observer = server.connect();
    let files = server.open_files();
    let early = memory_after(&server, clients, files);
    let later = (1..looks).map(|_| memory_after(&server, clients, files));
    let growth = later.max().unwrap().saturating_sub(early);
    let (first, all) = (50 * clients, 50 * clients * looks);
    eprintln!(
        "{} KiB after {first} sessions, at most {} KiB more after up to {all}",
        early >> 10,
        growth >> 10
    );
    assert!(growth <= 5 << 20, "{early} bytes, then {growth} more");
}
