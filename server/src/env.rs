//! One environment: a task in its world, episode by episode. It knows nothing of clients.
//!
//! ```
//! use trocar_proto::Options;
//! use trocar_server::Registry;
//!
//! let mut env = Registry::builtin().make("NeedleReach-v0", &Options::new())?;
//! env.reset(Some(7));
//! let mut action = vec![0.0; env.spec().action_dim()];
//! let step = loop {
//!     env.expert(&mut action);
//!     let step = env.step(&action)?;
//!     if step.truncated {
//!         break step;
//!     }
//! };
//! assert!(step.is_success);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::sync::Arc;

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use trocar_proto::goal::Reward;
use trocar_proto::snapshot::Recipe;
use trocar_proto::spec::Element;
use trocar_proto::{Code, Options, Placement, Rejection, Stage, TaskSpec};

use crate::error::StepError;
use crate::render::{Look, Scene};
use crate::sim::instrument::BetweenFingers;
use crate::sim::motion::{Effort, MAX_INSTRUMENTS};
use crate::sim::random::Rng;
use crate::sim::soft::Damage;
use crate::sim::world::World;
use crate::tasks::expert::{ExpertInput, Sees};
use crate::tasks::options::{self, Domain};
use crate::tasks::proprioception::Proprioception;
use crate::tasks::start::Starts;
use crate::tasks::time::Time;
use crate::tasks::{Task, rate, relative};

mod arrange;
mod bounds;
mod drive;
mod imaging;
mod live;
mod observing;
mod passing;
mod rebuild;
#[cfg(test)]
#[expect(clippy::float_cmp, reason = "these results are exact")]
mod tests;

pub use bounds::Excess;
use bounds::Excesses;
pub use drive::Drive;
pub use imaging::Pictures;
pub(crate) use imaging::{Imaging, Shot};
pub use live::LiveWorld;
use observing::{Noise, Seen, Sight};
use passing::Actuation;

pub(crate) use rebuild::{Identity, Rebuild};

/// Most numbers of actions that are kept of an episode: they fit into an exported snapshot, and are
/// 1300 steps of ten numbers.
const RECORDED: usize = 13_000;

/// What one step gave, besides what [`Env::observe`] shows: the columns of replies whose role is `step`, see
/// [`trocar_proto::reply_columns`].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Step {
    /// Reward of the transition.
    pub reward: f32,
    /// The episode ended in a terminal state.
    pub terminated: bool,
    /// The episode ended at its time limit.
    pub truncated: bool,
    /// The goal is reached now; never for tasks without goals.
    pub is_success: bool,
    /// Length of the paths of the tips, m: of the jaws of all arms together, or of the endoscope. A path is the polygon
    /// through where the true tip is after each substep, 1/240 s.
    pub tip_path: f32,
    /// Largest force between a jaw and a touched body, N, averaged over 1/60 s; 0 if the jaws touched nothing. Friction
    /// is excluded. The static limit of grip and arm is in `server/GRASPING.md`.
    pub peak_force: f32,
    /// Largest pressure of a finger or wrist on tissue, Pa: its force over the skin that it touches, as the average of a
    /// substep.
    pub tissue_pressure: f32,
    /// Share of the elements of soft bodies that are stretched beyond the ultimate strain of their material after the step,
    /// of those that are not between jaws in part.
    pub overstretched: f32,
    /// Share of the elements that are compressed beyond it, of those between jaws.
    pub crushed: f32,
}

/// An environment as one value: world, task, randomness and step count. A clone is a snapshot and
/// goes on bit by bit like the original; [`Self::export`] gives one as bytes.
#[derive(Clone)]
pub struct Env {
    spec: Arc<TaskSpec>,
    beginning: Beginning,
    options: Arc<Options>,
    imaging: Option<Arc<Imaging>>,
    look: Look,
    expert_sees: Sees,
    domain: Domain,
    task: Box<dyn Task>,
    world: World,
    seed: u64,
    episode: u64,
    /// How the episode was made to begin.
    placement: Placement,
    steps: u32,
    state: State,
    /// The step after which an object was seen to be lost, and said to be.
    lost_at: Option<u32>,
    noise: Noise,
    /// Substeps of a step.
    substeps: u32,
    time: Time,
    /// Substeps that an action is on its way.
    latency: u32,
    actuation: Actuation,
    /// Whether the arms were driven from outside in this episode: then no actions lead to its state.
    is_driven: bool,
    /// Joints of the endoscope's arm beside PSMs where a live world moves it, rad; index 2 in m.
    endoscope_joints: Option<[f64; 4]>,
    /// Actions on their way, the oldest first.
    delayed: Vec<f32>,
    command: Vec<f32>,
    /// Which numbers an observation has besides, or in place of, the task's.
    own: Proprioception,
    sight: Sight,
    /// What the arms measured of themselves when they were last sensed.
    measured: Vec<f32>,
    terminates_on_success: bool,
    /// Actions since the episode began, as far as there is room.
    taken: Vec<f32>,
    seen: Seen,
    /// What was clamped and should not have had to be.
    excesses: Excesses,
}

/// From what episodes begin.
#[derive(Clone)]
enum Beginning {
    /// One world, which a reset arranges.
    World(Arc<World>),
    /// One of several states.
    Starts(Arc<Starts>),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// Never reset.
    New,
    /// In an episode.
    Running,
    /// After an episode, or after a failure.
    Over,
}

impl Env {
    /// Memory that an environment of rigid bodies is counted with, bytes: an upper bound over the tasks.
    pub const MEMORY_BYTES: u64 = 192 << 10;

    /// Memory that this environment is counted with, bytes.
    pub fn memory_bytes(&self) -> u64 {
        Self::memory_bytes_with(&self.world)
    }

    /// The same for one with this world.
    pub(crate) fn memory_bytes_with(world: &World) -> u64 {
        Self::MEMORY_BYTES + world.memory_bytes()
    }

    /// An environment of `task` under all of `options`. `spec` is the specification before scaling, `state` holds the
    /// elements of the state, `world` was prepared by the task. The environment needs a reset.
    pub(crate) fn new(
        spec: TaskSpec,
        state: Vec<Element>,
        task: Box<dyn Task>,
        world: World,
        domain: Domain,
        options: Options,
        imaging: Option<Imaging>,
    ) -> Self {
        let (action, observation, goal) =
            (spec.action_dim(), spec.observation_dim(), spec.goal_dim());
        let substeps = rate::substeps(spec.seconds_per_step);
        Self {
            substeps,
            spec: Arc::new(options::shown(spec.clone(), &options)),
            beginning: if task.begins_prepared() {
                Beginning::Starts(Arc::new(Starts::new(task.clone(), world.clone(), substeps)))
            } else {
                Beginning::World(Arc::new(world.clone()))
            },
            expert_sees: Sees::of(&options),
            own: Proprioception::of(&options),
            sight: Sight {
                elements: state.into(),
                has_state: options::observes_state(&options)
                    || !options::observes_numbers(&options),
                has_features: relative::is_wanted(&options),
                plain: options::is_scaled(&options).then(|| Arc::new(spec)),
            },
            measured: vec![],
            terminates_on_success: options::terminates_on_success(&options),
            look: options::look_of(&options),
            options: Arc::new(options),
            imaging: imaging.map(Arc::new),
            domain,
            task,
            world,
            seed: 0,
            episode: 0,
            placement: Placement::default(),
            steps: 0,
            state: State::New,
            lost_at: None,
            noise: Noise { rng: Rng::new(0, 0), sigma: 0.0 },
            time: Time::default(),
            latency: 0,
            actuation: Actuation::none(),
            is_driven: false,
            endoscope_joints: None,
            delayed: vec![],
            command: vec![0.0; action],
            taken: vec![],
            seen: Seen {
                observation: vec![0.0; observation],
                achieved: vec![0.0; goal],
                desired: vec![0.0; goal],
                is_present: false,
            },
            excesses: Excesses::default(),
        }
    }

    /// The task under this environment's options.
    pub fn spec(&self) -> &TaskSpec {
        &self.spec
    }

    /// What is simulated, to look at.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// What there is to see now.
    pub fn scene(&self) -> Scene {
        let mut scene = Scene::default();
        scene.endoscope_joints = self.endoscope_joints;
        self.task.scene(&self.world, &mut scene);
        scene.add_others(&self.world, &mut Rng::appearance(self.seed, self.episode));
        scene.set_look(self.look);
        scene
    }

    /// Draws the pictures that the options ask for, one view after the other; shapes as in
    /// [`trocar_proto::wire::ReplyLayout`], empty what is not asked for.
    ///
    /// # Panics
    /// Where a slice has another length.
    pub fn show(&self, rgb: &mut [u8], depth: &mut [f32], mask: &mut [i32], points: &mut [f32]) {
        if let Some(imaging) = &self.imaging {
            imaging.draw(&mut [Shot { scene: self.scene(), rgb, depth, mask, points }]);
        }
    }

    /// How its pictures are drawn, if it has any.
    pub(crate) fn imaging(&self) -> Option<&Arc<Imaging>> {
        self.imaging.as_ref()
    }

    /// Whether an object has left the theatre: it fell off the table, or was thrown away. Observations
    /// show it at the edge.
    pub fn has_lost_objects(&self) -> bool {
        let theatre = self.task.theatre();
        self.world.objects().any(|object| {
            let at = self.world.pose(object).translation.vector;
            theatre.clamp(&at) != at
        })
    }

    /// Whether the last step was the first of the episode after which an object was lost.
    pub fn has_just_lost_an_object(&self) -> bool {
        self.lost_at == Some(self.steps)
    }

    /// Begins an episode: episode 0 of `seed`, or without one the next episode of the seed that is
    /// set (the first ever is episode 0 of seed 0).
    pub fn reset(&mut self, seed: Option<u64>) {
        match seed {
            Some(seed) => return self.reset_to(seed, 0),
            None if self.state == State::New => {}
            // A client may ask for the last of all episodes, after which comes the first.
            None => self.episode = self.episode.wrapping_add(1),
        }
        self.begin();
    }

    /// Begins an episode of a seed.
    pub fn reset_to(&mut self, seed: u64, episode: u64) {
        (self.seed, self.episode) = (trocar_proto::seed::of(seed.into()), episode);
        self.begin();
    }

    /// Begins the episode that is set.
    fn begin(&mut self) {
        tracing::debug!(task = self.spec.id, self.seed, self.episode, "reset");
        self.steps = 0;
        self.time = Time::default();
        self.placement = Placement::default();
        self.seen.is_present = false;
        // Here, so that no step has to allocate.
        let dim = self.spec.action_dim();
        self.taken.clear();
        self.taken.reserve((self.spec.max_steps as usize * dim).min(RECORDED));
        self.state = State::Running;
        self.lost_at = None;
        let mut rng = Rng::new(self.seed, self.episode);
        match &self.beginning {
            Beginning::World(world) => self.world.clone_from(world),
            Beginning::Starts(starts) => {
                let variation = Rng::variation(self.seed, self.episode);
                starts.begin(&mut rng, &variation, &mut self.task, &mut self.world);
            }
        }
        self.task.reset(&mut self.world, &mut rng);
        self.measure();

        let mut rng = Rng::sensor(self.seed, self.episode);
        let late = self.domain.latency_seconds.draw(&mut rng.aside());
        self.latency = self.domain.latency.draw_integer(&mut rng) as u32 * self.substeps
            + rate::substeps(late);
        self.noise = Noise { sigma: self.domain.observation_noise.draw(&mut rng), rng };
        self.actuation = Actuation::draw(&self.domain, self.seed, self.episode);
        self.is_driven = false;
        self.endoscope_joints = None;
        self.delayed.clear();
        self.delayed.reserve((self.latency.div_ceil(self.substeps) as usize + 1) * dim);
    }

    /// Sets the seed whose first episode the next reset without a seed begins.
    pub fn set_seed(&mut self, seed: u64) {
        (self.seed, self.episode, self.state) =
            (trocar_proto::seed::of(seed.into()), 0, State::New);
    }

    /// Whether an episode was ever begun.
    pub fn was_reset(&self) -> bool {
        self.state != State::New
    }

    /// Seed of the episode.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Number of the episode under its seed, from 0.
    pub fn episode(&self) -> u64 {
        self.episode
    }

    /// Steps since the episode began.
    pub fn steps(&self) -> u32 {
        self.steps
    }

    /// Whether [`Self::step`] would be refused: before the first reset, after an episode's end, and
    /// after a failure of the simulation.
    pub fn needs_reset(&self) -> bool {
        self.state != State::Running
    }

    /// Lets one step pass. `action` has one finite number for each element of the specification;
    /// numbers outside [−1, 1] are clipped.
    pub fn step(&mut self, action: &[f32]) -> Result<Step, StepError> {
        let mut seen = std::mem::take(&mut self.seen);
        let Seen { observation, achieved, desired, is_present } = &mut seen;
        let result = self.step_into(action, observation, achieved, desired);
        *is_present |= matches!(result, Ok(_) | Err(StepError::Simulation { .. }));
        self.seen = seen;
        result
    }

    /// As [`Self::step`], and writes what [`Self::observe`] would then write.
    pub fn step_into(
        &mut self,
        action: &[f32],
        observation: &mut [f32],
        achieved: &mut [f32],
        desired: &mut [f32],
    ) -> Result<Step, StepError> {
        if self.needs_reset() {
            return Err(StepError::ResetNeeded);
        }
        self.check(action)?;
        self.take_down(action);
        self.pass_noise();
        let Effort { tip_path, peak_force, tissue_pressure } = self.pass(action, 1, &mut |_| {});
        self.measure();
        self.steps += 1;
        self.seen.is_present = false;
        let shows_finite = self.look(observation, achieved, desired);
        let failure = if !self.world.is_finite() {
            Some("the position or velocity of an object")
        } else if !shows_finite {
            Some("the observation or goal")
        } else {
            None
        };
        if let Some(what) = failure {
            self.state = State::Over;
            return Err(StepError::Simulation { what, step: self.steps });
        }

        if self.lost_at.is_none() && self.has_lost_objects() {
            self.lost_at = Some(self.steps);
            let Self { seed, episode, steps, .. } = self;
            tracing::warn!(task = self.spec.id, seed, episode, steps, "an object left the theatre");
        }

        let step = self.evaluate(achieved, desired);
        let truncated = self.steps >= self.spec.max_steps;
        if step.terminated || truncated {
            self.state = State::Over;
        }
        let damage = self.damage();
        Ok(Step {
            truncated,
            tip_path: tip_path as f32,
            peak_force: peak_force as f32,
            tissue_pressure: tissue_pressure as f32,
            overstretched: damage.overstretched_share() as f32,
            crushed: damage.crushed_share() as f32,
            ..step
        })
    }

    /// What was done to the elements of soft bodies.
    fn damage(&mut self) -> Damage {
        let Self { task, world, .. } = self;
        let mut damage = Damage::default();
        if world.soft_bodies().next().is_none() {
            return damage;
        }
        let mut arms = task.arms();
        let jaws = arms.iter_mut().map(|arm| arm.instrument().between_fingers(world));
        let jaws: ArrayVec<BetweenFingers, MAX_INSTRUMENTS> = jaws.collect();
        for body in world.soft_bodies() {
            damage += body.damage(|point, reach| jaws.iter().any(|each| each.has(point, reach)));
        }
        damage
    }

    /// What the present state is worth, but for the time limit and what led to it.
    fn evaluate(&self, achieved: &[f32], desired: &[f32]) -> Step {
        let reward = match (&self.spec.goal, self.spec.reward) {
            (Some(goal), Reward::Sparse | Reward::Dense) => {
                self.spec.reward.of(&goal.success, achieved, desired)
            }
            _ => self.task.reward(&self.world),
        };
        let is_success = self.spec.is_success(achieved, desired);
        let terminated =
            self.task.terminated(&self.world) || (is_success && self.terminates_on_success);
        Step { reward, terminated, is_success, ..Step::default() }
    }

    /// The present state as bytes, from which [`Self::import`] rebuilds it: here, in another process
    /// or on another machine.
    pub fn export(&self) -> Result<Vec<u8>, Rejection> {
        self.recipe()?.to_bytes()
    }

    /// An environment of the same task and options in the state that `bytes` tell of; they may be
    /// anything. Rebuilding it takes as long as the episode took up to there.
    pub fn import(&self, bytes: &[u8]) -> Result<Self, Rejection> {
        let recipe = Recipe::from_bytes(bytes)?;
        self.identity().check(&recipe)?;
        let mut rebuild = Rebuild::new(self, recipe);
        while !rebuild.is_done() {
            rebuild.step();
        }
        rebuild.finish()
    }

    /// Writes the scripted expert's action for the present state.
    pub fn expert(&self, action: &mut [f32]) {
        self.task.expert(&self.world, &self.expert_input(), action);
        for (number, element) in action.iter_mut().zip(&self.spec.action) {
            self.check_bounds("expert", *number, element);
            *number = number.clamp(-1.0, 1.0);
        }
    }

    /// What the scripted expert is about in the present state.
    pub fn stage(&self) -> Stage {
        self.task.stage(&self.world, &self.expert_input())
    }

    fn expert_input(&self) -> ExpertInput<'_> {
        let position_error = match self.expert_sees {
            Sees::Measured if self.noise.sigma > 0.0 => {
                let mut rng = self.noise.rng.aside();
                Vector3::from_fn(|_, _| self.noise.sigma * rng.normal())
            }
            _ => Vector3::zeros(),
        };
        ExpertInput { in_flight: &self.delayed, sees: self.expert_sees, position_error }
    }

    fn check(&self, action: &[f32]) -> Result<(), Rejection> {
        let expected = self.spec.action_dim();
        if action.len() != expected {
            return Err(Rejection::new(
                Code::InvalidAction,
                "action",
                format!("{} numbers", action.len()),
                format!("{expected} numbers, each finite"),
            ));
        }
        match action.iter().position(|number| !number.is_finite()) {
            None => Ok(()),
            Some(index) => Err(Rejection::new(
                Code::InvalidAction,
                format!("action[{index}]"),
                action[index],
                format!("a finite number ({})", self.spec.action[index].name),
            )),
        }
    }

    /// Keeps the action for [`Self::export`], where there is room.
    fn take_down(&mut self, action: &[f32]) {
        if self.taken.len() + action.len() <= RECORDED {
            self.taken.extend(action.iter().map(|number| number.clamp(-1.0, 1.0)));
        }
    }
}
