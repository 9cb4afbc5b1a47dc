//! Tests as record batches: Parquet and Arrow IPC.

use std::io::Write;
use std::sync::Arc;

use arrow::array::{ArrayRef, Float64Builder, RecordBatch, StringBuilder};
use arrow::datatypes::{DataType, Field, Schema};
use arrow::ipc::writer::FileWriter;
use kalfit::{Labels, Test};
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::properties::WriterProperties;

use super::columns::{From, OutColumn, text};
use super::error::WriteError;

/// Rows of a batch.
const ROWS: usize = 65_536;
/// Rows of a row group, which Parquet holds in memory.
const GROUP_ROWS: usize = 1_048_576;

/// Where batches go.
pub(super) enum BatchSink<W: Write + Send> {
    Parquet(Box<ArrowWriter<W>>),
    Arrow(Box<FileWriter<W>>),
}

/// Writes columns of 64-bit floats and of texts; missing cells are null.
pub(super) struct BatchTests<W: Write + Send> {
    sink: BatchSink<W>,
    schema: Arc<Schema>,
    cells: Vec<Cells>,
    rows: usize,
}

enum Cells {
    Numbers(Float64Builder),
    Texts(StringBuilder),
}

impl<W: Write + Send> BatchTests<W> {
    pub(super) fn parquet(sink: W, columns: &[OutColumn]) -> Result<BatchTests<W>, WriteError> {
        let schema = schema(columns);
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_max_row_group_row_count(Some(GROUP_ROWS))
            .build();
        let writer = ArrowWriter::try_new(sink, schema.clone(), Some(properties))?;
        Ok(BatchTests::new(BatchSink::Parquet(Box::new(writer)), schema, columns))
    }

    pub(super) fn arrow(sink: W, columns: &[OutColumn]) -> Result<BatchTests<W>, WriteError> {
        let schema = schema(columns);
        let writer = FileWriter::try_new(sink, &schema)?;
        Ok(BatchTests::new(BatchSink::Arrow(Box::new(writer)), schema, columns))
    }

    fn new(sink: BatchSink<W>, schema: Arc<Schema>, columns: &[OutColumn]) -> BatchTests<W> {
        let cells = |column: &OutColumn| match &column.from {
            From::Number(_) => Cells::Numbers(Float64Builder::new()),
            From::Id(_) | From::Text(_) => Cells::Texts(StringBuilder::new()),
        };
        BatchTests { sink, schema, cells: columns.iter().map(cells).collect(), rows: 0 }
    }

    pub(super) fn write(&mut self, columns: &[OutColumn], test: &Test, labels: &Labels) -> Result<(), WriteError> {
        for row in 0..test.rows() {
            for (column, cells) in columns.iter().zip(&mut self.cells) {
                match (&column.from, cells) {
                    (From::Number(index), Cells::Numbers(numbers)) => {
                        numbers.append_option(Some(test.numbers(row)[*index]).filter(|value| !value.is_nan()));
                    }
                    (from, Cells::Texts(texts)) => texts.append_option(text(from, test, row, labels)),
                    (_, Cells::Numbers(_)) => unreachable!("numbers come from numeric cells"),
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
        let finished = |cells: &mut Cells| -> ArrayRef {
            match cells {
                Cells::Numbers(numbers) => Arc::new(numbers.finish()),
                Cells::Texts(texts) => Arc::new(texts.finish()),
            }
        };
        let batch = RecordBatch::try_new(self.schema.clone(), self.cells.iter_mut().map(finished).collect())?;
        self.rows = 0;
        match &mut self.sink {
            BatchSink::Parquet(writer) => writer.write(&batch)?,
            BatchSink::Arrow(writer) => writer.write(&batch)?,
        }
        Ok(())
    }

    pub(super) fn finish(mut self) -> Result<W, WriteError> {
        if self.rows > 0 {
            self.flush()?;
        }
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

fn schema(columns: &[OutColumn]) -> Arc<Schema> {
    let field = |column: &OutColumn| {
        let kind = match &column.from {
            From::Number(_) => DataType::Float64,
            From::Id(_) | From::Text(_) => DataType::Utf8,
        };
        Field::new(&column.name, kind, true)
    };
    Arc::new(Schema::new(columns.iter().map(field).collect::<Vec<_>>()))
}
