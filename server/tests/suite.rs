//! Every registered task, in-process, under every option that changes what it does.

use std::collections::BTreeMap;

use rayon::prelude::*;
use trocar_proto::spec::{Allowed, Element, OptionValue};
use trocar_proto::{Code, Options, TaskSpec};
use trocar_server::Registry;
use trocar_server::env::{Env, Step};
use trocar_server::error::StepError;
use trocar_server::sim::random::Rng;
use trocar_server::tasks::builtin;

mod domain;
pub(crate) use domain::is_arm_error;
mod heads;
mod setups;
mod snapshots;

/// What an environment shows after a reset or step.
#[derive(Debug, Clone)]
struct Seen {
    observation: Vec<f32>,
    achieved: Vec<f32>,
    desired: Vec<f32>,
    expert: Vec<f32>,
}

impl Seen {
    fn of(env: &Env) -> Self {
        let spec = env.spec();
        let mut seen = Self {
            observation: vec![f32::NAN; spec.observation_dim()],
            achieved: vec![f32::NAN; spec.goal_dim()],
            desired: vec![f32::NAN; spec.goal_dim()],
            expert: vec![f32::NAN; spec.action_dim()],
        };
        env.observe(&mut seen.observation, &mut seen.achieved, &mut seen.desired);
        env.expert(&mut seen.expert);
        seen
    }

    fn bits(&self) -> Vec<u32> {
        [&self.observation, &self.achieved, &self.desired, &self.expert]
            .into_iter()
            .flatten()
            .map(|number| number.to_bits())
            .collect()
    }
}

/// A stream of actions that clip, press and wander.
struct Actions(Rng);

impl Actions {
    fn new(seed: u64) -> Self {
        Self(Rng::new(seed, u64::MAX))
    }

    fn next(&mut self, spec: &TaskSpec) -> Vec<f32> {
        (0..spec.action_dim()).map(|_| self.0.uniform(-1.3, 1.3) as f32).collect()
    }
}

/// A row of a table by name.
type Row<'a> = (&'a str, &'a [f64]);

fn table(rows: &[Row]) -> OptionValue {
    let row = |(name, numbers): &Row| ((*name).to_string(), numbers.to_vec());
    OptionValue::Table(rows.iter().map(row).collect::<BTreeMap<_, _>>())
}

/// Every task with its defaults and with each word of each option that is a choice.
fn variants() -> Vec<(String, Options)> {
    let registry = Registry::builtin();
    let mut variants = vec![];
    for id in registry.ids() {
        variants.push((id.to_string(), Options::new()));
        if is_slow(id) {
            if tasks().any(|task| task == id) {
                let words = [("reward", "dense"), ("instrument", "needle_driver")];
                let with =
                    |(option, word)| (id.to_string(), Options::new().with_text(option, word));
                variants.extend(words.map(with));
            }
            continue;
        }
        for option in registry.spec(id, &Options::new()).unwrap().options {
            if let Allowed::OneOf(words) = option.allowed {
                for word in &words[1..] {
                    variants.push((id.to_string(), Options::new().with_text(&option.name, word)));
                }
            }
        }
    }
    variants
}

/// Whether a step of a task takes as long as a hundred of others: then what all tasks share is tested with those.
fn is_slow(id: &str) -> bool {
    Registry::builtin().tagged("tissue").any(|slow| slow == id)
}

/// What all tasks share is tested with these: every one, but of those that are slow the first alone, unless in a soak.
pub(crate) fn tasks() -> impl Iterator<Item = &'static str> {
    let mut slow = builtin::ALL.iter().map(|task| task.id).filter(|id| is_slow(id));
    let first = slow.next();
    let ids = builtin::ALL.iter().map(|task| task.id);
    ids.filter(move |id| !is_slow(id) || Some(*id) == first || soak())
}

fn soak() -> bool {
    std::env::var_os("TROCAR_SOAK").is_some()
}

fn make((id, options): &(String, Options)) -> Env {
    Registry::builtin().make(id, options).unwrap()
}

/// Whether an element changes under these options, as the task says; none where it may or may not.
fn varies((id, options): &(String, Options), element: &Element) -> Option<bool> {
    let paper = options.text("action").is_none_or(|mode| mode == "paper");
    // Fingers pass through an object that an attachment will hold, which is carried as it lay; so is a heavy one
    // that is attached when it is lifted. Until then it may rock.
    let attached =
        options.text("grasp") == Some("approx") || options.text("preset") == Some("surrol");
    let objects = ["mid arc", "crest", "wall 1", "wall 2", "upper end"];
    let is_tilt = objects.iter().any(|object| {
        ["roll", "pitch"].iter().any(|angle| element.name == format!("{object} {angle}"))
    });
    if paper && attached && (is_tilt || ["crest yaw", "upper end yaw"].contains(&&*element.name)) {
        return None;
    }
    // Corners of a sheet hardly move where another point of it is taken, or where smooth jaws let it go.
    if is_slow(id) && element.name.starts_with("sheet") {
        return None;
    }
    Some(!Registry::builtin().is_constant(id, &element.name, paper))
}

#[test]
fn specifications_are_complete_and_every_box_is_finite() {
    let registry = Registry::builtin();
    let mut known: Vec<_> = registry.ids().collect();
    let mut listed: Vec<_> = builtin::ALL.iter().map(|task| task.id).collect();
    known.sort_unstable();
    listed.sort_unstable();
    assert_eq!(known, listed, "clients know the tasks without a server");
    for variant in variants() {
        let env = make(&variant);
        let spec = env.spec();
        assert_eq!(spec.id, variant.0);
        assert!(!spec.summary.is_empty() && spec.max_steps > 0 && spec.seconds_per_step > 0.0);
        let goal = spec.goal.iter().flat_map(|goal| &goal.elements);
        for element in spec.action.iter().chain(&spec.observation).chain(goal) {
            assert!(!element.name.is_empty() && !element.unit.is_empty(), "{element:?}");
            assert!(element.min.is_finite() && element.max.is_finite());
            assert!(element.min < element.max, "{element:?}");
        }
        assert!(spec.action.iter().all(|element| (element.min, element.max) == (-1.0, 1.0)));
        assert_eq!(*spec, Registry::builtin().spec(&variant.0, &variant.1).unwrap());
    }
}

#[test]
fn dimensions_are_those_of_the_paper() {
    let dims = |id: &str| {
        let spec = Registry::builtin().spec(id, &Options::new()).unwrap();
        (spec.action_dim(), spec.observation_dim(), spec.goal_dim(), spec.max_steps)
    };
    assert_eq!(dims("NeedleReach-v0"), (5, 7, 3, 50));
    assert_eq!(dims("NeedlePick-v0"), (5, 19, 3, 50));
    assert_eq!(dims("GauzeRetrieve-v0"), (5, 19, 3, 50));
    assert_eq!(dims("PegTransfer-v0"), (5, 19, 3, 50));
    assert_eq!(dims("NeedleRegrasp-v0"), (10, 35, 3, 50));
    assert_eq!(dims("BiPegTransfer-v0"), (10, 35, 3, 50));
    assert_eq!(dims("EcmReach-v0"), (3, 6, 3, 50));
    assert_eq!(dims("MisOrient-v0"), (1, 9, 1, 50));
    assert_eq!(dims("StaticTrack-v0"), (3, 10, 3, 50));
    assert_eq!(dims("ActiveTrack-v0"), (3, 10, 0, 500));
    assert_eq!(dims("TissueRetract-v0"), (5, 55, 6, 60));
    assert_eq!(dims("TissuePoint-v0"), (5, 51, 5, 60));
    assert_eq!(dims("GauzePlace-v0"), (5, 40, 5, 60));
}

#[test]
fn what_is_seen_is_within_its_bounds_and_not_constant() {
    let mut faults = vec![];
    for variant in variants() {
        let mut env = make(&variant);
        let spec = env.spec().clone();
        let mut actions = Actions::new(1);
        let mut ranges = vec![(f32::INFINITY, f32::NEG_INFINITY); spec.observation_dim()];
        // Two of the expert's at least: smooth jaws lose fat in one episode of seven.
        for episode in 0..4 {
            env.reset((episode == 0).then_some(3));
            loop {
                let seen = Seen::of(&env);
                for (range, number) in ranges.iter_mut().zip(&seen.observation) {
                    *range = (range.0.min(*number), range.1.max(*number));
                }
                if env.needs_reset() {
                    break;
                }
                // Half of the episodes are the expert's: objects that lie still are moved by it.
                let random = actions.next(&spec);
                env.step(if episode % 2 == 0 { &random } else { &seen.expert }).unwrap();
            }
        }
        let excesses = env.clamped().into_iter();
        faults.extend(excesses.map(|excess| format!("{variant:?}: out of bounds: {excess:?}")));
        for (range, element) in ranges.iter().zip(&spec.observation) {
            let found = range.1 - range.0 > 5e-5;
            if varies(&variant, element).is_some_and(|expected| found != expected) {
                let is = if found { "varies" } else { "is constant" };
                faults.push(format!("{variant:?}: {element:?} {is}: {range:?}"));
            }
        }
    }
    assert!(faults.is_empty(), "{faults:#?}");
}

#[test]
fn a_seed_is_an_episode_bit_by_bit_and_another_seed_is_another() {
    for variant in variants() {
        let (mut one, mut two) = (make(&variant), make(&variant));
        two.reset(Some(99)); // what was before does not matter
        one.reset(Some(5));
        two.reset(Some(5));
        let first = Seen::of(&one);
        assert_eq!(first.bits(), Seen::of(&two).bits());
        let mut actions = Actions::new(5);
        while !one.needs_reset() {
            let action = actions.next(one.spec());
            assert_eq!(one.step(&action).unwrap(), two.step(&action).unwrap());
            assert_eq!(Seen::of(&one).bits(), Seen::of(&two).bits());
        }
        one.reset(None);
        assert_ne!(first.bits(), Seen::of(&one).bits(), "the next episode is another");
        two.reset(Some(6));
        assert_ne!(first.bits(), Seen::of(&two).bits());
    }
}

#[test]
fn episodes_are_keyed_by_seed_and_number() {
    for id in tasks() {
        let make = || Registry::builtin().make(id, &Options::new()).unwrap();
        let (mut stepped, mut fresh) = (make(), make());
        stepped.reset(Some(4));
        let mut actions = Actions::new(0);
        for _ in 0..20 {
            stepped.step(&actions.next(&stepped.spec().clone())).unwrap();
        }
        stepped.reset(None);
        fresh.reset(Some(4));
        fresh.reset(None);
        assert_eq!((stepped.seed(), stepped.episode(), stepped.steps()), (4, 1, 0));
        assert_eq!(Seen::of(&stepped).bits(), Seen::of(&fresh).bits());
        let mut unseeded = make();
        unseeded.reset(None);
        fresh.reset(Some(0));
        assert_eq!((unseeded.seed(), unseeded.episode()), (0, 0));
        assert_eq!(Seen::of(&unseeded).bits(), Seen::of(&fresh).bits());
    }
}

#[test]
fn rewards_and_success_are_those_of_the_goals_bit_by_bit() {
    for variant in variants() {
        let mut env = make(&variant);
        let spec = env.spec().clone();
        let Some(goal) = &spec.goal else { continue };
        let mut actions = Actions::new(2);
        for episode in 0..if soak() { 4 } else { 2 } {
            env.reset(None);
            while !env.needs_reset() {
                let expert = Seen::of(&env).expert;
                let action = if episode % 2 == 0 { actions.next(&spec) } else { expert };
                let step = env.step(&action).unwrap();
                let seen = Seen::of(&env);
                let reward = spec.reward.of(&goal.success, &seen.achieved, &seen.desired);
                assert_eq!(step.reward.to_bits(), reward.to_bits());
                assert_eq!(step.is_success, spec.is_success(&seen.achieved, &seen.desired));
            }
        }
    }
}

#[test]
fn a_tolerance_makes_success_easier_or_harder_and_rewards_follow() {
    let mut easier = 0;
    for id in Registry::builtin().ids() {
        let with = |factor: f64| Options::new().with("tolerance", OptionValue::Number(factor));
        let Some(goal) = Registry::builtin().spec(id, &Options::new()).unwrap().goal else {
            assert!(Registry::builtin().spec(id, &with(2.0)).is_err(), "{id} has no goal");
            continue;
        };
        let [mut wide, mut narrow] = [10.0, 0.1].map(|factor| make(&(id.into(), with(factor))));
        for env in [&mut wide, &mut narrow] {
            env.reset(Some(3));
        }
        while !wide.needs_reset() {
            let action = Seen::of(&wide).expert;
            let [one, other] = [&mut wide, &mut narrow].map(|env| env.step(&action).unwrap());
            let Seen { achieved, desired, .. } = Seen::of(&wide);
            let nominal = goal.success.holds(&achieved, &desired);
            assert!((one.is_success || !nominal) && (nominal || !other.is_success), "{id}");
            for step in [one, other] {
                let sparse: f32 = if step.is_success { 0.0 } else { -1.0 };
                assert_eq!(step.reward.to_bits(), sparse.to_bits(), "{id}");
            }
            easier += u32::from(one.is_success && !other.is_success);
        }
    }
    assert!(easier > 9, "steps that were near a goal, and not at it: {easier}");
}

#[test]
fn episodes_are_truncated_at_their_time_limit_and_need_a_reset() {
    for id in Registry::builtin().ids() {
        let mut env = Registry::builtin().make(id, &Options::new()).unwrap();
        let action = vec![0.0; env.spec().action_dim()];
        assert_eq!(env.step(&action), Err(StepError::ResetNeeded));
        env.reset(None);
        for step in 1..=env.spec().max_steps {
            let Step { terminated, truncated, .. } = env.step(&action).unwrap();
            assert_eq!(truncated, step == env.spec().max_steps);
            assert_eq!(env.steps(), step);
            assert!(!terminated || env.spec().goal.is_none(), "{id} has no terminal states");
            if terminated {
                break; // a target was lost
            }
        }
        assert!(env.needs_reset());
        assert_eq!(env.step(&action), Err(StepError::ResetNeeded));
    }
}

#[test]
fn actions_that_are_no_numbers_are_refused_and_change_nothing() {
    for id in tasks() {
        let mut env = Registry::builtin().make(id, &Options::new()).unwrap();
        env.reset(Some(1));
        let mut untouched = env.clone();
        let dim = env.spec().action_dim();
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for index in 0..dim {
                let mut action = vec![0.5; dim];
                action[index] = bad;
                let Err(StepError::InvalidAction(refusal)) = env.step(&action) else {
                    panic!("{id}: {bad} was taken");
                };
                assert_eq!(refusal.code, Code::InvalidAction);
                assert_eq!(refusal.field, format!("action[{index}]"));
            }
        }
        for length in [0, dim - 1, dim + 1] {
            let refused = env.step(&vec![0.0; length]);
            assert!(matches!(refused, Err(StepError::InvalidAction(_))), "{id}: {length}");
        }
        let mut actions = Actions::new(3);
        for _ in 0..20 {
            let action = actions.next(&env.spec().clone());
            assert_eq!(env.step(&action).unwrap(), untouched.step(&action).unwrap());
            assert_eq!(Seen::of(&env).bits(), Seen::of(&untouched).bits());
            begin_anew_where_it_ended(&mut env);
            begin_anew_where_it_ended(&mut untouched);
        }
    }
}

#[test]
fn numbers_outside_the_range_act_as_the_nearest_inside() {
    for variant in variants() {
        let mut clipped = make(&variant);
        clipped.reset(Some(2));
        let mut wild = clipped.clone();
        let mut actions = Actions::new(4);
        for _ in 0..30 {
            let action = actions.next(&wild.spec().clone());
            let inside: Vec<f32> = action.iter().map(|number| number.clamp(-1.0, 1.0)).collect();
            wild.step(&action).unwrap();
            clipped.step(&inside).unwrap();
            begin_anew_where_it_ended(&mut wild);
            begin_anew_where_it_ended(&mut clipped);
            assert_eq!(Seen::of(&wild).bits(), Seen::of(&clipped).bits());
        }
    }
}

#[test]
fn environments_side_by_side_are_as_if_each_were_alone() {
    for id in tasks() {
        let first = Registry::builtin().make(id, &Options::new()).unwrap();
        let count = if is_slow(id) { 3 } else { 16 };
        let mut envs = vec![first; count as usize];
        let mut streams: Vec<_> = (0..count).map(Actions::new).collect();
        let mut together = vec![vec![]; count as usize];
        for (seed, env) in envs.iter_mut().enumerate() {
            env.reset(Some(seed as u64));
        }
        for _ in 0..50 {
            for ((env, stream), bits) in envs.iter_mut().zip(&mut streams).zip(&mut together) {
                env.step(&towards_the_goal(stream, env)).unwrap();
                begin_anew_where_it_ended(env);
                bits.push(Seen::of(env).bits());
            }
        }
        let alone = std::thread::spawn({
            let id = id.to_string();
            move || {
                let mut env = Registry::builtin().make(&id, &Options::new()).unwrap();
                let mut run = |seed: u64| {
                    let mut stream = Actions::new(seed);
                    env.reset(Some(seed));
                    let step = |_| {
                        env.step(&towards_the_goal(&mut stream, &env)).unwrap();
                        begin_anew_where_it_ended(&mut env);
                        Seen::of(&env).bits()
                    };
                    (0..50).map(step).collect::<Vec<_>>()
                };
                (0..count).map(&mut run).collect::<Vec<_>>()
            }
        });
        assert_eq!(together, alone.join().unwrap());
    }
}

#[test]
fn nothing_explodes_under_adversarial_actions() {
    variants().into_par_iter().for_each(|variant| {
        let mut env = make(&variant);
        let mut actions = Actions::new(9);
        let metres = if variant.1.text("preset") == Some("surrol") { 5.0 } else { 1.0 };
        let episodes = match (is_slow(&variant.0), soak()) {
            (true, _) => 2,
            (false, true) => 40,
            (false, false) => 8,
        };
        for _ in 0..episodes {
            env.reset(None);
            let mut before = Seen::of(&env);
            while !env.needs_reset() {
                env.step(&towards_the_goal(&mut actions, &env)).unwrap();
                let now = Seen::of(&env);
                // Angles and image points may jump: an endoscope turns in no time at its pivot.
                let goal = env.spec().goal.iter().flat_map(|goal| &goal.elements);
                let pairs = now.achieved.iter().zip(&before.achieved).zip(goal);
                let lengths = pairs.filter(|(_, element)| element.unit.ends_with('m'));
                let squares = lengths.map(|((a, b), _)| (a - b) * (a - b));
                let moved = squares.sum::<f32>().sqrt() / metres;
                // An object that slips out of the jaws may fly at 1.5 m/s.
                let most = if variant.0.contains("Reach") { 0.05 } else { 0.3 };
                assert!(moved < most, "{variant:?}: the achieved goal jumps by {moved} m");
                before = now;
            }
        }
    });
}

#[test]
fn what_cannot_be_made_is_refused_by_name() {
    let registry = Registry::builtin();
    let refusal = registry.make("NeedleReech-v0", &Options::new()).err().unwrap();
    assert_eq!(refusal.code, Code::UnknownTask);
    for part in ["task", "NeedleReech-v0", "NeedleReach-v0", "EcmReach-v0"] {
        assert!(refusal.to_string().contains(part), "{refusal}");
    }
    for id in registry.ids() {
        let refuse = |options: &Options| registry.make(id, options).err().unwrap();
        let refusal = refuse(&Options::new().with_text("action", "reward"));
        assert_eq!((refusal.code, refusal.field.as_str()), (Code::InvalidOption, "options.action"));
        let refusal = refuse(&Options::new().with_text("reward", "shaped"));
        let known = registry.spec(id, &Options::new()).unwrap().goal.is_some();
        let code = if known { Code::InvalidOption } else { Code::UnknownOption };
        assert_eq!((refusal.code, refusal.field.as_str()), (code, "options.reward"));
        let refusal = refuse(&Options::new().with_text("colour", "red"));
        assert_eq!(refusal.code, Code::UnknownOption);
        let far = Options::new().with("setup", table(&[("base", &[3.0, 3.0, 3.0, 0.0])]));
        let refusal = refuse(&far);
        assert_eq!((refusal.code, refusal.field.as_str()), (Code::InvalidOption, "options.setup"));
        // SurRoL has no tissue.
        if !is_slow(id) {
            let original = Options::new().with_text("preset", "surrol");
            assert!(registry.make(id, &original.clone().with_text("arm", "classic")).is_ok());
            let refusal = refuse(&original.with_text("arm", "si"));
            assert_eq!(
                (refusal.code, refusal.field.as_str()),
                (Code::InvalidOption, "options.arm")
            );
            for part in ["\"si\"", "\"classic\"", "preset = \"surrol\""] {
                assert!(refusal.to_string().contains(part), "{refusal}");
            }
        }
        let backwards = table(&[("latency", &[3.0, 1.0])]);
        let refusal = refuse(&Options::new().with("domain", backwards));
        assert_eq!(refusal.field, "options.domain.latency");
    }
}

/// Resets an environment whose episode has ended: a task may have terminal states.
fn begin_anew_where_it_ended(env: &mut Env) {
    if env.needs_reset() {
        env.reset(None);
    }
}

/// Random, but biased towards where goals and objects are.
fn towards_the_goal(actions: &mut Actions, env: &Env) -> Vec<f32> {
    let mut action = actions.next(env.spec());
    if actions.0.unit() < 0.6 {
        let expert = Seen::of(env).expert;
        let pull = 1.0 / expert.iter().fold(0.1, |largest: f32, number| largest.max(number.abs()));
        for (number, wanted) in action.iter_mut().zip(expert) {
            *number = 0.3 * *number + wanted * pull;
        }
    }
    action
}
