//! How rows of a table become tests.

/// What a reader must know of a table in addition to the columns of the model.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Layout {
    /// What distinguishes tests.
    pub test: TestKey,
    /// Columns with the groups of tests, the outermost first. With a [`TestKey::Column`], tests are distinguished by
    /// these columns and the key's together, and an id joins the texts of all of these with `/`.
    pub levels: Vec<String>,
    /// Texts that mark a missing cell, in addition to the usual ones.
    pub missing: Vec<String>,
    /// Text that begins each comment line of a CSV file; `None` where there are no comments.
    pub comment: Option<String>,
}

/// What distinguishes tests.
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
