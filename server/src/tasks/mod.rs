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
//! `assignment.rs` reads options that are texts. A task of one's own implements [`Task`] and is added by [`Registry::register`].

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use trocar_proto::spec::OptionSpec;
use trocar_proto::{Code, Options, Rejection, Stage, TaskSpec};

use self::ecm_scene::EcmArm;
use self::expert::ExpertInput;
use self::proprioception::Proprioception;
use self::psm_scene::PsmArm;
use crate::env::{Env, Imaging};
use crate::render::Scene;
use crate::sim::frames::Aabb;
use crate::sim::motion::MAX_INSTRUMENTS;
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

pub use assignment::Assignment;

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
pub(crate) mod proprioception;
pub mod psm_scene;
pub mod rate;
pub(crate) mod relative;
pub mod start;
pub mod static_track;
pub mod theatre;
pub(crate) mod time;
pub mod track;
pub mod tray;

/// The instrument arms of a task.
pub type Arms<'a> = ArrayVec<&'a mut PsmArm, MAX_INSTRUMENTS>;

/// A task: what it looks like from outside, how an episode begins, what an action asks for, what is
/// seen. Letting time pass, counting steps, the time limit, checking actions, goal rewards and randomisation that is
/// the same for every task are [`Env`]'s.
pub trait Task: Clone + Send + Sync + 'static {
    /// Name with version, e.g. `NeedleReach-v0`.
    const ID: &'static str;

    /// The options that it knows.
    fn options() -> Vec<OptionSpec>;

    /// The task and its prepared world under `options`, in which every option of
    /// [`Self::options`] has an allowed value.
    fn new(options: &Options) -> Result<(Self, World), Rejection>;

    /// What it looks like from outside; it never changes.
    fn spec(&self) -> TaskSpec;

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

    /// Writes observation, achieved and desired goal, of the specification's dimensions.
    fn observe(
        &self,
        world: &World,
        observation: &mut [f32],
        achieved: &mut [f32],
        desired: &mut [f32],
    );

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

/// The tasks that can be made, by id.
pub struct Registry(Vec<Entry>);

/// A task with its prepared world.
type Made = (Box<dyn AnyTask>, World);

struct Entry {
    id: &'static str,
    options: fn() -> Vec<OptionSpec>,
    make: fn(&Options) -> Result<Made, Rejection>,
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
    pub fn register<T: Task>(&mut self) {
        self.0.retain(|entry| entry.id != T::ID);
        self.0.push(Entry {
            id: T::ID,
            options: T::options,
            make: |options| T::new(options).map(|(task, world)| (Box::new(task) as _, world)),
        });
    }

    /// The ids in order of registration.
    pub fn ids(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|entry| entry.id)
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
        let (mut task, world, resolved) = self.build(id, options)?;
        let imaging = Imaging::of(&resolved, || first_scene(task.as_ref(), &world))?;
        let spec = spec_of(task.as_mut(), options, &resolved, imaging.as_ref());
        Ok((spec, Env::memory_bytes_with(&world)))
    }

    /// An environment of the task `id` under `options`; it needs a reset.
    pub fn make(&self, id: &str, options: &Options) -> Result<Env, Rejection> {
        let (mut task, world, resolved) = self.build(id, options)?;
        let domain = options::Domain::of(&resolved)?;
        let imaging = Imaging::of(&resolved, || first_scene(task.as_ref(), &world))?;
        let spec = spec_of(task.as_mut(), options, &resolved, imaging.as_ref());
        Ok(Env::new(spec, task, world, domain, resolved, imaging))
    }

    /// How environments of the task `id` under `options` are drawn when that is asked for. `view` may have
    /// what the options of observed pictures have; by default it is the overview, 640 × 480.
    pub(crate) fn view(
        &self,
        id: &str,
        options: &Options,
        view: &Options,
    ) -> Result<Imaging, Rejection> {
        let (task, world, _) = self.build(id, options)?;
        let of_view = |refusal: Rejection| match refusal.field.strip_prefix("options.") {
            Some(name) => Rejection { field: format!("view.{name}"), ..refusal },
            None => refusal,
        };
        let resolved = view.resolve(&options::of_views()).map_err(of_view)?;
        let imaging = Imaging::of(&resolved, || first_scene(task.as_ref(), &world));
        let imaging = imaging.map_err(of_view)?;
        Ok(imaging.expect("views have colour and depth").fine())
    }

    fn build(
        &self,
        id: &str,
        options: &Options,
    ) -> Result<(Box<dyn AnyTask>, World, Options), Rejection> {
        let Some(entry) = self.0.iter().find(|entry| entry.id == id) else {
            let ids: Vec<_> = self.ids().collect();
            let allowed = format!("unknown task; this server knows {ids:?}");
            return Err(Rejection::new(Code::UnknownTask, "task", format!("{id:?}"), allowed));
        };
        let known = options::with_common((entry.options)());
        let allowed = options::under_preset(known, options);
        let options = options.resolve(&allowed)?;
        let (task, world) = (entry.make)(&options)?;
        if relative::is_wanted(&options) && task.spec().relative.features.is_empty() {
            let allowed = "this task has no relative features";
            let word = format!("{:?}", relative::WORD);
            return Err(Rejection::new(Code::InvalidOption, "options.observation", word, allowed));
        }
        Ok((task, world, options))
    }
}

/// What a task looks like under `resolved`, to which `options` were completed; the defaults of its options are
/// those of the preset.
fn spec_of(
    task: &mut dyn AnyTask,
    options: &Options,
    resolved: &Options,
    imaging: Option<&Imaging>,
) -> TaskSpec {
    let mut spec = task.spec();
    spec.relative = relative::of(&spec);
    if options::observes_numbers(resolved) && !options::observes_state(resolved) {
        spec.observation.clear();
    }
    spec.observation.extend(Proprioception::of(resolved).elements(task));
    if relative::is_wanted(resolved) {
        spec.observation.extend(spec.relative.elements());
    }
    let known = options::with_common(spec.options);
    TaskSpec {
        options: options::under_preset(known, options),
        images: imaging.map(|imaging| imaging.spec().clone()),
        ..spec
    }
}

/// What there is to see in some episode: all bodies that there will ever be.
fn first_scene(task: &dyn AnyTask, world: &World) -> Scene {
    let (mut task, mut world) = (task.boxed_clone(), world.clone());
    if !task.begins_prepared() {
        task.reset(&mut world, &mut Rng::new(0, 0));
    }
    let mut scene = Scene::default();
    task.scene(&world, &mut scene);
    scene.add_others(&world);
    scene
}

/// [`Task`] behind a pointer.
pub(crate) trait AnyTask: Send + Sync {
    fn spec(&self) -> TaskSpec;
    fn begins_prepared(&self) -> bool;
    fn prepare(&mut self, world: &mut World, rng: &mut Rng);
    fn reset(&mut self, world: &mut World, rng: &mut Rng);
    fn objects(&self) -> Vec<(&'static str, BodyId)>;
    fn objects_placed(&mut self, world: &World);
    fn set_goal(&mut self, goal: &Vector3<f64>) -> Result<(), Rejection>;
    fn command(&mut self, world: &mut World, action: Option<&[f32]>);
    fn arms(&mut self) -> Arms<'_>;
    fn endoscope(&mut self) -> Option<&mut EcmArm>;
    fn after_step(&mut self, world: &mut World);
    fn between(&mut self, part: f64);
    fn observe(
        &self,
        world: &World,
        observation: &mut [f32],
        achieved: &mut [f32],
        desired: &mut [f32],
    );
    fn expert(&self, world: &World, input: &ExpertInput<'_>, action: &mut [f32]);
    fn stage(&self, world: &World, input: &ExpertInput<'_>) -> Stage;
    fn scene(&self, world: &World, scene: &mut Scene);
    fn theatre(&self) -> Aabb;
    fn reward(&self, world: &World) -> f32;
    fn terminated(&self, world: &World) -> bool;
    fn boxed_clone(&self) -> Box<dyn AnyTask>;
}

impl<T: Task> AnyTask for T {
    fn spec(&self) -> TaskSpec {
        Task::spec(self)
    }

    fn begins_prepared(&self) -> bool {
        Task::begins_prepared(self)
    }

    fn prepare(&mut self, world: &mut World, rng: &mut Rng) {
        Task::prepare(self, world, rng);
    }

    fn reset(&mut self, world: &mut World, rng: &mut Rng) {
        Task::reset(self, world, rng);
    }

    fn objects(&self) -> Vec<(&'static str, BodyId)> {
        Task::objects(self)
    }

    fn objects_placed(&mut self, world: &World) {
        Task::objects_placed(self, world);
    }

    fn set_goal(&mut self, goal: &Vector3<f64>) -> Result<(), Rejection> {
        Task::set_goal(self, goal)
    }

    fn command(&mut self, world: &mut World, action: Option<&[f32]>) {
        Task::command(self, world, action);
    }

    fn arms(&mut self) -> Arms<'_> {
        Task::arms(self)
    }

    fn endoscope(&mut self) -> Option<&mut EcmArm> {
        Task::endoscope(self)
    }

    fn after_step(&mut self, world: &mut World) {
        Task::after_step(self, world);
    }

    fn between(&mut self, part: f64) {
        Task::between(self, part);
    }

    fn observe(
        &self,
        world: &World,
        observation: &mut [f32],
        achieved: &mut [f32],
        desired: &mut [f32],
    ) {
        Task::observe(self, world, observation, achieved, desired);
    }

    fn expert(&self, world: &World, input: &ExpertInput<'_>, action: &mut [f32]) {
        Task::expert(self, world, input, action);
    }

    fn stage(&self, world: &World, input: &ExpertInput<'_>) -> Stage {
        Task::stage(self, world, input)
    }

    fn scene(&self, world: &World, scene: &mut Scene) {
        Task::scene(self, world, scene);
    }

    fn theatre(&self) -> Aabb {
        Task::theatre(self)
    }

    fn reward(&self, world: &World) -> f32 {
        Task::reward(self, world)
    }

    fn terminated(&self, world: &World) -> bool {
        Task::terminated(self, world)
    }

    fn boxed_clone(&self) -> Box<dyn AnyTask> {
        Box::new(self.clone())
    }
}

impl Clone for Box<dyn AnyTask> {
    fn clone(&self) -> Self {
        self.as_ref().boxed_clone()
    }
}
