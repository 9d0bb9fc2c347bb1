//! What was seen, and what could have been meant by it: hindsight replay.

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use trocar_client::Reply;
use trocar_proto::TaskSpec;

/// Share of transitions that are given a goal in hindsight ("future", k = 4). Source: Andrychowicz et al.,
/// Hindsight Experience Replay, `NeurIPS` 2017.
const HINDSIGHT: f64 = 0.8;

/// Episodes of several environments, side by side.
pub(crate) struct Episodes {
    envs: usize,
    desired: Vec<f32>,
    /// From the first state to the last; (steps + 1, envs, dim).
    observations: Vec<f32>,
    achieved: Vec<f32>,
    /// (steps, envs, dim).
    actions: Vec<f32>,
}

impl Episodes {
    /// Those that begin with this reply.
    pub(crate) fn begin(reply: &Reply) -> Self {
        Self {
            envs: reply.rows(),
            desired: reply.desired_goal().to_vec(),
            observations: reply.observation().to_vec(),
            achieved: reply.achieved_goal().to_vec(),
            actions: vec![],
        }
    }

    /// Adds a step: what was done, and where that led.
    pub(crate) fn add(&mut self, actions: &[f32], observations: &[f32], achieved: &[f32]) {
        self.actions.extend_from_slice(actions);
        self.observations.extend_from_slice(observations);
        self.achieved.extend_from_slice(achieved);
    }
}

/// Transitions to learn from, each array (rows, dim).
pub(crate) struct Batch {
    pub(crate) observations: Vec<f32>,
    pub(crate) next_observations: Vec<f32>,
    pub(crate) goals: Vec<f32>,
    pub(crate) actions: Vec<f32>,
    pub(crate) rewards: Vec<f32>,
}

/// All episodes so far.
pub(crate) struct Replay {
    spec: TaskSpec,
    kept: Vec<Episodes>,
}

impl Replay {
    pub(crate) fn new(spec: TaskSpec) -> Self {
        Self { spec, kept: vec![] }
    }

    pub(crate) fn keep(&mut self, episodes: Episodes) {
        self.kept.push(episodes);
    }

    /// Observations and goals of the episodes kept last: what inputs are like.
    pub(crate) fn newest(&self) -> (&[f32], [&[f32]; 2]) {
        self.kept.last().map_or((&[], [&[]; 2]), |newest| {
            (&newest.observations, [&newest.achieved, &newest.desired])
        })
    }

    /// Transitions drawn from all alike, most of them with a goal that was achieved later in their episode.
    pub(crate) fn sample(&self, rows: usize, rng: &mut ChaCha8Rng) -> Batch {
        let mut batch = Batch {
            observations: vec![],
            next_observations: vec![],
            goals: vec![],
            actions: vec![],
            rewards: vec![],
        };
        let success = &self.spec.goal.as_ref().expect("the task has goals").success;
        for _ in 0..rows {
            let episodes = &self.kept[rng.random_range(0..self.kept.len())];
            let env = rng.random_range(0..episodes.envs);
            let of = |values: &[f32], dim: usize, step: usize| -> Vec<f32> {
                values[(step * episodes.envs + env) * dim..][..dim].to_vec()
            };
            let (observation, goal, action) =
                (self.spec.observation_dim(), self.spec.goal_dim(), self.spec.action_dim());
            let steps = episodes.actions.len() / (episodes.envs * action);
            let step = rng.random_range(0..steps);
            let achieved = |step: usize| of(&episodes.achieved, goal, step);
            let meant = if rng.random_bool(HINDSIGHT) {
                achieved(rng.random_range(step + 1..=steps))
            } else {
                of(&episodes.desired, goal, 0)
            };
            batch.rewards.push(self.spec.reward.of(success, &achieved(step + 1), &meant));
            batch.observations.extend(of(&episodes.observations, observation, step));
            batch.next_observations.extend(of(&episodes.observations, observation, step + 1));
            batch.actions.extend(of(&episodes.actions, action, step));
            batch.goals.extend(meant);
        }
        batch
    }
}
