//! A thread that polls the sessions that are next.

use std::panic::{self, AssertUnwindSafe};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use trocar_proto::notify::spin_wait::SpinWait;

use super::run_queue::Parked;
use super::{Finished, Poll, Polled, Quantum, Running, SCAN_PERIOD, Scheduler, Slot, SlotId};

/// A thread, and what it polls sessions with. All end once the last session has: the C library keeps memory that a
/// thread has freed for as long as that thread lives (`heap.rs`).
pub(super) struct Worker {
    scheduler: Arc<Scheduler>,
    parked: Arc<Parked>,
    spin_wait: SpinWait,
}

impl Worker {
    /// Starts one, which counts as looking already.
    pub(super) fn start(scheduler: &Arc<Scheduler>) {
        let own = Arc::clone(scheduler);
        let started = std::thread::Builder::new().name("trocar-work".into()).spawn(move || {
            let (parked, spin_wait) = (Parked::here(), SpinWait::new());
            let mut worker = Self { scheduler: own, parked, spin_wait };
            worker.scheduler.lock().looking -= 1;
            let mut finished = None;
            while let Some(running) = worker.next(finished) {
                finished = Some(worker.poll(running));
            }
        });
        if let Err(error) = started {
            tracing::warn!(%error, "a thread could not be started; clients wait for those that there are");
            scheduler.lock().looking -= 1;
        }
    }

    /// Polls a session once.
    fn poll(&mut self, running: Running) -> Finished {
        let Running { slot, entity, mut session } = running;
        let mut quantum = Quantum::begin(&self.scheduler, &entity, &self.parked, true);
        let polled = panic::catch_unwind(AssertUnwindSafe(|| session.poll(&mut quantum)));
        let (permitted, computed) = quantum.end();
        let mut more = false;
        let session = match polled {
            Ok(Polled::Answered { slept, more: another }) => {
                self.spin_wait.begin(slept);
                more = another;
                session.computed(computed);
                Some(session)
            }
            Ok(Polled::Idle) => Some(session),
            Ok(Polled::Closed) => {
                self.close(slot, session);
                None
            }
            Err(_) => {
                session.failed();
                self.close(slot, session);
                None
            }
        };
        Finished { slot, entity, permitted, session, more }
    }

    /// Drops a session, which frees its slot: on a thread of its own, since much may have to be given back.
    fn close(&self, slot: SlotId, session: Box<dyn Poll>) {
        self.scheduler.lock().slots[slot.0 as usize] = Slot::Reserved;
        let name = format!("trocar-close-{}", slot.0);
        let thread = std::thread::Builder::new().name(name).spawn(move || drop(session));
        if let Err(error) = thread {
            tracing::debug!(%error, "a session was closed without a thread of its own");
        }
    }

    /// The next session to poll, once there is one. `None` where this worker is not needed any more.
    fn next(&mut self, finished: Option<Finished>) -> Option<Running> {
        let Self { scheduler, spin_wait, .. } = self;
        let mut state = scheduler.lock();
        if let Some(finished) = finished {
            state.settle(finished);
        }
        let mut spins = true;
        loop {
            state.collect(&scheduler.doorbell);
            let (running, permitted) = state.hand_out(true);
            if running.is_some() {
                if scheduler.release(state, permitted) {
                    scheduler.doorbell.kick();
                }
                spin_wait.end();
                return running;
            }
            if state.is_empty() {
                drop(state);
                // Workers that sleep end, too.
                scheduler.doorbell.wake_all();
                return None;
            }
            if std::mem::take(&mut spins) && state.queue.free > 0 {
                state.looking += 1;
                scheduler.release(state, permitted);
                while !scheduler.doorbell.is_rung()
                    && !scheduler.kicked.load(Ordering::Acquire)
                    && spin_wait.spin()
                {}
                state = scheduler.lock();
                state.looking -= 1;
                scheduler.kicked.store(false, Ordering::Relaxed);
                continue;
            }
            // Each sleeper has a heap of its own: with 16 clients of which five a second are killed, a server with as
            // many as came took 44 to 50 MiB after a minute, with these 36 to 40 (a run each).
            if state.asleep > scheduler.pool.current_num_threads() {
                scheduler.release(state, permitted);
                return None;
            }
            let seen = scheduler.doorbell.wakes();
            state.asleep += 1;
            if !scheduler.release(state, permitted) {
                // No wake-up is lost. Should a client spoil the doorbell's words, the limit bounds what that costs.
                scheduler.doorbell.sleep(seen, SCAN_PERIOD);
            }
            state = scheduler.lock();
            state.asleep -= 1;
            // The client that woke a worker up has taken the advertisement away.
            state.advertised &= scheduler.doorbell.is_advertised();
        }
    }
}
