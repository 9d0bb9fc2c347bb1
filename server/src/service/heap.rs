//! The memory of sessions that have ended.
//!
//! The C library has a heap for each of many threads, and sessions are opened on threads of their own. Each heap keeps
//! what a session has freed there: 70 to 160 MiB after clients with 50 sessions each were killed, with two heaps that
//! are emptied 7.
//!
//! It also keeps freed chunks of up to 1 KiB for the thread that freed them, 448 at most, and each may hold a page: 1.75
//! MiB for each thread that goes on. No call takes them from a thread, so workers end with the last session (`hall.rs`).

/// Heaps at most: threads that step environments hardly use one.
#[cfg(target_env = "gnu")]
const HEAPS: libc::c_int = 2;

/// Limits the heaps of this process, before its threads begin.
#[allow(unsafe_code)]
pub(super) fn limit() {
    #[cfg(target_env = "gnu")]
    // SAFETY: it sets a number that the C library reads when a thread first asks for memory.
    unsafe {
        libc::mallopt(libc::M_ARENA_MAX, HEAPS);
    }
}

/// Gives memory that was freed back to the system.
#[allow(unsafe_code)]
pub(super) fn give_back() {
    #[cfg(target_env = "gnu")]
    // SAFETY: it takes the locks of the heaps, and moves nothing that is in use.
    unsafe {
        libc::malloc_trim(0);
    }
}
