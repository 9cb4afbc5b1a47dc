//! Exchange files out. Numbers are written as they are, so that what is read back has the same bits.

use std::io::Write;
use std::sync::Arc;

use arrow::array::{ArrayRef, Float64Builder, Int64Builder, ListBuilder, RecordBatch, StringBuilder};
use arrow::datatypes::{DataType, Field, Schema};
use kalfit::reduce::{Estimates, Path, PhaseReduction};
use kalfit::{Labels, PhasedModel};
use nalgebra::DMatrix;
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::properties::WriterProperties;

use super::constants::{name_in_file, numeric, textual};
use super::metadata::Metadata;
use super::reductions::{INFORMATION, SQUARE_ROOT};
use super::schema::{ESTIMATES_SCHEMA, GROUPS, REDUCTIONS_SCHEMA};
use crate::write::WriteError;

/// Numbers of a row group, which the writer holds in memory.
const GROUP_NUMBERS: usize = 1_000_000;
/// Rows of a row group.
const GROUP_ROWS: usize = 16_384;

/// A cell to be written.
enum Cell<'a> {
    Text(Option<&'a str>),
    Number(Option<f64>),
    Count(usize),
    Numbers(Option<Vec<f64>>),
    Words(Option<&'a [String]>),
}

/// What a column is built in.
enum Column {
    Text(StringBuilder),
    Number(Float64Builder),
    Count(Int64Builder),
    Numbers(ListBuilder<Float64Builder>),
    Words(ListBuilder<StringBuilder>),
}

/// A table of such columns.
struct Table<W: Write + Send> {
    writer: ArrowWriter<W>,
    schema: Arc<Schema>,
    columns: Vec<Column>,
    rows: usize,
    numbers: usize,
}

impl Column {
    fn of(kind: Kind) -> Column {
        match kind {
            Kind::Text => Column::Text(StringBuilder::new()),
            Kind::Number => Column::Number(Float64Builder::new()),
            Kind::Count => Column::Count(Int64Builder::new()),
            Kind::Numbers => Column::Numbers(ListBuilder::new(Float64Builder::new())),
            Kind::Words => Column::Words(ListBuilder::new(StringBuilder::new())),
        }
    }

    /// Appends a cell; how many numbers it has.
    fn push(&mut self, cell: Cell<'_>) -> usize {
        match (self, cell) {
            (Column::Text(column), Cell::Text(text)) => column.append_option(text),
            (Column::Number(column), Cell::Number(number)) => column.append_option(number),
            (Column::Count(column), Cell::Count(count)) => {
                column.append_value(i64::try_from(count).expect("no test has 2^63 rows"));
            }
            (Column::Numbers(column), Cell::Numbers(numbers)) => {
                let length = numbers.as_ref().map_or(0, Vec::len);
                column.append_option(numbers.map(|numbers| numbers.into_iter().map(Some)));
                return length;
            }
            (Column::Words(column), Cell::Words(words)) => {
                column.append_option(words.map(|words| words.iter().map(Some)));
            }
            _ => unreachable!("a row has the cells of its columns"),
        }
        1
    }

    fn finish(&mut self) -> ArrayRef {
        match self {
            Column::Text(column) => Arc::new(column.finish()),
            Column::Number(column) => Arc::new(column.finish()),
            Column::Count(column) => Arc::new(column.finish()),
            Column::Numbers(column) => Arc::new(column.finish()),
            Column::Words(column) => Arc::new(column.finish()),
        }
    }
}

#[derive(Debug, Clone, Copy)]
enum Kind {
    Text,
    Number,
    Count,
    Numbers,
    Words,
}

impl Kind {
    fn data_type(self) -> DataType {
        let list = |element: DataType| DataType::List(Arc::new(Field::new_list_field(element, true)));
        match self {
            Kind::Text => DataType::Utf8,
            Kind::Number => DataType::Float64,
            Kind::Count => DataType::Int64,
            Kind::Numbers => list(DataType::Float64),
            Kind::Words => list(DataType::Utf8),
        }
    }
}

impl<W: Write + Send> Table<W> {
    fn new(columns: &[(String, Kind)], metadata: &Metadata, schema: &str, sink: W) -> Result<Table<W>, WriteError> {
        let fields = columns.iter().map(|(name, kind)| Field::new(name, kind.data_type(), true));
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_key_value_metadata(Some(metadata.pairs(schema)))
            .build();
        let schema = Arc::new(Schema::new(fields.collect::<Vec<_>>()));
        let writer = ArrowWriter::try_new(sink, schema.clone(), Some(properties))?;
        let columns = columns.iter().map(|(_, kind)| Column::of(*kind)).collect();
        Ok(Table { writer, schema, columns, rows: 0, numbers: 0 })
    }

    fn push(&mut self, cells: Vec<Cell<'_>>) -> Result<(), WriteError> {
        assert_eq!(cells.len(), self.columns.len(), "cells of a row");
        self.numbers += self.columns.iter_mut().zip(cells).map(|(column, cell)| column.push(cell)).sum::<usize>();
        self.rows += 1;
        if self.numbers >= GROUP_NUMBERS || self.rows >= GROUP_ROWS { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<(), WriteError> {
        let arrays = self.columns.iter_mut().map(Column::finish).collect();
        self.writer.write(&RecordBatch::try_new(self.schema.clone(), arrays)?)?;
        self.writer.flush()?;
        (self.rows, self.numbers) = (0, 0);
        Ok(())
    }

    fn finish(mut self) -> Result<W, WriteError> {
        if self.rows > 0 {
            self.flush()?;
        }
        Ok(self.writer.into_inner()?)
    }
}

fn rows_of(a: &DMatrix<f64>) -> Vec<f64> {
    a.transpose().as_slice().to_vec()
}

/// Writes reductions, `kalfit-reductions/1`.
pub struct ReductionWriter<W: Write + Send> {
    table: Table<W>,
    phases: Vec<Names>,
}

/// Names in a phase.
struct Names {
    phase: String,
    entering: Vec<String>,
    states: Vec<String>,
}

fn names(model: &PhasedModel) -> Vec<Names> {
    let of = |phase: &kalfit::model::Phase| {
        let name = |state: usize| phase.model.states[state].name.clone();
        Names {
            phase: phase.name.clone(),
            entering: phase.entering().into_iter().map(name).collect(),
            states: (0..phase.model.states.len()).map(name).collect(),
        }
    };
    model.phases.iter().map(of).collect()
}

impl<W: Write + Send> ReductionWriter<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// A sink that cannot be written to.
    pub fn new(model: &PhasedModel, metadata: &Metadata, sink: W) -> Result<ReductionWriter<W>, WriteError> {
        use Kind::{Count, Number, Numbers, Text, Words};
        let columns = [
            ("test", Text),
            ("phase", Text),
            ("states", Words),
            ("constant", Number),
            ("data", Numbers),
            ("factor", Numbers),
            ("covariates", Numbers),
            ("path", Text),
            ("design", Text),
            ("steps", Count),
            ("observations", Count),
            ("terminal_states", Words),
            ("terminal_mean", Numbers),
            ("terminal_sensitivity", Numbers),
            ("terminal_root", Numbers),
            ("inherited_transition", Numbers),
            ("inherited_input", Numbers),
            (GROUPS, Words),
        ];
        let columns = columns.map(|(name, kind)| (name.to_owned(), kind));
        Ok(ReductionWriter { table: Table::new(&columns, metadata, REDUCTIONS_SCHEMA, sink)?, phases: names(model) })
    }

    /// Appends one phase of a test. `groups` has the names of the groups that the test stands in, the outermost first.
    ///
    /// # Errors
    /// A sink that cannot be written to.
    pub fn write(
        &mut self,
        test: &str,
        phase: usize,
        piece: &PhaseReduction,
        groups: &[String],
    ) -> Result<(), WriteError> {
        let names = &self.phases[phase];
        let reduction = &piece.reduction;
        let design = format!("{:032x}", reduction.design);
        let (terminal, inherited) = (piece.terminal.as_ref(), piece.inherited.as_ref());
        self.table.push(vec![
            Cell::Text(Some(test)),
            Cell::Text(Some(&names.phase)),
            Cell::Words(Some(&names.entering)),
            Cell::Number(Some(reduction.constant)),
            Cell::Numbers(Some(reduction.data.clone())),
            Cell::Numbers(Some(reduction.factor.clone())),
            Cell::Numbers(Some(reduction.covariates.clone())),
            Cell::Text(Some(match reduction.path {
                Path::Information => INFORMATION,
                Path::SquareRoot => SQUARE_ROOT,
            })),
            Cell::Text(Some(&design)),
            Cell::Count(reduction.steps),
            Cell::Count(reduction.observations),
            Cell::Words(terminal.map(|_| names.states.as_slice())),
            Cell::Numbers(terminal.map(|t| t.mean.as_slice().to_vec())),
            Cell::Numbers(terminal.map(|t| rows_of(&t.sensitivity))),
            Cell::Numbers(terminal.map(|t| rows_of(&t.root))),
            Cell::Numbers(inherited.map(|i| rows_of(&i.transition))),
            Cell::Numbers(inherited.map(|i| i.input.as_slice().to_vec())),
            Cell::Words((!groups.is_empty()).then_some(groups)),
        ])
    }

    /// Ends the file; the sink may still have to be flushed.
    ///
    /// # Errors
    /// A sink that cannot be written to.
    pub fn finish(self) -> Result<W, WriteError> {
        self.table.finish()
    }
}

/// Writes estimates, `kalfit-estimates/1`, with the constants of their tests.
pub struct EstimatesWriter<W: Write + Send> {
    table: Table<W>,
    phases: Vec<Names>,
    /// Columns of the model that are written: numeric ones, then texts.
    numbers: Vec<usize>,
    texts: Vec<usize>,
}

impl<W: Write + Send> EstimatesWriter<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// A model with levels of groups, a sink that cannot be written to.
    pub fn new(model: &PhasedModel, metadata: &Metadata, sink: W) -> Result<EstimatesWriter<W>, WriteError> {
        use Kind::{Count, Number, Numbers, Text, Words};
        if !model.levels.is_empty() {
            return Err(WriteError::Levels);
        }
        let columns = [
            ("test", Text),
            ("phase", Text),
            ("states", Words),
            ("estimates", Numbers),
            ("offsets", Numbers),
            ("sensitivities", Numbers),
            ("covariance_root", Numbers),
            ("transition", Numbers),
            ("drift", Numbers),
            ("steps", Count),
            ("observations", Count),
        ];
        let mut columns: Vec<(String, Kind)> = columns.map(|(name, kind)| (name.to_owned(), kind)).into();
        let (mut numbers, mut texts) = (Vec::new(), Vec::new());
        for (index, name) in textual(model) {
            texts.push(index);
            columns.push((name_in_file(name), Text));
        }
        // A column that is read both ways is written as the text, which says both.
        for (index, name) in numeric(model) {
            let name = name_in_file(name);
            if columns.iter().all(|(other, _)| *other != name) {
                numbers.push(index);
                columns.push((name, Number));
            }
        }
        let table = Table::new(&columns, metadata, ESTIMATES_SCHEMA, sink)?;
        Ok(EstimatesWriter { table, phases: names(model), numbers, texts })
    }

    /// Appends one phase of a test. `labels` has the texts of its constants.
    ///
    /// # Errors
    /// A sink that cannot be written to.
    pub fn write(
        &mut self,
        test: &str,
        phase: usize,
        estimates: &Estimates,
        labels: &Labels,
    ) -> Result<(), WriteError> {
        let names = &self.phases[phase];
        let mut cells = vec![
            Cell::Text(Some(test)),
            Cell::Text(Some(&names.phase)),
            Cell::Words(Some(&names.states)),
            Cell::Numbers(Some(estimates.estimates.as_slice().to_vec())),
            Cell::Numbers(Some(estimates.offsets.as_slice().to_vec())),
            Cell::Numbers(Some(rows_of(&estimates.sensitivities))),
            Cell::Numbers(Some(rows_of(&estimates.root))),
            Cell::Numbers(Some(rows_of(&estimates.transition))),
            Cell::Numbers(Some(estimates.drift.as_slice().to_vec())),
            Cell::Count(estimates.steps),
            Cell::Count(estimates.observations),
        ];
        let constants = &estimates.constants;
        let known = constants.rows() > 0;
        cells.extend(self.texts.iter().map(|&index| {
            let label = if known { constants.texts(0)[index] } else { kalfit::Label::MISSING };
            Cell::Text((!label.is_missing()).then(|| labels.text(label)))
        }));
        cells.extend(self.numbers.iter().map(|&index| {
            let value = if known { constants.numbers(0)[index] } else { f64::NAN };
            Cell::Number((!value.is_nan()).then_some(value))
        }));
        self.table.push(cells)
    }

    /// Ends the file; the sink may still have to be flushed.
    ///
    /// # Errors
    /// A sink that cannot be written to.
    pub fn finish(self) -> Result<W, WriteError> {
        self.table.finish()
    }
}
