//! The behaviour that scripts of real robots rely on, in lock-step: see the files for whose.

use super::command::PoseMessage;
use super::{ArmController, Command, Event, Mechanism, Pose, State, StateCommand, TICK, What};
use crate::robots::{Ecm, Psm};
use crate::sim::random::Rng;

mod fuzz;
mod kinematics;
mod misuse;
mod planner;
mod scenarios;
mod set_points;
mod settings;
mod topics;

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// How long a client's handle waits, s.
const PATIENCE: f64 = 30.0;

/// What rounding may add to a limit of velocity or acceleration.
const ROUNDING: f64 = 1e-9;

/// A script at the other end: it sends, lets ticks pass, and reads. At each tick it checks what always holds.
struct Script {
    arm: ArmController,
    heard: Vec<Event>,
}

impl Script {
    fn new(mechanism: &Mechanism) -> Self {
        let start = vec![0.0; mechanism.axes()];
        let name = if matches!(mechanism, Mechanism::Psm(_)) { "PSM1" } else { "ECM" };
        Self { arm: ArmController::new(name, *mechanism, &start), heard: vec![] }
    }

    /// A PSM of the first generation, enabled and homed.
    fn psm() -> Self {
        Self::new(&Mechanism::Psm(Psm::CLASSIC)).homed()
    }

    /// An ECM of the first generation, enabled and homed.
    fn ecm() -> Self {
        Self::new(&Mechanism::Ecm(Ecm::CLASSIC)).homed()
    }

    fn homed(mut self) -> Self {
        self.send(Command::State(StateCommand::Enable));
        self.wait(Command::State(StateCommand::Home)).expect("homing ends");
        assert!(self.arm.operating_state().is_homed);
        self
    }

    #[expect(clippy::needless_pass_by_value, reason = "a script makes a command to send it")]
    fn send(&mut self, command: Command) {
        self.arm.command(&command);
        self.listen();
    }

    fn listen(&mut self) {
        for event in self.arm.take_events() {
            let before = self.heard.last().map_or(0, |event| event.stamp.nanoseconds());
            let stamp = event.stamp.nanoseconds();
            assert!(stamp > before, "a client would ignore {event:?}");
            self.heard.push(event);
        }
    }

    fn tick(&mut self) {
        let arm = &self.arm;
        let (before, was_busy) = (arm.setpoint_js(), arm.operating_state().is_busy);
        let now = arm.stamp();
        let set_point = self.arm.tick();
        self.listen();
        let arm = &self.arm;
        assert!(arm.stamp() > now);
        let set = arm.setpoint_js();
        // The ideal arm is at its set-point, and its links are where its encoders say.
        assert_eq!(arm.measured_js().position, set.position);
        if arm.tool().is_some() {
            assert_eq!(set_point.joints, set.position);
            let fk = arm.forward_kinematics(&set.position).unwrap();
            assert!(far(&fk, &arm.measured_cp().unwrap()) < 1e-9);
            let base = arm.base_frame() * arm.local_measured_cp().unwrap();
            assert!(far(&base, &arm.measured_cp().unwrap()) < 1e-9);
        }
        for (axis, position) in set.position.iter().enumerate() {
            let limit = arm.mechanism().limit(axis);
            assert!(position.is_finite() && limit.contains(*position) || arm.tool().is_none());
            if was_busy && arm.operating_state().is_busy {
                let [speed, last] = [&set, &before].map(|state| state.velocity[axis]);
                assert!(speed.abs() <= limit.max_velocity + ROUNDING, "axis {axis}: {speed}");
                let change = (speed - last).abs() / TICK;
                assert!(change <= limit.max_acceleration + ROUNDING, "axis {axis}: {change}");
            }
        }
    }

    /// Lets time pass.
    fn run(&mut self, seconds: f64) {
        for _ in 0..ticks(seconds) {
            self.tick();
        }
    }

    /// Sends a command at each of 100 times a second for `seconds`; before each, `see` sees the arm.
    fn stream(
        &mut self,
        seconds: f64,
        mut command: impl FnMut(f64) -> Command,
        mut see: impl FnMut(&ArmController, f64),
    ) {
        let mut next = 0;
        for tick in 0..ticks(seconds) {
            // The 100 Hz of the script against the 240 Hz of the arm.
            while next * 240 <= tick * 100 {
                let time = next as f64 / 100.0;
                see(&self.arm, time);
                self.send(command(time));
                next += 1;
            }
            self.tick();
        }
    }

    /// Sends a command and waits as a handle does: until the arm was busy since and is not any more. The time that
    /// it took, s; nothing where the handle would lose its patience.
    fn wait(&mut self, command: Command) -> Option<f64> {
        let handle = self.handle(command);
        self.wait_for(handle)
    }

    /// Sends a command; since when its handle listens.
    fn handle(&mut self, command: Command) -> usize {
        let handle = self.heard.len();
        self.send(command);
        handle
    }

    fn wait_for(&mut self, handle: usize) -> Option<f64> {
        for tick in 0..ticks(PATIENCE) {
            let states = self.heard[handle..].iter().filter_map(|event| match event.what {
                What::OperatingState(state) => Some(state.is_busy),
                _ => None,
            });
            let states: Vec<bool> = states.collect();
            if states.contains(&true) && states.last() == Some(&false) {
                return Some(tick as f64 * TICK);
            }
            self.tick();
        }
        None
    }

    /// Whether the handle of a command sees the arm busy at once.
    fn is_busy_after(&mut self, command: Command) -> bool {
        let handle = self.handle(command);
        self.heard[handle..]
            .iter()
            .any(|event| matches!(event.what, What::OperatingState(state) if state.is_busy))
    }

    /// The results of moves since `from`.
    fn reached(&self, from: usize) -> Vec<bool> {
        let reached = |event: &Event| match event.what {
            What::GoalReached(reached) => Some(reached),
            _ => None,
        };
        self.heard[from..].iter().filter_map(reached).collect()
    }

    /// Warnings and errors since `from`, in words.
    fn complaints(&self, from: usize) -> Vec<String> {
        let complaint = |event: &Event| match &event.what {
            What::Warning(warning) => Some(format!("warning: {warning}")),
            What::Error(error) => Some(format!("error: {error}")),
            _ => None,
        };
        self.heard[from..].iter().filter_map(complaint).collect()
    }

    /// How many operating states were told since `from`.
    fn states(&self, from: usize) -> usize {
        let is_state = |event: &&Event| matches!(event.what, What::OperatingState(_));
        self.heard[from..].iter().filter(is_state).count()
    }

    fn joints(&self) -> Vec<f64> {
        self.arm.setpoint_js().position.to_vec()
    }

    fn jaw(&self) -> f64 {
        self.arm.jaw_measured_js().unwrap().position[0]
    }

    /// `insert_jp` of dVRK's Python client.
    fn insert(&self, depth: f64) -> Command {
        let mut joints = self.joints();
        joints[2] = depth;
        Command::MoveJp(joints)
    }

    /// `move_cp` to where the arm would be after a step from `from`.
    fn step_from(from: &Pose, step: [f64; 3]) -> Command {
        let mut goal = *from;
        goal.translation.vector += nalgebra::Vector3::from(step);
        Command::MoveCp(PoseMessage::new(&goal))
    }
}

fn ticks(seconds: f64) -> u64 {
    (seconds / TICK).round() as u64
}

/// Each move ends within two ticks of its closed form.
#[track_caller]
fn assert_took(took: Option<f64>, seconds: f64) {
    let took = took.expect("the arm was busy and then was not");
    assert!(
        took >= seconds - ROUNDING && took <= seconds + 2.0 * TICK,
        "{took} s, not {seconds} s"
    );
}

/// Time from rest to rest.
fn rest_to_rest(distance: f64, velocity: f64, acceleration: f64) -> f64 {
    let distance = distance.abs();
    if distance <= velocity * velocity / acceleration {
        2.0 * (distance / acceleration).sqrt()
    } else {
        distance / velocity + velocity / acceleration
    }
}

/// The larger of distance (m) and turn (rad) between two poses.
fn far(one: &Pose, other: &Pose) -> f64 {
    let chord =
        one.rotation.to_rotation_matrix().matrix() - other.rotation.to_rotation_matrix().matrix();
    (one.translation.vector - other.translation.vector).norm().max(chord.norm() / 2.0_f64.sqrt())
}

#[track_caller]
fn assert_near(values: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(values.len(), expected.len());
    let near = values.iter().zip(expected).all(|(one, other)| (one - other).abs() <= tolerance);
    assert!(near, "{values:?}, not {expected:?}");
}
