//! What Trocar reads from others, as functions of any bytes. None of them may panic, hang, or ask for much memory, and
//! what they take must be taken right.
//!
//! | target | reads |
//! |---|---|
//! | `control` | control messages of both directions, and what the server decides about requests |
//! | `data` | headers and payloads of a session's messages, in a server of this process |
//! | `live` | commands, ticks and questions to a live world |
//! | `words` | doorbell, reply and size words, and what a server does whose words are rubbish |
//! | `snapshots` | the state of an environment, and its restoring |
//! | `recordings` | files of episodes, and their playing |
//! | `urdf` | models and scenes, and a world with them |
//! | `policies` | ONNX files, and their first action |
//! | `options` | a task's options as text and as a message, and the environment that they make |
//!
//! `make fuzz` has libFuzzer find inputs; the test of this crate replays those that are kept in `corpus/`. A
//! target makes its first inputs itself, so that a change of a format needs no new files.

pub mod corpus;

mod bounded;
mod control;
mod data;
mod hosted;
mod input;
mod live;
mod options;
mod policies;
mod recordings;
mod snapshots;
mod urdf;
mod words;

/// Something that reads what others write.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Its name.
    pub name: &'static str,
    /// Reads these bytes, whatever they are.
    pub run: fn(&[u8]),
    /// Inputs of every kind that it takes, made from the code itself.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All of them.
pub const TARGETS: [Target; 9] = [
    Target { name: "control", run: control::run, seeds: control::seeds },
    Target { name: "data", run: data::run, seeds: data::seeds },
    Target { name: "live", run: live::run, seeds: live::seeds },
    Target { name: "words", run: words::run, seeds: words::seeds },
    Target { name: "snapshots", run: snapshots::run, seeds: snapshots::seeds },
    Target { name: "recordings", run: recordings::run, seeds: recordings::seeds },
    Target { name: "urdf", run: urdf::run, seeds: urdf::seeds },
    Target { name: "policies", run: policies::run, seeds: policies::seeds },
    Target { name: "options", run: options::run, seeds: options::seeds },
];

impl Target {
    /// The target of this name.
    ///
    /// # Panics
    /// Where there is none.
    pub fn named(name: &str) -> Self {
        let names = TARGETS.map(|target| target.name);
        let found = TARGETS.into_iter().find(|target| target.name == name);
        found.unwrap_or_else(|| panic!("no target {name:?}; there are {names:?}"))
    }
}
