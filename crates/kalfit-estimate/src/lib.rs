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
//! Constraints are the paper's (13) to (37): [`MeanStructure`](kalfit_model::MeanStructure),
//! [`CovarianceStructure`](kalfit_model::CovarianceStructure).
//!
//! The estimator sees reductions, never data. [`fit`] returns an [`Estimate`], which always carries the optimality
//! [`Certificate`]: an estimate without one cannot be constructed.

mod at_other_alpha;
mod canonical;
mod centring;
mod certificate;
#[cfg(test)]
mod certificate_tests;
mod chained;
mod chart;
mod class;
mod classes;
mod climb;
mod covariance;
mod curvature;
mod directions;
mod each_class;
mod em;
mod error;
mod evidence;
mod exact;
mod expected;
mod form;
mod forms;
mod frame;
mod gather;
mod initial_law;
mod joint_law;
mod lanes;
mod levels;
mod likelihood;
mod linear;
mod listed;
mod local;
mod marginal;
mod mean;
mod newton;
mod noise;
mod order;
mod origin;
mod pass;
mod pilot;
mod point;
mod problem;
mod products;
mod quadratic;
mod relaxed;
mod reml;
mod remote;
mod residual;
mod result;
mod rounding;
mod scoring;
mod search;
mod settings;
mod start;
mod structure;
mod summed;
mod sums;
mod terms;
mod unobserved;

use std::collections::HashSet;
use std::hash::{DefaultHasher, Hash, Hasher};

use rayon::prelude::*;

pub use certificate::Certificate;
pub use error::FitError;
pub use likelihood::{Derivatives, Evaluation, Likelihood, pass_flops};
pub use order::memory;
pub use result::Estimate;
pub use settings::{Combination, Criterion, Progress, Settings, Silent, Solver, Stage, Step, Stop};
pub use structure::{PhaseStructure, Structure};

pub use chained::{ChainDetail, ChainStore, ChainedClass};
pub use class::{Class, ClassRef};
pub use classes::Classes;
pub use climb::{ClimbLimits, climb};
pub use covariance::{Constraint, CoordinateForm, CovarianceMap, PhaseForm};
pub use curvature::NEGLIGIBLE_INFORMATION;
pub use each_class::map_classes;
pub use evidence::evidence;
pub use expected::{ExpectedError, at_population, information_at_population};
pub use forms::map_forms;
pub use initial_law::law_at;
pub use joint_law::{FlatDirection, JointLaw, Mixed};
pub use levels::{
    LevelPosteriors, ScaledEffectCovariance, ScaledGroupPosterior, TestPosterior, Units, posteriors as level_posteriors,
};
pub use local::{Local, Objective, Tangent, natural_length, natural_sizes};
pub use newton::NewtonIterate;
pub use noise::{NoiseInformation, ScalableNoise};
pub use order::Order;
pub use point::Point;
pub use problem::Problem;
pub use remote::Counts;
pub use residual::Residual;
pub use result::FinalState;
pub use start::generic_root;
pub use summed::Summed;
pub use sums::Sums;
pub use terms::ClassTerms;

use crate::search::{Beginning, Search};
use kalfit_filter::reduce::Reductions;
use kalfit_model::Population;

/// Maximises the criterion of the settings under a structure: ℓ(μ, Σ) of the reductions, or the restricted likelihood
/// of Σ with μ by generalised least squares.
pub fn fit(
    reductions: &Reductions,
    structure: &Structure<'_>,
    settings: &Settings,
    progress: &mut dyn Progress,
) -> Result<Estimate, FitError> {
    let problem = problem(reductions, structure, settings)?;
    Search::new(problem, settings, progress).run(Beginning::Open, structure)?.with_joint_likelihood(reductions)
}

/// Fits as [`fit`] does, from values near the optimum, such as the estimates under another structure or from other
/// tests. The values need not meet the structure. Regression coefficients that are not given start at zero.
pub fn fit_from(
    reductions: &Reductions,
    structure: &Structure<'_>,
    start: &Population,
    settings: &Settings,
    progress: &mut dyn Progress,
) -> Result<Estimate, FitError> {
    let problem = problem(reductions, structure, settings)?;
    Search::new(problem, settings, progress).run(Beginning::Near(start), structure)?.with_joint_likelihood(reductions)
}

/// Fits as [`fit`] does, to other reductions of the tests of an ended search, from the point where that search ended
/// and in the coordinates of that search.
pub fn fit_on(end: &FinalState, reductions: &Reductions, structure: &Structure<'_>) -> Result<Estimate, FitError> {
    let problem = Problem::within(&end.evidence(reductions), structure, &end.problem)?;
    let start = Beginning::At(end.newton_iterate.point.clone());
    Search::new(problem, &end.settings, &mut Silent).run(start, structure)?.with_joint_likelihood(reductions)
}

/// The problem, the point where a search would begin, and the sums at that point with the expected information.
pub fn at_start(reductions: &Reductions, structure: &Structure<'_>) -> Result<(Problem, Point, Sums), FitError> {
    let problem = problem(reductions, structure, &Settings::default())?;
    let start = start::start(&problem, structure)?;
    let sums = problem.sums(&start, Order::Expected, None).filter(|sums| sums.value.is_finite());
    let sums = sums.ok_or(FitError::NotFinite)?;
    Ok((problem, start, sums.only_expected()))
}

/// The first id, in alphabetical order, that two tests share.
fn duplicate_id(reductions: &Reductions) -> Option<&str> {
    let hash = |j: usize| {
        let mut hasher = DefaultHasher::new();
        reductions.id(j).hash(&mut hasher);
        hasher.finish()
    };
    let mut hashes: Vec<u64> = (0..reductions.len()).into_par_iter().map(hash).collect();
    hashes.par_sort_unstable();
    if hashes.windows(2).all(|pair| pair[0] != pair[1]) {
        return None;
    }
    let mut seen = HashSet::with_capacity(reductions.len());
    let again = reductions.iter().map(|r| r.test).filter(|id| !seen.insert(*id));
    again.min()
}

/// The problem that a fit solves; an error where there are no tests, where two tests share an id, or where a test
/// cannot be in groups.
fn problem(reductions: &Reductions, structure: &Structure<'_>, settings: &Settings) -> Result<Problem, FitError> {
    let reductions = &*evidence(reductions, structure, settings)?;
    if reductions.is_empty() && reductions.remote().is_none() {
        return Err(FitError::NoTests);
    }
    if let Some(id) = duplicate_id(reductions) {
        return Err(FitError::DuplicateTest { id: id.to_owned() });
    }
    if let Some(grouping) = &structure.grouping
        && let Some(apart) = reductions.iter().find(|reduction| grouping.number(reduction.test).is_none())
    {
        return Err(FitError::Ungrouped { test: apart.test.to_owned() });
    }
    if structure.grouping.is_some()
        && let Some(exact) = reductions.iter().find(|reduction| reduction.exact.is_some())
    {
        return Err(FitError::ExactInGroups { test: exact.test.to_owned() });
    }
    let problem = Problem::new(reductions, structure, (settings.criterion, settings.phases))?;
    match problem.classes.units.as_ref().map_or(0, |units| units.largest_system()) {
        found if found > MOST_EFFECTS => Err(FitError::ManyLevels { found, most: MOST_EFFECTS }),
        _ => Ok(problem),
    }
}

/// Most levels of crossed factors times states of one dense system: its matrices then have 200 MB each, and a pass takes
/// minutes.
const MOST_EFFECTS: usize = 5000;
