//! Tests out: CSV, Parquet and Arrow IPC, as [`read`](crate::read) takes them in.

mod batches;
mod columns;
mod csv;
mod error;
mod format;
mod table;

use std::io::Write;

use kalfit::{Labels, Layout, Model, Test};

use self::batches::BatchTests;
use self::columns::{OutColumn, columns, id_column, refuse_id_in_use};
use self::csv::CsvTests;
pub use self::csv::StateWriter;
pub use self::error::WriteError;
pub use self::format::Format;
pub use self::table::{Cell, CellKind, TableWriter};

/// Which tests will be written, where that decides what the table needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ids {
    /// Those of the data that the tests were read from: one test if the layout has but one.
    Same,
    /// New ones.
    New,
}

/// Writes tests to one table, with the columns that a model and its layout name. Times are written as the numbers that the core
/// sees: date-times become the time since the test's first row, in the model's time unit.
pub struct TestWriter<W: Write + Send> {
    columns: Vec<OutColumn>,
    table: Table<W>,
}

/// Name of the column of ids that a [`TestWriter`] adds because the model's layout names none.
pub fn added_id_column(model: &Model, layout: &Layout, ids: Ids) -> Option<String> {
    match layout.test {
        kalfit::TestKey::Column(_) => None,
        _ => id_column(model, layout, ids == Ids::New),
    }
}

enum Table<W: Write + Send> {
    Csv(Box<CsvTests<W>>),
    Batches(BatchTests<W>),
}

impl<W: Write + Send> TestWriter<W> {
    /// Begins a table.
    ///
    /// # Errors
    /// New ids where the model reads the column of ids otherwise too; a sink that cannot be written to.
    pub fn new(model: &Model, layout: &Layout, ids: Ids, format: Format, sink: W) -> Result<TestWriter<W>, WriteError> {
        if ids == Ids::New {
            refuse_id_in_use(model, layout)?;
        }
        let columns = columns(model, layout, ids == Ids::New);
        let table = match format {
            Format::Csv => Table::Csv(Box::new(CsvTests::new(sink, b',', &columns)?)),
            Format::Tsv => Table::Csv(Box::new(CsvTests::new(sink, b'\t', &columns)?)),
            Format::Parquet => Table::Batches(BatchTests::parquet(sink, &columns)?),
            Format::Arrow => Table::Batches(BatchTests::arrow(sink, &columns)?),
        };
        Ok(TestWriter { columns, table })
    }

    /// Appends the rows of tests. `labels` has every text in them.
    ///
    /// # Errors
    /// A sink that cannot be written to.
    pub fn write<'a>(&mut self, tests: impl IntoIterator<Item = &'a Test>, labels: &Labels) -> Result<(), WriteError> {
        for test in tests {
            match &mut self.table {
                Table::Csv(table) => table.write(&self.columns, test, labels)?,
                Table::Batches(table) => table.write(&self.columns, test, labels)?,
            }
        }
        Ok(())
    }

    /// Ends the table; the sink may still have to be flushed.
    ///
    /// # Errors
    /// A sink that cannot be written to.
    pub fn finish(self) -> Result<W, WriteError> {
        match self.table {
            Table::Csv(table) => table.finish(),
            Table::Batches(table) => table.finish(),
        }
    }
}
