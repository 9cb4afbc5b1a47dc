//! An exchange file, row by row: named columns of numbers, texts and lists, none of which is trusted.

use std::collections::BTreeMap;

use arrow_array::RecordBatch;
use arrow_schema::ArrowError;
use arrow_schema::DataType;
use nalgebra::DMatrix;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder,
};
use parquet::errors::ParquetError;
use parquet::file::metadata::ParquetMetaData;
use parquet::file::reader::ChunkReader;

use super::error::ExchangeError;
use super::lists::{NumberLists, TextLists, is_numbers, is_words};
use super::schema::{ColumnShape, SchemaColumn};
use crate::cell::shown;
use crate::columns::{FileColumns, nearest};
use crate::error::DataError;
use crate::kind::PARQUET;
use crate::most_rows::most_rows;
use crate::place::CellPlace;
use crate::table::arrays::{NumberArray, TextArray, is_numeric, misfit};
use crate::table::guard::guarded;
use crate::table::parquet::survey::{RowGroupSurvey, survey};
use crate::table::parquet::{refuse_codecs, refuse_oversized, unless_encrypted};

/// Rows decoded at a time: they may hold matrices.
const ROWS: usize = 256;

/// What is read of a file.
pub(super) struct SheetRequest<'a> {
    /// What the file is, in words: "estimates".
    pub(super) kind: &'static str,
    /// The columns of its schema.
    pub(super) columns: &'a [SchemaColumn],
    /// (name in the file, shape): further columns, which are there.
    pub(super) further: Vec<(String, ColumnShape)>,
}

/// Where the columns of a request are in a file.
#[derive(Clone)]
pub(super) struct SheetPlan<'a> {
    file: &'a str,
    mask: ProjectionMask,
    /// How all row groups are read.
    survey: RowGroupSurvey,
    /// Shapes by name.
    shapes: BTreeMap<String, ColumnShape>,
}

/// The bytes of a file, and what it says of itself.
pub(super) struct OpenParquet<R> {
    bytes: R,
    pub(super) about: ArrowReaderMetadata,
}

/// Rows of one row group: `rows` of them, after `skip` of the group and `before` of the file.
#[derive(Debug, Clone, Copy)]
pub(super) struct RowGroupPart {
    pub(super) group: usize,
    pub(super) skip: usize,
    pub(super) rows: usize,
    pub(super) before: u64,
}

/// An open file.
pub(super) struct ExchangeSheet<'a> {
    plan: SheetPlan<'a>,
    reader: ParquetRecordBatchReader,
    /// Rows before the next batch.
    before: u64,
}

/// Some rows of a file.
pub(super) struct SheetBatch<'a> {
    file: &'a str,
    before: u64,
    rows: usize,
    /// By name; there are so few that looking through all is quickest.
    cells: Vec<(String, SheetColumn)>,
}

enum SheetColumn {
    Texts(TextArray),
    Numbers(NumberArray),
    Lists(NumberLists),
    Words(TextLists),
}

/// One row of a batch.
#[derive(Clone, Copy)]
pub(super) struct SheetRow<'b> {
    batch: &'b SheetBatch<'b>,
    index: usize,
}

/// Opens a file.
pub(super) fn open<R: ChunkReader>(file: &str, bytes: R) -> Result<OpenParquet<R>, DataError> {
    let failed = |source: ParquetError| DataError::Parquet { file: file.to_owned(), source: Box::new(source) };
    guarded(file, PARQUET, || {
        let length = bytes.len();
        let loaded = ArrowReaderMetadata::load(&bytes, ArrowReaderOptions::new());
        let about = loaded.map_err(|error| unless_encrypted(file, &bytes, failed(error)))?;
        refuse_oversized(file, about.metadata(), length)?;
        refuse_long_lists(file, about.metadata(), length)?;
        Ok(OpenParquet { bytes, about })
    })
}

/// Lists can declare as many elements in a few bytes as rows can.
fn refuse_long_lists(file: &str, metadata: &ParquetMetaData, bytes: u64) -> Result<(), DataError> {
    let limit = most_rows(bytes);
    for group in metadata.row_groups() {
        for chunk in group.columns() {
            let declared = u64::try_from(chunk.num_values()).unwrap_or(u64::MAX);
            if declared > limit {
                return Err(DataError::Oversized { file: file.to_owned(), what: "values", declared, bytes, limit });
            }
        }
    }
    Ok(())
}

impl<'a> ExchangeSheet<'a> {
    /// All rows of a file with the columns of a request.
    pub(super) fn new<R: ChunkReader + 'static>(
        file: &'a str,
        opened: OpenParquet<R>,
        request: &SheetRequest<'_>,
    ) -> Result<ExchangeSheet<'a>, DataError> {
        SheetPlan::new(file, &opened, request)?.sheet(opened.bytes, None)
    }

    /// The next rows; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<SheetBatch<'a>>, DataError> {
        let file = self.plan.file;
        let failed =
            |source: ArrowError| DataError::Arrow { file: file.to_owned(), format: PARQUET, source: Box::new(source) };
        let (reader, shapes) = (&mut self.reader, &self.plan.shapes);
        let batch = guarded(file, PARQUET, || {
            let Some(batch) = reader.next().transpose().map_err(failed)? else { return Ok(None) };
            let cells = decode(&batch, shapes).map_err(failed)?;
            Ok(Some((batch.num_rows(), cells)))
        })?;
        Ok(batch.map(|(rows, cells)| {
            let before = self.before;
            self.before += rows as u64;
            SheetBatch { file, before, rows, cells }
        }))
    }
}

impl<'a> SheetPlan<'a> {
    /// Finds the columns of a request in a file.
    pub(super) fn new<R: ChunkReader>(
        file: &'a str,
        opened: &OpenParquet<R>,
        request: &SheetRequest<'_>,
    ) -> Result<SheetPlan<'a>, DataError> {
        let about = &opened.about;
        let names: Vec<String> = about.schema().fields().iter().map(|field| field.name().clone()).collect();
        let (mut roots, mut shapes) = (Vec::new(), BTreeMap::new());
        let own =
            request.columns.iter().map(|column| (column.name, column.shape, column.needed.then_some(column.name)));
        let further = request.further.iter().map(|(name, shape)| (name.as_str(), *shape, None));
        for (name, shape, needed) in own.chain(further) {
            let Some(root) = position(file, &names, name)? else {
                if let Some(column) = needed {
                    return Err(missing(file, request.kind, column, names).into());
                }
                continue;
            };
            let data_type = about.schema().field(root).data_type();
            if *data_type == DataType::Null {
                continue; // nothing but nulls
            }
            fits(file, data_type, (name, shape), request.kind)?;
            roots.push(root);
            shapes.insert(name.to_owned(), shape);
        }
        let found: Vec<&str> = roots.iter().map(|&root| names[root].as_str()).collect();
        refuse_codecs(file, about.metadata(), &roots, &found)?;
        roots.sort_unstable();
        let mask = ProjectionMask::roots(about.parquet_schema(), roots);
        let groups = 0..about.metadata().num_row_groups();
        let survey = survey(file, &opened.bytes, about, &mask, (groups, ROWS))?;
        Ok(SheetPlan { file, mask, survey, shapes })
    }

    /// The rows of a part, or all.
    pub(super) fn sheet<R: ChunkReader + 'static>(
        self,
        bytes: R,
        part: Option<RowGroupPart>,
    ) -> Result<ExchangeSheet<'a>, DataError> {
        let file = self.file;
        let failed = |source: ParquetError| DataError::Parquet { file: file.to_owned(), source: Box::new(source) };
        let reader = guarded(file, PARQUET, || {
            let all = ParquetRecordBatchReaderBuilder::new_with_metadata(bytes, self.survey.metadata.clone());
            let builder = match part {
                None => all,
                Some(RowGroupPart { group, skip, rows, .. }) => {
                    all.with_row_groups(vec![group]).with_offset(skip).with_limit(rows)
                }
            };
            builder.with_projection(self.mask.clone()).with_batch_size(self.survey.rows).build().map_err(failed)
        })?;
        Ok(ExchangeSheet { plan: self, reader, before: part.map_or(0, |part| part.before) })
    }
}

fn decode(
    batch: &RecordBatch,
    shapes: &BTreeMap<String, ColumnShape>,
) -> Result<Vec<(String, SheetColumn)>, ArrowError> {
    let schema = batch.schema();
    let columns = schema.fields().iter().zip(batch.columns());
    let cells = columns.filter_map(|(field, array)| {
        let cells = match shapes.get(field.name())? {
            ColumnShape::Text => TextArray::new(array).map(SheetColumn::Texts),
            ColumnShape::Number => NumberArray::new(array).map(SheetColumn::Numbers),
            ColumnShape::Numbers => NumberLists::new(array).map(SheetColumn::Lists),
            ColumnShape::Words => TextLists::new(array).map(SheetColumn::Words),
        };
        Some(cells.map(|cells| (field.name().clone(), cells)))
    });
    cells.collect()
}

/// Place of a column; an error when there are two.
fn position(file: &str, names: &[String], name: &str) -> Result<Option<usize>, DataError> {
    let mut places = (0..names.len()).filter(|&at| names[at] == name);
    match (places.next(), places.next()) {
        (Some(first), Some(second)) => Err(DataError::DuplicateColumn {
            file: file.to_owned(),
            column: name.to_owned(),
            first: first + 1,
            second: second + 1,
        }),
        (first, _) => Ok(first),
    }
}

fn missing(file: &str, kind: &'static str, column: &'static str, names: Vec<String>) -> ExchangeError {
    let columns = Box::new(FileColumns { near: nearest(column, &names), names, elsewhere: None });
    ExchangeError::MissingColumn { file: file.to_owned(), kind, column, columns }
}

fn fits(
    file: &str,
    data_type: &DataType,
    (name, shape): (&str, ColumnShape),
    kind: &'static str,
) -> Result<(), DataError> {
    let expected = match shape {
        ColumnShape::Text => misfit(data_type, false, false, true),
        ColumnShape::Number => (!is_numeric(data_type)).then_some("numbers"),
        ColumnShape::Numbers => (!is_numbers(data_type)).then_some("lists of numbers"),
        ColumnShape::Words => (!is_words(data_type)).then_some("lists of texts"),
    };
    let Some(expected) = expected else { return Ok(()) };
    Err(DataError::ColumnType {
        file: file.to_owned(),
        column: name.to_owned(),
        used_in: kind.to_owned(),
        found: data_type.to_string().into(),
        expected,
    })
}

impl<'a> SheetBatch<'a> {
    pub(super) fn rows(&self) -> impl Iterator<Item = SheetRow<'_>> {
        (0..self.rows).map(|index| SheetRow { batch: self, index })
    }
}

impl<'b> SheetRow<'b> {
    /// Its number in the file, from 1.
    pub(super) fn number(self) -> u64 {
        self.batch.before + self.index as u64 + 1
    }

    /// One of its cells.
    pub(super) fn place(self, column: &str) -> Box<CellPlace> {
        Box::new(CellPlace { file: self.batch.file.to_owned(), row: self.number(), column: column.to_owned() })
    }

    /// True when the file has this column.
    pub(super) fn has(self, column: &str) -> bool {
        self.cells(column).is_some()
    }

    fn cells(self, column: &str) -> Option<&'b SheetColumn> {
        self.batch.cells.iter().find(|(name, _)| name == column).map(|(_, cells)| cells)
    }

    /// What is made of a text; `None` when it is null or the file has no such column.
    pub(super) fn with_text<T>(self, column: &str, make: impl FnOnce(&str) -> T) -> Option<T> {
        let Some(SheetColumn::Texts(texts)) = self.cells(column) else { return None };
        let mut scratch = String::new();
        texts.get(self.index, &mut scratch).map(make)
    }

    /// A text; `None` when it is null or the file has no such column.
    pub(super) fn text(self, column: &str) -> Option<String> {
        self.with_text(column, str::to_owned)
    }

    /// A number; NaN when it is null or the file has no such column.
    pub(super) fn number_or_nan(self, column: &str) -> f64 {
        match self.cells(column) {
            Some(SheetColumn::Numbers(NumberArray::Values(values))) => values[self.index],
            _ => f64::NAN,
        }
    }

    /// A count; `None` when it is null or the file has no such column.
    pub(super) fn count(self, column: &str) -> Result<Option<usize>, ExchangeError> {
        const MOST: f64 = 9_007_199_254_740_992.0; // 2^53: whole numbers are exact up to here
        let value = self.number_or_nan(column);
        if value.is_nan() {
            return Ok(None);
        }
        if !(0.0..=MOST).contains(&value) || value.fract() != 0.0 {
            let (at, found) = (self.place(column), value.to_string());
            return Err(ExchangeError::Value { at, found, expected: "a count: 0, 1, 2 and so on" });
        }
        Ok(Some(value as usize))
    }

    /// A finite number.
    pub(super) fn finite(self, column: &str) -> Result<f64, ExchangeError> {
        let value = self.number_or_nan(column);
        if value.is_nan() {
            return Err(ExchangeError::Missing { at: self.place(column), expected: "a number" });
        }
        if value.is_infinite() {
            let (at, found) = (self.place(column), value.to_string());
            return Err(ExchangeError::Value { at, found, expected: "a finite number" });
        }
        Ok(value)
    }

    /// A list of finite numbers; `None` when it is null or the file has no such column.
    pub(super) fn list(self, column: &str) -> Result<Option<&'b [f64]>, ExchangeError> {
        let Some(SheetColumn::Lists(lists)) = self.cells(column) else { return Ok(None) };
        let Some(list) = lists.get(self.index) else { return Ok(None) };
        match list.iter().position(|value| !value.is_finite()) {
            None => Ok(Some(list)),
            Some(at) => Err(ExchangeError::NotFinite { at: self.place(column), found: list[at], element: at + 1 }),
        }
    }

    /// A list that must be there.
    pub(super) fn needed(self, column: &str) -> Result<&'b [f64], ExchangeError> {
        self.list(column)?
            .ok_or_else(|| ExchangeError::Missing { at: self.place(column), expected: "a list of numbers" })
    }

    /// A list that must have this length; `rule` says why.
    pub(super) fn exact(
        self,
        column: &str,
        length: usize,
        rule: impl FnOnce() -> String,
    ) -> Result<&'b [f64], ExchangeError> {
        let list = self.needed(column)?;
        if list.len() == length {
            return Ok(list);
        }
        let (at, found) = (self.place(column), list.len());
        Err(ExchangeError::Length { at, found, expected: length.to_string(), rule: rule() })
    }

    /// A matrix of this many rows and any number of columns; `rule` says why.
    pub(super) fn rows(
        self,
        column: &str,
        rows: usize,
        rule: impl FnOnce() -> String,
    ) -> Result<DMatrix<f64>, ExchangeError> {
        let list = self.needed(column)?;
        let columns = list.len().checked_div(rows).unwrap_or(0);
        if columns * rows == list.len() {
            return Ok(DMatrix::from_row_slice(rows, columns, list));
        }
        let (at, found, expected) = (self.place(column), list.len(), format!("a multiple of {rows}"));
        Err(ExchangeError::Length { at, found, expected, rule: rule() })
    }

    /// True when a list has the precision of single floats.
    pub(super) fn is_single(self, column: &str) -> bool {
        matches!(self.cells(column), Some(SheetColumn::Lists(lists)) if lists.is_single())
    }

    /// A list of texts; `None` when it is null or the file has no such column.
    pub(super) fn words(self, column: &str) -> Option<Vec<&'b str>> {
        match self.cells(column) {
            Some(SheetColumn::Words(words)) => words.get(self.index),
            _ => None,
        }
    }

    /// True for a list of these texts.
    pub(super) fn has_words(self, column: &str, expected: &[String]) -> bool {
        matches!(self.cells(column), Some(SheetColumn::Words(words)) if words.are(self.index, expected))
    }

    /// A text for a message.
    pub(super) fn shown(self, column: &str) -> Option<String> {
        self.text(column).map(|text| shown(text.as_bytes()))
    }
}
