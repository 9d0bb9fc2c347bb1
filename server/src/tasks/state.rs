//! The fields of a task's state, each declared once: name, frame, unit, range, and how it is read.
//!
//! A task goes through its fields in [`Task::state`](super::Task::state). Where its specification is made, they say what
//! they are; where it is observed, they are read. What they are is computed only where it is asked for.

use std::fmt::Display;

use nalgebra::Vector3;
use trocar_proto::spec::Element;

use super::options::{self, Preset};
use crate::sim::frames::Aabb;

/// The fields of a state, one after the other: described, or read.
#[derive(Debug)]
pub struct State<'a>(Fields<'a>);

#[derive(Debug)]
enum Fields<'a> {
    Described(Vec<Element>),
    Read(std::slice::IterMut<'a, f32>),
}

impl<'a> State<'a> {
    /// What the fields are that `fields` goes through.
    pub fn elements(fields: impl FnOnce(&mut State<'_>)) -> Vec<Element> {
        let mut state = State(Fields::Described(vec![]));
        fields(&mut state);
        match state.0 {
            Fields::Described(elements) => elements,
            Fields::Read(_) => vec![],
        }
    }

    /// Reads fields into `numbers`, of which there are as many.
    pub fn read(numbers: &'a mut [f32]) -> Self {
        Self(Fields::Read(numbers.iter_mut()))
    }

    /// Some fields: what they are, and what they are now.
    ///
    /// # Panics
    /// Where more are read than there are.
    pub fn fields(
        &mut self,
        elements: impl FnOnce() -> Vec<Element>,
        numbers: impl IntoIterator<Item = f64>,
    ) {
        match &mut self.0 {
            Fields::Described(described) => described.extend(elements()),
            Fields::Read(slots) => {
                for number in numbers {
                    *slots.next().expect("as many fields as were described") = number as f32;
                }
            }
        }
    }

    /// One field.
    pub fn field(&mut self, element: impl FnOnce() -> Element, number: f64) {
        self.fields(|| vec![element()], [number]);
    }

    /// A position `at` (m) within `bounds` (m), in the unit of `preset`: "`name` x", "`name` y" and "`name` z".
    pub fn position(
        &mut self,
        name: impl Display,
        frame: &str,
        bounds: &Aabb,
        preset: Preset,
        at: &Vector3<f64>,
    ) {
        let at = at * options::position_scale(preset);
        let elements = || options::position_elements(&name.to_string(), frame, bounds, preset);
        self.fields(elements, at.iter().copied());
    }

    /// Extrinsic XYZ Euler angles, rad: "`name` roll", "`name` pitch" and "`name` yaw".
    pub fn angles(&mut self, name: impl Display, frame: &str, angles: [f64; 3]) {
        self.fields(|| options::euler_elements(&name.to_string(), frame), angles);
    }

    /// The fields that `fields` goes through, with `prefix` before their names.
    pub fn named(&mut self, prefix: impl Display, fields: impl FnOnce(&mut Self)) {
        let first = if let Fields::Described(elements) = &self.0 { elements.len() } else { 0 };
        fields(self);
        if let Fields::Described(elements) = &mut self.0 {
            for element in &mut elements[first..] {
                element.name = format!("{prefix} {}", element.name);
            }
        }
    }
}
