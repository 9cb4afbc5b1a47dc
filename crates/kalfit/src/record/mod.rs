//! The result of a fit as others read it: fit.json. Field names are a contract; unknown figures are null, never NaN.

mod build;
mod diagnosis;
mod dynamic;
mod dynamic_ratio;
mod levels;
mod parameters;
mod population;
mod ratio;

use serde::{Deserialize, Serialize};

pub use crate::infer::Interval;

pub use build::Provenance;
pub use diagnosis::shortage_notes;
pub use dynamic::DynamicParts;
pub use dynamic_ratio::DynamicSides;
pub use levels::{LevelCounts, level_notes};
pub use parameters::{MethodRecord, StartRecord};
pub use population::{FIT_SCHEMA, RecordError};
pub use ratio::{BootstrapRecord, ComponentRecord, PartRecord, RatioProvenance, RatioRecord, SideRecord};

/// All that a fit found. `None` is written as null: not known, not identified, or not applicable.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FitRecord {
    /// Always `kalfit-fit/1`.
    pub schema: String,
    /// Version that made it.
    pub kalfit_version: String,
    /// Title of the model.
    pub title: String,
    /// SHA-256 of the model file, `sha256:…`.
    pub model_digest: Option<String>,
    /// Counts.
    pub data: DataRecord,
    /// `ml` or `reml`.
    pub criterion: String,
    /// `measurements`, or `estimates` where a phase has a filter of its own.
    pub log_likelihood_kind: String,
    /// log p of all measurements, every constant included; under `reml` the restricted log-likelihood.
    pub log_likelihood: f64,
    /// Declared free quantities: μ, Σ and α.
    pub free_parameters: usize,
    /// 2k - 2ℓ.
    pub aic: Option<f64>,
    /// k log(observations) - 2ℓ.
    pub bic: Option<f64>,
    /// The optimality certificate holds.
    pub converged: bool,
    /// Why the solver stopped, in words.
    pub reason: String,
    /// The optimality certificate.
    pub certificate: CertificateRecord,
    /// What was done.
    pub solver: SolverRecord,
    /// What standard errors are made of: `observed`, `expected` or `sandwich`.
    #[serde(default)]
    pub std_errors: String,
    /// How 95 % intervals were made: `wald` or `profile`.
    #[serde(default)]
    pub intervals: String,
    /// One entry per phase.
    pub phases: Vec<PhaseRecord>,
    /// Dynamic parameters, one entry per level, in the order of the model and, within a parameter, of the texts of its levels.
    pub parameters: Vec<ParameterRecord>,
    /// Where searches for α from other starts ended, the best first.
    #[serde(default)]
    pub starts: Vec<StartRecord>,
    /// The methods that were asked for, when there were several: where each of them ended.
    #[serde(default)]
    pub methods: Vec<MethodRecord>,
    /// Every constrained element and what the constraint costs.
    pub constraints: Vec<ConstraintRecord>,
    /// What each test says.
    pub tests: Vec<TestRecord>,
    /// Findings in plain words, most important first.
    #[serde(default)]
    pub notes: Vec<String>,
}

/// Counts of the data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DataRecord {
    /// Tests.
    pub tests: usize,
    /// Steps over all tests.
    pub steps: usize,
    /// Scalar measurements over all tests.
    pub observations: usize,
    /// Sets of tests that share gains and information.
    pub design_classes: usize,
    /// Tests that went through the square-root path.
    #[serde(default)]
    pub square_root_tests: usize,
    /// Files, as named on the command line.
    #[serde(default)]
    pub files: Vec<String>,
}

/// How far the optimality conditions are from holding, each in units of its tolerance-free natural scale: standard errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CertificateRecord {
    /// Largest score of the mean.
    pub mean: f64,
    /// Largest entry of G Σ on the free elements.
    pub covariance: f64,
    /// Largest positive eigenvalue of G on the null space of Σ.
    pub null_space: f64,
    /// Largest score of the dynamic parameters.
    pub parameters: f64,
}

/// What was done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SolverRecord {
    /// `hybrid`, `innovations` or `em`; how α was found.
    pub method: String,
    /// `newton` or `em`.
    pub solver: String,
    /// `chain`, `marginal` or `stacked`.
    pub phases: String,
    /// Passes over the reductions.
    pub iterations: usize,
    /// Runs of the filters over all tests.
    pub filter_passes: usize,
    /// Backward runs over all tests, for the scores of the dynamic parameters.
    #[serde(default)]
    pub score_passes: usize,
    /// Log-likelihood after each accepted step.
    pub trace: Vec<f64>,
    /// Wall time.
    pub seconds: f64,
}

/// One phase's error model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PhaseRecord {
    /// `main` when there is but one.
    pub name: String,
    /// Estimated states, in the order of every matrix.
    pub states: Vec<String>,
    /// Their units.
    #[serde(default)]
    pub units: Vec<Option<String>>,
    /// μ.
    pub mean: MeanRecord,
    /// Σ.
    pub covariance: CovarianceRecord,
    /// Square roots of the diagonal of Σ.
    pub std_dev: VectorRecord,
    /// Correlations.
    pub correlation: MatrixRecord,
    /// Where Σ is on the boundary of the positive semidefinite cone.
    pub boundary: Vec<BoundaryRecord>,
    /// Directions the data say nothing about.
    pub unidentified: Vec<UnidentifiedRecord>,
    /// Which tests say what of each state, one entry per estimated state.
    #[serde(default)]
    pub observability: Vec<ObservabilityRecord>,
    /// Directions of the mean that are known much worse than its elements suggest, the worst first.
    #[serde(default)]
    pub weakly_determined: Vec<WeakRecord>,
}

/// μ with its uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeanRecord {
    /// μ.
    pub estimate: Vec<f64>,
    /// Standard errors; null where fixed or not identified.
    pub std_error: Vec<Option<f64>>,
    /// 95 % intervals, lower and upper end; an end is null where no limit was found.
    #[serde(default)]
    pub interval95: Vec<Interval>,
    /// Not estimated.
    pub fixed: Vec<bool>,
    /// α_μ of a proportional mean.
    pub scale: Option<ScaleRecord>,
    /// Regression coefficients.
    pub regression: Vec<RegressionRecord>,
}

/// A scale factor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScaleRecord {
    /// Its value.
    pub estimate: f64,
    /// Its standard error.
    pub std_error: Option<f64>,
    /// 95 % interval.
    #[serde(default)]
    pub interval95: Interval,
}

/// One regression coefficient.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RegressionRecord {
    /// State whose mean moves.
    pub state: String,
    /// Column it moves with.
    pub column: String,
    /// Coefficient.
    pub estimate: f64,
    /// Its standard error.
    pub std_error: Option<f64>,
    /// 95 % interval.
    #[serde(default)]
    pub interval95: Interval,
}

/// Σ with its uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CovarianceRecord {
    /// Σ.
    pub estimate: Vec<Vec<f64>>,
    /// Standard errors.
    pub std_error: Vec<Vec<Option<f64>>>,
    /// 95 % intervals, lower and upper end; an end is null where no limit was found.
    #[serde(default)]
    pub interval95: Vec<Vec<Interval>>,
    /// Not estimated.
    pub fixed: Vec<Vec<bool>>,
    /// β of a proportional covariance.
    pub scale: Option<ScaleRecord>,
}

/// Figures with standard errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VectorRecord {
    /// Figures.
    pub estimate: Vec<f64>,
    /// Standard errors.
    pub std_error: Vec<Option<f64>>,
    /// 95 % intervals, lower and upper end; an end is null where no limit was found.
    #[serde(default)]
    pub interval95: Vec<Interval>,
}

/// A matrix of figures with standard errors; null where not defined (a correlation with a zero variance).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MatrixRecord {
    /// Figures.
    pub estimate: Vec<Vec<Option<f64>>>,
    /// Standard errors.
    pub std_error: Vec<Vec<Option<f64>>>,
    /// 95 % intervals, lower and upper end; an end is null where no limit was found.
    #[serde(default)]
    pub interval95: Vec<Vec<Interval>>,
}

/// Σ on the boundary: `rank` of its `of` random states.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BoundaryRecord {
    /// `covariance`.
    pub what: String,
    /// Rank of Σ on the states whose variance is not fixed at zero.
    pub rank: usize,
    /// Their number.
    pub of: usize,
    /// The states of the block that is singular.
    #[serde(default)]
    pub states: Vec<String>,
    /// States whose estimated variance is zero.
    #[serde(default)]
    pub zero_variances: Vec<String>,
}

/// A direction the data say nothing about.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct UnidentifiedRecord {
    /// `mean` or `covariance`.
    pub what: String,
    /// Unit vector over the states (mean), or over the free covariance elements.
    pub direction: Vec<f64>,
    /// What the entries of `direction` stand for.
    #[serde(default)]
    pub elements: Vec<String>,
    /// Ids of the tests that inform any of its states, when they are at most twenty.
    #[serde(default)]
    pub tests: Vec<String>,
    /// Why, in words.
    #[serde(default)]
    pub reason: String,
}

/// What the ensemble says of one state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ObservabilityRecord {
    /// The state.
    pub state: String,
    /// Number of tests whose measurements depend on it.
    pub informed_by: usize,
    /// Number of tests that could estimate it alone.
    pub observed_by: usize,
    /// Ids of the tests that inform it, when they are at most twenty; else none.
    pub tests: Vec<String>,
    /// The test that most of what is known of its mean rests on; null where the mean is fixed or not identified.
    pub leading_test: Option<String>,
    /// That test's share of what is known, 0 to 1.
    pub leading_share: Option<f64>,
}

/// A weakly determined direction of the mean.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WeakRecord {
    /// Unit vector over the states.
    pub direction: Vec<f64>,
    /// Condition index: how many times less precisely it is known than the best known direction, states in comparable units.
    pub condition: f64,
    /// The test that most of what is known of it rests on.
    pub leading_test: Option<String>,
    /// That test's share of what is known, 0 to 1.
    pub leading_share: Option<f64>,
}

/// One dynamic parameter, at one level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParameterRecord {
    /// Its name.
    pub name: String,
    /// Column whose levels have a value each; null for a common parameter.
    pub per: Option<String>,
    /// The level.
    pub level: Option<String>,
    /// Its value.
    pub estimate: f64,
    /// Its standard error.
    pub std_error: Option<f64>,
    /// 95 % interval, lower and upper end; an end is null where no limit was found.
    pub interval95: Interval,
    /// Not estimated.
    pub fixed: bool,
    /// At a bound.
    pub at_bound: bool,
    /// Unit label.
    #[serde(default)]
    pub unit: Option<String>,
    /// Where the value lies: `inside`, `lower`, `upper`, `unbounded` or `unidentified`; null for a fixed value.
    #[serde(default)]
    pub standing: Option<String>,
    /// What that means, in words; null when the value is inside.
    #[serde(default)]
    pub note: Option<String>,
}

/// What one constraint costs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ConstraintRecord {
    /// `mean[a]` or `covariance[a, b]`.
    pub element: String,
    /// Its phase.
    pub phase: String,
    /// Value it is held at.
    pub value: f64,
    /// dℓ_max / d value.
    pub sensitivity: Option<f64>,
    /// Score (Lagrange multiplier) statistic, χ² with one degree of freedom.
    pub score_statistic: Option<f64>,
    /// Its p-value.
    pub p_value: Option<f64>,
    /// Expected change of the element if it were freed.
    pub expected_change: Option<f64>,
}

/// What one test says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TestRecord {
    /// Its id.
    pub id: String,
    /// log p of its measurements.
    pub log_likelihood: f64,
    /// Scalar measurements used.
    pub observations: usize,
    /// Posterior of ξ, by phase.
    pub phases: Vec<PosteriorRecord>,
    /// Standardised squared distance of the test from the population.
    pub distance: Option<f64>,
    /// Its degrees of freedom: rank of J.
    pub degrees_of_freedom: usize,
    /// Its χ² p-value.
    pub p_value: Option<f64>,
    /// The fit without this test; null when it was not asked for or has no certified optimum.
    #[serde(default)]
    pub deletion: Option<DeletionRecord>,
    /// Innovations of the filter at the estimate; null when they were not asked for or could not be had.
    #[serde(default)]
    pub innovations: Option<InnovationRecord>,
}

/// Innovations of one test at the estimate, as figures: e of variance S, in the order of the filter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InnovationRecord {
    /// Their number, n.
    pub count: usize,
    /// Normalised innovation squared, Σ e²/S; its expectation is n. Null without innovations.
    pub nis: Option<f64>,
    /// Two-sided p-value of it: twice the smaller of the upper tail of χ²_n and the lower tail of χ² with n less the number of
    /// estimated states, which the estimate may have absorbed.
    pub nis_p_value: Option<f64>,
    /// Mean of e/√S; its standard deviation is 1/√n.
    pub mean: Option<f64>,
    /// Ljung and Box's test; null when too short.
    pub whiteness: Option<WhitenessRecord>,
}

/// Ljung and Box's test of the e/√S, each measurement by itself, added up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WhitenessRecord {
    /// The statistic.
    pub statistic: f64,
    /// The longest lag: at most 10, and one for every five innovations of a measurement.
    pub lags: usize,
    /// Degrees of freedom: the lags of all measurements together.
    pub degrees_of_freedom: usize,
    /// Its χ² p-value.
    pub p_value: f64,
}

/// The fit without one test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DeletionRecord {
    /// log p of the test's measurements at the fit without it: its predictive density.
    pub log_density: f64,
    /// Standardised squared distance from the population that the other tests describe.
    pub distance: Option<f64>,
    /// Its χ² p-value.
    pub p_value: Option<f64>,
    /// 2 (ℓ(θ̂) - ℓ(θ̂ without the test)) over all tests: how far the test pulls the estimate.
    pub displacement: f64,
    /// The answer without the test, by phase.
    pub phases: Vec<DeletedRecord>,
}

/// μ and Σ of one phase without a test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DeletedRecord {
    /// Name of the phase.
    pub name: String,
    /// μ.
    pub mean: Vec<f64>,
    /// Regression coefficients.
    #[serde(default)]
    pub regression: Vec<f64>,
    /// Σ.
    pub covariance: Vec<Vec<f64>>,
}

/// Posterior of ξ in one phase.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PosteriorRecord {
    /// Name of the phase.
    pub name: String,
    /// E[ξ | z].
    pub mean: Vec<f64>,
    /// Var[ξ | z].
    pub covariance: Vec<Vec<f64>>,
}
