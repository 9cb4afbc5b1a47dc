//! What a job is asked for, and what it ends with.

use std::fs::File;
use std::path::{Path, PathBuf};

use kalfit::apply::StateKind;
use kalfit::dynamic::{self, Method};
use kalfit::estimate::{Criterion, Settings};
use kalfit::infer::{Bootstrap, Choices};
use kalfit::predict::Limits;
use kalfit::record::{AppliedRecord, PredictedRecord};
use kalfit_data::{Datum, Input};
use kalfit_report::PlotKind;
use serde::Serialize;

use crate::document::Document;
use crate::export::format::ExportFormat;
use crate::failure::Failure;
use crate::output::OutputFile;
use crate::tables::FitTableKind;

/// Which model.
#[derive(Debug, Clone)]
pub struct ModelJob {
    /// A model file, or its text.
    pub document: Document,
    /// Values of parameters, each as `name=value` or `name[level]=value`.
    pub set: Vec<String>,
}

/// Fit a model to data.
#[derive(Debug, Clone)]
pub struct FitJob {
    /// The model.
    pub model: ModelJob,
    /// The data.
    pub data: Vec<Datum>,
    /// File for the results.
    pub out: Option<PathBuf>,
    /// File for the HTML report.
    pub report: Option<PathBuf>,
    /// Where tables of the results go.
    pub tables: FitTables,
    /// Of the search for the mean and the covariance.
    pub settings: Settings,
    /// Of the search for free dynamic parameters.
    pub search: dynamic::Settings,
    /// How they are sought.
    pub method: MethodChoice,
    /// What is inferred, and how.
    pub choices: Choices,
    /// Look at the data once more after the fit.
    pub innovations: bool,
    /// Fit each group of tests by itself too: do they differ.
    pub group_test: bool,
    /// Write the files of a search that was [stopped](crate::JobWatch::stops), too: what it has, as not converged.
    pub keeps_stopped: bool,
}

impl FitJob {
    /// As the command does it when no option is given.
    pub fn new(model: ModelJob, data: Vec<Datum>) -> FitJob {
        let settings = Settings::default();
        let search = dynamic::Settings { inner: settings.clone(), seed: 1, ..dynamic::Settings::default() };
        let (method, choices) = (MethodChoice::By(Method::Hybrid), Choices::default());
        FitJob {
            model,
            data,
            out: None,
            report: None,
            tables: FitTables::default(),
            settings,
            search,
            method,
            choices,
            innovations: true,
            group_test: false,
            keeps_stopped: false,
        }
    }
}

/// Tables of what a fit found.
#[derive(Debug, Clone, Default)]
pub struct FitTables {
    /// What each test says: a row for each phase.
    pub tests: Option<PathBuf>,
    /// Every number that describes the population, and every parameter.
    pub parameters: Option<PathBuf>,
    /// What each constraint costs.
    pub constraints: Option<PathBuf>,
    /// Measurements that contradict the others of their test.
    pub rows: Option<PathBuf>,
}

impl FitTables {
    /// Each table with its file.
    pub(crate) fn all(&self) -> [(FitTableKind, &Option<PathBuf>); 4] {
        [
            (FitTableKind::Tests, &self.tests),
            (FitTableKind::Parameters, &self.parameters),
            (FitTableKind::Constraints, &self.constraints),
            (FitTableKind::Rows, &self.rows),
        ]
    }
}

/// Run filters and write what they make of the data.
#[derive(Debug, Clone)]
pub struct ExchangeJob {
    /// The model.
    pub model: ModelJob,
    /// The data.
    pub data: Vec<Datum>,
    /// Results of a fit, for the parameters.
    pub at: Option<Document>,
    /// File for the table, which is handed back when none.
    pub out: Option<PathBuf>,
}

/// Whether a test draws ensembles from its hypothesis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BootstrapChoice {
    /// With few units and known parameters, where a draw costs no run of the filters.
    Auto {
        /// Seed of the draws.
        seed: u64,
    },
    /// Never.
    None,
    /// As many as are asked for.
    Drawn(Bootstrap),
}

impl BootstrapChoice {
    /// `replicates`: number that is asked for; zero for none, `None` for as many as are due.
    pub fn of(replicates: Option<usize>, seed: u64) -> BootstrapChoice {
        match replicates {
            None => BootstrapChoice::Auto { seed },
            Some(0) => BootstrapChoice::None,
            Some(replicates) => BootstrapChoice::Drawn(Bootstrap { replicates, seed }),
        }
    }

    /// The ensembles that are drawn; `is_due`: whether some are drawn without being asked for.
    pub(crate) fn resolved(self, is_due: bool) -> Option<Bootstrap> {
        /// The p-value is then a multiple of a thousandth.
        const REPLICATES: usize = 999;
        match self {
            BootstrapChoice::Auto { seed } => is_due.then_some(Bootstrap { replicates: REPLICATES, seed }),
            BootstrapChoice::None => None,
            BootstrapChoice::Drawn(asked) => Some(asked),
        }
    }
}

/// Test a hypothesis.
#[derive(Debug, Clone)]
pub struct TestJob {
    /// The model.
    pub model: ModelJob,
    /// The data.
    pub data: Vec<Datum>,
    /// The hypothesis.
    pub null: Document,
    /// Ensembles to draw from it.
    pub bootstrap: BootstrapChoice,
    /// File for the results.
    pub out: Option<PathBuf>,
    /// Of the searches.
    pub settings: Settings,
}

/// Read all and fit nothing.
#[derive(Debug, Clone)]
pub struct CheckJob {
    /// The model.
    pub model: ModelJob,
    /// The data; nothing but the model is checked when there are none.
    pub data: Vec<Datum>,
    /// File for the results.
    pub out: Option<PathBuf>,
}

/// Draw an ensemble.
#[derive(Debug, Clone)]
pub struct SimulateJob {
    /// The model.
    pub model: ModelJob,
    /// Where the population comes from: results of a fit, or a model.
    pub from: Document,
    /// Data that give times, inputs and missingness.
    pub design: Vec<Datum>,
    /// Number of tests; as many as the design has when none.
    pub tests: Option<u64>,
    /// A best plan, which says how many tests there are like each test of the design.
    pub plan: Option<Document>,
    /// The same seed draws the same ensemble.
    pub seed: u64,
    /// File for the data, which are handed back as an Arrow IPC file when none.
    pub out: Option<PathBuf>,
    /// File for the true initial states.
    pub states: Option<PathBuf>,
}

/// Expect standard errors, or choose the best plan among candidates.
#[derive(Debug, Clone)]
pub struct PlanJob {
    /// The model.
    pub model: ModelJob,
    /// Where the population comes from: results of a fit, or a model.
    pub from: Document,
    /// What is planned.
    pub request: PlanRequest,
    /// File for the plan.
    pub out: Option<PathBuf>,
}

/// What is planned.
#[derive(Debug, Clone)]
pub enum PlanRequest {
    /// Numbers of tests like those of a design.
    Design(DesignPlan),
    /// The best plan among candidates.
    Best(Box<BestPlanRequest>),
}

/// Numbers of tests like those of a design.
#[derive(Debug, Clone)]
pub struct DesignPlan {
    /// Data that give times, inputs and missingness.
    pub design: Vec<Datum>,
    /// Numbers of tests; of a model with levels of tests in each group of the innermost level.
    pub tests: Vec<usize>,
    /// Of each level of groups its name, and numbers of groups in each group of the level above.
    pub groups: Vec<(String, Vec<usize>)>,
}

/// The best plan among candidates.
#[derive(Debug, Clone)]
pub struct BestPlanRequest {
    /// Data whose tests, or units of the outermost level, are the candidates.
    pub candidates: Vec<Datum>,
    /// Largest cost of the plan.
    pub budget: f64,
    /// Column of the cost of a candidate; `cost` where the data have it, else every candidate costs 1.
    pub cost: Option<String>,
    /// Column of the largest number of a candidate; `most` where the data have it, else there is none.
    pub most: Option<String>,
    /// What is to be best known: `D`, `A`, or figures.
    pub goal: String,
    /// What is known already.
    pub so_far: Option<SoFar>,
    /// Draws of the parameters, with their seed.
    pub draws: Option<(usize, u64)>,
    /// A test that has not been made, whose values are figures; none where it is empty.
    pub mission: Vec<Datum>,
    /// Outputs of the mission, linear in the states.
    pub outputs: Option<Document>,
}

impl SoFar {
    /// What some files tell: a single file is the results of a fit by its ending `.json`; nothing where there are none.
    pub fn of_paths(paths: Vec<PathBuf>) -> Option<SoFar> {
        let is_json = |path: &PathBuf| path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("json"));
        match &paths[..] {
            [] => None,
            [path] if is_json(path) => Some(SoFar::Fit(path.clone().into())),
            _ => Some(SoFar::Tests(paths.iter().map(|path| Datum::Named(path.display().to_string())).collect())),
        }
    }
}

/// What is known before any test of a plan is made.
#[derive(Debug, Clone)]
pub enum SoFar {
    /// What a fit knows.
    Fit(Document),
    /// Tests that were made.
    Tests(Vec<Datum>),
}

/// Apply a fitted model to tests.
#[derive(Debug, Clone)]
pub struct ApplyJob {
    /// The model.
    pub model: ModelJob,
    /// The tests.
    pub data: Vec<Datum>,
    /// Where all parameters come from: results of a fit, or a model.
    pub from: Document,
    /// Where a table of the tests goes.
    pub tests: TableDestination,
    /// Where a table of the states at every step goes.
    pub states: TableDestination,
    /// What is known of the states when they are told.
    pub kind: StateKind,
}

/// Predict tests by fits that were made without them.
#[derive(Debug, Clone)]
pub struct ValidateJob {
    /// The model.
    pub model: ModelJob,
    /// The tests.
    pub data: Vec<Datum>,
    /// Which tests are left out together.
    pub folds: FoldChoice,
    /// Another model.
    pub against: Option<Document>,
    /// Of the fits.
    pub criterion: Criterion,
    /// File for the results.
    pub out: Option<PathBuf>,
}

/// Which tests are left out together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FoldChoice {
    /// About equally many, drawn.
    Drawn {
        /// Number of folds.
        count: usize,
        /// The same seed draws the same folds.
        seed: u64,
    },
    /// Those with one text in a column.
    Column(String),
}

/// Say what tests that nobody has made will give.
#[derive(Debug, Clone)]
pub struct PredictJob {
    /// The model.
    pub model: ModelJob,
    /// Where all parameters come from: results of a fit, or a model.
    pub from: Document,
    /// Data that give times and inputs.
    pub design: Vec<Datum>,
    /// Named quantities that are linear in the states.
    pub outputs: Option<Document>,
    /// How sure limits are, and what they are of.
    pub limits: Limits,
    /// Whose tests they are.
    pub units: PredictedUnits,
    /// The data of the fit, where limits of means are to be by profile likelihood.
    pub profile: Vec<Datum>,
    /// Where the table goes.
    pub out: TableDestination,
}

/// How free parameters are sought.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MethodChoice {
    /// By one method.
    By(Method),
    /// By all, side by side; the results are those of the hybrid.
    All,
}

/// Whose tests are predicted, of a model with levels of groups.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PredictedUnits {
    /// Of groups that nobody has seen.
    #[default]
    New,
    /// Of groups that the fit knows.
    Known,
}

/// Predictions of a model.
#[derive(Debug)]
pub struct PredictedModel {
    /// The last row of each of the first tests.
    pub record: PredictedRecord,
    /// The table of all rows as an Arrow IPC file without a name, where it is handed back.
    pub table: Option<File>,
}

/// Where a table goes.
#[derive(Debug, Clone, Default)]
pub enum TableDestination {
    /// It is not made.
    #[default]
    Nowhere,
    /// It is handed back.
    Back,
    /// To a file.
    File(PathBuf),
}

impl From<Option<PathBuf>> for TableDestination {
    fn from(path: Option<PathBuf>) -> TableDestination {
        path.map_or(TableDestination::Nowhere, TableDestination::File)
    }
}

/// A fitted model that was applied.
#[derive(Debug)]
pub struct AppliedModel {
    /// What it says of all tests.
    pub record: AppliedRecord,
    /// The table of the tests as an Arrow IPC file without a name, where it is handed back.
    pub tests: Option<File>,
    /// That of the states.
    pub states: Option<File>,
}

/// Make the filter that follows from a fit.
#[derive(Debug, Clone)]
pub struct ExportJob {
    /// The model.
    pub model: ModelJob,
    /// Where all parameters come from: results of a fit, or a model.
    pub from: Document,
    /// The phase; it can be left out where there is one.
    pub phase: Option<String>,
    /// Length of a step, where anything depends on it.
    pub step: Option<f64>,
    /// Columns with the value that they have on all rows, each as `column=value`.
    pub at: Vec<String>,
    /// What kind of file; as the ending of `out` says when none.
    pub format: Option<ExportFormat>,
    /// The file.
    pub out: Option<PathBuf>,
}

/// Make the numbers of a datasheet.
#[derive(Debug, Clone)]
pub struct DatasheetJob {
    /// The model.
    pub model: ModelJob,
    /// Where all parameters come from: results of a fit, or a model.
    pub from: Document,
    /// Records to put beside the model; there need be none.
    pub data: Vec<Datum>,
    /// Time from a value to the next, without data.
    pub step: Option<f64>,
    /// Columns with the value that they have on all rows, each as `column=value`.
    pub at: Vec<String>,
    /// File for the results.
    pub out: Option<PathBuf>,
}

/// Put fits of the same data side by side.
#[derive(Debug, Clone)]
pub struct CompareJob {
    /// Results of fits.
    pub fits: Vec<Document>,
    /// File for the results.
    pub out: Option<PathBuf>,
}

/// Make the report of a fit from its results.
#[derive(Debug, Clone)]
pub struct ReportJob {
    /// Results of a fit.
    pub fit: Document,
    /// Results of a test of a hypothesis within the same model.
    pub test: Option<Document>,
    /// File for the page, which is handed back when none.
    pub out: Option<PathBuf>,
}

/// Draw a figure of a fit.
#[derive(Debug, Clone)]
pub struct PlotJob {
    /// Results of a fit.
    pub fit: Document,
    /// What the figure shows.
    pub what: PlotKind,
    /// The model, for figures of records.
    pub model: Option<ModelJob>,
    /// The data, for figures of records.
    pub data: Vec<Datum>,
    /// The test whose record is shown; the least probable when none.
    pub test: Option<String>,
    /// Width in points of a screen.
    pub width: u32,
    /// The file, whose ending says its format.
    pub out: PathBuf,
}

/// What a job ends with that had good input.
#[derive(Debug)]
pub struct JobDone<R> {
    /// Its results.
    pub record: R,
    /// What the user should know, and the results do not say.
    pub notes: Vec<String>,
    /// The files of the results, as the user named them.
    pub written: Vec<String>,
    /// What is wrong with files that could not be written, where others were: nothing that was done is lost for them.
    pub unwritten: Vec<String>,
}

impl<R> JobDone<R> {
    /// All that was asked for is written.
    pub(crate) fn new(record: R, notes: Vec<String>, written: Vec<String>) -> JobDone<R> {
        JobDone { record, notes, written, unwritten: Vec::new() }
    }
}

impl<R: Serialize> JobDone<R> {
    /// Results that are written as they are, where a file is named.
    pub(crate) fn in_json(record: R, notes: Vec<String>, output: Option<&OutputFile>) -> Result<JobDone<R>, Failure> {
        output.map_or(Ok(()), |output| output.write(&record))?;
        Ok(JobDone::new(record, notes, output.map(OutputFile::name).into_iter().collect()))
    }
}

/// A table that was made.
#[derive(Debug)]
pub struct ExchangedTable {
    /// Number of its rows.
    pub rows: usize,
    /// What a row is, in words.
    pub row: &'static str,
    /// Number of tests in it.
    pub tests: usize,
    /// The Parquet file, when none was asked for: it has no name.
    pub table: Option<File>,
}

/// An ensemble that was drawn.
#[derive(Debug)]
pub struct SimulatedEnsemble {
    /// Number of tests.
    pub tests: u64,
    /// Number of rows.
    pub rows: u64,
    /// The file of the true initial states, as the user named it.
    pub states: Option<String>,
    /// Name of the column that tells tests apart, where the model names none.
    pub added: Option<String>,
    /// The Arrow IPC file, when none was asked for: it has no name.
    pub table: Option<File>,
    /// (test, true initial state), when no file was asked for: the states of phases that a test lacks are left out at the end.
    pub initial: Vec<(String, Vec<f64>)>,
    /// Names of those states.
    pub state_names: Vec<String>,
}

/// Files that are read, which no output may replace.
pub(crate) fn files<'a>(documents: &[&'a Document], inputs: &'a [Input]) -> Vec<&'a Path> {
    let data = inputs.iter().filter_map(Input::path);
    documents.iter().filter_map(|document| document.path()).chain(data).collect()
}
