//! Why tests cannot be written.

use arrow_schema::ArrowError;
use parquet::errors::ParquetError;

/// What is wrong with a table that is to be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The name of the file does not say its format.
    #[error("cannot tell the format of `{path}`: found {}, expected one of {}", found(extension), EXTENSIONS)]
    Format {
        /// The file.
        path: String,
        /// Its extension.
        extension: Option<String>,
    },
    /// The column of the test's id is used otherwise too.
    #[error("column `{column}` tells tests apart and is used in {used_in} too, so a test cannot have a new id")]
    IdInUse {
        /// Name of the column.
        column: String,
        /// Where else it is used, in words.
        used_in: String,
    },
    /// A model with levels of groups, for a file of estimates.
    #[error("the model has levels of groups, and files of estimates do not say the groups of tests")]
    Levels,
    /// A test that measures estimated states without noise, for a file of reductions.
    #[error(
        "test `{test}` measures a combination of estimated states without any noise, which files of reductions do not hold"
    )]
    Exact {
        /// Its id.
        test: String,
    },
    /// The system could not write.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// The Parquet library could not write.
    #[error("{0}")]
    Parquet(#[from] ParquetError),
    /// The Arrow library could not write.
    #[error("{0}")]
    Arrow(#[from] ArrowError),
}

const EXTENSIONS: &str = "`.csv`, `.tsv`, `.parquet`, `.arrow`";

fn found(extension: &Option<String>) -> String {
    extension.as_ref().map_or("no extension".to_owned(), |extension| format!("`.{extension}`"))
}
