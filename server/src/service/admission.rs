//! What a control message means, without any transport: every byte that a client can send on the
//! control service is judged here, so this is what the fuzz tests attack.

use std::collections::BTreeMap;
use std::sync::Arc;

use trocar_proto::control::{self, ControlRequest, ServerInfo, SessionRequest};
use trocar_proto::dvrk::{ArmInfo, LiveInfo};
use trocar_proto::endpoint::{Endpoint, MAX_CLIENTS};
use trocar_proto::open_files::{OpenFiles, SESSION_FILES};
use trocar_proto::wire::{
    Header, LiveReplyLayout, LiveRequestLayout, MAGIC, MAX_IN_FLIGHT, PictureLayout, ReplyLayout,
    RequestLayout,
};
use trocar_proto::{Code, PROTOCOL_VERSION, Rejection, TaskSpec};

use super::ports::REPLIES;
use super::{ServeError, ServerConfig};
use crate::registry::Registry;
use crate::sim::motion::MAX_INSTRUMENTS;

/// A control message that may be answered.
#[derive(Debug, Clone, PartialEq)]
pub struct Admitted {
    /// What is asked.
    pub request: ControlRequest,
    /// Memory that the session may take, where one is to be opened.
    pub footprint: Footprint,
}

/// Memory that sessions are counted with, bytes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Footprint {
    /// In `/dev/shm`.
    pub shared: u64,
    /// In the server.
    pub private: u64,
}

impl Footprint {
    /// Both together.
    pub fn total(&self) -> u64 {
        self.shared + self.private
    }
}

impl std::iter::Sum for Footprint {
    fn sum<I: Iterator<Item = Self>>(footprints: I) -> Self {
        footprints.fold(Self::default(), |sum, one| Self {
            shared: sum.shared + one.shared,
            private: sum.private + one.private,
        })
    }
}

/// What a server's sessions take.
#[derive(Debug, Clone, Default)]
pub struct Usage {
    /// Memory of all of them and of their snapshots.
    pub memory: Footprint,
    /// How many there are.
    pub sessions: usize,
    /// The server's open files, where a session is to be opened.
    pub files: OpenFiles,
    /// What those of each client take, by process id.
    pub clients: BTreeMap<u32, Holding>,
}

/// What one client has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Holding {
    /// Number of sessions.
    pub sessions: usize,
    /// Environments of all of them.
    pub envs: u64,
    /// Memory of them and their snapshots, bytes.
    pub memory_bytes: u64,
}

/// What one client, a process, may have. [`Self::default`] limits nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quota {
    /// Most sessions at a time.
    pub sessions: usize,
    /// Most environments of all its sessions.
    pub envs: u64,
    /// Most memory of its sessions and their snapshots, bytes.
    pub memory_bytes: u64,
    /// Most threads that step its environments at a time.
    pub threads: usize,
}

impl Default for Quota {
    fn default() -> Self {
        Self { sessions: usize::MAX, envs: u64::MAX, memory_bytes: u64::MAX, threads: usize::MAX }
    }
}

impl Quota {
    /// Whether process `pid`, which has `held`, may have `envs` environments more in a session of
    /// `bytes` bytes.
    fn check(&self, pid: u32, held: Holding, envs: u32, bytes: u64) -> Result<(), Rejection> {
        if held.sessions >= self.sessions {
            return Err(Rejection::new(
                Code::TooManySessions,
                "sessions",
                held.sessions + 1,
                format!(
                    "process {pid} may have {} at a time (serve --client-sessions)",
                    self.sessions
                ),
            ));
        }
        if held.envs + u64::from(envs) > self.envs {
            return Err(Rejection::new(
                Code::InvalidEnvCount,
                "envs",
                envs,
                format!(
                    "process {pid} has {} of the {} that it may have (serve --client-envs)",
                    held.envs, self.envs
                ),
            ));
        }
        if held.memory_bytes.saturating_add(bytes) > self.memory_bytes {
            return Err(Rejection::new(
                Code::MemoryBudget,
                "envs",
                envs,
                format!(
                    "they need {}, and process {pid} has {} of the {} that it may have (serve \
                     --client-memory)",
                    mebibytes(bytes),
                    mebibytes(held.memory_bytes),
                    mebibytes(self.memory_bytes)
                ),
            ));
        }
        Ok(())
    }
}

/// Judges control messages.
#[derive(Clone)]
pub struct Admission {
    registry: Arc<Registry>,
    info: ServerInfo,
    endpoint: Endpoint,
    budget: u64,
    quota: Quota,
}

impl Admission {
    /// The admission of one run of a server.
    pub fn new(registry: Arc<Registry>, config: &ServerConfig, epoch: u64) -> Self {
        let info = ServerInfo {
            name: config.name.to_string(),
            pid: std::process::id(),
            epoch,
            version: env!("CARGO_PKG_VERSION").into(),
            max_envs: config.max_envs,
        };
        let endpoint = Endpoint::new(&config.name);
        let (budget, quota) = (config.memory_bytes, config.client);
        Self { registry, info, endpoint, budget, quota }
    }

    /// The server, as it introduces itself.
    pub fn info(&self) -> &ServerInfo {
        &self.info
    }

    /// Whether a message may be answered, where open sessions take `usage`.
    pub fn check(
        &self,
        header: &Header,
        payload: &[u8],
        usage: &Usage,
    ) -> Result<Admitted, Rejection> {
        check_header(header)?;
        let Some(body) = payload.get(..header.length as usize) else {
            return Err(Rejection::new(
                Code::Malformed,
                "header.length",
                header.length,
                format!("at most the {} bytes that were sent", payload.len()),
            ));
        };
        let request: ControlRequest = control::decode(body)?;
        if header.kind != request.kind() {
            return Err(Rejection::new(
                Code::Malformed,
                "header.kind",
                header.kind,
                format!("the message is of kind {}", request.kind()),
            ));
        }
        let mut footprint = Footprint::default();
        match &request {
            ControlRequest::OpenSession { request, client } => {
                footprint = self.check_session(request, client.pid, usage)?;
            }
            ControlRequest::ImportPlacement { placement, .. } => placement.check()?,
            _ => {}
        }
        Ok(Admitted { request, footprint })
    }

    /// Whether a session may be opened, and what it is counted with.
    fn check_session(
        &self,
        request: &SessionRequest,
        pid: u32,
        usage: &Usage,
    ) -> Result<Footprint, Rejection> {
        let (used, sessions) = (usage.memory, usage.sessions);
        let (spec, each) = self.registry.describe(&request.task, &request.options)?;
        if !(1..=self.info.max_envs).contains(&request.envs) {
            return Err(Rejection::new(
                Code::InvalidEnvCount,
                "envs",
                request.envs,
                format!("allowed is 1 to {} (serve --max-envs)", self.info.max_envs),
            ));
        }
        if let Some(live) = &request.live {
            live.check()?;
            if request.envs != 1 {
                let allowed = "a live world is one environment";
                return Err(Rejection::new(Code::InvalidEnvCount, "envs", request.envs, allowed));
            }
        }
        let held = usage.clients.get(&pid).copied().unwrap_or_default();
        check_room(sessions, usage.files, pid, held.sessions)?;
        let view = request.view.as_ref();
        let view = view.map(|view| self.registry.view(&request.task, &request.options, view));
        let view = view.transpose()?.map(|imaging| PictureLayout::new(imaging.spec()));
        let footprint = Footprint {
            shared: match request.live {
                None => shared_bytes(request.envs as usize, &spec, view.as_ref()),
                Some(_) => live_bytes(&spec, view.as_ref()),
            },
            private: u64::from(request.envs) * each,
        };
        self.quota.check(pid, held, request.envs, footprint.total())?;
        if used.total() + footprint.total() > self.budget {
            return Err(Rejection::new(
                Code::MemoryBudget,
                "envs",
                request.envs,
                format!(
                    "{} of task {} need {}, and {} of {} are taken (serve --memory)",
                    request.envs,
                    spec.id,
                    mebibytes(footprint.total()),
                    mebibytes(used.total()),
                    mebibytes(self.budget)
                ),
            ));
        }
        let free = self.free_memory(used);
        if footprint.shared + RESERVE > free {
            return Err(Rejection::new(
                Code::MemoryBudget,
                "envs",
                request.envs,
                format!(
                    "the session needs {} of shared memory, {} more must stay free for other clients, and {} of \
                     /dev/shm are free; give the container more (docker run --shm-size)",
                    mebibytes(footprint.shared),
                    mebibytes(RESERVE),
                    mebibytes(free)
                ),
            ));
        }
        Ok(footprint)
    }

    /// Shared memory that is promised to no session, bytes. Most of what open sessions were
    /// promised looks free until they write to it.
    fn free_memory(&self, used: Footprint) -> u64 {
        let free = Endpoint::free_memory().unwrap_or(u64::MAX);
        let written = self.endpoint.committed_memory().unwrap_or(0).min(used.shared);
        free.saturating_sub(used.shared - written)
    }
}

/// Whether process `pid`, which has `held` sessions, may have another, where all have `sessions`. A process gets three
/// quarters of what the others leave of a limit, so that later processes find room.
fn check_room(sessions: usize, files: OpenFiles, pid: u32, held: usize) -> Result<(), Rejection> {
    let by_seats = MAX_SESSIONS.saturating_sub(sessions);
    let by_files = files.sessions(CONTROL_FILES);
    let room = by_seats.min(by_files);
    if room > 0 && (held == 0 || 4 * (held + 1) <= 3 * (held + room)) {
        return Ok(());
    }
    let limit = if by_files <= by_seats {
        let OpenFiles { used, limit } = files;
        format!(
            "open files: the server has {used} of the {limit} that it may have, a session takes {SESSION_FILES}, and \
             {CONTROL_FILES} are kept for control; raise the server's limit (ulimit -n, LimitNOFILE of systemd)"
        )
    } else {
        format!("the server has {sessions} sessions of {MAX_SESSIONS}")
    };
    let share = if room > 0 {
        format!(", and the other {room} are kept for other processes")
    } else {
        String::new()
    };
    Err(Rejection::new(
        Code::TooManySessions,
        "sessions",
        sessions + 1,
        format!("process {pid} has {held}{share}; {limit}; or close sessions"),
    ))
}

/// Open files that are kept for control: clients that connect, ask for the status, or are reclaimed.
pub(super) const CONTROL_FILES: usize = 64;

/// Most sessions at a time; each takes a seat.
pub(super) const MAX_SESSIONS: usize = MAX_CLIENTS;

/// Shared memory that must stay free, bytes: the bookkeeping of a few more clients.
const RESERVE: u64 = 2 << 20;

/// Bookkeeping of one session in shared memory, bytes (measured: 28 KiB).
const SERVICE_BYTES: u64 = 32 << 10;

/// Shared memory that a session takes, bytes.
pub(super) fn shared_bytes(envs: usize, spec: &TaskSpec, view: Option<&PictureLayout>) -> u64 {
    let requests = 2 * MAX_IN_FLIGHT + 2;
    let reply = ReplyLayout::new(envs, spec).bytes;
    let reply = view.map_or(reply, |view| view.bytes.max(reply));
    let bytes = REPLIES * reply + requests * RequestLayout::new(envs, spec).bytes;
    bytes as u64 + SERVICE_BYTES
}

/// Shared memory that a session with a live world takes, bytes: an upper bound.
fn live_bytes(spec: &TaskSpec, view: Option<&PictureLayout>) -> u64 {
    let arm = ArmInfo {
        name: String::new(),
        joints: vec![],
        raw_joints: vec![],
        has_jaw: true,
        world_from_base: [0.0; 7],
    };
    let objects = vec![String::new(); MOST_OBJECTS];
    let info = LiveInfo { arms: vec![arm; MAX_INSTRUMENTS + 1], objects, speed: None };
    let requests = 2 * MAX_IN_FLIGHT + 2;
    let reply = LiveReplyLayout::new(&info, spec).bytes;
    let reply = view.map_or(reply, |view| view.bytes.max(reply));
    let bytes = REPLIES * reply + requests * LiveRequestLayout::new().bytes;
    bytes as u64 + SERVICE_BYTES
}

/// More objects than any task has.
const MOST_OBJECTS: usize = 64;

/// Whether a message speaks this protocol.
pub(super) fn check_header(header: &Header) -> Result<(), Rejection> {
    if header.magic != MAGIC {
        return Err(Rejection::new(
            Code::Malformed,
            "header.magic",
            format!("{:#010x}", header.magic),
            format!("expected {MAGIC:#010x}"),
        ));
    }
    if header.protocol != PROTOCOL_VERSION {
        return Err(Rejection::new(
            Code::VersionMismatch,
            "protocol version",
            header.protocol,
            format!(
                "the server speaks version {PROTOCOL_VERSION} (trocar {}), the client version {}; \
                 install the same release on both sides",
                env!("CARGO_PKG_VERSION"),
                header.protocol
            ),
        ));
    }
    Ok(())
}

/// Whether a configuration makes sense.
pub(super) fn check_config(config: &ServerConfig) -> Result<(), ServeError> {
    let check = |field: &str, value: u64, allowed: std::ops::RangeInclusive<u64>| {
        if allowed.contains(&value) {
            return Ok(());
        }
        let (least, most) = allowed.into_inner();
        let allowed = format!("allowed is {least} to {most}");
        Err(Rejection::new(Code::InvalidOption, field, value, allowed))
    };
    check("--threads", config.threads as u64, 1..=1024)?;
    check("--max-envs", config.max_envs.into(), 1..=65_536)?;
    check("--memory", config.memory_bytes, 1 << 20..=1 << 50)?;
    check("--idle-limit", config.idle_limit.as_secs(), 1..=u64::from(u32::MAX))?;
    check("--drain-limit", config.drain_limit.as_secs(), 0..=u64::from(u32::MAX))?;
    check("--client-sessions", config.client.sessions as u64, 1..=u64::MAX)?;
    check("--client-envs", config.client.envs, 1..=u64::MAX)?;
    check("--client-memory", config.client.memory_bytes, 1 << 20..=u64::MAX)?;
    check("--client-threads", config.client.threads as u64, 1..=u64::MAX)?;
    Ok(())
}

fn mebibytes(bytes: u64) -> String {
    format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20))
}
