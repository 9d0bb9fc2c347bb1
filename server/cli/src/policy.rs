//! Agents: experts, random numbers, trained policies.

use std::path::Path;

use anyhow::Context;
use clap::ValueEnum;
use serde::Serialize;
use trocar_network::{Network, Seen};
use trocar_proto::{TaskSpec, similar};
use trocar_server::sim::random::Rng;
use trocar_server::{Env, Step, StepError};

use crate::exit::Exit;
use crate::options::{self, Assignment};
use crate::policies;

/// What chooses the actions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Policy {
    /// The task's scripted expert
    Oracle,
    /// Uniformly random in [−1, 1], by the episode's seed
    Random,
}

impl Policy {
    /// The agent of the episode of `seed`.
    pub(crate) fn actor(self, seed: u64) -> Actor {
        // No episode of a task has this number, so its randomness is not used twice.
        let rng = || Rng::new(seed, u64::MAX);
        Actor((self == Self::Random).then(rng))
    }

    /// Whether the expert's actions are needed.
    pub(crate) fn asks_expert(self) -> bool {
        self == Self::Oracle
    }
}

impl std::fmt::Display for Policy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Oracle => "oracle",
            Self::Random => "random",
        })
    }
}

/// What acts in one episode: random numbers, or the expert where there are none.
#[derive(Debug, Clone)]
pub(crate) struct Actor(Option<Rng>);

impl Actor {
    /// Writes the next action; `expert` writes what the expert would do now.
    pub(crate) fn act(&mut self, action: &mut [f32], expert: impl FnOnce(&mut [f32])) {
        match &mut self.0 {
            Some(rng) => action.fill_with(|| rng.uniform(-1.0, 1.0) as f32),
            None => expert(action),
        }
    }
}

/// What chooses the actions of a rollout.
#[derive(Clone)]
pub(crate) enum Chooser {
    /// The expert, or random numbers.
    Policy(Policy),
    /// A policy that was trained.
    Network(Network),
}

impl Chooser {
    /// Reads `oracle`, `random`, the name of an ONNX file, or a task that has a policy.
    pub(crate) fn read(text: &str) -> anyhow::Result<Self> {
        if let Ok(policy) = Policy::from_str(text, false) {
            return Ok(Self::Policy(policy));
        }
        let path = Path::new(text);
        if path.extension().is_some_and(|extension| extension == "onnx") {
            return Ok(Self::Network(Network::load(path).map_err(|error| unfit(&error))?));
        }
        if let Some(network) = policies::find(text) {
            return Ok(Self::Network(network));
        }
        let tasks = policies::names().collect::<Vec<_>>().join(", ");
        let allowed =
            "allowed are oracle, random, the name of a file that ends in .onnx, or a task";
        let hint = similar::hint(text, policies::names());
        Err(Exit::Usage(format!("--policy {text}: {allowed}: {tasks}{hint}")).into())
    }

    /// Options of a task: those with which a policy was trained, then `given`, which win.
    pub(crate) fn with_options(&self, given: Vec<Assignment>) -> anyhow::Result<Vec<Assignment>> {
        let Self::Network(network) = self else { return Ok(given) };
        let trained = options::from_json(network.options().unwrap_or("{}"));
        let trained = trained.with_context(|| format!("the options of {self}"))?;
        Ok([trained, given].concat())
    }

    /// An error unless it can act in a task.
    pub(crate) fn check(&self, spec: &TaskSpec) -> anyhow::Result<()> {
        match self {
            Self::Policy(_) => Ok(()),
            Self::Network(network) => network.check(spec).map_err(|error| unfit(&error)),
        }
    }

    /// Plays the episode of `seed`. `after_step` is shown the environment after every step, and what came
    /// of it: nothing where the simulation failed.
    pub(crate) fn play(
        &self,
        env: &mut Env,
        seed: u64,
        mut after_step: impl FnMut(&Env, Option<Step>) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        let mut agent = self.agent(env.spec(), seed);
        env.reset(Some(seed));
        while !env.needs_reset() {
            let step = match env.step(agent.act(env)?) {
                Ok(step) => Some(step),
                Err(StepError::Simulation { .. }) => None,
                Err(error) => return Err(error.into()),
            };
            after_step(env, step)?;
        }
        Ok(())
    }

    /// The same, for another thread.
    pub(crate) fn twin(&self) -> Self {
        match self {
            Self::Policy(policy) => Self::Policy(*policy),
            Self::Network(network) => Self::Network(network.twin()),
        }
    }

    /// The tasks of the argument `--task`: where it is `all`, that for which a policy was trained, or `all()`.
    pub(crate) fn tasks(
        &self,
        task: &str,
        all: impl FnOnce() -> anyhow::Result<Vec<String>>,
    ) -> anyhow::Result<Vec<String>> {
        match (task, self) {
            ("all", Self::Network(network)) => {
                let without = "--task: the policy's file names no task, so this must".into();
                Ok(vec![network.task().ok_or(Exit::Usage(without))?.to_string()])
            }
            ("all", Self::Policy(_)) => all(),
            (task, _) => Ok(vec![task.to_string()]),
        }
    }

    /// The agent of the episode of `seed`, for an environment of this process.
    pub(crate) fn agent(&self, spec: &TaskSpec, seed: u64) -> Agent {
        let [action, observation, achieved, desired] =
            [spec.action_dim(), spec.observation_dim(), spec.goal_dim(), spec.goal_dim()]
                .map(|dim| vec![0.0; dim]);
        Agent { player: self.player(seed), action, observation, achieved, desired }
    }

    /// The agent of the episode of `seed`.
    pub(crate) fn player(&self, seed: u64) -> Player {
        match self {
            Self::Policy(policy) => Player::Actor(Box::new(policy.actor(seed))),
            Self::Network(network) => Player::Network(network.clone()),
        }
    }

    /// Whether the expert's actions are needed.
    pub(crate) fn asks_expert(&self) -> bool {
        matches!(self, Self::Policy(policy) if policy.asks_expert())
    }
}

/// What is wrong with the file of a policy.
fn unfit(error: &trocar_network::Error) -> anyhow::Error {
    Exit::Usage(format!("--policy {error}")).into()
}

impl std::fmt::Display for Chooser {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Policy(policy) => policy.fmt(f),
            Self::Network(network) => network.path().display().fmt(f),
        }
    }
}

/// What acts in one episode of a rollout.
pub(crate) enum Player {
    Actor(Box<Actor>),
    Network(Network),
}

impl Player {
    /// Writes the next action. `seen` is what is seen now; `expert` writes what the expert would do.
    pub(crate) fn act(
        &mut self,
        seen: &Seen<'_>,
        action: &mut [f32],
        expert: impl FnOnce(&mut [f32]),
    ) -> anyhow::Result<()> {
        match self {
            Self::Actor(actor) => actor.act(action, expert),
            Self::Network(network) => network.act(seen, action)?,
        }
        Ok(())
    }
}

/// An agent in one environment of this process: it sees an observation and chooses an action.
pub(crate) struct Agent {
    player: Player,
    action: Vec<f32>,
    observation: Vec<f32>,
    achieved: Vec<f32>,
    desired: Vec<f32>,
}

impl Agent {
    /// The next action, (action dim).
    pub(crate) fn act(&mut self, env: &Env) -> anyhow::Result<&[f32]> {
        let Self { player, action, observation, achieved, desired } = self;
        env.observe(observation, achieved, desired);
        let seen = Seen { observation, achieved, desired };
        player.act(&seen, action, |action| env.expert(action))?;
        Ok(action)
    }
}
