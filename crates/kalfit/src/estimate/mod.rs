//! Maximum likelihood for (μ, Σ) on the reductions: the paper's DL algorithm, and a faster way to the same point.
//!
//! With Σ = LL', A = I + L'JL, b = L'(y - Jμ), W = (I + JΣ)⁻¹J and r = (I + JΣ)⁻¹(y - Jμ), summed over tests:
//!
//! ```text
//! ℓ = c - ½ log|A| + ½ b'A⁻¹b + y'μ - ½ μ'Jμ                    the log-likelihood of all measurements          (3), (12)
//! ∂ℓ/∂μ = Σ r                                                                                                   (4)
//! ∂ℓ/∂Σ = G = ½ Σ (rr' - W)                                                                                     (5)
//! μ ← mean of x̂_j,  Σ ← mean of V_j + (x̂_j - μ)(x̂_j - μ)'       one DL step, x̂_j and V_j by (10), (11)           (8), (9)
//! ∂ℓ/∂μ = 0,  GΣ = 0,  -G ≥ 0 on the null space of Σ            the certificate of a maximum
//! ```
//!
//! Constraints are the paper's (13) to (37): [`MeanStructure`](crate::model::MeanStructure),
//! [`CovarianceStructure`](crate::model::CovarianceStructure).
//!
//! The estimator sees reductions, never data. [`fit`] returns an [`Estimate`], which always carries the optimality
//! [`Certificate`]: an estimate without one cannot be written down.

mod canonical;
mod certificate;
#[cfg(test)]
mod certificate_tests;
mod chained;
mod chart;
mod classes;
mod climb;
mod covariance;
mod curvature;
mod elsewhere;
mod em;
mod exact;
mod expected;
mod form;
mod forms;
mod frame;
mod joint_law;
mod lanes;
mod likelihood;
mod linear;
mod listed;
mod local;
mod marginal;
mod mean;
mod newton;
mod noise;
mod pass;
mod pilot;
mod problem;
mod products;
mod quadratic;
mod relaxed;
mod reml;
mod rounding;
mod scoring;
mod search;
mod settings;
mod start;
mod structure;
mod sums;
mod terms;
mod together;
mod unobserved;

use std::borrow::Cow;
use std::collections::HashSet;

use nalgebra::DMatrix;

pub use certificate::Certificate;
pub use likelihood::{Derivatives, Evaluation, Likelihood, pass_flops};
pub use settings::{Combination, Criterion, Progress, Settings, Silent, Solver, Stage, Step};
pub use structure::{PhaseStructure, Structure};

pub(crate) use chained::{Chained, Detail, Kept};
pub(crate) use classes::{Class, Classes};
pub(crate) use climb::{Limits, climb};
pub(crate) use covariance::{Constraint, CovarianceMap, Form, Part};
pub(crate) use curvature::NOTHING;
pub(crate) use elsewhere::InitialLaw;
pub(crate) use expected::{ExpectedError, at_population};
pub(crate) use forms::forms_in_parts;
pub(crate) use joint_law::JointLaw;
pub(crate) use listed::Residual;
pub(crate) use local::{Local, Objective, Tangent, harmonic, natural_sizes};
pub(crate) use newton::{Place, retract};
pub(crate) use noise::{NoiseInformation, Noisy};
pub(crate) use pass::Order;
pub(crate) use problem::Problem;
pub(crate) use start::generic_root;
pub(crate) use structure::Assumed;
pub(crate) use sums::Sums;
pub(crate) use terms::{Point, Terms};
pub(crate) use together::{each, in_parts};

use rayon::prelude::*;

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
    /// A test that is not kept phase by phase, where each phase is to be taken by itself.
    #[error("the reduction of test `{test}` does not hold its phases one by one, which `marginal` needs")]
    NoPhases {
        /// Its id.
        test: String,
    },
    /// The restricted likelihood of phases taken by themselves.
    #[error("there is no restricted likelihood of several phases that are each taken by themselves (`marginal`)")]
    RestrictedMarginal,
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
    /// [`Progress::stops`] asked for it.
    Interrupted,
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
    /// ℓ, or under [`Criterion::Reml`] the restricted ℓ_R; every constant included. It is that of all phases together, also where
    /// something else was maximised.
    pub log_likelihood: f64,
    /// What was maximised instead, under [`Combination::Marginal`] in several phases: the sum of the log-densities of the phases'
    /// least-squares differences. Standard errors within a phase, the certificate and the trace are of it.
    pub composite: Option<f64>,
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
    /// With the log-likelihood of all phases together, where something else was maximised.
    fn of_all(mut self, reductions: &[Reduction]) -> Result<Estimate, FitError> {
        if self.state.is_marginal() {
            let (problem, point) = (&self.state.problem, &self.state.place.point);
            let whole = Problem::within(reductions, &self.state.structure(), problem)?;
            self.composite = Some(self.log_likelihood);
            self.log_likelihood = whole.likelihood(point, Order::First).value;
        }
        Ok(self)
    }

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
    pub fn covariance_scale(&self, phase: usize) -> f64 {
        let part = &self.state.problem.covariance.parts[phase];
        let sigma = self.state.place.point.covariance();
        match &part.form {
            Form::Scale(star) => part.states.clone().map(|i| sigma[(i, i)]).sum::<f64>() / star.norm_squared(),
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
    /// What standard errors are made of where dynamic parameters are estimated too, with their uncertainty in it.
    pub(crate) joint: Option<JointLaw>,
}

impl State {
    /// The reductions whose likelihood was maximised, from those that the estimate was made from.
    pub(crate) fn evidence<'a>(&self, reductions: &'a [Reduction]) -> Cow<'a, [Reduction]> {
        let elements = &self.problem.covariance.elements;
        evidence(reductions, (elements.blocks().len(), elements.states()), &self.settings)
            .expect("the estimate was made from such")
    }

    /// Each phase was taken by itself.
    pub(crate) fn is_marginal(&self) -> bool {
        self.settings.phases == Combination::Marginal && !self.problem.covariance.elements.is_single()
    }

    /// What rounding leaves open, by mean coordinate (elements of μ, then regression coefficients), in standard errors.
    pub(crate) fn rounding(&self) -> Vec<f64> {
        rounding::rounding(&self.problem.classes.frame, &self.place)
    }

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
    let evidence = evidence(reductions, (structure.phases.len(), structure.dimension()), settings)?;
    let problem = problem(&evidence, structure, settings)?;
    ended(problem, structure, None, settings, progress)?.of_all(reductions)
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
    let evidence = evidence(reductions, (structure.phases.len(), structure.dimension()), settings)?;
    let problem = problem(&evidence, structure, settings)?;
    ended(problem, structure, Some(start), settings, progress)?.of_all(reductions)
}

/// The end of a search, from values near the optimum if there are any.
fn ended(
    problem: Problem,
    structure: &Structure<'_>,
    near: Option<&Population>,
    settings: &Settings,
    progress: &mut dyn Progress,
) -> Result<Estimate, FitError> {
    let start = match near {
        Some(values) => start::near(&problem, values)?,
        None => start::start(&problem, structure)?,
    };
    let search = search::Search::new(problem, settings, progress);
    if near.is_some() { search.resume(start, structure) } else { search.run(start, structure) }
}

/// The place where a search would begin, with the expected information there.
pub(crate) fn at_start(
    reductions: &[Reduction],
    structure: &Structure<'_>,
) -> Result<(Problem, Place, Sums), FitError> {
    let problem = problem(reductions, structure, &Settings::default())?;
    let start = start::start(&problem, structure)?;
    let place = Place::new(&problem, &problem.covariance, start, None).ok_or(FitError::NotFinite)?;
    let sums = problem.sums(&place.point, pass::Order::Expected, None).ok_or(FitError::NotFinite)?;
    Ok((problem, place, sums))
}

/// The reductions whose likelihood is maximised: those given, or, phase by phase, what is left of each phase without the one before.
fn evidence<'a>(
    reductions: &'a [Reduction],
    (phases, states): (usize, usize),
    settings: &Settings,
) -> Result<Cow<'a, [Reduction]>, FitError> {
    if settings.phases != Combination::Marginal || phases < 2 {
        return Ok(Cow::Borrowed(reductions));
    }
    if settings.criterion == Criterion::Reml {
        return Err(FitError::RestrictedMarginal);
    }
    let one = |r: &Reduction| marginal::marginal(r, states).ok_or_else(|| FitError::NoPhases { test: r.test.clone() });
    Ok(Cow::Owned(reductions.par_iter().map(one).collect::<Result<_, _>>()?))
}

/// Of ids that two tests have, the first by order.
fn twice(reductions: &[Reduction]) -> Option<&str> {
    let mut seen = HashSet::with_capacity(reductions.len());
    let again = reductions.iter().map(|r| r.test.as_str()).filter(|id| !seen.insert(*id));
    again.min()
}

fn problem(reductions: &[Reduction], structure: &Structure<'_>, settings: &Settings) -> Result<Problem, FitError> {
    if reductions.is_empty() {
        return Err(FitError::NoTests);
    }
    if let Some(id) = twice(reductions) {
        return Err(FitError::DuplicateTest { id: id.to_owned() });
    }
    Ok(Problem::new(reductions, structure, (settings.criterion, settings.phases))?)
}
