//! Where a client sleeps until a reply is there: an event count of each session, in shared memory. Its server makes and
//! removes it, its client opens it. The server is told of requests by the [`doorbell`](super::doorbell).

use std::fs;
use std::io;
use std::ops::Deref;

use super::event_count::EventCount;
use super::platform::Linux;
use super::shm::{SharedLayout, Shm};
use crate::endpoint::Endpoint;

const _: () = assert!(size_of::<EventCount<Linux>>() == 128);

#[allow(unsafe_code)]
// SAFETY: atomics that are 0 at first.
unsafe impl SharedLayout for EventCount<Linux> {}

/// The replies of a session, counted.
#[derive(Debug)]
pub struct ReplyEvent(Shm<EventCount<Linux>>);

impl ReplyEvent {
    /// Makes that of a session of the run `epoch` of the server. It is removed when this is dropped; should the server
    /// die before, with all else under the endpoint's prefix.
    pub fn make(endpoint: &Endpoint, epoch: u64, session: u64) -> io::Result<Self> {
        Shm::make(endpoint.reply_event(epoch, session)).map(Self)
    }

    /// Opens that of a session.
    pub fn open(endpoint: &Endpoint, epoch: u64, session: u64) -> io::Result<Self> {
        Shm::open(&endpoint.reply_event(epoch, session)).map(Self)
    }

    /// Removes those that earlier runs of the server have left, and their doorbells. Only a running server may:
    /// sessions of its own must not be there yet, or not any more.
    pub fn clear(endpoint: &Endpoint) -> io::Result<()> {
        endpoint.notify_files()?.into_iter().try_for_each(fs::remove_file)
    }
}

impl Deref for ReplyEvent {
    type Target = EventCount<Linux>;

    fn deref(&self) -> &EventCount<Linux> {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use std::thread;
    use std::time::Duration;

    use super::super::futex::WaitOutcome;
    use super::*;
    use crate::endpoint::Membership;

    const LONG: Duration = Duration::from_mins(1);

    fn pair(label: &str) -> (Membership, ReplyEvent, ReplyEvent) {
        let name = format!("t-{label}-{}", std::process::id());
        let endpoint = Endpoint::new(&name.parse().unwrap());
        let membership = endpoint.join().unwrap();
        let made = ReplyEvent::make(&endpoint, 7, 1).unwrap();
        let opened = ReplyEvent::open(&endpoint, 7, 1).unwrap();
        (membership, made, opened)
    }

    #[test]
    fn what_a_crash_left_is_cleared() {
        let (membership, made, _opened) = pair("left");
        let endpoint = membership.endpoint();
        std::mem::forget(made);
        ReplyEvent::clear(endpoint).unwrap();
        assert_eq!(endpoint.remains().unwrap(), [endpoint.folder()]);
    }

    #[test]
    fn it_is_removed_by_its_maker() {
        let (membership, made, opened) = pair("event");
        let endpoint = membership.endpoint();
        let path = endpoint.reply_event(7, 1);
        assert!(endpoint.remains().unwrap().contains(&path));
        let again = ReplyEvent::make(endpoint, 7, 1).unwrap_err();
        assert_eq!(again.kind(), io::ErrorKind::AlreadyExists);
        drop(opened);
        assert!(path.exists());
        drop(made);
        assert!(!path.exists());
        assert_eq!(ReplyEvent::open(endpoint, 7, 1).unwrap_err().kind(), io::ErrorKind::NotFound);
        // Nor is what is too short ever looked at.
        fs::write(&path, "short").unwrap();
        let short = ReplyEvent::open(endpoint, 7, 1).unwrap_err();
        assert_eq!(short.kind(), io::ErrorKind::UnexpectedEof);
    }

    #[test]
    fn a_client_sleeps_until_its_time_is_over_and_not_at_all_where_a_reply_is_there() {
        let (_membership, server, client) = pair("event-waits");
        assert_eq!(client.wait(0, Duration::from_millis(1)), WaitOutcome::TimedOut);
        assert!(!server.signal(), "the client is awake");
        assert_eq!(client.wait(0, LONG), WaitOutcome::Woken);
        assert_eq!(client.count(), 1);
    }

    #[test]
    fn no_reply_is_missed() {
        const ROUNDS: u32 = 10_000;
        let (_membership, server, client) = pair("event-rounds");
        let (_other, request, requested) = pair("event-requests");
        thread::scope(|scope| {
            scope.spawn(|| {
                for round in 0..ROUNDS {
                    while requested.count() == round {
                        assert_ne!(requested.wait(round, LONG), WaitOutcome::TimedOut);
                    }
                    if server.signal() {
                        server.wake();
                    }
                }
            });
            for round in 0..ROUNDS {
                if request.signal() {
                    request.wake();
                }
                while client.count() == round {
                    assert_ne!(client.wait(round, LONG), WaitOutcome::TimedOut);
                }
            }
        });
    }
}
