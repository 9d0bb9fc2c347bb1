//! Which clients are alive. No message tells of a death, so the server looks: once to four times a
//! second it lists the participants of the transport, closes the sessions of those that are gone,
//! and at the next look removes what they left.

use std::time::{Duration, Instant};

use iceoryx2::node::{NodeState, NodeView};
use iceoryx2::prelude::CallbackProgression;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::OwnedFd;
use rustix::process::{Pid, PidfdFlags, pidfd_open};
use trocar_proto::endpoint::Node;

use super::ServerConfig;

/// How often the server looks, if that takes no more than a hundredth of a core.
pub(super) const INTERVAL: Duration = Duration::from_millis(250);

/// How often it looks at least, however long that takes.
const LONGEST: Duration = Duration::from_secs(1);

/// How long the server waits after a look for which it computed for so long: with 64 clients 10 ms.
pub(super) fn pause(computed: Duration) -> Duration {
    (computed * 100).clamp(INTERVAL, LONGEST)
}

/// The clients that were alive at the last look.
#[derive(Debug, Default)]
pub(super) struct LiveNodes {
    alive: Vec<u128>,
    /// Whether a client died and left something.
    pub(super) deaths: bool,
}

impl LiveNodes {
    /// Looks which clients are alive. `None` where the list could not be read; the next look may
    /// do.
    pub(super) fn take(node: &Node) -> Option<Self> {
        let mut live = Self::default();
        let listed = Node::list(node.config(), |state| {
            match state {
                NodeState::Alive(view) => live.alive.push(view.id().value()),
                NodeState::Dead(_) => live.deaths = true,
                // Being created or removed right now; the next look tells.
                NodeState::Inaccessible(id) | NodeState::Undefined(id) => {
                    live.alive.push(id.value());
                }
            }
            CallbackProgression::Continue
        });
        listed
            .inspect_err(|error| tracing::debug!(?error, "participants could not be listed"))
            .ok()
            .map(|()| live)
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

/// Watches for the end of a server's reason to be, if its configuration names one.
#[derive(Debug)]
pub(super) struct Lifetime {
    followed: Option<Followed>,
    linger: Option<Duration>,
    last_client: Instant,
}

/// The process whose end ends the server.
#[derive(Debug)]
enum Followed {
    /// A descriptor of it, which becomes readable when it ends.
    Process(OwnedFd),
    /// It had ended before it could be watched.
    Gone,
}

impl Lifetime {
    pub(super) fn new(config: &ServerConfig) -> Self {
        let followed = config.follow.map(|process| {
            Pid::from_raw(process.cast_signed())
                .and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok())
                .map_or(Followed::Gone, Followed::Process)
        });
        Self { followed, linger: config.linger, last_client: Instant::now() }
    }

    /// Why the server should end, if it should.
    pub(super) fn verdict(&mut self, clients: usize) -> Option<&'static str> {
        if clients > 0 {
            self.last_client = Instant::now();
        }
        if self.linger.is_some_and(|linger| self.last_client.elapsed() > linger) {
            return Some("its last client is gone");
        }
        let ended = match &self.followed {
            Some(Followed::Process(process)) => {
                let mut polled = [PollFd::new(process, PollFlags::IN)];
                poll(&mut polled, Some(&Timespec::default())).is_ok_and(|ready| ready > 0)
            }
            Some(Followed::Gone) => true,
            None => false,
        };
        ended.then_some("the process it follows has ended")
    }
}
