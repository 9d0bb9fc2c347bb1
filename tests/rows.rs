//! What one environment showed after one message, as bits; and actions that a seed decides.

use rand::{RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;
use trocar_client::{Autoreset, Reply};

/// One environment's part of a reply. Floats are bits: what is equal here is the same.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Row {
    pub(crate) observation: Vec<u32>,
    pub(crate) achieved: Vec<u32>,
    pub(crate) desired: Vec<u32>,
    pub(crate) reward: u32,
    pub(crate) terminated: bool,
    pub(crate) truncated: bool,
    pub(crate) is_success: bool,
    pub(crate) tip_path: u32,
    pub(crate) peak_force: u32,
    pub(crate) steps: u32,
    pub(crate) seed: u64,
    pub(crate) episode: u64,
    /// What the scripted expert would do.
    pub(crate) expert: Vec<u32>,
    /// What it is about.
    pub(crate) stage: u8,
    /// Observation and goals of the episode that a same-step autoreset replaced.
    pub(crate) last: Option<[Vec<u32>; 3]>,
}

impl Row {
    /// Every row of a reply to a session that wants the expert.
    pub(crate) fn all(reply: &Reply, autoreset: Autoreset) -> Vec<Self> {
        (0..reply.rows()).map(|row| Self::of(reply, row, autoreset)).collect()
    }

    fn of(reply: &Reply, row: usize, autoreset: Autoreset) -> Self {
        let spec = reply.spec();
        let (goal, seen) = (spec.goal_dim(), spec.observation_dim());
        let part = |all: &[f32], dim: usize| bits(&all[row * dim..(row + 1) * dim]);
        let (terminated, truncated) = (reply.terminated()[row] == 1, reply.truncated()[row] == 1);
        let ended = autoreset == Autoreset::SameStep && (terminated || truncated);
        Self {
            observation: part(reply.observation(), seen),
            achieved: part(reply.achieved_goal(), goal),
            desired: part(reply.desired_goal(), goal),
            reward: reply.reward()[row].to_bits(),
            terminated,
            truncated,
            is_success: reply.is_success()[row] == 1,
            tip_path: reply.tip_path()[row].to_bits(),
            peak_force: reply.peak_force()[row].to_bits(),
            steps: reply.steps()[row],
            seed: reply.seed()[row],
            episode: reply.episode()[row],
            expert: part(reply.expert_action(), spec.action_dim()),
            stage: reply.expert_stage()[row],
            last: ended.then(|| {
                [
                    part(reply.final_observation(), seen),
                    part(reply.final_achieved_goal(), goal),
                    part(reply.final_desired_goal(), goal),
                ]
            }),
        }
    }
}

/// Floats as bits.
pub(crate) fn bits(numbers: &[f32]) -> Vec<u32> {
    numbers.iter().map(|number| number.to_bits()).collect()
}

/// Actions of one environment, which depend on nothing but its seed and what it showed: half of
/// the time the expert's, else random ones, a few of them out of range.
#[derive(Debug, Clone)]
pub(crate) struct Policy(ChaCha8Rng);

impl Policy {
    pub(crate) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// The next action after `row`.
    pub(crate) fn act(&mut self, row: &Row) -> Vec<f32> {
        let follow = self.0.next_u32().is_multiple_of(2);
        let pick = |expert: &u32| {
            let random = self.0.next_u32() as f32 / u32::MAX as f32 * 2.4 - 1.2;
            if follow { f32::from_bits(*expert) } else { random }
        };
        row.expert.iter().map(pick).collect()
    }
}

/// The actions of several environments, row by row.
pub(crate) fn act(policies: &mut [Policy], rows: &[Row]) -> Vec<f32> {
    policies.iter_mut().zip(rows).flat_map(|(policy, row)| policy.act(row)).collect()
}

/// Policies for the seeds from `seed` on.
pub(crate) fn policies(seed: u64, count: usize) -> Vec<Policy> {
    (0..count as u64).map(|index| Policy::new(seed + index)).collect()
}

/// A number that stands for every bit of a trajectory (FNV-1a, 64 bits).
#[derive(Debug)]
pub(crate) struct Digest(u64);

impl Default for Digest {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Digest {
    /// Steps after the reset: past the end of an episode.
    pub(crate) const STEPS: usize = 60;

    pub(crate) fn add(&mut self, rows: &[Row]) {
        for byte in format!("{rows:?}").bytes() {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }

    pub(crate) fn text(&self) -> String {
        format!("{:016x}", self.0)
    }
}
