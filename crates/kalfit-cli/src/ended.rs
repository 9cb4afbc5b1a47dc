//! How a command ended: its exit status, and what is said of one without results.

use std::process::ExitCode;

use kalfit_job::Failure;

use crate::generate::ManError;
use crate::init::InitError;
use crate::interrupt;
use crate::terminal;

/// How a command ended that had good input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    Done,
    NotCertified,
    /// Something could not be written, where other files were.
    Incomplete,
    /// By Ctrl-C, with what there was.
    Interrupted,
}

impl Outcome {
    /// Of a fit, or of what is made of fits.
    pub(crate) fn of(converged: bool) -> Outcome {
        if converged { Outcome::Done } else { Outcome::NotCertified }
    }

    /// The same, when something could not be written.
    pub(crate) fn with_losses(self) -> Outcome {
        if self == Outcome::Interrupted { self } else { Outcome::Incomplete }
    }

    pub(crate) fn exit_code(self) -> ExitCode {
        match self {
            Outcome::Done => ExitCode::SUCCESS,
            Outcome::NotCertified | Outcome::Incomplete => ExitCode::FAILURE,
            Outcome::Interrupted => ExitCode::from(interrupt::STATUS),
        }
    }
}

/// Why a command ended without results that were seen.
#[derive(Debug)]
pub(crate) enum Ended {
    /// The job could not be done.
    Failed(Box<Failure>),
    /// No starter model was written.
    NotBegun(InitError),
    /// No manual pages were written.
    NoPages(ManError),
    /// Standard output could not be written.
    Unheard(std::io::Error),
}

impl From<Failure> for Ended {
    fn from(failure: Failure) -> Ended {
        Ended::Failed(Box::new(failure))
    }
}

impl Ended {
    /// Bad input, unless it was the user who ended it.
    pub(crate) fn exit_code(&self) -> ExitCode {
        match self {
            Ended::Failed(failure) if matches!(**failure, Failure::Interrupted) => ExitCode::from(interrupt::STATUS),
            _ => ExitCode::from(2),
        }
    }

    /// The whole message.
    pub(crate) fn words(&self) -> String {
        let color = terminal::color_on_stderr();
        match self {
            Ended::Failed(failure) => kalfit_job::render(failure, color),
            Ended::NotBegun(error) => kalfit_job::render_hinted(&error.to_string(), error.hint(), color),
            Ended::NoPages(_) | Ended::Unheard(_) => kalfit_job::render_message(&self.message(), color),
        }
    }

    /// The message alone.
    pub(crate) fn message(&self) -> String {
        match self {
            Ended::Failed(failure) => failure.to_string(),
            Ended::NotBegun(error) => error.to_string(),
            Ended::NoPages(error) => error.to_string(),
            Ended::Unheard(error) => format!("cannot write to standard output: {error}"),
        }
    }
}
