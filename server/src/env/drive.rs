//! An environment whose arms are driven from outside, substep by substep.

use arrayvec::ArrayVec;

use super::Env;
use crate::error::StepError;
use crate::sim::instrument::Posture;
use crate::sim::motion::{Arrival, Instruments, MAX_INSTRUMENTS, Motion, Profiles};

/// The instrument arms of an environment in the hands of a controller: it gives set-points that may change at every
/// substep, and what stops a step's motion stops these, too. Observations, goals and success are those of the
/// task, as of the latest [`Drive::sense`].
pub struct Drive<'a> {
    env: &'a mut Env,
    motion: Motion,
    /// Whether no substep has passed since the sensors last reported.
    is_sensed: bool,
}

impl Env {
    /// Takes the instrument arms in hand, from where they are. No step passes meanwhile, and the episode cannot be
    /// exported any more: no actions lead to its state.
    pub fn drive(&mut self) -> Result<Drive<'_>, StepError> {
        if self.needs_reset() {
            return Err(StepError::ResetNeeded);
        }
        self.is_driven = true;
        let arms = self.task.arms().into_iter();
        let motion = Motion::streamed(arms.map(|arm| *arm.instrument().posture()));
        Ok(Drive { env: self, motion, is_sensed: true })
    }
}

impl Drive<'_> {
    /// The environment.
    pub fn env(&self) -> &Env {
        self.env
    }

    /// Where the arms are: the true wrist in the scene frame, and the opening of the jaws that is asked for.
    pub fn postures(&mut self) -> ArrayVec<Posture, MAX_INSTRUMENTS> {
        self.env.task.arms().iter_mut().map(|arm| *arm.instrument().posture()).collect()
    }

    /// Gives the task an action, as a step does, and returns where that step would bring the arms: set-points to
    /// follow, or to depart from.
    pub fn command(&mut self, action: &[f32]) -> Result<Profiles, StepError> {
        self.env.check(action)?;
        self.sense();
        let task = self.env.task.as_mut();
        task.command(&mut self.env.world, Some(action));
        let profiles: Profiles = task.arms().iter().map(|arm| arm.profile().clone()).collect();
        self.motion = Motion::streamed(profiles.iter().map(|profile| profile.at(0, 0, 1)));
        Ok(profiles)
    }

    /// Lets one substep, 1/240 s, pass, in which each arm goes to its set-point: the true wrist in the scene frame,
    /// and the opening of its jaws. An arm that is held up is as many set-points behind, until nothing is in its
    /// way any more and the world rests.
    ///
    /// # Panics
    /// Where there is not one set-point for each arm.
    pub fn advance(&mut self, set_points: &[Posture]) {
        self.motion.push(set_points);
        self.is_sensed = false;
        let mut arms = self.env.task.arms();
        let mut instruments: Instruments<'_> =
            arms.iter_mut().map(|arm| arm.instrument()).collect();
        self.motion.pass(1, &mut instruments, &mut self.env.world);
        self.env.seen.is_present = false;
    }

    /// Lets the sensors report where the arms are, and the task take note of it, if a substep has passed.
    pub fn sense(&mut self) {
        if std::mem::replace(&mut self.is_sensed, true) {
            return;
        }
        let task = self.env.task.as_mut();
        for (arm, arrival) in task.arms().iter_mut().zip(self.motion.arrivals()) {
            // Where the arm is not where it was last commanded, increments of later commands count from where it is.
            let ends = [arm.profile().at(1, 1, 1), arm.profile().end()];
            let is_there = !arrival.is_blocked && ends.contains(arm.instrument().posture());
            arm.arrive(Arrival { covered: f64::from(is_there), is_blocked: !is_there });
        }
        task.after_step(&mut self.env.world);
        self.env.measure();
        self.env.seen.is_present = false;
    }
}
