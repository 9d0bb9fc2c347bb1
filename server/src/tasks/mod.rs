//! What is learnt: one file per task, and the registry from which everything else takes its list.
//!
//! | task | in one line |
//! |---|---|
//! | [`needle_reach`] | the closed jaw tip of a PSM goes to a point just above a needle |
//! | [`gauze_retrieve`] | a PSM picks up a gauze and brings it to a goal |
//! | [`needle_pick`] | a PSM picks up a needle and brings it to a goal |
//! | [`peg_transfer`] | a PSM takes a block from one peg to another |
//! | [`needle_regrasp`] | a PSM hands a needle to the other, which brings it to a goal |
//! | [`bi_peg_transfer`] | a PSM takes a block to the other, which puts it onto a peg |
//! | [`ecm_reach`] | the endoscope goes to a position |
//! | [`mis_orient`] | the endoscope is rolled until its picture is level |
//! | [`static_track`] | the endoscope centres a cube among others |
//! | [`active_track`] | the endoscope follows a moving cube |
//!
//! `assignment.rs` reads options that are texts. A task of one's own implements [`Task`] and [`Registered`], and is added
//! by [`Registry::register`].

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use trocar_proto::builtin::TaskInfo;
use trocar_proto::goal::Reward;
use trocar_proto::relative::Relative;
use trocar_proto::spec::{Element, GoalSpec, OptionSpec};
use trocar_proto::{Code, Options, Rejection, Stage, TaskSpec};

use self::ecm_scene::EcmArm;
use self::expert::ExpertInput;
use self::proprioception::Proprioception;
use self::psm_scene::PsmArm;
use self::rate::Rate;
use crate::env::{Env, Imaging};
use crate::render::Scene;
use crate::sim::frames::Aabb;
use crate::sim::motion::MAX_INSTRUMENTS;
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

pub use assignment::Assignment;
pub use state::State;
pub use trocar_proto::builtin;

pub mod active_track;
mod assignment;
pub mod bi_peg_transfer;
pub mod bimanual;
pub mod camera;
pub mod ecm_reach;
pub mod ecm_scene;
pub mod expert;
pub mod gauze;
pub mod gauze_retrieve;
pub mod goal;
pub mod mis_orient;
pub mod needle_pick;
pub mod needle_reach;
pub mod needle_regrasp;
pub mod objects;
pub mod options;
pub mod pad;
pub mod path;
pub mod peg_board;
pub mod peg_expert;
pub mod peg_transfer;
pub mod perception;
pub mod pick;
pub mod picking;
pub(crate) mod proprioception;
pub mod psm_scene;
pub mod rate;
pub(crate) mod relative;
pub mod start;
pub mod state;
pub mod static_track;
pub mod theatre;
pub(crate) mod time;
pub mod track;
pub mod tray;

/// The instrument arms of a task.
pub type Arms<'a> = ArrayVec<&'a mut PsmArm, MAX_INSTRUMENTS>;

/// A task that can be made, so that a [`Registry`] may have it.
pub trait Registered: Task + Clone + Sized {
    /// What is fixed of it: name, summary, steps and rate, tags.
    const INFO: TaskInfo;

    /// Fields of the state that nothing changes, whatever actions are like. Tests look.
    const CONSTANT: &'static [&'static str] = &[];

    /// Those that nothing changes as long as actions are the paper's.
    const CONSTANT_UNDER_PAPER: &'static [&'static str] = &[];

    /// The options that it knows.
    fn options() -> Vec<OptionSpec>;

    /// The task and its prepared world under `options`, in which every option of
    /// [`Self::options`] has an allowed value.
    fn new(options: &Options) -> Result<(Self, World), Rejection>;
}

/// A task: what it looks like from outside, how an episode begins, what an action asks for, what is
/// seen. Letting time pass, counting steps, the time limit, checking actions, goal rewards and randomisation that is
/// the same for every task are [`Env`]'s. What every specification repeats is the [`Registry`]'s.
pub trait Task: CloneTask + Send + Sync + 'static {
    /// The elements of an action; they never change.
    fn action(&self) -> Vec<Element>;

    /// What its goals are, if it has any; they never change.
    fn goal(&self) -> Option<GoalSpec> {
        None
    }

    /// What its state, of these elements, and its goals say of each other: the features, without their dimensions.
    fn relative(&self, state: &[Element]) -> Relative {
        let _ = state;
        Relative::default()
    }

    /// Goes through the fields of the state; their descriptions never change.
    fn state(&self, world: &World, state: &mut State<'_>);

    /// Writes achieved and desired goal, of [`Self::goal`]'s dimensions.
    fn goals(&self, world: &World, achieved: &mut [f32], desired: &mut [f32]) {
        let _ = (world, achieved, desired);
    }

    /// Whether episodes begin in states that need physics to come about, see [`Self::prepare`].
    fn begins_prepared(&self) -> bool {
        false
    }

    /// Brings task and world to a state in which episodes may begin. Done rarely: episodes share a
    /// few of these states.
    fn prepare(&mut self, world: &mut World, rng: &mut Rng) {
        let _ = (world, rng);
    }

    /// Begins an episode in a copy of the world, or in one of the prepared states.
    fn reset(&mut self, world: &mut World, rng: &mut Rng);

    /// The objects that a reset may place, by name.
    fn objects(&self) -> Vec<(&'static str, BodyId)> {
        vec![]
    }

    /// Takes note that objects were placed anew.
    fn objects_placed(&mut self, world: &World) {
        let _ = world;
    }

    /// Sets the desired goal of the episode, a position (m), or says why it cannot be that.
    fn set_goal(&mut self, goal: &Vector3<f64>) -> Result<(), Rejection> {
        Err(goal::refuse(goal, "the goal of this task cannot be set"))
    }

    /// Takes a command, numbers in [−1, 1]: says where the arms are to go, and lets no time pass. `None` where
    /// no command has arrived yet: then the arms hold.
    fn command(&mut self, world: &mut World, action: Option<&[f32]>);

    /// The instrument arms, which the environment moves along their profiles.
    fn arms(&mut self) -> Arms<'_> {
        Arms::new()
    }

    /// The endoscope's arm, which the environment moves.
    fn endoscope(&mut self) -> Option<&mut EcmArm> {
        None
    }

    /// Takes note of what a step has brought, before it is observed.
    fn after_step(&mut self, world: &mut World) {
        let _ = world;
    }

    /// Brings what moves by itself to where it is after a `part`, 0 to 1, of the step to come. Pictures
    /// between steps are taken so, of a copy.
    fn between(&mut self, part: f64) {
        let _ = part;
    }

    /// Writes what a scripted expert would do now, numbers in [−1, 1]. Where actions are late, `input` has those
    /// that arrive before this one.
    fn expert(&self, world: &World, input: &ExpertInput<'_>, action: &mut [f32]);

    /// What that expert is about now; demonstrations are labelled with it.
    fn stage(&self, world: &World, input: &ExpertInput<'_>) -> Stage {
        let _ = (world, input);
        Stage::Reach
    }

    /// Adds what there is to see, and from where; by default every body as its collision shapes.
    fn scene(&self, world: &World, scene: &mut Scene) {
        scene.add_world(world);
    }

    /// Where free objects are to stay, m; see [`Env::has_lost_objects`].
    fn theatre(&self) -> Aabb {
        objects::THEATRE
    }

    /// The reward of tasks without goals; goal tasks get theirs from the goals.
    fn reward(&self, world: &World) -> f32 {
        let _ = world;
        0.0
    }

    /// Whether the episode ended in a terminal state.
    fn terminated(&self, world: &World) -> bool {
        let _ = world;
        false
    }
}

/// Clones a task behind a pointer; every task that is [`Clone`] has this.
pub trait CloneTask {
    /// A copy.
    fn boxed_clone(&self) -> Box<dyn Task>;
}

impl<T: Task + Clone> CloneTask for T {
    fn boxed_clone(&self) -> Box<dyn Task> {
        Box::new(self.clone())
    }
}

impl Clone for Box<dyn Task> {
    fn clone(&self) -> Self {
        self.as_ref().boxed_clone()
    }
}

/// The tasks that can be made, by id.
pub struct Registry(Vec<Entry>);

/// A task in its prepared world.
type InWorld = (Box<dyn Task>, World);

struct Entry {
    info: TaskInfo,
    constant: &'static [&'static str],
    constant_under_paper: &'static [&'static str],
    options: fn() -> Vec<OptionSpec>,
    make: fn(&Options) -> Result<InWorld, Rejection>,
}

impl Registry {
    /// Trocar's tasks.
    pub fn builtin() -> Self {
        let mut registry = Self::empty();
        registry.register::<needle_reach::NeedleReach>();
        registry.register::<gauze_retrieve::GauzeRetrieve>();
        registry.register::<needle_pick::NeedlePick>();
        registry.register::<bi_peg_transfer::BiPegTransfer>();
        registry.register::<peg_transfer::PegTransfer>();
        registry.register::<needle_regrasp::NeedleRegrasp>();
        registry.register::<ecm_reach::EcmReach>();
        registry.register::<mis_orient::MisOrient>();
        registry.register::<static_track::StaticTrack>();
        registry.register::<active_track::ActiveTrack>();
        registry
    }

    /// No tasks.
    pub fn empty() -> Self {
        Self(Vec::new())
    }

    /// Adds a task, in place of one that has its id.
    pub fn register<T: Registered>(&mut self) {
        self.0.retain(|entry| entry.info.id != T::INFO.id);
        self.0.push(Entry {
            info: T::INFO,
            constant: T::CONSTANT,
            constant_under_paper: T::CONSTANT_UNDER_PAPER,
            options: T::options,
            make: |options| T::new(options).map(|(task, world)| (Box::new(task) as _, world)),
        });
    }

    /// The ids in order of registration.
    pub fn ids(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|entry| entry.info.id)
    }

    /// The ids of the tasks that have a tag.
    pub fn tagged<'a>(&'a self, tag: &'a str) -> impl Iterator<Item = &'a str> {
        self.0.iter().filter(move |entry| entry.info.has(tag)).map(|entry| entry.info.id)
    }

    /// Whether nothing changes a field of a task's state, where actions are the paper's or not.
    pub fn is_constant(&self, id: &str, field: &str, under_paper: bool) -> bool {
        let entry = self.0.iter().find(|entry| entry.info.id == id);
        entry.is_some_and(|entry| {
            entry.constant.contains(&field)
                || under_paper && entry.constant_under_paper.contains(&field)
        })
    }

    /// The task `id` under `options`.
    pub fn spec(&self, id: &str, options: &Options) -> Result<TaskSpec, Rejection> {
        self.describe(id, options).map(|(spec, _)| spec)
    }

    /// The same, and the memory that an environment of it is counted with, bytes.
    pub(crate) fn describe(
        &self,
        id: &str,
        options: &Options,
    ) -> Result<(TaskSpec, u64), Rejection> {
        let mut made = self.build(id, options)?;
        let imaging = Imaging::of(&made.options, || made.first_scene())?;
        Ok((made.spec(options, imaging.as_ref()), Env::memory_bytes_with(&made.world)))
    }

    /// An environment of the task `id` under `options`; it needs a reset.
    pub fn make(&self, id: &str, options: &Options) -> Result<Env, Rejection> {
        let mut made = self.build(id, options)?;
        let domain = options::Domain::of(&made.options)?;
        let imaging = Imaging::of(&made.options, || made.first_scene())?;
        let spec = made.spec(options, imaging.as_ref());
        let Made { task, world, options, state, .. } = made;
        Ok(Env::new(spec, state, task, world, domain, options, imaging))
    }

    /// How environments of the task `id` under `options` are drawn when that is asked for. `view` may have
    /// what the options of observed pictures have; by default it is the overview, 640 × 480.
    pub(crate) fn view(
        &self,
        id: &str,
        options: &Options,
        view: &Options,
    ) -> Result<Imaging, Rejection> {
        let made = self.build(id, options)?;
        let of_view = |refusal: Rejection| match refusal.field.strip_prefix("options.") {
            Some(name) => Rejection { field: format!("view.{name}"), ..refusal },
            None => refusal,
        };
        let resolved = view.resolve(&options::of_views()).map_err(of_view)?;
        let imaging = Imaging::of(&resolved, || made.first_scene());
        let imaging = imaging.map_err(of_view)?;
        Ok(imaging.expect("views have colour and depth").fine())
    }

    fn build(&self, id: &str, options: &Options) -> Result<Made, Rejection> {
        let Some(entry) = self.0.iter().find(|entry| entry.info.id == id) else {
            let ids: Vec<_> = self.ids().collect();
            let allowed = format!("unknown task; this server knows {ids:?}");
            return Err(Rejection::new(Code::UnknownTask, "task", format!("{id:?}"), allowed));
        };
        let known = options::with_common((entry.options)());
        let allowed = options::under_preset(known, options);
        let options = options.resolve(&allowed)?;
        let (task, world) = (entry.make)(&options)?;
        let state = State::elements(|state| task.state(&world, state));
        let relative = task.relative(&state);
        if relative::is_wanted(&options) && relative.features.is_empty() {
            let allowed = "this task has no relative features";
            let word = format!("{:?}", relative::WORD);
            return Err(Rejection::new(Code::InvalidOption, "options.observation", word, allowed));
        }
        let known = (entry.options)();
        Ok(Made { info: entry.info, known, options, task, world, state, relative })
    }
}

/// A task that was made under some options, in its prepared world.
struct Made {
    info: TaskInfo,
    /// The options that it knows, besides those of every task.
    known: Vec<OptionSpec>,
    /// All of its options.
    options: Options,
    task: Box<dyn Task>,
    world: World,
    /// The elements of its state.
    state: Vec<Element>,
    relative: Relative,
}

impl Made {
    /// What it looks like; `given` are the options that were completed: defaults are those of its preset.
    fn spec(&mut self, given: &Options, imaging: Option<&Imaging>) -> TaskSpec {
        let goal = self.task.goal().map(|goal| GoalSpec {
            success: options::tolerated(goal.success, &self.options),
            ..goal
        });
        let goal_dim = goal.as_ref().map_or(0, |goal| goal.elements.len());
        let dims = [self.state.len(), goal_dim];
        let relative = Relative { dims, ..self.relative.clone() };
        let mut observation = self.state.clone();
        if options::observes_numbers(&self.options) && !options::observes_state(&self.options) {
            observation.clear();
        }
        observation.extend(Proprioception::of(&self.options).elements(self.task.as_mut()));
        if relative::is_wanted(&self.options) {
            observation.extend(relative.elements());
        }
        let rate = Rate::nominal(self.info.hertz).of(&self.options);
        let known = options::with_common(self.known.clone());
        TaskSpec {
            id: self.info.id.into(),
            summary: self.info.summary.into(),
            max_steps: rate.steps(self.info.steps),
            seconds_per_step: rate.seconds(),
            action: self.task.action(),
            observation,
            reward: if goal.is_some() { options::reward_of(&self.options) } else { Reward::State },
            goal,
            relative,
            options: options::under_preset(known, given),
            images: imaging.map(|imaging| imaging.spec().clone()),
        }
    }

    /// What there is to see in some episode: all bodies that there will ever be.
    fn first_scene(&self) -> Scene {
        let (mut task, mut world) = (self.task.clone(), self.world.clone());
        if !task.begins_prepared() {
            task.reset(&mut world, &mut Rng::new(0, 0));
        }
        let mut scene = Scene::default();
        task.scene(&world, &mut scene);
        scene.add_others(&world);
        scene
    }
}
