//! Waiting so that Python's other threads run and Ctrl-C works.

use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use pyo3::prelude::*;
use trocar_client::{CallError, Session};

use crate::error;

/// How long one wait may last before Python's signal handlers get a turn.
pub(crate) const SLICE: Duration = Duration::from_millis(100);

/// How long closing waits for the server to confirm; it ends the session in any case.
const FAREWELL: Duration = Duration::from_secs(2);

/// Runs `work`, which may wait for the server, on a thread of its own. Where Ctrl-C ends the wait,
/// that thread goes on and its result is dropped.
pub(crate) fn interruptibly<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce() -> T + Send + 'static,
) -> PyResult<T> {
    let (sender, mut receiver) = channel();
    let work = move || sender.send(work()).ok();
    let worker = thread::Builder::new().name("trocar-call".into()).spawn(work)?;
    loop {
        let receiver = &mut receiver;
        match py.detach(move || receiver.recv_timeout(SLICE)) {
            Ok(result) => {
                // Python warns about a fork while other threads run, even those about to end.
                py.detach(|| worker.join()).ok();
                return Ok(result);
            }
            Err(RecvTimeoutError::Timeout) => py.check_signals()?,
            Err(RecvTimeoutError::Disconnected) => {
                return Err(error::new(py, "Internal", "the call's thread ended early"));
            }
        }
    }
}

/// Waits for the reply to the oldest request in flight.
pub(crate) fn reply(py: Python<'_>, session: &mut Session) -> PyResult<trocar_client::Reply> {
    loop {
        match slice(py, session, Session::poll)? {
            Some(reply) => return Ok(reply),
            None => py.check_signals()?,
        }
    }
}

/// Waits for the replies that were given up on.
pub(crate) fn settled(py: Python<'_>, session: &mut Session) -> PyResult<()> {
    while !slice(py, session, Session::settle)? {
        py.check_signals()?;
    }
    Ok(())
}

fn slice<T: Send>(
    py: Python<'_>,
    session: &mut Session,
    wait: impl Fn(&mut Session, Duration) -> Result<T, CallError> + Sync,
) -> PyResult<T> {
    py.detach(|| wait(session, SLICE)).map_err(|error| error::call(py, error))
}

/// Ends a session, waiting a moment for the server but never for one that does not answer.
pub(crate) fn farewell<S: Send + 'static>(session: S) {
    let (sender, receiver) = channel();
    let closing = move || {
        drop(session);
        sender.send(()).ok();
    };
    // Where no thread can be had, the server ends the session together with the connection.
    if let Ok(worker) = thread::Builder::new().name("trocar-close".into()).spawn(closing)
        && receiver.recv_timeout(FAREWELL).is_ok()
    {
        worker.join().ok();
    }
}
