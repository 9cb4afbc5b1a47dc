//! Exchange files out. Numbers are written as they are, so that what is read back has the same bits.

use std::io::Write;
use std::sync::Arc;

use arrow_array::builder::{Float64Builder, Int64Builder, ListBuilder, StringBuilder};
use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{DataType, Field, Schema};
use kalfit::reduce::{Estimates, Path, PhaseReduction};
use kalfit::{Labels, PhasedModel};
use nalgebra::DMatrix;
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::properties::WriterProperties;

use super::constants::{name_in_file, numeric, textual};
use super::metadata::ExchangeMetadata;
use super::reductions::{INFORMATION, SQUARE_ROOT};
use super::schema::{ESTIMATES_SCHEMA, GROUPS, REDUCTIONS_SCHEMA};
use crate::write::WriteError;

/// Numbers of a row group, which the writer holds in memory.
const GROUP_NUMBERS: usize = 1_000_000;
/// Rows of a row group.
const GROUP_ROWS: usize = 16_384;

/// A cell to be written.
enum ExchangeCell<'a> {
    Text(Option<&'a str>),
    Number(Option<f64>),
    Count(usize),
    Numbers(Option<Vec<f64>>),
    Words(Option<&'a [String]>),
}

/// What a column is built in.
enum ExchangeColumnBuilder {
    Text(StringBuilder),
    Number(Float64Builder),
    Count(Int64Builder),
    Numbers(ListBuilder<Float64Builder>),
    Words(ListBuilder<StringBuilder>),
}

/// A table of such columns.
struct ExchangeTable<W: Write + Send> {
    writer: ArrowWriter<W>,
    schema: Arc<Schema>,
    columns: Vec<ExchangeColumnBuilder>,
    rows: usize,
    numbers: usize,
}

impl ExchangeColumnBuilder {
    fn of(kind: ExchangeColumnKind) -> ExchangeColumnBuilder {
        match kind {
            ExchangeColumnKind::Text => ExchangeColumnBuilder::Text(StringBuilder::new()),
            ExchangeColumnKind::Number => ExchangeColumnBuilder::Number(Float64Builder::new()),
            ExchangeColumnKind::Count => ExchangeColumnBuilder::Count(Int64Builder::new()),
            ExchangeColumnKind::Numbers => ExchangeColumnBuilder::Numbers(ListBuilder::new(Float64Builder::new())),
            ExchangeColumnKind::Words => ExchangeColumnBuilder::Words(ListBuilder::new(StringBuilder::new())),
        }
    }

    /// Appends a cell; how many numbers it has.
    fn push(&mut self, cell: ExchangeCell<'_>) -> usize {
        match (self, cell) {
            (ExchangeColumnBuilder::Text(column), ExchangeCell::Text(text)) => column.append_option(text),
            (ExchangeColumnBuilder::Number(column), ExchangeCell::Number(number)) => column.append_option(number),
            (ExchangeColumnBuilder::Count(column), ExchangeCell::Count(count)) => {
                column.append_value(i64::try_from(count).expect("no test has 2^63 rows"));
            }
            (ExchangeColumnBuilder::Numbers(column), ExchangeCell::Numbers(numbers)) => {
                let length = numbers.as_ref().map_or(0, Vec::len);
                column.append_option(numbers.map(|numbers| numbers.into_iter().map(Some)));
                return length;
            }
            (ExchangeColumnBuilder::Words(column), ExchangeCell::Words(words)) => {
                column.append_option(words.map(|words| words.iter().map(Some)));
            }
            _ => unreachable!("a row has the cells of its columns"),
        }
        1
    }

    fn finish(&mut self) -> ArrayRef {
        match self {
            ExchangeColumnBuilder::Text(column) => Arc::new(column.finish()),
            ExchangeColumnBuilder::Number(column) => Arc::new(column.finish()),
            ExchangeColumnBuilder::Count(column) => Arc::new(column.finish()),
            ExchangeColumnBuilder::Numbers(column) => Arc::new(column.finish()),
            ExchangeColumnBuilder::Words(column) => Arc::new(column.finish()),
        }
    }
}

#[derive(Debug, Clone, Copy)]
enum ExchangeColumnKind {
    Text,
    Number,
    Count,
    Numbers,
    Words,
}

impl ExchangeColumnKind {
    fn data_type(self) -> DataType {
        let list = |element: DataType| DataType::List(Arc::new(Field::new_list_field(element, true)));
        match self {
            ExchangeColumnKind::Text => DataType::Utf8,
            ExchangeColumnKind::Number => DataType::Float64,
            ExchangeColumnKind::Count => DataType::Int64,
            ExchangeColumnKind::Numbers => list(DataType::Float64),
            ExchangeColumnKind::Words => list(DataType::Utf8),
        }
    }
}

impl<W: Write + Send> ExchangeTable<W> {
    fn new(
        columns: &[(String, ExchangeColumnKind)],
        metadata: &ExchangeMetadata,
        schema: &str,
        sink: W,
    ) -> Result<ExchangeTable<W>, WriteError> {
        let fields = columns.iter().map(|(name, kind)| Field::new(name, kind.data_type(), true));
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_key_value_metadata(Some(metadata.pairs(schema)))
            .build();
        let schema = Arc::new(Schema::new(fields.collect::<Vec<_>>()));
        let writer = ArrowWriter::try_new(sink, schema.clone(), Some(properties))?;
        let columns = columns.iter().map(|(_, kind)| ExchangeColumnBuilder::of(*kind)).collect();
        Ok(ExchangeTable { writer, schema, columns, rows: 0, numbers: 0 })
    }

    fn push(&mut self, cells: Vec<ExchangeCell<'_>>) -> Result<(), WriteError> {
        assert_eq!(cells.len(), self.columns.len(), "cells of a row");
        self.numbers += self.columns.iter_mut().zip(cells).map(|(column, cell)| column.push(cell)).sum::<usize>();
        self.rows += 1;
        if self.numbers >= GROUP_NUMBERS || self.rows >= GROUP_ROWS { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<(), WriteError> {
        let arrays = self.columns.iter_mut().map(ExchangeColumnBuilder::finish).collect();
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
    table: ExchangeTable<W>,
    phases: Vec<PhaseStateNames>,
}

/// Names in a phase.
struct PhaseStateNames {
    phase: String,
    entering: Vec<String>,
    states: Vec<String>,
}

fn names(model: &PhasedModel) -> Vec<PhaseStateNames> {
    let of = |phase: &kalfit::model::Phase| {
        let name = |state: usize| phase.model.states[state].name.clone();
        PhaseStateNames {
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
    pub fn new(model: &PhasedModel, metadata: &ExchangeMetadata, sink: W) -> Result<ReductionWriter<W>, WriteError> {
        use ExchangeColumnKind::{Count, Number, Numbers, Text, Words};
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
        Ok(ReductionWriter {
            table: ExchangeTable::new(&columns, metadata, REDUCTIONS_SCHEMA, sink)?,
            phases: names(model),
        })
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
        if reduction.exact.is_some() {
            return Err(WriteError::Exact { test: test.to_owned() });
        }
        let design = format!("{:032x}", reduction.design);
        let (terminal, inherited) = (piece.terminal.as_ref(), piece.inherited.as_ref());
        self.table.push(vec![
            ExchangeCell::Text(Some(test)),
            ExchangeCell::Text(Some(&names.phase)),
            ExchangeCell::Words(Some(&names.entering)),
            ExchangeCell::Number(Some(reduction.constant)),
            ExchangeCell::Numbers(Some(reduction.data.clone())),
            ExchangeCell::Numbers(Some(reduction.factor.clone())),
            ExchangeCell::Numbers(Some(reduction.covariates.clone())),
            ExchangeCell::Text(Some(match reduction.path {
                Path::Information => INFORMATION,
                Path::SquareRoot => SQUARE_ROOT,
            })),
            ExchangeCell::Text(Some(&design)),
            ExchangeCell::Count(reduction.steps),
            ExchangeCell::Count(reduction.observations),
            ExchangeCell::Words(terminal.map(|_| names.states.as_slice())),
            ExchangeCell::Numbers(terminal.map(|t| t.mean.as_slice().to_vec())),
            ExchangeCell::Numbers(terminal.map(|t| rows_of(&t.sensitivity))),
            ExchangeCell::Numbers(terminal.map(|t| rows_of(&t.root))),
            ExchangeCell::Numbers(inherited.map(|i| rows_of(&i.transition))),
            ExchangeCell::Numbers(inherited.map(|i| i.input.as_slice().to_vec())),
            ExchangeCell::Words((!groups.is_empty()).then_some(groups)),
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
    table: ExchangeTable<W>,
    phases: Vec<PhaseStateNames>,
    /// Columns of the model that are written: numeric ones, then texts.
    numbers: Vec<usize>,
    texts: Vec<usize>,
}

impl<W: Write + Send> EstimatesWriter<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// A model with levels of groups, a sink that cannot be written to.
    pub fn new(model: &PhasedModel, metadata: &ExchangeMetadata, sink: W) -> Result<EstimatesWriter<W>, WriteError> {
        use ExchangeColumnKind::{Count, Number, Numbers, Text, Words};
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
        let mut columns: Vec<(String, ExchangeColumnKind)> = columns.map(|(name, kind)| (name.to_owned(), kind)).into();
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
        let table = ExchangeTable::new(&columns, metadata, ESTIMATES_SCHEMA, sink)?;
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
            ExchangeCell::Text(Some(test)),
            ExchangeCell::Text(Some(&names.phase)),
            ExchangeCell::Words(Some(&names.states)),
            ExchangeCell::Numbers(Some(estimates.estimates.as_slice().to_vec())),
            ExchangeCell::Numbers(Some(estimates.offsets.as_slice().to_vec())),
            ExchangeCell::Numbers(Some(rows_of(&estimates.sensitivities))),
            ExchangeCell::Numbers(Some(rows_of(&estimates.root))),
            ExchangeCell::Numbers(Some(rows_of(&estimates.transition))),
            ExchangeCell::Numbers(Some(estimates.drift.as_slice().to_vec())),
            ExchangeCell::Count(estimates.steps),
            ExchangeCell::Count(estimates.observations),
        ];
        let constants = &estimates.constants;
        let known = constants.rows() > 0;
        cells.extend(self.texts.iter().map(|&index| {
            let label = if known { constants.texts(0)[index] } else { kalfit::Label::MISSING };
            ExchangeCell::Text((!label.is_missing()).then(|| labels.text(label)))
        }));
        cells.extend(self.numbers.iter().map(|&index| {
            let value = if known { constants.numbers(0)[index] } else { f64::NAN };
            ExchangeCell::Number((!value.is_nan()).then_some(value))
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
