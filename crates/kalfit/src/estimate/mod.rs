//! Maximum likelihood for (μ, Σ) on the reductions: the paper's DL algorithm, and a faster way to the same point.
//!
//! The estimator sees reductions, never data. [`fit`] returns an [`Estimate`], which always carries the optimality
//! [`Certificate`]: an estimate without one cannot be written down.

mod certificate;
mod classes;
mod climb;
mod covariance;
mod elsewhere;
mod em;
mod exact;
mod expected;
mod likelihood;
mod linear;
mod local;
mod mean;
mod newton;
mod pass;
mod problem;
mod quadratic;
mod relaxed;
mod reml;
mod scoring;
mod search;
mod settings;
mod start;
mod structure;
mod terms;
mod unobserved;

use nalgebra::DMatrix;

pub use certificate::Certificate;
pub use likelihood::{Derivatives, Evaluation, Likelihood, pass_flops};
pub use settings::{Combination, Criterion, Progress, Settings, Silent, Solver, Step};
pub use structure::{PhaseStructure, Structure};

pub(crate) use classes::{Class, unpack};
pub(crate) use climb::{Limits, climb};
pub(crate) use covariance::{Constraint, CovarianceMap, Form};
pub(crate) use elsewhere::InitialLaw;
pub(crate) use expected::{ExpectedError, at_population};
pub(crate) use local::{Local, Objective, Tangent, harmonic, natural_sizes, packed_score};
pub(crate) use newton::{Place, retract};
pub(crate) use pass::{Order, Sums, of_class};
pub(crate) use problem::Problem;
pub(crate) use start::generic_root;
pub(crate) use structure::Assumed;
pub(crate) use terms::{Point, Terms};

use crate::model::{Population, StructureError};
use crate::reduce::Reduction;

/// Why there is no estimate.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FitError {
    /// There are no tests.
    #[error("there are no tests")]
    NoTests,
    /// The structure of Σ cannot be.
    #[error(transparent)]
    Structure(#[from] StructureError),
    /// Two tests have the same id.
    #[error("two tests have the id `{id}`")]
    DuplicateTest {
        /// The id.
        id: String,
    },
    /// ℓ is not a finite number at the start.
    #[error("the log-likelihood is not finite at the start values")]
    NotFinite,
    /// A step lowered the log-likelihood, which EM cannot do: the arithmetic has broken down.
    #[error("an EM step lowered the log-likelihood from {before} to {after}; the problem is too ill-conditioned")]
    NotMonotone {
        /// ℓ before the step.
        before: f64,
        /// ℓ after it.
        after: f64,
    },
}

/// Why the search stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// The certificate holds.
    Certified,
    /// The passes ran out first.
    PassLimit,
    /// No step raises ℓ, yet the certificate does not hold.
    Stalled,
}

/// Where the search ended, in the user's units.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// μ (p).
    pub mean: Vec<f64>,
    /// Regression coefficients, in the order of [`Structure::regressions`].
    pub coefficients: Vec<f64>,
    /// Σ (p × p). Fixed elements have exactly their values.
    pub covariance: DMatrix<f64>,
    /// ℓ, or under [`Criterion::Reml`] the restricted ℓ_R; every constant included.
    pub log_likelihood: f64,
    /// The optimality certificate.
    pub certificate: Certificate,
    /// Why the search stopped.
    pub stop: Stop,
    /// ℓ after each accepted step.
    pub trace: Vec<f64>,
    /// Passes over the reductions.
    pub passes: usize,
    /// Number of classes of tests with one information matrix.
    pub classes: usize,
    /// Solver that was used.
    pub solver: Solver,
    /// What was maximised.
    pub criterion: Criterion,
    /// What inference needs: the problem, the final point in its own coordinates, and the derivatives there.
    pub(crate) state: State,
}

impl Estimate {
    /// Number of free mean quantities, as declared: elements of μ and regression coefficients.
    pub fn declared_mean(&self) -> usize {
        let mean = &self.state.problem.mean;
        mean.basis.ncols() + mean.regressors.len()
    }

    /// Number of free covariance quantities, as declared.
    pub fn declared_covariance(&self) -> usize {
        self.state.problem.covariance.declared()
    }

    /// β of a phase's Σ = βΣ*; zero for other structures.
    pub fn covariance_scale(&self, _phase: usize) -> f64 {
        match &self.state.problem.covariance.form {
            Form::Scale(star) => self.state.place.point.covariance().trace() / star.norm_squared(),
            _ => 0.0,
        }
    }
}

/// The end of the search in the estimator's own coordinates.
#[derive(Debug, Clone)]
pub(crate) struct State {
    pub(crate) problem: std::sync::Arc<Problem>,
    pub(crate) place: Place,
    pub(crate) sums: Sums,
    pub(crate) assumed: Assumed,
    pub(crate) settings: Settings,
    /// Covariance along the tangent basis, where it is known with the uncertainty of dynamic parameters in it.
    pub(crate) joint: Option<DMatrix<f64>>,
}

impl State {
    /// The structure that was assumed.
    pub(crate) fn structure(&self) -> Structure<'_> {
        self.assumed.structure()
    }
}

/// Maximises ℓ(μ, Σ) over the reductions under a structure, or the restricted likelihood of Σ with μ by generalised least
/// squares, as the criterion of the settings says.
pub fn fit(
    reductions: &[Reduction],
    structure: &Structure<'_>,
    settings: &Settings,
    progress: &mut dyn Progress,
) -> Result<Estimate, FitError> {
    let problem = problem(reductions, structure, settings.criterion)?;
    let start = start::start(&problem, structure)?;
    search::Search::new(problem, settings, progress).run(start, structure)
}

impl From<&Estimate> for Population {
    fn from(estimate: &Estimate) -> Population {
        Population {
            mean: estimate.mean.clone(),
            coefficients: estimate.coefficients.clone(),
            covariance: estimate.covariance.clone(),
        }
    }
}

/// As [`fit`], from values that are near the optimum: those of a fit under another structure or to other tests. They
/// need not meet the structure. Regression coefficients that are not given start at zero.
pub fn fit_from(
    reductions: &[Reduction],
    structure: &Structure<'_>,
    start: &Population,
    settings: &Settings,
    progress: &mut dyn Progress,
) -> Result<Estimate, FitError> {
    let problem = problem(reductions, structure, settings.criterion)?;
    let start = start::near(&problem, start)?;
    search::Search::new(problem, settings, progress).resume(start, structure)
}

/// The place where a search would begin, with the expected information there.
pub(crate) fn at_start(
    reductions: &[Reduction],
    structure: &Structure<'_>,
) -> Result<(Problem, Place, Sums), FitError> {
    let problem = problem(reductions, structure, Criterion::Ml)?;
    let start = start::start(&problem, structure)?;
    let place = Place::new(&problem, &problem.covariance, start, None).ok_or(FitError::NotFinite)?;
    let sums = problem.sums(&place.point, pass::Order::Expected, None).ok_or(FitError::NotFinite)?;
    Ok((problem, place, sums))
}

fn problem(reductions: &[Reduction], structure: &Structure<'_>, criterion: Criterion) -> Result<Problem, FitError> {
    if reductions.is_empty() {
        return Err(FitError::NoTests);
    }
    let mut ids: Vec<&str> = reductions.iter().map(|r| r.test.as_str()).collect();
    ids.sort_unstable();
    if let Some(twice) = ids.windows(2).find(|pair| pair[0] == pair[1]) {
        return Err(FitError::DuplicateTest { id: twice[0].to_owned() });
    }
    Ok(Problem::new(reductions, structure, criterion)?)
}
