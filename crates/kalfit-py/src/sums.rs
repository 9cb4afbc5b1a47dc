//! Fits by sums: what tests say in one place, and what is asked next.

use kalfit_job::sums::{self, JoinedSums, SiteSums, Theta};
use kalfit_job::{Unwatched, words};
use pyo3::prelude::*;

use crate::data::{PyDatum, data};
use crate::errors::exception;
use crate::fit::Results;
use crate::options::{ModelOptions, pick};
use crate::run::{RunOptions, pool, run};
use crate::text::text;

/// The tests of one place, read: it answers what is asked of them, on so many threads.
#[pyclass(frozen, name = "Site", module = "kalfit._kalfit")]
pub(crate) struct PySite {
    site: sums::SumsSite,
    pool: rayon::ThreadPool,
}

#[pymethods]
impl PySite {
    #[new]
    fn open(py: Python<'_>, model: ModelOptions, given: Vec<PyDatum<'_>>, threads: usize) -> PyResult<PySite> {
        let (model, given, pool) = (model.into(), data(given)?, pool(Some(threads))?);
        py.detach(|| {
            let site = pool.install(|| sums::SumsSite::open(&model, &given, &mut Unwatched));
            Ok(PySite { site: site.map_err(|failure| exception(&failure))?, pool })
        })
    }

    /// Number of tests.
    fn __len__(&self) -> usize {
        self.site.tests()
    }

    /// The sums that are asked for, as JSON.
    fn answer(&self, py: Python<'_>, theta: &str) -> PyResult<String> {
        py.detach(|| {
            let theta = Theta::of_text("theta", theta).map_err(|failure| exception(&failure))?;
            let sums = self.pool.install(|| self.site.answer(theta, "theta"));
            let sums = sums.map_err(|failure| exception(&failure))?;
            text(&sums)
        })
    }
}

/// What is asked first, as JSON: all of θ, and what of it a place needs.
#[pyfunction]
pub(crate) fn first_theta(model: ModelOptions) -> PyResult<(String, String)> {
    let theta = sums::first(&model.into()).map_err(|failure| exception(&failure))?;
    Ok((text(&theta)?, text(&theta.bare())?))
}

/// What is asked next, if anything is, and the fit, if the search has ended.
type NextRound = (Option<(String, String)>, Option<Results>);

/// Goes on with the sums of all places, in their order.
#[pyfunction]
pub(crate) fn join(
    py: Python<'_>,
    model: ModelOptions,
    criterion: &str,
    theta: &str,
    given: Vec<String>,
    how: RunOptions<'_>,
) -> PyResult<NextRound> {
    let criterion = pick("criterion", criterion, words::CRITERIA)?;
    let theta = Theta::of_text("theta", theta).map_err(|failure| exception(&failure))?;
    let one = |text: &String| SiteSums::of_text("sums", text).map_err(|failure| exception(&failure));
    let given: Vec<SiteSums> = given.iter().map(one).collect::<PyResult<_>>()?;
    let model = model.into();
    let joined = run(py, how, move |watch| sums::of_partitions((&model, criterion), theta, &given, watch))?.result;
    Ok(match joined {
        JoinedSums::Asks(theta) => (Some((text(&*theta)?, text(&theta.bare())?)), None),
        JoinedSums::Ends(record) => (None, Some(Results::new(*record))),
    })
}
