//! Results of a fit, held as they are: words are made of them when somebody asks.

use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use kalfit::FitRecord;
use kalfit_job::FitTableKind;
use kalfit_report::{TextStyle, summary};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::errors::{exception, not_written};
use crate::table::PyTable;
use crate::text::{text, written};

/// The record of a fit. Python asks it for JSON of what it wants to see, so that a summary of a million tests parses none of them.
#[pyclass(frozen, module = "kalfit._kalfit")]
pub(crate) struct Results(Mutex<FitRecord>);

impl Results {
    pub(crate) fn new(record: FitRecord) -> Results {
        Results(Mutex::new(record))
    }

    fn record(&self) -> MutexGuard<'_, FitRecord> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Results {
    /// From the JSON of a fit; `name` says in messages where it is from.
    #[new]
    fn read(name: &str, json: &str) -> PyResult<Results> {
        let record = kalfit_job::fit_record(name, json).map_err(|failure| exception(&failure))?;
        Ok(Results::new(record))
    }

    /// All of it, as kalfit writes it.
    fn json(&self, py: Python<'_>) -> PyResult<String> {
        py.detach(|| written(&*self.record()))
    }

    /// All but the tests.
    fn head(&self, py: Python<'_>) -> PyResult<String> {
        py.detach(|| {
            let mut record = self.record();
            let tests = std::mem::take(&mut record.tests);
            let head = text(&*record);
            record.tests = tests;
            head
        })
    }

    /// The list of the tests, or of every so-many-th of them.
    #[pyo3(signature = (every = 1))]
    fn tests(&self, py: Python<'_>, every: usize) -> PyResult<String> {
        py.detach(|| text(&self.record().tests.iter().step_by(every.max(1)).collect::<Vec<_>>()))
    }

    /// The list of all numbers of the population and of all parameters.
    fn quantities(&self, py: Python<'_>) -> PyResult<String> {
        py.detach(|| text(&self.record().quantities()))
    }

    /// A table as the command writes it: `tests`, `parameters`, `constraints` or `rows`.
    fn table(&self, py: Python<'_>, which: &str) -> PyResult<PyTable> {
        let which = match which {
            "tests" => FitTableKind::Tests,
            "parameters" => FitTableKind::Parameters,
            "constraints" => FitTableKind::Constraints,
            "rows" => FitTableKind::Rows,
            _ => return Err(PyValueError::new_err(format!("there is no table `{which}`"))),
        };
        let file = py.detach(|| kalfit_job::fit_table(&self.record(), which)).map_err(|failure| exception(&failure))?;
        PyTable::ipc(file)
    }

    /// Number of the tests.
    fn __len__(&self) -> usize {
        self.record().tests.len()
    }

    /// In words, as the command prints it.
    fn summary(&self, py: Python<'_>, width: usize, color: bool) -> String {
        py.detach(|| summary(&self.record(), &TextStyle { width, color }))
    }

    /// Writes fit.json, whole or not at all.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let saved = py.detach(|| kalfit_job::save(&mut self.record(), &path));
        saved.map_err(|error| not_written(&error))
    }

    /// Writes the HTML report, whole or not at all.
    fn report(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let saved = py.detach(|| kalfit_job::save_text(&kalfit_report::html(&self.record()), &path));
        saved.map_err(|error| not_written(&error))
    }
}
