//! The control loop: rare messages, opening and closing sessions.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use iceoryx2::active_request::ActiveRequest;
use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::port::server::Server as ServerPort;
use iceoryx2::prelude::ServiceName;
use trocar_proto::control::{self, ControlReply, MAX_MESSAGE, ServerStatus};
use trocar_proto::endpoint::{CONTROL_SERVICE, MAX_CLIENTS, Node, Transport};
use trocar_proto::wire::Header;
use trocar_proto::{Code, Rejection};

use super::desk::{Answer, Desk};
use super::lease::{self, Census, PrivateWatch};
use super::scheduler::Scheduler;
use super::session::{self, SessionHandle};
use super::{ServeError, ServerConfig, StopSignal, transport};
use crate::tasks::Registry;

/// A control request that waits for its reply.
pub(super) type RawRequest = ActiveRequest<Transport, [u8], Header, [u8], Header>;

type Port = ServerPort<Transport, [u8], Header, [u8], Header>;

/// Serves until asked to stop.
pub(super) fn run(
    registry: Arc<Registry>,
    config: &ServerConfig,
    epoch: u64,
    node: &Arc<Node>,
    stop: &StopSignal,
    ready: impl FnOnce(),
) -> Result<(), ServeError> {
    let (port, bell) = open_ports(node)?;
    let scheduler =
        Scheduler::new(config.threads).map_err(|error| ServeError::Threads(error.to_string()))?;
    let mut host = Host {
        desk: Desk::new(Arc::clone(&registry), config, epoch),
        ground: Arc::new(session::Ground {
            registry,
            scheduler,
            node: Arc::clone(node),
            epoch,
            idle_limit: config.idle_limit,
        }),
        sessions: BTreeMap::new(),
        opened: 0,
        started: Instant::now(),
        stop: stop.clone(),
    };
    let mut watch = config.private.map(PrivateWatch::new);
    let mut looked = Instant::now();
    ready();
    tracing::info!(name = %config.name, pid = std::process::id(), threads = config.threads, "serving");
    while !stop.is_set() {
        // Every client that waits is answered once before anybody is answered twice.
        let waiting: Vec<RawRequest> =
            std::iter::from_fn(|| port.receive().ok().flatten()).take(MAX_CLIENTS).collect();
        for request in waiting {
            host.answer(request);
        }
        if looked.elapsed() >= lease::INTERVAL {
            looked = Instant::now();
            host.sweep(watch.as_mut());
        }
        let patience = lease::INTERVAL.saturating_sub(looked.elapsed());
        match bell.timed_wait(|_| {}, patience) {
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => {}
            Err(error) => {
                tracing::warn!(?error, "the control bell failed");
                std::thread::sleep(Duration::from_millis(1));
            }
        }
    }
    tracing::info!(sessions = host.sessions.len(), "shutting down");
    host.shut_down();
    Ok(())
}

fn open_ports(node: &Node) -> Result<(Port, Listener<Transport>), ServeError> {
    let name: ServiceName =
        CONTROL_SERVICE.try_into().expect("the name of the control service is short");
    let service = node
        .service_builder(&name)
        .request_response::<[u8], [u8]>()
        .request_user_header::<Header>()
        .response_user_header::<Header>()
        .max_servers(1)
        .max_clients(MAX_CLIENTS)
        .max_nodes(MAX_CLIENTS + 1)
        .max_active_requests_per_client(1)
        .max_loaned_requests(1)
        .max_response_buffer_size(1)
        .max_borrowed_responses_per_pending_response(1)
        .enable_safe_overflow_for_requests(false)
        .enable_safe_overflow_for_responses(false)
        .enable_fire_and_forget_requests(false)
        .create()
        .map_err(transport("control service"))?;
    let event = node
        .service_builder(&name)
        .event()
        .max_listeners(1)
        .max_notifiers(MAX_CLIENTS)
        .max_nodes(MAX_CLIENTS + 1)
        .create()
        .map_err(transport("control bell"))?;
    // The listener first: whoever can open the control service can ring.
    let bell = event.listener_builder().create().map_err(transport("control bell port"))?;
    let port = service
        .server_builder()
        .initial_max_slice_len(MAX_MESSAGE)
        .max_loaned_responses_per_request(1)
        .create()
        .map_err(transport("control port"))?;
    Ok((port, bell))
}

/// The sessions, and what is needed to open more.
struct Host {
    desk: Desk,
    ground: Arc<session::Ground>,
    sessions: BTreeMap<u64, SessionHandle>,
    opened: u64,
    started: Instant,
    stop: StopSignal,
}

impl Host {
    fn answer(&mut self, request: RawRequest) {
        let (used, count) = (self.used_bytes(), self.sessions.len());
        // The client could still write to what it sent: judge a copy.
        let header = *request.user_header();
        let payload = request.payload().to_vec();
        let result = match self.desk.judge(&header, &payload, used, count) {
            Answer::Reply(reply) => reply,
            Answer::Open { request: wanted, client, bytes } => {
                self.opened += 1;
                let id = self.opened;
                let handle =
                    session::open(Arc::clone(&self.ground), id, wanted, client, bytes, request);
                if let Some(handle) = handle {
                    self.sessions.insert(id, handle);
                }
                // The session's own thread replies once everything is in place.
                return;
            }
            Answer::Close { session, node } => self.close(session, node),
            Answer::Status => ControlReply::Status(self.status()),
            Answer::Shutdown => {
                self.stop.set();
                ControlReply::Done
            }
        };
        reply(&request, &result);
    }

    fn close(&mut self, session: u64, node: u128) -> ControlReply {
        match self.sessions.get(&session) {
            Some(handle) if handle.client().node == node => {
                // Its thread ends within a tenth of a second; the memory counts no longer.
                handle.stop();
                self.sessions.remove(&session);
                ControlReply::Done
            }
            _ => ControlReply::Refused(Rejection::new(
                Code::UnknownSession,
                "session",
                session,
                "this client has no such session",
            )),
        }
    }

    /// Closes the sessions of dead clients and removes what they left.
    fn sweep(&mut self, watch: Option<&mut PrivateWatch>) {
        let Some(census) = Census::take(&self.ground.node) else { return };
        self.sessions.retain(|id, handle| {
            let alive = census.has(handle.client().node);
            if !alive {
                tracing::info!(session = id, pid = handle.client().pid, "client is gone");
                handle.stop();
            }
            alive && !handle.has_ended()
        });
        if census.deaths {
            self.ground.node.try_cleanup_dead_nodes();
        }
        if let Some(why) = watch.and_then(|watch| watch.verdict(census.clients())) {
            tracing::info!(why, "the private server ends");
            self.stop.set();
        }
    }

    fn shut_down(self) {
        for handle in self.sessions.values() {
            handle.stop();
        }
        for handle in self.sessions.into_values() {
            handle.join();
        }
    }

    fn used_bytes(&self) -> u64 {
        self.sessions.values().map(SessionHandle::bytes).sum()
    }

    fn status(&self) -> ServerStatus {
        let info = self.desk.info();
        ServerStatus {
            name: info.name.clone(),
            pid: info.pid,
            epoch: info.epoch,
            uptime_s: self.started.elapsed().as_secs_f64(),
            sessions: self.sessions.values().map(SessionHandle::status).collect(),
            memory_bytes: self.used_bytes(),
        }
    }
}

/// Sends a control reply. A client that is gone by now gets none.
pub(super) fn reply(request: &RawRequest, reply: &ControlReply) {
    let mut bytes = vec![0; MAX_MESSAGE];
    let encoded = control::encode(reply, &mut bytes)
        .or_else(|refusal| control::encode(&ControlReply::Refused(refusal), &mut bytes));
    let Ok(length) = encoded else { return };
    let sent = request.loan_slice(length).map_err(|error| format!("{error:?}")).and_then(
        |mut response| {
            response.payload_mut().copy_from_slice(&bytes[..length]);
            let asked = request.user_header();
            *response.user_header_mut() =
                Header { length: length as u32, request: asked.request, ..Header::new(asked.kind) };
            response.send().map_err(|error| format!("{error:?}"))
        },
    );
    if let Err(error) = sent {
        tracing::debug!(error, "a control reply was not delivered");
    }
}
