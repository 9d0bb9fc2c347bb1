//! `trocar load` as a user meets it: nothing is amiss and nothing is left, whichever process is
//! killed or stopped.

#![allow(clippy::unwrap_used)] // a panic is a test's report

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use trocar_proto::endpoint::{Endpoint, ServerState};

/// How long anything here may take before it counts as hanging.
const PATIENCE: Duration = Duration::from_mins(3);

/// The same for the long runs of `make soak`.
const SOAK_PATIENCE: Duration = Duration::from_mins(20);

/// Whether the long runs are wanted.
fn soak() -> bool {
    std::env::var_os("TROCAR_SOAK").is_some_and(|value| value == "1")
}

const KEYS: [&str; 15] = [
    "clients",
    "envs",
    "errors",
    "jain",
    "killed",
    "leaked",
    "mismatches",
    "p50_us",
    "p99_us",
    "reclaimed",
    "restarts",
    "server_memory_bytes",
    "steps",
    "steps_per_second",
    "stopped",
];

fn trocar(arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_trocar"));
    command.args(arguments.split(' ')).env_remove("TROCAR_SERVER").env("TROCAR_LOG", "warn");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Runs a command to its end; also gives its process id.
fn run(command: &mut Command) -> (u32, Output) {
    let child = command.spawn().unwrap();
    let pid = child.id();
    let (sender, ended) = channel();
    std::thread::spawn(move || sender.send(child.wait_with_output()));
    let output = ended.recv_timeout(if soak() { SOAK_PATIENCE } else { PATIENCE });
    (pid, output.unwrap_or_else(|_| panic!("{command:?} hangs: {pid}")).unwrap())
}

/// The report of a load that found nothing amiss.
fn sound(arguments: &str) -> Value {
    let (pid, output) = run(&mut trocar(arguments));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("0 errors, 0 mismatches with the in-process twins, 0 leaks"), "{said}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let keys: Vec<_> = report.as_object().unwrap().keys().collect();
    assert_eq!(keys, KEYS);
    for key in ["errors", "mismatches", "leaked"] {
        assert_eq!(report[key], 0, "{report}");
    }
    assert!(report["steps"].as_u64().unwrap() > 0, "{report}");
    let (p50, p99) = (report["p50_us"].as_f64().unwrap(), report["p99_us"].as_f64().unwrap());
    assert!(0.0 < p50 && p50 <= p99, "{report}");
    let jain = report["jain"].as_f64().unwrap();
    assert!(0.0 < jain && jain <= 1.0 + 1e-9, "{report}");
    assert!(report["server_memory_bytes"].as_u64().unwrap() > 1 << 20, "{report}");
    assert_nothing_is_left(pid);
    report
}

/// The server that a load of that process has of its own.
fn own_server(pid: u32) -> Endpoint {
    Endpoint::new(&format!("load-{pid}").parse().unwrap())
}

fn assert_nothing_is_left(pid: u32) {
    let left = own_server(pid).remains().unwrap();
    assert!(left.is_empty(), "{left:?}");
}

fn eventually(what: &str, mut holds: impl FnMut() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < PATIENCE, "waited in vain until {what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Processes whose parent is `pid`.
fn children(pid: u32) -> Vec<u32> {
    let listed = std::fs::read_to_string(format!("/proc/{pid}/task/{pid}/children"));
    let listed = listed.unwrap_or_default();
    listed.split_whitespace().map(|pid| pid.parse().unwrap()).collect()
}

/// Whether a process runs, be it stopped.
fn runs(pid: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.rsplit_once(')').is_some_and(|(_, fields)| !fields.trim_start().starts_with(['Z', 'X']))
}

fn signal(pid: u32, signal: Signal) {
    kill_process(Pid::from_raw(pid.cast_signed()).unwrap(), signal).unwrap();
}

/// A load that is killed with this value.
struct Load(Child);

impl Load {
    /// Starts one with clients that are killed and stopped; returns when some were.
    fn start() -> Self {
        let arguments = "load --seconds 600 --clients 3 --envs 2 --stop-every 0.3 --kill-every 1";
        let load =
            Self(trocar(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap());
        let pid = load.0.id();
        eventually("the server and three clients run", || {
            matches!(own_server(pid).server_state(), ServerState::Running { .. })
                && children(pid).len() == 4
        });
        let first = children(pid);
        eventually("one was killed and another started", || {
            children(pid).iter().any(|child| !first.contains(child))
        });
        load
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

#[test]
fn a_short_load_finds_nothing_amiss() {
    let report = sound("load --json --seconds 2 --clients 3 --envs 2");
    assert_eq!((&report["clients"], &report["envs"]), (&3.into(), &2.into()));
    for key in ["killed", "reclaimed", "stopped", "restarts"] {
        assert_eq!(report[key], 0, "{report}");
    }
}

#[test]
fn killed_clients_are_reclaimed_and_stopped_ones_go_on() {
    let report = sound(if soak() {
        "load --json --seconds 600 --clients 16 --kill-every 2 --stop-every 5"
    } else {
        "load --json --seconds 15 --clients 16 --kill-every 0.5 --stop-every 1.5"
    });
    // Half of what was asked for: a busy machine is late.
    let (killed, stopped) = if soak() { (150, 60) } else { (15, 5) };
    assert!(report["killed"].as_u64().unwrap() >= killed, "{report}");
    assert_eq!(report["killed"], report["reclaimed"]);
    assert!(report["stopped"].as_u64().unwrap() >= stopped, "{report}");
}

#[test]
fn a_client_beside_others_of_another_task_is_compared_with_its_share() {
    let arguments = "load --json --seconds 3 --clients 3 --envs 2 --others NeedlePick-v0";
    let (_, output) = run(&mut trocar(arguments));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("client 1 beside the others: p99"), "{said}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report.as_object().unwrap().len(), KEYS.len() + 2, "{report}");
    // Two others have a turn of 1 ms or more each.
    assert!(report["share_us"].as_f64().unwrap() > 1000.0 * 2.0 / 64.0, "{report}");
    assert!(report["first_p99_us"].as_f64().unwrap() > 0.0, "{report}");
}

#[test]
fn clients_find_a_restarted_server() {
    let (seconds, least) = if soak() { (300, 100) } else { (6, 2) };
    let report =
        sound(&format!("load --json --seconds {seconds} --clients 3 --envs 2 --restart-server 1"));
    assert!(report["restarts"].as_u64().unwrap() >= least, "{report}");
}

#[test]
fn python_clients_are_compared_as_well() {
    // `make test-python` names one that has the package; by chance, another may have it, too.
    if std::env::var_os("TROCAR_PYTHON").is_none() {
        let found = Command::new("python3").args(["-c", "import trocar"]).output();
        if !found.is_ok_and(|output| output.status.success()) {
            eprintln!(
                "skipped: python3 has no package trocar; TROCAR_PYTHON may name one that has"
            );
            return;
        }
    }
    let report = sound("load --json --seconds 4 --clients 3 --envs 2 --kill-every 1 --python");
    assert_eq!(report["killed"], report["reclaimed"]);
    sound("load --json --seconds 4 --clients 2 --envs 2 --restart-server 1 --python");
}

#[test]
fn a_missing_package_is_named() {
    let mut command = trocar("load --python --seconds 1");
    let (pid, output) = run(command.env("TROCAR_PYTHON", "/nonexistent/python"));
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("/nonexistent/python") && said.contains("$TROCAR_PYTHON"), "{said}");
    assert_nothing_is_left(pid);
}

#[test]
fn a_server_that_runs_already_is_left_running() {
    let name = format!("loaded-{}", std::process::id());
    let mut server = trocar(&format!("serve --name {name} --follow {}", std::process::id()))
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let endpoint = Endpoint::new(&name.parse().unwrap());
    eventually("the server runs", || {
        matches!(endpoint.server_state(), ServerState::Running { .. })
    });
    let arguments = format!("load --json --seconds 2 --clients 2 --envs 2 --server {name}");
    sound(&format!("{arguments} --kill-every 0.5"));
    assert!(server.try_wait().unwrap().is_none());

    // A load whose server dies is none that found nothing amiss.
    let mut load = trocar(&format!("{arguments} --seconds 600").replace("--seconds 2 ", ""));
    let mut load = load.spawn().unwrap();
    eventually("two clients run", || children(load.id()).len() == 2);
    std::thread::sleep(Duration::from_secs(1));
    server.kill().unwrap();
    server.wait().unwrap();
    let mut said = BufReader::new(load.stderr.take().unwrap()).lines();
    assert!(said.any(|line| line.unwrap().contains("error:")));
    assert_eq!(load.wait().unwrap().code(), Some(1));
    assert!(endpoint.remains().unwrap().is_empty());
}

#[test]
fn wrong_usage_starts_nothing() {
    for (arguments, code) in [
        ("load --task Juggle-v0", 2),
        ("load --others Juggle-v0", 2),
        ("load --clients 0", 2),
        ("load --seconds -1", 2),
        ("load --kill-every 0", 2),
        ("load --server lab --restart-server 1", 2),
        ("load --server cli-nobody", 3),
    ] {
        let (pid, output) = run(&mut trocar(arguments));
        assert_eq!(output.status.code(), Some(code), "{arguments}");
        assert_nothing_is_left(pid);
    }
}

#[test]
fn ctrl_c_ends_everything() {
    let mut load = Load::start();
    let pid = load.0.id();
    let started = children(pid);
    signal(pid, Signal::INT);
    assert_eq!(load.0.wait().unwrap().code(), Some(1));
    assert!(!started.into_iter().any(runs));
    assert_nothing_is_left(pid);
}

#[test]
fn a_killed_load_takes_its_clients_and_its_server_along() {
    let mut load = Load::start();
    let pid = load.0.id();
    let started = children(pid);
    load.0.kill().unwrap();
    load.0.wait().unwrap();
    eventually("all have ended", || !started.iter().copied().any(runs));
    eventually("nothing is left", || own_server(pid).remains().unwrap().is_empty());
}
