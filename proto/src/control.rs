//! Rare messages: hello, tasks, sessions, status. Encoded with serde and bincode.

use std::net::SocketAddr;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::error::{Code, Rejection};
use crate::placement::Placement;
use crate::spec::{ImageSpec, Options, TaskSpec};

/// Largest control message, bytes.
pub const MAX_MESSAGE: usize = 64 * 1024;

/// What a client asks of the server.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ControlRequest {
    /// Introduces the client; the answer is [`ControlReply::Hello`].
    Hello(ClientInfo),
    /// Asks for the ids of all tasks.
    ListTasks,
    /// Asks for one task under some options.
    DescribeTask {
        /// Task id.
        task: String,
        /// Its options.
        options: Options,
    },
    /// Opens a session.
    OpenSession {
        /// What is wanted.
        request: SessionRequest,
        /// The client that asks, as it introduced itself.
        client: ClientInfo,
    },
    /// Closes a session of this client.
    CloseSession {
        /// Which.
        session: u64,
        /// The client's transport node, as it introduced itself.
        node: u128,
    },
    /// Asks for the server's clients and sessions, and how fast it runs.
    Status,
    /// Ends the server.
    Shutdown,
    /// Drops snapshots and placements; those that are not there are no error.
    DropSnapshots {
        /// The session that took them.
        session: u64,
        /// The client's transport node, as it introduced itself.
        node: u128,
        /// Their numbers.
        snapshots: Vec<u64>,
    },
    /// Asks for a snapshot as bytes.
    ExportSnapshot {
        /// The session that took it.
        session: u64,
        /// The client's transport node, as it introduced itself.
        node: u128,
        /// Its number.
        snapshot: u64,
    },
    /// Brings the bytes of a snapshot into a session.
    ImportSnapshot {
        /// The session that shall have it.
        session: u64,
        /// The client's transport node, as it introduced itself.
        node: u128,
        /// One part, as [`crate::snapshot::split`] gives it.
        bytes: Vec<u8>,
    },
    /// Begins to record an environment of any session, from its present episode's beginning on. One is
    /// recorded at a time: a new recording of a session ends the one before.
    Record {
        /// Which session.
        session: u64,
        /// Which of its environments.
        env: u32,
        /// Steps from one snapshot that is kept to the next, besides those at ends of episodes.
        every: u32,
    },
    /// Asks for what was recorded of a session since the last time; to be repeated at least twice a minute,
    /// or the recording ends.
    Recorded {
        /// Which session.
        session: u64,
    },
    /// Brings a placement into a session, for [`crate::wire::kind::ARRANGE`].
    ImportPlacement {
        /// The session that shall have it.
        session: u64,
        /// The client's transport node, as it introduced itself.
        node: u128,
        /// How episodes shall begin.
        placement: Placement,
    },
    /// Asks where the live viewer is; where there is none, one is started at a free port of 127.0.0.1.
    Viewer,
}

impl ControlRequest {
    /// What its client waits for, in words.
    pub fn purpose(&self) -> &'static str {
        match self {
            Self::Hello(_) => "the connection",
            Self::ListTasks => "the list of tasks",
            Self::DescribeTask { .. } => "the description of a task",
            Self::OpenSession { .. } => "the opening of a session",
            Self::CloseSession { .. } => "the closing of a session",
            Self::Status => "the status",
            Self::Shutdown => "the end of the server",
            Self::DropSnapshots { .. } => "the dropping of snapshots",
            Self::ExportSnapshot { .. } => "a snapshot's bytes",
            Self::ImportSnapshot { .. } => "a snapshot brought into a session",
            Self::Record { .. } => "the beginning of a recording",
            Self::Recorded { .. } => "what was recorded",
            Self::Viewer => "the viewer's address",
            Self::ImportPlacement { .. } => "a placement brought into a session",
        }
    }

    /// The kind of [`Self::OpenSession`].
    pub const OPEN_SESSION: u32 = 4;

    /// The number in [`crate::wire::Header::kind`]. Reserved for later: 32 to 47 dVRK arm sessions.
    pub fn kind(&self) -> u32 {
        match self {
            Self::Hello(_) => 1,
            Self::ListTasks => 2,
            Self::DescribeTask { .. } => 3,
            Self::OpenSession { .. } => Self::OPEN_SESSION,
            Self::CloseSession { .. } => 5,
            Self::Status => 6,
            Self::Shutdown => 7,
            Self::DropSnapshots { .. } => 18,
            Self::ExportSnapshot { .. } => 19,
            Self::ImportSnapshot { .. } => 20,
            Self::Record { .. } => 21,
            Self::Recorded { .. } => 22,
            Self::Viewer => 23,
            Self::ImportPlacement { .. } => 24,
        }
    }
}

/// What the server answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ControlReply {
    /// To [`ControlRequest::Hello`].
    Hello(ServerInfo),
    /// To [`ControlRequest::ListTasks`].
    Tasks(Vec<String>),
    /// To [`ControlRequest::DescribeTask`].
    Task(Box<TaskSpec>),
    /// To [`ControlRequest::OpenSession`].
    Opened(Box<SessionInfo>),
    /// To [`ControlRequest::CloseSession`], [`ControlRequest::DropSnapshots`], [`ControlRequest::Record`]
    /// and [`ControlRequest::Shutdown`].
    Done,
    /// To [`ControlRequest::Status`].
    Status(ServerStatus),
    /// To anything that was refused.
    Refused(Rejection),
    /// To [`ControlRequest::ExportSnapshot`]: one part.
    Exported(Vec<u8>),
    /// To [`ControlRequest::ImportSnapshot`] and [`ControlRequest::ImportPlacement`]: the number under which it
    /// is kept until [`ControlRequest::DropSnapshots`].
    Imported(u64),
    /// To [`ControlRequest::Recorded`].
    Recorded {
        /// Parts one after another, as [`crate::snapshot::split`] takes them; none where nothing is new.
        bytes: Vec<u8>,
        /// States that are missing since the client did not fetch the earlier ones in time.
        lost: u64,
    },
    /// To [`ControlRequest::Viewer`]: where its page is served over HTTP.
    Viewer(SocketAddr),
}

/// A client, as it introduces itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClientInfo {
    /// The client's transport node: its death is how the server learns of the client's.
    pub node: u128,
    /// Process id in the client's own process namespace.
    pub pid: u32,
    /// `rust` or `python`.
    pub language: String,
}

/// A server, as it introduces itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ServerInfo {
    /// Name it serves under.
    pub name: String,
    /// Process id in the server's own process namespace.
    pub pid: u32,
    /// The run of the server: a restarted one has another.
    pub epoch: u64,
    /// Version of the program.
    pub version: String,
    /// Most environments that one session may have.
    pub max_envs: u32,
}

/// What happens to an environment whose episode ended.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Autoreset {
    /// The next step resets it and ignores its action (Gymnasium's `NextStep`).
    #[default]
    NextStep,
    /// The step that ends the episode resets it and also returns its last state (`SameStep`).
    SameStep,
    /// Nothing: it must be reset before it is stepped again (`Disabled`).
    Disabled,
}

/// One task, N environments, one seed, its options.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SessionRequest {
    /// Task id, e.g. `NeedleReach-v0`.
    pub task: String,
    /// Number of environments.
    pub envs: u32,
    /// Environment i starts with the [seed](crate::seed) of the number `seed + i`.
    pub seed: u64,
    /// What happens at the end of an episode.
    pub autoreset: Autoreset,
    /// Options of the task.
    pub options: Options,
    /// How [`crate::wire::kind::RENDER`] draws: `image_size`, `camera` and what belongs to it, as the
    /// options of pictures that are observed; `None` if nothing will be drawn.
    pub view: Option<Options>,
}

impl SessionRequest {
    /// One environment of `task` with seed 0 and default options.
    pub fn new(task: &str) -> Self {
        Self {
            task: task.into(),
            envs: 1,
            seed: 0,
            autoreset: Autoreset::default(),
            options: Options::new(),
            view: None,
        }
    }

    /// The same with `envs` environments.
    #[must_use]
    pub fn envs(self, envs: u32) -> Self {
        Self { envs, ..self }
    }

    /// The same with another seed.
    #[must_use]
    pub fn seed(self, seed: u64) -> Self {
        Self { seed, ..self }
    }

    /// The same with another autoreset mode.
    #[must_use]
    pub fn autoreset(self, autoreset: Autoreset) -> Self {
        Self { autoreset, ..self }
    }

    /// The same with pictures on demand.
    #[must_use]
    pub fn view(self, view: Options) -> Self {
        Self { view: Some(view), ..self }
    }

    /// The same with other options.
    #[must_use]
    pub fn options(self, options: Options) -> Self {
        Self { options, ..self }
    }
}

/// An opened session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SessionInfo {
    /// Its number, unique in this run of the server.
    pub session: u64,
    /// The run of the server.
    pub epoch: u64,
    /// Its number at the [doorbell](crate::notify::doorbell).
    pub slot: u32,
    /// Number of environments.
    pub envs: u32,
    /// The task under the session's options.
    pub spec: TaskSpec,
    /// What pictures on demand are like, where they were asked for.
    pub view: Option<Box<ImageSpec>>,
}

/// The server as `trocar status` shows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ServerStatus {
    /// Name it serves under.
    pub name: String,
    /// Process id.
    pub pid: u32,
    /// The run of the server.
    pub epoch: u64,
    /// Time since it started, s.
    pub uptime_s: f64,
    /// Sessions, in the order in which they were opened.
    pub sessions: Vec<SessionStatus>,
    /// Bytes that sessions are counted with against the memory budget.
    pub memory_bytes: u64,
}

/// One session as `trocar status` shows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SessionStatus {
    /// Its number.
    pub id: u64,
    /// Process that opened it.
    pub pid: u32,
    /// Its task.
    pub task: String,
    /// Its number of environments.
    pub envs: u32,
    /// Environment steps per second over about the last second.
    pub steps_per_second: f64,
    /// Median time that the server takes for one message, µs.
    pub p50_us: f64,
    /// 99th percentile of the same.
    pub p99_us: f64,
}

fn config() -> bincode::config::Configuration<
    bincode::config::LittleEndian,
    bincode::config::Varint,
    bincode::config::Limit<MAX_MESSAGE>,
> {
    bincode::config::standard().with_limit::<MAX_MESSAGE>()
}

/// Writes a message into `buffer` and returns its length.
pub fn encode(message: &impl Serialize, buffer: &mut [u8]) -> Result<usize, Rejection> {
    bincode::serde::encode_into_slice(message, buffer, config()).map_err(|error| {
        Rejection::new(
            Code::Malformed,
            "message",
            error,
            format!("a control message of at most {} bytes", buffer.len()),
        )
    })
}

/// Reads a message that takes up all of `bytes`.
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Rejection> {
    let malformed = |found: String| {
        Rejection::new(Code::Malformed, "message", found, "a control message of this protocol")
    };
    if bytes.len() > MAX_MESSAGE {
        return Err(malformed(format!("{} bytes", bytes.len())));
    }
    match bincode::serde::decode_from_slice(bytes, config()) {
        Ok((message, used)) if used == bytes.len() => Ok(message),
        Ok((_, used)) => Err(malformed(format!("{} bytes after the message", bytes.len() - used))),
        Err(error) => Err(malformed(error.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request() -> ControlRequest {
        ControlRequest::OpenSession {
            request: SessionRequest::new("NeedleReach-v0")
                .envs(64)
                .seed(7)
                .autoreset(Autoreset::SameStep)
                .options(Options::new().with_text("reward", "dense")),
            client: ClientInfo { node: u128::MAX, pid: 1, language: "rust".into() },
        }
    }

    #[test]
    fn messages_survive_the_wire() {
        let mut buffer = vec![0; MAX_MESSAGE];
        let length = encode(&request(), &mut buffer).unwrap();
        assert_eq!(decode::<ControlRequest>(&buffer[..length]).unwrap(), request());
    }

    #[test]
    fn truncated_extended_and_oversized_messages_are_refused() {
        let mut buffer = vec![0; MAX_MESSAGE + 1];
        let length = encode(&request(), &mut buffer).unwrap();
        for end in 0..length {
            assert!(decode::<ControlRequest>(&buffer[..end]).is_err());
        }
        assert!(decode::<ControlRequest>(&buffer[..=length]).is_err());
        assert!(decode::<ControlRequest>(&buffer).is_err());
    }

    #[test]
    fn a_length_prefix_that_promises_too_much_is_refused_without_allocating() {
        // Variant 2 (DescribeTask), then a string said to have 2^60 bytes.
        let mut bytes = vec![2, 253];
        bytes.extend_from_slice(&(1u64 << 60).to_le_bytes());
        assert_eq!(decode::<ControlRequest>(&bytes).unwrap_err().code, Code::Malformed);
    }
}
