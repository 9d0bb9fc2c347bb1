//! Who acts.

use clap::ValueEnum;
use serde::Serialize;
use trocar_server::sim::random::Rng;

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
