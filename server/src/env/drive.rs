//! An environment whose arms are driven from outside, substep by substep.

use super::Env;
use crate::error::StepError;
use crate::sim::instrument::Posture;
use crate::sim::motion::{Arrival, Instruments, Motion, Profiles};
use crate::tasks::AnyTask;

/// The instrument arms of an environment in the hands of a controller: it gives set-points that may change at every
/// substep, and what stops a step's motion stops these, too. Observations, goals and success are those of the
/// task, as of the latest [`Drive::sense`].
pub struct Drive<'a> {
    env: &'a mut Env,
    motion: Motion,
    /// Whether the set-points are those of an action that the task has been given.
    is_commanded: bool,
}

impl Env {
    /// Takes the instrument arms in hand, from where they are. No step passes meanwhile, and the episode cannot be
    /// exported any more: no actions lead to its state.
    pub fn drive(&mut self) -> Result<Drive<'_>, StepError> {
        if self.needs_reset() {
            return Err(StepError::ResetNeeded);
        }
        self.is_driven = true;
        let motion = from_here(self.task.as_mut());
        Ok(Drive { env: self, motion, is_commanded: false })
    }
}

impl Drive<'_> {
    /// The environment.
    pub fn env(&self) -> &Env {
        self.env
    }

    /// Gives the task an action, as a step does, and returns where that step would bring the arms: set-points to
    /// follow, or to depart from.
    pub fn command(&mut self, action: &[f32]) -> Result<Profiles, StepError> {
        self.env.check(action)?;
        self.sense();
        let task = self.env.task.as_mut();
        task.command(&mut self.env.world, Some(action));
        (self.motion, self.is_commanded) = (from_here(task), true);
        Ok(task.arms().iter().map(|arm| arm.profile().clone()).collect())
    }

    /// Lets one substep, 1/240 s, pass, in which each arm goes to its set-point: the true wrist in the scene frame,
    /// and the opening of its jaws. An arm that is held up is as many set-points behind.
    ///
    /// # Panics
    /// Where there is not one set-point for each arm.
    pub fn advance(&mut self, set_points: &[Posture]) {
        self.motion.push(set_points);
        let mut arms = self.env.task.arms();
        let mut instruments: Instruments<'_> =
            arms.iter_mut().map(|arm| arm.instrument()).collect();
        self.motion.pass(1, &mut instruments, &mut self.env.world);
        self.env.seen.is_present = false;
    }

    /// Lets the sensors report where the arms are, and the task take note of it.
    pub fn sense(&mut self) {
        let task = self.env.task.as_mut();
        for (arm, arrival) in task.arms().iter_mut().zip(self.motion.arrivals()) {
            // Without a command, increments of a later one count from where the arm is.
            let nowhere = Arrival { covered: 0.0, is_blocked: true };
            arm.arrive(if self.is_commanded { arrival } else { nowhere });
        }
        task.after_step(&mut self.env.world);
        self.env.seen.is_present = false;
    }
}

/// A motion of a task's arms from where they are, whose set-points are still to come.
fn from_here(task: &mut dyn AnyTask) -> Motion {
    let mut arms = task.arms();
    let instruments: Instruments<'_> = arms.iter_mut().map(|arm| arm.instrument()).collect();
    Motion::streamed(&instruments)
}
