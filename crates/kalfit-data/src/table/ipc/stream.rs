//! The stream format: message after message, from anything that can be read.

use std::io::Read;

use arrow_array::RecordBatch;
use arrow_buffer::Buffer;
use arrow_ipc::reader::StreamDecoder;
use arrow_ipc::root_as_message;
use arrow_schema::ArrowError;
use arrow_schema::SchemaRef;

use super::super::batches::BatchTable;
use super::super::guard::guarded;
use super::message::{refuse_oversized, refused, unsound};
use crate::error::DataError;
use crate::kind::ARROW_IPC;
use crate::wanted::WantedColumns;

const CONTINUATION: [u8; 4] = [0xff; 4];

/// Opens a stream; memory holds one batch.
pub(in super::super) fn open<'a>(
    file: &'a str,
    bytes: Box<dyn Read + 'a>,
    wanted: &'a WantedColumns,
) -> Result<BatchTable<'a>, DataError> {
    let pending = Buffer::from_vec(Vec::<u8>::new());
    let mut messages = IpcStream { file, bytes, decoder: StreamDecoder::new(), pending, ended: false };
    let (schema, mut first) = guarded(file, ARROW_IPC, || messages.begin())?;
    let next = move || match first.take() {
        Some(batch) => Ok(Some(batch)),
        None => guarded(file, ARROW_IPC, || messages.next()),
    };
    BatchTable::new(file, ARROW_IPC, wanted, &schema, Box::new(next))
}

struct IpcStream<'a> {
    file: &'a str,
    bytes: Box<dyn Read + 'a>,
    decoder: StreamDecoder,
    /// What the decoder has not taken yet.
    pending: Buffer,
    ended: bool,
}

impl IpcStream<'_> {
    /// The schema, and the first batch if there is one: only then the schema is sure to be known.
    fn begin(&mut self) -> Result<(SchemaRef, Option<RecordBatch>), DataError> {
        let first = self.next()?;
        match self.decoder.schema() {
            Some(schema) => Ok((schema, first)),
            None => Err(unsound(self.file, "it has no schema")),
        }
    }

    /// The next batch; None at the end.
    fn next(&mut self) -> Result<Option<RecordBatch>, DataError> {
        loop {
            // A message without a body is decoded with the bytes of the next one, some of which then wait here.
            while !self.pending.is_empty() {
                let decoded = self.decoder.decode(&mut self.pending);
                if let Some(batch) = decoded.map_err(|error| refused(self.file, error))? {
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
        if self.read(4, &mut message)? == 0 {
            return Ok(self.end());
        }
        // Very old writers have no mark before the length.
        if message == CONTINUATION && self.read(4, &mut message)? < 4 {
            return Err(self.cut_off());
        }
        let length = message.last_chunk().copied().map(u32::from_le_bytes).ok_or_else(|| self.cut_off())?;
        if length == 0 {
            return Ok(self.end());
        }
        let metadata = message.len();
        if self.read(u64::from(length), &mut message)? < u64::from(length) {
            return Err(self.cut_off());
        }
        let body = message.len();
        let body_length = self.body_length(&message[metadata..])?;
        if self.read(body_length, &mut message)? < body_length {
            return Err(self.cut_off());
        }
        refuse_oversized(self.file, &message[metadata..body], &message[body..])?;
        Ok(message)
    }

    fn body_length(&self, metadata: &[u8]) -> Result<u64, DataError> {
        let message =
            root_as_message(metadata).map_err(|error| refused(self.file, ArrowError::IpcError(error.to_string())))?;
        u64::try_from(message.bodyLength()).map_err(|_| unsound(self.file, "it has a body of negative length"))
    }

    fn end(&mut self) -> Vec<u8> {
        self.ended = true;
        [CONTINUATION, [0; 4]].concat()
    }

    /// Reads as many bytes as there are, at most `length`; memory grows with what comes, not with what is declared.
    fn read(&mut self, length: u64, into: &mut Vec<u8>) -> Result<u64, DataError> {
        let read = self.bytes.by_ref().take(length).read_to_end(into);
        read.map(|read| read as u64).map_err(|source| DataError::Io { file: self.file.to_owned(), source })
    }

    fn cut_off(&self) -> DataError {
        unsound(self.file, "it ends inside a message")
    }
}
