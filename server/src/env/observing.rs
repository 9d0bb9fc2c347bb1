//! What an environment shows of its state: the task's numbers, what arms measure, relative features, and sensor noise.

use std::sync::Arc;

use trocar_proto::TaskSpec;
use trocar_proto::scaled::scale_all;
use trocar_proto::spec::Element;

use super::Env;
use super::bounds::bound;
use crate::sim::random::Rng;
use crate::tasks::State as Fields;
use crate::tasks::options::{SCALED_LENGTH, SCALED_LENGTHS_PER_METRE};

/// What [`Env::step`] saw, so that [`Env::observe`] need not look again.
#[derive(Debug, Clone, Default)]
pub(super) struct Seen {
    pub(super) observation: Vec<f32>,
    pub(super) achieved: Vec<f32>,
    pub(super) desired: Vec<f32>,
    /// Whether this is the present state.
    pub(super) is_present: bool,
}

/// What an observation has of the task's state.
#[derive(Debug, Clone)]
pub(super) struct Sight {
    /// The state.
    pub(super) elements: Arc<[Element]>,
    /// Whether the state itself is observed.
    pub(super) has_state: bool,
    /// Whether relative features of it are.
    pub(super) has_features: bool,
    /// The specification before scaling, if numbers are scaled.
    pub(super) plain: Option<Arc<TaskSpec>>,
}

/// The sensor noise of an episode.
#[derive(Debug, Clone)]
pub(super) struct Noise {
    /// As it is before the present state is looked at: that may be done again.
    pub(super) rng: Rng,
    pub(super) sigma: f64,
}

impl Noise {
    /// Its size for a number in `unit`, in that unit.
    fn sigma(&self, unit: &str) -> f64 {
        match unit {
            "m" => self.sigma,
            SCALED_LENGTH => self.sigma * SCALED_LENGTHS_PER_METRE,
            _ => 0.0,
        }
    }
}

impl Env {
    /// Writes the present observation and goals, of the specification's dimensions; zeros before
    /// the first reset. After a failure of the simulation, what is not finite reads 0.
    pub fn observe(&self, observation: &mut [f32], achieved: &mut [f32], desired: &mut [f32]) {
        let seen = &self.seen;
        if seen.is_present || !self.was_reset() {
            observation.copy_from_slice(&seen.observation);
            achieved.copy_from_slice(&seen.achieved);
            desired.copy_from_slice(&seen.desired);
        } else {
            self.look(observation, achieved, desired);
        }
    }

    /// Writes what is seen now: with this episode's noise on observed positions, within the bounds. A
    /// number that is not finite is written as 0, so that one environment does not spoil a client's
    /// statistics. Scaling comes last. Returns whether all of it was finite.
    pub(super) fn look(
        &self,
        observation: &mut [f32],
        achieved: &mut [f32],
        desired: &mut [f32],
    ) -> bool {
        let Sight { elements, has_state, has_features, plain } = &self.sight;
        let spec = plain.as_ref().unwrap_or(&self.spec);
        let shown = if *has_state { elements.len() } else { 0 };
        let (state, rest) = observation.split_at_mut(shown);
        let (measured, features) = rest.split_at_mut(self.measured.len());
        let mut hidden = vec![0.0; elements.len() - shown];
        let state = if *has_state { state } else { &mut hidden };
        self.task.state(&self.world, &mut Fields::read(state));
        self.task.goals(&self.world, achieved, desired);
        measured.copy_from_slice(&self.measured);
        let own = &spec.observation[shown..];
        let mut finite = self.bound_all("observation", measured, own);
        if self.is_noisy() {
            let mut rng = self.noise.rng.clone();
            for (value, element) in state.iter_mut().zip(elements.iter()) {
                self.check_bounds("observation", *value, element);
                let sigma = self.noise.sigma(&element.unit);
                if sigma > 0.0 {
                    *value += (sigma * rng.normal()) as f32;
                }
                finite &= bound(value, element);
            }
        } else {
            finite &= self.bound_all("observation", state, elements);
        }
        if let Some(goal) = &spec.goal {
            finite &= self.bound_all("achieved", achieved, &goal.elements);
            finite &= self.bound_all("desired", desired, &goal.elements);
        }
        if *has_features {
            spec.relative.write(state, achieved, desired, features);
        }
        if let Some(plain) = plain {
            scale_all(&plain.observation, observation);
            if let Some(goal) = &plain.goal {
                scale_all(&goal.elements, achieved);
                scale_all(&goal.elements, desired);
            }
        }
        finite
    }

    /// Whether sensor noise can be seen: it is that of the state. What arms measure has their encoders' errors.
    fn is_noisy(&self) -> bool {
        self.noise.sigma > 0.0 && (self.sight.has_state || self.sight.has_features)
    }

    /// Lets the arms measure themselves, where observations show that.
    pub(super) fn measure(&mut self) {
        if self.own.is_wanted() {
            self.own.measure(self.task.as_mut(), &self.world, &mut self.measured);
        }
    }

    /// Leaves the noise of the present state behind.
    pub(super) fn pass_noise(&mut self) {
        if self.is_noisy() {
            for element in self.sight.elements.iter() {
                if self.noise.sigma(&element.unit) > 0.0 {
                    self.noise.rng.normal();
                }
            }
        }
    }
}
