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
    /// while an object is lost, and all while arms are driven from outside, which may lead them anywhere.
    pub fn clamped(&self) -> BTreeMap<String, Excess> {
        self.excesses.get()
    }

    /// Brings the numbers of `what` into the ranges of their elements; whether all were finite.
    pub(super) fn bound_all(&self, what: &str, numbers: &mut [f32], elements: &[Element]) -> bool {
        let mut finite = true;
        for (number, element) in numbers.iter_mut().zip(elements) {
            // Nearly always it is inside, and finite therefore.
            if !is_inside(*number, element) {
                self.note_excess(what, *number, element);
                finite &= bound(number, element);
            }
        }
        finite
    }

    /// Notes a `number` of `what` that is outside the range of its element.
    pub(super) fn check_bounds(&self, what: &str, number: f32, element: &Element) {
        if !is_inside(number, element) {
            self.note_excess(what, number, element);
        }
    }

    #[cold]
    fn note_excess(&self, what: &str, number: f32, element: &Element) {
        if number.is_finite() && !self.is_driven && !(element.saturates && self.has_lost_objects())
        {
            self.excesses.note(format!("{what}: {}", element.name), number, element);
        }
    }
}

fn is_inside(number: f32, element: &Element) -> bool {
    element.min <= number && number <= element.max
}

/// Brings a number into the range of its element, and to 0 where it is not finite; whether it was.
pub(super) fn bound(number: &mut f32, element: &Element) -> bool {
    let is_finite = number.is_finite();
    *number = if is_finite { number.clamp(element.min, element.max) } else { 0.0 };
    is_finite
}
