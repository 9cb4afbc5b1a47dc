//! Applies a model whose parameters are all known to tests (theory §12): computes the posterior of each test's initial
//! state, whether the tests come from the population, and the states at each step of the records. Nothing is estimated.
//!
//! ```text
//! (α, μ, Σ) + tests ──> Applied ──> posteriors, distances, log densities, innovations ──> Verdict, by Laws
//!                               └─> states: predicted, filtered or smoothed, with the prediction of each measurement
//! ```

mod doubt;
mod error;
mod forward;
mod law;
#[cfg(test)]
mod law_tests;
mod laws;
mod predicted;
mod smoothed;
mod states;
#[cfg(test)]
mod tests;
mod tree;
mod verdict;

use std::borrow::Cow;
use std::sync::Arc;

pub use doubt::Trust;
pub use error::ApplyError;
pub use law::Law;
pub use laws::Laws;
pub(crate) use predicted::{EvaluatedPhase, StateForm, ValueSubject};
pub use states::{PhaseStates, Prediction, StateKind, StepStates};
pub use verdict::{Joint, Verdict};

use kalfit_estimate::{Combination, Criterion, Order, PhaseStructure, Point, Problem, Settings, Structure, evidence};
use kalfit_filter::innovations::{Innovations, innovations};
use kalfit_filter::reduce::{PhasedReducer, Reductions, grouping};
use kalfit_infer::{GroupPosterior, Posterior, Posteriors, posteriors_at};
use kalfit_model::Grouping;
use kalfit_model::PhasedTest;
use kalfit_model::{Alpha, CovarianceStructure, MeanStructure, PhasedModel, Population, Slots};

/// Tests under a model at (α, μ, Σ).
#[derive(Debug)]
pub struct Applied<'a> {
    model: &'a PhasedModel,
    alpha: &'a Alpha,
    population: &'a Population,
    tests: &'a [PhasedTest],
    grouping: Option<Arc<Grouping>>,
    slots: Slots,
    reducer: PhasedReducer,
    /// Reductions that `problem` was made from.
    reductions: Reductions,
    problem: Problem,
    point: Point,
}

/// Results of tests, in the order of the tests.
#[derive(Debug)]
pub struct Said {
    /// Likelihood, posterior and distance of each test.
    pub posteriors: Posteriors,
    /// Posterior of each group of each level, the innermost level first; empty where tests are in no groups.
    pub groups: Vec<Vec<GroupPosterior>>,
    /// Innovations of each test; `None` for tests whose measurements are not known.
    pub innovations: Vec<Option<Innovations>>,
    /// Residual of each test, the part of the squares that no initial state explains: (sum of squares of the
    /// innovations less the squared distance of the test from the population, degrees of freedom of χ²). Residual and
    /// distance are independent, also where tests are in groups. `None` where a phase is not given by rows, and where
    /// the squared distance is so large that the difference is only rounding.
    pub residuals: Vec<Option<(f64, usize)>>,
    /// The distance of all tests together, where groups cross, so that no test is independent of the others.
    pub joint: Option<JointDistance>,
}

/// Distance of all tests together from a population.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointDistance {
    /// (d - Rμ)'Ω⁻¹(d - Rμ) over all tests.
    pub squared: f64,
    /// Sum of the ranks of the tests' information.
    pub degrees_of_freedom: usize,
    /// log p of all measurements.
    pub log_density: f64,
}

/// Largest rounding error of a residual that is reported, relative to 1 + the residual.
const RESIDUAL_ROUNDING: f64 = 1e-3;

impl<'a> Applied<'a> {
    /// Runs the filters over the tests. `population` has the shape of the model; for a model with levels, `population`
    /// contains all levels.
    ///
    /// # Errors
    /// No tests; a population of another shape; a test that the model does not allow.
    pub fn new(
        model: &'a PhasedModel,
        alpha: &'a Alpha,
        population: &'a Population,
        tests: &'a [PhasedTest],
    ) -> Result<Applied<'a>, ApplyError> {
        if tests.is_empty() {
            return Err(ApplyError::NoTests);
        }
        population.check(model)?;
        let slots = Slots::none(model.shared());
        let reducer = PhasedReducer::scoring(model, alpha, &slots)?;
        let reductions = reducer.reduce(tests)?;
        let grouping = grouping(model, tests)?.map(Arc::new);
        // no constraint of the structure may change the given values
        let covariances: Vec<CovarianceStructure> = model.blocks().map(|(own, _)| unconstrained(own)).collect();
        let of = Structure::of(model, alpha, grouping.as_ref());
        let phases = of.phases.iter().zip(&covariances).map(|(phase, covariance)| {
            let free = MeanStructure::free(phase.mean.elements.len());
            let mean = MeanStructure { regression: phase.mean.regression.clone(), ..free };
            PhaseStructure { mean: Cow::Owned(mean), covariance }
        });
        let structure = Structure { phases: phases.collect(), ..of.clone() };
        let reductions = evidence(&reductions, &structure, &Settings::default())?.into_owned();
        let problem = Problem::new(&reductions, &structure, (Criterion::Ml, Combination::Chain))?;
        let point = problem.point_of(population);
        Ok(Applied { model, alpha, population, tests, grouping, slots, reducer, reductions, problem, point })
    }

    /// Number of measured values of each test.
    pub fn observations(&self) -> Vec<usize> {
        self.reductions.iter().map(|reduction| reduction.observations).collect()
    }

    /// Results of each test.
    ///
    /// # Errors
    /// The errors of [`innovations`].
    pub fn said(&self) -> Result<Said, ApplyError> {
        let (posteriors, groups) = posteriors_at(&self.problem, &self.point, &self.reductions);
        let combined = self.population.together(self.model.dimension(), &self.model.slots());
        let innovations = innovations(self.model, self.alpha, &combined, self.tests)?;
        let residual = |((test, own), posterior): ((&PhasedTest, &Option<Innovations>), Posterior<'_>)| {
            let (summary, distance) = (&own.as_ref().filter(|_| self.is_all_rows(test))?.summary, &posterior.distance);
            let degrees = summary.count.saturating_sub(distance.degrees_of_freedom);
            let residual = (summary.nis - distance.squared).max(0.0);
            let is_precise = summary.nis * f64::EPSILON * summary.count as f64 <= RESIDUAL_ROUNDING * (1.0 + residual);
            is_precise.then_some((residual, degrees))
        };
        let residuals = self.tests.iter().zip(&innovations).zip(posteriors.iter()).map(residual).collect();
        let crossed = self.grouping.as_deref().is_some_and(Grouping::is_crossed);
        let joint = crossed.then(|| {
            let sums = self.problem.likelihood(&self.point, Order::First);
            let degrees = posteriors.iter().map(|test| test.distance.degrees_of_freedom).sum();
            JointDistance { squared: sums.quadratic(), degrees_of_freedom: degrees, log_density: sums.value }
        });
        Ok(Said { posteriors, groups, innovations, residuals, joint })
    }

    /// Whether every phase of the test is given by rows and has no separate filter.
    fn is_all_rows(&self, test: &PhasedTest) -> bool {
        self.refuse_without_rows(test).is_ok()
    }
}

/// A structure that does not constrain Σ; the known covariance of `own` is still added to Σ.
fn unconstrained(own: &CovarianceStructure) -> CovarianceStructure {
    CovarianceStructure { known: own.known.clone(), ..CovarianceStructure::full() }
}
