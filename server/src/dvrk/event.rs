//! What an arm says besides its state: events, with reasons in words.

use trocar_proto::dvrk::Report;
use trocar_proto::dvrk::command::Fault;

use super::mechanism::NoSolution;
use super::state::{OperatingState, State};

/// When something was, ns since the controller began; never 0.
///
/// A tick's readings have the same stamp. Events have later and strictly increasing ones, since clients ignore a
/// state whose stamp is not newer than the latest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Stamp(u64);

impl Stamp {
    /// That of a tick, counted from 1.
    pub(super) fn of_tick(tick: u64) -> Self {
        let rate = super::TICKS_PER_SECOND;
        // Whole seconds apart, so that no product overflows.
        Self(tick / rate * 1_000_000_000 + tick % rate * 1_000_000_000 / rate)
    }

    /// The next one after both.
    pub(super) fn after(self, other: Self) -> Self {
        Self(self.0.max(other.0) + 1)
    }

    /// ns since the controller began.
    pub fn nanoseconds(self) -> u64 {
        self.0
    }

    /// Seconds since the controller began.
    pub fn seconds(self) -> f64 {
        self.0 as f64 * 1e-9
    }
}

/// An event and when it was.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// When it was.
    pub stamp: Stamp,
    /// What it was.
    pub what: What,
}

/// What happened; each has a topic.
#[derive(Debug, Clone, PartialEq)]
pub enum What {
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
    /// A command was ignored, or not done as it says.
    Warning(Warning),
    /// A command was refused, or the arm faulted.
    Error(Error),
}

impl What {
    /// The topic that it goes to, below the arm's name.
    pub fn topic(&self) -> &'static str {
        self.report().topic()
    }

    /// The same as clients are told it, with reasons in words.
    pub fn report(&self) -> Report {
        match self {
            Self::OperatingState(state) => Report::OperatingState(*state),
            Self::GoalReached(is_reached) => Report::GoalReached(*is_reached),
            Self::Ratio(ratio) => Report::Ratio(*ratio),
            Self::RatioV(ratio) => Report::RatioV(*ratio),
            Self::RatioA(ratio) => Report::RatioA(*ratio),
            Self::ToolType(name) => Report::ToolType(name.clone()),
            Self::EndoscopeType(name) => Report::EndoscopeType(name.clone()),
            Self::Warning(why) => Report::Warning(why.to_string()),
            Self::Error(why) => Report::Error(why.to_string()),
        }
    }
}

/// Why an arm takes no motion command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NotReady {
    /// It is not enabled.
    #[error("it is {0}; send state_command \"enable\", then \"home\"")]
    State(State),
    /// It is enabled and was not homed since.
    #[error("it is not homed; send state_command \"home\"")]
    NotHomed,
    /// It has no tool.
    #[error("it has no tool; send emulate_tool_present true")]
    NoTool,
}

/// Why a command was ignored, or not done as it says.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Warning {
    /// The arm takes no motion commands. At most one every 2 s, as dVRK has it.
    #[error("{command}, arm not ready: {why} ({ignored} commands were ignored)")]
    NotReady {
        /// The topic of the command.
        command: &'static str,
        /// Why it takes none.
        why: NotReady,
        /// How many were ignored since the last warning, with this one.
        ignored: u32,
    },
    /// The instrument is in the cannula. At most one every 2 s.
    #[error("{command}: the tool needs to be inserted past the cannula for Cartesian commands")]
    NotInserted {
        /// The topic of the command.
        command: &'static str,
    },
    /// The state has no such command.
    #[error("state_command \"{command}\" does nothing while the arm is {state}")]
    StateCommand {
        /// Its word.
        command: String,
        /// The state.
        state: State,
    },
    /// There is no such word.
    #[error("\"{0}\" is no state_command: enable, disable, home, unhome, pause and resume are")]
    UnknownStateCommand(String),
    /// A ratio was out of its range.
    #[error("{command}: the ratio must be within ]0, 1], not {ratio}")]
    Ratio {
        /// The topic of the command.
        command: &'static str,
        /// The ratio.
        ratio: f64,
    },
    /// A command needs dynamics of joints. At most one every 2 s.
    #[error("{command} needs joint dynamics, which are not simulated: it does nothing")]
    NeedsDynamics {
        /// The topic of the command.
        command: &'static str,
    },
    /// The jaw was servoed, and stays. As dVRK 2.4's source reads, it would go back.
    #[error(
        "{command}: the jaw stays at {jaw:.3} rad; a real arm would move it back to {stale:.3} rad, the goal of \
         its last jaw/move_jp"
    )]
    JawStays {
        /// The topic of the command.
        command: &'static str,
        /// Where it stays, rad.
        jaw: f64,
        /// Where a real arm may bring it, rad.
        stale: f64,
    },
}

/// Why a command was refused, or the arm faulted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A vector has another number of elements than the arm has joints.
    #[error("{command}: {got} numbers, expected {expected}")]
    WrongCount {
        /// The topic of the command.
        command: &'static str,
        /// How many there were.
        got: usize,
        /// How many there should be.
        expected: usize,
    },
    /// A number is a NaN, infinite or absurdly large.
    #[error("{command}: number {index} is {value}, expected a position or velocity within ±1e6")]
    NotFinite {
        /// The topic of the command.
        command: &'static str,
        /// Which number, from 0.
        index: usize,
        /// What it is.
        value: f64,
    },
    /// A quaternion is not of length 1.
    #[error("{command}: the orientation is no unit quaternion")]
    NotARotation {
        /// The topic of the command.
        command: &'static str,
    },
    /// A pose is in a frame that the arm does not know.
    #[error("{command}: unknown frame \"{frame}\", the arm knows \"{reference}\" and \"{base}\"")]
    UnknownFrame {
        /// The topic of the command.
        command: &'static str,
        /// The frame.
        frame: String,
        /// The reference frame.
        reference: String,
        /// The remote centre.
        base: String,
    },
    /// No joints lead to a pose.
    #[error("{command}: unable to solve inverse kinematics ({why})")]
    InverseKinematics {
        /// The topic of the command.
        command: &'static str,
        /// Why not.
        why: NoSolution,
    },
    /// This arm has no such command.
    #[error("{command}: this arm has none")]
    NotOnThisArm {
        /// The topic of the command.
        command: &'static str,
    },
    /// A tool or an endoscope that is not simulated.
    #[error("{command}: \"{name}\" is not simulated, \"{known}\" is")]
    UnknownTool {
        /// The topic of the command.
        command: &'static str,
        /// Its name.
        name: String,
        /// The one that is.
        known: &'static str,
    },
    /// A client asked for a fault.
    #[error("emulated fault")]
    Emulated,
    /// There is no such fault.
    #[error(
        "emulate_fault: \"{word}\" is unknown, allowed are {}",
        Fault::ALL.map(|fault| fault.word().to_string()).join(", ")
    )]
    UnknownFault {
        /// The word that was given.
        word: String,
    },
    /// A joint is further from its set-point than it may be.
    #[error(
        "tracking error: {joint} is {by:.4} from its set-point, more than {tolerance} (rad or m)"
    )]
    Tracking {
        /// The joint.
        joint: &'static str,
        /// How far, rad or m.
        by: f64,
        /// How far it may be, rad or m.
        tolerance: f64,
    },
}
