//! Server and client in separate process namespaces, as in two containers that share `/dev/shm`:
//! they work together, and notice each other's end.

use std::ffi::OsStr;
use std::process::Command;
use std::time::Instant;

use crate::harness::{Process, Server, client_command, eventually, serve, unique_name};
use crate::twin::{Bystander, digest};

/// `command` as process 1 of a process namespace of its own, and killed with its parent; `None`
/// where this user may not do that.
fn apart(command: &Command) -> Option<Command> {
    let mut apart = unshare()?;
    apart.arg(command.get_program()).args(command.get_args());
    for (name, value) in command.get_envs() {
        match value {
            Some(value) => apart.env(name, value),
            None => apart.env_remove(name),
        };
    }
    Some(apart)
}

pub(crate) fn unshare() -> Option<Command> {
    let arguments = ["--pid", "--fork", "--mount-proc", "--kill-child"];
    // Without being root, a namespace of users that maps this one to itself.
    for more in [&[][..], &["--user", "--map-current-user"]] {
        let mut unshare = Command::new("unshare");
        unshare.args(more).args(arguments);
        if unshare.arg("true").output().is_ok_and(|output| output.status.success()) {
            let mut unshare = Command::new("unshare");
            unshare.args(more).args(arguments);
            return Some(unshare);
        }
    }
    eprintln!("skipped: this user may not create process namespaces (unshare --pid)");
    None
}

fn client_apart(server: &str, role: &str) -> Option<Process> {
    Some(Process::spawn(&mut apart(&client_command(server, role))?))
}

/// Starts a server in a namespace of its own; the process is `unshare`, which it dies with.
fn server_apart(name: &str) -> Option<Process> {
    let server = Process::spawn(&mut apart(serve(name).args(["--threads", "2"]))?);
    let endpoint = crate::harness::endpoint(name);
    eventually("the server runs", || {
        matches!(endpoint.server_state(), trocar_proto::endpoint::ServerState::Running { .. })
    });
    Some(server)
}

#[test]
fn clients_in_other_namespaces_see_the_same_bits() {
    let server = Server::start();
    let expected = digest();
    // All of them are process 1 of their namespace.
    let clients: Option<Vec<Process>> =
        (0..3).map(|_| client_apart(server.name(), "digest")).collect();
    let Some(mut clients) = clients else { return };
    let bystander = Bystander::start(&server);
    for client in &mut clients {
        assert_eq!(client.line(), expected);
    }
    assert_eq!(server.connect().status().unwrap().sessions.len(), 4);
    for client in &mut clients {
        assert!(client.finish().0.success());
    }
    bystander.finish();
}

#[test]
fn a_client_killed_in_another_namespace_is_reclaimed_and_others_are_not() {
    let server = Server::start();
    let observer = server.connect();
    let Some(mut victim) = client_apart(server.name(), "step") else { return };
    let Some(mut other) = client_apart(server.name(), "hold") else { return };
    assert_eq!((victim.line(), other.line()), ("ready".into(), "ready".into()));
    let bystander = Bystander::start(&server);
    eventually("three sessions", || observer.status().unwrap().sessions.len() == 3);
    let killed = Instant::now();
    victim.kill();
    eventually("its session is gone", || observer.status().unwrap().sessions.len() == 2);
    eprintln!("client killed in its namespace: gone after {} ms", killed.elapsed().as_millis());
    std::thread::sleep(std::time::Duration::from_secs(1));
    assert_eq!(observer.status().unwrap().sessions.len(), 2);
    assert!(other.finish().0.success());
    bystander.finish();
}

#[test]
fn a_server_in_another_namespace_serves_and_is_missed() {
    let _watchdog = crate::harness::Watchdog::start();
    let name = unique_name();
    let Some(mut server) = server_apart(&name) else { return };
    let mut near = crate::harness::client(&name, "until-lost");
    let Some(mut apart) = client_apart(&name, "until-lost") else { return };
    assert_eq!((near.line(), apart.line()), ("ready".into(), "ready".into()));
    let mut twin = crate::harness::client(&name, "digest");
    assert_eq!(twin.line(), digest());
    server.kill();
    assert_eq!((near.line(), apart.line()), ("died".into(), "died".into()));
    for client in [&mut near, &mut apart, &mut twin] {
        assert!(client.finish().0.success());
    }
    // A successor outside of that namespace, then nothing.
    drop(Server::start_named(&name, &[]));
}

/// Both sides see a small `/dev/shm` of their own.
#[test]
fn sessions_that_shared_memory_cannot_hold_are_refused() {
    let _watchdog = crate::harness::Watchdog::start();
    let name = unique_name();
    let script = "mount -t tmpfs -o size=8m tmpfs /dev/shm || exit 1; \
                  \"$0\" serve --name \"$2\" & exec \"$1\" fill \"$2\"";
    let Some(mut command) = unshare() else { return };
    let program = crate::harness::binary().as_os_str();
    let test_client = client_command(&name, "fill");
    let arguments: [&OsStr; 6] = [
        OsStr::new("sh"),
        OsStr::new("-c"),
        OsStr::new(script),
        program,
        test_client.get_program(),
        OsStr::new(&name),
    ];
    let mut filler = Process::spawn(command.args(arguments));
    let said = filler.line();
    for part in ["envs", "/dev/shm", "--shm-size"] {
        assert!(said.contains(part), "{said:?} does not name {part:?}");
    }
    assert_eq!(filler.line(), "all stepped");
    assert!(filler.finish().0.success());
}
