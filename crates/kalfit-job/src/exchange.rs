//! What `kalfit reduce` and `kalfit estimates` share: evidence in, one file out, whole or not at all.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::PathBuf;

use kalfit::dynamic::DynamicError;
use kalfit::model::ParameterError;
use kalfit::reduce::{GroupingError, ReduceError, SplitError};
use kalfit::{Alpha, Labels, PhasedModel, Source, Test};
use kalfit_data::exchange::{ExchangeEntry, ExchangeMetadata, ParameterValue};
use kalfit_data::{DataReading, ReadError, TestSink, WriteError};
use kalfit_spec::Spec;

use crate::document::Document;
use crate::evidence::{CommandInputs, entries};
use crate::failure::Failure;
use crate::job::{ExchangeJob, ExchangedTable, JobDone, files};
use crate::output::{OutputTarget, PendingFile, finish_together};
use crate::truth::error::TruthError;
use crate::work::{JobWatch, JobWork};
use crate::{model, truth};

/// Phases of tests handled at a time.
const BATCH: usize = 1024;

/// Makes the rows of an exchange file.
pub(crate) trait ExchangeMaker: Sized {
    /// What writes them.
    type Writer;
    /// What one row is, in words.
    const ROW: &'static str;
    /// They are estimates, whatever they are made of.
    const OF_ESTIMATES: bool;

    /// Refuses a model of which there can be no such file.
    fn refuse(_: &PhasedModel) -> Result<(), WriteError> {
        Ok(())
    }

    fn new(setting: &ExchangeSetting) -> Result<Self, Failure>;

    fn open(setting: &ExchangeSetting, sink: ExchangeSink) -> Result<Self::Writer, WriteError>;

    /// Makes rows of entries and writes them.
    fn make(
        &mut self,
        entries: Vec<ExchangeEntry>,
        labels: &Labels,
        writer: &mut Self::Writer,
    ) -> Result<(), ExchangeRefusal>;

    fn close(writer: Self::Writer) -> Result<ExchangeSink, WriteError>;
}

/// Where a file goes.
pub(crate) type ExchangeSink = BufWriter<File>;

/// What rows are made at.
pub(crate) struct ExchangeSetting {
    pub(crate) spec: Spec,
    pub(crate) alpha: Alpha,
    metadata: ExchangeMetadata,
}

impl ExchangeSetting {
    pub(crate) fn metadata(&self) -> &ExchangeMetadata {
        &self.metadata
    }
}

/// Why no row was made.
pub(crate) enum ExchangeRefusal {
    Split(SplitError),
    Reduce(ReduceError),
    Grouping(GroupingError),
    Write(WriteError),
    /// Nobody waits any longer.
    Interrupted,
    /// Rows of a phase without a filter.
    NoFilter {
        phase: String,
        at: Source,
    },
    /// A reduction, of which no estimates can be made.
    Reduced {
        at: Source,
    },
}

/// Makes an exchange file.
pub(crate) fn run<M: ExchangeMaker>(
    job: &ExchangeJob,
    watch: &mut dyn JobWatch,
) -> Result<JobDone<ExchangedTable>, Failure> {
    let mut spec = model::read(&job.model.document)?;
    let path = job.out.as_ref().map_or_else(|| M::ROW.to_owned() + "s", |path| path.display().to_string());
    M::refuse(&spec.model).map_err(|error| Failure::Write { error: Box::new(error), path })?;
    let mut notes = job.at.as_ref().map_or(Ok(Vec::new()), |at| truth::parameters(&mut spec, at))?;
    model::set(&mut spec, &job.model.set)?;
    let given = CommandInputs::open(&mut spec, &job.data)?;
    notes.extend(given.notes.iter().cloned());
    let is_parquet = |path: &PathBuf| {
        let known = |extension: &OsStr| ["parquet", "pq"].iter().any(|known| extension.eq_ignore_ascii_case(known));
        path.extension().is_some_and(known) // as it will be read
    };
    if let Some(path) = job.out.as_ref().filter(|path| !is_parquet(path)) {
        return Err(Failure::NotParquet { path: path.display().to_string() });
    }
    let read: Vec<&Document> = std::iter::once(&job.model.document).chain(&job.at).collect();
    let output = OutputTarget::prepare(job.out.as_deref(), &files(&read, &given.inputs))?;
    let alpha = Alpha::fixed(&spec.model.shared().parameters)
        .map_err(|ParameterError::Free { names }| Failure::from(TruthError::NoParameter { names }))?;
    let metadata = metadata(&spec, &alpha, &given, M::OF_ESTIMATES);
    let setting = ExchangeSetting { spec, alpha, metadata };
    let mut work = JobWork::new(watch);
    let maker = M::new(&setting)?;
    let pending = output.begin()?;
    let mut filing = ExchangeFiller {
        setting: &setting,
        maker,
        writer: None,
        pending: &pending,
        tests: BTreeSet::new(),
        rows: 0,
        work: &mut work,
    };
    filing.fill(&given)?;
    filing.work.go_on()?;
    let (tests, rows) = (filing.tests.len(), filing.rows);
    filing.close()?;
    let [table] = finish_together([Some(pending)])?;
    let record = ExchangedTable { rows, row: M::ROW, tests, table };
    Ok(JobDone::new(record, notes, output.name().into_iter().collect()))
}

fn metadata(spec: &Spec, alpha: &Alpha, given: &CommandInputs, of_estimates: bool) -> ExchangeMetadata {
    let model = spec.model.shared();
    ExchangeMetadata {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        title: model.title.clone(),
        model_digest: spec.digest.clone(),
        reduction_digest: spec.reduction_digest(),
        parameters: ParameterValue::all(model, alpha, &Labels::new(&model.literals)),
        files: given.names(),
        of_estimates: of_estimates || given.is_of_estimates(&spec.model),
    }
}

/// A file that is being filled.
struct ExchangeFiller<'a, 'w, M: ExchangeMaker> {
    setting: &'a ExchangeSetting,
    maker: M,
    /// Nothing is written yet when none.
    writer: Option<M::Writer>,
    pending: &'a PendingFile<'a>,
    tests: BTreeSet<String>,
    rows: usize,
    work: &'a mut JobWork<'w>,
}

impl<M: ExchangeMaker> ExchangeFiller<'_, '_, M> {
    /// Rows as they are read; where there is more than rows, all at once.
    fn fill(&mut self, given: &CommandInputs) -> Result<(), Failure> {
        let (spec, path) = (&self.setting.spec, self.pending.name());
        let failed = |refused: ExchangeRefusal, reading: &DataReading| failure(refused, reading, &path);
        if given.is_rows() {
            let (inputs, layout) = (&given.inputs, &spec.layout);
            let read = kalfit_data::read_from(&spec.model, layout, inputs, self, &mut given.stdin());
            return read.map(|_| ()).map_err(|error| match error {
                ReadError::Data(error) => Failure::data(error, spec),
                ReadError::Sink { error, reading } => failed(error, &reading),
            });
        }
        let (mut entries, reading) = given.parts(spec, &spec.model, self.work)?;
        while !entries.is_empty() {
            let rest = entries.split_off(entries.len().min(BATCH));
            self.take(entries, &reading.labels).map_err(|refused| failed(refused, &reading))?;
            entries = rest;
        }
        Ok(())
    }

    fn take(&mut self, entries: Vec<ExchangeEntry>, labels: &Labels) -> Result<(), ExchangeRefusal> {
        if self.work.is_stopped() {
            return Err(ExchangeRefusal::Interrupted);
        }
        if self.writer.is_none() {
            let begun = self.begin().map_err(|error| ExchangeRefusal::Write(error.into()))?;
            self.writer = Some(M::open(self.setting, begun).map_err(ExchangeRefusal::Write)?);
        }
        for entry in &entries {
            if !self.tests.contains(&entry.test) {
                self.tests.insert(entry.test.clone());
            }
        }
        self.rows += entries.len();
        let writer = self.writer.as_mut().expect("it was opened");
        self.maker.make(entries, labels, writer)?;
        let done = self.rows;
        self.work.say(|| format!("filtering: {done} phases of tests"));
        Ok(())
    }

    /// The file, empty.
    fn begin(&self) -> std::io::Result<ExchangeSink> {
        let mut file = self.pending.file().try_clone()?;
        file.set_len(0)?;
        file.rewind()?;
        Ok(BufWriter::new(file))
    }

    fn close(self) -> Result<(), Failure> {
        let path = self.pending.name();
        let failed = |error: WriteError| Failure::Write { error: Box::new(error), path: path.clone() };
        let Some(writer) = self.writer else { return Ok(()) };
        M::close(writer).map_err(failed)?.flush().map_err(|error| failed(error.into()))
    }
}

impl<M: ExchangeMaker> TestSink for ExchangeFiller<'_, '_, M> {
    type Error = ExchangeRefusal;

    fn tests(&mut self, tests: Vec<Test>, labels: &Labels) -> Result<(), ExchangeRefusal> {
        let entries = entries(&self.setting.spec.model, tests, labels).map_err(ExchangeRefusal::Split)?;
        self.take(entries, labels)
    }

    fn bytes(&mut self, done: u64, of: Option<u64>) -> Result<(), ExchangeRefusal> {
        of.into_iter().for_each(|of| self.work.share("filtering", done, of));
        if self.work.is_stopped() { Err(ExchangeRefusal::Interrupted) } else { Ok(()) }
    }

    fn restart(&mut self) {
        (self.writer, self.rows) = (None, 0);
        self.tests.clear();
    }
}

fn failure(refused: ExchangeRefusal, reading: &DataReading, path: &str) -> Failure {
    match refused {
        ExchangeRefusal::Split(error) => Failure::Split { error, reading: Box::new(reading.clone()) },
        ExchangeRefusal::Reduce(error) => Failure::Reduce { error, reading: Some(Box::new(reading.clone())) },
        ExchangeRefusal::Grouping(error) => Failure::Dynamic(Box::new(DynamicError::from(error))),
        ExchangeRefusal::Write(error) => Failure::Write { error: Box::new(error), path: path.to_owned() },
        ExchangeRefusal::Interrupted => Failure::Interrupted,
        ExchangeRefusal::NoFilter { phase, at } => Failure::NoFilter { phase, at: reading.place(at) },
        ExchangeRefusal::Reduced { at } => Failure::NotEstimates { at: reading.place(at) },
    }
}
