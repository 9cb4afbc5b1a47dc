//! Expected standard errors before any test is run: how many tests are needed.
//!
//! At a population (μ, Σ) the expected information of the tests of a design is, with W_j = (I + J_jΣ)⁻¹J_j (theory §3),
//!
//! ```text
//! mean:        Σ_j B'W_jB          covariance, directions D, E:  ½ Σ_j tr(W_j D W_j E)          cross: 0
//! ```
//!
//! in the free coordinates of the model's structure. The inverse of the information is the covariance of the
//! maximum-likelihood estimates, to first order in 1/N; standard deviations and correlations follow by the delta
//! method. N tests like the n tests of the design have N/n times the design's information, so that all standard errors
//! fall as 1/√N.

mod best;
mod draws;
mod error;
mod levels;
mod lost;
mod mission;
pub mod optimal;
mod range;

pub use best::{BestPlan, CandidateInformation, Figure, Goal, NoPlan, PlannedFigure, best_plan};
pub use draws::{DrawnParameters, drawn};
pub use error::PlanError;
pub use kalfit_infer::Holdable as Quantity;
pub use levels::{Arrangement, plan_groups};
pub use lost::{InformationLost, StdErrorRatio, information_lost};
pub use mission::{MissionValue, mission};

use kalfit_algebra::elements::Elements;
use kalfit_estimate::{FinalState, Structure, at_population};
use kalfit_filter::reduce::Reductions;
use kalfit_infer as infer;
use kalfit_infer::{Direction, Uncertainty};
use kalfit_model::Population;

/// Why a quantity has no standard error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
    /// The model fixes the quantity.
    Fixed,
    /// The design has no information about the quantity.
    Unidentified,
    /// Σ is singular at the states of the quantity: many estimates are on the boundary, and no normal law describes the
    /// estimates.
    Boundary,
}

/// One quantity with expected standard errors.
#[derive(Debug, Clone, PartialEq)]
pub struct Planned {
    /// The quantity.
    pub quantity: Quantity,
    /// Value of the quantity in the population; `None` for a correlation with a variance of zero.
    pub value: Option<f64>,
    /// Standard error for each number of tests or each arrangement, infinite for an arrangement that does not identify
    /// the quantity; or the reason why the quantity has no standard error.
    pub std_errors: Result<Vec<f64>, Reason>,
}

/// Expected standard errors for several numbers of tests.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Number of tests of the design.
    pub design_tests: usize,
    /// Requested numbers of tests.
    pub tests: Vec<usize>,
    /// Arrangements in groups, where the model has levels.
    pub arrangements: Vec<Arrangement>,
    /// All quantities: μ, regression coefficients, standard deviations, correlations by rows, Σ by rows; pairs of
    /// states within a phase only.
    pub quantities: Vec<Planned>,
}

/// Expected standard errors for each number of `tests` like the tests of `reductions`. Only information and covariates
/// of the reductions count ([`PhasedReducer::reduce_designs`](kalfit_filter::reduce::PhasedReducer::reduce_designs)
/// makes such reductions); the dynamic parameters are taken as known.
///
/// ```
/// # mod kalfit { pub use {kalfit_apply::plan, kalfit_estimate as estimate, kalfit_filter::reduce, kalfit_model::*}; }
/// use kalfit::estimate::Structure;
/// use kalfit::model::{CovarianceStructure, MeanStructure};
/// use kalfit::plan::{Quantity, plan};
/// use kalfit::reduce::Path;
/// use kalfit::{Alpha, Population, Reduction};
/// use nalgebra::DMatrix;
///
/// // one test measures a level with variance 1: log p(z | ξ) = c - ½ (d - ξ)²
/// let test = Reduction {
///     test: "design".into(), constant: 0.0, data: vec![0.0], factor: vec![1.0], covariates: vec![],
///     residual: None,
///     steps: 1, observations: 1, path: Path::Information, design: 0,
///     chain: None, exact: None,
/// };
/// let (mean, covariance, alpha) = (MeanStructure::free(1), CovarianceStructure::full(), Alpha::default());
/// let structure = Structure::single(&mean, &covariance, &alpha);
/// let population = Population { mean: vec![5.0], coefficients: vec![], covariance: DMatrix::from_element(1, 1, 3.0) };
///
/// let plan = plan(&vec![test].into(), &structure, &population, &[4, 100])?;
/// let level = &plan.quantities[0];
/// assert_eq!(level.quantity, Quantity::Mean(0));
/// let errors = level.std_errors.as_ref().expect("the design identifies the mean");
/// assert!((errors[0] - (4.0_f64 / 4.0).sqrt()).abs() < 1e-12); // √((1 + 3) / N)
/// assert!((errors[1] - (4.0_f64 / 100.0).sqrt()).abs() < 1e-12);
/// # Ok::<(), kalfit::plan::PlanError>(())
/// ```
///
/// # Errors
/// No tests or numbers of tests of zero; a population that does not fit the structure; a structure that is not
/// possible.
pub fn plan(
    reductions: &Reductions,
    structure: &Structure<'_>,
    population: &Population,
    tests: &[usize],
) -> Result<Plan, PlanError> {
    let (p, regressions) = (structure.dimension(), structure.regressions().len());
    population.check_named(p, regressions, &|i| (i + 1).to_string())?;
    if tests.contains(&0) {
        return Err(PlanError::ZeroTests);
    }
    let found = Expected::of(reductions, structure, population)?;
    let n = reductions.len();
    let at_each = |error: f64| tests.iter().map(|&many| error * (n as f64 / many as f64).sqrt()).collect();
    let planned = |quantity: Quantity| Planned {
        quantity,
        value: found.at(population).value(quantity),
        std_errors: found
            .at(population)
            .error(quantity)
            .map(at_each)
            .ok_or_else(|| found.at(population).reason(quantity)),
    };
    let elements = &found.state.problem.covariance.elements;
    let quantities = quantities(elements, regressions).into_iter().map(planned).collect();
    Ok(Plan { design_tests: n, tests: tests.to_vec(), arrangements: Vec::new(), quantities })
}

/// Expected information of tests at a population, with unidentified directions and standard errors.
struct Expected {
    state: FinalState,
    unidentified: Vec<Direction>,
    uncertainty: Uncertainty,
}

impl Expected {
    fn of(reductions: &Reductions, structure: &Structure<'_>, population: &Population) -> Result<Expected, PlanError> {
        let state = at_population(reductions, structure, population)?;
        let unidentified = infer::directions(&state.problem, &state.newton_iterate.point, &state.sums);
        let uncertainty = infer::uncertainty_at(&state, &population.covariance, &unidentified);
        Ok(Expected { state, unidentified, uncertainty })
    }

    fn at<'a>(&'a self, population: &'a Population) -> ExpectedAt<'a> {
        let Expected { state, unidentified, uncertainty } = self;
        ExpectedAt { state, population, unidentified, uncertainty }
    }
}

/// Quantities of all phases. Pairs are within a phase, because states of different phases are independent.
fn quantities(elements: &Elements, regressions: usize) -> Vec<Quantity> {
    let p = elements.states();
    let off_diagonal = || elements.all().filter(|(i, j)| i != j);
    let means = (0..p).map(Quantity::Mean).chain((0..regressions).map(Quantity::Coefficient));
    let deviations_and_correlations =
        (0..p).map(Quantity::StdDev).chain(off_diagonal().map(|(i, j)| Quantity::Correlation(i, j)));
    means.chain(deviations_and_correlations).chain(elements.all().map(|(i, j)| Quantity::Covariance(i, j))).collect()
}

/// The results of [`Expected`], with the population.
struct ExpectedAt<'a> {
    state: &'a FinalState,
    population: &'a Population,
    unidentified: &'a [Direction],
    uncertainty: &'a Uncertainty,
}

impl ExpectedAt<'_> {
    fn value(&self, quantity: Quantity) -> Option<f64> {
        let Population { mean, coefficients, covariance } = self.population;
        quantity.value(mean, coefficients, covariance)
    }

    fn error(&self, quantity: Quantity) -> Option<f64> {
        self.uncertainty.errors.of(quantity).filter(|error| error.is_finite())
    }

    /// Index of an element of Σ.
    fn element(&self, i: usize, j: usize) -> usize {
        self.state.problem.covariance.elements.index(i, j)
    }

    /// Why a quantity has no standard error.
    fn reason(&self, quantity: Quantity) -> Reason {
        let takes_part = |what: infer::Quantity, k: usize| {
            self.unidentified.iter().any(|d| d.quantity == what && d.direction[k] != 0.0)
        };
        let is_singular = |i: usize| self.uncertainty.boundary.iter().any(|b| b.states.contains(&i));
        let elements: &[(usize, usize)] = match quantity {
            Quantity::Mean(i) if takes_part(infer::Quantity::Mean, i) => return Reason::Unidentified,
            Quantity::Mean(_) => return Reason::Fixed,
            Quantity::Coefficient(_) => return Reason::Unidentified, // no structure fixes a coefficient
            Quantity::StdDev(i) => &[(i, i)],
            Quantity::Covariance(i, j) => &[(i, j)],
            Quantity::Correlation(i, j) => &[(i, j), (i, i), (j, j)],
        };
        let (i, j) = elements[0];
        let held = infer::is_held(self.state, i, j);
        if held {
            Reason::Fixed
        } else if is_singular(i) || is_singular(j) {
            Reason::Boundary
        } else if elements.iter().any(|&(i, j)| takes_part(infer::Quantity::Covariance, self.element(i, j))) {
            Reason::Unidentified
        } else {
            Reason::Fixed
        }
    }
}
