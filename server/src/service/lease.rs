//! Who is alive. Nobody is told of a death, so the server looks: several times a second it lists
//! the participants of the transport, closes the sessions of those that are gone, and only then
//! removes what they left.

use std::time::{Duration, Instant};

use iceoryx2::node::{NodeState, NodeView};
use iceoryx2::prelude::CallbackProgression;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::OwnedFd;
use rustix::process::{Pid, PidfdFlags, pidfd_open};
use trocar_proto::endpoint::Node;

use super::PrivateRule;

/// How often the server looks.
pub(super) const INTERVAL: Duration = Duration::from_millis(250);

/// Who was alive at the last look.
#[derive(Debug, Default)]
pub(super) struct Census {
    alive: Vec<u128>,
    /// Whether somebody died and left something.
    pub(super) deaths: bool,
}

impl Census {
    /// Looks who is alive. `None` where the list could not be read; the next look may do.
    pub(super) fn take(node: &Node) -> Option<Self> {
        let mut census = Self::default();
        let listed = Node::list(node.config(), |state| {
            match state {
                NodeState::Alive(view) => census.alive.push(view.id().value()),
                NodeState::Dead(_) => census.deaths = true,
                // Being created or removed right now; the next look tells.
                NodeState::Inaccessible(id) | NodeState::Undefined(id) => {
                    census.alive.push(id.value());
                }
            }
            CallbackProgression::Continue
        });
        listed
            .inspect_err(|error| tracing::debug!(?error, "participants could not be listed"))
            .ok()
            .map(|()| census)
    }

    /// Whether this participant is alive.
    pub(super) fn has(&self, node: u128) -> bool {
        self.alive.contains(&node)
    }

    /// Participants besides the server.
    pub(super) fn clients(&self) -> usize {
        self.alive.len().saturating_sub(1)
    }
}

/// Watches for the end of a private server's reason to be.
#[derive(Debug)]
pub(super) struct PrivateWatch {
    rule: PrivateRule,
    root: Option<OwnedFd>,
    last_client: Instant,
}

impl PrivateWatch {
    pub(super) fn new(rule: PrivateRule) -> Self {
        let root = Pid::from_raw(rule.root.cast_signed())
            .and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok());
        Self { rule, root, last_client: Instant::now() }
    }

    /// Why the server should end, if it should.
    pub(super) fn verdict(&mut self, clients: usize) -> Option<&'static str> {
        if clients > 0 {
            self.last_client = Instant::now();
        }
        if self.last_client.elapsed() > self.rule.linger {
            return Some("its last client is gone");
        }
        let ended = match &self.root {
            // The descriptor of a process becomes readable when the process ends.
            Some(root) => poll(&mut [PollFd::new(root, PollFlags::IN)], Some(&Timespec::default()))
                .is_ok_and(|ready| ready > 0),
            None => true,
        };
        ended.then_some("its root process has ended")
    }
}
