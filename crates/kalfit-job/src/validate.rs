//! How well a model predicts tests that it was not fitted to: `kalfit validate`.

use kalfit::model::Column;
use kalfit::validate::{Folds, ValidateError, Validation, validate as run};
use kalfit::validate::{NotComparable, ValidateProvenance, ValidatedRecord};
use kalfit::{Ensemble, EnsembleError, Model, Options};
use kalfit_data::{DataReading, Input};
use kalfit_spec::Spec;

use crate::document::Document;
use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::job::{FoldChoice, JobDone, ModelJob, ValidateJob, files};
use crate::output::OutputFile;
use crate::work::{JobWatch, JobWork};
use crate::{dynamic, groups, memory, model, refused, tests};

/// Validates a model, and another one beside it.
///
/// # Errors
/// Bad input, or [`Failure::Interrupted`].
pub fn validate(job: &ValidateJob, watch: &mut dyn JobWatch) -> Result<JobDone<ValidatedRecord>, Failure> {
    let mut work = JobWork::new(watch);
    let first = OpenedModel::new(job, &job.model)?;
    if job.against.is_some() && first.given.inputs.contains(&Input::Stdin) {
        return Err(Failure::AgainstStdin);
    }
    let documents: Vec<_> = std::iter::once(&job.model.document).chain(&job.against).collect();
    let output = OutputFile::results(job.out.as_deref(), &files(&documents, &first.given.inputs))?;
    let other = |document: &Document| OpenedModel::new(job, &ModelJob { document: document.clone(), set: Vec::new() });
    let against = job.against.as_ref().map(other).transpose()?;
    against.as_ref().map_or(Ok(()), |against| first.refuse_others(against))?;
    let first = first.read(&mut work)?;
    let folds = first.folds(job)?;
    let found = first.validated(&folds, job, &mut work)?;
    let (by, seed) = match &job.folds {
        FoldChoice::Drawn { seed, .. } => (None, Some(*seed)),
        FoldChoice::Column(column) => (Some(column.clone()), None),
    };
    let provenance =
        ValidateProvenance { model_digest: Some(first.spec.digest.clone()), files: first.given.names(), by, seed };
    let mut record = ValidatedRecord::new(&first.spec.model, &folds, &found, provenance);
    if let Some(against) = against {
        let other = against.read(&mut work)?;
        let theirs = other.folds_like(&first, &folds)?;
        let beside = other.validated(&theirs, job, &mut work)?;
        let title = other.spec.model.shared().title.trim();
        let title = if title.is_empty() { other.spec.name.clone() } else { title.to_owned() };
        record
            .set_against(title, &beside)
            .map_err(|error| Failure::NotComparable { error: Box::new(error), path: other.spec.name.clone() })?;
    }
    JobDone::in_json(record, first.given.notes, output.as_ref())
}

/// A model with the data that it will read.
struct OpenedModel {
    spec: Spec,
    given: CommandInputs,
}

impl OpenedModel {
    fn new(job: &ValidateJob, model: &ModelJob) -> Result<OpenedModel, Failure> {
        let mut spec = model::load(model, &job.data)?;
        memory::suffices(&spec)?;
        if let FoldChoice::Column(column) = &job.folds {
            read_too(&mut spec, column);
        }
        let given = CommandInputs::open(&mut spec, &job.data)?;
        if given.is_rows() { Ok(OpenedModel { spec, given }) } else { Err(Failure::FoldsOfRows) }
    }

    /// Refuses another model that measures other columns.
    fn refuse_others(&self, other: &OpenedModel) -> Result<(), Failure> {
        let [first, second] = [self, other].map(|opened| measured(&opened.spec));
        if first == second {
            return Ok(());
        }
        let error = NotComparable::Columns { first, second };
        Err(Failure::NotComparable { error: Box::new(error), path: other.spec.name.clone() })
    }

    fn read(self, work: &mut JobWork<'_>) -> Result<ModelTests, Failure> {
        let OpenedModel { spec, given } = self;
        let (tests, reading) = tests::read(&spec, &given, work)?;
        let ensemble = Ensemble::of_tests(&spec.model, reading.labels.clone(), tests);
        Ok(ModelTests { spec, given, ensemble, reading })
    }
}

/// A model with its tests.
struct ModelTests {
    spec: Spec,
    given: CommandInputs,
    ensemble: Ensemble,
    reading: DataReading,
}

impl ModelTests {
    fn folds(&self, job: &ValidateJob) -> Result<Folds, Failure> {
        let (model, labels, tests) = (&self.spec.model, self.ensemble.labels(), self.ensemble.tests());
        let found = match &job.folds {
            FoldChoice::Drawn { count, seed } => Folds::drawn(model, labels, tests, (*count, *seed)),
            FoldChoice::Column(_) => {
                let texts = groups::of(model, tests, labels)?.unwrap_or_default();
                Folds::by_text(model, labels, tests, &texts)
            }
        };
        found.map_err(|error| Failure::Folds(Box::new(error)))
    }

    /// The folds of another's tests, by the names of these.
    fn folds_like(&self, other: &ModelTests, folds: &Folds) -> Result<Folds, Failure> {
        let of: std::collections::HashMap<&str, usize> =
            other.ensemble.tests().iter().map(|test| test.id.as_str()).zip(folds.of.iter().copied()).collect();
        let place = |test: &kalfit::PhasedTest| {
            let found = format!("test `{}`", test.id);
            let error = NotComparable::Names { found };
            of.get(test.id.as_str())
                .copied()
                .ok_or_else(|| Failure::NotComparable { error: Box::new(error), path: self.spec.name.clone() })
        };
        let of = self.ensemble.tests().iter().map(place).collect::<Result<_, _>>()?;
        Ok(Folds { names: folds.names.clone(), of })
    }

    fn validated(&self, folds: &Folds, job: &ValidateJob, work: &mut JobWork<'_>) -> Result<Validation, Failure> {
        let mut options = Options::default();
        options.settings.criterion = job.criterion;
        run(&self.ensemble, folds, &options, work).map_err(|error| self.refused(error))
    }

    fn refused(&self, error: ValidateError) -> Failure {
        match error {
            ValidateError::Interrupted => Failure::Interrupted,
            ValidateError::Fit(EnsembleError::Dynamic(error)) => dynamic::failure(*error, &self.reading),
            ValidateError::Fit(EnsembleError::Fit(error)) => Failure::Fit(error),
            ValidateError::Fit(EnsembleError::Reduce(error)) => {
                Failure::Reduce { error: *error, reading: Some(Box::new(self.reading.clone())) }
            }
            ValidateError::Apply(error) => refused::by_apply(error, &self.reading),
            error => Failure::Validate(Box::new(error)),
        }
    }
}

/// The columns that a model measures, in the order of their names.
fn measured(spec: &Spec) -> Vec<String> {
    let of = |model: &Model| -> Vec<String> {
        model.measurements.iter().map(|one| model.columns[one.column].name.clone()).collect()
    };
    let mut names: Vec<String> = spec.model.phases.iter().flat_map(|phase| of(&phase.model)).collect();
    names.sort();
    names.dedup();
    names
}

/// Has a column of texts read, and tests grouped by it.
fn read_too(spec: &mut Spec, column: &str) {
    let shared = spec.model.shared();
    let known = shared.text_columns.iter().position(|known| known.name == column);
    let place = known.unwrap_or(shared.text_columns.len());
    for model in spec.model.models_mut() {
        if known.is_none() {
            model.text_columns.push(Column { name: column.to_owned(), used_in: "`--by`".to_owned() });
        }
        model.group = Some(place);
    }
}
