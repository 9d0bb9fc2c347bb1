//! What changes of a live world: its time, what its arms told, which session drives which.

use std::collections::VecDeque;
use std::sync::Arc;

use arrayvec::ArrayVec;
use trocar_proto::dvrk::record::{CommandRecord, EventRecord};
use trocar_proto::dvrk::{Command, Event, State};
use trocar_proto::{Code, Rejection};

use crate::dvrk::ArmController;
use crate::env::LiveWorld;
use crate::error::StepError;
use crate::recording::live::LiveLog;
use crate::service::driver::Driver;
use crate::service::real_time::RealTime;
use crate::sim::motion::MAX_INSTRUMENTS;

/// Events that are kept for sessions that have not fetched them yet.
pub(super) const MOST_EVENTS: usize = 4096;

/// A state of a world, to which it can be brought back.
#[derive(Clone)]
pub(in crate::service) struct SavedWorld {
    pub(super) world: LiveWorld,
    pub(super) log: LiveLog,
}

/// What changes.
pub(super) struct WorldState {
    pub(super) world: LiveWorld,
    /// What led to it.
    pub(super) log: LiveLog,
    /// Bytes of the ledger that are counted for that.
    pub(super) paid: u64,
    /// Parts of the recording that a recorder has, where there is one.
    pub(super) fetched: Option<Vec<Arc<[u8]>>>,
    /// Which session drives each arm.
    pub(super) drivers: ArrayVec<Option<Driver>, { MAX_INSTRUMENTS + 1 }>,
    pub(super) events: VecDeque<EventRecord>,
    /// Events that were told since the world began.
    pub(super) told: u64,
    pub(super) ticks: u64,
    pub(super) real_time: Option<RealTime>,
    /// Room for the observation and both goals.
    pub(super) seen: [Vec<f32>; 3],
    /// Why no time passes any more, if that is so.
    pub(super) over: Option<Rejection>,
}

/// What a message let pass.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::service) struct Passed {
    pub(in crate::service) ticks: u32,
    /// An arm told something meanwhile.
    pub(in crate::service) has_told: bool,
}

impl WorldState {
    /// Lets up to so many ticks pass, or until an arm tells something.
    pub(super) fn tick(&mut self, most: u32, until_event: bool) -> Result<Passed, Rejection> {
        let mut passed = Passed::default();
        while passed.ticks < most && !(until_event && passed.has_told) {
            if let Some(over) = &self.over {
                return Err(over.clone());
            }
            if let Err(error) = self.world.tick() {
                let (code, words) = match &error {
                    StepError::InvalidAction(_) | StepError::ResetNeeded => (Code::ResetNeeded, ""),
                    StepError::Simulation { .. } => (Code::Simulation, "; open another world"),
                };
                let allowed = format!("{error}{words}");
                let over = Rejection::new(code, "world", format!("tick {}", self.ticks), allowed);
                self.over = Some(over.clone());
                return Err(over);
            }
            self.log.tick(&self.world);
            self.ticks += 1;
            passed.ticks += 1;
            passed.has_told |= self.listen();
        }
        Ok(passed)
    }

    /// Goes on from another state, in its own time.
    pub(super) fn go_on_from(&mut self, SavedWorld { mut world, log }: SavedWorld) {
        world.resume_after(&self.world);
        (self.world, self.log, self.over) = (world, log, None);
        self.listen();
    }

    /// Frees the arms of some drivers, which then hold.
    pub(super) fn free(&mut self, is_one: impl Fn(Driver) -> bool) {
        for place in 0..self.drivers.len() {
            if self.drivers[place].is_none_or(|driver| !is_one(driver)) {
                continue;
            }
            self.drivers[place] = None;
            let is = self.world.arms().nth(place).map(ArmController::operating_state);
            if is.is_some_and(|is| is.state == State::Enabled && is.is_homed) {
                let hold = CommandRecord::new(place as u32, &Command::Hold);
                self.give(place, &Command::Hold, &hold.expect("it has no numbers"));
            }
        }
        self.listen();
    }

    /// Gives an arm a command.
    pub(super) fn give(&mut self, place: usize, command: &Command, record: &CommandRecord) {
        self.log.give(record, &self.world);
        if let Some(arm) = self.world.arms_mut().nth(place) {
            arm.command(command);
        }
    }

    /// Takes down what the arms have told; whether that is anything.
    pub(super) fn listen(&mut self) -> bool {
        let before = self.told;
        for (place, arm) in self.world.arms_mut().enumerate() {
            for event in arm.take_events() {
                if self.events.len() == MOST_EVENTS {
                    self.events.pop_front();
                }
                let (stamp, report) = (event.stamp.nanoseconds(), event.what.report());
                let event = Event { arm: place as u32, stamp, report };
                self.events.push_back(EventRecord::new(&event));
                self.told += 1;
            }
        }
        self.told > before
    }
}
