//! What arms tell their clients: events, with reasons in words.

use super::state::OperatingState;

/// What an arm told, and when.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// The arm, by its place in [`LiveInfo::arms`](super::LiveInfo::arms).
    pub arm: u32,
    /// When it was, ns since the world began. Those of an arm increase strictly.
    pub stamp: u64,
    /// What it was.
    pub report: Report,
}

/// What happened; each has a topic.
#[derive(Debug, Clone, PartialEq)]
pub enum Report {
    /// The operating state, after a command or a change.
    OperatingState(OperatingState),
    /// A move ended: at its goal, or before.
    GoalReached(bool),
    /// The ratio of velocities and accelerations of moves; 0 where they differ.
    Ratio(f64),
    /// The ratio of velocities.
    RatioV(f64),
    /// The ratio of accelerations.
    RatioA(f64),
    /// The tool that was put in.
    ToolType(String),
    /// The endoscope that was put in.
    EndoscopeType(String),
    /// Why a command was ignored, or not done as it says.
    Warning(String),
    /// Why a command was refused, or the arm faulted.
    Error(String),
}

impl Report {
    /// The topic that it goes to, below the arm's name.
    pub fn topic(&self) -> &'static str {
        match self {
            Self::OperatingState(_) => "operating_state",
            Self::GoalReached(_) => "goal_reached",
            Self::Ratio(_) => "trajectory_j/ratio",
            Self::RatioV(_) => "trajectory_j/ratio_v",
            Self::RatioA(_) => "trajectory_j/ratio_a",
            Self::ToolType(_) => "tool_type",
            Self::EndoscopeType(_) => "endoscope_type",
            Self::Warning(_) => "warning",
            Self::Error(_) => "error",
        }
    }
}
