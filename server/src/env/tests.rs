//! Episodes, delays, noise, domains and failures of an environment.

use trocar_proto::Options;
use trocar_proto::builtin::TaskInfo;
use trocar_proto::spec::{Element, OptionSpec};

use super::*;
use crate::registry::Registry;
use crate::sim::world::Solver;
use crate::tasks::State as Fields;
use crate::tasks::expert::ExpertInput;
use crate::tasks::{Registered, Task};

/// A task whose observation leaves its range when the action is 0.75, and is no number when it is 1.
#[derive(Clone)]
struct Fragile(f32);

impl Registered for Fragile {
    const INFO: TaskInfo = TaskInfo {
        id: "Fragile-v0",
        summary: "Leave the range, or break.",
        steps: 3,
        hertz: 10.0,
        tags: &[],
    };

    fn options() -> Vec<OptionSpec> {
        vec![]
    }

    fn new(_: &Options) -> Result<(Self, World), Rejection> {
        Ok((Self(0.0), World::new(Solver::LIGHT)))
    }
}

impl Task for Fragile {
    fn action(&self) -> Vec<Element> {
        vec![Element::new("break", "", "1", -1.0, 1.0)]
    }

    fn state(&self, _: &World, state: &mut Fields<'_>) {
        state.field(|| Element::new("state", "", "1", -1.0, 1.0), self.0.into());
    }

    fn reset(&mut self, _: &mut World, _: &mut Rng) {
        self.0 = 0.0;
    }

    fn command(&mut self, _: &mut World, action: Option<&[f32]>) {
        self.0 = match action {
            Some(&[1.0]) => f32::NAN,
            Some(&[0.75]) => 1.5,
            _ => 0.5,
        };
    }

    fn reward(&self, _: &World) -> f32 {
        2.0 * self.0
    }

    fn expert(&self, _: &World, _: &ExpertInput<'_>, action: &mut [f32]) {
        action[0] = 7.0;
    }
}

fn fragile() -> Env {
    let mut registry = Registry::empty();
    registry.register::<Fragile>();
    registry.make("Fragile-v0", &Options::new()).unwrap()
}

#[test]
fn a_state_that_is_not_finite_ends_only_this_episode() {
    let mut env = fragile();
    let mut other = env.clone();
    env.reset(None);
    other.reset(None);
    assert!(matches!(env.step(&[1.0]), Err(StepError::Simulation { step: 1, .. })));
    assert_eq!(env.step(&[0.0]), Err(StepError::ResetNeeded));
    assert_eq!(other.step(&[0.0]).unwrap().reward, 1.0);
    env.reset(None);
    assert_eq!(env.step(&[0.0]).unwrap().reward, 1.0);
}

#[test]
fn an_environment_is_reset_before_and_after_each_episode() {
    let mut env = fragile();
    assert!(env.needs_reset());
    assert_eq!(env.step(&[0.0]), Err(StepError::ResetNeeded));
    env.reset(None);
    assert_eq!((env.seed(), env.episode()), (0, 0));
    for step in 1..=3 {
        assert_eq!(env.step(&[0.0]).unwrap().truncated, step == 3);
        assert_eq!(env.steps(), step);
    }
    assert_eq!(env.step(&[0.0]), Err(StepError::ResetNeeded));
    env.reset(None);
    assert_eq!((env.seed(), env.episode(), env.steps()), (0, 1, 0));
    env.reset(Some(9));
    assert_eq!((env.seed(), env.episode()), (9, 0));
    env.reset_to(8, 3);
    assert_eq!((env.seed(), env.episode(), env.steps()), (8, 3, 0));
    env.reset(None);
    assert_eq!((env.seed(), env.episode()), (8, 4));
}

#[test]
fn a_large_seed_is_mixed_to_one_that_begins_the_same_episodes() {
    let mut env = fragile();
    let mixed = trocar_proto::seed::of(u64::MAX.into());
    for seed in [u64::MAX, mixed] {
        env.reset(Some(seed));
        assert_eq!(env.seed(), mixed);
        env.set_seed(seed);
        assert_eq!(env.seed(), mixed);
    }
}

#[test]
fn bad_actions_are_refused_by_name_and_the_experts_are_clipped() {
    let mut env = fragile();
    env.reset(None);
    let StepError::InvalidAction(refusal) = env.step(&[f32::NAN]).unwrap_err() else {
        panic!("not refused as an action");
    };
    assert_eq!((refusal.code, refusal.field.as_str()), (Code::InvalidAction, "action[0]"));
    assert!(matches!(env.step(&[0.0, 0.0]), Err(StepError::InvalidAction(_))));
    assert_eq!(env.steps(), 0);
    let mut action = [0.0];
    env.expert(&mut action);
    assert_eq!(action, [1.0]);
    let excess = Excess { count: 1, farthest: 7.0 };
    assert_eq!(env.clamped().into_iter().collect::<Vec<_>>(), [("expert: break".into(), excess)]);
}

#[test]
fn what_leaves_its_range_is_clamped_and_counted() {
    let mut env = fragile();
    env.reset(None);
    env.step(&[0.0]).unwrap();
    assert!(env.clamped().is_empty());
    let mut seen = [0.0];
    for _ in 0..2 {
        env.step(&[0.75]).unwrap();
        env.observe(&mut seen, &mut [], &mut []);
        assert_eq!(seen, [1.0]);
    }
    let excess = Excess { count: 2, farthest: 1.5 };
    let clamped = env.clone().clamped();
    assert_eq!(clamped.into_iter().collect::<Vec<_>>(), [("observation: state".into(), excess)]);
    env.reset(None);
    env.step(&[1.0]).unwrap_err();
    assert_eq!(env.clamped()["observation: state"], excess, "no number is no excess");
}

#[test]
fn a_state_is_exported_from_as_many_steps_on_as_are_kept() {
    let mut env = fragile();
    Arc::make_mut(&mut env.spec).max_steps = 2 * RECORDED as u32;
    let fresh = env.clone();
    env.reset(Some(1));
    for _ in 0..RECORDED {
        env.step(&[0.25]).unwrap();
    }
    let last = env.export().unwrap();
    assert_eq!(fresh.import(&last).unwrap().steps() as usize, RECORDED);
    env.step(&[0.25]).unwrap();
    let refusal = env.export().unwrap_err();
    assert_eq!((refusal.code, refusal.field.as_str()), (Code::Unsupported, "snapshot"));
    let mut clone = env.clone();
    assert_eq!(clone.step(&[0.25]).unwrap(), env.step(&[0.25]).unwrap());
    env.reset(None);
    assert!(env.export().is_ok());
}

#[test]
fn a_failure_of_the_simulation_is_a_state_like_another() {
    let mut env = fragile();
    env.reset(None);
    env.step(&[0.0]).unwrap();
    env.step(&[1.0]).unwrap_err();
    let mut copy = fragile().import(&env.export().unwrap()).unwrap();
    assert_eq!((copy.steps(), copy.needs_reset()), (2, true));
    copy.reset(None);
    assert_eq!((copy.episode(), copy.step(&[0.0]).unwrap().reward), (1, 1.0));
}

#[test]
fn after_the_last_episode_of_a_seed_comes_its_first() {
    let mut env = Registry::builtin().make("EcmReach-v0", &Options::new()).unwrap();
    env.reset_to(3, u64::MAX);
    env.reset(None);
    assert_eq!((env.seed(), env.episode()), (3, 0));
}
