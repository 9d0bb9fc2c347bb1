//! What tells a client that a reply is there: a count in shared memory, which both sides of a session see. Where
//! the client sleeps meanwhile, and where the server is told of requests, is the [`door`](crate::door).
//!
//! A worker that has sent a reply *rings*: it increments the count. The client compares the count with the one before
//! it last looked. As long as the client is awake, that is all, and neither side calls the kernel. Before the client
//! sleeps, it says so and looks once more. The worker then sees that and has the client woken up. No ring is missed:
//!
//! | the worker | the client |
//! |---|---|
//! | 1. increments the count | 1. says that it sleeps |
//! | 2. reads whether the client sleeps | 2. reads the count, and does not sleep if it is a new one |
//!
//! All four accesses are sequentially consistent, so one side's first step comes before the other side's second: the
//! client is woken up or does not sleep.
//!
//! Both sides can write to both words. A wrong word costs the session time and nothing else: every wait has an end, and
//! then its caller looks whatever the word says.

use std::fs;
use std::io;
use std::sync::atomic::{AtomicU32, Ordering};

use crate::door::Size;
use crate::endpoint::Endpoint;
use crate::mapping::{Mapping, Words};

/// What a server rings for a client.
#[derive(Debug)]
#[repr(C, align(128))] // nothing that others write to lies beside it
pub struct Bell {
    /// How often it was rung.
    count: AtomicU32,
    /// Not 0 where its client sleeps.
    asleep: AtomicU32,
}

impl Bell {
    /// Tells the client that a reply is there; returns whether it has to be [woken up](crate::door::Door::rouse).
    pub fn ring(&self) -> bool {
        self.count.fetch_add(1, Ordering::SeqCst);
        self.asleep.load(Ordering::SeqCst) != 0
    }

    /// How often it was rung, modulo 2³².
    pub fn count(&self) -> u32 {
        self.count.load(Ordering::SeqCst)
    }

    /// Says whether the client is about to sleep. Look at the count before that.
    pub(crate) fn set_asleep(&self, asleep: bool) {
        self.asleep.store(asleep.into(), Ordering::SeqCst);
    }
}

/// The words of a session, as they lie in shared memory; zeros at first.
#[derive(Debug)]
#[repr(C)]
pub(crate) struct SessionWords {
    reply: Bell,
    /// The [`Size`] that its next request is expected to have.
    size: AtomicU32,
}

const _: () = assert!(size_of::<SessionWords>() == 256);

#[allow(unsafe_code)]
// SAFETY: 32-bit atomics that are 0 at first.
unsafe impl Words for SessionWords {}

/// What the two sides of a session share besides messages. Its server makes and removes it, its client opens it.
#[derive(Debug)]
pub struct Bells(Mapping<SessionWords>);

impl Bells {
    /// Makes those of a session of the run `epoch` of the server. They are removed when this is
    /// dropped; should the server die before, with all else under the endpoint's prefix.
    pub fn make(endpoint: &Endpoint, epoch: u64, session: u64) -> io::Result<Self> {
        Mapping::make(endpoint.bells(epoch, session)).map(Self)
    }

    /// Opens those of a session.
    pub fn open(endpoint: &Endpoint, epoch: u64, session: u64) -> io::Result<Self> {
        Mapping::open(&endpoint.bells(epoch, session)).map(Self)
    }

    /// Removes those that earlier runs of the server have left, and their doors. Only a running server may:
    /// sessions of its own must not be there yet, or not any more.
    pub fn clear(endpoint: &Endpoint) -> io::Result<()> {
        endpoint.all_bells()?.into_iter().try_for_each(fs::remove_file)
    }

    /// What tells the client of replies.
    pub fn reply(&self) -> &Bell {
        &self.0.reply
    }

    /// What the server expects of the client's next request.
    pub fn size(&self) -> Size {
        Size::of(self.0.size.load(Ordering::Relaxed))
    }

    /// Says so.
    pub fn set_size(&self, size: Size) {
        self.0.size.store(size as u32, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::endpoint::Membership;

    fn pair(label: &str) -> (Membership, Bells, Bells) {
        let name = format!("t-{label}-{}", std::process::id());
        let endpoint = Endpoint::new(&name.parse().unwrap());
        let membership = endpoint.join().unwrap();
        let made = Bells::make(&endpoint, 7, 1).unwrap();
        let opened = Bells::open(&endpoint, 7, 1).unwrap();
        (membership, made, opened)
    }

    #[test]
    fn what_a_crash_left_is_cleared() {
        let (membership, made, _opened) = pair("left");
        let endpoint = membership.endpoint();
        std::mem::forget(made);
        Bells::clear(endpoint).unwrap();
        assert_eq!(endpoint.remains().unwrap(), [endpoint.folder()]);
    }

    #[test]
    fn they_are_removed_by_their_maker() {
        let (membership, made, opened) = pair("bells");
        let endpoint = membership.endpoint();
        let path = endpoint.bells(7, 1);
        assert!(endpoint.remains().unwrap().contains(&path));
        assert_eq!(Bells::make(endpoint, 7, 1).unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(opened.size(), Size::Large);
        made.set_size(Size::Small);
        assert_eq!(opened.size(), Size::Small);
        assert!(!made.reply().ring(), "the client is awake");
        opened.reply().set_asleep(true);
        assert!(made.reply().ring());
        assert_eq!(opened.reply().count(), 2);
        drop(opened);
        assert!(path.exists());
        drop(made);
        assert!(!path.exists());
        assert_eq!(Bells::open(endpoint, 7, 1).unwrap_err().kind(), io::ErrorKind::NotFound);
        // Nor is what is too short ever looked at.
        fs::write(&path, "short").unwrap();
        assert_eq!(Bells::open(endpoint, 7, 1).unwrap_err().kind(), io::ErrorKind::UnexpectedEof);
    }
}
