//! The command `kalfit`: what was typed → what is meant → one call → exit status.

mod args;
mod check;
mod diagnostic;
mod dynamic;
mod estimates;
mod evidence;
mod exchange;
mod failure;
mod fit;
mod innovations;
mod job;
mod lost;
mod model;
mod output;
mod plan;
mod progress;
mod ratio;
mod reduce;
mod reductions;
mod report;
mod simulate;
mod terminal;
mod test;
mod tests;
mod truth;

use std::process::ExitCode;

use clap::Parser;

fn main() -> ExitCode {
    match job::Job::from(args::Args::parse()).run() {
        Ok(outcome) => outcome.exit_code(),
        Err(failure) => {
            terminal::complain(&diagnostic::render(&failure, terminal::color_on_stderr()));
            ExitCode::from(2)
        }
    }
}
