//! Saved states of environments.

use std::sync::{Arc, Mutex, PoisonError};

use trocar_proto::control::SessionInfo;
use trocar_proto::{Code, Rejection};

/// The states of some environments of a session, in the order in which they were named. They stay
/// in the server until the last clone of this is dropped or the session ends.
#[derive(Debug, Clone)]
pub struct Snapshot {
    session: u64,
    epoch: u64,
    states: Vec<Arc<State>>,
}

/// One state in the server.
#[derive(Debug)]
struct State {
    number: u64,
    dropped: Dropped,
}

impl Drop for State {
    fn drop(&mut self) {
        self.dropped.0.lock().unwrap_or_else(PoisonError::into_inner).push(self.number);
    }
}

/// Numbers of states that the client has dropped, for the session to tell the server.
#[derive(Debug, Clone, Default)]
pub(crate) struct Dropped(Arc<Mutex<Vec<u64>>>);

impl Dropped {
    pub(crate) fn take(&self) -> Vec<u64> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Snapshot {
    pub(crate) fn new(info: &SessionInfo, numbers: &[u64], dropped: &Dropped) -> Self {
        let state = |number: &u64| Arc::new(State { number: *number, dropped: dropped.clone() });
        Self {
            session: info.session,
            epoch: info.epoch,
            states: numbers.iter().map(state).collect(),
        }
    }

    /// Number of states.
    #[allow(clippy::len_without_is_empty, reason = "none is empty")]
    pub fn len(&self) -> usize {
        self.states.len()
    }

    /// The states `indices` of this snapshot, in that order; they may repeat.
    ///
    /// # Panics
    /// Where an index is not below [`Self::len`].
    #[must_use]
    pub fn select(&self, indices: &[usize]) -> Self {
        let states = indices.iter().map(|index| Arc::clone(&self.states[*index])).collect();
        Self { states, ..*self }
    }

    /// Adds the states of another snapshot of the same session.
    pub(crate) fn push(&mut self, other: &Self) {
        self.states.extend_from_slice(&other.states);
    }

    /// The numbers from which `rows` environments of the session `info` go on.
    pub(crate) fn numbers_for(
        &self,
        info: &SessionInfo,
        rows: usize,
    ) -> Result<Vec<u64>, Rejection> {
        if (self.session, self.epoch) != (info.session, info.epoch) {
            return Err(Rejection::new(
                Code::UnknownSnapshot,
                "snapshot",
                format!("of session {}", self.session),
                format!(
                    "allowed are those of session {}; export it and import it here",
                    info.session
                ),
            ));
        }
        let numbers = self.states.iter().map(|state| state.number);
        match self.len() {
            1 => Ok(numbers.cycle().take(rows).collect()),
            count if count == rows => Ok(numbers.collect()),
            count => Err(Rejection::new(
                Code::InvalidEnvIds,
                "env_ids",
                format!("{rows} environments"),
                format!(
                    "a snapshot of {count} goes into {count}; one of a single environment into any number"
                ),
            )),
        }
    }
}
