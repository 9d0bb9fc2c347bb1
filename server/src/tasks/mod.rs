//! What is learnt: one file per task.
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
//! | [`tissue_retract`] | a PSM lifts the edge of a sheet of fat and exposes what lies under it |
//! | [`tissue_point`] | a PSM brings a marked point of a sheet of fat to a place |
//! | [`gauze_place`] | a PSM lays a soft gauze on a spot |
//!
//! `assignment.rs` reads options that are texts. A task of one's own implements [`Task`] and [`Registered`], and is added
//! by [`Registry::register`](crate::Registry::register).

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use trocar_proto::builtin::TaskInfo;
use trocar_proto::relative::Relative;
use trocar_proto::spec::{Element, GoalSpec, OptionSpec};
use trocar_proto::{Options, Rejection, Stage};

use self::ecm_scene::EcmArm;
use self::expert::ExpertInput;
use self::psm_scene::PsmArm;
use crate::render::Scene;
use crate::sim::frames::Aabb;
use crate::sim::motion::MAX_INSTRUMENTS;
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

pub use assignment::Assignment;
pub use start::Extent;
pub use state::State;
pub use trocar_proto::builtin;

pub mod active_track;
mod assignment;
pub mod bi_peg_transfer;
pub mod bimanual;
pub mod camera;
pub mod cylinder;
pub mod cylinder_pick;
pub mod cylinder_reach;
pub mod ecm_reach;
pub mod ecm_scene;
pub mod expert;
pub mod exposure;
pub mod gauze;
pub mod gauze_place;
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
pub mod reaching;
pub(crate) mod relative;
pub mod soft_grasp;
pub mod start;
pub mod state;
pub mod static_track;
pub mod theatre;
pub(crate) mod time;
pub mod tissue;
pub mod tissue_point;
pub mod tissue_retract;
pub mod tissue_task;
pub mod track;
pub mod tray;

/// The instrument arms of a task.
pub type Arms<'a> = ArrayVec<&'a mut PsmArm, MAX_INSTRUMENTS>;

/// A task that can be made, so that a [`Registry`](crate::Registry) may have it.
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

/// A task: specification, beginning of an episode, commands of an action, state and goals. Letting time pass, counting steps, the time limit, checking actions, goal rewards and randomisation that is
/// the same for every task are [`Env`](crate::Env)'s. What every specification repeats is the [`Registry`](crate::Registry)'s.
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

    /// Varies a prepared state by the episode of `rng`: other poses and the rows of `domain`. An episode of another
    /// seed begins elsewhere. Returns false if no such state exists, after which the state is undefined.
    fn vary(&mut self, world: &mut World, rng: &mut Rng, extent: Extent) -> bool {
        let _ = (world, rng, extent);
        true
    }

    /// True if a varied state is still a prepared one: a held object is held.
    fn is_prepared(&self, world: &World) -> bool {
        let _ = world;
        true
    }

    /// Begins an episode in a copy of the world, or in a varied copy of a prepared state.
    fn reset(&mut self, world: &mut World, rng: &mut Rng);

    /// The free objects, by name. A reset may place them, unless episodes begin prepared.
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

    /// Where free objects are to stay, m; see [`Env::has_lost_objects`](crate::Env::has_lost_objects).
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

/// A task that can be made.
pub(crate) struct Entry {
    pub(crate) info: TaskInfo,
    pub(crate) constant: &'static [&'static str],
    pub(crate) constant_under_paper: &'static [&'static str],
    pub(crate) options: fn() -> Vec<OptionSpec>,
    pub(crate) make: fn(&Options) -> Result<InWorld, Rejection>,
}

/// A task in its prepared world.
type InWorld = (Box<dyn Task>, World);

impl Entry {
    pub(crate) fn of<T: Registered>() -> Self {
        Self {
            info: T::INFO,
            constant: T::CONSTANT,
            constant_under_paper: T::CONSTANT_UNDER_PAPER,
            options: T::options,
            make: |options| T::new(options).map(|(task, world)| (Box::new(task) as _, world)),
        }
    }
}

/// Trocar's tasks.
pub(crate) fn all() -> Vec<Entry> {
    vec![
        Entry::of::<needle_reach::NeedleReach>(),
        Entry::of::<gauze_retrieve::GauzeRetrieve>(),
        Entry::of::<needle_pick::NeedlePick>(),
        Entry::of::<bi_peg_transfer::BiPegTransfer>(),
        Entry::of::<peg_transfer::PegTransfer>(),
        Entry::of::<needle_regrasp::NeedleRegrasp>(),
        Entry::of::<ecm_reach::EcmReach>(),
        Entry::of::<mis_orient::MisOrient>(),
        Entry::of::<static_track::StaticTrack>(),
        Entry::of::<active_track::ActiveTrack>(),
        Entry::of::<cylinder_pick::CylinderPick>(),
        Entry::of::<cylinder_reach::CylinderReach>(),
        Entry::of::<tissue_retract::TissueRetract>(),
        Entry::of::<tissue_point::TissuePoint>(),
        Entry::of::<gauze_place::GauzePlace>(),
    ]
}
