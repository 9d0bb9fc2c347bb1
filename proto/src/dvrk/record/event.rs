//! Events that arms tell.

use bytemuck::{Pod, Zeroable};

use super::state::StateWord;
use super::values::Text;
use crate::dvrk::report::{Event, Report};

/// An event of an arm.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct EventRecord {
    stamp: u64,
    value: f64,
    arm: u32,
    kind: u32,
    state: StateWord,
    reserved: u32,
    text: Text,
}

const _: () = assert!(size_of::<EventRecord>() == 296);

impl EventRecord {
    /// An event as a record; long texts are cut.
    pub fn new(event: &Event) -> Self {
        let mut record = Self { stamp: event.stamp, arm: event.arm, ..Self::zeroed() };
        let (kind, text) = match &event.report {
            Report::OperatingState(state) => {
                record.state = StateWord::new(*state);
                (1, "")
            }
            Report::GoalReached(is) => {
                record.value = f64::from(*is);
                (2, "")
            }
            Report::Ratio(ratio) => {
                record.value = *ratio;
                (3, "")
            }
            Report::RatioV(ratio) => {
                record.value = *ratio;
                (4, "")
            }
            Report::RatioA(ratio) => {
                record.value = *ratio;
                (5, "")
            }
            Report::ToolType(name) => (6, name.as_str()),
            Report::EndoscopeType(name) => (7, name.as_str()),
            Report::Warning(why) => (8, why.as_str()),
            Report::Error(why) => (9, why.as_str()),
        };
        record.kind = kind;
        record.text = Text::new(text);
        record
    }

    /// The event, if it is one.
    pub fn event(&self) -> Option<Event> {
        let (value, text) = (self.value, || self.text.read());
        let report = match self.kind {
            1 => Report::OperatingState(self.state.read()),
            2 => Report::GoalReached(value != 0.0),
            3 => Report::Ratio(value),
            4 => Report::RatioV(value),
            5 => Report::RatioA(value),
            6 => Report::ToolType(text()),
            7 => Report::EndoscopeType(text()),
            8 => Report::Warning(text()),
            9 => Report::Error(text()),
            _ => return None,
        };
        Some(Event { arm: self.arm, stamp: self.stamp, report })
    }
}
