//! Whole runs of kalfit's command: a process from its start to its end, files read and written.

use std::path::{Path, PathBuf};
use std::process::Command;

use kalfit::FitRecord;

use super::clock::{self, TimeTaken};

/// The command and a folder for its files.
#[derive(Debug)]
pub(crate) struct KalfitCommand {
    pub(crate) command: PathBuf,
    pub(crate) folder: PathBuf,
}

/// Where the results of the last fit lie.
const RESULTS: &str = "fit.json";

impl KalfitCommand {
    /// One run in the folder; an error unless it is done and certified.
    pub(super) fn run(&self, arguments: &[&str]) -> Result<TimeTaken, String> {
        let mut command = Command::new(&self.command);
        let shown = format!("{} {}", self.command.display(), arguments.join(" "));
        let (output, taken) = clock::child(command.args(arguments).current_dir(&self.folder))?;
        let output = output.map_err(|error| format!("{shown}: {error}"))?;
        if output.status.success() {
            Ok(taken)
        } else {
            Err(format!("{shown}: {}\n{}", output.status, String::from_utf8_lossy(&output.stderr)))
        }
    }

    /// The run with the median processor time of several.
    pub(super) fn median(&self, runs: usize, arguments: &[&str]) -> Result<TimeTaken, String> {
        clock::median(runs, |taken| *taken, || self.run(arguments))
    }

    /// Whole fits by one thread, results written to a file.
    pub(super) fn fit(&self, model: &str, data: &Path) -> Result<TimeTaken, String> {
        self.median(9, &["fit", model, path(data)?, "--threads", "1", "--out", RESULTS])
    }

    /// What the last fit wrote.
    pub(super) fn record(&self) -> Result<FitRecord, String> {
        let file = self.folder.join(RESULTS);
        let text = std::fs::read_to_string(&file).map_err(|error| format!("{}: {error}", file.display()))?;
        serde_json::from_str(&text).map_err(|error| format!("{}: {error}", file.display()))
    }
}

/// A path as an argument.
pub(super) fn path(path: &Path) -> Result<&str, String> {
    path.to_str().ok_or_else(|| format!("the path {} is not in UTF-8", path.display()))
}
