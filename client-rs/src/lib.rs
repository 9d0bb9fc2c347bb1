//! Rust client of the Trocar surgical-robot simulation service.
//!
//! A [`Client`] connects to a running server; a [`Session`] is N environments of one task in that
//! server, stepped by one message through shared memory. This crate never links the physics.
//!
//! ```no_run
//! use trocar_client::{Client, SessionRequest};
//!
//! let client = Client::connect("lab")?;
//! let mut session = client.open(&SessionRequest::new("NeedleReach-v0").envs(64))?;
//! session.want_expert(true);
//! let mut actions = session.reset()?.expert_action().to_vec();
//! for _ in 0..50 {
//!     let reply = session.step(&actions)?;
//!     actions.copy_from_slice(reply.expert_action());
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod client;
mod error;
mod live;
mod owned;
pub mod private;
mod reconnect;
mod reply;
mod session;
mod snapshot;
mod transport;

pub use client::Client;
pub use error::{CallError, ConnectError, ReconnectError};
pub use live::LiveWorld;
pub use reconnect::Resumed;
pub use reply::Reply;
pub use session::Session;
pub use snapshot::Snapshot;
pub use trocar_proto as proto;
pub use trocar_proto::control::{Autoreset, ServerStatus, SessionRequest};
pub use trocar_proto::{Code, OptionValue, Options, Placement, Rejection, TaskSpec};
