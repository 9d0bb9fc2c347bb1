//! Open files of this process: how many it has and may have, and what clients and sessions take.

use rustix::io::Errno;
use rustix::process::{Resource, getrlimit};

/// Files that a session keeps open on either side (measured: 7).
pub const SESSION_FILES: usize = 8;

/// Files that a client keeps open on either side besides those of its sessions (measured: 3 in the server, 18 in the
/// client, which needs some more for moments).
pub const CLIENT_FILES: usize = 24;

/// Files that a process has open, and may have open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OpenFiles {
    /// How many there are.
    pub used: usize,
    /// How many there may be (`RLIMIT_NOFILE`, the soft limit).
    pub limit: usize,
}

impl Default for OpenFiles {
    /// No limit.
    fn default() -> Self {
        Self { used: 0, limit: usize::MAX }
    }
}

impl OpenFiles {
    /// Those of this process.
    pub fn now() -> Self {
        let limit = getrlimit(Resource::Nofile).current;
        let limit = limit.map_or(usize::MAX, |limit| usize::try_from(limit).unwrap_or(usize::MAX));
        let used = match std::fs::read_dir("/proc/self/fd") {
            // The list itself is one of them.
            Ok(files) => files.count() - 1,
            Err(error) if error.raw_os_error() == Some(Errno::MFILE.raw_os_error()) => limit,
            // Not known; an operation that needs more than there are will tell.
            Err(_) => 0,
        };
        Self { used, limit }
    }

    /// How many sessions more there may be, if `reserve` files stay free.
    pub fn sessions(&self, reserve: usize) -> usize {
        self.limit.saturating_sub(self.used + reserve) / SESSION_FILES
    }

    /// Says why `what` of this process cannot have `needed` files more, if it cannot.
    pub fn check(&self, what: &str, needed: usize) -> Result<(), String> {
        if self.limit.saturating_sub(self.used) >= needed {
            return Ok(());
        }
        Err(format!(
            "open files: this process has {} of the {} that it may have, and {what} takes {needed}; close some, or \
             raise the limit (ulimit -n)",
            self.used, self.limit
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_counted_and_what_does_not_fit_is_named() {
        let before = OpenFiles::now();
        let file = std::fs::File::open("/dev/null").unwrap();
        assert!(OpenFiles::now().used > 0 && before.limit > 0);
        drop(file);
        let few = OpenFiles { used: 1000, limit: 1024 };
        assert_eq!((few.sessions(8), few.sessions(24)), (2, 0));
        assert_eq!(few.check("a session", 24), Ok(()));
        let refusal = few.check("a session", 25).unwrap_err();
        assert!(["open files", "1000", "1024", "25"].iter().all(|word| refusal.contains(word)));
    }
}
