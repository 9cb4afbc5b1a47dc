//! How many rows a packed file may hold.
//!
//! Run-length and delta codes can declare millions of rows in a few bytes, and each of them costs a thousand bytes of memory
//! once it is a test. A table that is worth reading does not compress so well: a measured value has noise.

/// The variable by which a user says that a file of more rows is sound.
pub const MOST_ROWS: &str = "KALFIT_MOST_ROWS";

/// Rows that any file may hold.
const FREE: u64 = 200_000;
/// Further rows for each byte of the file: a byte of noise, shared by eight values of one bit each, and twice that.
const PER_BYTE: u64 = 16;

/// Rows that the variable [`MOST_ROWS`] accepts in any file; `None` where it is not set.
///
/// # Errors
/// A text that is no whole number.
pub fn accepted_rows() -> Result<Option<u64>, String> {
    match std::env::var(MOST_ROWS) {
        Ok(text) if !text.trim().is_empty() => text.trim().parse().map(Some).map_err(|_| text),
        _ => Ok(None),
    }
}

/// Rows that the variable accepts; none where it is not set.
pub(crate) fn accepted() -> u64 {
    accepted_rows().ok().flatten().unwrap_or(0)
}

/// Rows that a file of so many bytes may hold.
pub(crate) fn most_rows(bytes: u64) -> u64 {
    bytes.saturating_mul(PER_BYTE).saturating_add(FREE).max(accepted())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_noise_is_believed_and_a_bomb_is_not() {
        assert!(most_rows(2_000_000) > 1_000_000, "two bytes a row");
        assert!(most_rows(9_040) < 1_000_000, "a million rows in 9 kB");
    }
}
