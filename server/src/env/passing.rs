//! How the time of a step passes: commands that are late, actuators that add to them, and looks in between.

use nalgebra::Vector3;

use super::Env;
use crate::error::StepError;
use crate::render::Scene;
use crate::sim::motion::Effort;
use crate::sim::random::Rng;
use crate::tasks::Task;
use crate::tasks::options::Domain;

/// The noise of an episode's actuators.
#[derive(Debug, Clone)]
pub(super) struct Actuation {
    rng: Rng,
    /// Standard deviation along each axis, m.
    sigma: f64,
    /// Standard deviation about each axis, rad.
    sigma_angle: f64,
}

impl Actuation {
    /// None.
    pub(super) fn none() -> Self {
        Self { rng: Rng::new(0, 0), sigma: 0.0, sigma_angle: 0.0 }
    }

    /// That of an episode.
    pub(super) fn draw(domain: &Domain, seed: u64, episode: u64) -> Self {
        let mut rng = Rng::actuator(seed, episode);
        Self {
            sigma: domain.action_noise.draw(&mut rng),
            sigma_angle: domain.action_noise_angle.draw(&mut rng),
            rng,
        }
    }

    fn vector(&mut self, sigma: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| sigma * self.rng.normal())
    }

    /// Disturbs the next command of a task.
    fn disturb(&mut self, task: &mut dyn Task) {
        if self.sigma == 0.0 && self.sigma_angle == 0.0 {
            return;
        }
        let (sigma, sigma_angle) = (self.sigma, self.sigma_angle);
        for arm in &mut task.arms() {
            arm.disturb(self.vector(sigma), self.vector(sigma_angle));
        }
        if let Some(endoscope) = task.endoscope() {
            let sizes = [sigma_angle, sigma_angle, sigma, sigma_angle];
            endoscope.disturb(sizes.map(|sigma| sigma * self.rng.normal()));
        }
    }
}

impl Env {
    /// As [`Env::step`], and shows what there is to see at the ends of `parts` even parts of the step but the last.
    /// The result has the same bits.
    pub fn step_in_parts(
        &mut self,
        action: &[f32],
        parts: u32,
        see: &mut dyn FnMut(Scene),
    ) -> Result<super::Step, StepError> {
        // Where nothing is in their way, instruments take a step at once, in which nothing can be seen.
        let copy = (parts > 1).then(|| self.clone());
        let step = self.step(action)?;
        if let Some(mut copy) = copy {
            copy.pass(action, parts, see);
        }
        Ok(step)
    }

    /// Sends `action` on its way and lets the time of a step pass. Every action is on its way for as long, so one
    /// arrives in each step, as far into it, once the first has arrived; until then the arms hold.
    /// Returns what the arms did.
    pub(super) fn pass(
        &mut self,
        action: &[f32],
        parts: u32,
        see: &mut dyn FnMut(Scene),
    ) -> Effort {
        let substeps = self.substeps;
        self.delayed.extend(action.iter().map(|number| number.clamp(-1.0, 1.0)));
        let (late_steps, late) = (self.latency / substeps, self.latency % substeps);
        // When in this step an action arrives, if one does.
        let arrival = (self.steps >= late_steps).then_some(late);
        let has_moved = self.steps > late_steps;
        if arrival != Some(0) && !has_moved {
            self.time.command(self.task.as_mut(), &mut self.world, None, substeps);
        }
        let mut effort = Effort::default();
        let mut now = 0;
        for part in 1..=parts {
            let end = substeps * part / parts;
            if let Some(late) = arrival.filter(|late| (now..end).contains(late)) {
                if late > now {
                    effort += self.time.pass(self.task.as_mut(), &mut self.world, late - now);
                }
                effort += self.give_command(action.len());
                now = late;
            }
            effort += self.time.pass(self.task.as_mut(), &mut self.world, end - now);
            now = end;
            if part < parts {
                see(self.seen_after(f64::from(now) / f64::from(substeps)));
            }
        }
        effort += self.time.sense(self.task.as_mut());
        self.task.after_step(&mut self.world);
        effort
    }

    /// Gives the task the oldest action that is on its way, of `count` numbers. Returns what an arm did before, as far
    /// as that is known only now.
    fn give_command(&mut self, count: usize) -> Effort {
        let Self { task, world, time, command, .. } = self;
        let task = task.as_mut();
        let mut effort = Effort::default();
        if !self.latency.is_multiple_of(self.substeps) {
            effort = time.sense(task); // increments count from where the arms are now
        }
        command.clear();
        command.extend(self.delayed.drain(..count));
        self.actuation.disturb(task);
        time.command(task, world, Some(command), self.substeps);
        effort
    }

    /// What there is to see after a `part` of the step.
    fn seen_after(&self, part: f64) -> Scene {
        let mut copy = self.clone();
        copy.time.sense(copy.task.as_mut());
        copy.task.between(part);
        copy.scene()
    }
}
