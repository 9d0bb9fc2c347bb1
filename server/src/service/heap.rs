//! The memory of sessions that have ended.
//!
//! The C library has a heap for each of many threads, and sessions are opened on threads of their own. Each heap keeps
//! what a session has freed there: 70 to 160 MiB after clients with 50 sessions each were killed, with two heaps that
//! are emptied 7. But threads that step environments lock a heap several times in each substep with contact, since the
//! engine makes empty sets of joints there. So there are as many heaps as such threads.
//!
//! It also keeps freed chunks of up to 1 KiB for the thread that freed them, 448 at most, and each may hold a page: 1.75
//! MiB for each thread that goes on. No call takes them from a thread, so workers end with the last session (`scheduler/worker.rs`).

/// Heaps at least.
const LEAST_HEAPS: usize = 2;

/// Limits the heaps of this process to one for each thread that steps environments, before its threads begin.
#[allow(unsafe_code)]
pub(super) fn limit(threads: usize) {
    let heaps = threads.max(LEAST_HEAPS) as libc::c_int;
    #[cfg(target_env = "gnu")]
    // SAFETY: it sets a number that the C library reads when a thread first asks for memory.
    unsafe {
        libc::mallopt(libc::M_ARENA_MAX, heaps);
    }
    #[cfg(not(target_env = "gnu"))]
    let _ = heaps;
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
