//! The reply to a request of a session, and which environments a request is about.

use std::sync::Arc;

use trocar_proto::TaskSpec;
use trocar_proto::control::SessionInfo;
use trocar_proto::wire::{PictureLayout, ReplyLayout};

use crate::snapshot::Snapshot;
use crate::transport::{Link, Owned, RawReply};

/// The reply to a reset, step, restore or fork: arrays in shared memory, valid until this is dropped.
/// Row r belongs to environment `env_id(r)`.
#[derive(Debug)]
pub struct Reply {
    pub(crate) raw: Owned<RawReply>,
    pub(crate) taken: Option<Snapshot>,
    pub(crate) env_ids: EnvIds,
    pub(crate) info: Arc<SessionInfo>,
    pub(crate) layout: Arc<ReplyLayout>,
    /// Of a picture that was asked for; there is nothing else then.
    pub(crate) picture: Option<Arc<PictureLayout>>,
    /// Dropped last: as long as shared memory is used, nobody may remove it.
    pub(crate) _link: Arc<Owned<Link>>,
}

impl Reply {
    /// The snapshot that was taken, where one was asked for.
    pub fn into_snapshot(self) -> Option<Snapshot> {
        self.taken
    }

    /// Number of rows; none in the reply to [`Session::render`](crate::Session::render).
    pub fn rows(&self) -> usize {
        if self.picture.is_some() { 0 } else { self.env_ids.len() }
    }

    /// Red, green, blue of the picture that was asked for: u8 (views, height, width, 3).
    pub fn picture_rgb(&self) -> &[u8] {
        self.picture.as_ref().map_or(&[], |layout| layout.rgb.view(self.raw.payload(), 1))
    }

    /// Depth of the picture that was asked for, along the optical axis, m: f32 (views, height, width).
    pub fn picture_depth(&self) -> &[f32] {
        self.picture.as_ref().map_or(&[], |layout| layout.depth.view(self.raw.payload(), 1))
    }

    /// The environment of row `row`.
    pub fn env_id(&self, row: usize) -> u32 {
        match &self.env_ids {
            EnvIds::All(_) => row as u32,
            EnvIds::Some(ids) => ids[row],
        }
    }

    /// The task's specification, which says what each element means.
    pub fn spec(&self) -> &TaskSpec {
        &self.info.spec
    }

    /// State after the transition, or after the autoreset: (rows, observation dim).
    pub fn observation(&self) -> &[f32] {
        self.layout.observation.view(self.raw.payload(), self.rows())
    }

    /// Achieved goal of that state: (rows, goal dim).
    pub fn achieved_goal(&self) -> &[f32] {
        self.layout.achieved_goal.view(self.raw.payload(), self.rows())
    }

    /// Desired goal of that state: (rows, goal dim).
    pub fn desired_goal(&self) -> &[f32] {
        self.layout.desired_goal.view(self.raw.payload(), self.rows())
    }

    /// Reward of the transition: (rows); 0 for a reset.
    pub fn reward(&self) -> &[f32] {
        self.layout.reward.view(self.raw.payload(), self.rows())
    }

    /// 1 where the episode ended in a terminal state: (rows).
    pub fn terminated(&self) -> &[u8] {
        self.layout.terminated.view(self.raw.payload(), self.rows())
    }

    /// 1 where the episode ended at its time limit, or because its simulation failed: (rows).
    pub fn truncated(&self) -> &[u8] {
        self.layout.truncated.view(self.raw.payload(), self.rows())
    }

    /// 1 where the transition ended in success, before any autoreset: (rows).
    pub fn is_success(&self) -> &[u8] {
        self.layout.is_success.view(self.raw.payload(), self.rows())
    }

    /// A [`Code`](trocar_proto::Code) where the environment's simulation failed, else 0: (rows).
    pub fn fault(&self) -> &[u8] {
        self.layout.fault.view(self.raw.payload(), self.rows())
    }

    /// Steps since the episode began: (rows); 0 after a reset or autoreset.
    pub fn steps(&self) -> &[u32] {
        self.layout.steps.view(self.raw.payload(), self.rows())
    }

    /// Seed of the episode: (rows).
    pub fn seed(&self) -> &[u64] {
        self.layout.seed.view(self.raw.payload(), self.rows())
    }

    /// Number of the episode under its seed: (rows).
    pub fn episode(&self) -> &[u64] {
        self.layout.episode.view(self.raw.payload(), self.rows())
    }

    /// Last observation of an episode that a same-step autoreset replaced: (rows, observation
    /// dim); meaningful where terminated or truncated.
    pub fn final_observation(&self) -> &[f32] {
        self.layout.final_observation.view(self.raw.payload(), self.rows())
    }

    /// Its achieved goal: (rows, goal dim).
    pub fn final_achieved_goal(&self) -> &[f32] {
        self.layout.final_achieved_goal.view(self.raw.payload(), self.rows())
    }

    /// Its desired goal: (rows, goal dim).
    pub fn final_desired_goal(&self) -> &[f32] {
        self.layout.final_desired_goal.view(self.raw.payload(), self.rows())
    }

    /// The scripted expert's action for the returned state: (rows, action dim); zeros unless
    /// [`Session::want_expert`] was set.
    pub fn expert_action(&self) -> &[f32] {
        self.layout.expert_action.view(self.raw.payload(), self.rows())
    }

    /// Red, green, blue of every pixel, a row for each environment: u8 (rows, views, height, width, 3); empty
    /// where they are not asked for.
    pub fn rgb(&self) -> &[u8] {
        self.layout.rgb.view(self.raw.payload(), self.rows())
    }

    /// As [`Self::rgb`], of episodes that a same-step autoreset replaced; unspecified elsewhere.
    pub fn final_rgb(&self) -> &[u8] {
        self.layout.final_rgb.view(self.raw.payload(), self.rows())
    }

    /// Depth of every pixel along the optical axis, m: f32 (rows, views, height, width); empty where it is not
    /// asked for.
    pub fn depth(&self) -> &[f32] {
        self.layout.depth.view(self.raw.payload(), self.rows())
    }

    /// As [`Self::depth`], of episodes that a same-step autoreset replaced; unspecified elsewhere.
    pub fn final_depth(&self) -> &[f32] {
        self.layout.final_depth.view(self.raw.payload(), self.rows())
    }

    /// The number of the body that every pixel shows, 0 for none: i32 (rows, views, height, width); empty
    /// where they are not asked for.
    pub fn mask(&self) -> &[i32] {
        self.layout.mask.view(self.raw.payload(), self.rows())
    }

    /// As [`Self::mask`], of episodes that a same-step autoreset replaced; unspecified elsewhere.
    pub fn final_mask(&self) -> &[i32] {
        self.layout.final_mask.view(self.raw.payload(), self.rows())
    }

    /// Where every pixel's surface is in the axes of the camera, m: f32 (rows, views, height · width, 3); empty
    /// where they are not asked for.
    pub fn points(&self) -> &[f32] {
        self.layout.points.view(self.raw.payload(), self.rows())
    }

    /// As [`Self::points`], of episodes that a same-step autoreset replaced; unspecified elsewhere.
    pub fn final_points(&self) -> &[f32] {
        self.layout.final_points.view(self.raw.payload(), self.rows())
    }

    /// The [`trocar_proto::Stage`] that the expert is in there, by number (rows); zeros unless
    /// [`Session::want_expert`] was set.
    pub fn expert_stage(&self) -> &[u8] {
        self.layout.expert_stage.view(self.raw.payload(), self.rows())
    }
}

/// Which environments a request is about.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum EnvIds {
    All(u32),
    Some(Arc<[u32]>),
}

impl EnvIds {
    pub(crate) fn len(&self) -> usize {
        match self {
            Self::All(count) => *count as usize,
            Self::Some(ids) => ids.len(),
        }
    }

    /// These and others.
    pub(crate) fn and(&self, others: &[u32]) -> Self {
        match self {
            Self::All(count) => Self::All(*count),
            Self::Some(ids) => {
                let mut both = [ids, others].concat();
                both.sort_unstable();
                both.dedup();
                Self::Some(both.into())
            }
        }
    }

    /// An environment that both have.
    pub(crate) fn common(&self, other: &Self) -> Option<u32> {
        match (self, other) {
            (Self::All(_), Self::All(_)) => Some(0),
            (Self::All(_), Self::Some(ids)) | (Self::Some(ids), Self::All(_)) => {
                ids.first().copied()
            }
            // Increasing numbers: found by halving.
            (Self::Some(ids), Self::Some(others)) => {
                ids.iter().copied().find(|id| others.binary_search(id).is_ok())
            }
        }
    }
}
