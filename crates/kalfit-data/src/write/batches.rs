//! Tests as record batches: Parquet and Arrow IPC.

use std::io::Write;
use std::sync::Arc;

use arrow_array::builder::{Float64Builder, StringBuilder};
use arrow_array::{ArrayRef, RecordBatch};
use arrow_ipc::writer::FileWriter;
use arrow_schema::{DataType, Field, Schema};
use kalfit::{Labels, Test};
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::properties::WriterProperties;

use super::columns::{OutCellSource, OutColumn, text};
use super::error::WriteError;

/// Rows of a batch.
pub(super) const ROWS: usize = 65_536;
/// Rows of a row group, which Parquet holds in memory.
const GROUP_ROWS: usize = 1_048_576;

/// Where batches go.
enum BatchSink<W: Write + Send> {
    Parquet(Box<ArrowWriter<W>>),
    Arrow(Box<FileWriter<W>>),
}

/// Batches of one schema, written as they come.
pub(super) struct BatchWriter<W: Write + Send> {
    sink: BatchSink<W>,
    schema: Arc<Schema>,
}

impl<W: Write + Send> BatchWriter<W> {
    pub(super) fn parquet(sink: W, schema: Arc<Schema>) -> Result<BatchWriter<W>, WriteError> {
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_max_row_group_row_count(Some(GROUP_ROWS))
            .build();
        let writer = ArrowWriter::try_new(sink, schema.clone(), Some(properties))?;
        Ok(BatchWriter { sink: BatchSink::Parquet(Box::new(writer)), schema })
    }

    pub(super) fn arrow(sink: W, schema: Arc<Schema>) -> Result<BatchWriter<W>, WriteError> {
        let writer = FileWriter::try_new(sink, &schema)?;
        Ok(BatchWriter { sink: BatchSink::Arrow(Box::new(writer)), schema })
    }

    pub(super) fn write(&mut self, columns: Vec<ArrayRef>) -> Result<(), WriteError> {
        let batch = RecordBatch::try_new(self.schema.clone(), columns)?;
        match &mut self.sink {
            BatchSink::Parquet(writer) => writer.write(&batch)?,
            BatchSink::Arrow(writer) => writer.write(&batch)?,
        }
        Ok(())
    }

    pub(super) fn finish(self) -> Result<W, WriteError> {
        Ok(match self.sink {
            BatchSink::Parquet(writer) => writer.into_inner()?,
            BatchSink::Arrow(writer) => {
                let mut writer = *writer;
                writer.finish()?;
                writer.into_inner()?
            }
        })
    }
}

/// Writes columns of 64-bit floats and of texts; missing cells are null.
pub(super) struct BatchTestWriter<W: Write + Send> {
    batches: BatchWriter<W>,
    cells: Vec<TestColumnBuilder>,
    rows: usize,
}

enum TestColumnBuilder {
    Numbers(Float64Builder),
    Texts(StringBuilder),
}

impl<W: Write + Send> BatchTestWriter<W> {
    pub(super) fn parquet(sink: W, columns: &[OutColumn]) -> Result<BatchTestWriter<W>, WriteError> {
        Ok(BatchTestWriter::new(BatchWriter::parquet(sink, schema(columns))?, columns))
    }

    pub(super) fn arrow(sink: W, columns: &[OutColumn]) -> Result<BatchTestWriter<W>, WriteError> {
        Ok(BatchTestWriter::new(BatchWriter::arrow(sink, schema(columns))?, columns))
    }

    fn new(batches: BatchWriter<W>, columns: &[OutColumn]) -> BatchTestWriter<W> {
        let cells = |column: &OutColumn| match &column.from {
            OutCellSource::Number(_) => TestColumnBuilder::Numbers(Float64Builder::new()),
            OutCellSource::Id(_) | OutCellSource::Text(_) => TestColumnBuilder::Texts(StringBuilder::new()),
        };
        BatchTestWriter { batches, cells: columns.iter().map(cells).collect(), rows: 0 }
    }

    pub(super) fn write(&mut self, columns: &[OutColumn], test: &Test, labels: &Labels) -> Result<(), WriteError> {
        for row in 0..test.rows() {
            for (column, cells) in columns.iter().zip(&mut self.cells) {
                match (&column.from, cells) {
                    (OutCellSource::Number(index), TestColumnBuilder::Numbers(numbers)) => {
                        numbers.append_option(Some(test.numbers(row)[*index]).filter(|value| !value.is_nan()));
                    }
                    (from, TestColumnBuilder::Texts(texts)) => texts.append_option(text(from, test, row, labels)),
                    (_, TestColumnBuilder::Numbers(_)) => unreachable!("numbers come from numeric cells"),
                }
            }
            self.rows += 1;
            if self.rows == ROWS {
                self.flush()?;
            }
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), WriteError> {
        let finished = |cells: &mut TestColumnBuilder| -> ArrayRef {
            match cells {
                TestColumnBuilder::Numbers(numbers) => Arc::new(numbers.finish()),
                TestColumnBuilder::Texts(texts) => Arc::new(texts.finish()),
            }
        };
        self.rows = 0;
        self.batches.write(self.cells.iter_mut().map(finished).collect())
    }

    pub(super) fn finish(mut self) -> Result<W, WriteError> {
        if self.rows > 0 {
            self.flush()?;
        }
        self.batches.finish()
    }
}

fn schema(columns: &[OutColumn]) -> Arc<Schema> {
    let field = |column: &OutColumn| {
        let kind = match &column.from {
            OutCellSource::Number(_) => DataType::Float64,
            OutCellSource::Id(_) | OutCellSource::Text(_) => DataType::Utf8,
        };
        Field::new(&column.name, kind, true)
    };
    Arc::new(Schema::new(columns.iter().map(field).collect::<Vec<_>>()))
}
