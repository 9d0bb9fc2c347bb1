//! Plays an episode and says what it looks like: the bits of the world, of what is observed and earned, and
//! of pictures.

use trocar_proto::Rejection;
use trocar_server::Registry;
use trocar_server::env::{Env, Pictures};

use super::format::{Episode, Mark};

/// The hash FNV-1a of 64 bits: its values are the same in every release and on every machine.
#[derive(Clone, Copy)]
struct Fnv(u64);

impl Fnv {
    fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    fn add(&mut self, bytes: impl IntoIterator<Item = u8>) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }

    fn of(words: impl IntoIterator<Item = u32>) -> u64 {
        let mut hash = Self::new();
        hash.add(words.into_iter().flat_map(u32::to_le_bytes));
        hash.0
    }
}

/// An environment in an episode, and what its steps returned.
pub(crate) struct Player {
    env: Env,
    /// Actions taken, whether or not the environment took them.
    taken: u16,
    /// Of everything that the steps returned until now.
    outcome: Fnv,
    has_succeeded: bool,
}

impl Player {
    /// At the beginning of `episode`.
    pub(crate) fn new(episode: &Episode) -> Result<Self, Rejection> {
        let mut env = Registry::builtin().make(&episode.task, &episode.options)?;
        env.reset(Some(episode.seed));
        for _ in 0..episode.number {
            env.reset(None);
        }
        Ok(Self { env, taken: 0, outcome: Fnv::new(), has_succeeded: false })
    }

    pub(crate) fn env(&self) -> &Env {
        &self.env
    }

    /// Whether the goal was reached after any step.
    pub(crate) fn has_succeeded(&self) -> bool {
        self.has_succeeded
    }

    pub(crate) fn step(&mut self, action: &[f32]) {
        self.taken += 1;
        match self.env.step(action) {
            Ok(step) => {
                self.outcome.add(step.reward.to_bits().to_le_bytes());
                self.outcome.add([step.terminated, step.truncated, step.is_success].map(u8::from));
                self.has_succeeded |= step.is_success;
            }
            Err(_) => self.outcome.add([u8::MAX]),
        }
    }

    /// What it looks like now.
    pub(crate) fn mark(&self) -> Mark {
        let env = &self.env;
        let spec = env.spec();
        let mut observation = vec![0.0; spec.observation_dim()];
        let [mut achieved, mut desired] = [(); 2].map(|()| vec![0.0; spec.goal_dim()]);
        env.observe(&mut observation, &mut achieved, &mut desired);
        let mut outcome = self.outcome;
        outcome.add(env.steps().to_le_bytes());
        outcome.add([u8::from(env.needs_reset())]);
        let bits = |numbers: &[f32]| Fnv::of(numbers.iter().map(|number| number.to_bits()));
        let mut hashes = vec![
            Fnv::of(env.world().bits()),
            bits(&observation),
            bits(&[achieved, desired].concat()),
            outcome.0,
        ];
        if spec.images.is_some() {
            let pictures = Pictures::of(env);
            let mut rgb = Fnv::new();
            rgb.add(pictures.rgb);
            let mask = Fnv::of(pictures.mask.iter().map(|body| body.cast_unsigned()));
            hashes.extend([rgb.0, bits(&pictures.depth), mask, bits(&pictures.points)]);
        }
        Mark { step: self.taken, hashes }
    }
}
