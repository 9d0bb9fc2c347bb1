//! Recordings: files of episodes, and their playing.

use std::sync::LazyLock;

use trocar_proto::{Options, snapshot};
use trocar_server::Registry;
use trocar_server::recording::{self, Recorder, Replay};

use crate::control::check;
use crate::input::Input;
use crate::snapshots::seal;

/// Most episodes of an input that are played.
const MOST_EPISODES: usize = 3;

static REGISTRY: LazyLock<Registry> = LazyLock::new(Registry::builtin);

/// A byte that says how the rest is read: as a file, or as bodies of snapshots behind their lengths, which get
/// heads that fit.
pub(crate) fn run(data: &[u8]) {
    let mut input = Input::new(data);
    if input.byte().is_multiple_of(2) {
        return play(input.rest());
    }
    let mut file = vec![];
    while !input.is_empty() {
        let length = input.u16() as usize;
        file.extend(seal(input.take(length)));
    }
    play(&file);
}

fn play(file: &[u8]) {
    let courses = match recording::read(file) {
        Ok(courses) => courses,
        Err(refusal) => return check(&refusal),
    };
    let parts = snapshot::split(file).expect("it was read");
    let marks: usize = courses.iter().map(recording::Course::marks).sum();
    assert!(!courses.is_empty() && marks <= parts.len());
    for course in courses.into_iter().take(MOST_EPISODES) {
        let (seed, episode) = (course.seed(), course.episode());
        let mut replay = match Replay::new(&REGISTRY, course) {
            Ok(replay) => replay,
            Err(refusal) => {
                check(&refusal);
                continue;
            }
        };
        let most = replay.env().spec().max_steps;
        while let Some(step) = replay.next() {
            assert!(replay.env().steps() <= most);
            if let Err(refusal) = step {
                check(&refusal);
                break;
            }
        }
        assert_eq!((replay.env().seed(), replay.env().episode()), (seed, episode));
    }
}

pub(crate) fn seeds() -> Vec<Vec<u8>> {
    let mut seeds = vec![];
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
        let bodies = snapshot::split(&file).expect("it was recorded").into_iter();
        let bodies = bodies.flat_map(|part| {
            let body = &part[part.len().min(24)..];
            [&(body.len() as u16).to_le_bytes(), body].concat()
        });
        seeds.push([1].into_iter().chain(bodies).collect());
        seeds.push([vec![0], file].concat());
    }
    seeds
}
