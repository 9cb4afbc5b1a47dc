//! Memory that a fit needs, said before the work begins: second derivatives by all elements of Σ take matrices over those elements, and
//! there are half as many of them as states squared.

use std::path::Path;

use kalfit::estimate::memory;
use kalfit_spec::Spec;

use crate::failure::Failure;

/// What no machine is asked about.
const SMALL: u64 = 256 << 20;

/// Where the limits of a group of processes stand, of both kinds.
const GROUP_LIMITS: [&str; 2] = ["/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"];

/// An error where a fit of the model needs more memory than there is, as far as that can be known.
pub(crate) fn suffices(spec: &Spec) -> Result<(), Failure> {
    let blocks: Vec<usize> = spec.model.blocks().map(|(_, states)| states.len()).collect();
    let needed = memory(&blocks);
    if needed < SMALL {
        return Ok(());
    }
    match available() {
        Some(available) if needed > available => {
            Err(Failure::Memory { states: spec.model.dimension(), needed, available })
        }
        _ => Ok(()),
    }
}

/// Bytes that may be had: what the machine has to spare, unless a limit of the process or of its group is lower.
fn available() -> Option<u64> {
    let group = GROUP_LIMITS.iter().filter_map(|path| std::fs::read_to_string(path).ok()?.trim().parse().ok());
    free().into_iter().chain(group).chain(process_limit()).min()
}

/// What Linux has to spare.
fn free() -> Option<u64> {
    let told = std::fs::read_to_string(Path::new("/proc/meminfo")).ok()?;
    let line = told.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let kilobytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kilobytes << 10)
}

/// The address space that this process may have.
#[cfg(unix)]
fn process_limit() -> Option<u64> {
    use nix::sys::resource::{RLIM_INFINITY, Resource, getrlimit};
    let (limit, _) = getrlimit(Resource::RLIMIT_AS).ok()?;
    (limit != RLIM_INFINITY).then_some(limit)
}

#[cfg(not(unix))]
fn process_limit() -> Option<u64> {
    None
}

/// Bytes in words.
pub(crate) fn in_words(bytes: u64) -> String {
    let megabytes = bytes.div_ceil(1_000_000);
    if megabytes < 1000 { format!("{megabytes} MB") } else { format!("{} GB", megabytes.div_ceil(1000)) }
}
