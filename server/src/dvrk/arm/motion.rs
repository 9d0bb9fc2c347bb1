//! Motion commands: servo, move, hold, free.

use nalgebra::Vector3;

use super::{
    ArmController, Mode, Motion, Progress, ROUNDING, Space, VELOCITY_SECONDS, Velocity, zeros,
};
use crate::dvrk::TICKS_PER_SECOND;
use crate::dvrk::command::{self, Command, Malformed, PoseMessage};
use crate::dvrk::event::{Error, NotReady, Warning, What};
use crate::dvrk::mechanism::Pose;
use crate::dvrk::planner::Trajectory;
use crate::robots::Axes;

/// Least time of homing, s: a script must not miss its beginning.
const LEAST_HOMING: f64 = 0.1;

impl ArmController {
    /// Does what a motion command asks for; others are done elsewhere. What is malformed is refused, whatever the
    /// state.
    pub(super) fn motion_command(&mut self, command: &Command) -> Result<(), Error> {
        let topic = command.topic();
        match command {
            Command::Hold => {
                if self.is_ready(topic) {
                    self.servo(&self.setpoint.position.clone(), zeros(self.mechanism.axes()));
                    self.space = Space::Joint;
                }
            }
            Command::Free => {
                if self.is_ready(topic) {
                    self.interrupt();
                    (self.mode, self.space) = (Mode::Free, Space::Joint);
                }
            }
            Command::ServoJp { position, velocity } => {
                let position = self.joints(topic, position)?;
                let velocity = match velocity.as_slice() {
                    [] => zeros(position.len()),
                    velocity => self.joints(topic, velocity)?,
                };
                self.servo_joints(topic, &position, &velocity);
            }
            Command::ServoJr(step) => {
                let step = self.joints(topic, step)?;
                let goal = sum(&self.servo_base(), &step);
                self.servo_joints(topic, &goal, &zeros(goal.len()));
            }
            Command::ServoJv(velocity) => {
                let joints = self.joints(topic, velocity)?;
                if self.is_ready(topic) {
                    self.space = Space::Joint;
                    self.servo_velocity(Velocity::Joints(joints));
                }
            }
            Command::ServoCp(message) => {
                let pose = self.local(topic, message)?;
                if self.is_ready_in_space(topic) {
                    self.servo_pose(topic, &pose)?;
                }
            }
            Command::ServoCr(message) => {
                let step = self.local_step(topic, message)?;
                if self.is_ready_in_space(topic) {
                    let pose = stepped(&self.mechanism.forward(&self.servo_base()), &step);
                    self.servo_pose(topic, &pose)?;
                }
            }
            Command::ServoCv(twist) => {
                let twist = self.local_twist(topic, twist)?;
                if self.is_ready_in_space(topic) {
                    self.servo_velocity(Velocity::Twist(twist));
                }
            }
            Command::MoveJp(position) => {
                let position = self.joints(topic, position)?;
                self.move_joints(topic, &position);
            }
            Command::MoveJr(step) => {
                let step = self.joints(topic, step)?;
                self.move_joints(topic, &sum(&self.move_base(), &step));
            }
            Command::MoveCp(message) => {
                let pose = self.local(topic, message)?;
                if self.is_ready_in_space(topic) {
                    self.move_pose(topic, &pose)?;
                }
            }
            Command::MoveCr(message) => {
                let step = self.local_step(topic, message)?;
                if self.is_ready_in_space(topic) {
                    let pose = stepped(&self.mechanism.forward(&self.move_base()), &step);
                    self.move_pose(topic, &pose)?;
                }
            }
            Command::JawServoJp(angle) => self.jaw_servo(topic, angle)?,
            Command::JawMoveJp(angle) => self.jaw_move(topic, angle)?,
            Command::State(_)
            | Command::Effort(_)
            | Command::SetRatio(_)
            | Command::SetRatioV(_)
            | Command::SetRatioA(_)
            | Command::SetBaseFrame(_)
            | Command::EmulateAdapterPresent(_)
            | Command::EmulateToolPresent(_)
            | Command::SetToolType(_)
            | Command::SetEndoscopeType(_)
            | Command::EmulateFault(_) => {}
        }
        Ok(())
    }

    /// Whether the arm takes motion commands; where not, it says so now and then.
    pub(super) fn is_ready(&mut self, command: &'static str) -> bool {
        match self.readiness() {
            Ok(()) => {
                self.not_ready = super::Throttle::default();
                true
            }
            Err(why) => {
                self.warn_not_ready(command, why);
                false
            }
        }
    }

    fn warn_not_ready(&mut self, command: &'static str, why: NotReady) {
        if let Some(ignored) = self.not_ready.pass(self.ticks) {
            self.emit(What::Warning(Warning::NotReady { command, why, ignored }));
        }
    }

    /// Whether the arm takes Cartesian commands, which it enters where it was given others.
    fn is_ready_in_space(&mut self, command: &'static str) -> bool {
        if !self.is_ready(command) {
            return false;
        }
        let is_inserted =
            self.space == Space::Cartesian || self.mechanism.is_inserted(&self.measured.position);
        if is_inserted {
            self.space = Space::Cartesian;
            self.not_inserted = super::Throttle::default();
        } else if self.not_inserted.pass(self.ticks).is_some() {
            self.emit(What::Warning(Warning::NotInserted { command }));
        }
        is_inserted
    }

    /// A number for each joint, or why not.
    fn joints(&self, command: &'static str, numbers: &[f64]) -> Result<Axes, Error> {
        let (got, expected) = (numbers.len(), self.mechanism.joints());
        if got != expected {
            return Err(Error::WrongCount { command, got, expected });
        }
        match numbers.iter().position(|value| !command::is_position(*value)) {
            Some(index) => Err(Error::NotFinite { command, index, value: numbers[index] }),
            None => Ok(numbers.iter().copied().collect()),
        }
    }

    /// A pose in the base frame, or why there is none.
    fn local(&self, command: &'static str, message: &PoseMessage) -> Result<Pose, Error> {
        let pose = read(command, message)?;
        Ok(if self.is_in_reference(command, message)? {
            self.base.reference_from_base.inv_mul(&pose)
        } else {
            pose
        })
    }

    /// A step and a turn in the axes of the base frame.
    fn local_step(&self, command: &'static str, message: &PoseMessage) -> Result<Pose, Error> {
        let step = read(command, message)?;
        Ok(if self.is_in_reference(command, message)? {
            let turn = self.base.reference_from_base.rotation;
            let rotation = turn.inverse() * step.rotation * turn;
            Pose::from_parts((turn.inverse() * step.translation.vector).into(), rotation)
        } else {
            step
        })
    }

    /// Whether a message is in the reference frame: otherwise it is in the base frame, or refused.
    fn is_in_reference(&self, command: &'static str, message: &PoseMessage) -> Result<bool, Error> {
        let base = format!("{}_base", self.name);
        match message.frame.as_str() {
            "" => Ok(true),
            frame if frame == self.base.reference => Ok(true),
            frame if frame == base => Ok(false),
            frame => Err(Error::UnknownFrame {
                command,
                frame: super::quoted(frame),
                reference: self.base.reference.clone(),
                base,
            }),
        }
    }

    /// The joints from which a servoed step counts.
    fn servo_base(&self) -> Axes {
        match &self.mode {
            Mode::Servo { goal, .. } => goal.clone(),
            _ => self.setpoint.position.clone(),
        }
    }

    /// The joints from which the step of a move counts.
    fn move_base(&self) -> Axes {
        match &self.mode {
            Mode::Move(progress) => progress.trajectory.goal().clone(),
            _ => self.setpoint.position.clone(),
        }
    }

    /// Where the axes are asked to be in the end.
    pub(super) fn goal(&self) -> Axes {
        match &self.mode {
            Mode::Servo { goal, .. } => goal.clone(),
            Mode::Move(progress) | Mode::Homing(progress) => progress.trajectory.goal().clone(),
            Mode::Velocity { .. } | Mode::Still | Mode::Free => self.setpoint.position.clone(),
        }
    }

    /// Servoes the joints; the jaw goes on as it was servoed, or stops.
    fn servo_joints(&mut self, command: &'static str, joints: &[f64], velocity: &[f64]) {
        if self.is_ready(command) {
            self.space = Space::Joint;
            let goal = self.with_jaw(joints, &self.servo_base());
            let still = zeros(self.mechanism.axes());
            self.servo(&goal, self.with_jaw(velocity, &still));
        }
    }

    fn servo_pose(&mut self, command: &'static str, base_from_end: &Pose) -> Result<(), Error> {
        let seed = &self.measured.position[..self.mechanism.joints()];
        match self.mechanism.inverse(base_from_end, seed) {
            Ok(joints) => {
                let goal = self.with_jaw(&joints, &self.servo_base());
                self.servo(&goal, zeros(self.mechanism.axes()));
                Ok(())
            }
            Err(why) => {
                // The set-point before is held.
                self.servo(&self.servo_base(), zeros(self.mechanism.axes()));
                Err(Error::InverseKinematics { command, why })
            }
        }
    }

    /// Follows set-points of all axes, clipped silently.
    pub(super) fn servo(&mut self, goal: &[f64], velocity: Axes) {
        self.interrupt();
        self.mode = Mode::Servo { goal: self.mechanism.clipped(goal), velocity };
    }

    fn servo_velocity(&mut self, of: Velocity) {
        self.interrupt();
        let left = (VELOCITY_SECONDS * TICKS_PER_SECOND as f64) as u32;
        self.mode = Mode::Velocity { of, left };
    }

    fn move_joints(&mut self, command: &'static str, joints: &[f64]) {
        if self.is_ready(command) {
            self.space = Space::Joint;
            self.warn_of_jaw(command);
            let clipped = self.mechanism.clipped(joints);
            let goal = self.with_jaw(&clipped, &self.goal());
            self.move_axes(&goal);
        }
    }

    fn move_pose(&mut self, command: &'static str, base_from_end: &Pose) -> Result<(), Error> {
        let seed = &self.measured.position[..self.mechanism.joints()];
        match self.mechanism.inverse(base_from_end, seed) {
            Ok(joints) => {
                self.warn_of_jaw(command);
                let clipped = self.mechanism.clipped(&joints);
                let goal = self.with_jaw(&clipped, &self.goal());
                self.move_axes(&goal);
                Ok(())
            }
            Err(why) => {
                // A move that is under way has no goal any more.
                if !self.interrupt() {
                    self.emit(What::GoalReached(false));
                    self.tell_state();
                }
                Err(Error::InverseKinematics { command, why })
            }
        }
    }

    /// Plans a move of all axes, from the present velocity. One that is under way is replaced: no event tells.
    pub(super) fn move_axes(&mut self, goal: &[f64]) {
        self.plan(goal);
        self.tell_state();
    }

    fn plan(&mut self, goal: &[f64]) {
        let [position, velocity] = self.present();
        let limits = self.mechanism.axis_limits(self.ratios);
        let trajectory = Trajectory::plan(&position, &velocity, goal, &limits);
        self.mode = Mode::Move(Progress::new(trajectory));
    }

    /// Plans a move that is under way again, at other ratios.
    pub(super) fn replan(&mut self) {
        if let Mode::Move(progress) = &self.mode {
            let goal = progress.trajectory.goal().clone();
            self.plan(&goal);
        }
    }

    /// Where a trajectory begins: with the arm's own velocity after set-points, at rest after nothing.
    fn present(&self) -> [Axes; 2] {
        let Motion { position, .. } = &self.setpoint;
        match &self.mode {
            Mode::Move(progress) | Mode::Homing(progress) => progress.present(),
            Mode::Servo { .. } | Mode::Velocity { .. } => [position.clone(), self.own_velocity()],
            Mode::Still | Mode::Free => [position.clone(), zeros(position.len())],
        }
    }

    /// Ends a move or homing before its goal, if there is one; returns whether there was.
    pub(super) fn interrupt(&mut self) -> bool {
        let was_move = matches!(self.mode, Mode::Move(_));
        let was_busy = was_move || matches!(self.mode, Mode::Homing(_));
        if was_busy {
            self.mode = Mode::Still;
            self.setpoint.velocity = zeros(self.mechanism.axes());
            if was_move {
                self.emit(What::GoalReached(false));
            }
            self.tell_state();
        }
        was_busy
    }

    /// Positions and velocities of all axes at the end of this tick, not clipped.
    pub(super) fn follow(&mut self) -> [Axes; 2] {
        match &mut self.mode {
            Mode::Still | Mode::Free => {
                let position = self.setpoint.position.clone();
                [position, zeros(self.mechanism.axes())]
            }
            Mode::Servo { goal, velocity } => [goal.clone(), velocity.clone()],
            Mode::Move(progress) | Mode::Homing(progress) => {
                progress.passed += 1;
                progress.present()
            }
            Mode::Velocity { left: 0, .. } => {
                self.mode = Mode::Still;
                self.follow()
            }
            Mode::Velocity { of, left } => {
                *left -= 1;
                let of = of.clone();
                self.follow_velocity(&of)
            }
        }
    }

    /// Ends a trajectory that has come to its end.
    pub(super) fn finish(&mut self) {
        let (progress, least) = match &self.mode {
            Mode::Move(progress) => (progress, 0.0),
            Mode::Homing(progress) => (progress, LEAST_HOMING),
            _ => return,
        };
        let is_homing = matches!(self.mode, Mode::Homing(_));
        if progress.seconds() + ROUNDING < progress.trajectory.duration().max(least) {
            return;
        }
        self.setpoint.position = self.mechanism.clipped(progress.trajectory.goal());
        self.setpoint.velocity = zeros(self.mechanism.axes());
        self.mode = Mode::Still;
        if is_homing {
            self.has_zeros = true;
        } else {
            self.emit(What::GoalReached(true));
        }
        self.tell_state();
    }
}

/// The pose of a message, or why there is none.
pub(super) fn read(command: &'static str, message: &PoseMessage) -> Result<Pose, Error> {
    message.pose().map_err(|malformed| match malformed {
        Malformed::Position(index) => {
            Error::NotFinite { command, index, value: message.position[index] }
        }
        Malformed::Orientation => Error::NotARotation { command },
    })
}

/// The pose after a step and a turn about its own origin, both in base axes.
fn stepped(base_from_end: &Pose, step: &Pose) -> Pose {
    let position: Vector3<f64> = base_from_end.translation.vector + step.translation.vector;
    Pose::from_parts(position.into(), step.rotation * base_from_end.rotation)
}

/// The first axes of `base` moved by `step`.
fn sum(base: &[f64], step: &[f64]) -> Axes {
    base.iter().zip(step).map(|(base, step)| base + step).collect()
}
