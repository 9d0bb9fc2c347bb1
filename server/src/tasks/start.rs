//! Episodes that begin with a part of the work done: states that need physics to come about.
//!
//! A session has [`COUNT`] of them for its task and options. Each is made when it is first needed, by
//! letting the scripted expert do that part, and is the same wherever it is made; the seed of an
//! episode chooses one.

use std::sync::OnceLock;

use trocar_proto::Options;
use trocar_proto::spec::OptionSpec;

use super::expert::ExpertInput;
use super::rate::Rate;
use super::{Registered, Task, time};
use crate::sim::random::Rng;
use crate::sim::world::World;

/// How many different states episodes begin in.
pub const COUNT: usize = 64;

/// Attempts of the expert to bring a state about, each from another beginning.
const ATTEMPTS: u32 = 16;

/// How much of the work is done when an episode begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Start {
    /// Nothing.
    Reset,
    /// The open jaws are about the object.
    Approach,
    /// The jaws hold the object.
    Pick,
    /// The object is lifted as high as it is to be carried.
    Lift,
}

/// `start`: how much of the work is done when an episode begins.
pub fn option() -> OptionSpec {
    OptionSpec::choice(
        "start",
        "reset: nothing is done; approach: the open jaws are about the object; pick: they hold it; \
         lift: it is lifted.",
        &["reset", "approach", "pick", "lift"],
    )
}

impl Start {
    /// The start that resolved options ask for.
    pub fn of(options: &Options) -> Self {
        match options.text("start") {
            Some("approach") => Self::Approach,
            Some("pick") => Self::Pick,
            Some("lift") => Self::Lift,
            _ => Self::Reset,
        }
    }
}

/// Lets the expert of `task`, commanded at `rate`, work until it is `there`. `begin` begins an episode from nothing; where the
/// expert fails, it begins another.
pub fn bring_about<T: Registered>(
    task: &mut T,
    world: &mut World,
    rng: &mut Rng,
    rate: Rate,
    begin: impl Fn(&mut T, &mut World, &mut Rng),
    there: impl Fn(&T, &World) -> bool,
) {
    let mut action = vec![0.0; task.action().len()];
    let (empty_task, empty_world) = (task.clone(), world.clone());
    for _ in 0..ATTEMPTS {
        task.clone_from(&empty_task);
        world.clone_from(&empty_world);
        begin(task, world, rng);
        for _ in 0..rate.steps(T::INFO.steps) {
            if there(task, world) {
                return;
            }
            Task::expert(task, world, &ExpertInput::default(), &mut action);
            time::step(task, world, Some(&action), rate.substeps());
        }
    }
    tracing::warn!(
        task = T::INFO.id,
        "the expert failed to prepare a start; it is as far as it came"
    );
}

/// A task in its world, where episodes begin.
type State = (Box<dyn Task>, World);

/// The states in which episodes begin.
pub(crate) struct Starts {
    task: Box<dyn Task>,
    world: World,
    states: Box<[OnceLock<State>]>,
}

impl Starts {
    /// The states of `task` in `world`; none is made yet.
    pub(crate) fn new(task: Box<dyn Task>, world: World) -> Self {
        Self { task, world, states: (0..COUNT).map(|_| OnceLock::new()).collect() }
    }

    /// One of the states.
    pub(crate) fn draw(&self, rng: &mut Rng) -> &State {
        let index = rng.index(COUNT);
        self.states[index].get_or_init(|| {
            let (mut task, mut world) = (self.task.clone(), self.world.clone());
            task.prepare(&mut world, &mut Rng::start(index as u64));
            (task, world)
        })
    }
}
