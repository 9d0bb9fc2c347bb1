//! What drives an arm of a live world.

use trocar_proto::{Code, Rejection};

/// What drives an arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Driver {
    /// A session, of this process; whether a page may take its arms over.
    Session { session: u64, pid: u32, is_supervised: bool },
    /// A page of the viewer.
    Page(u64),
}

impl Driver {
    /// Its process; of a page, the server.
    pub(super) fn pid(self) -> u32 {
        match self {
            Self::Session { pid, .. } => pid,
            Self::Page(_) => std::process::id(),
        }
    }

    /// Whether it takes over what another drives.
    pub(super) fn takes_over(self, other: Self) -> bool {
        matches!((self, other), (Self::Page(_), Self::Session { is_supervised: true, .. }))
    }

    /// The refusal of what another session asks of its arm.
    pub(super) fn refusal(&self, arm: &str) -> Rejection {
        let allowed = match self {
            Self::Session { session, pid, .. } => format!(
                "process {pid} drives it, in session {session}; it is free once that session ends"
            ),
            Self::Page(_) => {
                "a page of the viewer drives it; it is free once that page lets go of it".into()
            }
        };
        Rejection::new(Code::ArmIsDriven, "arm", arm, allowed)
    }
}
