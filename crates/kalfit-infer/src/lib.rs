//! Uncertainty of the estimates: standard errors, sensitivities, identifiability, and the results of each test.
//!
//! ```text
//! Var θ̂ = H⁻¹, H = -∂²ℓ/∂θ²                                     standard errors, from the observed information
//! V_j = Σ(I + J_jΣ)⁻¹,  x̂_j = μ + V_j(y_j - J_jμ)               posterior of ξ in test j                  (10), (11)
//! λ = dℓ_max / d(value)                                         the sensitivity to a constraint           (17)-(19)
//! -2 log λ = 2 (ℓ of the model - ℓ of the hypothesis)           χ², or a mixture of χ² on the boundary
//! ```

mod constraint;
mod deletion;
mod direction;
pub mod dynamic;
mod each;
mod ends;
mod estimated;
mod estimates;
mod freed;
mod held;
mod heterogeneity;
mod holdable;
mod identifiability;
mod information;
mod interval;
mod knowledge;
mod law;
mod levels;
mod mean_limits;
mod mean_slopes;
pub mod misfit;
mod observability;
mod observed;
mod phases;
mod posterior;
mod posteriors;
mod progress;
mod ratio;
mod reason;
mod room;
mod score_test;
mod small_sample;
mod std_errors;

pub use constraint::{Sensitivity, sensitivities};
pub use deletion::Deletion;
pub use direction::{Direction, Quantity};
pub use each::{deletions, posteriors};
pub use each::{deletions_while, posteriors_at};
pub use estimated::Estimated;
pub use estimates::EstimateCovariance;
pub use holdable::Quantities;
pub use identifiability::{Examination, examine_at_start, identifiability};
pub use information::{Boundary, Uncertainty, free, uncertainty};
pub use interval::{FEW_UNITS, Interval, IntervalKind, Intervals, has_few_units, wald};
pub use kalfit_algebra::elements::Element;
pub use knowledge::{Estimand, Knowledge};
pub use levels::{EffectCovariance, GroupPosterior};
pub use mean_limits::{MeanCombination, mean_limits};
pub use observability::{Leading, MOST_TESTS, Observability, Shortage, StateObservability, WEAK, WeakDirection};
pub use phases::PhaseObservability;
pub use posteriors::{Distance, Posterior, Posteriors};
pub use ratio::{
    Bootstrap, BootstrapResult, Component, GoesOn, LikelihoodRatio, NotNested, NotNestedParameter, ReferenceLaw,
    Restricted, at_least, bootstrap, bootstrap_while, fit_null, likelihood_ratio, restricted,
};
pub use reason::{Explanation, Reason};
pub use small_sample::{
    DfChoice, DfMethod, FewTests, JointTest, MeanAndVarianceLaw, MeanTest, NoDf, NoJointTest, SmallSample,
    student_quantile,
};
pub use std_errors::StdErrors;

pub use constraint::{holds_any, is_held};
pub(crate) use ends::{Holds, Profile};
pub(crate) use held::{Held, HeldMaximum, Holder};
pub use heterogeneity::{Heterogeneity, heterogeneity};
pub use holdable::Holdable;
pub use identifiability::directions;
pub use information::uncertainty_at;
pub(crate) use interval::{QUANTILE, profiled, quantities, value};
pub use knowledge::MAX_RELATIVE_STEP as MOST_OF_A_VALUE;
pub(crate) use law::AsymptoticLaw;
pub use observability::observability_counts;
pub use progress::SharedProgress;
pub(crate) use ratio::replicates;

use deletion::deletion_work;
use kalfit_estimate::{Criterion, Estimate, Progress, Silent};
use kalfit_filter::reduce::Reductions;
use kalfit_model::PhasedModel;

/// Options of the inference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Choices {
    /// Matrix that standard errors come from; under the restricted likelihood always the observed information.
    pub std_errors: StdErrors,
    /// Method of the intervals.
    pub intervals: IntervalKind,
    /// Standard errors and degrees of freedom of means under the restricted likelihood.
    pub df: DfChoice,
    /// Whether the fit is repeated without each test.
    pub deletion: DeletionChoice,
    /// Whether results of single tests are computed.
    pub tests: TestsChoice,
}

/// Whether results of single tests are computed: for very many tests, these results take more memory than the fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TestsChoice {
    /// Results of every test.
    #[default]
    Each,
    /// No results of single tests: neither posteriors nor fits without each test.
    None,
}

/// Whether the fit is repeated without each test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DeletionChoice {
    /// Only when the fits without each test together take about a second at most.
    #[default]
    Cheap,
    /// Always, however long the fits take.
    All,
    /// Never: no fits without single tests.
    None,
}

/// Largest number of multiplications at which the fits without each test count as cheap.
const CHEAP_MULTIPLICATIONS: f64 = 5e8;

/// Everything inferred from an estimate.
#[derive(Debug, Clone)]
pub struct Inference {
    /// Matrix that the standard errors come from.
    pub std_errors: StdErrors,
    /// Standard errors, and the blocks of Σ that are singular.
    pub uncertainty: Uncertainty,
    /// Covariance of all estimates; `None` for more than 200 estimates, or where an entry is not finite.
    pub estimates: Option<EstimateCovariance>,
    /// 95 % intervals.
    pub intervals: Intervals,
    /// Tests of means with few tests; `None` under maximum likelihood, or where none were asked for.
    pub few_tests: Option<Result<FewTests, NoDf>>,
    /// Directions that the data do not determine.
    pub unidentified: Vec<Direction>,
    /// Why the data do not determine each of the unidentified directions.
    pub explanations: Vec<Explanation>,
    /// Which tests inform and observe each state.
    pub observability: Observability,
    /// Which directions enter at which phase; empty where the reductions are not stored phase by phase.
    pub phases: Vec<PhaseObservability>,
    /// Sensitivity and score test of each constraint.
    pub sensitivities: Vec<Sensitivity>,
    /// Posterior of each test, in the order of the reductions; empty when not requested.
    pub posteriors: Posteriors,
    /// The fit without each test, in the order of the reductions; `None` when not requested.
    pub deletions: Option<Vec<Option<Deletion>>>,
    /// Posteriors of the groups of each level, the innermost first; empty without groups, or when not requested.
    pub groups: Vec<Vec<GroupPosterior>>,
    /// The fit without each group of each level, the innermost first; `None` when not requested.
    pub group_deletions: Option<Vec<Vec<Option<Deletion>>>>,
}

/// Computes the inference from an estimate and the reductions of the estimate.
pub fn infer(estimate: &Estimate, reductions: &Reductions, choices: Choices) -> Inference {
    with_ratios((estimate, reductions), choices, &SharedProgress::new(&mut Silent, None))
}

/// Computes the inference as [`infer`] does, and reports to `progress` which interval is computed. Once `progress`
/// stops, intervals come from standard errors, and fits without each test are omitted.
pub fn infer_while(
    model: &PhasedModel,
    (estimate, reductions): (&Estimate, &Reductions),
    choices: Choices,
    progress: &mut dyn Progress,
) -> Inference {
    with_ratios((estimate, reductions), choices, &SharedProgress::new(progress, Some(model)))
}

/// The inference of an estimate with known α, with likelihood ratios of the constraints that score tests reject.
fn with_ratios(
    (estimate, reductions): (&Estimate, &Reductions),
    choices: Choices,
    progress: &SharedProgress<'_>,
) -> Inference {
    let mut inference = inferred(estimate, reductions, choices, progress);
    inference.add_few_tests(SmallSample::of(estimate, reductions, choices.df));
    if freed::is_possible(estimate, reductions) {
        let maximum = |freed: &freed::Freed, _: f64, _: bool| match progress.stops() {
            true => None,
            false => freed::freed_maximum(estimate, reductions, freed),
        };
        let f_test = |freed: &freed::Freed| match progress.stops() {
            true => None,
            false => freed::f_test((estimate, reductions), freed, choices.df),
        };
        let refits = freed::Refits { maximum: &maximum, f_test: &f_test };
        freed::add_refits(estimate, &mut inference.sensitivities, &refits);
    }
    inference
}

/// Computes the inference as [`infer_while`] does, with a `progress` that threads already share.
pub(crate) fn inferred(
    estimate: &Estimate,
    reductions: &Reductions,
    choices: Choices,
    progress: &SharedProgress<'_>,
) -> Inference {
    let evidence = estimate.state.evidence(reductions);
    let Examination { unidentified, explanations, observability, phases } =
        identifiability::examine(estimate, &evidence, reductions);
    let std_errors = match estimate.criterion {
        Criterion::Ml => choices.std_errors,
        Criterion::Reml => StdErrors::Observed, // the additional term of the restricted ℓ is not a sum over tests
    };
    let (uncertainty, estimates) = information::uncertainty_of(estimate, &evidence, &unidentified, std_errors);
    let profiled = match choices.intervals.resolved(estimate, reductions.len(), 0) {
        IntervalKind::Auto | IntervalKind::Wald => None,
        IntervalKind::Profile => interval::profile(estimate, &uncertainty, &free(estimate, &unidentified), progress),
        IntervalKind::Bootstrap => {
            let free = free(estimate, &unidentified);
            interval::bootstrap(estimate, reductions, (&uncertainty, &free), progress)
        }
    };
    let intervals = profiled.unwrap_or_else(|| wald(estimate, &uncertainty));
    let each = choices.tests == TestsChoice::Each;
    let computes_deletions = match choices.deletion {
        _ if !each => false,
        DeletionChoice::Cheap => deletion_work(estimate, reductions.len()) <= CHEAP_MULTIPLICATIONS,
        DeletionChoice::All => true,
        DeletionChoice::None => false,
    };
    let grouped = estimate.grouping().is_some();
    let (posteriors, mut groups) = match each {
        true => each::estimated(estimate, reductions),
        false => (Posteriors::default(), Vec::new()),
    };
    if let (Some(estimates), Some(innermost)) = (&estimates, groups.first_mut()) {
        mean_slopes::add(estimate, &evidence, estimates, innermost);
    }
    let (deletions, group_deletions) = match computes_deletions {
        true if grouped => levels::deletions(estimate, &evidence, progress).unzip(),
        true => (deletions_while(estimate, reductions, progress), None),
        false => (None, None),
    };
    Inference {
        std_errors,
        phases,
        intervals,
        uncertainty,
        few_tests: None,
        estimates,
        sensitivities: sensitivities(estimate),
        posteriors,
        deletions,
        groups,
        group_deletions,
        unidentified,
        explanations,
        observability,
    }
}
