//! Where something stands in the data.

use std::fmt;

use kalfit::Source;

/// A cell of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CellPlace {
    /// The file, as it was given.
    pub file: String,
    /// Its row: the line of a CSV file (the header is line 1), else the number of the row from 1.
    pub row: u64,
    /// Name of the column.
    pub column: String,
}

impl fmt::Display for CellPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, row {}, column `{}`", self.file, self.row, self.column)
    }
}

/// Where a row came from, in words.
pub(crate) fn place(files: &[String], source: Source) -> String {
    let file = files.get(source.file as usize).map_or("unknown file", String::as_str);
    format!("{file}, row {}", source.row)
}
