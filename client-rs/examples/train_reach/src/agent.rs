//! DDPG for sparse rewards (Lillicrap et al., Continuous control with deep reinforcement learning, ICLR
//! 2016), with what `OpenAI` baselines' HER adds:
//!
//! - inputs relative to what was seen,
//! - targets within possible returns,
//! - a cost of large actions,
//! - target networks that move after every round of updates.

use anyhow::Result;
use candle_core::{Device, Tensor, Var};
use candle_nn::{AdamW, Linear, Module, Optimizer, ParamsAdamW, loss};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use trocar_proto::TaskSpec;

use crate::replay::{Batch, Replay};

/// Neurons of each hidden layer.
const HIDDEN: [usize; 2] = [128, 128];

const LEARNING_RATE: f64 = 1e-3;

/// 1 − 1 / steps of an episode.
const DISCOUNT: f64 = 0.98;

/// What target networks keep of themselves in a move.
const INERTIA: f64 = 0.95;

/// Cost of the mean square of actions.
const ACTION_COST: f64 = 1.0;

/// Exploration: standard deviation of the noise, and the part of actions that are uniformly random.
const NOISE: f32 = 0.2;
const RANDOM: f64 = 0.3;

/// Largest absolute value of an input, standard deviations; least standard deviation.
const CLIP: f32 = 5.0;
const LEAST_DEVIATION: f64 = 2e-3;

/// A network of layers with rectifiers between them.
struct Network {
    layers: Vec<Linear>,
    variables: Vec<Var>,
}

impl Network {
    fn new(sizes: &[usize], rng: &mut ChaCha8Rng) -> Result<Self> {
        let (mut layers, mut variables) = (vec![], vec![]);
        for ends in sizes.windows(2) {
            let bound = 1.0 / (ends[0] as f32).sqrt();
            let mut uniform = |count: usize| -> Vec<f32> {
                (0..count).map(|_| rng.random_range(-bound..bound)).collect()
            };
            let (weights, biases) = (uniform(ends[0] * ends[1]), uniform(ends[1]));
            let weights = Var::from_vec(weights, (ends[1], ends[0]), &Device::Cpu)?;
            let biases = Var::from_vec(biases, ends[1], &Device::Cpu)?;
            layers.push(Linear::new(weights.as_tensor().clone(), Some(biases.as_tensor().clone())));
            variables.extend([weights, biases]);
        }
        Ok(Self { layers, variables })
    }

    fn forward(&self, inputs: &Tensor) -> candle_core::Result<Tensor> {
        let mut values = self.layers[0].forward(inputs)?;
        for layer in &self.layers[1..] {
            values = layer.forward(&values.relu()?)?;
        }
        Ok(values)
    }

    fn optimizer(&self) -> Result<AdamW> {
        let parameters =
            ParamsAdamW { lr: LEARNING_RATE, weight_decay: 0.0, ..ParamsAdamW::default() };
        Ok(AdamW::new(self.variables.clone(), parameters)?)
    }

    /// Moves towards another network of the same form.
    fn follow(&self, leader: &Self, inertia: f64) -> Result<()> {
        for (own, other) in self.variables.iter().zip(&leader.variables) {
            let moved = ((own.as_tensor() * inertia)? + (other.as_tensor() * (1.0 - inertia))?)?;
            own.set(&moved)?;
        }
        Ok(())
    }
}

/// A policy and what it needs to learn.
pub(crate) struct Agent {
    observation_dim: usize,
    action_dim: usize,
    goal_dim: usize,
    actor: Network,
    critic: Network,
    target_actor: Network,
    target_critic: Network,
    actor_optimizer: AdamW,
    critic_optimizer: AdamW,
    inputs: Statistics,
}

impl Agent {
    pub(crate) fn new(spec: &TaskSpec, rng: &mut ChaCha8Rng) -> Result<Self> {
        let dims = [spec.observation_dim(), spec.goal_dim(), spec.action_dim()];
        let [observation_dim, goal_dim, action_dim] = dims;
        let [first, second] = HIDDEN;
        let actor = [observation_dim + goal_dim, first, second, action_dim];
        let critic = [observation_dim + goal_dim + action_dim, first, second, 1];
        let [actor, target_actor] = [Network::new(&actor, rng)?, Network::new(&actor, rng)?];
        let [critic, target_critic] = [Network::new(&critic, rng)?, Network::new(&critic, rng)?];
        target_actor.follow(&actor, 0.0)?;
        target_critic.follow(&critic, 0.0)?;
        let (actor_optimizer, critic_optimizer) = (actor.optimizer()?, critic.optimizer()?);
        let inputs = Statistics::new(observation_dim + goal_dim);
        Ok(Self {
            observation_dim,
            action_dim,
            goal_dim,
            actor,
            critic,
            target_actor,
            target_critic,
            actor_optimizer,
            critic_optimizer,
            inputs,
        })
    }

    /// Takes newly collected episodes into account in what inputs are relative to.
    pub(crate) fn see(&mut self, replay: &Replay) {
        let (observations, goals) = replay.newest();
        self.inputs.see(0, self.observation_dim, observations);
        for goals in goals {
            self.inputs.see(self.observation_dim, self.goal_dim, goals);
        }
    }

    /// The best actions, (rows, action dim).
    pub(crate) fn act(&self, observations: &[f32], goals: &[f32]) -> Result<Vec<f32>> {
        let inputs = self.features(observations, goals)?;
        Ok(self.actor.forward(&inputs)?.tanh()?.flatten_all()?.to_vec1()?)
    }

    /// Actions near the best ones, and random ones.
    pub(crate) fn explore(
        &self,
        observations: &[f32],
        goals: &[f32],
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<f32>> {
        let mut actions = self.act(observations, goals)?;
        for action in actions.chunks_exact_mut(self.action_dim) {
            let is_random = rng.random_bool(RANDOM);
            for value in action {
                let noise: f32 = rng.sample(StandardNormal);
                let near = (*value + NOISE * noise).clamp(-1.0, 1.0);
                *value = if is_random { rng.random_range(-1.0..=1.0) } else { near };
            }
        }
        Ok(actions)
    }

    /// Learns from a batch.
    pub(crate) fn update(&mut self, batch: &Batch) -> Result<()> {
        let rows = batch.rewards.len();
        let table =
            |values: &[f32]| Tensor::from_slice(values, (rows, values.len() / rows), &Device::Cpu);
        let (actions, rewards) = (table(&batch.actions)?, table(&batch.rewards)?);
        let inputs = self.features(&batch.observations, &batch.goals)?;
        let next = self.features(&batch.next_observations, &batch.goals)?;

        let next_actions = self.target_actor.forward(&next)?.tanh()?;
        let value = self.target_critic.forward(&Tensor::cat(&[&next, &next_actions], 1)?)?;
        let least = -1.0 / (1.0 - DISCOUNT);
        let target = (rewards + (value * DISCOUNT)?)?.clamp(least, 0.0)?.detach();
        let value = self.critic.forward(&Tensor::cat(&[&inputs, &actions], 1)?)?;
        self.critic_optimizer.backward_step(&loss::mse(&value, &target)?)?;

        let actions = self.actor.forward(&inputs)?.tanh()?;
        let value = self.critic.forward(&Tensor::cat(&[&inputs, &actions], 1)?)?;
        let cost = (actions.sqr()?.mean_all()? * ACTION_COST)?;
        self.actor_optimizer.backward_step(&(cost - value.mean_all()?)?)?;
        Ok(())
    }

    /// Moves the target networks towards the others.
    pub(crate) fn follow(&self) -> Result<()> {
        self.target_actor.follow(&self.actor, INERTIA)?;
        self.target_critic.follow(&self.critic, INERTIA)
    }

    fn features(&self, observations: &[f32], goals: &[f32]) -> Result<Tensor> {
        let rows = observations.len() / self.observation_dim;
        let pairs =
            observations.chunks_exact(self.observation_dim).zip(goals.chunks_exact(self.goal_dim));
        let values = pairs.flat_map(|(observation, goal)| observation.iter().chain(goal));
        let features = self.inputs.relative(values.copied());
        Ok(Tensor::from_vec(features, (rows, self.observation_dim + self.goal_dim), &Device::Cpu)?)
    }
}

/// Mean and standard deviation of every input.
struct Statistics {
    count: Vec<f64>,
    sum: Vec<f64>,
    squares: Vec<f64>,
}

impl Statistics {
    fn new(dim: usize) -> Self {
        Self { count: vec![0.0; dim], sum: vec![0.0; dim], squares: vec![0.0; dim] }
    }

    /// Takes rows of the inputs from `first` on into account.
    fn see(&mut self, first: usize, dim: usize, rows: &[f32]) {
        for row in rows.chunks_exact(dim) {
            for (index, value) in row.iter().enumerate() {
                self.count[first + index] += 1.0;
                self.sum[first + index] += f64::from(*value);
                self.squares[first + index] += f64::from(*value) * f64::from(*value);
            }
        }
    }

    /// Inputs less their mean, by their standard deviation; as they are where nothing was seen.
    fn relative(&self, values: impl Iterator<Item = f32>) -> Vec<f32> {
        let scales: Vec<_> = (0..self.count.len())
            .map(|index| {
                let count = self.count[index];
                if count == 0.0 {
                    return (0.0, 1.0);
                }
                let mean = self.sum[index] / count;
                let variance = self.squares[index] / count - mean * mean;
                (mean as f32, variance.max(0.0).sqrt().max(LEAST_DEVIATION) as f32)
            })
            .collect();
        let scaled = values.zip(scales.iter().cycle());
        scaled
            .map(|(value, (mean, deviation))| ((value - mean) / deviation).clamp(-CLIP, CLIP))
            .collect()
    }
}
