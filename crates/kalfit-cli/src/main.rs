//! The command `kalfit`: what was typed → what is meant → one job → what is shown, and the exit status.

mod args;
mod ended;
mod examples;
mod generate;
mod init;
mod interrupt;
mod job;
mod progress;
mod show;
mod templates;
mod terminal;
mod threads;

use std::process::ExitCode;

use clap::Parser;

/// Tests are many and what each leaves is small (docs/decisions/0010-lanes.md).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    interrupt::end_early();
    interrupt::end_in_order_without_memory();
    kalfit_data::keep_quiet_of_broken_files();
    let args = args::Args::parse();
    terminal::choose_color(args.global.color);
    match job::CommandOrder::from(args).run() {
        Ok(outcome) => outcome.exit_code(),
        Err(ended) => {
            terminal::complain(&ended.words());
            ended.exit_code()
        }
    }
}
