//! `trocar rollout --policy FILE.onnx`, with networks that are written here, number by number.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use trocar_proto::builtin;

const TASK: &str = "NeedleReach-v0";

/// Metadata that says so.
const FOR_TASK: &[(&str, &str)] = &[("trocar.task", TASK)];

/// How long a server may take to come up.
const PATIENCE: Duration = Duration::from_mins(1);

fn trocar(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_trocar"));
    command.args(arguments).env_remove("TROCAR_SERVER").env("TROCAR_LOG", "warn");
    command
}

fn rollout(policy: &Path, more: &[&str]) -> Output {
    let policy = policy.to_str().unwrap();
    let flags = ["rollout", "--policy", policy, "--episodes", "12", "--json"];
    trocar(&[&flags[..], more].concat()).output().unwrap()
}

fn row(output: &Output) -> Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Messages of ONNX's format (Protocol Buffers), field by field.
mod proto {
    pub(super) fn number(field: u8, value: u64) -> Vec<u8> {
        let mut bytes = vec![field << 3];
        varint(&mut bytes, value);
        bytes
    }

    pub(super) fn bytes(field: u8, value: &[u8]) -> Vec<u8> {
        let mut bytes = vec![field << 3 | 2];
        varint(&mut bytes, value.len() as u64);
        bytes.extend(value);
        bytes
    }

    fn varint(bytes: &mut Vec<u8>, mut value: u64) {
        while value >= 0x80 {
            bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        bytes.push(value as u8);
    }
}

/// A network that goes towards the goal: `tanh((desired − achieved) · matrix)`, where the matrix has
/// `gain` (1/m) for each axis and nothing for the other actions. Inputs have `width` numbers; `told` is the
/// file's metadata.
fn towards_goal(name: &str, told: &[(&str, &str)], gain: f32, width: u64) -> PathBuf {
    use proto::{bytes, number};
    let node = |kind: &str, inputs: &[&str], output: &str| {
        let inputs = inputs.iter().flat_map(|input| bytes(1, input.as_bytes()));
        let rest = [bytes(2, output.as_bytes()), bytes(4, kind.as_bytes())].concat();
        bytes(1, &inputs.chain(rest).collect::<Vec<_>>())
    };
    let port = |field: u8, name: &str, width: u64| {
        let dims = [1, width].map(|dim| bytes(1, &number(1, dim))).concat();
        let tensor = [number(1, 1), bytes(2, &dims)].concat();
        bytes(field, &[bytes(1, name.as_bytes()), bytes(2, &bytes(1, &tensor))].concat())
    };
    let matrix: Vec<f32> = (0..width as usize * 5)
        .map(|index| if index / 5 == index % 5 { gain } else { 0.0 })
        .collect();
    let raw: Vec<u8> = matrix.iter().flat_map(|number| number.to_le_bytes()).collect();
    let matrix =
        [number(1, width), number(1, 5), number(2, 1), bytes(8, b"matrix"), bytes(9, &raw)];
    let graph = [
        node("Sub", &["desired_goal", "achieved_goal"], "way"),
        node("MatMul", &["way", "matrix"], "step"),
        node("Tanh", &["step"], "action"),
        bytes(2, b"policy"),
        bytes(5, &matrix.concat()),
        port(11, "achieved_goal", width),
        port(11, "desired_goal", width),
        port(12, "action", 5),
    ];
    let mut model = [number(1, 8), bytes(7, &graph.concat()), bytes(8, &number(2, 18))].concat();
    for (key, value) in told {
        model.extend(bytes(14, &[bytes(1, key.as_bytes()), bytes(2, value.as_bytes())].concat()));
    }
    let path = std::env::temp_dir().join(format!("trocar-{}-{name}.onnx", std::process::id()));
    std::fs::write(&path, model).unwrap();
    path
}

#[test]
fn a_network_that_goes_to_the_goal_succeeds_and_its_opposite_does_not() {
    let there = towards_goal("there", FOR_TASK, 60.0, 3);
    let away = towards_goal("away", FOR_TASK, -60.0, 3);
    let found = row(&rollout(&there, &[]));
    assert_eq!(found["task"], TASK, "the file says what it was trained for");
    assert_eq!(found["policy"], there.to_str().unwrap());
    assert_eq!(found["success_rate"], 1.0);
    assert!(found["mean_return"].as_f64().unwrap() > -25.0);
    assert_eq!(row(&rollout(&away, &[]))["success_rate"], 0.0);
    for path in [there, away] {
        std::fs::remove_file(path).unwrap();
    }
}

#[test]
fn it_acts_under_the_options_that_it_was_trained_with_unless_others_are_given() {
    let told = [FOR_TASK, &[("trocar.options", r#"{"terminate": "success"}"#)]].concat();
    let policy = towards_goal("options", &told, 60.0, 3);
    let length = |more: &[&str]| row(&rollout(&policy, more))["mean_length"].as_f64().unwrap();
    assert!(length(&[]) < 30.0);
    assert!(length(&["--option", "terminate=never"]) > 49.0);
    std::fs::remove_file(policy).unwrap();
}

#[test]
fn policies_that_come_with_trocar_have_names() {
    for name in ["NeedleReach", TASK] {
        let found = row(&rollout(Path::new(name), &[]));
        assert_eq!((&found["task"], &found["policy"]), (&TASK.into(), &TASK.into()));
        assert_eq!(found["success_rate"], 1.0);
    }
    let output = trocar(&["policies", "--json"]).output().unwrap();
    let lines = String::from_utf8(output.stdout).unwrap();
    let cards: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(cards.len(), builtin::ALL.len());
    for card in cards {
        assert!(
            card["command"].as_str().unwrap().contains(card["task"].as_str().unwrap()),
            "{card}"
        );
    }
    let folder = std::env::temp_dir().join(format!("trocar-{}-saved", std::process::id()));
    let saved = trocar(&["policies", "--save", folder.to_str().unwrap()]).output().unwrap();
    assert!(saved.status.success());
    let saved = row(&rollout(&folder.join(format!("{TASK}.onnx")), &[]));
    assert_eq!(saved["success_rate"], 1.0);
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn it_acts_the_same_where_people_watch() {
    let policy = towards_goal("watched", FOR_TASK, 60.0, 3);
    let short = ["--option", "terminate=success"];
    let alone = row(&rollout(&policy, &short));
    let output = rollout(&policy, &[&short[..], &["--view"]].concat());
    assert!(String::from_utf8_lossy(&output.stderr).contains("http://"));
    for field in ["success_rate", "mean_return", "mean_length"] {
        assert_eq!(row(&output)[field], alone[field], "{field}");
    }
    std::fs::remove_file(policy).unwrap();
}

#[test]
fn learning_is_that_of_python() {
    let learn = ["learn", "NeedlePick", "--python", "echo", "--algo", "bc", "--view"];
    let output = trocar(&learn).output().unwrap();
    let told = String::from_utf8(output.stdout).unwrap();
    assert_eq!(told, "-m trocar.rl train --task NeedlePick --algo bc --view\n");
    let output = trocar(&["learn", "NeedlePick", "--python", "/no/such/python"]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("/no/such/python"));
}

#[test]
fn it_can_be_looked_at() {
    let (there, away) =
        (towards_goal("seen", FOR_TASK, 60.0, 3), towards_goal("unseen", FOR_TASK, -60.0, 3));
    let pictures = [&there, &away].map(|policy| {
        let out = policy.with_extension("png");
        let policy = ["--policy", policy.to_str().unwrap(), "--out", out.to_str().unwrap()];
        let output = trocar(&["render"]).args(policy).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && stderr.contains(TASK), "{stderr}");
        let picture = std::fs::read(&out).unwrap();
        std::fs::remove_file(out).unwrap();
        picture
    });
    assert_ne!(pictures[0], pictures[1], "one goes to the goal, the other away from it");
    for path in [there, away] {
        std::fs::remove_file(path).unwrap();
    }
}

#[test]
fn it_acts_the_same_in_a_server() {
    struct Server(Child);
    impl Drop for Server {
        fn drop(&mut self) {
            self.0.kill().ok();
            self.0.wait().ok();
        }
    }

    let policy = towards_goal("served", &[], 60.0, 3);
    let name = format!("network-{}", std::process::id());
    let server = trocar(&["serve", "--name", &name]).stderr(Stdio::null()).spawn().unwrap();
    let server = Server(server);
    let start = Instant::now();
    while !trocar(&["status", "--name", &name]).output().unwrap().status.success() {
        assert!(start.elapsed() < PATIENCE, "the server does not come up");
    }
    let task = ["--task", TASK, "--seed", "5"];
    let here = row(&rollout(&policy, &task));
    let there = row(&rollout(&policy, &[&task[..], &["--server", &name, "--envs", "5"]].concat()));
    for field in ["success_rate", "success_ever_rate", "mean_return", "mean_length"] {
        assert_eq!(here[field], there[field], "{field}");
    }
    drop(server);
    trocar(&["clean", "--name", &name]).output().unwrap();
    std::fs::remove_file(policy).unwrap();
}

#[test]
fn what_does_not_fit_is_refused() {
    let refused = |policy: &Path, more: &[&str], told: &str| {
        let output = rollout(policy, more);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        assert!(stderr.contains(told), "{stderr}");
        assert!(output.stdout.is_empty());
    };
    let known = towards_goal("known", FOR_TASK, 60.0, 3);
    refused(&known, &["--task", "EcmReach-v0"], TASK);
    let unknown = towards_goal("unknown", &[], 60.0, 3);
    refused(&unknown, &[], "--task");
    let wide = towards_goal("wide", &[], 60.0, 4);
    refused(&wide, &["--task", TASK], "4 numbers");
    refused(Path::new("policy.pt"), &[], ".onnx");
    refused(Path::new("NeedlePack"), &[], "NeedlePick");
    refused(Path::new("/no/such/policy.onnx"), &[], "/no/such/policy.onnx");
    std::fs::write(&wide, b"no network").unwrap();
    refused(&wide, &["--task", TASK], "--policy");
    for path in [known, unknown, wide] {
        std::fs::remove_file(path).unwrap();
    }
}
