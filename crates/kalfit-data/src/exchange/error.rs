//! What can be wrong with exchange files, and with several of them together.

use crate::columns::FileColumns;
use crate::exchange::alpha::AlphaDifference;
use crate::exchange::schema::{ESTIMATES_SCHEMA, REDUCTIONS_KIND, REDUCTIONS_SCHEMA};
use crate::place::CellPlace;

/// What is wrong with an exchange file. The message says where, what was found and what was expected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ExchangeError {
    /// A schema of another program or version.
    #[error("{file} is of schema `{found}`, expected `{}` or `{}`", REDUCTIONS_SCHEMA, ESTIMATES_SCHEMA)]
    Schema {
        /// The file.
        file: String,
        /// Its schema.
        found: String,
    },
    /// Metadata that cannot be used.
    #[error("{file}: metadata `{key}` cannot be used: {reason}")]
    Metadata {
        /// The file.
        file: String,
        /// The key.
        key: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// A column that is needed is not there.
    #[error("{file} has no column `{column}`, which {kind} need")]
    MissingColumn {
        /// The file.
        file: String,
        /// What it holds.
        kind: &'static str,
        /// Name of the column.
        column: &'static str,
        /// The columns of the file.
        columns: Box<FileColumns>,
    },
    /// A value that is needed is null.
    #[error("{at}: found a missing value, expected {expected}")]
    Missing {
        /// The cell.
        at: Box<CellPlace>,
        /// What belongs there, in words.
        expected: &'static str,
    },
    /// A list of the wrong length.
    #[error("{at}: found a list of {found} numbers, expected {expected}: {rule}")]
    Length {
        /// The cell.
        at: Box<CellPlace>,
        /// Its length.
        found: usize,
        /// The length it should have, or "a multiple of" one.
        expected: String,
        /// Where that comes from.
        rule: String,
    },
    /// An element that is null, infinite or no number.
    #[error("{at}: found {found} as element {element} of the list, expected a finite number")]
    NotFinite {
        /// The cell.
        at: Box<CellPlace>,
        /// What it is.
        found: f64,
        /// Which one, from 1.
        element: usize,
    },
    /// A number that cannot be what it should be.
    #[error("{at}: found {found}, expected {expected}")]
    Value {
        /// The cell.
        at: Box<CellPlace>,
        /// What was found, shortened.
        found: String,
        /// What belongs there, in words.
        expected: &'static str,
    },
    /// A phase that the model does not have, or no phase where the model has several.
    #[error("{at}: found {}, expected a phase of the model: {}", quoted(found), list(phases))]
    Phase {
        /// The cell.
        at: Box<CellPlace>,
        /// What was found; `None` when nothing.
        found: Option<String>,
        /// Names of the model's phases.
        phases: Vec<String>,
    },
    /// The states of a row are not those of the phase.
    #[error("{at}: found {}, expected the states of phase `{phase}`{}: {}", list(found), if *ordered { " in this order" } else { "" }, list(expected))]
    States {
        /// The cell.
        at: Box<CellPlace>,
        /// Names that were found.
        found: Vec<String>,
        /// The phase.
        phase: String,
        /// Names that the model has.
        expected: Vec<String>,
        /// Their order matters.
        ordered: bool,
    },
    /// A covariance with negative eigenvalues.
    #[error(
        "{at}: not positive semidefinite: smallest eigenvalue {least:.3e}, largest {largest:.3e} (scaled to a diagonal of ones)"
    )]
    NotSemidefinite {
        /// The cell.
        at: Box<CellPlace>,
        /// The smallest eigenvalue.
        least: f64,
        /// The largest one.
        largest: f64,
    },
    /// A covariance whose halves differ.
    #[error("{at}: not symmetric: found {found} at ({row}, {column}) and {other} across the diagonal")]
    NotSymmetric {
        /// The cell.
        at: Box<CellPlace>,
        /// Row of the element, from 1.
        row: usize,
        /// Column of the element, from 1.
        column: usize,
        /// The element.
        found: f64,
        /// The one across the diagonal.
        other: f64,
    },
    /// Two forms of one thing.
    #[error("{at}: found a covariance beside `covariance_root`, expected one of the two")]
    Both {
        /// The cell of the covariance.
        at: Box<CellPlace>,
    },
    /// One phase of a test from two places.
    #[error("phase `{phase}` of test `{test}` is given twice: {first} and {second}")]
    Twice {
        /// Id of the test, shortened.
        test: String,
        /// The phase.
        phase: String,
        /// Where it was found first: file and row.
        first: String,
        /// Where it was found again.
        second: String,
    },
    /// A phase without the one before it.
    #[error("{at}: found phase `{phase}` of test `{test}`, expected phase `{lacking}` too, which comes before it")]
    Gap {
        /// File and row of the phase.
        at: String,
        /// Id of the test, shortened.
        test: String,
        /// The phase.
        phase: String,
        /// The missing phase.
        lacking: String,
    },
    /// Reductions of another model.
    #[error("{file} holds reductions of another model: found reduction digest {found}, expected {expected}")]
    Digest {
        /// The file.
        file: String,
        /// Its digest.
        found: String,
        /// The model's digest.
        expected: String,
    },
    /// A model with levels, whose groups the file does not hold.
    #[error("{file} has {kind} without the groups of tests, but the model has levels of groups")]
    Levels {
        /// The file.
        file: String,
        /// What it holds.
        kind: &'static str,
    },
    /// Filters that ran at other parameters.
    #[error("{file} was made with `{difference}` = {}, expected {} as in {other}", difference.second, difference.first)]
    Parameter {
        /// The file.
        file: String,
        /// The difference: the second value is the file's.
        difference: Box<AlphaDifference>,
        /// What has the first value: the model, or another file.
        other: String,
    },
}

fn quoted(found: &Option<String>) -> String {
    found.as_ref().map_or("no phase".to_owned(), |found| format!("`{found}`"))
}

fn list(names: &[String]) -> String {
    if names.is_empty() {
        return "none".to_owned();
    }
    names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")
}

impl ExchangeError {
    /// What to do about it, in one sentence; `None` when the message says all.
    pub fn hint(&self) -> Option<String> {
        Some(match self {
            ExchangeError::Schema { .. } => "write the file again with this version of kalfit".into(),
            ExchangeError::Metadata { .. } => {
                "write the file again; metadata other than kalfit's own may be left out altogether".into()
            }
            ExchangeError::MissingColumn { columns, .. } => columns.hint(),
            ExchangeError::Length { .. } => "matrices are flat lists, row after row; the book (Exchange files) has all lengths".into(),
            ExchangeError::Phase { .. } => "`phase` may be left out where the model has but one".into(),
            ExchangeError::States { ordered: false, .. } => {
                "name every state of the phase once, in the order in which the file's vectors have them".into()
            }
            ExchangeError::NotSemidefinite { .. } => {
                "give `covariance_root` in its place: a square root has no negative eigenvalues".into()
            }
            ExchangeError::Twice { .. } => "leave one of them out: it would count twice".into(),
            ExchangeError::Gap { .. } => "a test may end early, but it must begin with the first phase".into(),
            ExchangeError::Digest { .. } => {
                "reduce the data again with this model; only `[mean]`, `[covariance]` and labels may change after `kalfit reduce`"
                    .into()
            }
            ExchangeError::Levels { kind: REDUCTIONS_KIND, .. } => {
                "reduce the data again with this model: reductions then say the groups".into()
            }
            ExchangeError::Levels { .. } => "give the rows that the file was made of".into(),
            ExchangeError::Parameter { .. } => {
                "filters ran at one value of each parameter: leave `--set` out, or run them again at the value you want".into()
            }
            ExchangeError::Missing { .. }
            | ExchangeError::NotFinite { .. }
            | ExchangeError::Value { .. }
            | ExchangeError::States { .. }
            | ExchangeError::NotSymmetric { .. }
            | ExchangeError::Both { .. } => return None,
        })
    }
}
