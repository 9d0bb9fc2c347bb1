//! Settings of an arm: ratios of moves, base frame, tool.

use super::{ArmController, BaseFrame, motion, quoted};
use crate::dvrk::command::{Command, PoseMessage};
use crate::dvrk::event::{Error, Warning, What};
use crate::dvrk::mechanism::Mechanism;

impl ArmController {
    /// Sets the ratios of velocity and acceleration that are `meant`. A move that is under way goes on at them.
    pub(super) fn set_ratios(&mut self, command: &Command, ratio: f64, meant: [bool; 2]) {
        if !(ratio > 0.0 && ratio <= 1.0) {
            let command = command.topic();
            self.emit(What::Warning(Warning::Ratio { command, ratio }));
            return;
        }
        for (index, _) in meant.iter().enumerate().filter(|(_, meant)| **meant) {
            self.ratios[index] = ratio;
            let of = [What::RatioV, What::RatioA][index];
            self.emit(of(ratio));
        }
        self.emit(What::Ratio(self.ratio()));
        self.replan();
    }

    /// Sets where the remote centre is. A message without a frame leaves the name of the reference frame.
    pub(super) fn set_base_frame(&mut self, command: &Command, message: &PoseMessage) {
        match motion::read(command.topic(), message) {
            Ok(reference_from_base) => {
                let reference = match message.frame.as_str() {
                    "" => self.base.reference.clone(),
                    frame => quoted(frame),
                };
                self.base = BaseFrame { reference, reference_from_base };
            }
            Err(error) => self.emit(What::Error(error)),
        }
    }

    /// An adapter that is taken off takes the tool with it.
    pub(super) fn emulate_adapter(&mut self, command: &Command, is_present: bool) {
        if is_present && matches!(self.mechanism, Mechanism::Psm(_)) {
            return;
        }
        self.emulate_tool(command, false);
    }

    /// Puts the tool in or takes it out, at once.
    pub(super) fn emulate_tool(&mut self, command: &Command, is_present: bool) {
        if matches!(self.mechanism, Mechanism::Ecm(_)) {
            self.emit(What::Error(Error::NotOnThisArm { command: command.topic() }));
            return;
        }
        if is_present == self.tool.is_some() {
            return;
        }
        self.interrupt();
        self.tool = is_present.then(|| self.mechanism.tool().into());
        if let Some(tool) = self.tool.clone() {
            self.emit(What::ToolType(tool));
        }
        self.tell_state();
    }

    /// Puts in a tool of the kind that is simulated, in any version.
    pub(super) fn set_tool(&mut self, command: &Command, name: &str) {
        let known = self.mechanism.tool();
        let command = command.topic();
        let error = match self.mechanism {
            Mechanism::Ecm(_) => Error::NotOnThisArm { command },
            Mechanism::Psm(_) if is_version_of(name, known) => {
                self.tool = Some(quoted(name));
                self.emit(What::ToolType(quoted(name)));
                self.tell_state();
                return;
            }
            Mechanism::Psm(_) => Error::UnknownTool { command, name: quoted(name), known },
        };
        self.emit(What::Error(error));
    }

    /// Puts in an endoscope of the arm's generation. A move that is under way goes on.
    pub(super) fn set_endoscope(&mut self, command: &Command, name: &str) {
        let (known, command) = (self.mechanism.tool(), command.topic());
        match self.mechanism.with_endoscope(name) {
            Some(mechanism) => {
                (self.mechanism, self.tool) = (mechanism, Some(name.into()));
                self.emit(What::EndoscopeType(name.into()));
            }
            None => self.emit(What::Error(match self.mechanism {
                Mechanism::Psm(_) => Error::NotOnThisArm { command },
                Mechanism::Ecm(_) => Error::UnknownTool { command, name: quoted(name), known },
            })),
        }
    }
}

/// Whether `name` is `known`, or that with a version in brackets.
fn is_version_of(name: &str, known: &str) -> bool {
    name.strip_prefix(known)
        .is_some_and(|rest| rest.is_empty() || (rest.starts_with('[') && rest.ends_with(']')))
}
