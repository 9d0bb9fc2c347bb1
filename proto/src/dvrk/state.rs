//! Operating states and what leads from one to another (CRTK, "robot operating state").

use std::fmt;

use super::command::StateCommand;

/// The state of an arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// Without power.
    Disabled,
    /// With power.
    Enabled,
    /// With power; it stays where it is.
    Paused,
    /// Without power, after something went wrong.
    Fault,
}

impl State {
    /// Its name in messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Disabled => "DISABLED",
            Self::Enabled => "ENABLED",
            Self::Paused => "PAUSED",
            Self::Fault => "FAULT",
        }
    }

    /// Whether a command means something in this state.
    pub fn takes(self, command: &StateCommand) -> bool {
        use StateCommand::{Disable, Enable, Home, Pause, Resume, Unhome};
        match self {
            Self::Disabled | Self::Fault => matches!(command, Enable | Disable | Unhome),
            Self::Enabled => matches!(command, Enable | Disable | Pause | Unhome | Home),
            Self::Paused => matches!(command, Disable | Pause | Resume | Unhome),
        }
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What `operating_state` tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OperatingState {
    /// The state.
    pub state: State,
    /// Whether the zeros of all joints are known.
    pub is_homed: bool,
    /// Whether a move or homing is under way.
    pub is_busy: bool,
}
