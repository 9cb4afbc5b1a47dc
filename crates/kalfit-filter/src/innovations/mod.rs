//! Innovations: does the model describe each test, as the filter sees it (theory §9).
//!
//! At an estimate the filter of a test starts from x_0 ~ N(a + Aμ_j, P0 + AΣA'), with nothing unknown. Its innovations
//! e with variances S, one scalar measurement at a time (correlated noise is whitened first), are then such that e/√S
//! are independent N(0, 1), if the model is right. The innovations of a test give:
//!
//! ```text
//! NIS = Σ e²/S ~ χ²_n        mean of e/√S ~ N(0, 1/n)        whiteness: Ljung and Box, see Whiteness
//! ```
//!
//! and Σ -½ (log 2πS + e²/S) is the log-likelihood of the test (theory §3), computed in another way. The figures take
//! μ, Σ and α as known; estimates of μ, Σ and α from the checked tests make the checks milder, not stricter, in small
//! ensembles.
//!
//! There is one filter, that of [`reduce`](crate::reduce). What Σ and earlier phases imply for the start of a phase
//! becomes part of P0, so that no σ remains; where that would need square roots, the law of σ corrects the results of
//! the filter instead (theory §7). Every innovation is conditional on all earlier measurements, of the phase and of
//! earlier phases.

mod chained;
mod change;
mod channels;
mod innovation;
mod law;
mod phase_prior;
mod plain;
mod rows;
mod series;
mod whiteness;

use rayon::prelude::*;

pub use change::Change;
pub use innovation::Innovation;
pub use series::{Innovations, Part, Summary};
pub use whiteness::Whiteness;

pub use chained::ChainedFilter;
pub use law::EnteringLaw;

use crate::innovations::chained::TestInnovations;
use crate::innovations::rows::ListedInnovation;
use crate::reduce::{ReduceError, check_shape, chunk_size, refuse};
use kalfit_model::PhasedTest;
use kalfit_model::{Alpha, PhasedModel, Population};

/// Largest number of changed copies of a test that one thread filters together, for which there is memory; the number
/// decides no bit.
const MAX_COPIES: usize = 8;

/// Innovations of each test, in the order of the tests; `None` for a test whose phases are all given by estimates or
/// reductions, which no longer contain the measurements. A phase with a given filter has no innovations either:
/// the filter's estimates are the evidence.
///
/// # Errors
/// As [`PhasedReducer::reduce`](crate::reduce::PhasedReducer::reduce), for the first test with an error; also when Σ
/// with the model's known covariance is not positive semidefinite, or `initial` does not have the shape of the model.
pub fn innovations(
    model: &PhasedModel,
    alpha: &Alpha,
    initial: &Population,
    tests: &[PhasedTest],
) -> Result<Vec<Option<Innovations>>, ReduceError> {
    InnovationFilter::new(model, alpha, initial)?.run(tests).into_iter().collect()
}

/// The filter behind [`innovations`], for ensembles that come in batches: the batches share design classes. `None` when
/// the only phase has a given filter, whose estimates are the evidence.
#[derive(Debug)]
pub struct InnovationFilter(Option<Box<ChainedFilter>>);

impl InnovationFilter {
    /// A filter of a model at (α, μ, Σ), of all phases together.
    ///
    /// # Errors
    /// As [`innovations`], except for the errors of single tests.
    pub fn new(model: &PhasedModel, alpha: &Alpha, initial: &Population) -> Result<InnovationFilter, ReduceError> {
        check_shapes(model, initial)?;
        let has_no_innovations = matches!(&model.phases[..], [only] if only.filter.is_some());
        let chained = (!has_no_innovations).then(|| ChainedFilter::new(model, alpha, initial)).transpose()?;
        Ok(InnovationFilter(chained.map(Box::new)))
    }

    /// The filter at the same α and another `initial`. Both filters share what they find of designs.
    ///
    /// # Errors
    /// As [`InnovationFilter::new`].
    pub fn at(&self, model: &PhasedModel, initial: &Population) -> Result<InnovationFilter, ReduceError> {
        check_shapes(model, initial)?;
        let chained = self.0.as_ref().map(|filter| filter.at(model, initial)).transpose()?;
        Ok(InnovationFilter(chained.map(Box::new)))
    }

    /// Innovations of each test, or the error of the test, in the order of the tests; `None` for a test without
    /// innovations. The results depend neither on batches nor on threads.
    pub fn run(&self, tests: &[PhasedTest]) -> Vec<Result<Option<Innovations>, ReduceError>> {
        self.each(tests, |test, series, other_log_density| {
            Innovations::new(test.id.to_string(), series, other_log_density)
        })
    }

    /// As [`InnovationFilter::run`], without the summaries.
    pub fn series(&self, tests: &[PhasedTest]) -> Vec<Result<Option<Vec<Innovation>>, ReduceError>> {
        self.each(tests, |_, series, _| series)
    }

    /// As [`InnovationFilter::run`], e/√S alone.
    pub fn standardised(&self, tests: &[PhasedTest]) -> Vec<Result<Option<Vec<f64>>, ReduceError>> {
        self.each(tests, |_, series, _| series)
    }

    /// A copy of a test with a change.
    pub fn copy(&self, test: &PhasedTest, change: &Change<'_>) -> PhasedTest {
        match &self.0 {
            Some(filter) => change.copy(test, filter.column(change.phase, change.measurement)),
            None => test.clone(),
        }
    }

    /// As [`InnovationFilter::standardised`], of a test with each of these changes; `None` where the innovations cannot
    /// be had. A long test is evaluated once for several changes.
    pub fn changed(&self, test: &PhasedTest, changes: &[Change<'_>]) -> Vec<Option<Vec<f64>>> {
        let Some(filter) = &self.0 else { return changes.iter().map(|_| None).collect() };
        let size = changes.len().div_ceil(rayon::current_num_threads()).clamp(1, MAX_COPIES);
        let of_some = |changes: &[Change<'_>]| -> Vec<Option<Vec<f64>>> {
            if let Some(found) = filter.changed(test, changes, filter.room().space()) {
                return found.into_iter().map(|series| rows::are_finite(&series).then_some(series)).collect();
            }
            let copies: Vec<PhasedTest> = changes.iter().map(|change| self.copy(test, change)).collect();
            self.standardised(&copies).into_iter().map(|found| found.ok().flatten()).collect()
        };
        changes.par_chunks(size).flat_map_iter(of_some).collect()
    }

    /// Filters tests, and maps (test, innovations, log p of the phases without innovations) of each by `finish`.
    fn each<T: ListedInnovation, R: Send>(
        &self,
        tests: &[PhasedTest],
        finish: impl Fn(&PhasedTest, Vec<T>, f64) -> R + Sync,
    ) -> Vec<Result<Option<R>, ReduceError>> {
        let Some(filter) = &self.0 else { return tests.iter().map(|_| Ok(None)).collect() };
        let rows = tests.iter().map(PhasedTest::row_count).sum();
        let finished = |(test, found): (&PhasedTest, TestInnovations<T>)| {
            Ok(found?.map(|(series, other_log_density)| finish(test, series, other_log_density)))
        };
        let batches: Vec<Vec<Result<Option<R>, ReduceError>>> = tests
            .par_chunks(chunk_size(tests.len(), rows))
            .map_init(
                || filter.room(),
                |room, tests| tests.iter().zip(filter.innovations(tests, room.space())).map(finished).collect(),
            )
            .collect();
        batches.into_iter().flatten().collect()
    }
}

/// Checks that `initial` has the shapes of the model: p, number of regressions, p × p.
fn check_shapes(model: &PhasedModel, initial: &Population) -> Result<(), ReduceError> {
    let (p, regressors) =
        (model.dimension(), model.phases.iter().map(|phase| phase.model.mean.regression.len()).sum::<usize>());
    let shaped = |what: &str, found: (usize, usize), expected: (usize, usize)| {
        check_shape(found, expected).map_err(|kind| refuse(None, what, kind))
    };
    shaped("mean of the initial state", (initial.mean.len(), 1), (p, 1))?;
    shaped("regression coefficients", (initial.coefficients.len(), 1), (regressors, 1))?;
    shaped("covariance of the initial state", initial.covariance.shape(), (p, p))
}
