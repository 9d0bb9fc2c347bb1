//! The bits stay: episodes that were recorded once come again bit by bit, their pictures too.
//!
//! `fixtures/bits.bin` has episodes of every task under every option that changes what it does, in a
//! format of its own (`bits/format.rs`). An episode has the options that were given and the actions. At every tenth
//! step it has hashes of the world, the observation, goals, rewards and flags, and pictures. Actions are stored and not asked of
//! the expert, so an expert may change; states in which episodes start with a part of the work done
//! are the expert's.
//!
//! `make bits` writes the file anew, `TROCAR_BITS=starts make bits` only episodes with such a start, those
//! of NeedleRegrasp among them. That is
//! done only when physics, or with those starts the expert, changes on purpose. `TROCAR_BITS=tasks make bits` adds the
//! episodes of tasks that the file does not have. `TROCAR_BITS=observations make bits`
//! writes hashes of observations alone, where a range of one was wrong: it refuses where anything else differs.
//! `TROCAR_BITS=encoders make bits` writes hashes of episodes whose encoders err, and keeps their actions.
//! `TROCAR_BITS=hashes make bits` does the same for all episodes: rows change only if their episodes do.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use trocar_proto::Options;
use trocar_proto::spec::{Allowed, OptionValue};
use trocar_server::Registry;

use format::{Episode, HASHED, Mark, decode, encode, json_of};
use player::Player;

mod episodes;
mod format;
mod player;

/// Size that the file may have, bytes.
const MOST_BYTES: usize = 2 << 20;

/// How many differences are told of in full.
const TOLD: usize = 12;

/// Height by which an object that was lifted is above where it lay, m.
const LIFTED: f64 = 0.005;

/// Choices of which each word that a task knows must be in the file. What is added later need not.
const CHOICES: [(&str, &[&str]); 7] = [
    ("action", &["paper", "cartesian", "cartesian_abs", "joint"]),
    ("grasp", &["interact", "approx", "weld"]),
    ("preset", &["paper", "surrol"]),
    ("spawn", &["workspace", "narrow"]),
    ("start", &["reset", "approach", "pick", "lift"]),
    ("reward", &["sparse", "dense"]),
    ("observation", &["state", "perceived", "rgb", "depth", "mask", "points"]),
];

/// The same for rows of `domain`.
const ROWS: [&str; 8] = [
    "observation_noise",
    "joint_offset",
    "latency",
    "friction",
    "mass",
    "size",
    "camera_pose_position",
    "camera_pose_angle",
];

fn fixture() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/bits.bin")
}

fn recorded() -> Vec<Episode> {
    decode(&std::fs::read(fixture()).unwrap())
}

/// What came of an episode that was played again.
struct Replayed {
    /// At which step it was another, and in what.
    difference: Option<String>,
    /// Whether an object was above where it lay at first.
    lifts: bool,
    /// Whether its goal was reached after any step.
    succeeds: bool,
}

/// The hashes that differ between the mark of an episode and what it looks like now.
fn difference(episode: &Episode, player: &Player, mark: usize) -> Option<String> {
    let (then, now) = (&episode.marks[mark], player.mark());
    if *then == now {
        return None;
    }
    let pairs = then.hashes.iter().zip(&now.hashes);
    let others = HASHED.iter().zip(pairs).filter(|(_, (then, now))| then != now);
    let mut others: Vec<_> = others.map(|(name, _)| *name).collect();
    if then.hashes.len() != now.hashes.len() {
        others.push("which pictures there are");
    }
    Some(format!("step {}: {}", then.step, others.join(", ")))
}

fn replay(episode: &Episode) -> Replayed {
    let mut player = match Player::new(episode) {
        Ok(player) => player,
        Err(refusal) => {
            let difference = Some(format!("it is refused: {refusal}"));
            return Replayed { difference, lifts: false, succeeds: false };
        }
    };
    let heights = |player: &Player| -> Vec<f64> {
        let world = player.env().world();
        world.objects().map(|object| world.pose(object).translation.z).collect()
    };
    let at_first = heights(&player);
    let mut lifts = false;
    let mut found = difference(episode, &player, 0);
    let mut marks = 1;
    for (step, action) in episode.actions().enumerate() {
        player.step(&action);
        let is_marked = episode.marks.get(marks).is_some_and(|m| usize::from(m.step) == step + 1);
        if found.is_none() && is_marked {
            found = difference(episode, &player, marks);
            marks += 1;
            let mut rise = heights(&player).into_iter().zip(&at_first).map(|(z, first)| z - first);
            lifts |= rise.any(|rise| rise > LIFTED);
        }
    }
    Replayed { difference: found, lifts, succeeds: player.has_succeeded() }
}

#[test]
fn recorded_episodes_come_again_bit_by_bit() {
    let episodes = recorded();
    let replayed: Vec<_> = episodes.par_iter().map(replay).collect();
    let mut counts = BTreeMap::<&str, usize>::new();
    let mut told = vec![];
    for (index, (episode, replayed)) in episodes.iter().zip(&replayed).enumerate() {
        if let Some(difference) = &replayed.difference {
            let Episode { task, options, seed, number, .. } = episode;
            *counts.entry(task).or_default() += 1;
            let options = json_of(options);
            told.push(format!("{index}: {task} {options} {seed}.{number}, {difference}"));
        }
    }
    let different = told.len();
    told.truncate(TOLD);
    let of = episodes.len();
    assert!(
        different == 0,
        "{different} of {of} episodes differ: {counts:?}; the first:\n{}",
        told.join("\n")
    );
    // Half of their actions are random, and still work is done.
    let registry = Registry::builtin();
    for id in registry.ids() {
        let spec = registry.spec(id, &Options::new()).unwrap();
        let of_task = || episodes.iter().zip(&replayed).filter(|(episode, _)| episode.task == id);
        let succeed = of_task().filter(|(_, replayed)| replayed.succeeds).count();
        let lift = of_task().filter(|(_, replayed)| replayed.lifts).count();
        println!("{id}: {} episodes, {lift} lift, {succeed} succeed", of_task().count());
        // Few episodes handle tissue, and what is soft is no object.
        if registry.tagged("tissue").any(|tissue| tissue == id) {
            continue;
        }
        assert!(spec.goal.is_none() || succeed >= 5, "{id}: {succeed} reach the goal");
        let grasps = spec.options.iter().any(|option| option.name == "grasp");
        assert!(!grasps || lift >= 10, "{id}: {lift} lift an object");
    }
}

/// Whether an option was given with this word; a default counts where it was not given.
fn has(options: &Options, name: &str, word: &str, is_default: bool) -> bool {
    match options.0.get(name) {
        Some(OptionValue::Text(given)) => given == word,
        Some(OptionValue::Texts(given)) => given.iter().any(|given| given == word),
        _ => is_default,
    }
}

#[test]
fn the_file_is_small_and_has_every_task_under_all_that_changes_it() {
    let bytes = std::fs::read(fixture()).unwrap();
    let episodes = recorded();
    assert!(bytes.len() <= MOST_BYTES, "{} bytes", bytes.len());
    assert!(encode(&episodes) == bytes, "what is read is written alike");
    assert!(episodes.len() >= 300, "{} episodes", episodes.len());
    let pictures = episodes.iter().filter(|episode| episode.has_pictures()).count();
    assert!(pictures >= 40, "{pictures} episodes with pictures");
    let steps: usize = episodes.iter().map(Episode::steps).sum();
    let expert_steps: usize = episodes.iter().map(|e| usize::from(e.expert_steps)).sum();
    let share = expert_steps as f64 / steps as f64;
    assert!((0.45..0.55).contains(&share), "{share} of {steps} steps are the expert's");
    println!("{} bytes, {} episodes, {pictures} with pictures", bytes.len(), episodes.len());
    println!("{steps} steps, {share:.2} the expert's");
    assert!(episodes.iter().any(|e| e.number > 0 && e.has_start_of_expert()));
    assert!(episodes.iter().flat_map(Episode::actions).flatten().any(|number| number > 1.2));
    for episode in &episodes {
        let marks: Vec<_> = episode.marks.iter().map(|mark| usize::from(mark.step)).collect();
        let steps = episode.steps();
        let mut expected: Vec<_> = (0..=steps).step_by(episodes::EVERY).collect();
        expected.extend((!steps.is_multiple_of(episodes::EVERY)).then_some(steps));
        assert_eq!(marks, expected, "{}", episode.task);
    }
    let registry = Registry::builtin();
    for id in registry.ids() {
        let of_task: Vec<_> = episodes.iter().filter(|episode| episode.task == id).collect();
        let spec = registry.spec(id, &Options::new()).unwrap();
        for option in &spec.options {
            let is_given =
                |name: &str| of_task.iter().any(|e| e.options.row(&option.name, name).is_some());
            match &option.allowed {
                Allowed::OneOf(known) | Allowed::SomeOf(known) => {
                    let listed = CHOICES.iter().filter(|(name, _)| *name == option.name);
                    for word in listed.flat_map(|(_, words)| *words) {
                        let is_there = of_task
                            .iter()
                            .any(|e| has(&e.options, &option.name, word, *word == known[0]));
                        let is_known = known.iter().any(|known| known == word);
                        assert!(!is_known || is_there, "{id}: no {} {word}", option.name);
                    }
                }
                Allowed::Table(known) if option.name == "domain" => {
                    for row in ROWS.iter().filter(|row| known.iter().any(|k| k.name == **row)) {
                        assert!(is_given(row), "{id}: no row {row}");
                    }
                }
                Allowed::Table(_) => {
                    let is_moved = of_task.iter().any(|e| e.options.0.contains_key("setup"));
                    assert!(option.name != "setup" || is_moved, "{id}: no arm is moved");
                }
                _ => {}
            }
        }
        for camera in ["endoscope", "overview", "stereo", "placed"] {
            let seen = of_task.iter().any(|episode| {
                episode.has_pictures()
                    && has(&episode.options, "camera", camera, camera == "endoscope")
            });
            let rgb = OptionValue::Texts(vec!["rgb".into()]);
            let options = Options::new().with("observation", rgb).with_text("camera", camera);
            let is_known = registry.make(id, &options).is_ok();
            assert!(seen || !is_known, "{id}: no picture from {camera}");
        }
    }
}

/// What an episode looks like now, with the actions that it has.
fn marks_anew(episode: &Episode) -> Vec<Mark> {
    let mut player = Player::new(episode).unwrap();
    let mut marks = vec![player.mark()];
    for action in episode.actions() {
        player.step(&action);
        let taken = marks.len();
        if episode.marks.get(taken).is_some_and(|mark| mark.step == player.mark().step) {
            marks.push(player.mark());
        }
    }
    marks
}

/// Hashes the observations of an episode anew; everything else must be as it was.
fn observe_anew(episode: &mut Episode) {
    let marks = marks_anew(episode);
    let observation = HASHED.iter().position(|name| *name == "observation").unwrap();
    for (old, new) in episode.marks.iter_mut().zip(marks) {
        old.hashes[observation] = new.hashes[observation];
        assert!(old.hashes == new.hashes, "{}: more than an observation differs", episode.task);
    }
}

#[test]
#[ignore = "writes the file: `make bits`"]
fn write_the_file() {
    let which = std::env::var("TROCAR_BITS").expect("TROCAR_BITS says which");
    let episodes = match which.as_str() {
        "all" => episodes::record(episodes::all()),
        "tasks" => {
            let mut episodes = recorded();
            let known: BTreeSet<_> = episodes.iter().map(|episode| episode.task.clone()).collect();
            let new = episodes::all().into_iter().filter(|episode| !known.contains(&episode.task));
            episodes.extend(episodes::record(new.collect()));
            episodes
        }
        "tissue" => {
            let registry = Registry::builtin();
            let is_tissue =
                |episode: &Episode| registry.tagged("tissue").any(|id| id == episode.task);
            let mut episodes = recorded();
            episodes.retain(|episode| !is_tissue(episode));
            episodes
                .extend(episodes::record(episodes::all().into_iter().filter(is_tissue).collect()));
            episodes
        }
        "starts" => {
            let mut episodes = recorded();
            let of_expert = |e: &&mut Episode| e.has_start_of_expert();
            let rows: Vec<_> = episodes.iter_mut().filter(of_expert).collect();
            let anew = episodes::record(rows.iter().map(|row| (**row).clone()).collect());
            rows.into_iter().zip(anew).for_each(|(row, anew)| *row = anew);
            episodes
        }
        "observations" => {
            let mut episodes = recorded();
            episodes.par_iter_mut().for_each(observe_anew);
            episodes
        }
        "encoders" => {
            let mut episodes = recorded();
            let err = |e: &&mut Episode| e.options.row("domain", "joint_offset").is_some();
            let rows = episodes.par_iter_mut().filter(err);
            rows.for_each(|episode| episode.marks = marks_anew(episode));
            episodes
        }
        "hashes" => {
            let mut episodes = recorded();
            episodes.par_iter_mut().for_each(|episode| episode.marks = marks_anew(episode));
            episodes
        }
        other => {
            let known = "all, tasks, tissue, starts, observations, encoders or hashes";
            panic!("TROCAR_BITS is {known}, not {other:?}")
        }
    };
    let bytes = encode(&episodes);
    assert!(decode(&bytes) == episodes, "what is written is read alike");
    std::fs::write(fixture(), bytes).unwrap();
}
