//! Files that the parent process has left open to this one.

use std::os::fd::RawFd;

use rustix::fd::{FromRawFd, OwnedFd};

/// Closes files in shared memory that this process has inherited. The transport does not mark its
/// files to be closed, so a client that starts a server leaves it the files of all its sessions. Their
/// memory would be kept as long as the server runs. To be called before anything else.
pub(crate) fn close_shared_memory() {
    let Ok(entries) = std::fs::read_dir("/proc/self/fd") else { return };
    let inherited: Vec<RawFd> = entries
        .flatten()
        .filter(|entry| {
            std::fs::read_link(entry.path()).is_ok_and(|file| {
                file.to_str().is_some_and(|file| file.starts_with("/dev/shm/trocar"))
            })
        })
        .filter_map(|entry| entry.file_name().to_str()?.parse().ok())
        .filter(|number| *number > rustix::stdio::raw_stderr())
        .collect();
    for number in inherited {
        #[allow(unsafe_code)]
        // SAFETY: this process has opened nothing in shared memory yet, so whatever is open there
        // was inherited and has no owner here; every number is listed once.
        drop(unsafe { OwnedFd::from_raw_fd(number) });
    }
}
