//! The book: written anew by the test that compares its pages with what the commands print, or opened in a browser.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use crate::places;
use crate::places::MEASURE;

/// The version of mdBook that the pages were looked at with.
const MDBOOK: &str = "0.5.4";

/// Runs the book's tests so that they write instead of compare.
pub(crate) fn write() -> ExitCode {
    let mut cargo = Command::new("cargo");
    // built as `cargo dev test` builds it, so that nothing is built twice
    cargo.args(["test", "--quiet", "--locked", "--workspace", "--features", MEASURE, "--test", "book"]);
    ended(cargo.args(["--", "--test-threads", "1"]).env("KALFIT_BOOK", "write"), "cargo")
}

/// Shows the book in a browser, by mdBook, which is installed into the target directory first where it is missing.
pub(crate) fn open() -> ExitCode {
    match mdbook() {
        Ok(program) => {
            let book = places::root().join("book");
            ended(Command::new(program).arg("serve").arg(book).arg("--open"), "mdbook")
        }
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

/// The program: that of the user, or ours.
fn mdbook() -> Result<PathBuf, String> {
    let works =
        |program: &Path| Command::new(program).arg("--version").output().is_ok_and(|done| done.status.success());
    let own = PathBuf::from("mdbook");
    if works(&own) {
        return Ok(own);
    }
    let tools = places::target()?.join("tools");
    let ours = tools.join("bin").join(format!("mdbook{}", std::env::consts::EXE_SUFFIX));
    if !works(&ours) {
        println!("== mdBook is not installed: cargo install mdbook {MDBOOK} into {}, some minutes", tools.display());
        let mut cargo = Command::new("cargo");
        cargo.args(["install", "--locked", "--version", MDBOOK, "mdbook", "--root"]).arg(&tools);
        if !cargo.status().is_ok_and(|status| status.success()) {
            return Err("mdBook could not be installed: see above, or install it as `mdbook`".to_owned());
        }
    }
    Ok(ours)
}

fn ended(command: &mut Command, what: &str) -> ExitCode {
    match command.status() {
        Ok(status) if status.success() => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("{what}: {error}");
            ExitCode::FAILURE
        }
    }
}
