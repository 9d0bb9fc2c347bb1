//! What an environment clamps of its task's own numbers: nothing, where task and specification agree.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use trocar_proto::spec::Element;

use super::Env;

/// How often, and how far at most, a number left the range of its element.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Excess {
    /// How often.
    pub count: u64,
    /// The number farthest outside.
    pub farthest: f32,
}

/// Excesses by name. Looking at an environment counts, so it is counted behind a shared reference.
#[derive(Debug, Default)]
pub(super) struct Excesses(Mutex<BTreeMap<String, Excess>>);

impl Excesses {
    fn get(&self) -> BTreeMap<String, Excess> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn note(&self, name: String, number: f32, element: &Element) {
        let outside = |number: f32| (element.min - number).max(number - element.max);
        let mut excesses = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let excess = excesses.entry(name).or_insert(Excess { count: 0, farthest: number });
        excess.count += 1;
        if outside(number) > outside(excess.farthest) {
            excess.farthest = number;
        }
    }
}

impl Clone for Excesses {
    fn clone(&self) -> Self {
        Self(Mutex::new(self.get()))
    }
}

impl Env {
    /// What was clamped of the task's own numbers (before noise) and of its expert's, by element: each entry is
    /// a fault of the task or of its specification. Elements that [saturate](Element::saturates) are left out
    /// while an object is lost.
    pub fn clamped(&self) -> BTreeMap<String, Excess> {
        self.excesses.get()
    }

    /// Notes a `number` of `what` that is outside the range of its element.
    pub(super) fn check_bounds(&self, what: &str, number: f32, element: &Element) {
        if number.is_finite() && !(element.min..=element.max).contains(&number) {
            self.note_excess(what, number, element);
        }
    }

    #[cold]
    fn note_excess(&self, what: &str, number: f32, element: &Element) {
        if !(element.saturates && self.has_lost_objects()) {
            self.excesses.note(format!("{what}: {}", element.name), number, element);
        }
    }
}

/// `number` in the range of `element`; what is not finite stays.
pub(super) fn bounded(number: f32, element: &Element) -> f32 {
    if number.is_finite() { number.clamp(element.min, element.max) } else { number }
}
