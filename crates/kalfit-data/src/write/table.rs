//! Tables of results: CSV, Parquet and Arrow IPC.

use std::io::Write;
use std::sync::Arc;

use arrow_array::ArrayRef;
use arrow_array::builder::{Float64Builder, Int64Builder, StringBuilder};
use arrow_schema::{DataType, Field, Schema};

use super::batches::{BatchWriter, ROWS};
use super::csv::{failed, header, number};
use super::error::WriteError;
use super::format::TableFormat;

/// What the cells of a column are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CellKind {
    /// Texts.
    Text,
    /// Numbers.
    Number,
    /// Whole numbers from zero on.
    Count,
}

/// A cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TableCell<'a> {
    /// Of a column of texts.
    Text(&'a str),
    /// Of a column of numbers; one that is not a number is missing.
    Number(f64),
    /// Of a column of counts.
    Count(usize),
    /// Nothing, in any column.
    Missing,
}

/// Writes a table row by row.
pub struct TableWriter<W: Write + Send> {
    rows: TableRows<W>,
}

enum TableRows<W: Write + Send> {
    Text(Box<csv::Writer<W>>),
    Batches { batches: BatchWriter<W>, columns: Vec<TableColumnBuilder>, rows: usize },
}

enum TableColumnBuilder {
    Texts(StringBuilder),
    Numbers(Float64Builder),
    Counts(Int64Builder),
}

impl TableColumnBuilder {
    fn of(kind: CellKind) -> TableColumnBuilder {
        match kind {
            CellKind::Text => TableColumnBuilder::Texts(StringBuilder::new()),
            CellKind::Number => TableColumnBuilder::Numbers(Float64Builder::new()),
            CellKind::Count => TableColumnBuilder::Counts(Int64Builder::new()),
        }
    }

    fn push(&mut self, cell: TableCell<'_>) {
        match (self, cell) {
            (TableColumnBuilder::Texts(texts), TableCell::Text(text)) => texts.append_value(text),
            (TableColumnBuilder::Texts(texts), _) => texts.append_null(),
            (TableColumnBuilder::Numbers(numbers), TableCell::Number(x)) if !x.is_nan() => numbers.append_value(x),
            (TableColumnBuilder::Numbers(numbers), _) => numbers.append_null(),
            (TableColumnBuilder::Counts(counts), TableCell::Count(n)) => counts.append_option(i64::try_from(n).ok()),
            (TableColumnBuilder::Counts(counts), _) => counts.append_null(),
        }
    }

    fn finish(&mut self) -> ArrayRef {
        match self {
            TableColumnBuilder::Texts(texts) => Arc::new(texts.finish()),
            TableColumnBuilder::Numbers(numbers) => Arc::new(numbers.finish()),
            TableColumnBuilder::Counts(counts) => Arc::new(counts.finish()),
        }
    }
}

impl<W: Write + Send> TableWriter<W> {
    /// Begins a table with these columns.
    ///
    /// # Errors
    /// A sink that cannot be written to.
    pub fn new(columns: &[(String, CellKind)], format: TableFormat, sink: W) -> Result<TableWriter<W>, WriteError> {
        let rows = match format {
            TableFormat::Csv => text(columns, b',', sink)?,
            TableFormat::Tsv => text(columns, b'\t', sink)?,
            TableFormat::Parquet => batches(columns, BatchWriter::parquet(sink, schema(columns))?),
            TableFormat::Arrow => batches(columns, BatchWriter::arrow(sink, schema(columns))?),
        };
        Ok(TableWriter { rows })
    }

    /// Appends a row: a cell for each column. A cell of another kind than its column's is missing.
    ///
    /// # Errors
    /// A sink that cannot be written to.
    pub fn write<'a>(&mut self, cells: impl IntoIterator<Item = TableCell<'a>>) -> Result<(), WriteError> {
        match &mut self.rows {
            TableRows::Text(writer) => {
                for cell in cells {
                    let field = match cell {
                        TableCell::Text(text) => writer.write_field(text),
                        TableCell::Number(x) => writer.write_field(number(x)),
                        TableCell::Count(n) => writer.write_field(n.to_string()),
                        TableCell::Missing => writer.write_field(""),
                    };
                    field.map_err(failed)?;
                }
                writer.write_record(None::<&[u8]>).map_err(failed)
            }
            TableRows::Batches { batches, columns, rows } => {
                columns.iter_mut().zip(cells).for_each(|(column, cell)| column.push(cell));
                *rows += 1;
                if *rows < ROWS {
                    return Ok(());
                }
                *rows = 0;
                batches.write(columns.iter_mut().map(TableColumnBuilder::finish).collect())
            }
        }
    }

    /// Ends the table; the sink may still have to be flushed.
    ///
    /// # Errors
    /// A sink that cannot be written to.
    pub fn finish(self) -> Result<W, WriteError> {
        match self.rows {
            TableRows::Text(writer) => writer.into_inner().map_err(|error| WriteError::Io(error.into_error())),
            TableRows::Batches { mut batches, mut columns, rows } => {
                if rows > 0 {
                    batches.write(columns.iter_mut().map(TableColumnBuilder::finish).collect())?;
                }
                batches.finish()
            }
        }
    }
}

fn text<W: Write + Send>(
    columns: &[(String, CellKind)],
    delimiter: u8,
    mut sink: W,
) -> Result<TableRows<W>, WriteError> {
    header(&mut sink, delimiter, columns.iter().map(|(name, _)| name.as_str()))?;
    Ok(TableRows::Text(Box::new(csv::WriterBuilder::new().delimiter(delimiter).from_writer(sink))))
}

fn batches<W: Write + Send>(columns: &[(String, CellKind)], batches: BatchWriter<W>) -> TableRows<W> {
    TableRows::Batches {
        batches,
        columns: columns.iter().map(|(_, kind)| TableColumnBuilder::of(*kind)).collect(),
        rows: 0,
    }
}

fn schema(columns: &[(String, CellKind)]) -> Arc<Schema> {
    let field = |(name, kind): &(String, CellKind)| {
        let kind = match kind {
            CellKind::Text => DataType::Utf8,
            CellKind::Number => DataType::Float64,
            CellKind::Count => DataType::Int64,
        };
        Field::new(name, kind, true)
    };
    Arc::new(Schema::new(columns.iter().map(field).collect::<Vec<_>>()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_of_text_has_a_header_and_empty_cells_where_nothing_is_known() {
        let columns = [("test", CellKind::Text), ("row", CellKind::Count), ("a, b", CellKind::Number)];
        let columns = columns.map(|(name, kind)| (name.to_owned(), kind));
        let mut table = TableWriter::new(&columns, TableFormat::Csv, Vec::new()).expect("a table");
        table.write([TableCell::Text("x,1"), TableCell::Count(3), TableCell::Number(0.1)]).expect("a row");
        table.write([TableCell::Text("y"), TableCell::Missing, TableCell::Number(f64::NAN)]).expect("a row");
        let text = String::from_utf8(table.finish().expect("an end")).expect("text");
        assert_eq!(text, "test,row,\"a, b\"\n\"x,1\",3,0.1\ny,,\n");
    }
}
