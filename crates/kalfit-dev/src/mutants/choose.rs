//! Which of all changes become mutants: each has its place in an order drawn from the seed, so that a change of one file leaves
//! those of the others as they were.

use std::collections::BTreeSet;
use std::path::Path;

use super::find::{self, SourceChange};
use super::rewrite::overlap;
use super::sources::shares;

/// A change of a file of the core.
#[derive(Debug, Clone)]
pub(super) struct Mutant {
    pub(super) group: &'static str,
    pub(super) file: &'static str,
    pub(super) change: SourceChange,
    /// What it is known by from run to run: its file, its words and its line of source.
    pub(super) key: String,
}

/// So many mutants, shared out over the files; without those whose keys are in the set.
pub(super) fn chosen(
    sources: &Path,
    (count, seed): (usize, u64),
    without: &BTreeSet<String>,
) -> Result<Vec<Mutant>, String> {
    let mut all = Vec::new();
    for (group, file, share) in shares(count) {
        let mut candidates = candidates(sources, group, file)?;
        candidates.sort_by_key(|mutant| place(seed, &mutant.key));
        let mut taken: Vec<Mutant> = Vec::new();
        for mutant in candidates {
            let apart = |other: &Mutant| !overlap(&other.change, &mutant.change);
            if taken.len() < share && !without.contains(&mutant.key) && taken.iter().all(apart) {
                taken.push(mutant);
            }
        }
        taken.sort_by_key(|mutant| mutant.change.line);
        all.extend(taken);
    }
    Ok(all)
}

/// All changes of a file.
fn candidates(sources: &Path, group: &'static str, file: &'static str) -> Result<Vec<Mutant>, String> {
    let path = sources.join(file);
    let text = std::fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    let changes = find::changes(&text).map_err(|error| format!("{}: {error}", path.display()))?;
    let lines: Vec<&str> = text.lines().collect();
    let mut seen = BTreeSet::new();
    let mut known = |change: &SourceChange| {
        let line = lines.get(change.line - 1).map_or("", |line| line.trim());
        let mut key = format!("{file}: {} in {line}", change.what);
        while !seen.insert(key.clone()) {
            key.push('\''); // the same once more
        }
        key
    };
    Ok(changes.into_iter().map(|change| Mutant { group, file, key: known(&change), change }).collect())
}

/// Place in the order of a seed: FNV-1a, mixed.
fn place(seed: u64, key: &str) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325 ^ seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    for byte in key.bytes() {
        hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
    }
    hash = (hash ^ (hash >> 32)).wrapping_mul(0xd6e8_feb8_6659_fd93);
    hash ^ (hash >> 32)
}
