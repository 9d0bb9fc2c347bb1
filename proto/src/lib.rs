//! What Trocar's server and clients must agree on: the whole protocol on one screen.
//!
//! | module | holds |
//! |---|---|
//! | [`endpoint`] | where a server is found: names, folders, transport configuration |
//! | [`notify`] | how both sides tell each other that a message is there, and where they sleep until then |
//! | [`builtin`] | what is known of Trocar's own tasks without a server |
//! | [`cause`] | why an operation of the transport failed, in its own words |
//! | [`missing_page`] | making shared memory while there is none |
//! | [`open_files`] | how many files a process has open, and what clients and sessions take |
//! | [`dvrk`] | live worlds: commands to their arms, what these tell, and all of it as records in shared memory |
//! | [`control`] | rare messages: hello, tasks, sessions, status (serde + bincode, at most 64 KiB) |
//! | [`columns`] | what each environment's row of a reply holds |
//! | [`wire`] | frequent messages: step and reset as plain arrays in shared memory |
//! | [`spec`] | what a task looks like: actions, observations, goals, options |
//! | [`goal`] | distance, success and reward as pure functions of goals |
//! | [`relative`] | features as pure functions of state and goals |
//! | [`scaled`] | scaling of state and goals by their ranges |
//! | [`stage`] | what a scripted expert is about |
//! | [`placement`] | how an episode shall begin |
//! | [`similar`] | suggestions for mistyped names |
//! | [`seed`] | which numbers are seeds |
//! | [`part`] | bytes that outlive a process: snapshots and recordings consist of them |
//! | [`snapshot`] | the state of an environment as bytes |
//! | [`error`] | refusals: the field, its value and what is allowed |
//!
//! A client opens the control service, says hello, and opens a *session*: one task, N
//! environments, one seed, its options. The server answers with the session's [`spec::TaskSpec`]
//! and the name of a data service of its own, over which every reset and step goes. The arrays of
//! both directions lie at the offsets of [`wire::RequestLayout`] and [`wire::ReplyLayout`], which
//! both sides compute from the same specification. Snapshots are taken and restored there too, so
//! their order among resets and steps is plain; only their bytes travel by control messages.
//!
//! ```
//! use trocar_proto::goal::{Reward, SuccessRule};
//!
//! let rule = SuccessRule::Distance { tolerance: 0.005 };
//! assert!(rule.holds(&[0.0, 0.0, 0.0], &[0.003, 0.0, 0.0]));
//! assert_eq!(Reward::Sparse.of(&rule, &[0.0; 3], &[0.1, 0.0, 0.0]), -1.0);
//! ```

pub mod builtin;
pub mod cause;
pub mod columns;
pub mod control;
pub mod dvrk;
pub mod endpoint;
pub mod error;
pub mod goal;
pub mod missing_page;
pub mod notify;
pub mod open_files;
pub mod part;
pub mod placement;
pub mod relative;
pub mod scaled;
pub mod seed;
pub mod similar;
pub mod snapshot;
pub mod spec;
pub mod stage;
pub mod wire;

pub use control::PROTOCOL_VERSION;
pub use error::{Code, Rejection};
pub use placement::Placement;
pub use spec::{OptionValue, Options, TaskSpec};
pub use stage::Stage;
