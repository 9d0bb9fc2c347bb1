//! `trocar demos`: what it checks before Python has its turn. What it records, Python's tests look at.

use std::process::{Command, Output};

fn demos(python: &str, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_trocar"))
        .arg("demos")
        .args(arguments)
        .env_remove("TROCAR_SERVER")
        .env("TROCAR_PYTHON", python)
        .output()
        .unwrap()
}

#[track_caller]
fn assert_refused(output: &Output, code: i32, told: &str) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{stderr}");
    assert!(stderr.contains(told), "{stderr}");
}

#[test]
fn wrong_usage_needs_no_python() {
    let refused = |arguments: &[&str], told| {
        assert_refused(&demos("/no/such/python", arguments), 2, told);
    };
    refused(&["--task", "NoSuchTask-v0"], "NeedlePick-v0");
    refused(&["--task", "NeedlePick-v0", "--spawn", "nowhere"], "workspace");
    refused(&["--task", "NeedleReach-v0", "--grasp", "weld"], "grasp");
    refused(&["--task", "NeedlePick-v0", "--format", "csv"], "minari");
    refused(&["--task", "NeedlePick-v0", "--episodes", "0"], "episodes");
    let nowhere = ["--task", "NeedlePick-v0", "--server", "no-such-server"];
    assert_refused(&demos("/no/such/python", &nowhere), 3, "no-such-server");
}

#[test]
fn a_missing_python_is_named() {
    let output = demos("/no/such/python", &["--task", "NeedlePick-v0"]);
    assert_refused(&output, 1, "/no/such/python");
    assert_refused(&output, 1, "TROCAR_PYTHON");
}

#[test]
fn python_is_told_what_was_asked_for() {
    // A shell in Python's place says what it was started with.
    let folder = std::env::temp_dir().join(format!("trocar-demos-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let python = folder.join("python");
    std::fs::write(&python, "#!/bin/sh\nshift 2\necho \"$TROCAR_BINARY\" \"$@\"\nexit 5\n")
        .unwrap();
    let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
    std::fs::set_permissions(&python, mode).unwrap();
    let flags = ["--task", "NeedlePick-v0", "--episodes", "7", "--out", "data", "--resume"];
    let options = ["--grasp", "approx", "--grasp-distance", "0.001", "--keep-failures", "--json"];
    let output = demos(python.to_str().unwrap(), &[&flags[..], &options[..]].concat());
    let by_hand = ["--task", "NeedlePick-v0", "--by-hand", "--speed", "0.5", "--max-steps", "90"];
    let by_hand = demos(python.to_str().unwrap(), &by_hand);
    std::fs::remove_dir_all(&folder).unwrap();
    assert_eq!(output.status.code(), Some(5), "its exit code is ours");
    let said = String::from_utf8(output.stdout).unwrap();
    let expected = "--task NeedlePick-v0 --name expert-v0 --format minari --out data --episodes 7 \
                    --seed 0 --envs 16 --keep-failures --resume --json --options \
                    {\"grasp\":\"approx\",\"grasp_distance\":0.001}";
    assert_eq!(said.trim(), format!("{} {expected}", env!("CARGO_BIN_EXE_trocar")));
    let said = String::from_utf8(by_hand.stdout).unwrap();
    for part in ["--name hand-v0", "--by-hand --speed 0.5 --max-steps 90"] {
        assert!(said.contains(part), "{said}");
    }
}
