//! A session's place in the server: the thread that waits for its requests, and how other threads
//! answer them in its place.

use std::any::Any;
use std::panic::{self, AssertUnwindSafe};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use trocar_proto::bell::{Bells, Woken};
use trocar_proto::vigil::Vigil;

use super::gallery::{Exhibit, Gallery};
use super::scheduler::Scheduler;
use super::session::{Ground, Next, Session, Shared};
use super::turns::Guest;

/// How long an idle session sleeps before it looks whether it should end.
const SLICE: Duration = Duration::from_millis(100);

/// One thread at a time, who *claims* it, answers a session's requests: its own thread ([`Self::run`]),
/// or one that was awake anyway ([`Guest`]).
pub(super) struct Seat {
    ground: Arc<Ground>,
    shared: Arc<Shared>,
    scheduler: Scheduler,
    bells: Arc<Bells>,
    /// Rings whose requests were taken up; changed by who has claimed it.
    taken: AtomicU32,
    claimed: AtomicBool,
    /// A request was received that is for its own thread.
    kept: AtomicBool,
    /// Others may answer what it is asked.
    little: AtomicBool,
    /// Locked by who has claimed it; `None` once it has ended.
    session: Mutex<Option<Session>>,
    /// What another thread panicked with in its place.
    panic: Mutex<Option<Box<dyn Any + Send>>>,
}

impl Seat {
    pub(super) fn new(session: Session) -> Arc<Self> {
        Arc::new(Self {
            ground: Arc::clone(&session.ground),
            shared: Arc::clone(&session.shared),
            scheduler: session.scheduler.clone(),
            bells: Arc::clone(&session.ports.bells),
            taken: AtomicU32::new(0),
            claimed: AtomicBool::new(false),
            kept: AtomicBool::new(false),
            little: AtomicBool::new(false),
            session: Mutex::new(Some(session)),
            panic: Mutex::new(None),
        })
    }

    /// Answers requests until the session ends; on its own thread.
    pub(super) fn run(self: Arc<Self>) {
        let Shared { id, task, envs, client, .. } = &*self.shared;
        let (id, pid, opened) = (*id, client.pid, Instant::now());
        let language = client.language.as_str();
        tracing::info!(session = id, pid, language, task, envs, "session opened");
        self.ground.meter.opened();
        let guest: Arc<dyn Guest> = Arc::<Self>::clone(&self);
        let place = Place { scheduler: &self.scheduler, guest: &guest };
        let show = |gallery: &Arc<Gallery>| gallery.exhibit(id, Arc::clone(&self.shared));
        let exhibit: Option<Exhibit> = self.ground.gallery.as_ref().map(show);
        self.answer_all(&guest);
        drop((exhibit, place));
        // Whoever answers in its place comes to an end first.
        let session = self.session.lock().unwrap_or_else(PoisonError::into_inner).take();
        let steps = session.map_or(0, |session| session.steps);
        let reason = self.shared.reason.get().copied().unwrap_or("idle");
        self.ground.meter.closed(reason);
        let seconds = opened.elapsed().as_secs_f64();
        tracing::info!(session = id, pid, task, envs, reason, steps, seconds, "session closed");
    }

    fn answer_all(&self, own: &Arc<dyn Guest>) {
        let stop = || self.shared.stop.load(Ordering::Acquire);
        let mut vigil = Vigil::new();
        vigil.begin();
        let mut late = false;
        while !stop() {
            if let Some(panic) = self.panic.lock().unwrap_or_else(PoisonError::into_inner).take() {
                panic::resume_unwind(panic);
            }
            // Asked before a request is looked for: what arrived by then is answered.
            let finish = self.shared.finish.load(Ordering::Acquire);
            let (seen, now) = (self.bells.request().count(), Instant::now());
            let little = self.little.load(Ordering::Relaxed);
            self.scheduler.watch(own, little);
            let mut any = false;
            if (self.is_wanted() || late || finish) && self.claim() {
                any = self.answer(true) == Next::Answered;
            }
            late = false;
            let go_on = || !stop() && !self.has_kept() && (little || !self.is_due());
            any |= self.scheduler.attend(u64::MAX, go_on);
            if any {
                vigil.end_at(now);
                vigil.begin();
                continue;
            }
            if finish && !self.is_claimed() {
                break;
            }
            if !self.scheduler.is_crowded() && vigil.keep() {
                continue;
            }
            if self.shared.idle() > self.ground.idle_limit {
                break;
            }
            if self.shared.slot().is_watched() && self.claim() {
                self.show();
            }
            self.scheduler.retire(own);
            if !self.is_wanted() {
                late = self.bells.request().wait(seen, SLICE) == Woken::Late;
            }
        }
    }

    /// Answers the next request, by who has claimed it.
    fn answer(&self, at_home: bool) -> Next {
        let mut place = self.session.lock().unwrap_or_else(PoisonError::into_inner);
        let count = self.bells.request().count();
        let next = match &mut *place {
            Some(session) => {
                let had = session.has_kept();
                let next = session.answer_next(at_home);
                self.kept.store(session.has_kept(), Ordering::SeqCst);
                self.little.store(session.needs_little(), Ordering::Relaxed);
                match next {
                    Next::Nothing => self.taken.store(count, Ordering::SeqCst),
                    // It was counted when it was received.
                    Next::Answered | Next::Kept if had => {}
                    Next::Answered | Next::Kept => {
                        self.taken.fetch_add(1, Ordering::SeqCst);
                    }
                }
                next
            }
            None => Next::Nothing,
        };
        drop(place);
        self.claimed.store(false, Ordering::SeqCst);
        next
    }

    /// Shows the environments to whoever watches them, by who has claimed it.
    fn show(&self) {
        let place = self.session.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(session) = &*place {
            session.show();
        }
        drop(place);
        self.claimed.store(false, Ordering::SeqCst);
    }

    fn is_claimed(&self) -> bool {
        self.claimed.load(Ordering::SeqCst)
    }

    fn has_kept(&self) -> bool {
        self.kept.load(Ordering::SeqCst)
    }

    /// Whether its own thread has something to do.
    fn is_wanted(&self) -> bool {
        self.has_kept() || self.is_due()
    }
}

impl Guest for Seat {
    fn scheduler(&self) -> &Scheduler {
        &self.scheduler
    }

    fn is_due(&self) -> bool {
        let is_new = self.bells.request().count() != self.taken.load(Ordering::SeqCst);
        is_new && !self.has_kept() && !self.is_claimed()
    }

    fn claim(&self) -> bool {
        !self.claimed.swap(true, Ordering::SeqCst)
    }

    fn serve(&self) {
        match panic::catch_unwind(AssertUnwindSafe(|| self.answer(false))) {
            Ok(Next::Kept) => self.wake(),
            Ok(_) => {}
            Err(panic) => {
                // That ends its own thread, as it would have had it panicked there.
                *self.panic.lock().unwrap_or_else(PoisonError::into_inner) = Some(panic);
                self.wake();
            }
        }
    }

    fn arm(&self) {
        self.bells.request().arm();
    }

    fn disarm(&self) {
        self.bells.request().disarm();
    }

    fn wake(&self) {
        self.bells.request().wake();
    }
}

/// Held while a session's thread works; given up also by a panic.
struct Place<'a> {
    scheduler: &'a Scheduler,
    guest: &'a Arc<dyn Guest>,
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        self.scheduler.leave(self.guest);
    }
}
