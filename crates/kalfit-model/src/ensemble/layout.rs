//! Layout of a table: which rows make up a test.

/// Layout of a table: what a reader needs in addition to the columns of the model.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Layout {
    /// What distinguishes tests.
    pub test: TestKey,
    /// Columns with the groups of tests, the outermost first. With a [`TestKey::Column`], rows are of one test if the
    /// texts in these columns and in the key column are equal, and the id of the test joins all these texts with `/`.
    pub levels: Vec<String>,
    /// Columns of crossed factors, each constant within a test; they are no part of the id of a test.
    pub crossed: Vec<String>,
    /// Texts that mark a missing cell, in addition to the usual texts.
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
    /// Rows with equal text in the column of this name are one test, and the text is the id.
    Column(String),
    /// Each file is a test (`@file`).
    File,
    /// Each row is a test (`@row`); the id is the number of the row among the rows of all files.
    Row,
}
