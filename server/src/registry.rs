//! The tasks that can be made, and environments of them. It is above both: a task knows of no environment, and an
//! environment of no list of tasks.

use trocar_proto::builtin::TaskInfo;
use trocar_proto::goal::Reward;
use trocar_proto::relative::Relative;
use trocar_proto::spec::{Element, GoalSpec, OptionSpec};
use trocar_proto::{Code, Options, Rejection, TaskSpec, similar};

use crate::env::{Env, Imaging};
use crate::render::Scene;
use crate::sim::random::Rng;
use crate::sim::world::World;
use crate::tasks::proprioception::Proprioception;
use crate::tasks::rate::Rate;
use crate::tasks::{self, Entry, Registered, State, Task, options, relative};

/// The tasks that can be made, by id.
pub struct Registry(Vec<Entry>);

impl Registry {
    /// Trocar's tasks.
    pub fn builtin() -> Self {
        Self(tasks::all())
    }

    /// No tasks.
    pub fn empty() -> Self {
        Self(Vec::new())
    }

    /// Adds a task, in place of one that has its id.
    pub fn register<T: Registered>(&mut self) {
        self.0.retain(|entry| entry.info.id != T::INFO.id);
        self.0.push(Entry::of::<T>());
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
        let spec = options::shown(made.spec(options, imaging.as_ref()), &made.options);
        Ok((spec, Env::memory_bytes_with(&made.world)))
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
            let hint = similar::hint(id, self.ids());
            let allowed = format!("unknown task{hint}; this server knows {ids:?}");
            return Err(Rejection::new(Code::UnknownTask, "task", format!("{id:?}"), allowed));
        };
        let allowed = options::under_preset(known_options(&entry.info, (entry.options)()), options);
        let options = options.resolve(&allowed)?;
        let (task, world) = (entry.make)(&options)?;
        let state = State::elements(|state| task.state(&world, state));
        let relative = task.relative(&state);
        if relative::is_wanted(&options) && relative.features.is_empty() {
            let allowed = "this task has no relative features";
            let word = format!("{:?}", relative::WORD);
            return Err(Rejection::new(Code::InvalidOption, "options.observation", word, allowed));
        }
        if relative::is_wanted(&options) && options::is_scaled(&options) {
            let allowed = "relative features are of unscaled numbers; allowed is one of both words";
            let words = format!("{:?}", [options::SCALED, relative::WORD]);
            return Err(Rejection::new(Code::InvalidOption, "options.observation", words, allowed));
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

/// The task's own options and the common options of all tasks.
fn known_options(info: &TaskInfo, own: Vec<OptionSpec>) -> Vec<OptionSpec> {
    let mut known = options::with_common(own);
    known.push(options::episode_seconds(f64::from(info.steps) / info.hertz));
    known
}

impl Made {
    /// What it looks like, unscaled; `given` are the options that were completed: defaults are those of its preset.
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
        let known = known_options(&self.info, self.known.clone());
        TaskSpec {
            id: self.info.id.into(),
            summary: self.info.summary.into(),
            max_steps: rate.steps_in(options::episode_seconds_of(&self.options)),
            seconds_per_step: rate.seconds(),
            action: self.task.action(),
            observation,
            reward: if goal.is_some() { options::reward_of(&self.options) } else { Reward::State },
            goal,
            relative,
            options: options::under_preset(known, given),
            images: imaging.map(|imaging| imaging.spec().clone()),
            has_tissue: self.world.soft_bodies().next().is_some(),
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
        scene.add_others(&world, &mut Rng::appearance(0, 0));
        scene
    }
}
