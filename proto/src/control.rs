//! Rare messages: hello, tasks, sessions, status. Encoded with serde and bincode.

use std::net::SocketAddr;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::dvrk::{LiveInfo, LiveRequest};
use crate::error::{Code, Rejection};
use crate::placement::Placement;
use crate::spec::{ImageSpec, Options, TaskSpec};

/// Largest control message, bytes.
pub const MAX_MESSAGE: usize = 64 * 1024;

/// Version of everything in this crate; both sides must have the same.
pub const PROTOCOL_VERSION: u32 = 19;

macro_rules! control_messages {
    ($(
        $(#[$doc:meta])*
        $kind:literal $variant:ident: $method:ident $({ $($field:ident: $type:ty),* })? -> $reply:ty, $purpose:literal;
    )*) => {
        /// What a client asks of the server.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[expect(missing_docs, reason = "the variant says what its fields are")]
        pub enum ControlRequest {
            $($(#[$doc])* $variant $({ $($field: $type),* })?,)*
        }

        impl ControlRequest {
            /// What its client waits for, in words.
            pub fn purpose(&self) -> &'static str {
                match self {
                    $(Self::$variant { .. } => $purpose,)*
                }
            }

            /// The kind of [`Self::OpenSession`].
            pub const OPEN_SESSION: u32 = 4;

            /// The number in [`crate::wire::Header::kind`].
            pub fn kind(&self) -> u32 {
                match self {
                    $(Self::$variant { .. } => $kind,)*
                }
            }

            /// Has `handler` answer it; `None` where it will be answered later.
            pub fn dispatch(self, handler: &mut impl ControlHandler) -> Option<ControlReply> {
                let answer = match self {
                    $(Self::$variant $({ $($field),* })? => {
                        handler.$method($($($field),*)?).map(ControlReply::$variant)
                    })*
                };
                match answer {
                    Ok(reply) => Some(reply),
                    Err(Unanswered::Refused(refusal)) => Some(ControlReply::Refused(refusal)),
                    Err(Unanswered::Later) => None,
                }
            }
        }

        /// What the server answers: what belongs to the request of that name, or a refusal.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        pub enum ControlReply {
            /// To anything that was refused.
            Refused(Rejection),
            $(#[doc = concat!("To [`ControlRequest::", stringify!($variant), "`].")] $variant($reply),)*
        }

        /// What answers control messages: the server.
        #[expect(missing_docs, reason = "the request of that name says what it is")]
        pub trait ControlHandler {
            $(fn $method(&mut self, $($($field: $type),*)?) -> Result<$reply, Unanswered>;)*
        }

        /// What sends control messages: a connection of a client.
        pub trait ControlCalls {
            /// Why there is no answer.
            type Error;

            /// Sends a request and waits for its reply; a refusal is an error.
            fn call(&self, request: &ControlRequest) -> Result<ControlReply, Self::Error>;

            /// The error of a reply that belongs to another request.
            fn unexpected(reply: &ControlReply) -> Self::Error;

            $(
                $(#[$doc])*
                fn $method(&self, $($($field: $type),*)?) -> Result<$reply, Self::Error> {
                    match self.call(&ControlRequest::$variant $({ $($field),* })?)? {
                        ControlReply::$variant(reply) => Ok(reply),
                        other => Err(Self::unexpected(&other)),
                    }
                }
            )*
        }
    };
}

// Each is declared once: the number in the header, the request with its fields, the reply, what a client waits for.
// From it follow the messages, the method of [`ControlHandler`] that the server implements and the method of
// [`ControlCalls`] that clients have. New ones come last: their place is their number on the wire.
control_messages! {
    /// Introduces the client.
    1 Hello: hello { client: ClientInfo } -> ServerInfo, "the connection";
    /// Asks for the ids of all tasks.
    2 ListTasks: list_tasks -> Vec<String>, "the list of tasks";
    /// Asks for one task under some options.
    3 DescribeTask: describe_task { task: String, options: Options } -> Box<TaskSpec>, "the description of a task";
    /// Opens a session for a client, as it introduced itself.
    4 OpenSession: open_session { request: SessionRequest, client: ClientInfo } -> Box<SessionInfo>,
        "the opening of a session";
    /// Closes a session of the client with this transport node.
    5 CloseSession: close_session { session: u64, node: u128 } -> (), "the closing of a session";
    /// Asks for the server's clients and sessions, and how fast it runs.
    6 Status: status -> ServerStatus, "the status";
    /// Ends the server.
    7 Shutdown: shutdown -> (), "the end of the server";
    /// Drops snapshots and placements of a session, by their numbers; those that are not there are no error. `node` is
    /// the client's, as it introduced itself.
    18 DropSnapshots: drop_snapshots { session: u64, node: u128, snapshots: Vec<u64> } -> (),
        "the dropping of snapshots";
    /// Asks for a snapshot of a session as bytes: one part. `node` is the client's, as it introduced itself.
    19 ExportSnapshot: export_snapshot { session: u64, node: u128, snapshot: u64 } -> Vec<u8>, "a snapshot's bytes";
    /// Brings the bytes of a snapshot into a session: one part, as [`crate::part::split`] gives it. The reply is the
    /// number under which it is kept until [`ControlRequest::DropSnapshots`]. `node` is the client's, as it introduced
    /// itself.
    20 ImportSnapshot: import_snapshot { session: u64, node: u128, bytes: Vec<u8> } -> u64,
        "a snapshot brought into a session";
    /// Begins to record an environment of any session, from its present episode's beginning on: each `every` steps a
    /// snapshot, and one at ends of episodes. One is recorded at a time: a new recording of a session ends the one before.
    21 Record: record { session: u64, env: u32, every: u32 } -> (), "the beginning of a recording";
    /// Asks for what was recorded of a session since the last time; to be repeated at least twice a minute, or the
    /// recording ends. The reply has parts one after another, as [`crate::part::split`] takes them, none where nothing
    /// is new; and the number of states that are missing since the client did not fetch the earlier ones in time.
    22 Recorded: recorded { session: u64 } -> (Vec<u8>, u64), "what was recorded";
    /// Brings a placement into a session, for [`crate::wire::kind::ARRANGE`]. The reply is the number under which it is
    /// kept until [`ControlRequest::DropSnapshots`]. `node` is the client's, as it introduced itself.
    24 ImportPlacement: import_placement { session: u64, node: u128, placement: Placement } -> u64,
        "a placement brought into a session";
    /// Asks where the live viewer is, whose page is served over HTTP; where there is none, one is started at a free port
    /// of 127.0.0.1.
    23 Viewer: viewer -> SocketAddr, "the viewer's address";
    /// Asks for the token with which the viewer's page drives arms of live worlds.
    26 DriveToken: drive_token -> String, "the token of the viewer's page";
    /// Asks what one client may have of the server.
    25 Limits: limits -> ClientLimits, "the limits of a client";
}

/// Why a message is not answered at once.
#[derive(Debug, Clone, PartialEq)]
pub enum Unanswered {
    /// It is refused.
    Refused(Rejection),
    /// It will be answered when what it asks for is done.
    Later,
}

impl From<Rejection> for Unanswered {
    fn from(refusal: Rejection) -> Self {
        Self::Refused(refusal)
    }
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
    /// A live world instead of environments that are stepped; then there is one environment, in its first episode.
    pub live: Option<LiveRequest>,
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
            live: None,
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

    /// The same with a live world.
    #[must_use]
    pub fn live(self, live: LiveRequest) -> Self {
        Self { live: Some(live), ..self }
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
    /// Its live world, where that was asked for.
    pub live: Option<Box<LiveInfo>>,
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

/// What one client, a process, may have of a server; `None` where only the server itself limits it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClientLimits {
    /// Most environments of a session.
    pub session_envs: u32,
    /// Most sessions at a time.
    pub sessions: Option<u64>,
    /// Most environments of all its sessions.
    pub envs: Option<u64>,
    /// Most memory of its sessions and their snapshots, bytes.
    pub memory_bytes: Option<u64>,
    /// Most threads that step its environments at a time.
    pub threads: Option<u64>,
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
    fn the_request_that_opens_a_session_has_its_kind() {
        assert_eq!(request().kind(), ControlRequest::OPEN_SESSION);
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
