//! What wakes up the other side of a session: a word in shared memory for each direction, on which
//! the kernel lets a thread sleep (futex(2)).
//!
//! Whoever has sent a message *rings*: counts one up. Whoever waits compares the count with the one
//! before it last looked. As long as both are awake, that is all, and nobody calls the kernel. Before
//! somebody sleeps, it says so ([`Bell::arm`]) and looks once more; whoever rings then sees that and
//! has it woken up. No ring is missed:
//!
//! | who rings | who sleeps |
//! |---|---|
//! | 1. counts one up | 1. says that it sleeps |
//! | 2. reads whether the other sleeps | 2. reads the count, and does not sleep if it is a new one |
//!
//! All four are sequentially consistent, so one of the first steps comes before the other one's
//! second: it wakes or the other does not sleep. And the kernel compares the count once more before a
//! thread sleeps, under the lock that a wake-up takes.
//!
//! Both sides can write to both words. What is wrong there costs the session time and nothing else:
//! every wait has an end, and then its caller looks whatever the word says.

use std::fmt;
use std::fs::{self, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;
use std::ptr::{self, NonNull};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use rustix::fs::FallocateFlags;
use rustix::io::Errno;
use rustix::mm::{MapFlags, ProtFlags};
use rustix::thread::futex;

use crate::endpoint::Endpoint;

/// One direction of a session.
#[derive(Debug)]
#[repr(C, align(128))] // the two directions do not slow each other down
pub struct Bell {
    /// How often it was rung.
    count: AtomicU32,
    /// Not 0 where who rings has to wake the other up.
    armed: AtomicU32,
}

/// How a wait ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Woken {
    /// There may have been a ring.
    Rung,
    /// The time was over.
    Late,
    /// A signal came.
    Interrupted,
}

impl Bell {
    /// Tells the other side that a message is there; returns whether it had to be woken up for that.
    pub fn ring(&self) -> bool {
        self.count.fetch_add(1, Ordering::SeqCst);
        let asleep = self.armed.load(Ordering::SeqCst) != 0;
        if asleep {
            self.wake();
        }
        asleep
    }

    /// How often it was rung, modulo 2³². What was sent before these rings can be received.
    pub fn count(&self) -> u32 {
        self.count.load(Ordering::SeqCst)
    }

    /// From now on, who rings wakes up who waits. Look at the count again before you wait.
    pub fn arm(&self) {
        self.armed.store(1, Ordering::SeqCst);
    }

    /// From now on somebody is awake and will look at the count.
    pub fn disarm(&self) {
        self.armed.store(0, Ordering::SeqCst);
    }

    /// Wakes up who waits, without a ring.
    pub fn wake(&self) {
        // Fails where the memory is gone, and then nobody waits on it.
        futex::wake(&self.count, futex::Flags::empty(), 1).ok();
    }

    /// Sleeps until it is rung or woken, at most for `limit`; not at all where the count is not `seen`.
    pub fn wait(&self, seen: u32, limit: Duration) -> Woken {
        let limit = futex::Timespec {
            tv_sec: limit.as_secs().try_into().unwrap_or(i64::MAX),
            tv_nsec: limit.subsec_nanos().into(),
        };
        match futex::wait(&self.count, futex::Flags::empty(), seen, Some(&limit)) {
            Err(Errno::TIMEDOUT) => Woken::Late,
            Err(Errno::INTR) => Woken::Interrupted,
            Ok(()) | Err(_) => Woken::Rung,
        }
    }

    /// As [`Self::wait`], for somebody who looks at the count only when awake.
    pub fn sleep(&self, seen: u32, limit: Duration) -> Woken {
        self.arm();
        let woken = if self.count() == seen { self.wait(seen, limit) } else { Woken::Rung };
        self.disarm();
        woken
    }
}

/// Both directions, as they lie in shared memory; zeros at first.
#[derive(Debug)]
#[repr(C)]
struct Words {
    request: Bell,
    reply: Bell,
}

const BYTES: usize = size_of::<Words>();
const _: () = assert!(BYTES == 256 && align_of::<Words>() <= 4096);

/// The bells of a session. Its server makes and removes them, its client opens them.
pub struct Bells {
    words: NonNull<Words>,
    /// Where they are to be removed.
    made: Option<PathBuf>,
}

#[allow(unsafe_code)]
// SAFETY: all that can be reached are atomics; the mapping belongs to no thread.
unsafe impl Send for Bells {}
#[allow(unsafe_code)]
// SAFETY: as above.
unsafe impl Sync for Bells {}

impl Bells {
    /// Makes those of a session of the run `epoch` of the server. They are removed when this is
    /// dropped; should the server die before, with all else under the endpoint's prefix.
    pub fn make(endpoint: &Endpoint, epoch: u64, session: u64) -> io::Result<Self> {
        let path = endpoint.bells(epoch, session);
        let file =
            OpenOptions::new().read(true).write(true).create_new(true).mode(0o600).open(&path)?;
        // Memory that is only promised would end the process when it is first written to.
        let bells = rustix::fs::fallocate(&file, FallocateFlags::empty(), 0, BYTES as u64)
            .map_err(io::Error::from)
            .and_then(|()| Self::map(&file));
        match bells {
            Ok(mut bells) => {
                bells.made = Some(path);
                Ok(bells)
            }
            Err(error) => {
                fs::remove_file(path).ok();
                Err(error)
            }
        }
    }

    /// Removes those that earlier runs of the server have left. Only a running server may: sessions
    /// of its own must not be there yet, or not any more.
    pub fn clear(endpoint: &Endpoint) -> io::Result<()> {
        endpoint.all_bells()?.into_iter().try_for_each(fs::remove_file)
    }

    /// Opens those of a session.
    pub fn open(endpoint: &Endpoint, epoch: u64, session: u64) -> io::Result<Self> {
        let path = endpoint.bells(epoch, session);
        let file = OpenOptions::new().read(true).write(true).open(path)?;
        if file.metadata()?.len() < BYTES as u64 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        Self::map(&file)
    }

    /// What tells the server of requests.
    pub fn request(&self) -> &Bell {
        &self.words().request
    }

    /// What tells the client of replies.
    pub fn reply(&self) -> &Bell {
        &self.words().reply
    }

    #[allow(unsafe_code)]
    fn map(file: &fs::File) -> io::Result<Self> {
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: the kernel chooses the place, so nothing that is there is replaced.
        let place = unsafe {
            rustix::mm::mmap(ptr::null_mut(), BYTES, protection, MapFlags::SHARED, file, 0)
        }?;
        let words = NonNull::new(place.cast()).ok_or(io::ErrorKind::OutOfMemory)?;
        Ok(Self { words, made: None })
    }

    #[allow(unsafe_code)]
    fn words(&self) -> &Words {
        // SAFETY: the mapping is as long as the words, aligned to a page, and stays until this is
        // dropped; atomics may be written to by others, and every value of theirs is valid.
        unsafe { self.words.as_ref() }
    }
}

impl fmt::Debug for Bells {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Bells").field("words", self.words()).field("made", &self.made).finish()
    }
}

impl Drop for Bells {
    #[allow(unsafe_code)]
    fn drop(&mut self) {
        if let Some(path) = &self.made {
            // What cannot be removed now goes with all else of this endpoint.
            fs::remove_file(path).ok();
        }
        // SAFETY: it was mapped by `map`, as long as that, and nothing refers to it any more.
        unsafe { rustix::mm::munmap(self.words.as_ptr().cast(), BYTES) }.ok();
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    const LONG: Duration = Duration::from_mins(1);

    fn pair(label: &str) -> (crate::endpoint::Membership, Bells, Bells) {
        let name = format!("t-{label}-{}", std::process::id());
        let endpoint = Endpoint::new(&name.parse().unwrap());
        let membership = endpoint.join().unwrap();
        let made = Bells::make(&endpoint, 7, 1).unwrap();
        let opened = Bells::open(&endpoint, 7, 1).unwrap();
        (membership, made, opened)
    }

    #[test]
    fn no_ring_is_missed() {
        const ROUNDS: u32 = 20_000;
        let (_membership, server, client) = pair("rings");
        thread::scope(|scope| {
            scope.spawn(|| {
                for round in 0..ROUNDS {
                    while server.request().count() == round {
                        assert_ne!(server.request().sleep(round, LONG), Woken::Late);
                    }
                    server.reply().ring();
                }
            });
            for round in 0..ROUNDS {
                client.request().ring();
                while client.reply().count() == round {
                    assert_ne!(client.reply().sleep(round, LONG), Woken::Late);
                }
            }
        });
        assert_eq!((server.request().count(), server.reply().count()), (ROUNDS, ROUNDS));
    }

    #[test]
    fn a_wait_ends_at_once_where_it_was_rung_and_else_in_time() {
        let (_membership, server, client) = pair("waits");
        let bell = server.request();
        assert_eq!(bell.sleep(0, Duration::from_millis(1)), Woken::Late);
        client.request().ring();
        assert_eq!(bell.sleep(0, LONG), Woken::Rung);
        // Somebody who sleeps is woken up without a ring, too.
        thread::scope(|scope| {
            let sleeper = scope.spawn(|| bell.sleep(1, LONG));
            while !sleeper.is_finished() {
                client.request().wake();
                thread::yield_now();
            }
            assert_eq!(sleeper.join().unwrap(), Woken::Rung);
        });
        assert_eq!(bell.count(), 1);
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
    fn they_are_removed_by_who_made_them() {
        let (membership, made, opened) = pair("bells");
        let endpoint = membership.endpoint();
        let path = endpoint.bells(7, 1);
        assert!(endpoint.remains().unwrap().contains(&path));
        assert_eq!(Bells::make(endpoint, 7, 1).unwrap_err().kind(), io::ErrorKind::AlreadyExists);
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
