//! What can be asked for, by the names that the command has for it.

use std::path::PathBuf;

use kalfit::dynamic::{self, Method};
use kalfit::estimate::{Settings, Solver};
use kalfit::infer::{Choices, DfChoice, TestsChoice};
use kalfit_job::words::{self, OptionWord};
use kalfit_job::{Document, FitJob, ModelJob};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A text and where it comes from: what messages call it, the text itself, and the file that it was read from, if any.
#[derive(FromPyObject)]
pub(crate) struct NamedText(String, String, Option<PathBuf>);

impl From<NamedText> for Document {
    fn from(NamedText(name, text, file): NamedText) -> Document {
        Document::Text { name, text, file }
    }
}

/// A model and values of parameters, each as `name=value`.
#[derive(FromPyObject)]
pub(crate) struct ModelOptions(NamedText, Vec<String>);

impl From<ModelOptions> for ModelJob {
    fn from(ModelOptions(text, set): ModelOptions) -> ModelJob {
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
    df: Option<String>,
    std_errors: String,
    deletion: String,
    innovations: bool,
    tests: bool,
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
        let solver = pick("solver", &self.solver, words::SOLVERS)?;
        job.settings = settings(solver, self.tolerance, self.max_iterations)?;
        job.settings.criterion = pick("criterion", &self.criterion, words::CRITERIA)?;
        job.settings.phases = pick("phases", &self.phases, words::PHASES)?;
        job.choices = self.choices()?;
        job.innovations = self.innovations && self.tests;
        job.group_test = self.group_test;
        job.report.clone_from(&self.report);
        job.method = pick("method", &self.method, words::METHODS)?;
        if self.starts.is_some_and(|starts| !(0..=10_000).contains(&starts)) {
            return Err(PyValueError::new_err("starts must be from 0 to 10000, or None"));
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
        Ok(Choices {
            std_errors: pick("std_errors", &self.std_errors, words::STD_ERRORS)?,
            intervals: pick("intervals", &self.intervals, words::INTERVALS)?,
            df: self.df.as_ref().map_or(Ok(DfChoice::Auto), |df| pick("df", df, words::DF))?,
            deletion: pick("deletion", &self.deletion, words::DELETIONS)?,
            tests: if self.tests { TestsChoice::Each } else { TestsChoice::None },
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
pub(crate) fn pick<T: Copy>(option: &str, word: &str, words: &[OptionWord<T>]) -> PyResult<T> {
    let found = words.iter().find(|own| own.word == word);
    found.map(|own| own.means).ok_or_else(|| {
        let names: Vec<String> = words.iter().map(|own| format!("`{}`", own.word)).collect();
        PyValueError::new_err(format!("{option} is `{word}`, expected one of {}", names.join(", ")))
    })
}
