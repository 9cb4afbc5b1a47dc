//! What a message declares, held against the bytes it has.

use arrow_ipc::root_as_message;
use arrow_schema::ArrowError;

use crate::error::DataError;
use crate::kind::ARROW_IPC;
use crate::most_rows::accepted;

/// Bytes that a compressed batch may declare beyond [`RATIO`] times its own.
const BYTES_FREE: u64 = 256 << 20;
const RATIO: u64 = 1_000;
/// Rows that a batch may declare beyond one a bit.
const ROWS_FREE: u64 = 1 << 16;

/// Compares the rows, the buffers and the unpacked size that a message declares with the bytes it has. Messages without
/// rows pass.
pub(super) fn refuse_oversized(file: &str, metadata: &[u8], body: &[u8]) -> Result<(), DataError> {
    let message = root_as_message(metadata).map_err(|error| refused(file, ArrowError::IpcError(error.to_string())))?;
    let batch = match message.header_as_dictionary_batch() {
        Some(dictionary) => dictionary.data(),
        None => message.header_as_record_batch(),
    };
    let Some(batch) = batch else { return Ok(()) };
    let bytes = body.len() as u64;
    let mut unpacked = bytes;
    for buffer in batch.buffers().into_iter().flatten() {
        let packed = slice(body, buffer.offset(), buffer.length())
            .ok_or_else(|| unsound(file, "a buffer lies outside of its batch"))?;
        // Each packed buffer begins with its unpacked length; -1 says that it is not packed.
        if let (Some(_), Some(length)) = (batch.compression(), packed.first_chunk().copied().map(i64::from_le_bytes)) {
            unpacked = unpacked.saturating_add(u64::try_from(length).unwrap_or(0));
        }
    }
    let oversized =
        |what, declared, limit| DataError::Oversized { file: file.to_owned(), what, declared, bytes, limit };
    let limit = bytes.saturating_mul(RATIO).saturating_add(BYTES_FREE);
    if unpacked > limit {
        return Err(oversized("unpacked bytes", unpacked, limit));
    }
    let limit = unpacked.saturating_mul(8).saturating_add(ROWS_FREE).max(accepted());
    match u64::try_from(batch.length()) {
        Ok(rows) if rows <= limit => Ok(()),
        rows => Err(oversized("rows", rows.unwrap_or(u64::MAX), limit)),
    }
}

fn slice(body: &[u8], offset: i64, length: i64) -> Option<&[u8]> {
    body.get(usize::try_from(offset).ok()?..)?.get(..usize::try_from(length).ok()?)
}

pub(super) fn refused(file: &str, source: ArrowError) -> DataError {
    DataError::Arrow { file: file.to_owned(), format: ARROW_IPC, source: Box::new(source) }
}

pub(super) fn unsound(file: &str, what: &str) -> DataError {
    refused(file, ArrowError::IpcError(what.to_owned()))
}
