//! Exported states: how one is written down, checked and rebuilt.
//!
//! See [`trocar_proto::snapshot`] for what the bytes are. A state is rebuilt by going through its episode again.

use std::sync::Arc;

use trocar_proto::part;
use trocar_proto::{Code, Options, TaskSpec};

use super::{Env, RECORDED, Recipe, Rejection, State};

impl Env {
    /// What led to the present state.
    pub(crate) fn recipe(&self) -> Result<Recipe, Rejection> {
        self.check_begun()?;
        if self.is_driven {
            let why =
                "the arms were driven from outside; a state is exported where actions led to it";
            return Err(Rejection::new(Code::Unsupported, "snapshot", "no actions", why));
        }
        let dim = self.spec.action_dim();
        if self.taken.len() != self.steps as usize * dim {
            return Err(Rejection::new(
                Code::Unsupported,
                "snapshot",
                format!("{} steps into the episode", self.steps),
                format!("a state is exported from the first {} steps on", RECORDED / dim),
            ));
        }
        Ok(Recipe {
            version: env!("CARGO_PKG_VERSION").into(),
            task: self.spec.id.clone(),
            options: (*self.options).clone(),
            seed: self.seed,
            episode: self.episode,
            placement: self.placement.clone(),
            actions: self.taken.clone(),
            fingerprint: self.fingerprint(),
        })
    }

    /// An error before the first reset: there is no state yet.
    pub(crate) fn check_begun(&self) -> Result<(), Rejection> {
        if self.was_reset() {
            return Ok(());
        }
        let why = "it was never reset; reset it first";
        Err(Rejection::new(Code::ResetNeeded, "env", "no state", why))
    }

    /// What recipes must be of to lead to a state of this environment.
    pub(crate) fn identity(&self) -> Identity {
        Identity { spec: Arc::clone(&self.spec), options: Arc::clone(&self.options) }
    }

    /// A number that stands for every bit of what is seen and of what the objects do.
    pub(crate) fn fingerprint(&self) -> u64 {
        let (dim, goal) = (self.spec.observation_dim(), self.spec.goal_dim());
        let mut seen = vec![0.0; dim + 2 * goal];
        let (observation, goals) = seen.split_at_mut(dim);
        let (achieved, desired) = goals.split_at_mut(goal);
        self.observe(observation, achieved, desired);
        let words = seen.iter().map(|number| number.to_bits()).chain(self.world.bits());
        let words = words.chain([self.steps, u32::from(self.state == State::Over)]);
        part::fingerprint(words.flat_map(u32::to_le_bytes))
    }
}

/// A task and its options.
#[derive(Debug, Clone)]
pub(crate) struct Identity {
    spec: Arc<TaskSpec>,
    options: Arc<Options>,
}

impl Identity {
    /// Whether `recipe` is of this task and these options and can have happened.
    pub(crate) fn check(&self, recipe: &Recipe) -> Result<(), Rejection> {
        let refuse = |part: &str, value: String, allowed: String| {
            Err(Rejection::new(Code::InvalidSnapshot, format!("snapshot.{part}"), value, allowed))
        };
        if recipe.version != env!("CARGO_PKG_VERSION") {
            let allowed = format!("this is release {}", env!("CARGO_PKG_VERSION"));
            return refuse("version", format!("{:?}", recipe.version), allowed);
        }
        if recipe.task != self.spec.id {
            let allowed = format!("expected {:?}, as the environments here", self.spec.id);
            return refuse("task", format!("{:?}", recipe.task), allowed);
        }
        for (name, value) in &self.options.0 {
            let found = recipe.options.0.get(name);
            if found != Some(value) {
                let found = found.map_or("not given".into(), |found| format!("{found:?}"));
                let allowed = format!("expected {value:?}, as the environments here");
                return refuse(&format!("options.{name}"), found, allowed);
            }
        }
        if let Some(name) = recipe.options.0.keys().find(|name| !self.options.0.contains_key(*name))
        {
            return refuse("options", format!("{name:?}"), "the task has no such option".into());
        }
        recipe.placement.check()?;
        let (dim, count) = (self.spec.action_dim(), recipe.actions.len());
        let most = (self.spec.max_steps as usize).min(RECORDED / dim);
        if !count.is_multiple_of(dim) || count / dim > most {
            let allowed = format!("allowed are {dim} numbers for each of at most {most} steps");
            return refuse("actions", format!("{count} numbers"), allowed);
        }
        if let Some(number) = recipe.actions.iter().find(|number| !(-1.0..=1.0).contains(*number)) {
            return refuse("actions", number.to_string(), "allowed are numbers in [-1, 1]".into());
        }
        Ok(())
    }
}

/// An environment on its way back to an exported state, step by step.
#[derive(Clone)]
pub(crate) struct Rebuild {
    env: Env,
    recipe: Recipe,
    /// Numbers of actions that were carried out; `None` before the episode has begun.
    done: Option<usize>,
    failed: bool,
    /// Why the episode does not begin as it is said to have begun.
    refused: Option<Rejection>,
}

impl Rebuild {
    /// An episode that is still to begin, of a recipe that [`Identity::check`] of `like` found to be good.
    pub(crate) fn new(like: &Env, recipe: Recipe) -> Self {
        let mut env = like.clone();
        (env.seed, env.episode) = (recipe.seed, recipe.episode);
        Self { env, recipe, done: None, failed: false, refused: None }
    }

    /// Whether no step is left.
    pub(crate) fn is_done(&self) -> bool {
        self.failed || self.refused.is_some() || self.done == Some(self.recipe.actions.len())
    }

    /// Begins, or carries out the next step, if one is left.
    pub(crate) fn step(&mut self) {
        if self.is_done() {
            return;
        }
        let Some(done) = self.done else {
            self.env.begin();
            self.refused = self.env.arrange(&self.recipe.placement).err();
            self.done = Some(0);
            return;
        };
        let end = done + self.env.spec.action_dim();
        // A failure of the simulation is a state like another; steps after it are not.
        self.failed = self.env.needs_reset();
        self.env.step(&self.recipe.actions[done..end]).ok();
        self.done = Some(end);
    }

    /// The environment, if its state is the one that was exported.
    pub(crate) fn finish(self) -> Result<Env, Rejection> {
        if let Some(refusal) = self.refused {
            return Err(Rejection { code: Code::InvalidSnapshot, ..refusal });
        }
        let found = self.env.fingerprint();
        if self.is_done() && !self.failed && found == self.recipe.fingerprint {
            return Ok(self.env);
        }
        Err(Rejection::new(
            Code::InvalidSnapshot,
            "snapshot.fingerprint",
            format!("{:016x}", self.recipe.fingerprint),
            format!(
                "its actions lead to {found:016x} here; it was changed, or another build wrote it"
            ),
        ))
    }
}
