//! How rows of a table become tests.

/// What a reader must know of a table beside the model's columns.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Layout {
    /// What tells tests apart.
    pub test: TestKey,
    /// Columns with the groups that tests stand in, the outermost first: tests of a [`TestKey::Column`] are told apart by these and
    /// their own column together, and their ids are the texts of all of them with `/` between.
    pub levels: Vec<String>,
    /// Texts that stand for a missing cell, beside the usual ones.
    pub missing: Vec<String>,
    /// Lines of a CSV file that begin with this text are comments; none are without it.
    pub comment: Option<String>,
}

/// What tells tests apart.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum TestKey {
    /// All rows are one test.
    #[default]
    Single,
    /// A column with the test's id.
    Column(String),
    /// Each file is a test (`@file`).
    File,
}
