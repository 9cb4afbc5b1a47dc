//! Innovations: does the model describe each test, as the filter sees it (theory §9).
//!
//! At an estimate the filter of a test starts from x_0 ~ N(a + Aμ_j, P0 + AΣA'), nothing unknown. Its innovations e with
//! variances S, one scalar measurement at a time (correlated noise is whitened first), are then such that e/√S are
//! independent N(0, 1), if the model is right. From them, for each test:
//!
//! ```text
//! NIS = Σ e²/S ~ χ²_n        mean of e/√S ~ N(0, 1/n)        whiteness: Ljung and Box, see Whiteness
//! ```
//!
//! and Σ -½ (log 2πS + e²/S) is the log-likelihood of the test (theory §3), by another way. The figures take μ, Σ and α as
//! known; that they were estimated from the same tests makes the tests of few and small ensembles milder, not stricter.
//!
//! There is one filter, that of [`reduce`](crate::reduce). What Σ and earlier phases say of the start of a phase becomes part of P0,
//! and nothing is left of σ; or, where that calls for square roots, it is added to what the filter finds (theory §7). Every innovation is from all that was measured before, in its
//! phase and in earlier ones.

mod chained;
mod channels;
mod innovation;
mod law;
mod phase_prior;
mod plain;
mod rows;
mod series;
mod whiteness;

use rayon::prelude::*;

pub use innovation::Innovation;
pub use series::{Innovations, Part, Summary};
pub use whiteness::Whiteness;

pub use chained::ChainedFilter;
pub use law::EnteringLaw;

use crate::reduce::{ReduceError, chunk_size, of_shape, refuse};
use kalfit_model::PhasedTest;
use kalfit_model::{Alpha, PhasedModel, Population};

/// Innovations of all tests, in their order; `None` of a test all of whose phases are given by estimates or reductions: what was
/// measured is no longer known there. Neither is what was measured in a phase with a filter of its own, whose estimates are
/// what counts.
///
/// # Errors
/// As [`PhasedReducer::reduce`](crate::reduce::PhasedReducer::reduce), the first test's; also when Σ with the model's known
/// covariance is not positive semidefinite, or `initial` has not the shape of the model.
pub fn innovations(
    model: &PhasedModel,
    alpha: &Alpha,
    initial: &Population,
    tests: &[PhasedTest],
) -> Result<Vec<Option<Innovations>>, ReduceError> {
    InnovationFilter::new(model, alpha, initial)?.run(tests).into_iter().collect()
}

/// The filter behind [`innovations`], for ensembles that come in batches: it keeps design classes from batch to batch. `None` of
/// the only phase's filter, whose estimates are what counts.
#[derive(Debug)]
pub struct InnovationFilter(Option<Box<ChainedFilter>>);

impl InnovationFilter {
    /// A filter of a model at (α, μ, Σ), of all phases together.
    ///
    /// # Errors
    /// As [`innovations`], where no test is to blame.
    pub fn new(model: &PhasedModel, alpha: &Alpha, initial: &Population) -> Result<InnovationFilter, ReduceError> {
        check(model, initial)?;
        let silent = matches!(&model.phases[..], [only] if only.filter.is_some());
        let chained = (!silent).then(|| ChainedFilter::new(model, alpha, initial)).transpose()?;
        Ok(InnovationFilter(chained.map(Box::new)))
    }

    /// Innovations of each test, in their order, or why there are none. They depend neither on batches nor on threads.
    pub fn run(&self, tests: &[PhasedTest]) -> Vec<Result<Option<Innovations>, ReduceError>> {
        let Some(filter) = &self.0 else { return tests.iter().map(|_| Ok(None)).collect() };
        let rows = tests.iter().map(PhasedTest::row_count).sum();
        let batches: Vec<Vec<Result<Option<Innovations>, ReduceError>>> = tests
            .par_chunks(chunk_size(tests.len(), rows))
            .map_init(|| filter.workspace(), |room, tests| filter.innovations(tests, room))
            .collect();
        batches.into_iter().flatten().collect()
    }
}

/// The shapes of `initial` are those of the model.
fn check(model: &PhasedModel, initial: &Population) -> Result<(), ReduceError> {
    let (p, regressors) =
        (model.dimension(), model.phases.iter().map(|phase| phase.model.mean.regression.len()).sum::<usize>());
    let shaped = |what: &str, found: (usize, usize), expected: (usize, usize)| {
        of_shape(found, expected).map_err(|kind| refuse(None, what, kind))
    };
    shaped("mean of the initial state", (initial.mean.len(), 1), (p, 1))?;
    shaped("regression coefficients", (initial.coefficients.len(), 1), (regressors, 1))?;
    shaped("covariance of the initial state", initial.covariance.shape(), (p, p))
}
