//! Memory of the machine, as far as a program may know of it.

use std::fs::read_to_string;

/// Where the limit of a group of processes stands, and what the group takes, by the two kinds of groups.
const GROUPS: [(&str, &str); 2] = [
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
];

/// Bytes that may still be had: what the machine has to spare, unless a limit of the process or of its group leaves less. `None` where
/// nothing is known.
pub fn memory_left() -> Option<u64> {
    let number = |path: &str| read_to_string(path).ok()?.trim().parse::<u64>().ok();
    let group =
        GROUPS.iter().filter_map(|(most, taken)| Some(number(most)?.saturating_sub(number(taken).unwrap_or(0))));
    machine().into_iter().chain(group).chain(process()).min()
}

/// A line of a file of Linux, in bytes.
fn line(path: &str, name: &str) -> Option<u64> {
    let told = read_to_string(path).ok()?;
    let line = told.lines().find_map(|line| line.strip_prefix(name))?;
    let kilobytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kilobytes << 10)
}

fn machine() -> Option<u64> {
    line("/proc/meminfo", "MemAvailable:")
}

/// Bytes of address space that programs and stacks take beside what is used.
#[cfg(unix)]
const BESIDE: u64 = 128 << 20;

/// Address space that this process may still use, about: the allocator takes some of it in advance, of which a part can be had in
/// large pieces.
#[cfg(unix)]
fn process() -> Option<u64> {
    use nix::sys::resource::{RLIM_INFINITY, Resource, getrlimit};
    let (limit, _) = getrlimit(Resource::RLIMIT_AS).ok()?;
    if limit == RLIM_INFINITY {
        return None;
    }
    let status = |name| line("/proc/self/status", name).unwrap_or(0);
    let (taken, used) = (status("VmSize:"), status("VmRSS:"));
    let in_advance = taken.saturating_sub(used + BESIDE) / 4;
    Some(limit.saturating_sub(taken) + in_advance)
}

#[cfg(not(unix))]
fn process() -> Option<u64> {
    None
}

/// A number of bytes in words.
pub fn bytes_in_words(bytes: u64) -> String {
    match bytes as f64 / 1e9 {
        small if small < 0.9995 => format!("{:.0} MB", 1000.0 * small),
        some if some < 9.95 => format!("{some:.1} GB"),
        many => format!("{many:.0} GB"),
    }
}

/// Watches memory while rows are read, so that it ends in a message and not in the middle of the work.
#[derive(Debug, Default)]
pub(crate) struct MemoryWatch {
    /// Rows at which memory was looked up last.
    looked: u64,
}

/// Rows from one look to the next, and what they and the work on them may take.
const STEP: u64 = 1 << 16;
const RESERVE: u64 = 96 << 20;

impl MemoryWatch {
    /// What the process takes and what is left, where the latter may not be enough to go on after so many rows. Room that grows does so
    /// by as much as it is, and may have to stand beside itself: rows of tests that have not ended take `held`, and no other list is so
    /// large a part of all.
    pub(crate) fn short(&mut self, rows: u64, held: u64) -> Option<(u64, u64)> {
        if rows < self.looked + STEP {
            return None;
        }
        self.looked = rows;
        let (taken, left) = (line("/proc/self/status", "VmRSS:")?, memory_left()?);
        (left < RESERVE + (2 * held).max(taken / 4)).then_some((taken, left))
    }
}
