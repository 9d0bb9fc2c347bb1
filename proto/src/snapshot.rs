//! A snapshot as bytes: what led to the state of an environment, from which it is rebuilt.
//!
//! The same seed and actions give the same bits. So the seed of an episode, its number, the placement with
//! which it began and the actions since *are* the state. They take a few hundred bytes, and do not say how the
//! state is laid out in memory. Bytes from anywhere can then do no more harm than actions can. The process that
//! rebuilds a state compares its fingerprint with the one that was written down.
//!
//! Several environments are their [parts](part) one after another.

use serde::{Deserialize, Serialize};

use crate::error::Rejection;
use crate::part::{self, Kind};
use crate::placement::Placement;
use crate::spec::Options;

/// What led to the state of one environment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recipe {
    /// Release that wrote it.
    pub version: String,
    /// Task id.
    pub task: String,
    /// Every option of the task.
    pub options: Options,
    /// Seed of the episode.
    pub seed: u64,
    /// Number of the episode under that seed.
    pub episode: u64,
    /// How it was made to begin.
    pub placement: Placement,
    /// Actions since the episode began: (steps, action dim), row by row.
    pub actions: Vec<f32>,
    /// Stands for every bit of the state that must come of it.
    pub fingerprint: u64,
}

impl Recipe {
    /// The part of one environment.
    pub fn to_bytes(&self) -> Result<Vec<u8>, Rejection> {
        let what = || format!("{} numbers of actions and the options", self.actions.len());
        part::seal(Kind::Snapshot, self, what)
    }

    /// Reads what [`Self::to_bytes`] wrote; `bytes` may be anything.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        part::open(Kind::Snapshot, bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Code;
    use crate::part::split;

    fn recipe(steps: usize) -> Recipe {
        Recipe {
            version: "1.2.3".into(),
            task: "Test-v0".into(),
            options: Options::new().with_text("reward", "dense"),
            seed: u64::MAX,
            episode: 3,
            placement: Placement { goal: Some(vec![0.5; 3]), ..Placement::default() },
            actions: vec![0.25; 5 * steps],
            fingerprint: 7,
        }
    }

    #[test]
    fn recipes_survive_as_bytes_alone_and_one_after_another() {
        let recipes = [recipe(0), recipe(1), recipe(500)];
        let parts: Vec<_> = recipes.iter().map(|recipe| recipe.to_bytes().unwrap()).collect();
        for (part, recipe) in parts.iter().zip(&recipes) {
            assert_eq!(Recipe::from_bytes(part).unwrap(), *recipe);
        }
        assert_eq!(split(&parts.concat()).unwrap(), parts);
    }

    #[test]
    fn cut_extended_and_changed_bytes_are_refused_by_name() {
        let bytes = recipe(20).to_bytes().unwrap();
        for end in 0..bytes.len() {
            let refusal = Recipe::from_bytes(&bytes[..end]).unwrap_err();
            assert_eq!(refusal.code, Code::InvalidSnapshot, "{refusal}");
            assert!(split(&bytes[..end]).is_err());
        }
        let twice = [bytes.clone(), bytes.clone()].concat();
        assert_eq!(Recipe::from_bytes(&twice).unwrap_err().field, "snapshot.length");
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut changed = bytes.clone();
                changed[at] ^= 1 << bit;
                assert!(Recipe::from_bytes(&changed).is_err(), "bit {bit} of byte {at}");
            }
        }
        let mut old = bytes;
        old[8] ^= 0xff;
        assert_eq!(Recipe::from_bytes(&old).unwrap_err().code, Code::VersionMismatch);
    }

    #[test]
    fn what_does_not_fit_into_a_message_is_refused() {
        let refusal = recipe(10_000).to_bytes().unwrap_err();
        assert_eq!((refusal.code, refusal.field.as_str()), (Code::Unsupported, "snapshot"));
    }
}
