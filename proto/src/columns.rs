//! The columns of a reply, declared once.
//!
//! From the list in [`reply_columns!`](crate::reply_columns) follow the layout in shared memory, the rows that the
//! server writes, the client's getters, Python's arrays and infos, and what `trocar load` compares. A new column is a
//! line here and what the server writes into it.

use crate::spec::{ImageKind, TaskSpec};

/// A truth value: 0 is false.
pub type Flag = u8;

/// How many numbers a row of a column has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Width {
    /// One.
    One,
    /// As many as the state has.
    Observation,
    /// As many as a goal has.
    Goal,
    /// As many as an action has.
    Action,
    /// One, for tasks with soft bodies.
    Tissue,
    /// Three for each pixel that is asked for.
    Rgb,
    /// One for each pixel that is asked for.
    Depth,
    /// One for each pixel that is asked for.
    Mask,
    /// Three for each pixel that is asked for.
    Points,
}

impl Width {
    /// The number, for a task.
    pub fn of(self, spec: &TaskSpec) -> usize {
        let pixels = |kind: ImageKind| spec.pixels(kind) * kind.channels();
        match self {
            Self::One => 1,
            Self::Observation => spec.observation_dim(),
            Self::Goal => spec.goal_dim(),
            Self::Action => spec.action_dim(),
            Self::Tissue => usize::from(spec.has_tissue),
            Self::Rgb => pixels(ImageKind::Rgb),
            Self::Depth => pixels(ImageKind::Depth),
            Self::Mask => pixels(ImageKind::Mask),
            Self::Points => pixels(ImageKind::Points),
        }
    }
}

/// Calls the macro `$then` with all columns. Row r belongs to the r-th environment of the request.
///
/// Each is `name: element [width] {role key};`. The key is the one that it has in Gymnasium's infos, if it has one. The
/// role says what the column tells of:
///
/// | role | what | written from |
/// |---|---|---|
/// | `step` | what a step brought; zeros after a reset | the field of that name of the server's `Step` |
/// | `tissue` | the same, of tasks with soft bodies; others have no such info | the same |
/// | `fault` | whether the simulation failed in it | the error of the step |
/// | `episode` | which episode it is | the environment |
/// | `expert` | what the scripted expert would do; zeros unless it is wanted | the environment |
/// | none | the state, pictures, numbers | the environment |
#[macro_export]
macro_rules! reply_columns {
    ($then:ident) => {
        $then! {
            /// State after the transition, or after the autoreset: (rows, observation dim).
            observation: f32 [Observation] {};
            /// Achieved goal of that state: (rows, goal dim).
            achieved_goal: f32 [Goal] {};
            /// Desired goal of that state: (rows, goal dim).
            desired_goal: f32 [Goal] {};
            /// Reward of the transition: (rows); 0 for a reset.
            reward: f32 [One] {step};
            /// 1 where the episode ended in a terminal state: (rows).
            terminated: Flag [One] {step};
            /// 1 where the episode ended at its time limit, or because its simulation failed: (rows).
            truncated: Flag [One] {step};
            /// 1 where the transition ended in success, before any autoreset: (rows).
            is_success: Flag [One] {step is_success};
            /// Length of the paths of the tips in the step, m: (rows); of the jaws of all arms together, or of the endoscope.
            tip_path: f32 [One] {step tip_path};
            /// Largest force between a jaw and a body in the step, N: (rows); 0 where the jaws touched nothing.
            peak_force: f32 [One] {step peak_force};
            /// Largest pressure of a finger or wrist on tissue in the step, Pa: (rows); tasks with soft bodies only.
            tissue_pressure: f32 [Tissue] {tissue tissue_pressure};
            /// Share of the elements outside the jaws that are stretched beyond the ultimate strain of their material after
            /// the step: (rows); tasks with soft bodies only.
            overstretched: f32 [Tissue] {tissue overstretched};
            /// Share of the elements between the jaws that are compressed beyond it after the step: (rows); tasks with soft
            /// bodies only.
            crushed: f32 [Tissue] {tissue crushed};
            /// The `Code` of the failure where the environment's simulation failed, else 0: (rows).
            fault: Flag [One] {fault simulation_failed};
            /// Steps since the episode began: (rows); 0 after a reset or autoreset.
            steps: u32 [One] {};
            /// Seed of the episode: (rows).
            seed: u64 [One] {episode episode_seed};
            /// Number of the episode under its seed: (rows).
            episode: u64 [One] {episode episode_index};
            /// Last observation of an episode that a same-step autoreset replaced: (rows, observation dim);
            /// unspecified where neither terminated nor truncated.
            final_observation: f32 [Observation] {};
            /// Its achieved goal: (rows, goal dim).
            final_achieved_goal: f32 [Goal] {};
            /// Its desired goal: (rows, goal dim).
            final_desired_goal: f32 [Goal] {};
            /// The scripted expert's action for the returned state: (rows, action dim); zeros unless it is wanted.
            expert_action: f32 [Action] {expert expert_action};
            /// The `Stage` that the expert is in there, by number: (rows); zeros unless it is wanted.
            expert_stage: u8 [One] {expert expert_stage};
            /// Numbers of snapshots that were taken: (rows).
            snapshot: u64 [One] {};
            /// Red, green, blue of every pixel: (rows, views, height, width, 3); empty unless they are asked for.
            rgb: u8 [Rgb] {};
            /// Depth of every pixel along the optical axis, m: (rows, views, height, width); empty unless it is asked for.
            depth: f32 [Depth] {};
            /// The number of the body that every pixel shows, 0 for none: (rows, views, height, width); empty unless they
            /// are asked for.
            mask: i32 [Mask] {};
            /// Where every pixel's surface is in the axes of the camera, m: (rows, views, height · width, 3); empty unless
            /// they are asked for.
            points: f32 [Points] {};
            /// As `rgb`, of episodes that a same-step autoreset replaced; unspecified elsewhere.
            final_rgb: u8 [Rgb] {};
            /// As `depth`, of episodes that a same-step autoreset replaced; unspecified elsewhere.
            final_depth: f32 [Depth] {};
            /// As `mask`, of episodes that a same-step autoreset replaced; unspecified elsewhere.
            final_mask: i32 [Mask] {};
            /// As `points`, of episodes that a same-step autoreset replaced; unspecified elsewhere.
            final_points: f32 [Points] {};
        }
    };
}

/// What follows the role of a column where a step brings it, else nothing.
#[macro_export]
macro_rules! if_step {
    ({step $($key:ident)?} $($then:tt)*) => { $($then)* };
    ({tissue $key:ident} $($then:tt)*) => { $($then)* };
    ({$($role:tt)*} $($then:tt)*) => {};
}
