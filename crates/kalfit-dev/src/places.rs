//! Where things are: the project's root, and what cargo builds of it, whichever folder the user has cargo build in.

use std::path::{Path, PathBuf};

/// The feature with which this package and all others are built for tests: one build serves every step.
pub(crate) const MEASURE: &str = "kalfit-dev/measure";

/// The root of the repository.
pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("the crate lies in crates/")
}

/// What cargo builds: this program lies in its `debug` or `release`.
///
/// The folder is named by a variable, by an option or by a configuration file of cargo's, or is `target`; the program that cargo
/// has built there knows.
pub(crate) fn target() -> Result<PathBuf, String> {
    let program = std::env::current_exe().map_err(|error| error.to_string())?;
    Ok(program.ancestors().nth(2).ok_or("the program has no folder")?.to_owned())
}

/// The program `kalfit` of a profile, in the folder of what cargo builds.
pub(crate) fn kalfit(target: &Path, profile: &str) -> PathBuf {
    target.join(profile).join(format!("kalfit{}", std::env::consts::EXE_SUFFIX))
}
