//! How a command ended: its exit status, and what is said of one without results.

use std::process::ExitCode;

use kalfit_job::Failure;

use crate::generate::ManError;
use crate::init::InitError;
use crate::interrupt;
use crate::terminal;

/// How a command ended that had good input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CommandOutcome {
    Done,
    NotCertified,
    /// Something could not be written, where other files were.
    Incomplete,
    /// By Ctrl-C, with what there was.
    Interrupted,
}

impl CommandOutcome {
    /// Of a fit, or of what is made of fits.
    pub(crate) fn of(converged: bool) -> CommandOutcome {
        if converged { CommandOutcome::Done } else { CommandOutcome::NotCertified }
    }

    /// The same, when something could not be written.
    pub(crate) fn with_losses(self) -> CommandOutcome {
        if self == CommandOutcome::Interrupted { self } else { CommandOutcome::Incomplete }
    }

    pub(crate) fn exit_code(self) -> ExitCode {
        match self {
            CommandOutcome::Done => ExitCode::SUCCESS,
            CommandOutcome::NotCertified | CommandOutcome::Incomplete => ExitCode::FAILURE,
            CommandOutcome::Interrupted => ExitCode::from(interrupt::STATUS),
        }
    }
}

/// Why a command ended without results that were seen.
#[derive(Debug)]
pub(crate) enum CommandFailure {
    /// The job could not be done.
    Failed(Box<Failure>),
    /// No starter model was written.
    NotBegun(InitError),
    /// No manual pages were written.
    NoPages(ManError),
    /// Standard output could not be written.
    Unheard(std::io::Error),
}

impl From<Failure> for CommandFailure {
    fn from(failure: Failure) -> CommandFailure {
        CommandFailure::Failed(Box::new(failure))
    }
}

impl CommandFailure {
    /// Bad input, unless it was the user who ended it.
    pub(crate) fn exit_code(&self) -> ExitCode {
        match self {
            CommandFailure::Failed(failure) if matches!(**failure, Failure::Interrupted) => {
                ExitCode::from(interrupt::STATUS)
            }
            _ => ExitCode::from(2),
        }
    }

    /// The whole message.
    pub(crate) fn words(&self) -> String {
        let color = terminal::color_on_stderr();
        match self {
            CommandFailure::Failed(failure) => kalfit_job::render(failure, color),
            CommandFailure::NotBegun(error) => kalfit_job::render_hinted(&error.to_string(), error.hint(), color),
            CommandFailure::NoPages(_) | CommandFailure::Unheard(_) => {
                kalfit_job::render_message(&self.message(), color)
            }
        }
    }

    /// The message alone.
    pub(crate) fn message(&self) -> String {
        match self {
            CommandFailure::Failed(failure) => failure.to_string(),
            CommandFailure::NotBegun(error) => error.to_string(),
            CommandFailure::NoPages(error) => error.to_string(),
            CommandFailure::Unheard(error) => format!("cannot write to standard output: {error}"),
        }
    }
}
