//! Refusals: why a server (or a client, before it sends) does not do what was asked.

use serde::{Deserialize, Serialize};

/// What kind of refusal it is; the number is the wire format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[repr(u32)]
pub enum Code {
    /// No task of that name is registered.
    UnknownTask = 1,
    /// The task has no option of that name.
    UnknownOption = 2,
    /// The option's value is not allowed.
    InvalidOption = 3,
    /// The number of environments is zero or above the server's limit.
    InvalidEnvCount = 4,
    /// The session would not fit into the server's memory budget.
    MemoryBudget = 5,
    /// Client and server speak different protocol versions.
    VersionMismatch = 6,
    /// The session belongs to an earlier run of the server.
    StaleSession = 7,
    /// No such session, or it was closed.
    UnknownSession = 8,
    /// The message could not be decoded.
    Malformed = 9,
    /// The server takes no more sessions.
    TooManySessions = 10,
    /// The server is shutting down.
    ShuttingDown = 11,
    /// An environment was stepped before its first reset, or after its episode ended.
    ResetNeeded = 12,
    /// An action is not finite or has the wrong shape.
    InvalidAction = 13,
    /// The environment indices are out of range, repeated or busy.
    InvalidEnvIds = 14,
    /// The server knows the request but does not offer it.
    Unsupported = 15,
    /// The simulation of one environment failed; its session goes on.
    Simulation = 16,
    /// A fault of the server's own.
    Internal = 17,
    /// The session has no such snapshot.
    UnknownSnapshot = 18,
    /// The bytes are no snapshot, or none of this task and these options.
    InvalidSnapshot = 19,
    /// A live world has no such arm.
    UnknownArm = 20,
    /// A command to an arm is malformed.
    InvalidCommand = 21,
    /// Another client drives the arm.
    ArmIsDriven = 22,
}

impl Code {
    /// The code of a number on the wire.
    pub fn from_u32(number: u32) -> Option<Self> {
        use Code::{
            ArmIsDriven, Internal, InvalidAction, InvalidCommand, InvalidEnvCount, InvalidEnvIds,
            InvalidOption, InvalidSnapshot, Malformed, MemoryBudget, ResetNeeded, ShuttingDown,
            Simulation, StaleSession, TooManySessions, UnknownArm, UnknownOption, UnknownSession,
            UnknownSnapshot, UnknownTask, Unsupported, VersionMismatch,
        };
        [
            UnknownTask,
            UnknownOption,
            InvalidOption,
            InvalidEnvCount,
            MemoryBudget,
            VersionMismatch,
            StaleSession,
            UnknownSession,
            Malformed,
            TooManySessions,
            ShuttingDown,
            ResetNeeded,
            InvalidAction,
            InvalidEnvIds,
            Unsupported,
            Simulation,
            Internal,
            UnknownSnapshot,
            InvalidSnapshot,
            UnknownArm,
            InvalidCommand,
            ArmIsDriven,
        ]
        .into_iter()
        .find(|code| *code as u32 == number)
    }
}

/// A refusal that names the field, the value it had and what is allowed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{field} = {value}: {allowed}")]
pub struct Rejection {
    /// The kind of refusal.
    pub code: Code,
    /// Which field of the request was refused, e.g. `options.reward`.
    pub field: String,
    /// The value that it had.
    pub value: String,
    /// What would have been accepted, or what went wrong.
    pub allowed: String,
}

impl Rejection {
    /// The longest text that any part of a refusal keeps, in characters: a refusal quotes what a
    /// client sent, and must fit into a reply whatever that was.
    pub const MAX_TEXT: usize = 800;

    /// A refusal of `field`, which was `value`, where `allowed` was expected.
    pub fn new(
        code: Code,
        field: impl Into<String>,
        value: impl std::fmt::Display,
        allowed: impl Into<String>,
    ) -> Self {
        let shorten = |text: String| match text.char_indices().nth(Self::MAX_TEXT) {
            Some((end, _)) => format!("{}…", &text[..end]),
            None => text,
        };
        Self {
            code,
            field: shorten(field.into()),
            value: shorten(value.to_string()),
            allowed: shorten(allowed.into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_survives_the_wire() {
        for number in 1..=22 {
            assert_eq!(Code::from_u32(number).map(|code| code as u32), Some(number));
        }
        assert_eq!(Code::from_u32(0), None);
        assert_eq!(Code::from_u32(23), None);
    }

    #[test]
    fn a_refusal_quotes_at_most_a_few_lines() {
        let refusal = Rejection::new(Code::UnknownTask, "task", "é".repeat(100_000), "a task");
        assert!(refusal.value.chars().count() <= Rejection::MAX_TEXT + 1);
    }
}
