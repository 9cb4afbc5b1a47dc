//! The book, written anew: the test that compares its pages with what the commands print can also write them.

use std::process::{Command, ExitCode};

/// Runs the book's tests so that they write instead of compare.
pub(crate) fn write() -> ExitCode {
    let arguments = ["test", "--quiet", "--locked", "-p", "kalfit-cli", "--test", "book", "--", "--test-threads", "1"];
    match Command::new("cargo").args(arguments).env("KALFIT_BOOK", "write").status() {
        Ok(status) if status.success() => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("cargo: {error}");
            ExitCode::FAILURE
        }
    }
}
