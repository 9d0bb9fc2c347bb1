//! The controller of one arm: commands in, set-points and events out, tick by tick.

use arrayvec::ArrayVec;
use nalgebra::Vector6;

use super::Homing;
use super::command::Command;
use super::event::{Error, Event, NotReady, Stamp, Warning, What};
use super::mechanism::{Mechanism, Pose};
use super::planner::Trajectory;
use super::state::{OperatingState, State};
use super::{TICK, TICKS_PER_SECOND};
use crate::robots::{Axes, Drivetrain};

mod jaw;
mod motion;
mod readout;
mod settings;
mod transition;
mod velocity;

pub use readout::JointState;

/// For how long a velocity acts that no other command follows, s.
pub const VELOCITY_SECONDS: f64 = 0.1;

/// Ticks over which a measured velocity is an average.
const AVERAGED: usize = 5;

/// Time between two warnings of the same kind, ticks: 2 s, as dVRK has it.
const QUIET: u64 = 2 * TICKS_PER_SECOND;

/// What counts as rounding of times, s.
const ROUNDING: f64 = 1e-9;

/// Longest text of a client that an event quotes, in characters.
const QUOTED: usize = 64;

/// Where an arm is to go in a tick: the true links, not what their encoders say.
#[derive(Debug, Clone, PartialEq)]
pub struct SetPoint {
    /// The joints, rad; index 2 in m.
    pub joints: Axes,
    /// Opening of the jaw, rad, of an arm that has one.
    pub jaw: Option<f64>,
}

/// What the set-points follow.
#[derive(Debug, Clone)]
enum Mode {
    /// Nothing: they stay.
    Still,
    /// What was servoed latest.
    Servo { goal: Axes, velocity: Axes },
    /// A velocity, for as many ticks.
    Velocity { of: Velocity, left: u32 },
    /// A trajectory.
    Move(Progress),
    /// A trajectory to the zeros, on which nothing else is taken.
    Homing(Progress),
    /// Nothing, with no effort: the ideal arm stays.
    Free,
}

/// A velocity that was asked for.
#[derive(Debug, Clone)]
enum Velocity {
    Joints(Axes),
    /// Of the end, in base axes: m/s, rad/s.
    Twist(Vector6<f64>),
}

/// How far a trajectory is.
#[derive(Debug, Clone)]
struct Progress {
    trajectory: Trajectory,
    /// Ticks since it began.
    passed: u64,
}

impl Progress {
    fn new(trajectory: Trajectory) -> Self {
        Self { trajectory, passed: 0 }
    }

    fn seconds(&self) -> f64 {
        self.passed as f64 * TICK
    }

    fn present(&self) -> [Axes; 2] {
        self.trajectory.at(self.seconds())
    }
}

/// Which kind of command came latest: the first Cartesian one is checked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Space {
    Undefined,
    Joint,
    Cartesian,
}

/// Lets a warning pass now and then.
#[derive(Debug, Clone, Default)]
struct Throttle {
    latest: Option<u64>,
    withheld: u32,
}

impl Throttle {
    /// Counts one; if it may pass, how many there were since the last that did.
    fn pass(&mut self, now: u64) -> Option<u32> {
        self.withheld = self.withheld.saturating_add(1);
        if self.latest.is_some_and(|latest| now - latest <= QUIET) {
            return None;
        }
        self.latest = Some(now);
        Some(std::mem::take(&mut self.withheld))
    }
}

/// Positions and velocities of all axes, as encoders have them.
#[derive(Debug, Clone, PartialEq)]
struct Motion {
    position: Axes,
    velocity: Axes,
}

/// Where the remote centre is.
#[derive(Debug, Clone)]
struct BaseFrame {
    /// Name of the reference frame.
    reference: String,
    reference_from_base: Pose,
}

/// The controller of one arm. See the [module](super) for what it does.
#[derive(Debug, Clone)]
pub struct ArmController {
    name: String,
    mechanism: Mechanism,
    drivetrain: Drivetrain,
    base: BaseFrame,
    /// The tool or endoscope, by name, if there is one.
    tool: Option<String>,
    homing: Homing,
    /// Ticks passed, from 1.
    ticks: u64,
    latest: Stamp,
    events: Vec<Event>,
    state: State,
    /// Whether the zeros of all joints are known.
    has_zeros: bool,
    /// Whether a pause interrupted homing.
    resumes_homing: bool,
    mode: Mode,
    space: Space,
    /// Of velocities and of accelerations of moves.
    ratios: [f64; 2],
    setpoint: Motion,
    measured: Motion,
    /// The latest measured positions, the newest last.
    history: ArrayVec<Axes, { AVERAGED + 1 }>,
    /// Estimate of [`Self::own_velocity`] at the tick before the latest, rad/s and m/s.
    own: Axes,
    /// The goal of the jaw's latest move, and whether the jaw was servoed since.
    jaw_moved_to: f64,
    is_jaw_servoed: bool,
    /// Where the jaw is stuck, if it is, rad.
    stuck_jaw: Option<f64>,
    not_ready: Throttle,
    not_inserted: Throttle,
    needs_dynamics: Throttle,
}

impl ArmController {
    /// The controller of an arm that is disabled, whose encoders say `start`: the joints, rad, index 2 in m, and the
    /// jaw of a PSM behind them. Its reference frame is its remote centre, `NAME_base`.
    ///
    /// # Panics
    /// Where `start` has another number of axes than the arm, or is not finite.
    pub fn new(name: impl Into<String>, mechanism: Mechanism, start: &[f64]) -> Self {
        assert_eq!(start.len(), mechanism.axes(), "one number for each axis");
        assert!(start.iter().all(|value| value.is_finite()), "encoders say numbers");
        let name = name.into();
        let position: Axes = start.iter().copied().collect();
        let still = Motion { velocity: zeros(start.len()), position: position.clone() };
        Self {
            base: BaseFrame {
                reference: format!("{name}_base"),
                reference_from_base: Pose::identity(),
            },
            name,
            mechanism,
            drivetrain: Drivetrain::new(start.iter().map(|_| 0.0)),
            tool: Some(mechanism.tool().into()),
            homing: Homing::ToZero,
            ticks: 1,
            latest: Stamp::of_tick(0),
            events: vec![],
            state: State::Disabled,
            own: zeros(start.len()),
            has_zeros: false,
            resumes_homing: false,
            mode: Mode::Still,
            space: Space::Undefined,
            ratios: [1.0; 2],
            setpoint: still.clone(),
            measured: still,
            history: [position].into_iter().collect(),
            jaw_moved_to: start.get(mechanism.joints()).copied().unwrap_or_default(),
            is_jaw_servoed: false,
            stuck_jaw: None,
            not_ready: Throttle::default(),
            not_inserted: Throttle::default(),
            needs_dynamics: Throttle::default(),
        }
    }

    /// The same arm with its remote centre at `reference_from_base` in the reference frame of this name.
    #[must_use]
    pub fn with_base_frame(self, reference: impl Into<String>, reference_from_base: Pose) -> Self {
        let base = BaseFrame { reference: reference.into(), reference_from_base };
        Self { base, ..self }
    }

    /// The same arm that is homed otherwise.
    #[must_use]
    pub fn with_homing(self, homing: Homing) -> Self {
        Self { homing, ..self }
    }

    /// The same arm with another drivetrain.
    #[must_use]
    pub fn with_drivetrain(self, drivetrain: Drivetrain) -> Self {
        Self { drivetrain, ..self }
    }

    /// Does what a command asks for, or says in an event why not. Set-points change with the next tick.
    pub fn command(&mut self, command: &Command) {
        match command {
            Command::State(state) => self.state_command(state),
            Command::Effort(_) => {
                if self.needs_dynamics.pass(self.ticks).is_some() {
                    let command = command.topic();
                    self.emit(What::Warning(Warning::NeedsDynamics { command }));
                }
            }
            Command::SetRatio(ratio) => self.set_ratios(command, *ratio, [true, true]),
            Command::SetRatioV(ratio) => self.set_ratios(command, *ratio, [true, false]),
            Command::SetRatioA(ratio) => self.set_ratios(command, *ratio, [false, true]),
            Command::SetBaseFrame(message) => self.set_base_frame(command, message),
            Command::EmulateAdapterPresent(present) => self.emulate_adapter(command, *present),
            Command::EmulateToolPresent(present) => self.emulate_tool(command, *present),
            Command::SetToolType(name) => self.set_tool(command, name),
            Command::SetEndoscopeType(name) => self.set_endoscope(command, name),
            Command::EmulateFault(fault) => self.emulate_fault(command, fault),
            motion => {
                if let Err(error) = self.motion_command(motion) {
                    self.emit(What::Error(error));
                }
            }
        }
    }

    /// Lets a tick of 1/240 s pass, and returns where its drivetrain brings the links by its end. Say by
    /// [`Self::measure`] where links are that something holds.
    pub fn tick(&mut self) -> SetPoint {
        self.ticks += 1;
        self.own = self.own_velocity();
        let [position, velocity] = self.follow();
        let clipped = self.mechanism.clipped(&position);
        let velocity = velocity.iter().zip(position.iter().zip(&clipped));
        let velocity = velocity.map(|(v, (free, kept))| if free == kept { *v } else { 0.0 });
        self.setpoint = Motion { velocity: velocity.collect(), position: clipped };
        self.finish();
        if self.history.is_full() {
            self.history.remove(0);
        }
        let mut told = self.setpoint.position.clone();
        if let (Some(jaw), Some(stuck)) = (told.get_mut(self.mechanism.joints()), self.stuck_jaw) {
            *jaw = stuck;
        }
        let [encoders, mut joints] = self.drivetrain.advance(&told, TICK);
        self.history.push(encoders.clone());
        let velocity = match self.mode {
            Mode::Servo { .. } => self.mean_velocity(),
            _ if self.drivetrain.gives() => self.mean_velocity(),
            _ => self.setpoint.velocity.clone(),
        };
        self.measured = Motion { position: encoders, velocity };
        if self.drivetrain.gives() {
            self.check_tracking();
        }
        let jaw = (joints.len() > self.mechanism.joints()).then(|| joints.pop()).flatten();
        SetPoint { joints, jaw }
    }

    /// Says where the true links are at the end of a tick, the jaw of a PSM behind the joints: rad, index 2 in m. An
    /// arm that is too far from its set-point faults.
    ///
    /// # Panics
    /// Where there is another number of links than of axes.
    pub fn measure(&mut self, links: &[f64]) {
        assert_eq!(links.len(), self.mechanism.axes(), "one number for each axis");
        let position = self.drivetrain.encoders(links);
        self.history.pop();
        self.history.push(position.clone());
        self.measured = Motion { velocity: self.mean_velocity(), position };
        self.check_tracking();
    }

    /// The events since the last call, oldest first. The owner of a controller takes them at every tick.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Goes on from this state after another one of the same arm: stamps still increase, and the arm tells its state.
    pub fn resume_after(&mut self, present: &Self) {
        (self.ticks, self.latest) = (present.ticks, present.latest);
        self.events.clear();
        self.tell_state();
    }

    /// The operating state.
    pub fn operating_state(&self) -> OperatingState {
        OperatingState {
            state: self.state,
            is_homed: self.has_zeros && self.tool.is_some(),
            is_busy: matches!(self.mode, Mode::Move(_) | Mode::Homing(_)),
        }
    }

    fn emit(&mut self, what: What) {
        self.latest = self.latest.after(self.stamp());
        self.events.push(Event { stamp: self.latest, what });
    }

    /// Tells the operating state.
    fn tell_state(&mut self) {
        self.emit(What::OperatingState(self.operating_state()));
    }

    /// Whether the arm takes motion commands.
    fn readiness(&self) -> Result<(), NotReady> {
        if self.state != State::Enabled {
            return Err(NotReady::State(self.state));
        }
        if !self.has_zeros {
            return Err(NotReady::NotHomed);
        }
        if self.tool.is_none() { Err(NotReady::NoTool) } else { Ok(()) }
    }

    /// The mean velocity of the latest ticks.
    fn mean_velocity(&self) -> Axes {
        let (newest, oldest) = (&self.history[self.history.len() - 1], &self.history[0]);
        let seconds = (self.history.len() - 1) as f64 * TICK;
        let change = |(newest, oldest): (&f64, &f64)| {
            if seconds > 0.0 { (newest - oldest) / seconds } else { 0.0 }
        };
        newest.iter().zip(oldest).map(change).collect()
    }

    /// Faults where an axis of an arm that moves is too far from its set-point, unless that is at a limit.
    fn check_tracking(&mut self) {
        if self.state != State::Enabled || !self.has_zeros || matches!(self.mode, Mode::Free) {
            return;
        }
        let tolerances = self.mechanism.tolerances();
        for (axis, tolerance) in tolerances.iter().copied().enumerate() {
            let (is, should) = (self.measured.position[axis], self.setpoint.position[axis]);
            let limit = self.mechanism.limit(axis);
            let by = (is - should).abs();
            if by > tolerance && should > limit.min && should < limit.max {
                self.fault(Error::Tracking { joint: limit.name, by, tolerance });
                return;
            }
        }
    }
}

/// What an event quotes of a client's text.
fn quoted(text: &str) -> String {
    text.chars().take(QUOTED).collect()
}

/// As many zeros.
fn zeros(count: usize) -> Axes {
    (0..count).map(|_| 0.0).collect()
}
