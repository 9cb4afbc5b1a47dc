//! The command `kalfit`: what was typed → what is meant → one job → what is shown, and the exit status.

mod args;
mod job;
mod progress;
mod show;
mod terminal;

use std::process::ExitCode;

use clap::Parser;

fn main() -> ExitCode {
    match job::Order::from(args::Args::parse()).run() {
        Ok(outcome) => outcome.exit_code(),
        Err(ended) => {
            terminal::complain(&ended.words());
            ExitCode::from(2)
        }
    }
}
