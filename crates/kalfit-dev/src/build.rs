//! Tasks that need kalfit itself: this program is built without it, so that `cargo dev test` talks at once, and builds itself again.

use std::process::{Command, ExitCode};

/// Their names.
const TASKS: [&str; 8] =
    ["coverage", "maxima", "false-alarms", "fuzz-in-process", "mutants", "whiteness", "bench", "peers"];

/// Runs such a task in a release build.
pub(crate) fn run(words: &[String]) -> ExitCode {
    let task = words.first().map_or("", String::as_str);
    if !TASKS.contains(&task) {
        eprintln!("there is no task `{task}`: `cargo dev --help` lists all");
        return ExitCode::from(2);
    }
    // mutants work on a copy of the core, which this program need not have in it
    let how: &[&str] =
        if task == "mutants" { &["--features", "mutants"] } else { &["--release", "--features", "measure"] };
    println!("== {task}: cargo run --package kalfit-dev {}, some minutes at first", how.join(" "));
    let mut cargo = Command::new("cargo");
    cargo.args(["run", "--quiet", "--locked", "--package", "kalfit-dev"]).args(how).arg("--");
    match cargo.args(words).status() {
        Ok(status) if status.success() => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("cargo: {error}");
            ExitCode::FAILURE
        }
    }
}
