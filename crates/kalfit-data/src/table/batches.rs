//! Record batches of Parquet and Arrow IPC into blocks.

use arrow_array::{Array, RecordBatch};
use arrow_schema::{ArrowError, DataType, Schema};

use super::ahead::{BlockTask, BlockTasks, TableProgress};
use super::arrays::{NumberArray, TextArray, TimeArray, misfit};
use super::guard::guarded;
use crate::cell::CellFault;
use crate::error::DataError;
use crate::fill::{BadRow, BlockFiller, ColumnwiseRows};
use crate::moment::{Moment, is_known_zone};
use crate::numbering::RowNumbering;
use crate::wanted::{WantedColumn, WantedColumns};

/// Rows decoded at a time.
pub(super) const ROWS: usize = 8192;
/// Rows of a block.
const BLOCK_ROWS: usize = 8 * ROWS;

/// Gives the next batch; None at the end.
type NextBatch<'a> = Box<dyn FnMut() -> Result<Option<RecordBatch>, DataError> + 'a>;

/// What must be known of a table to read its batches.
#[derive(Clone, Copy)]
pub(super) struct BatchForm<'a> {
    pub(super) file: &'a str,
    pub(super) format: &'static str,
    pub(super) wanted: &'a WantedColumns,
}

/// A table of record batches that come one after the other.
pub(crate) struct BatchTable<'a> {
    form: BatchForm<'a>,
    next_batch: NextBatch<'a>,
    /// Position of each wanted column in a batch.
    positions: Vec<usize>,
    /// What is left of the batch.
    rest: Option<RecordBatch>,
    /// Rows handed out.
    before: u64,
}

/// A wanted column, as far as it is used.
struct DecodedColumn {
    numbers: Option<NumberArray>,
    times: Option<TimeArray>,
    texts: Option<TextArray>,
}

impl<'a> BatchForm<'a> {
    /// Positions of the wanted columns in a schema, which must have them in usable types.
    pub(super) fn positions(self, schema: &Schema) -> Result<Vec<usize>, DataError> {
        let names: Vec<&str> = schema.fields().iter().map(|field| field.name().as_str()).collect();
        let positions = self.wanted.positions(self.file, &names)?;
        for (column, &position) in self.wanted.columns.iter().zip(&positions) {
            let data_type = schema.field(position).data_type();
            if let DataType::Timestamp(_, Some(zone)) = data_type
                && !is_known_zone(zone)
            {
                let (file, column) = (self.file.to_owned(), column.name.clone());
                return Err(DataError::TimeZone { file, column, found: zone.to_string() });
            }
            if let Some(expected) = misfit(data_type, column.is_number(), column.is_time, column.is_text()) {
                return Err(DataError::ColumnType {
                    file: self.file.to_owned(),
                    column: column.name.clone(),
                    used_in: column.used_in.clone(),
                    found: data_type.to_string().into(),
                    expected,
                });
            }
        }
        Ok(positions)
    }

    /// Appends the rows of a batch, of which the first is the one after `before` rows.
    pub(super) fn fill(
        self,
        filler: &mut BlockFiller<'_>,
        positions: &[usize],
        (batch, before): (&RecordBatch, u64),
    ) -> Result<(), DataError> {
        for first in (0..batch.num_rows()).step_by(ROWS) {
            let rows = ROWS.min(batch.num_rows() - first);
            let columns = self.decoded(positions, &batch.slice(first, rows))?;
            let decoded = DecodedRows { form: self, columns, rows, first: before + first as u64 + 1 };
            filler.fill(&decoded).map_err(|(_, error)| error)?;
        }
        Ok(())
    }

    fn decoded(self, positions: &[usize], batch: &RecordBatch) -> Result<Vec<DecodedColumn>, DataError> {
        guarded(self.file, self.format, || {
            let columns = self.wanted.columns.iter().zip(positions);
            let decoded = columns.map(|(column, &position)| DecodedColumn::new(column, batch.column(position)));
            decoded.collect::<Result<_, _>>().map_err(|source| DataError::Arrow {
                file: self.file.to_owned(),
                format: self.format,
                source: Box::new(source),
            })
        })
    }
}

impl<'a> BatchTable<'a> {
    /// A table of batches with this schema, which must have the wanted columns in usable types.
    pub(super) fn new(
        file: &'a str,
        format: &'static str,
        wanted: &'a WantedColumns,
        schema: &Schema,
        next_batch: NextBatch<'a>,
    ) -> Result<BatchTable<'a>, DataError> {
        let form = BatchForm { file, format, wanted };
        Ok(BatchTable { form, next_batch, positions: form.positions(schema)?, rest: None, before: 0 })
    }
}

impl<'a> BlockTasks<'a> for BatchTable<'a> {
    fn next(&mut self) -> Result<Option<BlockTask<'a>>, DataError> {
        let batch = match self.rest.take() {
            Some(rest) => rest,
            None => match (self.next_batch)()? {
                Some(batch) => batch,
                None => return Ok(None),
            },
        };
        let now = batch.num_rows().min(BLOCK_ROWS);
        if now < batch.num_rows() {
            self.rest = Some(batch.slice(now, batch.num_rows() - now));
        }
        let (form, positions, before) = (self.form, self.positions.clone(), self.before);
        self.before += now as u64;
        let batch = batch.slice(0, now);
        let make = move || {
            let mut filler = BlockFiller::new(form.wanted, batch.num_rows());
            let filled = form.fill(&mut filler, &positions, (&batch, before));
            filler.finish(RowNumbering::from(before + 1), filled.err())
        };
        Ok(Some(BlockTask { make: Box::new(make), done: TableProgress::Share(0.0) }))
    }

    fn alone(&self) -> usize {
        1
    }
}

impl DecodedColumn {
    fn new(column: &WantedColumn, array: &dyn Array) -> Result<DecodedColumn, ArrowError> {
        Ok(DecodedColumn {
            numbers: column.is_number().then(|| NumberArray::new(array)).transpose()?,
            times: column.is_time.then(|| TimeArray::new(array)).transpose()?,
            texts: column.is_text().then(|| TextArray::new(array)).transpose()?,
        })
    }
}

/// Rows of a batch.
struct DecodedRows<'a> {
    form: BatchForm<'a>,
    /// The wanted ones.
    columns: Vec<DecodedColumn>,
    rows: usize,
    /// Number of the first row in the file.
    first: u64,
}

impl DecodedRows<'_> {
    fn number(&self, row: usize) -> u64 {
        self.first + row as u64
    }

    fn bad(&self, (column, row): (usize, usize), fault: CellFault, found: &[u8]) -> BadRow {
        let BatchForm { file, wanted, .. } = self.form;
        (row, wanted.columns[column].fault(fault, file, self.number(row), found))
    }
}

impl ColumnwiseRows for DecodedRows<'_> {
    fn rows(&self) -> usize {
        self.rows
    }

    fn numbers(&self, column: usize, mut put: impl FnMut(f64)) -> Result<(), BadRow> {
        let tokens = &self.form.wanted.tokens;
        match &self.columns[column].numbers {
            Some(NumberArray::Values(values)) => {
                for (row, &value) in values.iter().enumerate() {
                    let bad = |fault| self.bad((column, row), fault, value.to_string().as_bytes());
                    put(tokens.finite(value).map_err(bad)?);
                }
            }
            Some(NumberArray::Texts(strings)) => {
                for row in 0..self.rows {
                    let text = strings.get(row).unwrap_or_default().as_bytes();
                    put(tokens.number(text).map_err(|fault| self.bad((column, row), fault, text))?);
                }
            }
            None => {}
        }
        Ok(())
    }

    fn times(&self, column: usize, mut put: impl FnMut(Moment)) -> Result<(), BadRow> {
        let BatchForm { file, wanted: WantedColumns { columns, tokens, .. }, .. } = self.form;
        for row in 0..self.rows {
            let moment = match &self.columns[column].times {
                Some(TimeArray::Moments(moments)) => moments[row],
                Some(TimeArray::Numbers(NumberArray::Values(values))) => {
                    let bad = |fault| self.bad((column, row), fault, values[row].to_string().as_bytes());
                    Some(tokens.finite(values[row]).map_err(bad)?).filter(|time| !time.is_nan()).map(Moment::Number)
                }
                Some(TimeArray::Numbers(NumberArray::Texts(strings))) => {
                    let text = strings.get(row).unwrap_or_default().as_bytes();
                    Some(
                        columns[column]
                            .moment(tokens.number(text), (file, self.number(row)), text)
                            .map_err(|error| (row, error))?,
                    )
                }
                None => return Ok(()),
            };
            put(moment
                .ok_or_else(|| (row, DataError::MissingTime { at: columns[column].place(file, self.number(row)) }))?);
        }
        Ok(())
    }

    fn text<'t>(&'t self, column: usize, row: usize, scratch: &'t mut String) -> Result<Option<&'t str>, DataError> {
        let text = self.columns[column].texts.as_ref().and_then(|texts| texts.get(row, scratch));
        let BatchForm { file, wanted, .. } = self.form;
        wanted.columns[column].measure(text.map_or(0, str::len), file, || self.number(row))?;
        Ok(text.filter(|text| !self.form.wanted.tokens.is_missing(text.as_bytes())))
    }

    fn change(&self, column: usize, row: usize) -> usize {
        self.columns[column].texts.as_ref().map_or(self.rows, |texts| texts.change(row..self.rows))
    }

    fn without_id(&self, column: usize, row: usize) -> DataError {
        let BatchForm { file, wanted, .. } = self.form;
        wanted.columns[column].without_id(file, self.number(row))
    }
}
