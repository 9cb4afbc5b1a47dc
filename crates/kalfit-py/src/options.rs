//! What can be asked for, by the names that the command has for it.

use std::path::PathBuf;

use kalfit::dynamic::{self, Method};
use kalfit::estimate::{Combination, Criterion, Settings, Solver};
use kalfit::infer::{Choices, DeletionChoice, IntervalKind, StdErrors};
use kalfit_job::{Document, FitJob, ModelJob};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A text and where it comes from: what messages call it, the text itself, and the file that it was read from, if any.
#[derive(FromPyObject)]
pub(crate) struct Text(String, String, Option<PathBuf>);

impl From<Text> for Document {
    fn from(Text(name, text, file): Text) -> Document {
        Document::Text { name, text, file }
    }
}

/// A model and values of parameters, each as `name=value`.
#[derive(FromPyObject)]
pub(crate) struct Asked(Text, Vec<String>);

impl From<Asked> for ModelJob {
    fn from(Asked(text, set): Asked) -> ModelJob {
        ModelJob { document: text.into(), set }
    }
}

/// Options of a fit, as a dictionary.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct FitOptions {
    method: String,
    solver: String,
    criterion: String,
    phases: String,
    intervals: String,
    std_errors: String,
    deletion: String,
    innovations: bool,
    group_test: bool,
    starts: Option<u32>,
    seed: Option<u64>,
    tolerance: Option<f64>,
    max_iterations: Option<u32>,
    report: Option<PathBuf>,
}

impl FitOptions {
    /// Puts what was asked for into a job.
    pub(crate) fn apply(&self, job: &mut FitJob) -> PyResult<()> {
        let solver = pick("solver", &self.solver, &[("newton", Solver::Newton), ("em", Solver::Em)])?;
        job.settings = settings(solver, self.tolerance, self.max_iterations)?;
        let criteria = [("ml", Criterion::Ml), ("reml", Criterion::Reml)];
        job.settings.criterion = pick("criterion", &self.criterion, &criteria)?;
        let phases =
            [("chain", Combination::Chain), ("marginal", Combination::Marginal), ("stacked", Combination::Stacked)];
        job.settings.phases = pick("phases", &self.phases, &phases)?;
        job.choices = self.choices()?;
        job.innovations = self.innovations;
        job.group_test = self.group_test;
        job.report.clone_from(&self.report);
        let methods = [
            ("hybrid", Some(Method::Hybrid)),
            ("innovations", Some(Method::Innovations)),
            ("em", Some(Method::Em)),
            ("all", None),
        ];
        job.method = pick("method", &self.method, &methods)?;
        if self.starts.is_some_and(|starts| !(1..=10_000).contains(&starts)) {
            return Err(PyValueError::new_err("starts must be from 1 to 10000, or None"));
        }
        if self.seed.is_some() && self.starts.is_none() {
            return Err(PyValueError::new_err("seed has no effect without starts"));
        }
        job.search = dynamic::Settings {
            method: Method::Hybrid,
            inner: job.settings.clone(),
            starts: self.starts.unwrap_or(0) as usize,
            seed: self.seed.unwrap_or(1),
        };
        Ok(())
    }

    fn choices(&self) -> PyResult<Choices> {
        let std_errors =
            [("observed", StdErrors::Observed), ("expected", StdErrors::Expected), ("sandwich", StdErrors::Sandwich)];
        let deletions = [("auto", DeletionChoice::Cheap), ("all", DeletionChoice::All), ("none", DeletionChoice::None)];
        Ok(Choices {
            std_errors: pick("std_errors", &self.std_errors, &std_errors)?,
            intervals: pick(
                "intervals",
                &self.intervals,
                &[("wald", IntervalKind::Wald), ("profile", IntervalKind::Profile)],
            )?,
            deletion: pick("deletion", &self.deletion, &deletions)?,
            ..Choices::default()
        })
    }
}

/// Settings of a solver with what was asked for.
pub(crate) fn settings(solver: Solver, tolerance: Option<f64>, passes: Option<u32>) -> PyResult<Settings> {
    let mut settings = Settings::of(solver);
    if let Some(tolerance) = tolerance {
        if !(tolerance > 0.0 && tolerance <= 1.0) {
            return Err(PyValueError::new_err(format!(
                "tolerance is {tolerance}, expected a number above 0 and at most 1"
            )));
        }
        settings.tolerance = tolerance;
    }
    match passes {
        Some(0) => Err(PyValueError::new_err("max_iterations must be at least 1")),
        Some(passes) => Ok(Settings { max_passes: passes as usize, ..settings }),
        None => Ok(settings),
    }
}

/// The meaning of a word.
pub(crate) fn pick<T: Clone>(option: &str, word: &str, meanings: &[(&str, T)]) -> PyResult<T> {
    let found = meanings.iter().find(|(name, _)| *name == word);
    found.map(|(_, meaning)| meaning.clone()).ok_or_else(|| {
        let names: Vec<String> = meanings.iter().map(|(name, _)| format!("`{name}`")).collect();
        PyValueError::new_err(format!("{option} is `{word}`, expected one of {}", names.join(", ")))
    })
}
