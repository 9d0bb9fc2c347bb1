//! Arms that answer as those of the da Vinci Research Kit (dVRK 2.4) do: the CRTK interface without ROS, without a
//! clock and without clients.
//!
//! An [`ArmController`] is a value. It takes [`Command`]s, lets ticks of 1/240 s pass, and gives the set-points of
//! each tick. What it has to tell it tells by [`Event`]s. The same commands at the same ticks give the same bits.
//! Its owner brings commands from scripts or messages, gives set-points to a world or to nothing, and publishes what it
//! reads.
//!
//! | module | holds |
//! |---|---|
//! | [`command`] | what a client may ask for |
//! | [`event`] | what an arm tells: states, ends of moves, warnings and errors with their reasons |
//! | [`state`] | operating states and the commands that each takes |
//! | [`arm`] | the controller |
//! | [`planner`] | time-optimal trajectories of all joints and the jaw |
//! | [`mechanism`] | joints, limits and kinematics with dVRK's answers |
//! | [`topics`] | the list of all topics, from which interfaces to clients are made |
//!
//! # What an arm does
//!
//! - It begins `DISABLED`. `enable` gives it power; `home` brings all joints to zero and the insertion to 0.12 m, as
//!   dVRK's kinematic simulation does, unless it is to stay ([`Homing`]). Then it takes motion commands. Without power it forgets its zeros.
//! - Every `state_command` is answered by an operating state, also where nothing changes.
//! - `servo_*` takes effect with the next tick: no interpolation, no limit of speed, joints clipped silently.
//! - `move_*` plans a time-optimal trajectory of joints and jaw, from the present velocity, clipped first. It is busy
//!   until the tick in which it ends, one tick at least. `move_cp` goes no straight line. After set-points, a velocity
//!   counts only as far as joints accelerate that fast: a step is none, a loop at 50 Hz or more has one.
//! - `hold`, `free` and `servo_*` end a move: `goal_reached` is false, and the arm not busy any more. Another move takes
//!   its place without a word.
//! - What is malformed is refused by an [`Error`](event::Error). What comes at the wrong time is ignored with a
//!   [`Warning`](event::Warning).
//!
//! # What differs from a real arm
//!
//! - There are no dynamics of joints: efforts are 0, and commands of efforts are ignored with a warning.
//! - An arm move after `jaw/servo_jp` leaves the jaw where it is; a warning says where a real one may bring it.
//! - Without a tool the arm takes no motion commands at all; a real one takes those of joints.
//! - A goal of the jaw is planned to one turn at most, the goals of joints are always within their limits.
//! - `servo_jv`, `servo_cv`, `servo_cr` and `move_cr` are CRTK's; dVRK does not offer them.
//!
//! Sources: sawIntuitiveResearchKit 2.4 (Arm, PSM and ECM components), its manual, and CRTK's documentation.
//!
//! ```
//! use trocar_server::dvrk::{ArmController, Command, Mechanism, StateCommand};
//! use trocar_server::robots::Psm;
//!
//! let psm = Mechanism::Psm(Psm::CLASSIC);
//! let mut arm = ArmController::new("PSM1", psm, &[0.0; 7]);
//! for command in [StateCommand::Enable, StateCommand::Home] {
//!     arm.command(&Command::State(command));
//! }
//! while arm.operating_state().is_busy {
//!     arm.tick();
//! }
//! assert!(arm.operating_state().is_homed);
//! arm.command(&Command::MoveJp(vec![0.1, 0.0, 0.12, 0.0, 0.0, 0.0]));
//! while arm.operating_state().is_busy {
//!     let set_point = arm.tick();
//!     assert_eq!(set_point.joints[..], arm.measured_js().position[..]);
//! }
//! assert_eq!(arm.measured_js().position[0], 0.1);
//! ```

use crate::sim::world::SUBSTEPS_PER_SECOND;

pub mod arm;
pub mod event;
pub mod mechanism;
pub mod planner;
#[cfg(test)]
mod tests;

pub use arm::{ArmController, JointState, SetPoint, VELOCITY_SECONDS};
pub use command::{Command, Effort, PoseMessage, StateCommand};
pub use event::{Error, Event, NotReady, Stamp, Warning, What};
pub use mechanism::{Mechanism, NoSolution, Pose};
pub use state::{OperatingState, State};
pub use trocar_proto::dvrk::{Homing, command, state, topics};

/// Ticks in a second: a tick is a substep of the simulation.
pub const TICKS_PER_SECOND: u64 = SUBSTEPS_PER_SECOND as u64;

const _: () = assert!(TICKS_PER_SECOND == trocar_proto::dvrk::TICKS_PER_SECOND);

/// A pose as messages have it: x, y, z, m; x, y, z, w of a unit quaternion.
pub fn numbers_of(pose: &Pose) -> [f64; 7] {
    let ([x, y, z], [i, j, k, w]) = (pose.translation.vector.into(), pose.rotation.coords.into());
    [x, y, z, i, j, k, w]
}

/// A tick, s.
pub const TICK: f64 = 1.0 / SUBSTEPS_PER_SECOND;
