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
pub(super) enum ColumnShape {
    Text,
    /// A number; a count is one without a fraction.
    Number,
    Numbers,
    Words,
}

/// A column that is looked for.
#[derive(Debug, Clone, Copy)]
pub(super) struct SchemaColumn {
    pub(super) name: &'static str,
    pub(super) shape: ColumnShape,
    pub(super) needed: bool,
}

impl SchemaColumn {
    pub(super) const fn needed(name: &'static str, shape: ColumnShape) -> SchemaColumn {
        SchemaColumn { name, shape, needed: true }
    }

    pub(super) const fn optional(name: &'static str, shape: ColumnShape) -> SchemaColumn {
        SchemaColumn { name, shape, needed: false }
    }
}

/// The schema `kalfit-reductions/1`.
pub(super) const REDUCTIONS: [SchemaColumn; 18] = [
    SchemaColumn::needed(TEST, ColumnShape::Text),
    SchemaColumn::needed(PHASE, ColumnShape::Text),
    SchemaColumn::needed("states", ColumnShape::Words),
    SchemaColumn::needed("constant", ColumnShape::Number),
    SchemaColumn::needed("data", ColumnShape::Numbers),
    SchemaColumn::needed("factor", ColumnShape::Numbers),
    SchemaColumn::needed("covariates", ColumnShape::Numbers),
    SchemaColumn::needed("path", ColumnShape::Text),
    SchemaColumn::needed("design", ColumnShape::Text),
    SchemaColumn::needed("steps", ColumnShape::Number),
    SchemaColumn::needed("observations", ColumnShape::Number),
    SchemaColumn::optional("terminal_states", ColumnShape::Words),
    SchemaColumn::optional("terminal_mean", ColumnShape::Numbers),
    SchemaColumn::optional("terminal_sensitivity", ColumnShape::Numbers),
    SchemaColumn::optional("terminal_root", ColumnShape::Numbers),
    SchemaColumn::optional("inherited_transition", ColumnShape::Numbers),
    SchemaColumn::optional("inherited_input", ColumnShape::Numbers),
    SchemaColumn::optional(GROUPS, ColumnShape::Words),
];

/// The schema `kalfit-estimates/1`.
pub(super) const ESTIMATES: [SchemaColumn; 12] = [
    SchemaColumn::optional(TEST, ColumnShape::Text),
    SchemaColumn::optional(PHASE, ColumnShape::Text),
    SchemaColumn::needed("states", ColumnShape::Words),
    SchemaColumn::needed("estimates", ColumnShape::Numbers),
    SchemaColumn::needed("offsets", ColumnShape::Numbers),
    SchemaColumn::needed("sensitivities", ColumnShape::Numbers),
    SchemaColumn::optional("covariance_root", ColumnShape::Numbers),
    SchemaColumn::optional("covariance", ColumnShape::Numbers),
    SchemaColumn::needed("transition", ColumnShape::Numbers),
    SchemaColumn::optional("drift", ColumnShape::Numbers),
    SchemaColumn::optional("steps", ColumnShape::Number),
    SchemaColumn::optional("observations", ColumnShape::Number),
];
