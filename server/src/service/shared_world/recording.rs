//! Recordings of a live world, and the memory that they take.

use std::sync::Arc;

use trocar_proto::{Code, Rejection};

use super::SharedWorld;
use super::state::WorldState;

/// In which portions the memory of a recording is counted, bytes.
const RECORDED_AT_ONCE: u64 = 1 << 20;

impl SharedWorld {
    /// Begins a recording, which has all that led to the present state.
    pub(in crate::service) fn record(&self) {
        let mut state = self.lock();
        let WorldState { world, log, fetched, .. } = &mut *state;
        log.close(world);
        *fetched = Some(vec![]);
        self.pay(&mut state);
    }

    /// The parts of the recording that were not fetched yet, of about `room` bytes.
    pub(in crate::service) fn recorded(&self, room: usize) -> Result<Vec<u8>, Rejection> {
        let mut state = self.lock();
        let WorldState { world, log, fetched, .. } = &mut *state;
        let Some(fetched) = fetched else {
            let why = "it is not recorded; begin again";
            return Err(Rejection::new(Code::UnknownSession, "recording", "none", why));
        };
        // Time that passes without commands is told with the next ones: else there would always be something new.
        if log.has_commands() {
            log.close(world);
        }
        let parts = log.parts()?;
        let same = fetched.iter().zip(parts).take_while(|(one, other)| Arc::ptr_eq(one, other));
        let same = same.count();
        fetched.truncate(same);
        let mut bytes = vec![];
        for part in &parts[same..] {
            if !bytes.is_empty() && bytes.len() + part.len() > room {
                break;
            }
            bytes.extend_from_slice(part);
            fetched.push(Arc::clone(part));
        }
        self.pay(&mut state);
        Ok(bytes)
    }

    /// Has the memory of the recording counted, or gives it up.
    pub(super) fn pay(&self, state: &mut WorldState) {
        let due = (state.log.bytes() as u64).saturating_sub(state.paid).div_ceil(RECORDED_AT_ONCE);
        if due == 0 {
            return;
        }
        match self.ledger.take(due as usize, RECORDED_AT_ONCE) {
            Ok(()) => state.paid += due * RECORDED_AT_ONCE,
            Err(_) => state.log.give_up(),
        }
    }
}

#[cfg(test)]
mod tests {
    use trocar_proto::control::SessionRequest;
    use trocar_proto::dvrk::record::CommandRecord;
    use trocar_proto::dvrk::{Command, LiveRequest, StateCommand};
    use trocar_proto::part;

    use super::*;
    use crate::registry::Registry;
    use crate::service::driver::Driver;
    use crate::service::store::Ledger;

    #[test]
    fn a_recording_for_which_there_is_no_memory_is_given_up_and_the_world_goes_on() {
        let ledger = Arc::new(Ledger::new(RECORDED_AT_ONCE));
        let request = SessionRequest::new("NeedleReach-v0");
        let new = || {
            let (registry, live) = (Registry::builtin(), LiveRequest::default());
            SharedWorld::new(&registry, &ledger, &request, live).unwrap()
        };
        let (one, two) = (new(), new());
        let enable = CommandRecord::new(0, &Command::State(StateCommand::Enable)).unwrap();
        let driver = Driver::Session { session: 1, pid: 1, is_supervised: false };
        for (world, is_recorded) in [(&one, true), (&two, false)] {
            world.record();
            world.command(driver, &[enable]).unwrap();
            assert_eq!(world.advance(300, false).unwrap().ticks, 300);
            // The beginning and the first second.
            let parts = world.recorded(1 << 16).map(|bytes| part::split(&bytes).unwrap().len());
            assert_eq!(parts.ok(), is_recorded.then_some(2));
        }
        let refusal = two.recorded(1 << 16).unwrap_err();
        assert_eq!((refusal.code, refusal.field.as_str()), (Code::MemoryBudget, "recording"));
        assert_eq!(ledger.snapshots(), RECORDED_AT_ONCE);
        drop(one);
        assert_eq!(ledger.snapshots(), 0);
    }
}
