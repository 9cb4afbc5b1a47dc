//! The jobs of the command, one function each. Notes are what the user should know beside the results.

use std::fs::File;
use std::path::PathBuf;

use kalfit::apply::StateKind;
use kalfit::estimate::Solver;
use kalfit::predict::{Limits, Sides};
use kalfit_job::words;
use kalfit_job::{
    AppliedModel, ApplyJob, BestPlanRequest, BootstrapChoice, CheckJob, CompareJob, DatasheetJob, DesignPlan,
    ExchangeJob, ExchangedTable, ExportJob, Failure, FitJob, FoldChoice, JobDone, JobWatch, PlanJob, PlanRequest,
    PredictJob, PredictedModel, SimulateJob, SimulatedEnsemble, SoFar, TableDestination, TestJob, ValidateJob,
};
use kalfit_report::{TextStyle, check_summary};
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::data::{PyDatum, data};
use crate::errors::exception;
use crate::fit::Results;
use crate::options::{FitOptions, ModelOptions, NamedText, pick, settings};
use crate::run::{JobEnd, RunOptions, run};
use crate::table::PyTable;
use crate::text::written;

/// (the fit, whether it was interrupted).
#[pyfunction]
pub(crate) fn fit(
    py: Python<'_>,
    model: ModelOptions,
    given: Vec<PyDatum<'_>>,
    out: Option<PathBuf>,
    options: FitOptions,
    how: RunOptions<'_>,
) -> PyResult<(Results, bool)> {
    let mut job = FitJob::new(model.into(), data(given)?);
    job.out = out;
    options.apply(&mut job)?;
    let JobEnd { result, interrupted } = run(py, how, move |watch| kalfit_job::fit(&job, watch))?;
    Ok((Results::new(result.record), interrupted))
}

/// (JSON of the check, its summary, notes).
#[pyfunction]
pub(crate) fn check(
    py: Python<'_>,
    model: ModelOptions,
    given: Vec<PyDatum<'_>>,
    how: RunOptions<'_>,
) -> PyResult<(String, String, Vec<String>)> {
    let job = CheckJob { model: model.into(), data: data(given)?, out: None };
    let done = whole(run(py, how, move |watch| kalfit_job::check(&job, watch))?)?;
    let summary = check_summary(&done.record, &TextStyle::default());
    Ok((written(&done.record)?, summary, done.notes))
}

/// (replicates of a bootstrap, its seed, tolerance, most passes).
type TestOptions = (Option<u32>, u64, Option<f64>, Option<u32>);

/// (JSON of the test, notes).
#[pyfunction]
pub(crate) fn test(
    py: Python<'_>,
    model: ModelOptions,
    given: Vec<PyDatum<'_>>,
    null: NamedText,
    options: TestOptions,
    out: Option<PathBuf>,
    how: RunOptions<'_>,
) -> PyResult<(String, Vec<String>)> {
    let (replicates, seed, tolerance, passes) = options;
    let job = TestJob {
        model: model.into(),
        data: data(given)?,
        null: null.into(),
        bootstrap: BootstrapChoice::of(replicates.map(|replicates| replicates as usize), seed),
        out,
        settings: settings(Solver::Newton, tolerance, passes)?,
    };
    let done = whole(run(py, how, move |watch| kalfit_job::test(&job, watch))?)?;
    Ok((written(&done.record)?, done.notes))
}

/// (JSON of the plan, notes).
#[pyfunction]
pub(crate) fn plan(
    py: Python<'_>,
    model: ModelOptions,
    from: NamedText,
    design: Vec<PyDatum<'_>>,
    many: (Vec<usize>, Vec<(String, Vec<usize>)>),
    out: Option<PathBuf>,
    how: RunOptions<'_>,
) -> PyResult<(String, Vec<String>)> {
    let (tests, groups) = many;
    let request = PlanRequest::Design(DesignPlan { design: data(design)?, tests, groups });
    planned(py, PlanJob { model: model.into(), from: from.into(), request, out }, how)
}

/// Cost of all tests, columns of cost and largest number, what is to be best known, and draws with their seed.
type PlanLimits = (f64, Option<String>, Option<String>, String, Option<(usize, u64)>);
/// Results of a fit that are known, data of tests that were made, and the file for the plan.
type PlanFiles<'py> = (Option<NamedText>, Option<Vec<PyDatum<'py>>>, PlanMission<'py>, Option<PathBuf>);
/// Data of a mission, and its outputs.
type PlanMission<'py> = (Vec<PyDatum<'py>>, Option<NamedText>);

/// (JSON of the best plan among candidates, notes).
#[pyfunction]
pub(crate) fn best_plan(
    py: Python<'_>,
    model: ModelOptions,
    from: NamedText,
    candidates: Vec<PyDatum<'_>>,
    limits: PlanLimits,
    files: PlanFiles<'_>,
    how: RunOptions<'_>,
) -> PyResult<(String, Vec<String>)> {
    let (budget, cost, most, goal, draws) = limits;
    let (fit, made, (mission, outputs), out) = files;
    let (mission, outputs) = (data(mission)?, outputs.map(Into::into));
    let so_far = match (fit, made) {
        (Some(fit), _) => Some(SoFar::Fit(fit.into())),
        (None, Some(made)) => Some(SoFar::Tests(data(made)?)),
        (None, None) => None,
    };
    let best =
        BestPlanRequest { candidates: data(candidates)?, budget, cost, most, goal, so_far, draws, mission, outputs };
    planned(
        py,
        PlanJob { model: model.into(), from: from.into(), request: PlanRequest::Best(Box::new(best)), out },
        how,
    )
}

fn planned(py: Python<'_>, job: PlanJob, how: RunOptions<'_>) -> PyResult<(String, Vec<String>)> {
    let done = whole(run(py, how, move |watch| kalfit_job::plan(&job, watch))?)?;
    Ok((written(&done.record)?, done.notes))
}

/// (JSON of the results, table of the tests, that of the states, notes); tables that went to files are not handed back.
type AppliedTuple = (String, Option<PyTable>, Option<PyTable>, Vec<String>);

/// Applies a fitted model to tests. `states`: what those are known from, if they are wanted.
#[pyfunction]
pub(crate) fn apply(
    py: Python<'_>,
    model: ModelOptions,
    given: Vec<PyDatum<'_>>,
    from: NamedText,
    states: Option<&str>,
    files: (Option<PathBuf>, Option<PathBuf>),
    how: RunOptions<'_>,
) -> PyResult<AppliedTuple> {
    let kind = states.map(|kind| pick("states", kind, words::KINDS)).transpose()?;
    let to = |file: Option<PathBuf>| file.map_or(TableDestination::Back, TableDestination::File);
    let job = ApplyJob {
        model: model.into(),
        data: data(given)?,
        from: from.into(),
        tests: to(files.0),
        states: kind.map_or(TableDestination::Nowhere, |_| to(files.1)),
        kind: kind.unwrap_or(StateKind::Smoothed),
    };
    let done = whole(run(py, how, move |watch| kalfit_job::apply(&job, watch))?)?;
    let AppliedModel { record, tests, states } = done.record;
    let table = |file: Option<File>| file.map(PyTable::ipc).transpose();
    Ok((written(&record)?, table(tests)?, table(states)?, done.notes))
}

/// (number of folds and seed, or a column; criterion).
type FoldOptions = (Option<(usize, u64)>, Option<String>, String);

/// Predicts tests by fits that were made without them: (JSON of the validation, notes).
#[pyfunction]
pub(crate) fn validate(
    py: Python<'_>,
    model: ModelOptions,
    given: Vec<PyDatum<'_>>,
    folds: FoldOptions,
    against: Option<NamedText>,
    out: Option<PathBuf>,
    how: RunOptions<'_>,
) -> PyResult<(String, Vec<String>)> {
    let (drawn, by, criterion) = folds;
    let (count, seed) = drawn.unwrap_or((10, 1));
    let job = ValidateJob {
        model: model.into(),
        data: data(given)?,
        folds: by.map_or(FoldChoice::Drawn { count, seed }, FoldChoice::Column),
        against: against.map(Into::into),
        criterion: pick("criterion", &criterion, words::CRITERIA)?,
        out,
    };
    let done = whole(run(py, how, move |watch| kalfit_job::validate(&job, watch))?)?;
    Ok((written(&done.record)?, done.notes))
}

/// (outputs, confidence, content, each limit by itself, whose tests).
type PredictOptions = (Option<NamedText>, f64, f64, bool, String);

/// Says what tests that nobody has made will give, of designs and perhaps the data of the fit: (JSON of the last rows, table, notes).
#[pyfunction]
pub(crate) fn predict(
    py: Python<'_>,
    model: ModelOptions,
    from: NamedText,
    given: (Vec<PyDatum<'_>>, Vec<PyDatum<'_>>),
    asks: PredictOptions,
    out: Option<PathBuf>,
    how: RunOptions<'_>,
) -> PyResult<(String, Option<PyTable>, Vec<String>)> {
    let (design, profile) = given;
    let (outputs, confidence, content, one_sided, units) = asks;
    let sides = if one_sided { Sides::One } else { Sides::Two };
    let job = PredictJob {
        model: model.into(),
        from: from.into(),
        design: data(design)?,
        outputs: outputs.map(Into::into),
        limits: Limits { confidence, content, sides },
        units: pick("units", &units, words::UNITS)?,
        profile: data(profile)?,
        out: out.map_or(TableDestination::Back, TableDestination::File),
    };
    let done = whole(run(py, how, move |watch| kalfit_job::predict(&job, watch))?)?;
    let PredictedModel { record, table } = done.record;
    Ok((written(&record)?, table.map(PyTable::ipc).transpose()?, done.notes))
}

/// (length of a step, columns with their values as `column=value`, phase).
type ExportOptions = (Option<f64>, Vec<String>, Option<String>);

/// (JSON of the filter that follows from a fit, notes).
#[pyfunction]
pub(crate) fn export(
    model: ModelOptions,
    from: NamedText,
    wanted: ExportOptions,
    format: Option<&str>,
    out: Option<PathBuf>,
) -> PyResult<(String, Vec<String>)> {
    let format = format.map(|format| pick("format", format, words::EXPORT_FORMATS)).transpose()?;
    let (step, at, phase) = wanted;
    let job = ExportJob { model: model.into(), from: from.into(), phase, step, at, format, out };
    let done = kalfit_job::export(&job).map_err(|failure| exception(&failure))?;
    Ok((written(&done.record)?, done.notes))
}

/// (JSON of the numbers of a datasheet, notes).
#[pyfunction]
pub(crate) fn datasheet(
    py: Python<'_>,
    model: ModelOptions,
    from: NamedText,
    given: Vec<PyDatum<'_>>,
    wanted: (Option<f64>, Vec<String>),
    out: Option<PathBuf>,
    how: RunOptions<'_>,
) -> PyResult<(String, Vec<String>)> {
    let (step, at) = wanted;
    let job = DatasheetJob { model: model.into(), from: from.into(), data: data(given)?, step, at, out };
    let done = whole(run(py, how, move |watch| kalfit_job::datasheet(&job, watch))?)?;
    Ok((written(&done.record)?, done.notes))
}

/// JSON of fits of the same data side by side.
#[pyfunction]
pub(crate) fn compare(fits: Vec<NamedText>, out: Option<PathBuf>) -> PyResult<String> {
    let job = CompareJob { fits: fits.into_iter().map(Into::into).collect(), out };
    let done = kalfit_job::compare(&job).map_err(|failure| exception(&failure))?;
    written(&done.record)
}

/// (the table unless it went to a file, number of tests, of rows, the true initial states unless the table went to a file, the
/// column that was added to tell tests apart, notes).
type SimulatedTuple = (Option<PyTable>, u64, u64, Option<PyTable>, Option<String>, Vec<String>);

/// Draws an ensemble.
#[pyfunction]
pub(crate) fn simulate(
    py: Python<'_>,
    model: ModelOptions,
    from: NamedText,
    design: Vec<PyDatum<'_>>,
    draw: (Option<u64>, Option<NamedText>, u64),
    files: (Option<PathBuf>, Option<PathBuf>),
    how: RunOptions<'_>,
) -> PyResult<SimulatedTuple> {
    let (model, from, design) = (model.into(), from.into(), data(design)?);
    let ((tests, plan, seed), (out, states)) = (draw, files);
    let plan = plan.map(Into::into);
    let job = SimulateJob { model, from, design, tests, plan, seed, out, states };
    let done = whole(run(py, how, move |watch| kalfit_job::simulate(&job, watch))?)?;
    let SimulatedEnsemble { tests, rows, added, table, initial, state_names, .. } = done.record;
    let states = table.is_some().then(|| PyTable::of_rows(&state_names, &initial)).transpose()?;
    Ok((table.map(PyTable::ipc).transpose()?, tests, rows, states, added, done.notes))
}

/// (the table unless it went to a file, number of rows, of tests, notes).
type ExchangedTuple = (Option<PyTable>, usize, usize, Vec<String>);

/// A job that makes an exchange file.
type ExchangeFunction = fn(&ExchangeJob, &mut dyn JobWatch) -> Result<JobDone<ExchangedTable>, Failure>;

/// Runs filters once and makes a table of what they leave: `reductions`, or `estimates` of the model's filters as they are.
#[pyfunction]
pub(crate) fn exchange(
    py: Python<'_>,
    what: &str,
    model: ModelOptions,
    given: Vec<PyDatum<'_>>,
    at: Option<NamedText>,
    out: Option<PathBuf>,
    how: RunOptions<'_>,
) -> PyResult<ExchangedTuple> {
    let make: ExchangeFunction = match what {
        "reductions" => kalfit_job::reduce,
        "estimates" => kalfit_job::estimates,
        _ => return Err(PyValueError::new_err(format!("what is `{what}`, expected `reductions` or `estimates`"))),
    };
    let job = ExchangeJob { model: model.into(), data: data(given)?, at: at.map(Into::into), out };
    let done = whole(run(py, how, move |watch| make(&job, watch))?)?;
    let ExchangedTable { rows, tests, table, .. } = done.record;
    Ok((table.map(PyTable::parquet).transpose()?, rows, tests, done.notes))
}

/// Nothing but a fit has a use for less than the whole.
fn whole<R>(JobEnd { result, interrupted }: JobEnd<R>) -> PyResult<R> {
    if interrupted { Err(PyKeyboardInterrupt::new_err(())) } else { Ok(result) }
}
