//! Episodes that begin with a part of the work done: states that need physics to come about.
//!
//! A session has [`COUNT`] of them for its task and options. Each is made when it is first needed, by letting the
//! scripted expert do that part. A prepared state depends on its number only.
//!
//! The seed of an episode chooses a state and varies it: jaws and object move together to another place, and the rows
//! of `domain` are drawn anew, for an object that is held already as well. Afterwards contacts come to rest, in at
//! most two steps. A variation is valid if the object stays where the jaws brought it, at rest, without a new overlap.
//! Otherwise the next attempt has a smaller extent or another prepared state; later attempts also draw all rows again.
//! Without a valid attempt, the episode begins in the unvaried state.
//!
//! The true pose of an arm that holds an object does not depend on the arm's errors: sensors report another pose. An arm
//! without an object begins at its sensed pose.

use std::sync::OnceLock;

use trocar_proto::Options;
use trocar_proto::spec::OptionSpec;

use super::expert::ExpertInput;
use super::rate::{self, Rate};
use super::{Registered, Task, time};
use crate::sim::frames::Pose;
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

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

/// Extent of the variation of a prepared state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    /// Share of the whole range of poses, 0 to 1.
    pub share: f64,
    /// True if the episode draws mass and size of objects, friction of the jaws and stiffness of the pad; otherwise
    /// those of the prepared state stay.
    pub contacts: bool,
}

/// Successive attempts: the number of the prepared state, counted from the drawn one, and the extent. Poses close to
/// the prepared one need less room.
const VARIATIONS: [(usize, Extent); 4] = [
    (0, Extent { share: 1.0, contacts: true }),
    (0, Extent { share: 0.5, contacts: true }),
    (0, Extent { share: 0.1, contacts: true }),
    (1, Extent { share: 1.0, contacts: true }),
];

/// Attempts with other draws of all rows, if no attempt of [`VARIATIONS`] is valid: some errors of arms leave no room
/// between jaws and object.
const REDRAWS: usize = 16;

/// Last attempts, with mass, size and friction of the prepared states.
const SAME_CONTACTS: usize = 2;

/// Interval in which the contacts of a varied state come to rest, s; repeated while an object is fast.
const SETTLING: f64 = 0.05;

/// Longest time in which contacts come to rest, s: two steps.
const MAX_SETTLING_TIME: f64 = 0.4;

/// Largest speed of an object at the beginning of an episode, m/s.
const MAX_SPEED: f64 = 5e-3;

/// Largest movement of an object while contacts come to rest: m and rad.
const MAX_SETTLING: [f64; 2] = [2e-3, 0.15];

/// Overlaps up to this depth are allowed, m, and up to as much more than in the prepared state.
const MAX_OVERLAP: f64 = 0.1e-3;
const MAX_MORE_OVERLAP: f64 = 0.02e-3;

/// Deepest overlap of a free object with anything, m, fingers included: they sink into thin and into round objects.
const MAX_SQUEEZED: f64 = 0.4e-3;

/// Overlaps and clearance of a state.
struct Contacts {
    /// Deepest overlap of the main object with everything but instruments, m.
    object: f64,
    /// Deepest overlap of an instrument with fixed bodies, m.
    instruments: f64,
    /// Clearance of two instruments, m.
    gap: f64,
}

impl Contacts {
    fn of(task: &mut dyn Task, world: &World) -> Self {
        let object = task.objects().first().map(|(_, body)| *body);
        let mut arms = task.arms();
        let instruments = arms.iter_mut().map(|arm| arm.instrument().static_overlap(world));
        let instruments = instruments.fold(0.0, f64::max);
        let gap = match arms.as_slice() {
            [one, other] => one.gap(other),
            _ => f64::INFINITY,
        };
        let mut own = |body| arms.iter_mut().any(|arm| arm.instrument().has_body(body));
        let others: Vec<_> =
            world.bodies().map(|solid| solid.body).filter(|body| own(*body)).collect();
        let object =
            object.map_or(0.0, |object| world.overlap(object, |other| !others.contains(&other)));
        Self { object, instruments, gap }
    }

    fn allows(&self, varied: &Self) -> bool {
        let most = |depth: f64| MAX_OVERLAP.max(depth + MAX_MORE_OVERLAP);
        varied.object <= most(self.object)
            && varied.instruments <= most(self.instruments)
            && varied.gap >= self.gap.min(0.0)
    }
}

/// A task in its world, where episodes begin.
struct State {
    task: Box<dyn Task>,
    world: World,
    contacts: Contacts,
    /// Deepest overlap of a free object, m.
    overlap: f64,
}

/// The prepared states, from which episodes begin.
pub(crate) struct Starts {
    task: Box<dyn Task>,
    world: World,
    /// Substeps of a step.
    substeps: u32,
    states: Box<[OnceLock<State>]>,
}

impl Starts {
    /// The states of `task`, whose steps have so many substeps, in `world`; none is made yet.
    pub(crate) fn new(task: Box<dyn Task>, world: World, substeps: u32) -> Self {
        Self { task, world, substeps, states: (0..COUNT).map(|_| OnceLock::new()).collect() }
    }

    /// Brings `task` and `world` to the beginning of an episode: one of the states, which `rng` draws, varied by
    /// `variation`. If no variation is valid, the state stays as it is.
    pub(crate) fn begin(
        &self,
        rng: &mut Rng,
        variation: &Rng,
        task: &mut Box<dyn Task>,
        world: &mut World,
    ) {
        let drawn = rng.index(COUNT);
        for (further, extent) in VARIATIONS {
            let state = self.restore((drawn + further) % COUNT, task, world);
            if self.vary(state, task.as_mut(), world, &mut variation.clone(), extent) {
                return;
            }
        }
        let mut redrawn = variation.clone();
        for further in 0..REDRAWS + SAME_CONTACTS {
            let state = self.restore((drawn + further) % COUNT, task, world);
            let extent = Extent { share: 0.5, contacts: further < REDRAWS };
            if self.vary(state, task.as_mut(), world, &mut redrawn, extent) {
                return;
            }
        }
        tracing::debug!("no variation of the prepared start is valid");
        self.restore(drawn, task, world);
    }

    /// Copies a prepared state into `task` and `world`.
    fn restore(&self, index: usize, task: &mut Box<dyn Task>, world: &mut World) -> &State {
        let state = self.state(index);
        task.clone_from(&state.task);
        world.clone_from(&state.world);
        state
    }

    fn state(&self, index: usize) -> &State {
        self.states[index].get_or_init(|| {
            let (mut task, mut world) = (self.task.clone(), self.world.clone());
            task.prepare(&mut world, &mut Rng::start(index as u64));
            let contacts = Contacts::of(task.as_mut(), &world);
            let overlap = world.deepest_overlap();
            State { task, world, contacts, overlap }
        })
    }

    /// Varies a copy of `state`; false if the result is no valid beginning.
    fn vary(
        &self,
        state: &State,
        task: &mut dyn Task,
        world: &mut World,
        variation: &mut Rng,
        extent: Extent,
    ) -> bool {
        if !task.vary(world, variation, extent)
            || !state.contacts.allows(&Contacts::of(task, world))
        {
            return false;
        }
        let objects: Vec<_> = world.objects().map(|body| (body, world.pose(body))).collect();
        let [interval, longest] = [SETTLING, MAX_SETTLING_TIME].map(rate::substeps);
        let mut passed = 0;
        let is_fast =
            |world: &World| world.objects().any(|body| world.velocity(body).norm() >= MAX_SPEED);
        while passed == 0 || passed < longest && is_fast(world) {
            let part = interval.min(self.substeps);
            let mut time = time::Time::default();
            time.command(task, world, None, self.substeps);
            time.pass(task, world, part);
            time.sense(task);
            task.after_step(world);
            passed += part;
        }
        let rests = |(body, before): &(BodyId, Pose)| {
            let moved = before.inv_mul(&world.pose(*body));
            moved.translation.vector.norm() < MAX_SETTLING[0]
                && moved.rotation.angle() < MAX_SETTLING[1]
                && world.velocity(*body).norm() < MAX_SPEED
        };
        world.is_finite()
            && objects.iter().all(rests)
            && world.deepest_overlap() <= MAX_SQUEEZED.max(state.overlap + MAX_MORE_OVERLAP)
            && task.is_prepared(world)
            && state.contacts.allows(&Contacts::of(task, world))
    }
}
