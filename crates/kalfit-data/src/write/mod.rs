//! Tests out: CSV, Parquet and Arrow IPC, as [`read`](crate::read) takes them in.

mod batches;
mod columns;
mod csv;
mod error;
mod format;
mod table;

use std::io::Write;

use kalfit::{Labels, Layout, Model, Test};

use self::batches::BatchTestWriter;
use self::columns::{OutColumn, columns, id_column, refuse_id_in_use};
use self::csv::CsvTestWriter;
pub use self::error::WriteError;
pub use self::format::TableFormat;
pub use self::table::{CellKind, TableCell, TableWriter};

/// Which tests will be written, where that decides what the table needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WrittenIds {
    /// Those of the data that the tests were read from: one test if the layout has but one.
    Same,
    /// New ones.
    New,
}

/// Writes tests to one table, with the columns that a model and its layout name. Times are written as the numbers that the core
/// sees: date-times become the time since the test's first row, in the model's time unit.
pub struct TestWriter<W: Write + Send> {
    columns: Vec<OutColumn>,
    table: TestTable<W>,
}

/// Name of the column of ids that a [`TestWriter`] adds because the model's layout names none.
pub fn added_id_column(model: &Model, layout: &Layout, ids: WrittenIds) -> Option<String> {
    match layout.test {
        kalfit::TestKey::Column(_) => None,
        _ => id_column(model, layout, ids == WrittenIds::New),
    }
}

enum TestTable<W: Write + Send> {
    Csv(Box<CsvTestWriter<W>>),
    Batches(BatchTestWriter<W>),
}

impl<W: Write + Send> TestWriter<W> {
    /// Begins a table.
    ///
    /// # Errors
    /// New ids where the model reads the column of ids otherwise too; a sink that cannot be written to.
    pub fn new(
        model: &Model,
        layout: &Layout,
        ids: WrittenIds,
        format: TableFormat,
        sink: W,
    ) -> Result<TestWriter<W>, WriteError> {
        if ids == WrittenIds::New {
            refuse_id_in_use(model, layout)?;
        }
        let columns = columns(model, layout, ids == WrittenIds::New);
        let table = match format {
            TableFormat::Csv => TestTable::Csv(Box::new(CsvTestWriter::new(sink, b',', &columns)?)),
            TableFormat::Tsv => TestTable::Csv(Box::new(CsvTestWriter::new(sink, b'\t', &columns)?)),
            TableFormat::Parquet => TestTable::Batches(BatchTestWriter::parquet(sink, &columns)?),
            TableFormat::Arrow => TestTable::Batches(BatchTestWriter::arrow(sink, &columns)?),
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
                TestTable::Csv(table) => table.write(&self.columns, test, labels)?,
                TestTable::Batches(table) => table.write(&self.columns, test, labels)?,
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
            TestTable::Csv(table) => table.finish(),
            TestTable::Batches(table) => table.finish(),
        }
    }
}
