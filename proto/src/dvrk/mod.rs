//! Live worlds, whose arms answer the commands of dVRK scripts: what clients ask for, and what they are told.
//!
//! | module | holds |
//! |---|---|
//! | [`command`] | what a client may ask of an arm |
//! | [`state`] | operating states, and the commands that each takes |
//! | [`report`] | what arms tell: states, ends of moves, warnings, errors |
//! | [`topics`] | the list of all topics, from which interfaces to clients are made |
//! | [`live`] | how a session with a live world is opened |
//! | [`record`] | all of that as fixed-size records in shared memory |
//! | [`recording`] | what led to a world's state, as bytes: recordings |

use nalgebra::Isometry3;

pub mod command;
pub mod live;
pub mod record;
pub mod recording;
pub mod report;
pub mod state;
pub mod topics;

pub use command::{Command, Effort, PoseMessage, StateCommand};
pub use live::{ArmInfo, Homing, LiveInfo, LiveRequest};
pub use record::{ArmRecord, WorldRecord};
pub use report::{Event, Report};
pub use state::{OperatingState, State};

/// A pose, m.
pub type Pose = Isometry3<f64>;

/// Ticks in a second of a live world: a tick is a substep of the simulation.
pub const TICKS_PER_SECOND: u64 = 240;
