//! A model that only names columns, sinks that watch, and writers of one table in every format.
#![allow(dead_code, reason = "each test file uses a part")]
#![allow(clippy::unwrap_used, reason = "only tests call these")]

use std::fmt::Write as _;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow_ipc::writer::{FileWriter, IpcWriteOptions, StreamWriter};
use kalfit::model::{Clock, Column, CovarianceStructure, MeanStructure};
use kalfit::{Label, Labels, Layout, Model, PhasedModel, Source, Test, TestKey};
use kalfit_data::{DataError, DataReading, Input, ReadError, TestSink, read_from};
use parquet::arrow::ArrowWriter;
use parquet::file::properties::WriterProperties;

/// A model that reads these columns; the time column, when given, is one of them.
pub(crate) fn model(columns: &[&str], text_columns: &[&str], time: Option<&str>) -> PhasedModel {
    let named = |names: &[&str]| -> Vec<Column> {
        names
            .iter()
            .map(|name| Column { name: (*name).to_owned(), used_in: format!("equation of measurement `m_{name}`") })
            .collect()
    };
    let model = Model {
        title: String::new(),
        columns: named(columns),
        text_columns: named(text_columns),
        literals: vec!["A".into(), "unused".into()],
        parameters: Vec::new(),
        states: Vec::new(),
        process_noise_covariance: Vec::new(),
        measurements: Vec::new(),
        noise_covariance: Vec::new(),
        clock: Clock { time: time.and_then(|t| columns.iter().position(|c| *c == t)), ..Clock::default() },
        group: None,
        estimated: Vec::new(),
        mean: MeanStructure::free(0),
        covariance: CovarianceStructure::full(),
    };
    model.into()
}

pub(crate) fn with_unit(mut model: PhasedModel, unit: &str) -> PhasedModel {
    model.phases[0].model.clock.unit = Some(unit.into());
    model
}

pub(crate) fn by(column: &str) -> Layout {
    Layout {
        test: TestKey::Column(column.into()),
        levels: Vec::new(),
        crossed: Vec::new(),
        missing: Vec::new(),
        comment: None,
    }
}

/// Keeps everything, and notes what happened.
#[derive(Debug, Default)]
pub(crate) struct Collect {
    pub(crate) tests: Vec<Test>,
    pub(crate) restarts: usize,
    pub(crate) batches: Vec<usize>,
}

impl TestSink for Collect {
    type Error = std::convert::Infallible;

    fn tests(&mut self, tests: Vec<Test>, labels: &Labels) -> Result<(), Self::Error> {
        for test in &tests {
            for row in 0..test.rows() {
                assert!(
                    test.texts(row).iter().all(|&l| l.is_missing() || !labels.text(l).is_empty()),
                    "labels are known when a test is handed over"
                );
            }
        }
        self.batches.push(tests.len());
        self.tests.extend(tests);
        Ok(())
    }

    fn restart(&mut self) {
        self.tests.clear();
        self.batches.clear();
        self.restarts += 1;
    }
}

pub(crate) fn data_error<E>(error: ReadError<E>) -> DataError {
    match error {
        ReadError::Data(error) => error,
        ReadError::Sink { .. } => panic!("the sink refuses nothing"),
    }
}

/// Reads inputs with a sink that keeps everything.
pub(crate) fn collect(
    model: &PhasedModel,
    layout: &Layout,
    inputs: &[Input],
    stdin: &mut dyn Read,
) -> Result<(Collect, DataReading), DataError> {
    let mut sink = Collect::default();
    let reading = read_from(model, layout, inputs, &mut sink, stdin).map_err(data_error)?;
    Ok((sink, reading))
}

/// Reads bytes from standard input.
pub(crate) fn collect_stdin(
    model: &PhasedModel,
    layout: &Layout,
    bytes: &[u8],
) -> Result<(Collect, DataReading), DataError> {
    collect(model, layout, &[Input::Stdin], &mut Cursor::new(bytes))
}

pub(crate) fn write(folder: &Path, name: &str, bytes: &[u8]) -> Input {
    let path: PathBuf = folder.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, bytes).unwrap();
    Input::Path(path)
}

/// Tests as text, without sources: what must be equal across formats.
pub(crate) fn shown(tests: &[Test], labels: &Labels) -> String {
    let mut text = String::new();
    for test in tests {
        writeln!(text, "{}", test.id).unwrap();
        for row in 0..test.rows() {
            let label = |l: &Label| if l.is_missing() { "-" } else { labels.text(*l) }.to_owned();
            let texts: Vec<String> = test.texts(row).iter().map(label).collect();
            writeln!(text, "  {:?} {texts:?}", test.numbers(row)).unwrap();
        }
    }
    text
}

pub(crate) fn sources(tests: &[Test]) -> Vec<Source> {
    tests.iter().flat_map(|test| (0..test.rows()).map(|row| test.source(row))).collect()
}

/// One column of a table.
#[derive(Debug, Clone)]
pub(crate) enum Cells {
    Integers(Vec<Option<i64>>),
    Floats(Vec<Option<f64>>),
    Texts(Vec<Option<String>>),
}

/// A table that can be written in every format.
#[derive(Debug, Clone)]
pub(crate) struct Table(pub(crate) Vec<(String, Cells)>);

impl Cells {
    fn len(&self) -> usize {
        match self {
            Cells::Integers(v) => v.len(),
            Cells::Floats(v) => v.len(),
            Cells::Texts(v) => v.len(),
        }
    }

    fn csv(&self, row: usize) -> String {
        match self {
            Cells::Integers(v) => v[row].map_or_else(|| "NA".into(), |x| x.to_string()),
            Cells::Floats(v) => v[row].map_or_else(String::new, |x| format!("{x:?}")),
            Cells::Texts(v) => v[row].as_ref().map_or_else(String::new, |x| format!("\"{}\"", x.replace('"', "\"\""))),
        }
    }

    fn array(&self) -> ArrayRef {
        match self {
            Cells::Integers(v) => Arc::new(Int64Array::from(v.clone())),
            Cells::Floats(v) => Arc::new(Float64Array::from(v.clone())),
            Cells::Texts(v) => Arc::new(StringArray::from(v.clone())),
        }
    }
}

impl Table {
    pub(crate) fn rows(&self) -> usize {
        self.0[0].1.len()
    }

    pub(crate) fn csv(&self, delimiter: char, end: &str) -> Vec<u8> {
        let join = |cells: Vec<String>| cells.join(&delimiter.to_string()) + end;
        let mut text = join(self.0.iter().map(|(name, _)| name.clone()).collect());
        for row in 0..self.rows() {
            text += &join(self.0.iter().map(|(_, cells)| cells.csv(row)).collect());
        }
        text.into_bytes()
    }

    pub(crate) fn batch(&self) -> RecordBatch {
        batch(self.0.iter().map(|(name, cells)| (name.as_str(), cells.array())).collect())
    }

    /// The columns in the opposite order.
    pub(crate) fn reversed(&self) -> Table {
        Table(self.0.iter().rev().cloned().collect())
    }
}

pub(crate) fn batch(columns: Vec<(&str, ArrayRef)>) -> RecordBatch {
    RecordBatch::try_from_iter_with_nullable(columns.into_iter().map(|(name, array)| (name, array, true))).unwrap()
}

pub(crate) fn parquet(batch: &RecordBatch, group_rows: usize) -> Vec<u8> {
    let properties = WriterProperties::builder()
        .set_max_row_group_row_count(Some(group_rows))
        .set_compression(parquet::basic::Compression::SNAPPY)
        .build();
    let mut bytes = Vec::new();
    let mut writer = ArrowWriter::try_new(&mut bytes, batch.schema(), Some(properties)).unwrap();
    writer.write(batch).unwrap();
    writer.close().unwrap();
    bytes
}

/// The rows in batches of `rows`.
fn pieces(batch: &RecordBatch, rows: usize) -> Vec<RecordBatch> {
    (0..batch.num_rows()).step_by(rows).map(|at| batch.slice(at, rows.min(batch.num_rows() - at))).collect()
}

pub(crate) fn arrow_file(batch: &RecordBatch, rows: usize, options: IpcWriteOptions) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut writer = FileWriter::try_new_with_options(&mut bytes, &batch.schema(), options).unwrap();
    pieces(batch, rows).iter().for_each(|piece| writer.write(piece).unwrap());
    writer.finish().unwrap();
    drop(writer);
    bytes
}

pub(crate) fn arrow_stream(batch: &RecordBatch, rows: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut writer = StreamWriter::try_new(&mut bytes, &batch.schema()).unwrap();
    pieces(batch, rows).iter().for_each(|piece| writer.write(piece).unwrap());
    writer.finish().unwrap();
    drop(writer);
    bytes
}
