//! Recordings: what was played comes again bit by bit, also what a trainer did in a server.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal};
use serde_json::Value;
use trocar_client::{Autoreset, Client, Options, SessionRequest};

/// How long anything here may take before it counts as hanging.
const PATIENCE: Duration = Duration::from_mins(2);

fn trocar(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_trocar"));
    command.args(arguments).env_remove("TROCAR_SERVER").env("TROCAR_LOG", "warn");
    command
}

fn run(arguments: &[&str]) -> Output {
    trocar(arguments).output().unwrap()
}

fn rows(output: &Output) -> Vec<Value> {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = std::str::from_utf8(&output.stdout).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// A file of this test's own.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        Self(std::env::temp_dir().join(format!("trocar-{}-{name}", std::process::id())))
    }

    fn path(&self) -> &str {
        self.0.to_str().unwrap()
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        std::fs::remove_file(&self.0).ok();
    }
}

#[test]
fn a_rollout_is_recorded_and_played_again() {
    let file = Scratch::new("reach.trocar");
    let common = ["--task", "NeedleReach-v0", "--option", "reward=dense", "--episodes", "2"];
    let record = [&["record"], &common[..], &["--seed", "5", "--out", file.path()]].concat();
    assert!(run(&record).status.success());
    let replayed = rows(&run(&["replay", "--json", file.path()]));
    assert_eq!(replayed.len(), 2);
    for (row, seed) in replayed.iter().zip(5..) {
        assert_eq!((&row["seed"], &row["steps"]), (&seed.into(), &50.into()));
        assert_eq!((&row["snapshots"], &row["success"]), (&5.into(), &true.into()));
    }
    // The same episodes as a rollout's.
    let rollout = [&["rollout", "--json"], &common[..], &["--seed", "5"]].concat();
    let mean = rows(&run(&rollout))[0]["mean_return"].as_f64().unwrap();
    let sum: f64 = replayed.iter().map(|row| row["return"].as_f64().unwrap()).sum();
    assert!((sum / 2.0 - mean).abs() < 1e-9, "{sum} {mean}");

    let sheet = Scratch::new("reach.png");
    let small = ["--size", "32x24", "--moments", "3", "--episode", "1"];
    let draw = [&["replay", file.path(), "--out", sheet.path()], &small[..]].concat();
    assert!(run(&draw).status.success());
    // Two cameras beside each other, three moments, gaps of 4 pixels.
    let decoder = png::Decoder::new(BufReader::new(std::fs::File::open(&sheet.0).unwrap()));
    assert_eq!(decoder.read_info().unwrap().info().width, 3 * 64 + 2 * 4);
}

#[test]
fn a_recording_is_served_to_a_browser_until_somebody_ends_it() {
    let file = Scratch::new("watched.trocar");
    let record = ["record", "--task", "EcmReach-v0", "--out", file.path()];
    assert!(run(&record).status.success());
    let mut replay = trocar(&["replay", file.path(), "--view", "0"]);
    let mut replay = replay.stderr(Stdio::piped()).spawn().unwrap();
    let mut said = BufReader::new(replay.stderr.take().unwrap()).lines().map(Result::unwrap);
    let line = said.find(|line| line.contains("watch it at")).unwrap();
    let address = line.split("http://").nth(1).unwrap().split('/').next().unwrap();
    let mut stream = TcpStream::connect(address).unwrap();
    write!(stream, "GET / HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").unwrap();
    let mut page = String::new();
    stream.read_to_string(&mut page).unwrap();
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("<title>Trocar</title>"));
    let pid = Pid::from_child(&replay);
    rustix::process::kill_process(pid, Signal::INT).unwrap();
    assert!(replay.wait().unwrap().success());
}

#[test]
fn what_cannot_be_recorded_or_played_is_said() {
    let file = Scratch::new("bad.trocar");
    let said = |arguments: &[&str], code: i32, words: &str| {
        let output = run(arguments);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {text}");
        assert!(text.contains(words), "{arguments:?}: {text}");
    };
    said(&["record", "--out", file.path()], 2, "--task");
    said(&["record", "--task", "Needle", "--out", file.path()], 2, "NeedlePick-v0");
    said(&["record", "--session", "1", "--name", "nobody-here", "--out", file.path()], 3, "nobody");
    said(&["replay", file.path()], 2, "bad.trocar");
    assert!(run(&["record", "--task", "EcmReach-v0", "--out", file.path()]).status.success());
    said(&["replay", "--episode", "7", file.path()], 1, "no such episode");
    let mut bytes = std::fs::read(&file.0).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    std::fs::write(&file.0, &bytes).unwrap();
    said(&["replay", file.path()], 1, "checksum");
    std::fs::write(&file.0, &bytes[..7]).unwrap();
    said(&["replay", file.path()], 1, "bad.trocar");
    for command in [&["replay", file.path()][..], &["record", "--task", "EcmReach-v0"]] {
        said(&[command, &["--out", "/no/such/folder/file.png"]].concat(), 2, "/no/such/folder");
    }
}

#[test]
fn a_recording_that_was_cut_off_is_played_up_to_its_last_whole_part() {
    let file = Scratch::new("cut.trocar");
    let record = ["record", "--task", "EcmReach-v0", "--episodes", "2", "--out", file.path()];
    assert!(run(&record).status.success());
    let bytes = std::fs::read(&file.0).unwrap();
    std::fs::write(&file.0, &bytes[..bytes.len() - 1]).unwrap();
    let output = run(&["replay", "--json", file.path()]);
    let rows = rows(&output);
    assert_eq!((rows.len(), &rows[0]["steps"], &rows[1]["steps"]), (2, &50.into(), &40.into()));
    let text = String::from_utf8_lossy(&output.stderr);
    for words in ["cut.trocar: cut off", "it ends at step 40 of episode 1"] {
        assert!(text.contains(words), "{text}");
    }
}

#[test]
fn a_recording_of_a_policy_that_is_interrupted_is_whole() {
    for signal in [Signal::INT, Signal::TERM] {
        let file = Scratch::new("interrupted.trocar");
        let record = ["record", "--task", "ActiveTrack-v0", "--episodes", "100000", "--out"];
        let mut recorder = trocar(&[&record[..], &[file.path()]].concat());
        let recorder = recorder.stderr(Stdio::piped()).spawn().unwrap();
        let start = Instant::now();
        while std::fs::metadata(&file.0).map_or(0, |file| file.len()) == 0 {
            assert!(start.elapsed() < PATIENCE, "no part is written");
            std::thread::sleep(Duration::from_millis(5));
        }
        rustix::process::kill_process(Pid::from_child(&recorder), signal).unwrap();
        let output = recorder.wait_with_output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && text.contains("interrupted"), "{text}");
        let replayed = run(&["replay", "--json", file.path()]);
        assert!(!String::from_utf8_lossy(&replayed.stderr).contains("cut off"));
        let last = rows(&replayed).pop().unwrap();
        let end = format!("ends at step {}", last["steps"]);
        assert!(text.contains(&end), "{text}, {last}");
    }
}

#[test]
fn a_session_is_recorded_while_it_trains() {
    let name = format!("record-{}", std::process::id());
    let mut server = trocar(&["serve", "--name", &name, "--threads", "2", "--failures", "none"])
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let start = Instant::now();
    let client = loop {
        match Client::connect(&name) {
            Ok(client) => break client,
            Err(error) => assert!(start.elapsed() < PATIENCE, "{error}"),
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    let request = SessionRequest::new("NeedleReach-v0").envs(3).autoreset(Autoreset::SameStep);
    let request = request.options(Options::new().with_text("reward", "dense"));
    let mut session = client.open(&request).unwrap();
    session.want_expert(true);
    let mut expert = session.reset().unwrap().expert_action().to_vec();
    let id = session.info().session.to_string();

    let file = Scratch::new("live.trocar");
    let wrong = ["record", "--name", &name, "--session", "77", "--out", file.path()];
    assert_eq!(run(&wrong).status.code(), Some(1));
    let arguments = [
        "record",
        "--name",
        &name,
        "--session",
        &id,
        "--env",
        "1",
        "--episodes",
        "2",
        "--out",
        file.path(),
    ];
    let mut recorder = trocar(&arguments).stderr(Stdio::null()).spawn().unwrap();

    // Until it has what it wants; returns of environment 1 by the number of its episode.
    let (mut returns, mut total, mut episode) = (vec![], 0.0, 0);
    let start = Instant::now();
    while recorder.try_wait().unwrap().is_none() {
        assert!(start.elapsed() < PATIENCE, "the recorder does not end");
        let reply = session.step(&expert).unwrap();
        total += f64::from(reply.reward()[1]);
        if reply.truncated()[1] == 1 {
            returns.push((episode, total));
            (total, episode) = (0.0, reply.episode()[1]);
        }
        expert.copy_from_slice(reply.expert_action());
    }
    let played = rows(&run(&["replay", "--json", file.path()]));
    assert_eq!(played.len(), 2, "{played:?}");
    for row in &played {
        assert_eq!((&row["seed"], &row["steps"]), (&1.into(), &50.into()));
        let number = row["number"].as_u64().unwrap();
        let (_, seen) = returns.iter().find(|(episode, _)| *episode == number).unwrap();
        assert!((row["return"].as_f64().unwrap() - seen).abs() < 1e-9);
    }
    drop(session);
    drop(client);
    assert!(run(&["stop", "--name", &name]).status.success());
    assert!(server.wait().unwrap().success());
}
