//! Why a command ended: what a library said, and where the user should look.

use std::ops::Range;

use kalfit::apply::ApplyError;
use kalfit::compare::CompareError;
use kalfit::dynamic::DynamicError;
use kalfit::dynamic::DynamicRatioError;
use kalfit::estimate::FitError;
use kalfit::export::ExportError;
use kalfit::infer::{Element, NotNested};
use kalfit::plan::PlanError;
use kalfit::predict::PredictError;
use kalfit::record::{FIT_SCHEMA, MixedGroup};
use kalfit::reduce::{ReduceError, SplitError};
use kalfit::simulate::SimulateError;
use kalfit::validate::NotComparable;
use kalfit::validate::{FoldsError, ValidateError};
use kalfit_data::{DataError, DataReading, MOST_ROWS, WriteError, bytes_in_words};
use kalfit_spec::{Spec, SpecError};

use crate::output::OutputError;
use crate::plan::error::BestPlanError;
use crate::results::ResultError;
use crate::sums::error::SumsError;
use crate::truth::error::TruthError;

/// A unit that a fit does not know.
#[derive(Debug, thiserror::Error)]
#[error("test `{test}` is of {level} `{unit}`, which is not in `{path}`: {known}")]
pub struct UnknownUnit {
    /// The test.
    pub test: String,
    /// Name of its innermost level of groups.
    pub level: String,
    /// The group.
    pub unit: String,
    /// The results.
    pub path: String,
    /// What is there.
    pub known: String,
}

/// Bad input, or a world that does not let us write. Exit status 2.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Failure {
    /// The model file.
    #[error("{error}")]
    Model {
        /// What is wrong.
        error: Box<SpecError>,
        /// The file and its text, when it could be read.
        file: Option<SourceText>,
    },
    /// An assignment of `--set`.
    #[error("{error}")]
    Set {
        /// What is wrong.
        error: Box<SpecError>,
    },
    /// The data.
    #[error("{error}")]
    Data {
        /// What is wrong.
        error: Box<DataError>,
        /// Where the model uses what the data lack.
        place: Option<Box<SourcePlace>>,
    },
    /// Rows that are not of the model's phases.
    #[error("{}", split_message(error, reading))]
    Split {
        /// What is wrong.
        error: SplitError,
        /// What was read so far.
        reading: Box<DataReading>,
    },
    /// The model does not work on the data.
    #[error("{}", reduce_message(error, reading.as_deref()))]
    Reduce {
        /// What is wrong.
        error: ReduceError,
        /// What was read so far.
        reading: Option<Box<DataReading>>,
    },
    /// A test of several groups.
    #[error("{0}")]
    MixedGroup(MixedGroup),
    /// Groups that cannot be compared.
    #[error("cannot test whether groups differ: {problem}")]
    GroupTest {
        /// Why.
        problem: &'static str,
        /// What to do about it.
        hint: &'static str,
    },
    /// The estimator.
    #[error("{0}")]
    Fit(FitError),
    /// Sums that cannot be made, or not be put together.
    #[error("{0}")]
    Sums(Box<SumsError>),
    /// The search for dynamic parameters.
    #[error("{0}")]
    Dynamic(Box<DynamicError>),
    /// A hypothesis that cannot be tested within the model.
    #[error("cannot test this hypothesis: {0}")]
    NotNested(NotNested),
    /// The same, where dynamic parameters are estimated.
    #[error("cannot test this hypothesis: {0}")]
    DynamicRatio(DynamicRatioError),
    /// A hypothesis that does not leave a parameter as the model has it.
    #[error("parameter `{name}` is not the same in the hypothesis as in the model, which has it fixed")]
    HypothesisParameter {
        /// Name of the parameter.
        name: String,
    },
    /// The population to draw from or to plan for.
    #[error("{0}")]
    Truth(Box<TruthError>),
    /// The ensemble cannot be drawn.
    #[error("{}", simulate_message(error, reading.as_deref()))]
    Simulate {
        /// What is wrong.
        error: Box<SimulateError>,
        /// What was read so far.
        reading: Option<Box<DataReading>>,
    },
    /// The model is not applied.
    #[error("{0}")]
    Apply(Box<ApplyError>),
    /// Nothing is predicted.
    #[error("{0}")]
    Predict(Box<PredictError>),
    /// A unit that the fit does not know.
    #[error("{0}")]
    UnknownUnit(Box<UnknownUnit>),
    /// A test of groups whose covariance the fit does not hold.
    #[error("{path} does not hold how the unit of test `{test}` and the levels that it meets are known together")]
    UnknownTogether {
        /// The test.
        test: String,
        /// The results.
        path: String,
    },
    /// Known units of a model without units.
    #[error("`--units known` has no effect: {why}")]
    NoUnits {
        /// Why.
        why: &'static str,
    },
    /// What is not done where groups of tests cross.
    #[error("{what} where groups of tests cross (`crossed` in `[data]`)")]
    Crossed {
        /// What is refused, as the beginning of a sentence.
        what: &'static str,
        /// What to do.
        hint: &'static str,
    },
    /// A table of rows of a fit that did not examine single measurements.
    #[error("`--rows` has nothing to write: {why}")]
    NoRows {
        /// Why.
        why: &'static str,
    },
    /// No limits by profile likelihood.
    #[error("limits by profile likelihood are not possible: {why}")]
    NoProfile {
        /// Why.
        why: String,
        /// What to do.
        hint: &'static str,
    },
    /// There are no folds.
    #[error("{0}")]
    Folds(Box<FoldsError>),
    /// Reductions and estimates tell neither innovations nor columns.
    #[error("tests are validated from their measurements, and some of them are given by reductions or estimates")]
    FoldsOfRows,
    /// Two models are validated on what can be read once.
    #[error("standard input can be read only once, and `--against` validates a second model on the same data")]
    AgainstStdin,
    /// The model is not validated.
    #[error("{0}")]
    Validate(Box<ValidateError>),
    /// Two models that do not predict the same.
    #[error("`{path}` cannot be compared: {error}")]
    NotComparable {
        /// Why.
        error: Box<NotComparable>,
        /// The other model.
        path: String,
    },
    /// There is no filter of constant matrices.
    #[error("{0}")]
    Export(Box<ExportError>),
    /// A column that is given no value.
    #[error("found `--at {found}`, expected a column and its value")]
    NoColumnValue {
        /// What was given.
        found: String,
    },
    /// A step that is given, and data that have one.
    #[error("a step is given beside data, whose records have steps of their own")]
    StepBesideData,
    /// A file whose ending does not say what is to be in it.
    #[error("what `{path}` is to hold is not said")]
    NoExportFormat {
        /// The file.
        path: String,
    },
    /// Fits that do not compare.
    #[error("{0}")]
    Compare(CompareError),
    /// Results to compare.
    #[error("{0}")]
    Compared(Box<ResultError>),
    /// There is no plan.
    #[error("{}", plan_message(error, states))]
    Plan {
        /// What is wrong.
        error: Box<PlanError>,
        /// Names of the estimated states.
        states: Vec<String>,
    },
    /// A plan of which no ensemble can be drawn.
    #[error("no ensemble can be drawn for the plan `{path}`: {problem}")]
    PlanToDraw {
        /// The file.
        path: String,
        /// What is wrong.
        problem: String,
    },
    /// A variable that is no number of rows.
    #[error("the variable {MOST_ROWS} is `{found}`, expected a number of rows")]
    RowsVariable {
        /// What it holds.
        found: String,
    },
    /// Tests that take more memory than there is.
    #[error(
        "the work on {tests} tests needs about {} of memory, and {} are left", bytes_in_words(*needed), bytes_in_words(*available)
    )]
    MemoryOfTests {
        /// Number of tests.
        tests: u64,
        /// Bytes that are needed.
        needed: u64,
        /// Bytes that are left.
        available: u64,
    },
    /// There is no best plan.
    #[error("{0}")]
    BestPlan(Box<BestPlanError>),
    /// The table to write.
    #[error("{}", write_message(error, path))]
    Write {
        /// What is wrong.
        error: Box<WriteError>,
        /// The file.
        path: String,
    },
    /// The output file.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// Results to report.
    #[error("{0}")]
    Report(Box<ResultError>),
    /// A figure that cannot be drawn.
    #[error("{0}")]
    Plot(kalfit_report::PlotError),
    /// A figure of a model file, which has no estimates.
    #[error("found a model, expected results of `kalfit fit`")]
    PlotOfModel,
    /// A figure of records, without them.
    #[error("this figure needs the model and the data, which the results do not contain")]
    RecordsWithoutData,
    /// A model, data or a test, which a figure has no use for.
    #[error("`--model`, `--test` and data go with `--what records`, `residuals`, `quantiles` and `allan` only")]
    IdlePlotData,
    /// Standard errors that a criterion does not have.
    #[error("`--std-errors expected` and `--std-errors sandwich` go with `--criterion ml` only")]
    RestrictedErrors,
    /// Degrees of freedom, which a criterion does not have.
    #[error("`--df kenward-roger` and `--df satterthwaite` go with `--criterion reml` only")]
    UnrestrictedDf,
    /// Numbers of groups of a level, more than once.
    #[error("numbers of groups of level `{level}` are given more than once")]
    GroupsTwice {
        /// The level.
        level: String,
    },
    /// Numbers of groups of a level that the model does not have.
    #[error("found groups of `{found}`, expected {}", levels_of(expected))]
    UnknownLevel {
        /// The name.
        found: String,
        /// The levels of the model.
        expected: Vec<String>,
    },
    /// No numbers of groups of a level.
    #[error("how many groups of level `{level}` is not said")]
    NoGroups {
        /// The level.
        level: String,
    },
    /// More tests than the design of tests in groups has.
    #[error(
        "found {found} tests to draw, expected at most the {expected} of the design: the model has levels of groups"
    )]
    MoreThanDesign {
        /// Tests asked for.
        found: u64,
        /// Tests of the design.
        expected: u64,
    },
    /// An option of the search for dynamic parameters, none of which is free.
    #[error("`{option}` has no effect: the model has no free parameters")]
    NoFreeParameter {
        /// The option.
        option: &'static str,
    },
    /// A way to put phases together, of which there is but one.
    #[error("`--phases {found}` has no effect: the model has one phase")]
    OnePhase {
        /// What was asked for.
        found: &'static str,
    },
    /// An exchange file of another kind.
    #[error("the output `{path}` is no name of a Parquet file, expected one that ends in `.parquet`")]
    NotParquet {
        /// The file.
        path: String,
    },
    /// Rows of a phase of which there are no estimates.
    #[error("{at}: found rows of phase `{phase}`, which has no `[filter]`, expected rows of phases with one")]
    NoFilter {
        /// Name of the phase.
        phase: String,
        /// File and row.
        at: String,
    },
    /// A reduction among what estimates are to be made of.
    #[error("{at}: found a reduction, of which no estimates can be made, expected rows or estimates")]
    NotEstimates {
        /// File and row.
        at: String,
    },
    /// Nobody waits any longer.
    #[error("the work was interrupted")]
    Interrupted,
    /// More memory than there is.
    #[error(
        "the fit of a model with {states} estimated states needs about {} of memory, and there are {}",
        bytes_in_words(*needed),
        bytes_in_words(*available)
    )]
    Memory {
        /// Estimated states.
        states: usize,
        /// Bytes that a fit needs.
        needed: u64,
        /// Bytes that may be had.
        available: u64,
    },
    /// Less memory than any work takes.
    #[error("less than {} of memory can be had", bytes_in_words(*needed))]
    NoRoom {
        /// Bytes that the least work takes.
        needed: u64,
    },
    /// Instructions that the machine does not have.
    #[error("{set}: found `{word}`, expected one of `{}` on this machine", machine.join("`, `"))]
    Instructions {
        /// The option or the variable that asked for them.
        set: &'static str,
        /// What was asked for.
        word: String,
        /// Words for those that there are.
        machine: Vec<&'static str>,
    },
    /// A variable of the environment that asks for no number of threads.
    #[error("the variable RAYON_NUM_THREADS is `{found}`, expected a number from 1 to {most}")]
    ThreadsVariable {
        /// What it is.
        found: String,
        /// The most threads that may be asked for.
        most: usize,
    },
    /// Threads.
    #[error("cannot start {threads} threads: {reason}")]
    Threads {
        /// How many.
        threads: usize,
        /// What the system said.
        reason: String,
    },
}

/// A text file, for showing places in it.
#[derive(Debug, Clone)]
pub struct SourceText {
    /// What messages call it.
    pub name: String,
    /// All of it.
    pub text: String,
}

/// Bytes of a text file.
#[derive(Debug, Clone)]
pub struct SourcePlace {
    /// The file.
    pub source: SourceText,
    /// The bytes.
    pub span: Range<usize>,
    /// What is said of them.
    pub label: Option<String>,
}

impl SourcePlace {
    /// A place in a model file.
    fn in_model(spec: &Spec, span: Option<Range<usize>>, label: &str) -> Option<Box<SourcePlace>> {
        let source = SourceText { name: spec.name.clone(), text: spec.text.clone() };
        Some(Box::new(SourcePlace { source, span: span?, label: Some(label.to_owned()) }))
    }
}

impl Failure {
    /// Wrong data, pointing into the model when that names a column they do not have.
    pub(crate) fn data(mut error: DataError, spec: &Spec) -> Failure {
        let place = match &mut error {
            DataError::MissingColumn { column, columns, .. } => {
                columns.elsewhere = spec.nearest_name(column);
                SourcePlace::in_model(spec, spec.column_span(column), "this column is not in the data")
            }
            _ => None,
        };
        Failure::Data { error: Box::new(error), place }
    }

    /// A model that cannot be read from this path.
    pub(crate) fn model(error: SpecError, name: &str, text: Option<String>) -> Failure {
        let file = text.map(|text| SourceText { name: name.to_owned(), text });
        Failure::Model { error: Box::new(error), file }
    }

    /// Where to look.
    pub fn place(&self) -> Option<SourcePlace> {
        match self {
            Failure::Model { error, file } => {
                Some(SourcePlace { source: file.clone()?, span: error.span.clone()?, label: error.label.clone() })
            }
            Failure::Data { place, .. } => place.as_deref().cloned(),
            _ => None,
        }
    }

    /// What to do about it.
    pub fn hint(&self) -> Option<String> {
        match self {
            Failure::Model { error, .. } | Failure::Set { error } => error.hint.clone(),
            Failure::Data { error, .. } => error.hint(),
            Failure::Split { error, .. } => Some(error.hint().to_owned()),
            Failure::Reduce { error, .. } => error.hint().map(str::to_owned),
            Failure::Fit(error) => fit_hint(error).map(str::to_owned),
            Failure::Sums(error) => error.hint().map(str::to_owned),
            Failure::Dynamic(error) => error.hint().map(str::to_owned),
            Failure::NotNested(error) => Some(nesting_hint(*error).to_owned()),
            Failure::NoRows { .. } => {
                Some("leave out `--innovations off`, and give the tests by their measurements".to_owned())
            }
            Failure::DynamicRatio(error) => dynamic_ratio_hint(error).map(str::to_owned),
            Failure::Truth(error) => error.hint(),
            Failure::Simulate { error, .. } => error.hint().map(str::to_owned),
            Failure::Apply(error) => apply_hint(error).map(str::to_owned),
            Failure::Export(error) => error.hint(),
            Failure::Compare(error) => Some(error.hint().to_owned()),
            Failure::Plan { error, .. } => plan_hint(error).map(str::to_owned),
            Failure::BestPlan(error) => error.hint(),
            Failure::Write { error, .. } => write_hint(error).map(str::to_owned),
            Failure::Output(error) => error.hint().map(str::to_owned),
            Failure::Report(error) => report_hint(error).map(str::to_owned),
            Failure::GroupsTwice { level } => Some(format!("give all of them at once: `--groups {level}=5,10,20`")),
            Failure::NoGroups { level } => Some(format!("give them: `--groups {level}=5,10,20`")),
            of_command => of_command.command_hint().map(str::to_owned),
        }
    }

    /// What to do about what a command finds itself, not the error of a part of its work.
    fn command_hint(&self) -> Option<&'static str> {
        Some(match self {
            Failure::MixedGroup(_) => {
                "group by a column that is constant within a test, or make each of its texts a test of its own"
            }
            Failure::GroupTest { hint, .. } | Failure::NoProfile { hint, .. } => hint,
            Failure::HypothesisParameter { .. } => "a hypothesis restricts what the model leaves free",
            Failure::UnknownUnit(_) => "`--units new` predicts tests of units that nobody has seen",
            Failure::UnknownTogether { .. } => {
                "fits of very many units and levels leave it out, and so does `--no-tests`; at new levels a unit is predicted from such a fit, too"
            }
            Failure::NoUnits { .. } | Failure::OnePhase { .. } => "leave it out",
            Failure::Crossed { hint, .. } => hint,
            Failure::Folds(error) if matches!(**error, FoldsError::Apart { .. }) => {
                "a fold holds whole groups: name a column that is the same for all tests of one"
            }
            Failure::FoldsOfRows => "give the measurements",
            Failure::AgainstStdin => "put the data in a file, and name it in the place of `-`",
            Failure::NotComparable { .. } => {
                "log densities are compared of the same measured values: both models must use the same columns"
            }
            Failure::NoColumnValue { .. } => "write `--at temperature=20`",
            Failure::StepBesideData => "leave one of them out",
            Failure::NoExportFormat { .. } => {
                "say it by `--as json`, `npz`, `mat`, `c` or `python`, or by an ending: `.json`, `.npz`, `.mat`, `.h`, `.py`"
            }
            Failure::Compared(error)
                if matches!(**error, ResultError::NotARecord { .. } | ResultError::Schema { .. }) =>
            {
                "`kalfit compare` takes what `kalfit fit --out` writes"
            }
            Failure::RecordsWithoutData => {
                "write `kalfit plot fit.json data.csv --what records --model model.toml --out records.svg`"
            }
            Failure::IdlePlotData => "leave them out: other figures are drawn from the results alone",
            Failure::PlotOfModel => "give the file that `kalfit fit --out` wrote",
            Failure::RestrictedErrors => {
                "leave `--std-errors` out: the restricted likelihood has those of its own curvature"
            }
            Failure::UnrestrictedDf => {
                "add `--criterion reml`: degrees of freedom are those of the restricted likelihood, which is the one for few tests"
            }
            Failure::MoreThanDesign { .. } => {
                "give a design with as many groups and tests as are wanted: new groups need names of their own"
            }
            Failure::PlanToDraw { .. } => {
                "a plan of `kalfit plan --candidates … --out` for a model without levels goes with its candidates as `--design`"
            }
            Failure::RowsVariable { .. } => "set it to the most rows that a file may hold, or take it away",
            Failure::MemoryOfTests { .. } => {
                "leave results of single tests out (`--no-tests`), fit a part of the tests, or use `kalfit sums` on parts"
            }
            Failure::NoFreeParameter { .. } => {
                "leave it out, or free a parameter in `[parameters]`: `{}` or `{ start = 1 }`"
            }
            Failure::NoFilter { .. } => {
                "leave these rows out, they may stand beside the estimates as they are; or use `kalfit reduce`, which takes any phase"
            }
            Failure::NotEstimates { .. } => "leave the file out: it may stand beside the estimates",
            Failure::Memory { .. } => {
                "half the states take a sixteenth of it; a state with `initial = \"stationary\"` or `initial = { mean = …, sigma = … }` is not estimated"
            }
            Failure::NoRoom { .. } => "raise the limit of the process, which `ulimit -v` shows",
            Failure::Instructions { .. } => {
                "all machines that are to give the same bits need the same instructions; `portable` is everywhere"
            }
            Failure::Threads { .. } => "ask for fewer with `--threads`",
            Failure::ThreadsVariable { .. } => {
                "set it to a number, or take it away: `--threads` says how many are used"
            }
            _ => return None,
        })
    }
}

/// As [`reduce_message`], for what is drawn.
fn simulate_message(error: &SimulateError, reading: Option<&DataReading>) -> String {
    match (error, reading) {
        (SimulateError::Reduce(error), reading) => reduce_message(error, reading),
        (SimulateError::SharedCell { row, .. } | SimulateError::NotFinite { row, .. }, Some(reading)) => {
            format!("{}: {error}", reading.place(*row))
        }
        _ => error.to_string(),
    }
}

/// The core knows states by their places only.
fn plan_message(error: &PlanError, states: &[String]) -> String {
    let name = |i: usize| states.get(i).map_or("?", String::as_str);
    match error {
        PlanError::OffStructure { element, found, expected } => {
            let element = match *element {
                Element::Mean(i) => format!("mean[{}]", name(i)),
                Element::Covariance(i, j) => format!("covariance[{}, {}]", name(j), name(i)),
            };
            format!("{element} is {found} in the population, and the model makes it {expected}")
        }
        _ => error.to_string(),
    }
}

fn plan_hint(error: &PlanError) -> Option<&'static str> {
    match error {
        PlanError::OffStructure { .. } => {
            Some("plan with values that obey the model, such as a fit of this very model")
        }
        PlanError::Design(error) => fit_hint(error),
        _ => None,
    }
}

fn report_hint(error: &ResultError) -> Option<&'static str> {
    match error {
        ResultError::NotARecord { command: "fit", .. } | ResultError::Schema { expected: FIT_SCHEMA, .. } => {
            Some("give a file that `kalfit fit --out` wrote")
        }
        ResultError::NotARecord { .. } | ResultError::Schema { .. } => {
            Some("`--test` takes what `kalfit test --out` writes")
        }
        ResultError::Unreadable { .. } | ResultError::TooLarge { .. } => None,
    }
}

/// What the libraries say of a write does not name the file.
fn write_message(error: &WriteError, path: &str) -> String {
    match error {
        WriteError::Format { .. } | WriteError::IdInUse { .. } => error.to_string(),
        _ => format!("cannot write `{path}`: {error}"),
    }
}

fn write_hint(error: &WriteError) -> Option<&'static str> {
    match error {
        WriteError::IdInUse { .. } => Some("ask for no more tests than the design has"),
        _ => None,
    }
}

/// The core knows rows by number only.
fn split_message(error: &SplitError, reading: &DataReading) -> String {
    let place = format!("{} (test `{}`)", reading.place(error.at()), error.test());
    match error {
        SplitError::MissingCell { column, phases, .. } => {
            format!("{place}: the cell of phase column `{column}` is empty, expected {}", phases.join(", "))
        }
        SplitError::UnknownPhase { column, found, phases, .. } => {
            format!("{place}: found phase `{found}` in column `{column}`, expected {}", phases.join(", "))
        }
        SplitError::MissingPhase { missing, later, .. } => {
            format!("{place}: phase `{later}` follows phase `{missing}`, of which the test has no row")
        }
    }
}

/// The core knows rows by number only; the reading knows their files, and the texts behind labels.
fn reduce_message(error: &ReduceError, reading: Option<&DataReading>) -> String {
    let (Some(reading), Some(row)) = (reading, error.row) else { return error.to_string() };
    let test = error.test.as_ref().map_or(String::new(), |test| format!(" (test `{test}`)"));
    format!("{}{test}: {}: {}", reading.place(row), error.what, kind_message(error, reading))
}

fn kind_message(error: &ReduceError, reading: &DataReading) -> String {
    use kalfit::reduce::{Cell, ReduceErrorKind as Kind};
    let text = |cell: &Cell| match cell {
        Cell::Text(label) => format!("`{}`", reading.labels.text(*label)),
        Cell::Number(_) => cell.to_string(),
    };
    match &*error.kind {
        Kind::NoLevel { parameter, level } => {
            format!("parameter `{parameter}` has no value for level `{}`", reading.labels.text(*level))
        }
        Kind::Varies { column, first, second } => {
            format!("column `{column}` varies within the test: {} and {}", text(first), text(second))
        }
        Kind::StepConflict { column, first, second } => {
            format!("rows of one step disagree in column `{column}`: {} and {}", text(first), text(second))
        }
        kind => kind.to_string(),
    }
}

fn nesting_hint(error: NotNested) -> &'static str {
    match error {
        NotNested::Same => "a hypothesis adds constraints to the model's",
        NotNested::Mean | NotNested::Covariance => {
            "keys of the hypothesis replace the model's whole, so repeat in them the constraints that the model has"
        }
        NotNested::Restricted => "compare likelihoods instead",
        NotNested::Marginal => "use `--phases chain`",
        NotNested::Different => "give both the same states",
    }
}

fn dynamic_ratio_hint(error: &DynamicRatioError) -> Option<&'static str> {
    use kalfit::infer::NotNestedParameter as Parameter;
    match error {
        DynamicRatioError::Structure(error) => Some(nesting_hint(*error)),
        DynamicRatioError::Parameter(Parameter::Fixed { .. }) => {
            Some("a hypothesis restricts what the model leaves free")
        }
        DynamicRatioError::Parameter(Parameter::Levels { .. }) => {
            Some("a hypothesis has as many values as the model, or fewer")
        }
        DynamicRatioError::Parameter(Parameter::OutOfBounds { .. }) => Some("widen the bounds in the model"),
        DynamicRatioError::Parameter(Parameter::Bounds { .. }) => Some(
            "a parameter of the hypothesis replaces the model's whole, so repeat in it the bounds that the model has",
        ),
        DynamicRatioError::Fit(error) => fit_hint(error),
    }
}

/// What levels there are.
fn levels_of(names: &[String]) -> String {
    if names.is_empty() {
        return "none: the model has no levels of groups".to_owned();
    }
    let names: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
    format!("those of {}", names.join(", "))
}

fn apply_hint(error: &ApplyError) -> Option<&'static str> {
    match error {
        ApplyError::NoRows { .. } => Some("leave `--states` out: what is known of such a phase are its estimates"),
        _ => None,
    }
}

fn fit_hint(error: &FitError) -> Option<&'static str> {
    match error {
        FitError::DuplicateTest { .. } => Some("give each test an id of its own"),
        FitError::NotFinite => Some("give start values in `[mean]` and `[covariance]` nearer to what is expected"),
        FitError::NotMonotone { .. } => Some("choose units in which the states are of comparable size"),
        FitError::NoPhases { .. } | FitError::RestrictedMarginal => Some("use `--phases chain`"),
        FitError::Ungrouped { .. } => Some("give the rows of the test, which name its groups"),
        FitError::ExactInGroups { .. } => Some("give the measurement some noise"),
        FitError::ManyLevels { .. } => Some(
            "without `levels` the largest factor is eliminated first; else leave out the factor with most levels, or fit parts of the \
             data that share no level",
        ),
        FitError::Unbounded { .. } => {
            Some("give the measurement some noise, or use more tests or a simpler covariance, such as a diagonal one")
        }
        FitError::NoTests | FitError::Structure(_) => None,
    }
}
