//! The command as a user meets it: exit codes, streams, JSON fields.

use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use trocar_proto::builtin;

/// How long anything here may take before it counts as hanging.
const PATIENCE: Duration = Duration::from_mins(1);

fn trocar(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_trocar"));
    command.args(arguments).env_remove("TROCAR_SERVER").env("TROCAR_LOG", "warn");
    command
}

fn run(arguments: &[&str]) -> Output {
    let child = trocar(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let pid = child.id();
    let (sender, ended) = std::sync::mpsc::channel();
    std::thread::spawn(move || sender.send(child.wait_with_output()));
    ended.recv_timeout(PATIENCE).unwrap_or_else(|_| panic!("{arguments:?} hangs: {pid}")).unwrap()
}

fn code(arguments: &[&str]) -> i32 {
    run(arguments).status.code().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn json_lines(output: &Output) -> Vec<Value> {
    assert!(output.status.success(), "{}", stderr(output));
    let text = std::str::from_utf8(&output.stdout).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn keys(object: &Value) -> Vec<&str> {
    object.as_object().unwrap().keys().map(String::as_str).collect()
}

/// A server that ends with this value, however the test ends.
struct Server {
    name: String,
    child: Child,
}

impl Server {
    fn start(test: &str) -> Self {
        let name = format!("cli-{}-{test}", std::process::id());
        let child = trocar(&["serve", "--name", &name, "--threads", "2"])
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let server = Self { name, child };
        let start = Instant::now();
        while code(&["status", "--name", &server.name]) != 0 {
            assert!(start.elapsed() < PATIENCE, "the server does not come up");
            std::thread::sleep(Duration::from_millis(20));
        }
        server
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
        run(&["clean", "--name", &self.name]);
    }
}

#[test]
fn every_help_text_shows_examples() {
    for command in [
        "serve", "status", "stop", "clean", "tasks", "rollout", "render", "record", "replay",
        "demos", "bench", "load", "demo",
    ] {
        let help = run(&[command, "--help"]);
        let text = String::from_utf8(help.stdout).unwrap();
        assert!(help.status.success() && text.contains("Examples:"), "{command}: {text}");
    }
    let text = String::from_utf8(run(&["--help"]).stdout).unwrap();
    assert!(text.contains("Exit codes:"), "{text}");
}

#[test]
fn a_program_that_is_built_apart_is_asked_for_where_it_is_missing() {
    let folder = std::env::temp_dir().join(format!("trocar-{}-alone", std::process::id()));
    std::fs::create_dir(&folder).unwrap();
    // Where it may not be linked to, it is copied.
    let (whole, alone) = (env!("CARGO_BIN_EXE_trocar"), folder.join("trocar"));
    if std::fs::hard_link(whole, &alone).is_err() {
        std::fs::copy(whole, &alone).unwrap();
    }
    let done = Command::new(&alone).args(["dvrk", "--task", "NeedlePick-v0"]).output().unwrap();
    std::fs::remove_dir_all(&folder).unwrap();
    assert_eq!(done.status.code(), Some(1));
    assert!(stderr(&done).contains("cargo build --release -p trocar-ros2"), "{}", stderr(&done));
}

#[test]
fn exit_codes_tell_what_was_wrong() {
    for usage in [
        ["rollout", "--task", "Juggle-v0"].as_slice(),
        &["rollout", "--task", "EcmReach-v0", "--spawn", "narrow"],
        &["rollout", "--reward", "shaped"],
        &["rollout", "--option", "weather=rain"],
        &["rollout", "--episodes", "0"],
        &["rollout", "--policy", "genius"],
        &["bench", "--task", "Juggle-v0"],
        &["bench", "--mode", "by_hand"],
        &["bench", "--envs", "0"],
        &["bench", "--option", "weather=rain"],
        &["serve", "--name", "no spaces"],
        &["serve", "--memory", "1"],
        &["juggle"],
    ] {
        assert_eq!(code(usage), 2, "{usage:?}");
    }
    for missing in ["status", "stop"] {
        assert_eq!(code(&[missing, "--name", "cli-nobody"]), 3, "{missing}");
    }
    assert_eq!(code(&["rollout", "--server", "cli-nobody"]), 3);
    assert_eq!(code(&["clean", "--name", "cli-nobody"]), 0);
}

#[test]
fn an_empty_variable_is_none_and_a_wrong_one_is_named() {
    let with = |variable: &str, value: &str| {
        trocar(&["clean", "--name", "cli-nobody"]).env(variable, value).output().unwrap()
    };
    for variable in ["TROCAR_LOG", "TROCAR_SERVER", "TROCAR_PYTHON", "TROCAR_PRIVATE_SERVER"] {
        let output = with(variable, "");
        assert!(output.status.success(), "{variable}: {}", stderr(&output));
    }
    let refused = with("TROCAR_LOG", "trocar=loud");
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("TROCAR_LOG = \"trocar=loud\""), "{}", stderr(&refused));
}

#[test]
fn a_refused_option_is_named_with_what_is_allowed() {
    let refused = run(&["rollout", "--task", "NeedleReach-v0", "--reward", "shaped"]);
    let text = stderr(&refused);
    for part in ["reward", "shaped", "sparse", "dense"] {
        assert!(text.contains(part), "{text}");
    }
    assert!(refused.stdout.is_empty());
}

#[test]
fn tasks_are_listed_with_dimensions_and_options() {
    let tasks = json_lines(&run(&["tasks", "--json"]));
    let ids: Vec<_> = tasks.iter().map(|task| task["id"].as_str().unwrap()).collect();
    assert_eq!((ids.len(), ids[0]), (builtin::ALL.len(), "NeedleReach-v0"), "{ids:?}");
    let expected = [
        "action_dim",
        "goal_dim",
        "id",
        "max_steps",
        "observation_dim",
        "options",
        "seconds_per_step",
    ];
    assert_eq!(keys(&tasks[0]), expected);
    assert_eq!(tasks[0]["action_dim"], 5);
    assert_eq!(tasks[0]["options"]["reward"]["default"], "sparse");
    let stdout = |arguments: &[&str]| String::from_utf8(run(arguments).stdout).unwrap();
    let table = stdout(&["tasks"]);
    assert!(table.contains("EcmReach-v0") && table.lines().count() < 50, "{table}");
    let options = stdout(&["tasks", "NeedlePick"]);
    assert_eq!(options, stdout(&["tasks", "NeedlePick-v0"]));
    for words in ["Task and episode", "grasp_distance", "Errors and randomisation"] {
        assert!(options.contains(words), "{words}");
    }
    let unknown = run(&["tasks", "NedlePick"]);
    assert_eq!(unknown.status.code(), Some(2));
    assert!(stderr(&unknown).contains("did you mean \"NeedlePick-v0\"?"), "{}", stderr(&unknown));
    let drive = run(&["drive", "--out", "/no/such/folder.trocar"]);
    assert_eq!(drive.status.code(), Some(2));
    assert!(stderr(&drive).contains("/no/such/folder.trocar"));
    let render = run(&["render", "--out", "/no/such/folder.gif"]);
    assert_eq!(render.status.code(), Some(2));
    assert!(stderr(&render).contains("/no/such/folder.gif"));
}

#[test]
fn options_have_one_syntax_and_suggestions() {
    let rollout = |option: &str| {
        let task = ["rollout", "--task", "NeedleReach", "--episodes", "1", "--json", "--option"];
        run(&[&task[..], &[option]].concat())
    };
    for option in ["domain.latency=1,2", r#"domain={"latency": [1, 2]}"#, "domain.latency=[1, 2]"] {
        let mean = json_lines(&rollout(option))[0]["mean_return"].clone();
        let expected = json_lines(&rollout("domain.latency=1,2"))[0]["mean_return"].clone();
        assert_eq!(mean, expected, "{option}");
    }
    for (option, suggestion) in
        [("rewards=dense", "reward"), ("reward=dence", "dense"), ("domain.latncy=1,2", "latency")]
    {
        let refused = rollout(option);
        let words = format!("did you mean {suggestion:?}?");
        assert_eq!(refused.status.code(), Some(2));
        assert!(stderr(&refused).contains(&words), "{}", stderr(&refused));
    }
    let refused = run(&["bench", "--option", "rewards=dense"]);
    assert!(stderr(&refused).contains("did you mean \"reward\"?"), "{}", stderr(&refused));
}

#[test]
fn a_server_lists_its_tasks_and_draws_their_episodes() {
    let server = Server::start("draws");
    let place = ["--server", server.name.as_str()];
    let listed = |more: &[&str]| json_lines(&run(&[&["tasks", "--json"], more].concat()));
    assert_eq!(listed(&place), listed(&[]));
    let picture = |more: &[&str]| {
        let name = format!("trocar-{}-{}.png", std::process::id(), more.len());
        let path = std::env::temp_dir().join(name);
        let flags = ["render", "--task", "NeedlePick", "--seconds", "4", "--size", "48x32"];
        let out = ["--out", path.to_str().unwrap()];
        let output = run(&[&flags[..], &out, more].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let bytes = std::fs::read(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        bytes
    };
    assert!(picture(&place) == picture(&[]), "a server draws another picture");
    let mask = run(&[&["render", "--show", "mask", "--out", "/tmp/mask.png"], &place[..]].concat());
    assert_eq!(mask.status.code(), Some(2), "{}", stderr(&mask));
}

#[test]
fn a_rollout_of_all_tasks_has_a_row_of_each() {
    let tasks = json_lines(&run(&["tasks", "--json"]));
    let rows = json_lines(&run(&["rollout", "--json", "--episodes", "1"]));
    let ids = |rows: &[Value], key: &str| -> Vec<Value> {
        rows.iter().map(|row| row[key].clone()).collect()
    };
    assert_eq!(ids(&rows, "task"), ids(&tasks, "id"));
}

#[test]
fn a_rollout_gives_the_same_numbers_in_a_server_and_however_batched() {
    let server = Server::start("same");
    let place = ["--server", server.name.as_str()];
    let cases = ["NeedleReach-v0", "NeedlePick-v0", "ActiveTrack-v0"]
        .into_iter()
        .flat_map(|task| ["oracle", "random"].map(|policy| (task, policy)));
    for (task, policy) in cases {
        let common = ["rollout", "--json", "--episodes", "4", "--seed", "40"];
        let mut common = [&common[..], &["--task", task, "--policy", policy]].concat();
        if task != "ActiveTrack-v0" {
            common.extend(["--reward", "dense"]);
        }
        let results = [
            [&common[..], &["--envs", "1"]].concat(),
            [&common[..], &["--envs", "3"]].concat(),
            [&common[..], &place, &["--envs", "1"]].concat(),
            [&common[..], &place, &["--envs", "3"]].concat(),
            [&common[..], &place, &["--envs", "64"]].concat(),
        ]
        .map(|arguments| {
            let mut rows = json_lines(&run(&arguments));
            assert_eq!(rows.len(), 1);
            assert!(rows[0]["steps_per_second"].as_f64().unwrap() > 0.0);
            rows[0].as_object_mut().unwrap().remove("steps_per_second");
            rows.remove(0)
        });
        let row = &results[0];
        assert!(results.iter().all(|other| other == row), "{results:#?}");
        assert_eq!(
            keys(row),
            [
                "episodes",
                "grasp",
                "mean_length",
                "mean_return",
                "policy",
                "success_ever_rate",
                "success_rate",
                "task"
            ]
        );
        let is_expert = policy == "oracle";
        assert_eq!(row["grasp"].is_null(), task != "NeedlePick-v0");
        if task == "ActiveTrack-v0" {
            // A task without goals has a return, and nothing to succeed in.
            assert_eq!(
                (&row["success_rate"], &row["success_ever_rate"]),
                (&Value::Null, &Value::Null)
            );
            let mean = row["mean_return"].as_f64().unwrap();
            assert!(if is_expert { mean > 450.0 } else { mean < 400.0 }, "{mean}");
        } else {
            assert_eq!(row["success_rate"], if is_expert { 1.0 } else { 0.0 });
        }
    }
}

#[test]
fn a_bench_measures_every_mode_that_it_can() {
    let arguments = "bench --quick --json --task EcmReach-v0 --envs 1,3 --policy random,oracle";
    let arguments: Vec<_> = arguments.split(' ').collect();
    let output = trocar(&arguments).env("TROCAR_PYTHON", "/nonexistent/python").output().unwrap();
    assert!(stderr(&output).contains("client_py is left out"), "{}", stderr(&output));
    assert!(stderr(&output).contains("/nonexistent/python"));
    let rows = json_lines(&output);
    let measured: Vec<_> = rows
        .iter()
        .map(|row| {
            assert_eq!(
                keys(row),
                [
                    "clients",
                    "envs",
                    "mode",
                    "policy",
                    "ratio_to_in_process",
                    "steps_per_cpu_second",
                    "steps_per_second",
                    "task",
                    "threads"
                ]
            );
            assert_eq!((&row["task"], &row["threads"]), (&"EcmReach-v0".into(), &1.into()));
            let word = |key: &str| row[key].as_str().unwrap().to_string();
            (word("policy"), row["envs"].as_u64().unwrap(), word("mode"))
        })
        .collect();
    let mut expected = vec![];
    for policy in ["random", "oracle"] {
        for envs in [1, 3] {
            for mode in ["in_process", "client_rs"] {
                expected.push((policy.to_string(), envs, mode.to_string()));
            }
        }
    }
    assert_eq!(measured, expected);
    // Each row of a client follows the one in-process that it is compared with.
    let rate = |row: &Value, name: &str| row[name].as_f64().unwrap();
    for pair in rows.chunks_exact(2) {
        let [here, there] = [0, 1].map(|row| rate(&pair[row], "steps_per_second"));
        assert_eq!(rate(&pair[0], "ratio_to_in_process"), 1.0);
        let ratio = rate(&pair[1], "ratio_to_in_process");
        assert!((ratio * here / there - 1.0).abs() < 1e-9, "{pair:?}");
    }
    // Alone, there is nothing to compare with.
    let alone = "bench --quick --json --task EcmReach-v0 --envs 2 --policy random --mode client_rs";
    let rows = json_lines(&run(&alone.split(' ').collect::<Vec<_>>()));
    assert_eq!((rows.len(), &rows[0]["ratio_to_in_process"]), (1, &Value::Null));
}

#[test]
fn a_server_is_shown_kept_and_stopped() {
    let mut server = Server::start("life");
    let name = server.name.clone();
    let status = json_lines(&run(&["status", "--json", "--name", &name]));
    assert_eq!(keys(&status[0]), ["epoch", "memory_bytes", "name", "pid", "sessions", "uptime_s"]);
    assert_eq!(status[0]["pid"], server.child.id());

    let second = run(&["serve", "--name", &name]);
    assert_eq!(second.status.code(), Some(4));
    assert!(stderr(&second).contains(&server.child.id().to_string()));
    assert_eq!(code(&["clean", "--name", &name]), 4);

    assert_eq!(code(&["stop", "--name", &name]), 0);
    // Stopping waits, so the process has ended and only its parent has not asked yet.
    assert!(server.child.wait().unwrap().success());
    assert_eq!(code(&["stop", "--name", &name]), 3);
    assert!(stderr(&run(&["clean", "--name", &name])).contains("nothing is left"));
}

#[test]
fn what_a_killed_server_leaves_is_cleaned() {
    let mut server = Server::start("killed");
    server.child.kill().unwrap();
    server.child.wait().unwrap();
    assert_eq!(code(&["status", "--name", &server.name]), 3);
    assert!(stderr(&run(&["clean", "--name", &server.name])).contains("removed"));
    assert!(stderr(&run(&["clean", "--name", &server.name])).contains("nothing is left"));
}

#[test]
fn a_server_that_does_not_answer_is_stopped_by_force() {
    let mut server = Server::start("stuck");
    let freeze = format!("kill -STOP {}", server.child.id());
    assert!(Command::new("sh").args(["-c", &freeze]).status().unwrap().success());
    assert_eq!(code(&["stop", "--name", &server.name, "--force"]), 0);
    assert!(!server.child.wait().unwrap().success());
}
