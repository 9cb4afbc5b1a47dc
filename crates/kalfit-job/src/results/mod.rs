//! Files of results, read.

mod head;

use kalfit::record::FIT_SCHEMA;
use kalfit::validate::VALIDATE_SCHEMA;
use serde::de::DeserializeOwned;
use serde_json::error::Category;

use crate::document::Document;
use head::ResultHead;

/// Larger result files are not read.
const MAX_BYTES: u64 = 1 << 30;

/// What the file of a command holds.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ResultKind {
    pub(crate) schema: &'static str,
    /// The command that makes such results.
    pub(crate) command: &'static str,
}

/// What `kalfit fit --out` writes.
pub(crate) const FIT: ResultKind = ResultKind { schema: FIT_SCHEMA, command: "fit" };
/// What `kalfit test --out` writes.
pub(crate) const TEST: ResultKind = ResultKind { schema: "kalfit-test/1", command: "test" };
/// What `kalfit validate --out` writes.
pub(crate) const VALIDATED: ResultKind = ResultKind { schema: VALIDATE_SCHEMA, command: "validate" };

/// What `kalfit plan --out` writes.
pub(crate) const PLAN: ResultKind = ResultKind { schema: "kalfit-plan/1", command: "plan" };

/// Why results cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ResultError {
    /// The file cannot be read.
    #[error("cannot read `{path}`: {reason}")]
    Unreadable {
        /// The file.
        path: String,
        /// What is wrong.
        reason: String,
    },
    /// The file is too large to be read.
    #[error("`{path}` has {found} bytes, expected at most {limit}")]
    TooLarge {
        /// The file.
        path: String,
        /// What is there.
        found: u64,
        /// The most that is read.
        limit: u64,
    },
    /// The file has other things in it.
    #[error("`{path}` is not a result of `kalfit {command}`: {reason}")]
    NotARecord {
        /// The file.
        path: String,
        /// The command that makes such results.
        command: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// The results are of another kind.
    #[error("`{path}`: the schema is `{found}`, expected `{expected}`")]
    Schema {
        /// The file.
        path: String,
        /// The schema that was found.
        found: String,
        /// The schema that was expected.
        expected: &'static str,
    },
}

impl ResultError {
    pub(crate) fn unreadable(from: &Document, error: &std::io::Error) -> ResultError {
        ResultError::Unreadable { path: from.name(), reason: error.to_string() }
    }
}

/// The results in a file.
pub(crate) fn read<T: DeserializeOwned>(from: &Document, kind: ResultKind) -> Result<T, ResultError> {
    of_bytes(from.name(), &bytes(from)?, kind)
}

fn bytes(from: &Document) -> Result<Vec<u8>, ResultError> {
    let (bytes, found) = from.bytes(MAX_BYTES + 1).map_err(|error| ResultError::unreadable(from, &error))?;
    if found > MAX_BYTES {
        return Err(ResultError::TooLarge { path: from.name(), found, limit: MAX_BYTES });
    }
    Ok(bytes)
}

/// One of two kinds of results.
pub(crate) enum EitherResult<A, B> {
    First(A),
    Second(B),
}

/// The results in a file that holds those of the first kind, or else of the second.
pub(crate) fn read_either<A: DeserializeOwned, B: DeserializeOwned>(
    from: &Document,
    first: ResultKind,
    second: ResultKind,
) -> Result<EitherResult<A, B>, ResultError> {
    let bytes = bytes(from)?;
    let schema = serde_json::from_slice::<ResultHead>(&bytes).ok().and_then(|head| head.schema);
    if schema.as_deref() == Some(first.schema) {
        return of_bytes(from.name(), &bytes, first).map(EitherResult::First);
    }
    of_bytes(from.name(), &bytes, second).map(EitherResult::Second)
}

/// The results in the bytes of a file.
pub(crate) fn of_bytes<T: DeserializeOwned>(path: String, bytes: &[u8], kind: ResultKind) -> Result<T, ResultError> {
    let ResultKind { schema: expected, command } = kind;
    let refused = |reason: String| ResultError::NotARecord { path: path.clone(), command, reason };
    let no_head = |error: serde_json::Error| match error.classify() {
        Category::Syntax | Category::Eof => refused(format!("it is not JSON ({error})")),
        _ => refused(error.to_string()),
    };
    let head: ResultHead = serde_json::from_slice(bytes).map_err(no_head)?;
    match head.schema {
        None => Err(refused("it has no `schema`".to_owned())),
        Some(found) if found != expected => Err(ResultError::Schema { path, found, expected }),
        Some(_) => serde_json::from_slice(bytes).map_err(|error| refused(error.to_string())),
    }
}
