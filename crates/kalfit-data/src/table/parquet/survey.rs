//! What the pages of a Parquet file unpack to, looked up in their headers before they are read: a few bytes can declare a page of
//! gigabytes, and a dictionary of one long text can show it in every row.

use std::ops::Range;
use std::sync::Arc;

use arrow_schema::{DataType, Field, Schema};
use bytes::Bytes;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{ArrowReaderMetadata, ArrowReaderOptions};
use parquet::basic::{Encoding, Type};
use parquet::column::page::{Page, PageReader};
use parquet::errors::ParquetError;
use parquet::file::metadata::ColumnChunkMetaData;
use parquet::file::reader::{ChunkReader, Length};
use parquet::file::serialized_reader::SerializedPageReader;

use super::header::PageHeader;
use crate::error::DataError;
use crate::kind::PARQUET;
use crate::table::guard::guarded;

/// A page may unpack to as many bytes as these, and so many times its bytes in the file more.
const PAGE_FREE: u64 = 32 << 20;
const PAGE_PER_BYTE: u64 = 8;
/// Texts of a batch, about, in bytes.
const BATCH_TEXTS: u64 = 16 << 20;
/// Texts of one page of lists, at most, and so many times the bytes of the file more: there is no cutting them between rows.
const LIST_FREE: u64 = 64 << 20;
const LIST_PER_BYTE: u64 = 8;

/// How row groups are to be read.
#[derive(Clone)]
pub(crate) struct RowGroupSurvey {
    /// With texts as they are in the file: where all pages of a column point into a dictionary, as such.
    pub(crate) metadata: ArrowReaderMetadata,
    /// Rows of a batch.
    pub(crate) rows: usize,
}

/// A page of texts.
#[derive(Debug, Clone, Copy)]
struct TextPage {
    values: u64,
    /// What its texts unpack to: in all, and at most for each value.
    bytes: u64,
    each: Option<u64>,
}

/// A column of texts in a row group.
struct TextColumnChunk<'a> {
    /// Its column of the schema.
    root: usize,
    metadata: &'a ColumnChunkMetaData,
    pages: Vec<PageHeader>,
}

/// Looks through the headers of all pages of the columns in these row groups, of which not more than `rows` are to be read at a time.
///
/// # Errors
/// [`DataError::Oversized`] for a page that declares far more than its bytes can hold; what is no header.
pub(crate) fn survey<R: ChunkReader>(
    file: &str,
    bytes: &R,
    metadata: &ArrowReaderMetadata,
    mask: &ProjectionMask,
    (groups, rows): (Range<usize>, usize),
) -> Result<RowGroupSurvey, DataError> {
    guarded(file, PARQUET, || {
        let schema = metadata.parquet_schema();
        let mut chunks = Vec::new();
        for group in metadata.metadata().row_groups().get(groups).unwrap_or_default() {
            for (leaf, chunk) in group.columns().iter().enumerate() {
                if leaf >= schema.num_columns() || !mask.leaf_included(leaf) {
                    continue;
                }
                let pages = pages(file, bytes, chunk)?;
                if chunk.column_type() == Type::BYTE_ARRAY {
                    chunks.push(TextColumnChunk { root: schema.get_column_root_idx(leaf), metadata: chunk, pages });
                }
            }
        }
        // a column comes as a dictionary where it is one in all row groups
        let mut coded = vec![true; schema.root_schema().get_fields().len()];
        chunks.iter().for_each(|chunk| coded[chunk.root] &= chunk.is_coded());
        let mut most = rows;
        for chunk in chunks.iter().filter(|chunk| !coded[chunk.root]) {
            let texts = chunk.texts(bytes).map_err(|source| failed(file, source))?;
            most = most.min(chunk.rows((file, bytes.len()), &texts, rows)?);
        }
        let metadata = with_dictionaries(metadata, &coded).map_err(|source| failed(file, source))?;
        Ok(RowGroupSurvey { metadata, rows: most })
    })
}

fn failed(file: &str, source: ParquetError) -> DataError {
    DataError::Parquet { file: file.to_owned(), source: Box::new(source) }
}

/// Headers of the pages of a column in one row group.
fn pages<R: ChunkReader>(file: &str, bytes: &R, chunk: &ColumnChunkMetaData) -> Result<Vec<PageHeader>, DataError> {
    let (start, length) = chunk.byte_range();
    let end = start.saturating_add(length).min(bytes.len());
    let (mut at, mut pages) = (start, Vec::new());
    while at < end {
        let reader = bytes.get_read(at).map_err(|source| failed(file, source))?;
        let header = PageHeader::read(reader).map_err(|source| failed(file, source.into()))?;
        let limit = header.packed.saturating_mul(PAGE_PER_BYTE).saturating_add(PAGE_FREE);
        if header.unpacked > limit {
            return Err(oversized(file, "unpacked bytes of a page", header.unpacked, (header.packed, limit)));
        }
        at = at.saturating_add(header.length).saturating_add(header.packed);
        pages.push(header);
    }
    Ok(pages)
}

/// Bytes of the longest text in the dictionary of a column in one row group.
fn longest<R: ChunkReader>(bytes: &R, chunk: &ColumnChunkMetaData) -> Result<u64, ParquetError> {
    let values = usize::try_from(chunk.num_values()).unwrap_or(0);
    let first = SerializedPageReader::new(Arc::new(LentBytes(bytes)), chunk, values, None)?.get_next_page()?;
    let Some(Page::DictionaryPage { buf: texts, .. }) = first else { return Ok(0) };
    // each text after its length
    let (mut at, mut longest) = (0, 0);
    while let Some(length) = texts.get(at..at + 4).and_then(|length| length.try_into().ok()).map(u32::from_le_bytes) {
        longest = longest.max(u64::from(length));
        at += 4 + length as usize;
    }
    Ok(longest)
}

/// Bytes of a file that another one reads.
struct LentBytes<'a, R>(&'a R);

impl<R: Length> Length for LentBytes<'_, R> {
    fn len(&self) -> u64 {
        self.0.len()
    }
}

impl<R: ChunkReader> ChunkReader for LentBytes<'_, R> {
    type T = R::T;

    fn get_read(&self, start: u64) -> Result<R::T, ParquetError> {
        self.0.get_read(start)
    }

    fn get_bytes(&self, start: u64, length: usize) -> Result<Bytes, ParquetError> {
        self.0.get_bytes(start, length)
    }
}

fn oversized(file: &str, what: &'static str, declared: u64, (bytes, limit): (u64, u64)) -> DataError {
    DataError::Oversized { file: file.to_owned(), what, declared, bytes, limit }
}

impl TextColumnChunk<'_> {
    /// One dictionary before all other pages, as the format has it, or none.
    fn has_one_dictionary(&self) -> bool {
        self.pages.iter().skip(1).all(|page| !page.is_dictionary)
    }

    /// All pages point into the dictionary.
    fn is_coded(&self) -> bool {
        self.has_one_dictionary() && self.pages.iter().all(|page| page.is_dictionary || page.points())
    }

    /// Texts of the pages, when they are unfolded.
    fn texts<R: ChunkReader>(&self, bytes: &R) -> Result<Vec<TextPage>, ParquetError> {
        let (dictionaries, data): (Vec<&PageHeader>, Vec<&PageHeader>) =
            self.pages.iter().partition(|page| page.is_dictionary);
        let longest = match dictionaries.iter().map(|page| page.unpacked).max() {
            Some(_) if self.has_one_dictionary() => longest(bytes, self.metadata)?,
            largest => largest.unwrap_or(0),
        };
        let page = |page: &&PageHeader| {
            let each = match page.encoding {
                _ if page.points() => Some(longest),
                Some(Encoding::DELTA_BYTE_ARRAY) => Some(page.unpacked), // each begins as the one before it
                _ => None,
            };
            TextPage { values: page.values, bytes: page.unpacked, each }
        };
        Ok(data.iter().map(page).collect())
    }

    /// So many rows, at most, that their texts take about as much room as a batch may.
    fn rows(&self, (file, bytes): (&str, u64), pages: &[TextPage], rows: usize) -> Result<usize, DataError> {
        if self.metadata.column_descr().max_rep_level() == 0 {
            let mut halves = std::iter::successors(Some(rows), |rows| Some(rows / 2)).take_while(|&rows| rows > 1);
            return Ok(halves.find(|&rows| fits(pages, rows as u64)).unwrap_or(1));
        }
        let most = pages.iter().map(|page| page.texts(u64::MAX)).max().unwrap_or(0);
        let limit = bytes.saturating_mul(LIST_PER_BYTE).saturating_add(LIST_FREE);
        if most <= limit {
            return Ok(rows);
        }
        Err(oversized(file, "bytes of texts of a page", most, (bytes, limit)))
    }
}

impl PageHeader {
    /// Its values are places in a dictionary.
    fn points(&self) -> bool {
        matches!(self.encoding, Some(Encoding::PLAIN_DICTIONARY | Encoding::RLE_DICTIONARY))
    }
}

impl TextPage {
    /// Bytes that the texts of so many of its rows take at most.
    fn texts(&self, rows: u64) -> u64 {
        self.each.map_or(self.bytes, |each| each.saturating_mul(rows.min(self.values)))
    }
}

/// True when no `rows` rows that follow each other have more texts than a batch may.
fn fits(pages: &[TextPage], rows: u64) -> bool {
    // rows that touch both pages hold all rows of the pages between them
    let (mut first, mut between, mut texts) = (0, 0_u64, 0_u64);
    for (last, page) in pages.iter().enumerate() {
        if last > first + 1 {
            between = between.saturating_add(pages[last - 1].values);
        }
        texts = texts.saturating_add(page.texts(rows));
        while first < last && between.saturating_add(2) > rows {
            texts = texts.saturating_sub(pages[first].texts(rows));
            first += 1;
            between = if first < last { between.saturating_sub(pages[first].values) } else { 0 };
        }
        if texts > BATCH_TEXTS {
            return false;
        }
    }
    true
}

/// Metadata by which texts come as dictionaries in these columns of the schema.
fn with_dictionaries(metadata: &ArrowReaderMetadata, coded: &[bool]) -> Result<ArrowReaderMetadata, ParquetError> {
    let schema = metadata.schema();
    let field = |(at, field): (usize, &Arc<Field>)| {
        let is_coded = coded.get(at).copied().unwrap_or(false);
        let dictionary = is_coded.then(|| dictionary(field.data_type())).flatten();
        dictionary.map_or_else(|| field.clone(), |to| Arc::new(field.as_ref().clone().with_data_type(to)))
    };
    let fields: Vec<Arc<Field>> = schema.fields().iter().enumerate().map(field).collect();
    if fields == schema.fields().to_vec() {
        return Ok(metadata.clone());
    }
    let schema = Arc::new(Schema::new_with_metadata(fields, schema.metadata().clone()));
    ArrowReaderMetadata::try_new(metadata.metadata().clone(), ArrowReaderOptions::new().with_schema(schema))
}

/// The type of texts, or of lists of them, as dictionaries; `None` for other types.
fn dictionary(data_type: &DataType) -> Option<DataType> {
    let element =
        |field: &Arc<Field>| Some(Arc::new(field.as_ref().clone().with_data_type(dictionary(field.data_type())?)));
    Some(match data_type {
        DataType::Utf8 | DataType::LargeUtf8 => {
            DataType::Dictionary(Box::new(DataType::Int32), Box::new(data_type.clone()))
        }
        DataType::List(field) => DataType::List(element(field)?),
        DataType::LargeList(field) => DataType::LargeList(element(field)?),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use arrow_array::cast::AsArray;
    use arrow_array::{ArrayRef, RecordBatch, StringArray};
    use parquet::arrow::ArrowWriter;
    use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
    use parquet::basic::Compression;
    use parquet::file::properties::{WriterProperties, WriterPropertiesBuilder};

    use super::*;

    /// A file of one column of texts.
    fn file(texts: Vec<String>, set: impl FnOnce(WriterPropertiesBuilder) -> WriterPropertiesBuilder) -> Bytes {
        let column: ArrayRef = Arc::new(StringArray::from(texts));
        let batch = RecordBatch::try_from_iter([("id", column)]).expect("a batch");
        let properties = set(WriterProperties::builder()).build();
        let mut bytes = Vec::new();
        let mut writer = ArrowWriter::try_new(&mut bytes, batch.schema(), Some(properties)).expect("a writer");
        writer.write(&batch).expect("rows are written");
        writer.close().expect("the file ends");
        Bytes::from(bytes)
    }

    fn surveyed(bytes: &Bytes) -> Result<RowGroupSurvey, DataError> {
        let about = ArrowReaderMetadata::load(bytes, ArrowReaderOptions::new()).expect("metadata");
        survey("a file", bytes, &about, &ProjectionMask::all(), (0..about.metadata().num_row_groups(), 8192))
    }

    fn long(rows: usize) -> Vec<String> {
        vec!["x".repeat(1 << 20); rows]
    }

    /// Reads all texts as a survey says.
    fn read(bytes: &Bytes, survey: &RowGroupSurvey) -> Vec<RecordBatch> {
        let builder = ParquetRecordBatchReaderBuilder::new_with_metadata(bytes.clone(), survey.metadata.clone());
        let reader = builder.with_batch_size(survey.rows).build().expect("a reader");
        reader.map(|batch| batch.expect("a batch")).collect()
    }

    #[test]
    fn texts_of_a_dictionary_stay_in_it() {
        let bytes = file(long(300), |with| with.set_dictionary_page_size_limit(1 << 21));
        assert!(bytes.len() < 3 << 20, "{} bytes", bytes.len());
        let survey = surveyed(&bytes).expect("sound");
        let batches = read(&bytes, &survey);
        assert_eq!((survey.rows, batches.len(), batches[0].num_rows()), (8192, 1, 300));
        let column = batches[0].column(0).as_any_dictionary();
        assert_eq!(column.values().len(), 1);
        assert_eq!(column.values().as_string::<i32>().value(0).len(), 1 << 20);
    }

    #[test]
    fn long_texts_outside_a_dictionary_come_few_at_a_time() {
        let delta =
            |with: WriterPropertiesBuilder| with.set_dictionary_enabled(false).set_encoding(Encoding::DELTA_BYTE_ARRAY);
        let plain =
            |with: WriterPropertiesBuilder| with.set_dictionary_enabled(false).set_compression(Compression::SNAPPY);
        // texts that fill the dictionary, after which they stand by themselves
        let mixed = |with: WriterPropertiesBuilder| with.set_dictionary_page_size_limit(1 << 20);
        let other = (0..300).map(|row| "y".repeat(1_000_000) + &row.to_string());
        let mixture: Vec<String> = long(300).into_iter().chain(other).collect();
        for (name, bytes, least) in [
            ("delta", file(long(300), delta), 8),
            ("plain", file(long(300), plain), 8),
            ("mixed", file(mixture, mixed), 4),
        ] {
            let survey = surveyed(&bytes).expect("sound");
            println!("{name}: {} bytes, {} rows", bytes.len(), survey.rows);
            assert!((least..=16).contains(&survey.rows), "{name}: {} rows", survey.rows);
            let batches = read(&bytes, &survey);
            let most = batches.iter().map(RecordBatch::get_array_memory_size).max();
            assert!(most.is_some_and(|most| most < 64 << 20), "{name}: {most:?} bytes");
        }
    }

    #[test]
    fn a_column_that_is_a_dictionary_in_some_row_groups_alone_is_unfolded_in_all() {
        // the first group repeats one text, those of the second fill its dictionary and go on without it
        let other = (0..300).map(|row| "y".repeat(100_000) + &row.to_string());
        let texts: Vec<String> = long(300).into_iter().chain(other).collect();
        let set = |with: WriterPropertiesBuilder| {
            with.set_max_row_group_row_count(Some(300)).set_dictionary_page_size_limit(2 << 20)
        };
        let survey = surveyed(&file(texts, set)).expect("sound");
        assert!(matches!(survey.metadata.schema().field(0).data_type(), DataType::Utf8));
        assert!(survey.rows <= 16, "{} rows", survey.rows);
    }

    #[test]
    fn short_texts_come_in_whole_batches() {
        let ids = |rows: usize| (0..rows).map(|row| format!("test-{row:06}")).collect::<Vec<String>>();
        for (name, set) in [("plain", false), ("delta", true)] {
            let bytes = file(ids(100_000), |with| {
                let with = with.set_dictionary_enabled(false);
                if set { with.set_encoding(Encoding::DELTA_LENGTH_BYTE_ARRAY) } else { with }
            });
            assert_eq!(surveyed(&bytes).expect("sound").rows, 8192, "{name}");
        }
    }

    #[test]
    fn rows_that_touch_both_pages_hold_all_rows_between_them() {
        let page = |values, bytes| TextPage { values, bytes, each: None };
        let half = BATCH_TEXTS / 2;
        let pages = [page(5, half), page(3, 0), page(1, half), page(1, 1)];
        let fits = |rows| fits(&pages, rows);
        // the first two texts of the room and the last one: rows 5 to 10
        assert_eq!((fits(5), fits(6)), (true, false));
    }

    #[test]
    fn a_page_that_declares_far_more_than_it_has_is_refused() {
        let bytes = file(long(1), |with| with.set_dictionary_enabled(false).set_compression(Compression::SNAPPY));
        let about = ArrowReaderMetadata::load(&bytes, ArrowReaderOptions::new()).expect("metadata");
        let (start, _) = about.metadata().row_group(0).column(0).byte_range();
        let at = usize::try_from(start).expect("a place");
        let mut bad = bytes.to_vec();
        // the type of the page, then what it unpacks to: a number of four bytes
        assert_eq!(bad[at..at + 3], [0x15, 0, 0x15]);
        bad[at + 3..at + 7].copy_from_slice(&[0xfe, 0xff, 0xff, 0x7f]);
        let refused = surveyed(&Bytes::from(bad)).map(|survey| survey.rows).expect_err("128 MB").to_string();
        assert!(refused.starts_with("a file: found 134217727 unpacked bytes of a page declared by "), "{refused}");
    }
}
