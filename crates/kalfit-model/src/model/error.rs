//! Why a coefficient has no value.

use crate::ensemble::Label;

/// Why an expression has no value on a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum EvaluationError {
    /// A numeric cell that is needed is missing.
    #[error("a needed cell is empty")]
    MissingNumber {
        /// Index of the numeric column.
        column: usize,
    },
    /// A text cell that is needed is missing.
    #[error("a needed cell is empty")]
    MissingText {
        /// Index of the text column.
        column: usize,
    },
    /// The parameter has no value at the level of this row.
    #[error("a parameter has no value for this level")]
    NoLevel {
        /// Index of the parameter.
        parameter: usize,
        /// The level.
        level: Label,
    },
    /// Division by zero, overflow, the logarithm of a negative number and the like.
    #[error("the value is not a finite number")]
    NotFinite,
}
