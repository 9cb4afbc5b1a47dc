//! The file format (Feather version 2): blocks that a footer lists.
//!
//! The blocks are read where the footer says. Between the marks a file should also be a stream, but not every writer's
//! is: polars 2.1 leaves out the frame of the first message.

use std::io::{self, Read, Seek, SeekFrom};
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_buffer::Buffer;
use arrow_ipc::convert::try_fb_to_schema;
use arrow_ipc::reader::{FileDecoder, read_footer_length};
use arrow_ipc::{Block, root_as_footer};
use arrow_schema::ArrowError;
use arrow_schema::SchemaRef;

use super::super::batches::BatchTable;
use super::super::guard::guarded;
use super::message::{refuse_oversized, refused, unsound};
use crate::error::DataError;
use crate::kind::ARROW_IPC;
use crate::wanted::WantedColumns;

/// Bytes of the footer's length and the mark after it.
const TRAILER: u64 = 10;

/// Opens a file: only the wanted columns are decoded, one block at a time.
pub(in super::super) fn open<'a, B: Read + Seek + 'a>(
    file: &'a str,
    bytes: B,
    wanted: &'a WantedColumns,
) -> Result<BatchTable<'a>, DataError> {
    let mut source = IpcFile { file, bytes };
    let (schema, decoder, blocks) = guarded(file, ARROW_IPC, || begin(&mut source, wanted))?;
    let mut blocks = blocks.into_iter();
    let mut next = move || -> Result<Option<RecordBatch>, DataError> {
        for block in blocks.by_ref() {
            let decoded = decoder.read_record_batch(&block, &source.block(&block)?);
            if let Some(batch) = decoded.map_err(|error| refused(file, error))? {
                return Ok(Some(batch));
            }
        }
        Ok(None)
    };
    BatchTable::new(file, ARROW_IPC, wanted, &schema, Box::new(move || guarded(file, ARROW_IPC, &mut next)))
}

/// Reads footer and dictionaries: the schema of the wanted columns, what decodes the blocks, and the blocks.
fn begin<B: Read + Seek>(
    source: &mut IpcFile<'_, B>,
    wanted: &WantedColumns,
) -> Result<(SchemaRef, FileDecoder, Vec<Block>), DataError> {
    let file = source.file;
    let bad = |error: ArrowError| refused(file, error);
    let (footer_start, footer) = source.footer()?;
    let footer = root_as_footer(&footer).map_err(|error| bad(ArrowError::IpcError(error.to_string())))?;
    let schema = footer.schema().ok_or_else(|| unsound(file, "it has no schema"))?;
    let schema = try_fb_to_schema(schema).map_err(bad)?;
    let names: Vec<&str> = schema.fields().iter().map(|field| field.name().as_str()).collect();
    let mut columns = wanted.positions(file, &names)?;
    columns.sort_unstable();
    let projected = Arc::new(schema.project(&columns).map_err(bad)?);
    let dictionaries: Vec<Block> = footer.dictionaries().into_iter().flatten().copied().collect();
    let batches: Vec<Block> = footer.recordBatches().into_iter().flatten().copied().collect();
    if !inside([&dictionaries[..], &batches[..]].concat(), footer_start) {
        return Err(unsound(file, "its footer lists blocks that the file does not have"));
    }
    let mut decoder = FileDecoder::new(Arc::new(schema), footer.version()).with_projection(columns);
    for block in &dictionaries {
        decoder.read_dictionary(block, &source.block(block)?).map_err(bad)?;
    }
    Ok((projected, decoder, batches))
}

/// True when the blocks lie before `end` and do not overlap, so that what is read is at most the file.
fn inside(mut blocks: Vec<Block>, end: u64) -> bool {
    blocks.sort_by_key(Block::offset);
    let mut free = 0;
    for block in blocks {
        let Some((offset, length)) = extent(&block).filter(|(offset, _)| *offset >= free) else { return false };
        match offset.checked_add(length) {
            Some(after) if after <= end => free = after,
            _ => return false,
        }
    }
    true
}

/// Where a block starts and its length; None when one is negative.
fn extent(block: &Block) -> Option<(u64, u64)> {
    let body = u64::try_from(block.bodyLength()).ok()?;
    let length = u64::try_from(block.metaDataLength()).ok()?.checked_add(body)?;
    Some((u64::try_from(block.offset()).ok()?, length))
}

struct IpcFile<'a, B> {
    file: &'a str,
    bytes: B,
}

impl<B: Read + Seek> IpcFile<'_, B> {
    /// Where the footer starts, and the footer.
    fn footer(&mut self) -> Result<(u64, Vec<u8>), DataError> {
        let end = self.bytes.seek(SeekFrom::End(0)).map_err(|source| self.unread(source))?;
        let trailer_start = end.checked_sub(TRAILER).ok_or_else(|| unsound(self.file, "it has no footer"))?;
        let trailer = <[u8; 10]>::try_from(self.read(trailer_start, TRAILER)?);
        let trailer = trailer.map_err(|_| unsound(self.file, "it has no footer"))?;
        let length = read_footer_length(trailer).map_err(|error| refused(self.file, error))? as u64;
        let start = trailer_start.checked_sub(length).ok_or_else(|| unsound(self.file, "its footer is too long"))?;
        Ok((start, self.read(start, length)?))
    }

    /// The bytes of a block, which must have been found inside the file; its declarations are checked.
    fn block(&mut self, block: &Block) -> Result<Buffer, DataError> {
        let damaged = || unsound(self.file, "a block is shorter than its footer says");
        let (offset, length) = extent(block).ok_or_else(damaged)?;
        let metadata = usize::try_from(block.metaDataLength()).map_err(|_| damaged())?;
        let bytes = self.read(offset, length)?;
        let framed = bytes.get(..metadata).unwrap_or_default();
        // Very old writers have only the length before the metadata, no mark.
        let frame = if framed.starts_with(&[0xff; 4]) { 8 } else { 4 };
        let message = framed.get(frame..).ok_or_else(|| unsound(self.file, "a block has no message"))?;
        refuse_oversized(self.file, message, &bytes[metadata..])?;
        Ok(Buffer::from_vec(bytes))
    }

    /// Reads as many bytes as there are, at most `length`.
    fn read(&mut self, start: u64, length: u64) -> Result<Vec<u8>, DataError> {
        let mut bytes = Vec::new();
        self.bytes.seek(SeekFrom::Start(start)).map_err(|source| self.unread(source))?;
        self.bytes.by_ref().take(length).read_to_end(&mut bytes).map_err(|source| self.unread(source))?;
        Ok(bytes)
    }

    fn unread(&self, source: io::Error) -> DataError {
        DataError::Io { file: self.file.to_owned(), source }
    }
}
