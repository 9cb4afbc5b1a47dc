//! Arrow IPC, stream and file format.
//!
//! A file is a stream between two marks, with a footer for random access; it is read as a stream, so that standard input
//! needs no special case, and the footer is used to see that nothing is missing. Messages are taken from the bytes here
//! and decoded by the library, so that what they declare can be checked first.

use std::io::{self, Read};

use arrow::array::RecordBatch;
use arrow::buffer::Buffer;
use arrow::error::ArrowError;
use arrow::ipc::reader::StreamDecoder;
use arrow::ipc::{MessageHeader, root_as_footer, root_as_message};

use super::batches::BatchTable;
use super::guard::guarded;
use crate::error::DataError;
use crate::wanted::Wanted;

const FORMAT: &str = "Arrow IPC";
const MAGIC: &[u8] = b"ARROW1";
const CONTINUATION: [u8; 4] = [0xff; 4];

/// Bytes that a compressed batch may declare beyond [`RATIO`] times its own.
const BYTES_FREE: u64 = 256 << 20;
const RATIO: u64 = 1_000;
/// Rows that a batch may declare beyond one a bit.
const ROWS_FREE: u64 = 1 << 16;

/// Opens a file or stream; `is_file` when it began with the mark of a file.
pub(super) fn open<'a>(
    file: &'a str,
    bytes: Box<dyn Read + 'a>,
    is_file: bool,
    wanted: &'a Wanted,
) -> Result<BatchTable<'a>, DataError> {
    let mut messages = Messages {
        file,
        bytes,
        is_file,
        decoder: StreamDecoder::new(),
        pending: Buffer::from_vec(Vec::<u8>::new()),
        batches: 0,
        marked: false,
        ended: false,
    };
    let (schema, first) = guarded(file, FORMAT, || messages.begin())?;
    let mut first = first;
    let next = move || match first.take() {
        Some(batch) => Ok(Some(batch)),
        None => guarded(file, FORMAT, || messages.next()),
    };
    BatchTable::new(file, FORMAT, wanted, &schema, Box::new(next))
}

struct Messages<'a> {
    file: &'a str,
    bytes: Box<dyn Read + 'a>,
    is_file: bool,
    decoder: StreamDecoder,
    /// What the decoder has not taken yet.
    pending: Buffer,
    /// Messages with rows so far.
    batches: usize,
    /// Messages begin with a continuation mark (all but those of very old writers).
    marked: bool,
    ended: bool,
}

impl Messages<'_> {
    /// The schema, and the first batch if one had to be read to see it.
    fn begin(&mut self) -> Result<(arrow::datatypes::SchemaRef, Option<RecordBatch>), DataError> {
        if self.is_file {
            self.skip_mark()?;
        }
        let first = self.next()?;
        match self.decoder.schema() {
            Some(schema) => Ok((schema, first)),
            None => Err(self.refused(ArrowError::IpcError("no schema".to_owned()))),
        }
    }

    /// Skips the mark of a file and the zeros after it, up to where the first message can begin.
    fn skip_mark(&mut self) -> Result<(), DataError> {
        let mut mark = [0; 8];
        self.bytes.read_exact(&mut mark).map_err(|source| self.unread(source))?;
        for _ in 0..8 {
            let mut word = Vec::with_capacity(8);
            self.read(8, &mut word)?;
            if word != [0; 8] {
                let rest = std::mem::replace(&mut self.bytes, Box::new(io::empty()));
                self.bytes = Box::new(io::Cursor::new(word).chain(rest));
                return Ok(());
            }
        }
        Ok(())
    }

    /// The next batch; None at the end.
    fn next(&mut self) -> Result<Option<RecordBatch>, DataError> {
        loop {
            // A message without a body is decoded with the bytes of the next one, some of which then wait here.
            while !self.pending.is_empty() {
                if let Some(batch) = self.decoder.decode(&mut self.pending).map_err(|error| self.refused(error))? {
                    return Ok(Some(batch));
                }
            }
            if self.ended {
                return Ok(None);
            }
            self.pending = Buffer::from_vec(self.message()?);
        }
    }

    /// One whole message with its frame, its declarations checked. At the end, the mark of the end.
    fn message(&mut self) -> Result<Vec<u8>, DataError> {
        let mut message = Vec::new();
        self.read(4, &mut message)?;
        let continued = message == CONTINUATION;
        if continued {
            self.marked = true;
            if self.read(4, &mut message)? < 4 {
                return Err(self.cut_off());
            }
        } else if message.is_empty() || self.marked {
            return self.end(message, false);
        }
        let word = message.last_chunk::<4>().copied();
        let length = u32::from_le_bytes(word.ok_or_else(|| self.cut_off())?);
        if length == 0 {
            return self.end(Vec::new(), true);
        }
        let start = message.len();
        if self.read(u64::from(length), &mut message)? < u64::from(length) {
            return Err(self.cut_off());
        }
        let (header, body) = self.declared(&message[start..])?;
        let body_start = message.len();
        if self.read(body, &mut message)? < body {
            return Err(self.cut_off());
        }
        self.batches += usize::from(header == MessageHeader::RecordBatch);
        if matches!(header, MessageHeader::RecordBatch | MessageHeader::DictionaryBatch) {
            self.refuse_oversized(&message[start..body_start], &message[body_start..])?;
        }
        Ok(message)
    }

    fn declared(&self, metadata: &[u8]) -> Result<(MessageHeader, u64), DataError> {
        let message =
            root_as_message(metadata).map_err(|error| self.refused(ArrowError::IpcError(error.to_string())))?;
        let body = u64::try_from(message.bodyLength())
            .map_err(|_| self.refused(ArrowError::IpcError("a negative length".to_owned())))?;
        Ok((message.header_type(), body))
    }

    /// Compares the rows and the unpacked size that a batch declares with the bytes it has.
    fn refuse_oversized(&self, metadata: &[u8], body: &[u8]) -> Result<(), DataError> {
        let Ok(message) = root_as_message(metadata) else { return Ok(()) };
        let batch = match message.header_type() {
            MessageHeader::DictionaryBatch => message.header_as_dictionary_batch().and_then(|d| d.data()),
            _ => message.header_as_record_batch(),
        };
        let Some(batch) = batch else { return Ok(()) };
        let bytes = body.len() as u64;
        let mut unpacked = bytes;
        if batch.compression().is_some() {
            for buffer in batch.buffers().into_iter().flatten() {
                let declared = usize::try_from(buffer.offset())
                    .ok()
                    .and_then(|offset| body.get(offset..)?.first_chunk::<8>())
                    .map_or(0, |prefix| i64::from_le_bytes(*prefix));
                unpacked = unpacked.saturating_add(u64::try_from(declared).unwrap_or(0));
            }
        }
        let oversized =
            |what, declared, limit| DataError::Oversized { file: self.file.to_owned(), what, declared, bytes, limit };
        let limit = bytes.saturating_mul(RATIO).saturating_add(BYTES_FREE);
        if unpacked > limit {
            return Err(oversized("unpacked bytes", unpacked, limit));
        }
        let limit = unpacked.saturating_mul(8).saturating_add(ROWS_FREE);
        match u64::try_from(batch.length()) {
            Ok(rows) if rows <= limit => Ok(()),
            rows => Err(oversized("rows", rows.unwrap_or(u64::MAX), limit)),
        }
    }

    /// The end of the stream. A file must end with its mark and a footer that has as many batches as were read.
    fn end(&mut self, start: Vec<u8>, marked: bool) -> Result<Vec<u8>, DataError> {
        self.ended = true;
        if self.is_file {
            let mut tail = start;
            self.bytes.read_to_end(&mut tail).map_err(|source| self.unread(source))?;
            let expected = footer_batches(&tail);
            // Where no end was marked, what was taken for the start of a message is the start of the footer.
            if expected != Some(self.batches) {
                return Err(DataError::Truncated { file: self.file.to_owned(), found: self.batches, expected });
            }
        } else if !start.is_empty() && !marked {
            return Err(self.cut_off());
        }
        Ok([CONTINUATION, [0; 4]].concat())
    }

    /// Reads as many bytes as there are, at most `length`; memory grows with what comes, not with what is declared.
    fn read(&mut self, length: u64, into: &mut Vec<u8>) -> Result<u64, DataError> {
        let read = self.bytes.by_ref().take(length).read_to_end(into).map_err(|source| self.unread(source))?;
        Ok(read as u64)
    }

    fn unread(&self, source: io::Error) -> DataError {
        DataError::Io { file: self.file.to_owned(), source }
    }

    fn refused(&self, source: ArrowError) -> DataError {
        DataError::Arrow { file: self.file.to_owned(), source: Box::new(source) }
    }

    fn cut_off(&self) -> DataError {
        self.refused(ArrowError::IpcError("it ends inside a message".to_owned()))
    }
}

/// Number of record batches that the footer at the end of these bytes lists; None when there is no footer.
fn footer_batches(tail: &[u8]) -> Option<usize> {
    let (rest, length) = tail.strip_suffix(MAGIC)?.split_last_chunk::<4>()?;
    let length = usize::try_from(i32::from_le_bytes(*length)).ok()?;
    let footer = root_as_footer(rest.get(rest.len().checked_sub(length)?..)?).ok()?;
    Some(footer.recordBatches().map_or(0, |batches| batches.len()))
}
