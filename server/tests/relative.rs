//! The words `relative` and `contact` of the option `observation`.

use std::collections::BTreeMap;

use trocar_proto::{OptionValue, Options};
use trocar_server::Registry;
use trocar_server::env::Env;

use crate::look;

/// Steps of an episode: enough for the expert to grasp.
const STEPS: u32 = 25;

fn with_words(words: &[&str]) -> Options {
    let words = words.iter().map(ToString::to_string).collect();
    Options::new().with("observation", OptionValue::Texts(words))
}

fn noisy(options: Options) -> Options {
    let rows = BTreeMap::from([("observation_noise".to_string(), vec![1e-3; 2])]);
    options.with("domain", OptionValue::Table(rows))
}

fn make(id: &str, options: &Options) -> Env {
    Registry::builtin().make(id, options).unwrap()
}

/// Calls `see` with what the expert's episode of `seed` shows under each of `options`, step by step.
fn watch<const N: usize>(
    id: &str,
    options: &[Options; N],
    seed: u64,
    mut see: impl FnMut([[Vec<f32>; 3]; N], &[Env; N]),
) {
    let mut envs = options.each_ref().map(|options| make(id, options));
    for env in &mut envs {
        env.reset(Some(seed));
    }
    let mut action = vec![0.0; envs[0].spec().action_dim()];
    for _ in 0..STEPS {
        see(envs.each_ref().map(look), &envs);
        envs[0].expert(&mut action);
        for env in &mut envs {
            env.step(&action).unwrap();
        }
    }
}

fn goal_tasks() -> Vec<String> {
    let registry = Registry::builtin();
    let ids = registry.ids().filter(|id| *id != "ActiveTrack-v0");
    ids.map(String::from).collect()
}

#[test]
fn features_are_those_of_the_state_and_goals_that_are_seen() {
    for id in goal_tasks() {
        for change in [|options| options, noisy] {
            let words = [&["state", "relative"][..], &["relative"], &["state"]];
            let options = words.map(|words| change(with_words(words)));
            watch(&id, &options, 3, |[both, alone, state], envs| {
                let spec = envs[0].spec();
                let [observation, achieved, desired] = &both;
                let (first, tail) = observation.split_at(state[0].len());
                assert_eq!(first, state[0], "{id}");
                assert_eq!(tail, alone[0], "{id}");
                assert_eq!(tail, spec.features(first, achieved, desired), "{id}");
                for (number, element) in observation.iter().zip(&spec.observation) {
                    let range = element.min..=element.max;
                    assert!(range.contains(number), "{id}: {number} of {element:?}");
                }
                // Whatever is observed, all know how features are computed.
                assert_eq!(envs[1].spec().relative, envs[2].spec().relative, "{id}");
            });
        }
    }
}

#[test]
fn every_feature_tells_something() {
    for id in goal_tasks() {
        let mut seen = vec![];
        for seed in 0..4 {
            watch(&id, &[with_words(&["relative"])], seed, |[[features, ..]], _| {
                seen.push(features);
            });
        }
        let spec = make(&id, &with_words(&["relative"])).spec().clone();
        let varies = |index: usize| seen.iter().any(|features| features[index] != seen[0][index]);
        // What is always far away is the same at the finest scale, and not at others.
        let what = |index: usize| spec.observation[index].name.split(" / ").next().unwrap();
        let told: Vec<_> =
            (0..spec.observation_dim()).filter(|index| varies(*index)).map(what).collect();
        let constant: Vec<_> =
            (0..spec.observation_dim()).map(what).filter(|name| !told.contains(name)).collect();
        // The paper's actions cannot turn everything, and StaticTrack's expert keeps its target in view.
        let may_be = |name: &&str| {
            ["x²", "xy", " of ", "jaw", "in view", "target z"]
                .into_iter()
                .any(|part| name.contains(part))
        };
        assert!(constant.iter().all(may_be), "{id}: {constant:?}");
    }
}

/// The number of this name.
fn number(env: &Env, numbers: &[f32], name: &str) -> f32 {
    let names = env.spec().observation.iter().map(|element| element.name.as_str());
    let index = names.clone().position(|other| other == name);
    numbers[index.unwrap_or_else(|| panic!("{name} is none of {:?}", names.collect::<Vec<_>>()))]
}

#[test]
fn each_arm_is_told_of_the_place_that_it_grasps() {
    // In the end PSM2 holds the needle near its point, between the ends of its jaws.
    let mut last = f32::NAN;
    let words = [with_words(&["relative", "contact"])];
    let mut env = make("NeedleRegrasp-v0", &words[0]);
    env.reset(Some(1));
    let mut action = vec![0.0; env.spec().action_dim()];
    while !env.needs_reset() {
        env.expert(&mut action);
        env.step(&action).unwrap();
        let [seen, ..] = look(&env);
        let along = ["x", "y", "z"].map(|axis| {
            number(&env, &seen, &format!("needle near its point from PSM2 tip {axis} / 0.05"))
        });
        last = along.iter().map(|part| part * part).sum::<f32>().sqrt() * 0.05;
    }
    assert!(last < 2e-3, "{last} m");
}

#[test]
fn fingers_tell_what_they_press_on() {
    let options = [with_words(&["state", "contact"])];
    let names = ["finger 1 contact", "finger 1 force", "finger 2 contact", "finger 2 force"];
    let mut held = 0;
    watch("NeedlePick-v0", &options, 3, |[[seen, ..]], [env]| {
        let [one, force, other, other_force] = names.map(|name| number(env, &seen, name));
        let object = env.world().objects().next().unwrap();
        let presses = env.world().contacts().filter(|contact| contact.on == object).count();
        if one == 1.0 && other == 1.0 {
            held += 1;
            assert!(presses > 0);
            // Jaws press with 1 N.
            assert!((0.5..2.0).contains(&force) && (0.5..2.0).contains(&other_force));
        } else {
            assert!(held == 0 && one == 0.0 && other == 0.0, "{one} {other}");
        }
    });
    assert!(held > 5, "{held}");
}

#[test]
fn words_that_a_task_has_no_use_for_are_refused() {
    let refuse = |id: &str, word: &str| {
        let refused = Registry::builtin().make(id, &with_words(&[word])).err().unwrap();
        assert_eq!(refused.field, "options.observation", "{id}");
        refused.to_string()
    };
    assert!(refuse("ActiveTrack-v0", "relative").contains("proprioception"));
    assert!(refuse("EcmReach-v0", "contact").contains("relative"));
    assert!(refuse("NeedleReach-v0", "contact").contains("relative"));
}
