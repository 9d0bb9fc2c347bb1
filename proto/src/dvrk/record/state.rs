//! What can be read of arms and of the world.

use bytemuck::{Pod, Zeroable};

use super::values::Text;
use crate::dvrk::state::{OperatingState, State};

/// Most axes of an arm: six joints and the jaw.
pub const MAX_AXES: usize = 7;

/// What can be read of an arm. All of one tick has the same stamp.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ArmRecord {
    /// When it was, ns since the world began.
    pub stamp: u64,
    /// The operating state, as a number.
    pub(crate) state: StateWord,
    /// Whether it has a tool: without one, there is nothing Cartesian, and the joints are raw ones.
    pub has_tool: u32,
    /// The process that drives it, 0 if none does.
    pub driver: u32,
    /// Reserved.
    pub reserved: u32,
    /// `measured_js`: rad; index 2 in m. The jaw is behind the joints.
    pub measured_position: [f64; MAX_AXES],
    /// Velocities of the same.
    pub measured_velocity: [f64; MAX_AXES],
    /// `setpoint_js`.
    pub setpoint_position: [f64; MAX_AXES],
    /// Velocities of the same.
    pub setpoint_velocity: [f64; MAX_AXES],
    /// `local/measured_cp`: x, y, z, m; x, y, z, w of a unit quaternion.
    pub local_measured_cp: [f64; 7],
    /// `local/setpoint_cp`.
    pub local_setpoint_cp: [f64; 7],
    /// `measured_cp`.
    pub measured_cp: [f64; 7],
    /// `setpoint_cp`.
    pub setpoint_cp: [f64; 7],
    /// `measured_cv`: m/s, rad/s.
    pub measured_cv: [f64; 6],
    /// The ratio of velocities and accelerations of moves; 0 where they differ.
    pub ratio: f64,
    /// Where the remote centre is in the reference frame.
    pub base_frame: [f64; 7],
    /// Name of the reference frame.
    pub reference_frame: Text,
}

const _: () = assert!(size_of::<ArmRecord>() == 24 + 8 * (4 * 7 + 4 * 7 + 6 + 1 + 7) + 264);

impl ArmRecord {
    /// The record of an arm in this operating state, everything else zero.
    pub fn in_state(state: OperatingState) -> Self {
        Self { state: StateWord::new(state), ..Self::zeroed() }
    }

    /// The operating state.
    pub fn operating_state(&self) -> OperatingState {
        self.state.read()
    }
}

/// An operating state as a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(transparent)]
pub(crate) struct StateWord(u32);

const STATES: [State; 4] = [State::Disabled, State::Enabled, State::Paused, State::Fault];
const IS_HOMED: u32 = 4;
const IS_BUSY: u32 = 8;

impl StateWord {
    pub(super) fn new(state: OperatingState) -> Self {
        let place = STATES.iter().position(|known| *known == state.state).unwrap_or_default();
        let bit = |is: bool, bit: u32| if is { bit } else { 0 };
        Self(place as u32 | bit(state.is_homed, IS_HOMED) | bit(state.is_busy, IS_BUSY))
    }

    pub(super) fn read(self) -> OperatingState {
        OperatingState {
            state: STATES[(self.0 % 4) as usize],
            is_homed: self.0 & IS_HOMED != 0,
            is_busy: self.0 & IS_BUSY != 0,
        }
    }
}

/// A live world after a message.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct WorldRecord {
    /// Ticks that have passed since the world began.
    pub ticks: u64,
    /// Events that this client came too late for.
    pub lost_events: u64,
    /// Ticks that passed with this message.
    pub passed: u32,
    /// Events in this reply.
    pub events: u32,
    /// 1 where there are more events than there was room for: the next reply has them.
    pub has_more: u32,
    /// Steps of the task that have passed.
    pub steps: u32,
    /// What the present state is worth.
    pub reward: f32,
    /// 1 where the goal is reached now.
    pub is_success: u32,
    /// 1 where the state is terminal.
    pub terminated: u32,
    /// Ticks that a paced world is behind its pace: the server had no time for them.
    pub late: u32,
}

const _: () = assert!(size_of::<WorldRecord>() == 48);
