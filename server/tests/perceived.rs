//! Targets that are sought in the endoscope's picture: how well they are found, and what an expert makes of it
//! that knows no more. `TROCAR_SOAK=1` for all 200 seeds; `--nocapture` prints what failed.

use rayon::prelude::*;
use trocar_proto::{Code, OptionValue, Options};
use trocar_server::Env;
use trocar_server::Registry;
use trocar_server::render::{Lens, Picture, Renderer, Software};
use trocar_server::tasks::perception;

const TASKS: [&str; 2] = ["StaticTrack-v0", "ActiveTrack-v0"];

/// How far single precision may take the middle of the target's pixels off, as a part of half the picture.
const ROUNDING: f64 = 1e-6;

fn observing(words: &[&str]) -> Options {
    let words = words.iter().map(ToString::to_string).collect();
    Options::new().with("observation", OptionValue::Texts(words))
}

fn env(id: &str, options: &Options, seed: u64) -> Env {
    let mut env = Registry::builtin().make(id, options).unwrap();
    env.reset(Some(seed));
    env
}

/// Observation and achieved goal.
fn look(env: &Env) -> [Vec<f32>; 2] {
    let mut observation = vec![0.0; env.spec().observation_dim()];
    let [mut achieved, mut desired] = [(); 2].map(|()| vec![0.0; env.spec().goal_dim()]);
    env.observe(&mut observation, &mut achieved, &mut desired);
    [observation, achieved]
}

fn step(env: &mut Env) {
    let mut action = vec![0.0; env.spec().action_dim()];
    env.expert(&mut action);
    env.step(&action).unwrap();
}

/// How many seeds are looked at.
fn seeds(all: u64, some: u64) -> u64 {
    if std::env::var_os("TROCAR_SOAK").is_some() { all } else { some }
}

#[test]
fn an_expert_that_perceives_centres_the_target() {
    let seeds = seeds(200, 20);
    let error = |seed: u64| {
        let mut env = env("StaticTrack-v0", &observing(&["perceived"]), seed);
        while !env.needs_reset() {
            step(&mut env);
        }
        // The goal is what geometry says, whatever was perceived.
        let [_, achieved] = look(&env);
        let is_centred = achieved[0].hypot(achieved[1]) <= 0.03 && achieved[2].abs() <= 0.1;
        (!is_centred).then_some((seed, achieved))
    };
    let failures: Vec<_> = (0..seeds).into_par_iter().filter_map(error).collect();
    println!("{} of {seeds} not centred: {failures:?}", failures.len());
    assert!(failures.is_empty(), "{failures:?}");
}

#[test]
fn what_is_perceived_is_the_middle_of_the_targets_pixels() {
    const SIZE: usize = perception::SIZE;
    let (seeds, half) = (seeds(200, 20), 0.5 * SIZE as f64);
    for id in TASKS {
        let compare = |seed: u64| {
            let mut env = env(id, &observing(&["perceived"]), seed);
            for _ in 0..seed % 7 {
                step(&mut env);
            }
            let scene = env.scene();
            let camera = scene.camera(Lens::Endoscope, SIZE, SIZE).unwrap();
            let picture = Software::default().picture(&scene, &camera);
            let [observation, _] = look(&env);
            let (pixels, middle) = middle(&picture, scene.body("target").unwrap());
            let is_seen = observation[6] == 1.0;
            // What glints, and what other cubes cut off, may be lost of a target that shows little.
            assert!(is_seen || pixels < 20, "{id} {seed}: {pixels} pixels are not seen");
            if !is_seen {
                assert_eq!(observation[7..9], [0.0, 0.0]);
                return None;
            }
            let off = [0, 1].map(|axis| {
                let expected = (middle[axis] + 0.5) / half - 1.0;
                (f64::from(observation[7 + axis]) - expected).abs()
            });
            Some(off[0].max(off[1]))
        };
        let off: Vec<_> = (0..seeds).into_par_iter().filter_map(compare).collect();
        let most = off.iter().copied().fold(0.0, f64::max);
        println!("{id}: seen {} of {seeds} times, at most {most} off", off.len());
        assert_eq!(off.len() as u64, seeds, "{id}");
        assert!(most < ROUNDING, "{id}: {most}");
    }
}

/// How many pixels show a body, and the mean of their columns and rows.
fn middle(picture: &Picture, body: i32) -> (usize, [f64; 2]) {
    let mut sum = [0, 0];
    let pixels = (0..picture.mask.len()).filter(|index| picture.mask[*index] == body);
    let count = pixels
        .inspect(|index| {
            sum[0] += index % picture.width;
            sum[1] += index / picture.width;
        })
        .count();
    (count, sum.map(|sum| sum as f64 / count as f64))
}

#[test]
fn an_expert_that_perceives_follows_the_moving_target_as_well_as_one_that_knows() {
    let (seeds, steps) = (seeds(20, 4), seeds(500, 50));
    let reward_of_a_step = |word: &str| {
        let followed = |seed: u64| {
            let mut env = env("ActiveTrack-v0", &observing(&[word]), seed);
            let mut action = [0.0; 3];
            let returned: f64 = (0..steps)
                .map(|_| {
                    env.expert(&mut action);
                    let step = env.step(&action).unwrap();
                    assert!(!step.terminated, "{seed}: lost after {} steps", env.steps());
                    f64::from(step.reward)
                })
                .sum();
            returned / steps as f64
        };
        (0..seeds).into_par_iter().map(followed).sum::<f64>() / seeds as f64
    };
    let [perceived, known] = ["perceived", "state"].map(reward_of_a_step);
    println!("mean reward of a step: {perceived} where perceived, {known} where known");
    assert!(perceived > known - 0.001, "{perceived} {known}");
}

#[test]
fn the_same_state_is_perceived_the_same() {
    for id in TASKS {
        let options = observing(&["perceived"]);
        let mut first = env(id, &options, 5);
        for _ in 0..4 {
            step(&mut first);
        }
        let fresh = Registry::builtin().make(id, &options).unwrap();
        let imported = fresh.import(&first.export().unwrap()).unwrap();
        // The same picture beside it changes nothing, nor do other threads that draw at the same
        // time.
        let both = observing(&["perceived", "state", "rgb"]);
        let beside = (0..4).into_par_iter().map(|_| {
            let mut env = env(id, &both, 5);
            (0..4).for_each(|_| step(&mut env));
            env
        });
        let mut copies: Vec<_> = beside.collect();
        copies.push(imported);
        copies.push(first.clone());
        for _ in 0..3 {
            let expected = look(&first);
            assert!(copies.iter().all(|copy| look(copy) == expected), "{id}");
            step(&mut first);
            copies.iter_mut().for_each(step);
        }
    }
}

#[test]
fn tasks_without_a_coloured_target_refuse_to_perceive_one() {
    let registry = Registry::builtin();
    for id in registry.ids().filter(|id| !TASKS.contains(id)) {
        let refusal = registry.spec(id, &observing(&["perceived"])).unwrap_err();
        let found = (refusal.code, refusal.field.as_str());
        assert_eq!(found, (Code::InvalidOption, "options.observation"));
        assert!(refusal.to_string().contains("\"points\""), "{refusal}");
    }
    for id in TASKS {
        let perceived = registry.spec(id, &observing(&["perceived"])).unwrap();
        assert_eq!(perceived.observation, registry.spec(id, &Options::new()).unwrap().observation);
        assert_eq!(perceived.images, None);
        let beside = registry.spec(id, &observing(&["perceived", "depth"])).unwrap();
        assert!(beside.images.unwrap().with_state);
    }
}
