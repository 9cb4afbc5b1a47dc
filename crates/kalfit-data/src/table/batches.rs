//! Record batches of Parquet and Arrow IPC into blocks.

use arrow::array::{Array, RecordBatch};
use arrow::datatypes::Schema;
use arrow::error::ArrowError;

use super::ahead::{Done, Task, Tasks};
use super::arrays::{Numbers, Texts, Times, misfit};
use super::guard::guarded;
use crate::block::Filler;
use crate::cell::Tokens;
use crate::error::DataError;
use crate::moment::Moment;
use crate::wanted::{Wanted, WantedColumn};

/// Rows decoded at a time.
pub(super) const ROWS: usize = 8192;
/// Rows of a block.
const BLOCK_ROWS: usize = 8 * ROWS;

/// Gives the next batch; None at the end.
type NextBatch<'a> = Box<dyn FnMut() -> Result<Option<RecordBatch>, DataError> + 'a>;

/// What must be known of a table to read its batches.
#[derive(Clone, Copy)]
pub(super) struct Form<'a> {
    pub(super) file: &'a str,
    pub(super) format: &'static str,
    pub(super) wanted: &'a Wanted,
}

/// A table of record batches that come one after the other.
pub(crate) struct BatchTable<'a> {
    form: Form<'a>,
    next_batch: NextBatch<'a>,
    /// Position of each wanted column in a batch.
    positions: Vec<usize>,
    /// What is left of the batch.
    rest: Option<RecordBatch>,
    /// Rows handed out.
    before: u64,
}

/// A wanted column, as far as it is used.
struct Decoded {
    numbers: Option<Numbers>,
    times: Option<Times>,
    texts: Option<Texts>,
}

impl<'a> Form<'a> {
    /// Positions of the wanted columns in a schema, which must have them in usable types.
    pub(super) fn positions(self, schema: &Schema) -> Result<Vec<usize>, DataError> {
        let names: Vec<&str> = schema.fields().iter().map(|field| field.name().as_str()).collect();
        let positions = self.wanted.positions(self.file, &names)?;
        for (column, &position) in self.wanted.columns.iter().zip(&positions) {
            let data_type = schema.field(position).data_type();
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

    /// A block of about so many rows, none yet.
    pub(super) fn filler(self, rows: usize) -> Filler {
        Filler::new((self.wanted.numbers, self.wanted.texts), self.wanted.columns.len(), rows)
    }

    /// Appends the rows of a batch, of which the first is the one after `before` rows.
    pub(super) fn fill(
        self,
        filler: &mut Filler,
        positions: &[usize],
        (batch, mut before): (&RecordBatch, u64),
    ) -> Result<(), DataError> {
        for first in (0..batch.num_rows()).step_by(ROWS) {
            let batch = batch.slice(first, ROWS.min(batch.num_rows() - first));
            let decoded = self.decoded(positions, &batch)?;
            for index in 0..batch.num_rows() {
                before += 1;
                self.row(filler, &decoded, (index, before))?;
            }
        }
        Ok(())
    }

    fn decoded(self, positions: &[usize], batch: &RecordBatch) -> Result<Vec<Decoded>, DataError> {
        guarded(self.file, self.format, || {
            let columns = self.wanted.columns.iter().zip(positions);
            let decoded = columns.map(|(column, &position)| Decoded::new(column, batch.column(position)));
            decoded
                .collect::<Result<_, _>>()
                .map_err(|source| DataError::Arrow { file: self.file.to_owned(), source: Box::new(source) })
        })
    }

    fn row(self, filler: &mut Filler, decoded: &[Decoded], (index, row): (usize, u64)) -> Result<(), DataError> {
        let (file, tokens) = (self.file, &self.wanted.tokens);
        for (at, (column, decoded)) in self.wanted.columns.iter().zip(decoded).enumerate() {
            let cell = Cell { column, file, tokens, row, index };
            if let Some(numbers) = &decoded.numbers {
                let value = cell.number(numbers)?;
                column.numbers.iter().for_each(|&number| filler.number(number, value));
            }
            if let Some(times) = &decoded.times {
                filler.time(cell.time(times)?);
            }
            if let Some(texts) = &decoded.texts {
                if index > 0 && texts.repeats(index) {
                    continue; // id and labels stay
                }
                let mut scratch = String::new();
                let text = texts.get(index, &mut scratch).filter(|text| !tokens.is_missing(text.as_bytes()));
                if column.is_test {
                    let id = text.ok_or_else(|| DataError::MissingTest { at: column.place(file, row) })?;
                    filler.id(id);
                }
                filler.text(at, &column.texts, text);
            }
        }
        filler.end_row(row);
        Ok(())
    }
}

impl<'a> BatchTable<'a> {
    /// A table of batches with this schema, which must have the wanted columns in usable types.
    pub(super) fn new(
        file: &'a str,
        format: &'static str,
        wanted: &'a Wanted,
        schema: &Schema,
        next_batch: NextBatch<'a>,
    ) -> Result<BatchTable<'a>, DataError> {
        let form = Form { file, format, wanted };
        Ok(BatchTable { form, next_batch, positions: form.positions(schema)?, rest: None, before: 0 })
    }
}

impl<'a> Tasks<'a> for BatchTable<'a> {
    fn next(&mut self) -> Result<Option<Task<'a>>, DataError> {
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
            let mut filler = form.filler(batch.num_rows());
            let filled = form.fill(&mut filler, &positions, (&batch, before));
            filler.finish(filled.err())
        };
        Ok(Some(Task { make: Box::new(make), done: Done::Share(0.0) }))
    }

    fn alone(&self) -> usize {
        1
    }
}

impl Decoded {
    fn new(column: &WantedColumn, array: &dyn Array) -> Result<Decoded, ArrowError> {
        Ok(Decoded {
            numbers: column.is_number().then(|| Numbers::new(array)).transpose()?,
            times: column.is_time.then(|| Times::new(array)).transpose()?,
            texts: column.is_text().then(|| Texts::new(array)).transpose()?,
        })
    }
}

/// Where a value stands.
struct Cell<'a> {
    column: &'a WantedColumn,
    file: &'a str,
    tokens: &'a Tokens,
    /// In the file.
    row: u64,
    /// Among the decoded rows.
    index: usize,
}

impl Cell<'_> {
    fn number(&self, numbers: &Numbers) -> Result<f64, DataError> {
        match numbers {
            Numbers::Values(values) => {
                let value = values[self.index];
                self.tokens
                    .finite(value)
                    .map_err(|fault| self.column.fault(fault, self.file, self.row, value.to_string().as_bytes()))
            }
            Numbers::Texts(strings) => {
                let text = strings.get(self.index).unwrap_or_default().as_bytes();
                self.tokens.number(text).map_err(|fault| self.column.fault(fault, self.file, self.row, text))
            }
        }
    }

    fn time(&self, times: &Times) -> Result<Moment, DataError> {
        let moment = match times {
            Times::Moments(moments) => moments[self.index],
            Times::Numbers(Numbers::Texts(strings)) => {
                let text = strings.get(self.index).unwrap_or_default();
                return self.column.moment(self.tokens, self.file, self.row, text.as_bytes());
            }
            Times::Numbers(numbers) => Some(self.number(numbers)?).filter(|t| !t.is_nan()).map(Moment::Number),
        };
        moment.ok_or_else(|| DataError::MissingTime { at: self.column.place(self.file, self.row) })
    }
}
