//! Recordings: files of episodes, and their playing.

use std::sync::LazyLock;

use trocar_proto::Options;
use trocar_proto::dvrk::record::CommandRecord;
use trocar_proto::dvrk::recording::{Beginning, Given, LivePart, Stretch};
use trocar_proto::dvrk::{Command, Homing, StateCommand};
use trocar_proto::part::{self, Kind};
use trocar_server::Registry;
use trocar_server::recording::{self, Recorder, Replay};

use crate::control::check;
use crate::input::Input;
use crate::snapshots::seal;

/// Most episodes of an input that are played.
const MOST_EPISODES: usize = 3;

/// Most steps of a live world that are played: it may go on for a day.
const MOST_STEPS: usize = 20;

static REGISTRY: LazyLock<Registry> = LazyLock::new(Registry::builtin);

/// A byte that says how the rest is read: as a file, or as bodies of parts behind their lengths, which get heads that
/// fit, of snapshots or of live worlds.
pub(crate) fn run(data: &[u8]) {
    let mut input = Input::new(data);
    let kind = match input.byte() % 4 {
        1 => Kind::Snapshot,
        3 => Kind::Live,
        _ => return play(input.rest()),
    };
    let mut file = vec![];
    while !input.is_empty() {
        let length = input.u16() as usize;
        file.extend(seal(kind, input.take(length)));
    }
    play(&file);
}

fn play(file: &[u8]) {
    let courses = match recording::read(file) {
        Ok(courses) => courses,
        Err(refusal) => return check(&refusal),
    };
    let parts = part::split(file).expect("it was read");
    let marks: usize = courses.iter().map(recording::Course::marks).sum();
    assert!(!courses.is_empty() && marks <= parts.len());
    for course in courses.into_iter().take(MOST_EPISODES) {
        let (seed, episode) = (course.seed(), course.episode());
        let steps = if course.is_live() { MOST_STEPS } else { usize::MAX };
        let mut replay = match Replay::new(&REGISTRY, course) {
            Ok(replay) => replay,
            Err(refusal) => {
                check(&refusal);
                continue;
            }
        };
        let most = replay.env().spec().max_steps.max(MOST_STEPS as u32);
        for step in std::iter::from_fn(|| replay.next()).take(steps) {
            if let Err(refusal) = step {
                check(&refusal);
                break;
            }
        }
        assert!(replay.env().steps() <= most);
        assert_eq!((replay.env().seed(), replay.env().episode()), (seed, episode));
    }
}

/// A live world whose arm is homed and moved, as parts.
fn live_world(task: &str) -> Vec<u8> {
    let beginning = Beginning {
        version: env!("CARGO_PKG_VERSION").into(),
        task: task.into(),
        options: Options::new(),
        seed: 3,
        homing: Homing::InPlace,
    };
    let words = [StateCommand::Enable, StateCommand::Home].map(Command::State);
    let commands = words.into_iter().chain([Command::MoveJp(vec![0.1; 6])]);
    let given = |command| Given::new(2, &CommandRecord::new(0, &command)?);
    let commands = commands.map(given).collect::<Result<_, _>>().expect("good commands");
    let stretch = Stretch { number: 0, commands, ticks: 30, fingerprint: 0 };
    let parts = [LivePart::Beginning(beginning), LivePart::Stretch(stretch)];
    parts.iter().flat_map(|part| part.to_bytes().expect("short parts")).collect()
}

/// Bodies of a file's parts, as [`run`] reads them.
fn bodies(kind: u8, file: &[u8]) -> Vec<u8> {
    let bodies = part::split(file).expect("it was recorded").into_iter();
    let bodies = bodies.flat_map(|part| {
        let body = &part[part.len().min(24)..];
        [&(body.len() as u16).to_le_bytes(), body].concat()
    });
    [kind].into_iter().chain(bodies).collect()
}

pub(crate) fn seeds() -> Vec<Vec<u8>> {
    let live = ["NeedlePick-v0", "EcmReach-v0"].map(live_world);
    let mut seeds: Vec<_> = live.iter().map(|file| bodies(3, file)).collect();
    for task in ["EcmReach-v0", "NeedleReach-v0", "NeedlePick-v0", "ActiveTrack-v0"] {
        let mut env = REGISTRY.make(task, &Options::new()).expect("a task");
        let (mut recorder, mut file) = (Recorder::new(2), vec![]);
        for seed in [3, 4] {
            file.extend(recorder.before_leaving(&env).into_iter().flatten());
            env.reset(Some(seed));
            let mut action = vec![0.0; env.spec().action_dim()];
            for _ in 0..3 {
                env.expert(&mut action);
                env.step(&action).expect("a good action");
                file.extend(recorder.after_step(&env).into_iter().flatten());
            }
        }
        seeds.push(bodies(1, &file));
        seeds.push([vec![0], file].concat());
    }
    seeds
}
