//! The documents keep their word: the Rust quick start runs as pasted, the task table is the registry's.

use std::path::Path;
use std::process::Command;

use trocar_proto::Options;
use trocar_server::Registry;

const RUST: &str = include_str!("../../../docs/rust.md");
const TASKS: &str = include_str!("../../../docs/tasks.md");
const QUICK_START: &str = include_str!("../examples/quick_start.rs");

#[test]
fn the_rust_quick_start_runs_as_pasted() {
    let (_, rest) = RUST.split_once("```rust\n").unwrap();
    let (block, _) = rest.split_once("```\n").unwrap();
    assert!(QUICK_START.ends_with(block), "examples/quick_start.rs differs from docs/rust.md");

    let trocar = Path::new(env!("CARGO_BIN_EXE_trocar"));
    let done = Command::new(trocar.with_file_name("examples/quick_start"))
        .env_remove("TROCAR_SERVER")
        .env("TROCAR_BINARY", trocar)
        .output()
        .unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    assert_eq!(done.stdout, b"64 of 64 episodes ended in success\n");
}

#[test]
fn the_task_table_is_that_of_the_registry() {
    let registry = Registry::builtin();
    for id in registry.ids() {
        let spec = registry.spec(id, &Options::new()).unwrap();
        let row = TASKS.lines().find(|line| line.starts_with(&format!("| `{id}`"))).unwrap();
        let cells: Vec<_> = row.split('|').map(str::trim).collect();
        assert_eq!(cells[2], spec.summary);
        assert!(cells[3].starts_with(&format!("{}:", spec.action_dim())), "{row}");
        assert_eq!(cells[4], format!("{} / {}", spec.observation_dim(), spec.goal_dim()));
        assert_eq!(cells[5], format!("{} × {}", spec.max_steps, spec.seconds_per_step));
        for option in &spec.options {
            let row = format!("| `{}` |", option.name);
            assert!(TASKS.contains(&row), "{id} has the option {}", option.name);
        }
    }
}
