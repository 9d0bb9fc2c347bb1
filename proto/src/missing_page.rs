//! Making and opening shared memory while `/dev/shm` is full. The transport writes to what it makes before it can be
//! allocated, and reads what others could not finish; where no page is left, the kernel sends `SIGBUS`, which ends the
//! process. Sending and receiving open what partners have made. Within [`guarded`], the page is replaced by
//! memory of this process instead, and what was made is dropped again and reported as not made.

use std::cell::Cell;
use std::io;
use std::sync::OnceLock;

use rustix::mm::{MapFlags, ProtFlags, mmap_anonymous};

#[derive(Clone, Copy, PartialEq)]
enum State {
    Unguarded,
    Guarded,
    /// Guarded, and a page was missing.
    Missed,
}

thread_local! {
    static STATE: Cell<State> = const { Cell::new(State::Unguarded) };
}

/// What is done with the signal elsewhere.
static PREVIOUS: OnceLock<Option<libc::sigaction>> = OnceLock::new();

/// Does what makes or opens shared memory; an error that names it where there was no page for that. What is made is then
/// dropped before anything else looks at it.
pub fn guarded<T>(make: impl FnOnce() -> T) -> io::Result<T> {
    PREVIOUS.get_or_init(install);
    let guard = Guard(STATE.replace(State::Guarded));
    let made = make();
    if STATE.get() != State::Missed {
        return Ok(made);
    }
    // Other pages of it may be missing, too.
    drop(made);
    drop(guard);
    Err(io::Error::new(
        io::ErrorKind::StorageFull,
        "/dev/shm is full; remove what fills it, or give the container more (docker run --shm-size)",
    ))
}

/// Restores what was before, also should a panic pass.
struct Guard(State);

impl Drop for Guard {
    fn drop(&mut self) {
        STATE.set(self.0);
    }
}

#[allow(unsafe_code)]
fn install() -> Option<libc::sigaction> {
    // SAFETY: `sigaction` consists of numbers and pointers that may be null; `handle` is of the type that SA_SIGINFO
    // asks for, and does nothing that a handler may not do.
    unsafe {
        let mut previous: libc::sigaction = std::mem::zeroed();
        let mut action: libc::sigaction = std::mem::zeroed();
        action.sa_sigaction = handle as *const () as libc::sighandler_t;
        action.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK | libc::SA_RESTART;
        let done = libc::sigaction(libc::SIGBUS, &raw const action, &raw mut previous) == 0;
        done.then_some(previous)
    }
}

/// Calls nothing but the kernel: a handler may run anywhere.
#[allow(unsafe_code)]
extern "C" fn handle(signal: libc::c_int, info: *mut libc::siginfo_t, _: *mut libc::c_void) {
    const PAGE: usize = 4096; // the least there is; where pages are larger, the next access comes here again
    // SAFETY: the kernel hands over a valid `info`. A page that does not exist in the file that is mapped there held
    // nothing, so nothing is lost when it is replaced; `previous` is what the kernel gave.
    unsafe {
        if STATE.get() != State::Unguarded && (*info).si_code == libc::BUS_ADRERR {
            let page = (*info).si_addr().map_addr(|address| address & !(PAGE - 1));
            let flags = MapFlags::PRIVATE | MapFlags::FIXED;
            if mmap_anonymous(page, PAGE, ProtFlags::READ | ProtFlags::WRITE, flags).is_ok() {
                STATE.set(State::Missed);
                return;
            }
        }
        // The access is made again, and the handler from before is called then.
        if let Some(Some(previous)) = PREVIOUS.get() {
            libc::sigaction(signal, previous, std::ptr::null_mut());
        }
    }
}

#[cfg(test)]
#[expect(unsafe_code, reason = "a page beyond the end of a file is one that cannot be had")]
mod tests {
    use std::fs::File;

    use super::*;

    /// Two pages of a file, of which the second is not there.
    fn beyond_the_end(file: &File) -> *mut u8 {
        file.set_len(4096).unwrap();
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: the kernel chooses where.
        let start = unsafe {
            rustix::mm::mmap(std::ptr::null_mut(), 8192, protection, MapFlags::SHARED, file, 0)
        };
        // SAFETY: two pages were mapped.
        unsafe { start.unwrap().cast::<u8>().add(4096) }
    }

    #[test]
    fn a_page_that_cannot_be_had_is_an_error() {
        let path = std::env::temp_dir().join(format!("trocar-page-{}", std::process::id()));
        let file = File::options().read(true).write(true).create_new(true).open(&path).unwrap();
        std::fs::remove_file(path).unwrap();
        let missing = beyond_the_end(&file);
        // SAFETY: it is mapped, and the guard provides for the page.
        let write = || unsafe { missing.write_volatile(7) };
        let error = guarded(|| {
            write();
            assert!(guarded(|| ()).is_ok(), "another one has what it needs");
        })
        .unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
        assert!(error.to_string().contains("/dev/shm"));
        assert_eq!(guarded(|| 3).unwrap(), 3);
    }
}
