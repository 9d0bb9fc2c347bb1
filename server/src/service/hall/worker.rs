//! A thread that looks for guests whose turn it is, and attends to them.

use std::panic::{self, AssertUnwindSafe};
use std::sync::atomic::Ordering;
use std::sync::{Arc, MutexGuard};
use std::time::Duration;

use trocar_proto::door::Listener;
use trocar_proto::vigil::Vigil;

use super::{Attended, Done, Guest, Hall, Place, SLICE, State, Visit};
use crate::service::scheduler::{Turn, Watch};
use crate::service::turns::{Need, Waiter};
use crate::service::wakes::Wakes;

/// How long a worker sleeps that does not have to look for requests without a ring.
const LONG: Duration = Duration::from_secs(1);

/// A session that needs little goes ahead of others that need little once no turn has begun for so long.
const PATIENCE: Duration = Duration::from_millis(1);

/// A thread, and what it has to attend to guests with.
pub(super) struct Worker {
    hall: Arc<Hall>,
    kind: Listener,
    waiter: Arc<Waiter>,
    vigil: Vigil,
    /// Since when this thread has done nothing but look for the next guest.
    watch: Option<Watch>,
    wakes: Wakes,
}

impl Worker {
    /// Starts one for `hall`. It ends when it is not needed any more.
    pub(super) fn start(hall: Arc<Hall>, kind: Listener) -> std::io::Result<()> {
        let name = if kind == Listener::Small { "trocar-run" } else { "trocar-work" };
        std::thread::Builder::new().name(name.into()).spawn(move || {
            let (waiter, vigil) = (Waiter::here(), Vigil::new());
            let (watch, wakes) = (None, Wakes::default());
            let mut worker = Self { hall, kind, waiter, vigil, watch, wakes };
            worker.hall.lock().asleep(kind).summoned = false;
            let mut done = None;
            while let Some(visit) = worker.next(done) {
                done = Some(worker.attend(visit));
            }
        })?;
        Ok(())
    }

    /// Attends to a guest for one message.
    fn attend(&mut self, visit: Visit) -> Done {
        let Visit { seat, user, mut guest, outlook, grant } = visit;
        let watch = self.watch.take().unwrap_or_else(Watch::start);
        let Self { hall, waiter, wakes, .. } = self;
        let mut turn = Turn::begin(hall, &user, waiter, Some(grant), watch, wakes);
        let attended = panic::catch_unwind(AssertUnwindSafe(|| guest.attend(&mut turn)));
        let (grant, computed, watch) = turn.end();
        self.watch = Some(watch);
        let mut more = false;
        let stays = match attended {
            Ok(Attended::Answered { slept, more: another }) => {
                self.vigil.begin(slept);
                more = another;
                let outlook = guest.outlook(computed);
                Some((guest, outlook))
            }
            Ok(Attended::Nothing) => Some((guest, outlook)),
            Ok(Attended::Over) => {
                self.see_off(seat, guest);
                None
            }
            Err(_) => {
                guest.failed();
                self.see_off(seat, guest);
                None
            }
        };
        Done { seat, user, grant, stays, more }
    }

    /// Lets go of a guest, which frees its seat: on a thread of its own, since much may have to be given back.
    fn see_off(&self, seat: u32, guest: Box<dyn Guest>) {
        self.hall.lock().places[seat as usize] = Place::Kept;
        let name = format!("trocar-close-{seat}");
        let thread = std::thread::Builder::new().name(name).spawn(move || drop(guest));
        if let Err(error) = thread {
            tracing::debug!(%error, "a session was closed without a thread of its own");
        }
    }

    /// The next guest whose turn it is, once there is one. `None` where this worker is not needed any more.
    fn next(&mut self, done: Option<Done>) -> Option<Visit> {
        let Self { hall, kind, vigil, watch, wakes, .. } = self;
        let mut state = hall.lock();
        if let Some(done) = done {
            state.settle(done);
        }
        // The count of turns begun, which must not have changed for a small session to go ahead.
        let mut patience = None;
        let mut awake = true;
        loop {
            state.patrol();
            let overdue = patience.take() == Some(state.turns.begun);
            let visit;
            (state, visit) = hall.hand_out(state, Some(*kind), overdue);
            if let Some(visit) = visit {
                let help = state.needs_help(Some(visit.outlook));
                hall.fetch_help(state, help);
                if !(visit.outlook.need == Need::Little && wakes.may_wait_for(visit.outlook.cost)) {
                    wakes.rouse(&hall.door);
                }
                vigil.end();
                return Some(visit);
            }
            if !wakes.is_empty() {
                drop(state);
                wakes.rouse(&hall.door);
                state = hall.lock();
                continue;
            }
            if state.is_empty() {
                state.runner &= *kind != Listener::Small;
                drop(state);
                // Workers that sleep end, too.
                hall.door.wake(Listener::Any);
                hall.door.wake(Listener::Small);
                return None;
            }
            *watch = None;
            let help = state.needs_help(None).filter(|needed| needed != kind);
            if help.is_some() {
                hall.fetch_help(state, help);
                state = hall.lock();
            }
            if std::mem::take(&mut awake) && *kind == Listener::Any && !state.turns.is_busy() {
                state = Self::look_awake(hall, vigil, state);
                continue;
            }
            if *kind == Listener::Any && state.asleep(*kind).count >= hall.most_sleepers() {
                return None;
            }
            state = Self::sleep(hall, *kind, &mut patience, state);
        }
    }

    /// Looks at the door for as long as that pays.
    fn look_awake<'a>(
        hall: &'a Hall,
        vigil: &Vigil,
        mut state: MutexGuard<'a, State>,
    ) -> MutexGuard<'a, State> {
        state.polling += 1;
        state.post(hall);
        drop(state);
        while !hall.door.is_rung()
            && !hall.beckons.load(Ordering::SeqCst)
            && !hall.taken.load(Ordering::Relaxed)
            && vigil.keep()
        {}
        let mut state = hall.lock();
        state.polling -= 1;
        hall.beckons.store(false, Ordering::SeqCst);
        state
    }

    /// Sleeps until it is needed, or is to look after a while. Sets `patience` to the count of turns begun where a small
    /// session may go ahead if that count is the same afterwards.
    fn sleep<'a>(
        hall: &'a Hall,
        kind: Listener,
        patience: &mut Option<u64>,
        mut state: MutexGuard<'a, State>,
    ) -> MutexGuard<'a, State> {
        let runs = kind == Listener::Small;
        let patient = runs && state.turns.is_tried();
        let timed = !runs && !state.timed;
        *patience = patient.then_some(state.turns.begun);
        state.patient |= patient;
        state.timed |= timed;
        let limit = match (patient, timed) {
            (true, _) => PATIENCE,
            (_, true) => SLICE,
            _ => LONG,
        };
        let seen = hall.door.wakes(kind);
        state.asleep(kind).count += 1;
        state.post(hall);
        let listens = state.asleep(kind).posted;
        drop(state);
        // A client may have rung before it could know that a worker sleeps.
        if !(listens && hall.door.is_rung()) {
            hall.door.sleep(kind, seen, limit);
        }
        let mut state = hall.lock();
        state.patient &= !patient;
        state.timed &= !timed;
        let asleep = state.asleep(kind);
        asleep.count -= 1;
        asleep.summoned = false;
        // The client that woke a worker up has taken the alert away.
        asleep.posted = hall.door.is_alert(kind);
        state
    }
}
