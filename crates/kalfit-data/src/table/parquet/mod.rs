//! Parquet files.

mod header;
pub(crate) mod survey;

use std::io;

use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder,
};
use parquet::basic::Compression;
use parquet::errors::ParquetError;
use parquet::file::metadata::ParquetMetaData;
use parquet::file::reader::ChunkReader;

use super::ahead::{BlockTask, BlockTasks, TableProgress};
use super::batches::{BatchForm, ROWS};
use super::guard::guarded;
use crate::block::RowBlock;
use crate::error::DataError;
use crate::fill::BlockFiller;
use crate::kind::PARQUET;
use crate::most_rows::most_rows;
use crate::numbering::RowNumbering;
use crate::wanted::WantedColumns;
use survey::RowGroupSurvey;

/// Cells of a block, and the fewest and most rows of one.
const BLOCK_CELLS: usize = 1 << 19;
const BLOCK_ROWS: (usize, usize) = (ROWS, 1 << 17);

/// A Parquet file in blocks of rows of one row group, each of which is read by itself.
struct ParquetTable<'a, B> {
    form: BatchForm<'a>,
    /// Opens the file once more: every reader moves its own place in it.
    open: B,
    metadata: ArrowReaderMetadata,
    mask: ProjectionMask,
    /// Position of each wanted column in a batch.
    positions: Vec<usize>,
    /// Rows of a block.
    block: usize,
    /// The next row group, how it is read, and its rows that are handed out.
    group: usize,
    survey: Option<RowGroupSurvey>,
    within: usize,
    /// Rows handed out.
    before: u64,
}

/// Opens a file: only the wanted columns are read, some rows at a time.
pub(super) fn open<'a, R: ChunkReader + 'static, B: Fn() -> io::Result<R> + Clone + Send + 'a>(
    file: &'a str,
    open: B,
    wanted: &'a WantedColumns,
) -> Result<Box<dyn BlockTasks<'a> + 'a>, DataError> {
    let failed = |source: ParquetError| DataError::Parquet { file: file.to_owned(), source: Box::new(source) };
    let bytes = open().map_err(|source| DataError::Io { file: file.to_owned(), source })?;
    guarded(file, PARQUET, || {
        let length = bytes.len();
        let loaded = ArrowReaderMetadata::load(&bytes, ArrowReaderOptions::new());
        let metadata = loaded.map_err(|error| unless_encrypted(file, &bytes, failed(error)))?;
        refuse_oversized(file, metadata.metadata(), length)?;
        let names: Vec<&str> = metadata.schema().fields().iter().map(|field| field.name().as_str()).collect();
        let mut roots = wanted.positions(file, &names)?;
        let columns: Vec<&str> = wanted.columns.iter().map(|column| column.name.as_str()).collect();
        refuse_codecs(file, metadata.metadata(), &roots, &columns)?;
        let form = BatchForm { file, format: PARQUET, wanted };
        roots.sort_unstable();
        let positions = form.positions(&metadata.schema().project(&roots).map_err(|error| failed(error.into()))?)?;
        let mask = ProjectionMask::roots(metadata.parquet_schema(), roots);
        let block = (BLOCK_CELLS / wanted.columns.len().max(1)).clamp(BLOCK_ROWS.0, BLOCK_ROWS.1);
        let table =
            ParquetTable { form, open, metadata, mask, positions, block, group: 0, survey: None, within: 0, before: 0 };
        Ok(Box::new(table) as Box<dyn BlockTasks<'a> + 'a>)
    })
}

impl<'a, R: ChunkReader + 'static, B: Fn() -> io::Result<R> + Clone + Send + 'a> BlockTasks<'a>
    for ParquetTable<'a, B>
{
    fn next(&mut self) -> Result<Option<BlockTask<'a>>, DataError> {
        let groups = self.metadata.metadata().row_groups();
        let rows = |group: usize| groups.get(group).map(|group| usize::try_from(group.num_rows()).unwrap_or(0));
        while rows(self.group).is_some_and(|rows| rows <= self.within) {
            (self.group, self.within, self.survey) = (self.group + 1, 0, None);
        }
        let Some(all) = rows(self.group) else { return Ok(None) };
        let survey = match self.survey.take() {
            Some(survey) => survey,
            None => self.survey()?,
        };
        let piece = RowGroupRows {
            form: self.form,
            metadata: survey.metadata.clone(),
            mask: self.mask.clone(),
            positions: self.positions.clone(),
            group: self.group,
            skip: self.within,
            rows: self.block.min(all - self.within),
            batch: survey.rows,
            before: self.before,
        };
        self.survey = Some(survey);
        self.within += piece.rows;
        self.before += piece.rows as u64;
        let declared = self.metadata.metadata().file_metadata().num_rows().max(1);
        let done = TableProgress::Share((self.before as f64 / declared as f64).min(1.0));
        let open = self.open.clone();
        Ok(Some(BlockTask { make: Box::new(move || piece.block(open())), done }))
    }

    fn alone(&self) -> usize {
        usize::from(self.metadata.metadata().file_metadata().num_rows() <= ROWS as i64)
    }
}

impl<R: ChunkReader + 'static, B: Fn() -> io::Result<R>> ParquetTable<'_, B> {
    /// How the next row group is to be read.
    fn survey(&self) -> Result<RowGroupSurvey, DataError> {
        let file = self.form.file;
        let bytes = (self.open)().map_err(|source| DataError::Io { file: file.to_owned(), source })?;
        let found = survey::survey(file, &bytes, &self.metadata, &self.mask, (self.group..self.group + 1, ROWS));
        found.map_err(|error| unless_encrypted(file, &bytes, error))
    }
}

/// Rows of one row group.
struct RowGroupRows<'a> {
    form: BatchForm<'a>,
    metadata: ArrowReaderMetadata,
    mask: ProjectionMask,
    positions: Vec<usize>,
    group: usize,
    /// Rows of the group before these.
    skip: usize,
    rows: usize,
    /// Rows decoded at a time.
    batch: usize,
    /// Rows of the file before these.
    before: u64,
}

impl RowGroupRows<'_> {
    fn block<R: ChunkReader + 'static>(self, bytes: io::Result<R>) -> RowBlock {
        let file = self.form.file.to_owned();
        match bytes {
            Ok(bytes) => self.read(bytes),
            Err(source) => RowBlock::failed(DataError::Io { file, source }),
        }
    }

    fn read<R: ChunkReader + 'static>(self, bytes: R) -> RowBlock {
        let RowGroupRows { form, metadata, mask, positions, group, skip, rows, batch, mut before } = self;
        let (mut filler, numbering) = (BlockFiller::new(form.wanted, rows), RowNumbering::from(before + 1));
        let last = before + rows as u64;
        let read = || -> Result<(), DataError> {
            let mut reader = guarded(form.file, PARQUET, || {
                let builder = ParquetRecordBatchReaderBuilder::new_with_metadata(bytes, metadata)
                    .with_projection(mask)
                    .with_row_groups(vec![group])
                    .with_offset(skip)
                    .with_limit(rows)
                    .with_batch_size(batch);
                let failed = |source| DataError::Parquet { file: form.file.to_owned(), source: Box::new(source) };
                builder.build().map_err(failed)
            })?;
            while let Some(batch) = guarded(form.file, PARQUET, || next_batch(&mut reader, form.file))? {
                form.fill(&mut filler, &positions, (&batch, before))?;
                before += batch.num_rows() as u64;
            }
            // to go on would take a declared row group of any length in vain
            let whole = before == last;
            whole.then_some(()).ok_or_else(|| DataError::Crashed { file: form.file.to_owned(), format: PARQUET })
        };
        let end = read().err();
        filler.finish(numbering, end)
    }
}

/// The error that reading met; the error of an encrypted file where the end of the file says that it is one.
pub(crate) fn unless_encrypted(file: &str, bytes: &impl ChunkReader, error: DataError) -> DataError {
    match is_encrypted(bytes) {
        Some(true) => DataError::Encrypted { file: file.to_owned() },
        _ => error,
    }
}

/// Whether the end of a file says that it, or some of its columns, are encrypted; `None` where it says nothing.
fn is_encrypted(bytes: &impl ChunkReader) -> Option<bool> {
    /// Length of the footer, then the mark of a file whose footer is encrypted or not.
    const TAIL: usize = 8;
    let length = bytes.len();
    let tail = bytes.get_bytes(length.checked_sub(TAIL as u64)?, TAIL).ok()?;
    if tail.ends_with(b"PARE") {
        return Some(true);
    }
    let footer = u64::from(u32::from_le_bytes(tail[..4].try_into().ok()?));
    let start = length.checked_sub(footer + TAIL as u64)?;
    header::has_encryption(bytes.get_bytes(start, usize::try_from(footer).ok()?).ok()?.as_ref()).ok()
}

fn next_batch(
    reader: &mut ParquetRecordBatchReader,
    file: &str,
) -> Result<Option<arrow_array::RecordBatch>, DataError> {
    reader.next().transpose().map_err(|source| DataError::Arrow {
        file: file.to_owned(),
        format: PARQUET,
        source: Box::new(source),
    })
}

pub(crate) fn refuse_oversized(file: &str, metadata: &ParquetMetaData, bytes: u64) -> Result<(), DataError> {
    let rows = metadata.row_groups().iter().map(|group| u64::try_from(group.num_rows()).unwrap_or(u64::MAX));
    let declared = rows.fold(0, u64::saturating_add);
    let limit = most_rows(bytes);
    if declared <= limit {
        return Ok(());
    }
    Err(DataError::Oversized { file: file.to_owned(), what: "rows", declared, bytes, limit })
}

/// Refuses columns, at these places and of these names, whose compression is not read.
pub(crate) fn refuse_codecs(
    file: &str,
    metadata: &ParquetMetaData,
    roots: &[usize],
    names: &[&str],
) -> Result<(), DataError> {
    let schema = metadata.file_metadata().schema_descr();
    for group in metadata.row_groups() {
        for (leaf, chunk) in group.columns().iter().enumerate().take(schema.num_columns()) {
            let Some(index) = roots.iter().position(|&root| root == schema.get_column_root_idx(leaf)) else { continue };
            let codec = chunk.compression();
            if !matches!(codec, Compression::UNCOMPRESSED | Compression::SNAPPY | Compression::ZSTD(_)) {
                let column = names[index].to_owned();
                let codec = codec.to_string();
                let name = codec.split('(').next().unwrap_or(&codec).to_lowercase();
                return Err(DataError::Codec { file: file.to_owned(), column, found: name.into() });
            }
        }
    }
    Ok(())
}
