//! The schemas of exchange files: their names and columns.

/// What a file of reductions is called.
pub(super) const REDUCTIONS_KIND: &str = "reductions";

/// Schema of reductions files.
pub(super) const REDUCTIONS_SCHEMA: &str = "kalfit-reductions/1";
/// Schema of estimates files.
pub(super) const ESTIMATES_SCHEMA: &str = "kalfit-estimates/1";

/// The column of the test's id.
pub(super) const TEST: &str = "test";
/// The column of the phase's name.
pub(super) const PHASE: &str = "phase";

/// The column of the names of the groups that a test stands in.
pub(super) const GROUPS: &str = "groups";

/// What a column holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shape {
    Text,
    /// A number; a count is one without a fraction.
    Number,
    Numbers,
    Words,
}

/// A column that is looked for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Column {
    pub(super) name: &'static str,
    pub(super) shape: Shape,
    pub(super) needed: bool,
}

impl Column {
    pub(super) const fn needed(name: &'static str, shape: Shape) -> Column {
        Column { name, shape, needed: true }
    }

    pub(super) const fn optional(name: &'static str, shape: Shape) -> Column {
        Column { name, shape, needed: false }
    }
}

/// The schema `kalfit-reductions/1`.
pub(super) const REDUCTIONS: [Column; 18] = [
    Column::needed(TEST, Shape::Text),
    Column::needed(PHASE, Shape::Text),
    Column::needed("states", Shape::Words),
    Column::needed("constant", Shape::Number),
    Column::needed("data", Shape::Numbers),
    Column::needed("factor", Shape::Numbers),
    Column::needed("covariates", Shape::Numbers),
    Column::needed("path", Shape::Text),
    Column::needed("design", Shape::Text),
    Column::needed("steps", Shape::Number),
    Column::needed("observations", Shape::Number),
    Column::optional("terminal_states", Shape::Words),
    Column::optional("terminal_mean", Shape::Numbers),
    Column::optional("terminal_sensitivity", Shape::Numbers),
    Column::optional("terminal_root", Shape::Numbers),
    Column::optional("inherited_transition", Shape::Numbers),
    Column::optional("inherited_input", Shape::Numbers),
    Column::optional(GROUPS, Shape::Words),
];

/// The schema `kalfit-estimates/1`.
pub(super) const ESTIMATES: [Column; 12] = [
    Column::optional(TEST, Shape::Text),
    Column::optional(PHASE, Shape::Text),
    Column::needed("states", Shape::Words),
    Column::needed("estimates", Shape::Numbers),
    Column::needed("offsets", Shape::Numbers),
    Column::needed("sensitivities", Shape::Numbers),
    Column::optional("covariance_root", Shape::Numbers),
    Column::optional("covariance", Shape::Numbers),
    Column::needed("transition", Shape::Numbers),
    Column::optional("drift", Shape::Numbers),
    Column::optional("steps", Shape::Number),
    Column::optional("observations", Shape::Number),
];
