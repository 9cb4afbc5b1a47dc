//! Errors in drawing an ensemble.

use crate::reduce::{GroupingError, ReduceError};
use kalfit_model::PopulationError;
use kalfit_model::Source;

/// Reason why an ensemble cannot be drawn.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimulateError {
    /// The population does not fit the model.
    #[error("the population cannot be drawn from: {0}")]
    Population(#[from] PopulationError),
    /// The model at α fails on a test of the design.
    #[error(transparent)]
    Reduce(#[from] ReduceError),
    /// The groups of the design's tests are not known, and the model has levels.
    #[error(transparent)]
    Grouping(#[from] GroupingError),
    /// The model has levels, but the design was made without groups.
    #[error("the model has levels of groups, and the groups of the tests of the design are not known")]
    Ungrouped,
    /// The design has no tests.
    #[error("the design has no tests")]
    NoTests,
    /// Two tests of the design have the same id.
    #[error("two tests of the design have the id `{id}`")]
    DuplicateTest {
        /// Id of both tests.
        id: String,
    },
    /// A phase of a test of the design is given by a reduction or estimates instead of rows.
    #[error(
        "test `{test}`: phase `{phase}` is given by {found}, expected its rows: they tell times, inputs and missing values"
    )]
    NoRows {
        /// Id of the test.
        test: String,
        /// Name of the phase.
        phase: String,
        /// Evidence of the phase in words: `a reduction` or `estimates`.
        found: &'static str,
    },
    /// A test of the design has no phases, or more phases than the model.
    #[error("test `{test}` has {found} phases, expected between 1 and {expected}")]
    Phases {
        /// Id of the test.
        test: String,
        /// Number of phases of the test.
        found: usize,
        /// Number of phases of the model.
        expected: usize,
    },
    /// A phase reads a measured column as an input too.
    #[error(
        "column `{column}` contains measurements and is also used as an input: a drawn value would change the model that it is drawn from"
    )]
    MeasuredInput {
        /// Name of the column.
        column: String,
    },
    /// Two measurements read the same cell.
    #[error(
        "test `{test}`: measurements `{first}` and `{second}` read the same cell of column `{column}`, which can hold one value only"
    )]
    SharedCell {
        /// Id of the test.
        test: String,
        /// The row.
        row: Source,
        /// Name of the column.
        column: String,
        /// Name of one measurement.
        first: String,
        /// Name of the other measurement.
        second: String,
    },
    /// A drawn value is too large to be a finite number.
    #[error("test `{test}`: the drawn value of column `{column}` is not a finite number")]
    NotFinite {
        /// Id of the test.
        test: String,
        /// The row.
        row: Source,
        /// Name of the column.
        column: String,
    },
}

impl SimulateError {
    /// Advice on how to avoid the error, where there is any.
    pub fn hint(&self) -> Option<&'static str> {
        match self {
            SimulateError::Reduce(error) => error.hint(),
            SimulateError::MeasuredInput { .. } => Some("read the input from a column of its own"),
            SimulateError::SharedCell { .. } => {
                Some("tell the rows of the two apart with `where`, or give each measurement a column")
            }
            SimulateError::DuplicateTest { .. } => Some("give each test an id of its own"),
            _ => None,
        }
    }
}
