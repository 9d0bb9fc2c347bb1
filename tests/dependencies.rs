//! Which crates may depend on what, and which files may import the transport and Python.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent();
    root.expect("this crate lies in the workspace").to_path_buf()
}

/// Every package that `package` is built from.
fn dependencies(package: &str) -> Vec<String> {
    let output = Command::new(env!("CARGO"))
        .args(["tree", "--locked", "--offline", "--edges", "normal,build", "--prefix", "none"])
        .args(["--format", "{p}", "--package", package])
        .current_dir(root())
        .output()
        .expect("cargo runs the tests");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("names of packages are text");
    text.lines().filter_map(|line| line.split(' ').next()).map(str::to_string).collect()
}

fn assert_free_of(package: &str, forbidden: &[&str]) {
    let found = dependencies(package);
    assert!(found.iter().any(|name| name == package), "{found:?}");
    let bad: Vec<_> = found.iter().filter(|name| forbidden.contains(&name.as_str())).collect();
    assert!(bad.is_empty(), "{package} depends on {bad:?}");
}

#[test]
fn clients_never_link_the_engine() {
    for client in ["trocar-client", "trocar-py", "trocar-ros2"] {
        assert_free_of(client, &["rapier3d", "parry3d", "trocar-server", "trocar"]);
    }
}

#[test]
fn only_the_node_of_ros_2_brings_what_it_needs() {
    for program in ["trocar", "trocar-client", "trocar-py", "trocar-tests"] {
        assert_free_of(program, &["trocar-ros2", "ros2-client", "rustdds"]);
    }
}

#[test]
fn the_contract_depends_on_neither_side() {
    let sides = ["rapier3d", "parry3d", "trocar-server", "trocar-client", "trocar-py", "pyo3"];
    assert_free_of("trocar-proto", &sides);
}

#[test]
fn the_server_never_depends_on_a_client() {
    assert_free_of(
        "trocar-server",
        &["trocar-client", "trocar-py", "pyo3", "trocar-network", "rten"],
    );
}

#[test]
fn only_the_python_package_links_python() {
    assert_free_of("trocar", &["pyo3", "numpy", "trocar-py"]);
    assert_free_of("trocar-client", &["pyo3", "numpy"]);
}

/// The Rust files of the workspace whose code names `crate_name`, relative to its root.
fn users_of(crate_name: &str) -> Vec<String> {
    let mut users = vec![];
    for folder in ["proto", "server", "client-rs", "client-py"] {
        visit(&root().join(folder), &mut |path| {
            let text = fs::read_to_string(path).expect("source files are text");
            let code = |line: &str| !line.trim_start().starts_with("//");
            let path_of = format!("{crate_name}::");
            if text.lines().any(|line| code(line) && line.contains(&path_of)) {
                let relative = path.strip_prefix(root()).expect("it lies in the workspace");
                users.push(relative.to_str().expect("paths are text").to_string());
            }
        });
    }
    assert!(!users.is_empty(), "nobody uses {crate_name}");
    users
}

fn visit(folder: &Path, file: &mut impl FnMut(&Path)) {
    for entry in fs::read_dir(folder).expect("the workspace can be read") {
        let path = entry.expect("the workspace can be read").path();
        if path.is_dir() && path.file_name().is_some_and(|name| name != "target") {
            visit(&path, file);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            file(&path);
        }
    }
}

#[test]
fn the_transport_is_imported_in_three_places_only() {
    for user in users_of("iceoryx2") {
        let allowed = ["proto/src/", "server/src/service/", "client-rs/src/transport.rs"];
        assert!(allowed.iter().any(|prefix| user.starts_with(prefix)), "{user}");
    }
}

#[test]
fn python_is_imported_in_one_place_only() {
    for user in users_of("pyo3") {
        assert!(user.starts_with("client-py/"), "{user}");
    }
}

#[test]
fn the_engine_is_imported_behind_the_world_only() {
    // Pictures are tested with the engine's rays, and soft bodies are compared with the engine's own.
    let allowed = ["server/src/sim/", "server/tests/render.rs", "server/benches/soft.rs"];
    for user in users_of("rapier3d") {
        assert!(allowed.iter().any(|prefix| user.starts_with(prefix)), "{user}");
    }
}
