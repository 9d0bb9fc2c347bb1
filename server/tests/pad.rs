//! Experts that are wrong about heights, on a pad that gives and without.
//!
//! `TROCAR_SOAK=1` plays more seeds. `--nocapture` shows how many succeed.

use nalgebra::Vector3;
use rayon::prelude::*;
use trocar_proto::builtin::TaskInfo;
use trocar_proto::spec::{Element, GoalSpec, OptionSpec};
use trocar_proto::{OptionValue, Options, Rejection, Stage};
use trocar_server::Registry;
use trocar_server::render::Scene;
use trocar_server::sim::frames::Aabb;
use trocar_server::sim::random::Rng;
use trocar_server::sim::world::World;
use trocar_server::tasks::expert::ExpertInput;
use trocar_server::tasks::gauze_retrieve::GauzeRetrieve;
use trocar_server::tasks::needle_pick::NeedlePick;
use trocar_server::tasks::peg_transfer::PegTransfer;
use trocar_server::tasks::{Arms, Registered, State, Task};

/// By how much an expert is wrong about heights at most, m.
const WRONG: f64 = 1e-3;

/// The first seed.
const FIRST: u64 = 50_000;

/// A task whose expert takes the objects for higher or lower than they are, by as much throughout an episode.
#[derive(Clone)]
struct Misled<T> {
    task: T,
    error: f64,
}

impl<T: Registered> Registered for Misled<T> {
    const INFO: TaskInfo = T::INFO;

    fn options() -> Vec<OptionSpec> {
        T::options()
    }

    fn new(options: &Options) -> Result<(Self, World), Rejection> {
        T::new(options).map(|(task, world)| (Self { task, error: 0.0 }, world))
    }
}

impl<T: Registered> Task for Misled<T> {
    fn action(&self) -> Vec<Element> {
        self.task.action()
    }

    fn goal(&self) -> Option<GoalSpec> {
        self.task.goal()
    }

    fn reset(&mut self, world: &mut World, rng: &mut Rng) {
        // Far behind what the episode itself draws aside.
        let mut aside = rng.aside();
        let error = (0..100).map(|_| aside.uniform(-WRONG, WRONG)).last();
        self.error = error.unwrap();
        self.task.reset(world, rng);
    }

    fn command(&mut self, world: &mut World, action: Option<&[f32]>) {
        self.task.command(world, action);
    }

    fn arms(&mut self) -> Arms<'_> {
        self.task.arms()
    }

    fn after_step(&mut self, world: &mut World) {
        self.task.after_step(world);
    }

    fn state(&self, world: &World, state: &mut State<'_>) {
        self.task.state(world, state);
    }

    fn goals(&self, world: &World, achieved: &mut [f32], desired: &mut [f32]) {
        self.task.goals(world, achieved, desired);
    }

    fn expert(&self, world: &World, input: &ExpertInput<'_>, action: &mut [f32]) {
        let position_error = input.position_error + Vector3::z() * self.error;
        self.task.expert(world, &ExpertInput { position_error, ..*input }, action);
    }

    fn stage(&self, world: &World, input: &ExpertInput<'_>) -> Stage {
        self.task.stage(world, input)
    }

    fn scene(&self, world: &World, scene: &mut Scene) {
        self.task.scene(world, scene);
    }

    fn theatre(&self) -> Aabb {
        self.task.theatre()
    }
}

/// The share of `seeds` with which the misled expert of `id` succeeds, on a pad of a stiffness (N/m) that gives
/// by a depth (m) or without.
fn share(id: &str, pad: Option<[f64; 2]>, seeds: u64) -> f64 {
    let mut registry = Registry::empty();
    registry.register::<Misled<NeedlePick>>();
    registry.register::<Misled<GauzeRetrieve>>();
    registry.register::<Misled<PegTransfer>>();
    let rows = pad.into_iter().flat_map(|[stiffness, depth]| {
        [("pad_stiffness", stiffness), ("pad_depth", depth)]
            .map(|(row, number)| (row.to_string(), vec![number; 2]))
    });
    let options = Options::new().with("domain", OptionValue::Table(rows.collect()));
    let env = registry.make(id, &options).unwrap();
    let succeeds = |seed: u64| {
        let mut env = env.clone();
        let mut action = vec![0.0; env.spec().action_dim()];
        env.reset(Some(seed));
        let mut last = None;
        while !env.needs_reset() {
            env.expert(&mut action);
            last = Some(env.step(&action).unwrap());
        }
        last.unwrap().is_success
    };
    let failing: Vec<_> =
        (FIRST..FIRST + seeds).into_par_iter().filter(|seed| !succeeds(*seed)).collect();
    let successes = seeds - failing.len() as u64;
    eprintln!("{id}, {pad:?}: {successes} of {seeds}; failing: {failing:?}");
    successes as f64 / seeds as f64
}

/// Seeds of a run.
fn seeds() -> u64 {
    if std::env::var_os("TROCAR_SOAK").is_some() { 200 } else { 12 }
}

#[test]
fn on_a_pad_experts_that_are_wrong_about_heights_grasp_all_the_same() {
    for id in ["NeedlePick-v0", "GauzeRetrieve-v0"] {
        for stiffness in [50.0, 200.0, 1000.0] {
            let share = share(id, Some([stiffness, 2.0 * WRONG]), seeds());
            assert!(share >= 0.9, "{id}, {stiffness} N/m: {share}");
        }
    }
}

#[test]
fn without_a_pad_they_grasp_all_the_same() {
    for id in ["NeedlePick-v0", "GauzeRetrieve-v0", "PegTransfer-v0"] {
        let share = share(id, None, seeds());
        assert!(share >= 0.9, "{id}: {share}");
    }
}
