//! Parquet files.

use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder};
use parquet::basic::Compression;
use parquet::errors::ParquetError;
use parquet::file::metadata::ParquetMetaData;
use parquet::file::reader::ChunkReader;

use super::batches::{BatchTable, ROWS};
use super::guard::guarded;
use crate::error::DataError;
use crate::wanted::Wanted;

pub(crate) const FORMAT: &str = "Parquet";

/// Rows a file is believed to hold beyond [`ROWS_PER_BYTE`]. Run-length codes can declare billions of equal rows in a
/// few bytes; a table worth reading does not compress so well.
pub(crate) const ROWS_FREE: u64 = 1_000_000;
pub(crate) const ROWS_PER_BYTE: u64 = 1_000;

/// Opens a file: only the wanted columns are read, a few thousand rows at a time.
pub(super) fn open<'a>(
    file: &'a str,
    bytes: impl ChunkReader + 'static,
    wanted: &'a Wanted,
) -> Result<BatchTable<'a>, DataError> {
    let failed = move |source: ParquetError| DataError::Parquet { file: file.to_owned(), source: Box::new(source) };
    let (schema, rows, mut reader) = guarded(file, FORMAT, || {
        let length = bytes.len();
        let builder = ParquetRecordBatchReaderBuilder::try_new(bytes).map_err(failed)?;
        refuse_oversized(file, builder.metadata(), length)?;
        let names: Vec<&str> = builder.schema().fields().iter().map(|field| field.name().as_str()).collect();
        let mut roots = wanted.positions(file, &names)?;
        let columns: Vec<&str> = wanted.columns.iter().map(|column| column.name.as_str()).collect();
        refuse_codecs(file, builder.metadata(), &roots, &columns)?;
        roots.sort_unstable();
        let mask = ProjectionMask::roots(builder.parquet_schema(), roots);
        let rows = u64::try_from(builder.metadata().file_metadata().num_rows()).unwrap_or(0);
        let reader = builder.with_projection(mask).with_batch_size(ROWS).build().map_err(failed)?;
        Ok((arrow::array::RecordBatchReader::schema(&reader), rows, reader))
    })?;
    let next = move || guarded(file, FORMAT, || next_batch(&mut reader, file));
    let table = BatchTable::new(file, FORMAT, wanted, &schema, Box::new(next))?;
    Ok(table.of_rows(rows))
}

fn next_batch(
    reader: &mut ParquetRecordBatchReader,
    file: &str,
) -> Result<Option<arrow::array::RecordBatch>, DataError> {
    reader.next().transpose().map_err(|source| DataError::Arrow { file: file.to_owned(), source: Box::new(source) })
}

pub(crate) fn refuse_oversized(file: &str, metadata: &ParquetMetaData, bytes: u64) -> Result<(), DataError> {
    let rows = metadata.row_groups().iter().map(|group| u64::try_from(group.num_rows()).unwrap_or(u64::MAX));
    let declared = rows.fold(0, u64::saturating_add);
    let limit = bytes.saturating_mul(ROWS_PER_BYTE).saturating_add(ROWS_FREE);
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
