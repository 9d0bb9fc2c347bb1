//! Beginnings in the middle of a task: NeedleRegrasp, and every `start` other than `reset`. Each seed begins elsewhere
//! and draws its own rows of `domain`, and the state is physically valid.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;
use trocar_proto::{OptionValue, Options};
use trocar_server::Registry;
use trocar_server::dvrk::Homing;
use trocar_server::env::{Env, LiveWorld};

/// Number of seeds of each case: more than there are prepared states. `TROCAR_SOAK=1` tries 1,000.
fn seeds() -> u64 {
    if std::env::var_os("TROCAR_SOAK").is_some() { 1000 } else { 80 }
}

/// Largest speed of an object at the beginning, m/s.
const MAX_SPEED: f64 = 5e-3;

/// Deepest overlap of an object with anything, fingers included, m.
const MAX_OVERLAP: f64 = 0.45e-3;

/// Largest movement of an object that jaws hold for three steps, m.
const MAX_SLIP: f64 = 2e-3;

/// Tasks with an option `start`.
const TASKS: [&str; 5] =
    ["NeedlePick-v0", "GauzeRetrieve-v0", "CylinderPick-v0", "PegTransfer-v0", "BiPegTransfer-v0"];

/// Every task and start whose episodes begin prepared.
fn cases() -> Vec<(&'static str, Options)> {
    let mut cases = vec![("NeedleRegrasp-v0", Options::new())];
    for task in TASKS {
        for start in ["approach", "pick", "lift"] {
            cases.push((task, Options::new().with_text("start", start)));
        }
    }
    cases
}

/// `options` with the errors of real arms.
fn with_errors(options: &Options) -> Options {
    options.clone().with("domain", OptionValue::Preset("dvrk".into(), BTreeMap::default()))
}

/// `options` with an object and jaws that differ from seed to seed. Blocks allow the least range of sizes.
fn with_objects(options: &Options) -> Options {
    let rows = [("friction", [0.7, 1.3]), ("mass", [0.7, 1.5]), ("size", [0.98, 1.08])];
    let rows = rows.map(|(name, range)| (name.to_string(), range.to_vec()));
    options.clone().with("domain", OptionValue::Table(rows.into()))
}

fn make(task: &str, options: &Options) -> Env {
    Registry::builtin().make(task, options).unwrap()
}

/// Every bit of the world and of the observation, without goals.
fn bits(env: &Env) -> Vec<u32> {
    let (dim, goal) = (env.spec().observation_dim(), env.spec().goal_dim());
    let (mut observation, mut goals) = (vec![0.0; dim], vec![0.0; 2 * goal]);
    let (achieved, desired) = goals.split_at_mut(goal);
    env.observe(&mut observation, achieved, desired);
    env.world().bits().chain(observation.iter().map(|number| number.to_bits())).collect()
}

/// An environment after a reset to `seed`.
fn begun(env: &Env, seed: u64) -> Env {
    let mut env = env.clone();
    env.reset(Some(seed));
    env
}

#[test]
fn every_seed_begins_elsewhere() {
    let distinct = |env: &Env| {
        let beginnings: Vec<_> =
            (0..seeds()).into_par_iter().map(|seed| bits(&begun(env, seed))).collect();
        beginnings.into_iter().collect::<BTreeSet<_>>().len() as u64
    };
    for (task, options) in cases() {
        assert_eq!(distinct(&make(task, &options)), seeds(), "{task} {options:?}");
    }
    let surrol = Options::new().with_text("start", "lift").with_text("preset", "surrol");
    assert_eq!(distinct(&make("PegTransfer-v0", &surrol)), seeds());
}

#[test]
fn every_seed_draws_the_errors_of_its_arms() {
    for (task, options) in cases() {
        let env = make(task, &with_errors(&options));
        let drawn = |seed| {
            let env = begun(&env, seed);
            let bits = bits(&env);
            let world = LiveWorld::new(env, Homing::InPlace).unwrap();
            // Offsets and plays of encoders, and lags.
            let arms = world.arms().map(|arm| format!("{:?}", arm.drivetrain()));
            (arms.collect::<Vec<_>>(), bits)
        };
        let drawn: Vec<_> = (0..seeds()).into_par_iter().map(drawn).collect();
        let rows: BTreeSet<_> = drawn.iter().map(|(arms, _)| arms).collect();
        let beginnings: BTreeSet<_> = drawn.iter().map(|(_, bits)| bits).collect();
        let counts = [rows.len(), beginnings.len()];
        assert_eq!(counts, [seeds() as usize; 2], "{task} {options:?}");
    }
}

#[test]
fn every_seed_draws_mass_and_size_of_a_held_object() {
    for (task, options) in cases() {
        let env = make(task, &with_objects(&options));
        let mass = |seed| {
            let env = begun(&env, seed);
            let object = env.world().objects().next().unwrap();
            env.world().inertia(object).mass.to_bits()
        };
        let masses: BTreeSet<_> =
            (0..seeds()).into_par_iter().map(mass).collect::<Vec<_>>().into_iter().collect();
        assert_eq!(masses.len() as u64, seeds(), "{task} {options:?}");
    }
}

#[test]
fn objects_begin_at_rest_without_overlaps_and_stay_in_the_jaws() {
    for (task, options) in cases() {
        for options in [options.clone(), with_errors(&options), with_objects(&options)] {
            let env = make(task, &options);
            let name = format!("{task} {options:?}");
            let is_held = options.text("start").is_none_or(|start| start != "approach");
            (0..seeds() / 4).into_par_iter().for_each(|seed| {
                let mut env = begun(&env, seed);
                for object in env.world().objects() {
                    let speed = env.world().velocity(object).norm();
                    assert!(speed < MAX_SPEED, "{name} {seed}: {speed} m/s");
                }
                let overlap = env.world().deepest_overlap();
                assert!(overlap < MAX_OVERLAP, "{name} {seed}: {overlap} m");
                let held = env.objects().next().unwrap().1;
                // The jaws stay closed, and the arms where they are.
                let mut action = vec![0.0; env.spec().action_dim()];
                for (number, element) in action.iter_mut().zip(&env.spec().action) {
                    *number = if element.name.ends_with("jaw") { -1.0 } else { 0.0 };
                }
                for _ in 0..3 {
                    env.step(&action).unwrap();
                }
                let fell = held.translation.z - env.objects().next().unwrap().1.translation.z;
                let is_plain = !options.0.contains_key("domain");
                assert!(!is_held || !is_plain || fell < MAX_SLIP, "{name} {seed}: {fell} m");
                assert!(
                    env.world().fastest() < 0.5,
                    "{name} {seed}: {} m/s",
                    env.world().fastest()
                );
            });
        }
    }
}

#[test]
fn a_seed_begins_alike_whatever_was_before() {
    for (task, options) in cases() {
        let options = with_errors(&options);
        let mut forwards = make(task, &options);
        let mut beginnings = vec![];
        for seed in 0..12 {
            forwards.reset(Some(seed));
            beginnings.push(bits(&forwards));
        }
        let mut backwards = make(task, &options);
        for seed in (0..12).rev() {
            backwards.reset(Some(seed));
            let dim = backwards.spec().action_dim();
            let is_same = bits(&backwards) == beginnings[seed as usize];
            assert!(is_same, "{task} {options:?}: {seed}");
            backwards.step(&vec![0.5; dim]).unwrap();
        }
        let seeds: Vec<u64> = (0..12).collect();
        let is_same = |seed: &u64| bits(&begun(&backwards, *seed)) == beginnings[*seed as usize];
        assert!(seeds.par_iter().all(is_same), "{task} {options:?}: on other threads");
        // A state that was exported comes again in an environment of its own.
        let mut env = begun(&forwards, 5);
        env.step(&vec![0.2; env.spec().action_dim()]).unwrap();
        let again = make(task, &options).import(&env.export().unwrap()).unwrap();
        assert!(bits(&env) == bits(&again), "{task} {options:?}: imported");
    }
}
