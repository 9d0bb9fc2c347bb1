//! The jaw: the last axis of the arm's own trajectory.

use super::{ArmController, Mode, Space, zeros};
use crate::dvrk::command;
use crate::dvrk::event::{Error, Warning, What};
use crate::robots::Axes;

/// Furthest angle to which the jaw's part of a trajectory is planned, rad. dVRK clips the jaw's way there, not its
/// goal: a move to an angle beyond the limit takes as long as if there were none.
const FURTHEST: f64 = std::f64::consts::TAU;

/// What counts as another angle, rad.
const ANOTHER: f64 = 1e-3;

impl ArmController {
    /// Servoes the jaw; the joints go on as they were servoed, or stop.
    pub(super) fn jaw_servo(&mut self, command: &'static str, angle: &[f64]) -> Result<(), Error> {
        let angle = self.jaw_angle(command, angle)?;
        if self.is_ready(command) {
            self.stay_cartesian();
            let (mut goal, velocity) = match &self.mode {
                Mode::Servo { goal, velocity } => (goal.clone(), velocity.clone()),
                _ => (self.setpoint.position.clone(), zeros(self.mechanism.axes())),
            };
            goal[self.mechanism.joints()] = angle;
            self.servo(&goal, velocity);
            self.is_jaw_servoed = true;
        }
        Ok(())
    }

    /// Moves the jaw: the trajectory of a move that is under way is planned again, with another goal of the jaw.
    pub(super) fn jaw_move(&mut self, command: &'static str, angle: &[f64]) -> Result<(), Error> {
        let angle = self.jaw_angle(command, angle)?;
        if self.is_ready(command) {
            self.stay_cartesian();
            let mut goal = self.goal();
            goal[self.mechanism.joints()] = angle.clamp(-FURTHEST, FURTHEST);
            (self.jaw_moved_to, self.is_jaw_servoed) = (angle, false);
            self.move_axes(&goal);
        }
        Ok(())
    }

    /// Some joints, and the jaw of other axes behind them.
    pub(super) fn with_jaw(&self, joints: &[f64], others: &[f64]) -> Axes {
        let joints = &joints[..self.mechanism.joints()];
        joints.iter().chain(&others[joints.len()..]).copied().collect()
    }

    /// Says that a move leaves the jaw where it was servoed, once.
    pub(super) fn warn_of_jaw(&mut self, command: &'static str) {
        if !std::mem::take(&mut self.is_jaw_servoed) {
            return;
        }
        let jaw = self.goal()[self.mechanism.joints()];
        let stale = std::mem::replace(&mut self.jaw_moved_to, jaw);
        if (jaw - stale).abs() > ANOTHER {
            self.emit(What::Warning(Warning::JawStays { command, jaw, stale }));
        }
    }

    /// Commands of the jaw leave an arm in Cartesian space where it is in it.
    fn stay_cartesian(&mut self) {
        if self.space != Space::Cartesian {
            self.space = Space::Joint;
        }
    }

    /// The one angle of a command, or why there is none.
    fn jaw_angle(&self, command: &'static str, angle: &[f64]) -> Result<f64, Error> {
        if self.mechanism.axes() == self.mechanism.joints() {
            return Err(Error::NotOnThisArm { command });
        }
        match angle {
            [angle] if command::is_position(*angle) => Ok(*angle),
            [value] => Err(Error::NotFinite { command, index: 0, value: *value }),
            _ => Err(Error::WrongCount { command, got: angle.len(), expected: 1 }),
        }
    }
}
