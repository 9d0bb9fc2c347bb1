//! The memory of sessions that have ended.

/// Gives memory that was freed back to the system. The C library has heaps for many threads, and sessions are opened on
/// threads of their own: each heap would keep what a session has freed there.
#[allow(unsafe_code)]
pub(super) fn give_back() {
    #[cfg(target_env = "gnu")]
    // SAFETY: it takes the locks of the heaps, and moves nothing that is in use.
    unsafe {
        libc::malloc_trim(0);
    }
}
