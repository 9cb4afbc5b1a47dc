//! What an expression may hold.

/// What may stand in an expression, and where the expression stands, in words.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ExpressionScope<'p> {
    pub(crate) states: bool,
    pub(crate) columns: bool,
    pub(crate) parameters: bool,
    /// `dt`.
    pub(crate) step: bool,
    pub(crate) place: &'p str,
}

impl<'p> ExpressionScope<'p> {
    /// Equations of motion and measurement.
    pub(crate) fn equation(place: &'p str) -> ExpressionScope<'p> {
        ExpressionScope { states: true, columns: true, parameters: true, step: true, place }
    }

    /// Noise.
    pub(crate) fn row(place: &'p str) -> ExpressionScope<'p> {
        ExpressionScope { states: false, ..ExpressionScope::equation(place) }
    }

    /// What a phase inherits.
    pub(crate) fn carry(place: &'p str) -> ExpressionScope<'p> {
        ExpressionScope { step: false, ..ExpressionScope::equation(place) }
    }

    /// The start of a test.
    pub(crate) fn start(place: &'p str) -> ExpressionScope<'p> {
        ExpressionScope { step: false, ..ExpressionScope::row(place) }
    }

    /// Selection of rows.
    pub(crate) fn rows(place: &'p str) -> ExpressionScope<'p> {
        ExpressionScope { parameters: false, ..ExpressionScope::row(place) }
    }

    /// What is common to all tests.
    pub(crate) fn common(place: &'p str) -> ExpressionScope<'p> {
        ExpressionScope { columns: false, ..ExpressionScope::start(place) }
    }

    /// Ties between means.
    pub(crate) fn means(place: &'p str) -> ExpressionScope<'p> {
        ExpressionScope { states: true, columns: false, parameters: false, step: false, place }
    }
}
