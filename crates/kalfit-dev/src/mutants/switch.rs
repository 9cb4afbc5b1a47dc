//! Which mutant is on: compiled into the changed copy of the core, not into this program.

use std::io::Write;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// The environment has not been asked yet.
const ASK: usize = usize::MAX;
/// None is on; those that are met are written down.
const NOTE: usize = usize::MAX - 1;
/// None is on.
const NONE: usize = usize::MAX - 2;

static ON: AtomicUsize = AtomicUsize::new(ASK);

/// Whether this mutant is on.
pub(crate) fn on(mutant: usize) -> bool {
    let now = ON.load(Ordering::Relaxed);
    if now < NONE { now == mutant } else { now != NONE && asked(mutant, now) }
}

#[cold]
fn asked(mutant: usize, now: usize) -> bool {
    if now == ASK {
        let said = std::env::var("KALFIT_MUTANT").ok().and_then(|number| number.parse().ok());
        let silent = if std::env::var_os("KALFIT_MUTANTS_MET").is_some() { NOTE } else { NONE };
        ON.store(said.unwrap_or(silent), Ordering::Relaxed);
        return on(mutant);
    }
    static MET: [AtomicBool; 4096] = [const { AtomicBool::new(false) }; 4096];
    if !MET[mutant].swap(true, Ordering::Relaxed) {
        let file = std::env::var_os("KALFIT_MUTANTS_MET").map(|path| std::fs::OpenOptions::new().append(true).create(true).open(path));
        if let Some(Ok(mut file)) = file {
            let _ = file.write_all(format!("{mutant}\n").as_bytes());
        }
    }
    false
}
