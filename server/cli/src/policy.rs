//! Who acts.

use std::path::Path;

use clap::ValueEnum;
use serde::Serialize;
use trocar_server::sim::random::Rng;

use crate::exit::Exit;
use crate::network::{Network, Seen};

/// Who chooses the actions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Policy {
    /// The task's scripted expert
    Oracle,
    /// Uniformly random in [−1, 1], by the episode's seed
    Random,
}

impl Policy {
    /// The one who acts in the episode of `seed`.
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

/// Who acts in one episode: random numbers, or the expert where there are none.
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

/// Who chooses the actions of a rollout.
#[derive(Clone)]
pub(crate) enum Chooser {
    /// The expert, or random numbers.
    Policy(Policy),
    /// A policy from a file.
    Network(Network),
}

impl Chooser {
    /// Reads `oracle`, `random`, or the name of an ONNX file.
    pub(crate) fn read(text: &str) -> anyhow::Result<Self> {
        if let Ok(policy) = Policy::from_str(text, false) {
            return Ok(Self::Policy(policy));
        }
        let path = Path::new(text);
        if path.extension().is_some_and(|extension| extension == "onnx") {
            return Ok(Self::Network(Network::load(path)?));
        }
        let allowed = "allowed are oracle, random, or the name of a file that ends in .onnx";
        Err(Exit::Usage(format!("--policy {text}: {allowed}")).into())
    }

    /// The same, for another thread.
    pub(crate) fn twin(&self) -> Self {
        match self {
            Self::Policy(policy) => Self::Policy(*policy),
            Self::Network(network) => Self::Network(network.twin()),
        }
    }

    /// The one who acts in the episode of `seed`.
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

impl std::fmt::Display for Chooser {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Policy(policy) => policy.fmt(f),
            Self::Network(network) => network.path().display().fmt(f),
        }
    }
}

/// Who acts in one episode of a rollout.
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
