//! Sessions that survive the loss of their server.

use std::time::{Duration, Instant};

use trocar_proto::Code;

use crate::client::Client;
use crate::error::{CallError, ReconnectError};
use crate::reply::Reply;
use crate::session::Session;

/// Where the environments of a session go on after [`Session::reconnect`]; the reply shows it.
#[derive(Debug)]
pub enum Resumed {
    /// From the states that [`Session::checkpoint`] saved last.
    FromSnapshot(Reply),
    /// From the first episodes of the session's seed, since none were saved.
    FromReset(Reply),
}

impl Session {
    /// Saves the state of every environment as bytes in this process: that is where
    /// [`Self::reconnect`] goes on. The one before is forgotten.
    pub fn checkpoint(&mut self) -> Result<(), CallError> {
        let snapshot = self.snapshot()?;
        self.checkpoint = Some(self.export(&snapshot)?);
        Ok(())
    }

    /// Opens this session again after its server was lost ([`CallError::ServerLost`]): with the same
    /// task, options and seed, in whichever server of the same name runs within `patience`. A private
    /// server is started again. Requests that were in flight were not carried out.
    ///
    /// Where it fails, the session is as it was, and this can be called again.
    pub fn reconnect(&mut self, patience: Duration) -> Result<Resumed, ReconnectError> {
        let start = Instant::now();
        loop {
            let client = self.client.again(patience.saturating_sub(start.elapsed()))?;
            match self.resume(&client) {
                // Lost once more.
                Err(error) if is_loss(&error) && start.elapsed() < patience => {}
                resumed => return Ok(resumed?),
            }
        }
    }

    fn resume(&mut self, client: &Client) -> Result<Resumed, CallError> {
        let mut session = client.open(&self.request)?;
        session.want_expert(self.want_expert);
        let resumed = if let Some(bytes) = &self.checkpoint {
            let snapshot = session.import(bytes)?;
            Resumed::FromSnapshot(session.restore(&snapshot)?)
        } else {
            Resumed::FromReset(session.reset()?)
        };
        session.checkpoint = self.checkpoint.take();
        *self = session;
        Ok(resumed)
    }
}

/// Whether an error says no more than that the server is gone, or about to be.
fn is_loss(error: &CallError) -> bool {
    match error {
        CallError::ServerLost { .. } => true,
        CallError::Refused(refusal) => {
            matches!(refusal.code, Code::ShuttingDown | Code::StaleSession)
        }
        _ => false,
    }
}
