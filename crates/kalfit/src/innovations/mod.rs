//! Innovations: does the model describe each test, as the filter sees it (theory §9).
//!
//! At an estimate the filter of a test starts from x_0 ~ N(a + Aμ_j, P0 + AΣA'), nothing unknown. Its innovations e with
//! variances S, one scalar measurement at a time (correlated noise is whitened first), are then such that e/√S are
//! independent N(0, 1), if the model is right. From them, for each test:
//!
//! ```text
//! NIS = Σ e²/S ~ χ²_n        mean of e/√S ~ N(0, 1/n)        whiteness: Ljung-Box, see Whiteness
//! ```
//!
//! and Σ -½ (log 2πS + e²/S) is the log-likelihood of the test (theory §3), by another way. The figures take μ, Σ and α as
//! known; that they were estimated from the same tests makes the tests of few and small ensembles milder, not stricter.
//!
//! There is one filter, that of [`reduce`](crate::reduce): the uncertain start becomes part of P0, and nothing is left of ξ.

mod known_start;
mod series;
mod whiteness;

use rayon::prelude::*;

pub use series::{Innovation, Innovations};
pub use whiteness::Whiteness;

use crate::ensemble::Test;
use crate::innovations::known_start::KnownStart;
use crate::model::{Alpha, Model, Population};
use crate::reduce::ReduceError;

/// Innovations of all tests, in their order.
///
/// # Errors
/// As [`Reducer::reduce`](crate::reduce::Reducer::reduce), the first test's; also when Σ with the model's known covariance
/// is not positive semidefinite, or `initial` has not the shape of the model.
pub fn innovations(
    model: &Model,
    alpha: &Alpha,
    initial: &Population,
    tests: &[Test],
) -> Result<Vec<Innovations>, ReduceError> {
    InnovationFilter::new(model, alpha, initial)?.run(tests).into_iter().collect()
}

/// The filter behind [`innovations`], for ensembles that come in batches: it keeps design classes from batch to batch.
#[derive(Debug)]
pub struct InnovationFilter(KnownStart);

impl InnovationFilter {
    /// A filter of a model at (α, μ, Σ).
    ///
    /// # Errors
    /// As [`innovations`], where no test is to blame.
    pub fn new(model: &Model, alpha: &Alpha, initial: &Population) -> Result<InnovationFilter, ReduceError> {
        KnownStart::new(model, alpha, initial).map(InnovationFilter)
    }

    /// Innovations of each test, in their order, or why there are none. They depend neither on batches nor on threads.
    pub fn run(&self, tests: &[Test]) -> Vec<Result<Innovations, ReduceError>> {
        let start = || self.0.workspace();
        tests.par_iter().map_init(start, |work, test| self.0.innovations(test, work)).collect()
    }
}
