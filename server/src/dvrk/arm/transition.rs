//! Operating states: commands that change them, and faults.

use super::{ArmController, Mode, Progress, Space, quoted, zeros};
use crate::dvrk::Homing;
use crate::dvrk::command::{Command, Fault, StateCommand};
use crate::dvrk::event::{Error, Warning, What};
use crate::dvrk::planner::Trajectory;
use crate::dvrk::state::State;

impl ArmController {
    /// Every `state_command` is answered by the state, whether it changes or not.
    pub(super) fn state_command(&mut self, command: &StateCommand) {
        if self.state.takes(command) {
            self.enter(command);
        } else {
            self.emit(What::Warning(match command {
                StateCommand::Unknown(word) => Warning::UnknownStateCommand(quoted(word)),
                _ => Warning::StateCommand { command: command.word().into(), state: self.state },
            }));
        }
        self.tell_state();
    }

    fn enter(&mut self, command: &StateCommand) {
        match command {
            StateCommand::Enable => self.state = State::Enabled,
            StateCommand::Disable => self.lose_power(State::Disabled),
            StateCommand::Home if !self.has_zeros => self.begin_homing(),
            StateCommand::Unhome => {
                self.interrupt();
                self.has_zeros = false;
                self.rest();
            }
            StateCommand::Pause if self.state == State::Enabled => {
                self.resumes_homing = matches!(self.mode, Mode::Homing(_));
                self.interrupt();
                self.state = State::Paused;
                self.rest();
            }
            StateCommand::Resume => {
                self.state = State::Enabled;
                if std::mem::take(&mut self.resumes_homing) {
                    self.begin_homing();
                }
            }
            StateCommand::Home | StateCommand::Pause | StateCommand::Unknown(_) => {}
        }
    }

    /// Stops the arm where it is, which loses its power and its zeros.
    fn lose_power(&mut self, state: State) {
        self.interrupt();
        self.setpoint.position = self.mechanism.clipped(&self.measured.position);
        self.state = state;
        self.has_zeros = false;
        self.resumes_homing = false;
        self.rest();
    }

    /// Something went wrong.
    pub(super) fn fault(&mut self, why: Error) {
        self.emit(What::Error(why));
        self.lose_power(State::Fault);
        self.tell_state();
    }

    /// Lets something go wrong, so that scripts can be tried with it.
    pub(super) fn emulate_fault(&mut self, command: &Command, fault: &Fault) {
        let jaw = self.measured.position.get(self.mechanism.joints()).copied();
        match (fault, jaw) {
            (Fault::None, _) => self.stuck_jaw = None,
            (Fault::Fault, _) => self.fault(Error::Emulated),
            (Fault::LostHoming, _) => {
                self.enter(&StateCommand::Unhome);
                self.tell_state();
            }
            (Fault::StuckJaw, Some(_)) => self.stuck_jaw = jaw,
            (Fault::StuckJaw, None) => {
                self.emit(What::Error(Error::NotOnThisArm { command: command.topic() }));
            }
            (Fault::Unknown(word), _) => {
                self.emit(What::Error(Error::UnknownFault { word: quoted(word) }));
            }
        }
    }

    /// Stays where it is.
    fn rest(&mut self) {
        self.mode = Mode::Still;
        self.space = Space::Undefined;
        self.setpoint.velocity = zeros(self.mechanism.axes());
    }

    /// Homing is a trajectory: to the zeros, or to where the arm is.
    fn begin_homing(&mut self) {
        if matches!(self.mode, Mode::Homing(_)) {
            return;
        }
        let home = match self.homing {
            Homing::ToZero => self.mechanism.home(),
            Homing::InPlace => self.setpoint.position.clone(),
        };
        self.jaw_moved_to = home.get(self.mechanism.joints()).copied().unwrap_or_default();
        self.is_jaw_servoed = false;
        let limits = self.mechanism.axis_limits(self.ratios);
        let still = zeros(home.len());
        let trajectory = Trajectory::plan(&self.setpoint.position, &still, &home, &limits);
        self.mode = Mode::Homing(Progress::new(trajectory));
    }
}
