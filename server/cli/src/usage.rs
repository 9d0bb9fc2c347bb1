//! What other processes use, as `/proc` tells.

use std::fs;
use std::path::Path;

use anyhow::Context;

/// Parts of a second in which the kernel states CPU times. It is the same number on every Linux
/// whose programs we run: it is part of the kernel's interface.
pub(crate) const TICKS_PER_SECOND: f64 = 100.0;

/// CPU time of some processes together, with all of their threads, s.
pub(crate) fn cpu_seconds(pids: &[u32]) -> anyhow::Result<f64> {
    let of = |pid: &u32| -> anyhow::Result<f64> {
        let path = format!("/proc/{pid}/stat");
        let text = fs::read_to_string(&path).with_context(|| path.clone())?;
        ticks(&text).map(|ticks| ticks as f64 / TICKS_PER_SECOND).context(path)
    };
    pids.iter().map(of).sum()
}

/// User and system time of all threads of a process, those that have ended included.
fn ticks(stat: &str) -> Option<u64> {
    // The program's name may hold anything, so fields are counted from its closing parenthesis.
    let (_, fields) = stat.rsplit_once(')')?;
    let mut fields = fields.split_whitespace().skip(11);
    let (user, system) = (fields.next()?, fields.next()?);
    Some(user.parse::<u64>().ok()? + system.parse::<u64>().ok()?)
}

/// Memory of a process that is in RAM, what it shares with others included, bytes.
pub(crate) fn resident_memory(pid: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? << 10)
}

/// Number of open files of a process.
pub(crate) fn open_files(pid: u32) -> usize {
    fs::read_dir(format!("/proc/{pid}/fd")).map_or(0, Iterator::count)
}

/// Number of pieces of memory that a process maps from files whose paths begin with `prefix`.
pub(crate) fn mappings(pid: u32, prefix: &str) -> usize {
    let maps = fs::read_to_string(format!("/proc/{pid}/maps")).unwrap_or_default();
    maps.lines().filter(|line| line.contains(prefix)).count()
}

/// Whether a process has files of `folder` open.
pub(crate) fn holds_files_in(pid: u32, folder: &Path) -> bool {
    let Ok(entries) = fs::read_dir(format!("/proc/{pid}/fd")) else { return false };
    entries
        .flatten()
        .any(|entry| fs::read_link(entry.path()).is_ok_and(|target| target.starts_with(folder)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_counted_from_the_end_of_the_name() {
        let stat = "12 (a ) b) S 1 2 3 4 5 6 7 8 9 10 70 30 0 0 20 0 1 0 5";
        assert_eq!(ticks(stat), Some(100));
    }

    #[test]
    fn this_process_is_seen() {
        let pid = std::process::id();
        assert!(resident_memory(pid).unwrap() > 1 << 20);
        let before = open_files(pid);
        let file = fs::File::open("/proc/self/stat").unwrap();
        // Other tests open and close files, too.
        assert!(before > 0 && open_files(pid) > 0);
        assert!(holds_files_in(pid, Path::new("/")));
        drop(file);
        let program = std::env::current_exe().unwrap();
        assert!(mappings(pid, program.to_str().unwrap()) > 0);
        assert_eq!(mappings(pid, "/no/such/file"), 0);
    }
}
