//! What can go wrong, one enum per operation.

use trocar_proto::Rejection;

/// Why no connection to a server came about.
#[derive(Debug, thiserror::Error)]
pub enum ConnectError {
    /// No server of that name runs for this user.
    #[error(
        "no server named {name:?} is running; start one with `trocar serve --name {name}`, or leave \
         out the name and unset TROCAR_SERVER to use a private server"
    )]
    NoServer {
        /// The name that was tried.
        name: String,
    },
    /// The name is not allowed, the versions differ, or the server takes no more clients.
    #[error(transparent)]
    Refused(#[from] Rejection),
    /// The server did not answer in time.
    #[error("server {name:?} did not answer within {seconds} s")]
    Timeout {
        /// The name that was tried.
        name: String,
        /// How long it was waited.
        seconds: f64,
    },
    /// A private server could not be started.
    #[error("the private server could not be started: {reason}")]
    Launch {
        /// What happened, and what to do.
        reason: String,
    },
    /// Shared memory or its bookkeeping failed.
    #[error("shared memory: {0}")]
    Transport(String),
}

/// Why a session could not be opened again.
#[derive(Debug, thiserror::Error)]
pub enum ReconnectError {
    /// No server was there in time.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// It does not open the session, or does not take what was saved.
    #[error(transparent)]
    Call(#[from] CallError),
}

/// Why a request to a connected server failed.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    /// The request was refused; nothing changed.
    #[error(transparent)]
    Refused(#[from] Rejection),
    /// The server is gone, and with it the session.
    #[error("server {name:?} {}", if *.closed { "was shut down" } else { "died" })]
    ServerLost {
        /// Its name.
        name: String,
        /// Whether it ended in order.
        closed: bool,
    },
    /// The server lives and does not answer: it is stopped, starved, or waits itself.
    #[error("server {name:?} did not answer within {seconds} s: {what}")]
    Timeout {
        /// Its name.
        name: String,
        /// What was waited for.
        what: String,
        /// How long, s.
        seconds: f64,
    },
    /// This process was forked after the session was opened; it must open its own.
    #[error("this session belongs to process {owner}; a forked process must open its own")]
    Forked {
        /// The process that opened it.
        owner: u32,
    },
    /// A reply was asked for, but no request is in flight.
    #[error("no request is in flight")]
    NothingInFlight,
    /// Two requests are in flight already.
    #[error("two requests are in flight already; receive a reply first")]
    TooManyInFlight,
    /// More replies are held on to than the session has room for.
    #[error("too many replies are held on to; drop some, or copy what is needed")]
    TooManyHeld,
    /// A reply did not look like this protocol.
    #[error("the server's reply was not understood: {0}")]
    Malformed(String),
    /// Shared memory or its bookkeeping failed.
    #[error("shared memory: {0}")]
    Transport(String),
}
