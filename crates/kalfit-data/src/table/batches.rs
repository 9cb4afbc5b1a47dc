//! Record batches of Parquet and Arrow IPC, row by row.

use arrow::array::RecordBatch;
use arrow::datatypes::Schema;
use arrow::error::ArrowError;
use kalfit::{Label, Labels};

use super::LastLabel;
use super::arrays::{Numbers, Texts, Times, misfit};
use super::guard::guarded;
use crate::cell::Tokens;
use crate::error::DataError;
use crate::moment::Moment;
use crate::row::Row;
use crate::wanted::{Wanted, WantedColumn};

/// Rows decoded at a time.
pub(super) const ROWS: usize = 8192;

/// Gives the next batch; None at the end.
type NextBatch<'a> = Box<dyn FnMut() -> Result<Option<RecordBatch>, DataError> + 'a>;

/// A table of record batches, row by row.
pub(crate) struct BatchTable<'a> {
    file: &'a str,
    format: &'static str,
    wanted: &'a Wanted,
    next_batch: NextBatch<'a>,
    /// Position of each wanted column in a batch.
    positions: Vec<usize>,
    /// What is left of the batch, after the rows decoded.
    rest: Option<RecordBatch>,
    decoded: Vec<Decoded>,
    /// Rows decoded, and how many of them are done.
    rows: usize,
    done: usize,
    /// Rows before the decoded ones.
    before: u64,
    /// All rows of the table, if that is known.
    all: Option<u64>,
    last: Vec<LastLabel>,
    scratch: String,
}

/// A wanted column, as far as it is used.
struct Decoded {
    numbers: Option<Numbers>,
    times: Option<Times>,
    texts: Option<Texts>,
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
        let names: Vec<&str> = schema.fields().iter().map(|field| field.name().as_str()).collect();
        let positions = wanted.positions(file, &names)?;
        for (column, &position) in wanted.columns.iter().zip(&positions) {
            let data_type = schema.field(position).data_type();
            if let Some(expected) = misfit(data_type, column.is_number(), column.is_time, column.is_text()) {
                return Err(DataError::ColumnType {
                    file: file.to_owned(),
                    column: column.name.clone(),
                    used_in: column.used_in.clone(),
                    found: data_type.to_string().into(),
                    expected,
                });
            }
        }
        let last = wanted.columns.iter().map(|_| LastLabel::default()).collect();
        let (rest, decoded, scratch) = (None, Vec::new(), String::new());
        let (rows, done, before, all) = (0, 0, 0, None);
        Ok(BatchTable {
            file,
            format,
            wanted,
            next_batch,
            positions,
            rest,
            decoded,
            rows,
            done,
            before,
            all,
            last,
            scratch,
        })
    }

    /// The table, known to have so many rows.
    pub(super) fn of_rows(self, rows: u64) -> BatchTable<'a> {
        BatchTable { all: Some(rows), ..self }
    }

    /// The part of its rows that was read, from 0 to 1; 0 when their number is not known.
    pub(crate) fn share(&self) -> f64 {
        let read = self.before + self.done as u64;
        self.all.map_or(0.0, |all| read as f64 / all.max(1) as f64).min(1.0)
    }

    /// Reads the next row; false at the end.
    pub(super) fn next(&mut self, row: &mut Row, labels: &mut Labels) -> Result<bool, DataError> {
        while self.done == self.rows {
            if !self.decode()? {
                return Ok(false);
            }
        }
        let index = self.done;
        self.done += 1;
        row.number = self.before + self.done as u64;
        let (file, tokens) = (self.file, &self.wanted.tokens);
        for ((column, decoded), last) in self.wanted.columns.iter().zip(&self.decoded).zip(&mut self.last) {
            let at = Cell { column, file, tokens, row: row.number, index };
            if let Some(numbers) = &decoded.numbers {
                let value = at.number(numbers)?;
                column.numbers.iter().for_each(|&number| row.numbers[number] = value);
            }
            if let Some(times) = &decoded.times {
                row.time = Some(at.time(times)?);
            }
            if let Some(texts) = &decoded.texts {
                let text = texts.get(index, &mut self.scratch).filter(|text| !tokens.is_missing(text.as_bytes()));
                if column.is_test {
                    let id = text.ok_or_else(|| DataError::MissingTest { at: column.place(file, at.row) })?;
                    row.set_id(id);
                }
                if !column.texts.is_empty() {
                    let label = text.map_or(Label::MISSING, |text| last.label(text, labels));
                    column.texts.iter().for_each(|&index| row.texts[index] = label);
                }
            }
        }
        Ok(true)
    }

    /// Decodes the next rows; false at the end.
    fn decode(&mut self) -> Result<bool, DataError> {
        let batch = match self.rest.take() {
            Some(rest) => rest,
            None => match (self.next_batch)()? {
                Some(batch) => batch,
                None => return Ok(false),
            },
        };
        let now = batch.num_rows().min(ROWS);
        if now < batch.num_rows() {
            self.rest = Some(batch.slice(now, batch.num_rows() - now));
        }
        let batch = batch.slice(0, now);
        self.before += self.rows as u64;
        (self.rows, self.done) = (now, 0);
        self.decoded = guarded(self.file, self.format, || {
            let columns = self.wanted.columns.iter().zip(&self.positions);
            let decoded = columns.map(|(column, &position)| Decoded::new(column, batch.column(position)));
            decoded
                .collect::<Result<_, _>>()
                .map_err(|source| DataError::Arrow { file: self.file.to_owned(), source: Box::new(source) })
        })?;
        Ok(true)
    }
}

impl Decoded {
    fn new(column: &WantedColumn, array: &dyn arrow::array::Array) -> Result<Decoded, ArrowError> {
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
