//! One phase's error model as a record.

use serde::{Deserialize, Serialize};

use kalfit_infer::Interval;

/// One phase's error model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PhaseRecord {
    /// Name of the phase; `main` when there is only one.
    pub name: String,
    /// Estimated states, in the order of every matrix.
    pub states: Vec<String>,
    /// Unit labels of the states.
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
    /// Directions that the data do not determine.
    pub unidentified: Vec<UnidentifiedRecord>,
    /// Which tests inform each state, one entry per estimated state.
    #[serde(default)]
    pub observability: Vec<ObservabilityRecord>,
    /// Directions of the mean that are known much worse than its elements suggest, the worst first.
    #[serde(default)]
    pub weakly_determined: Vec<WeakRecord>,
    /// Number of tests that have this phase; null in records without it.
    #[serde(default)]
    pub tests: Option<usize>,
    /// What this phase adds to the observability of all phases; null if there is only one phase.
    #[serde(default)]
    pub information: Option<InformationRecord>,
    /// The filter whose estimates replace the measurements; null if the measurements were used.
    #[serde(default)]
    pub filter: Option<FilterRecord>,
}

/// What the ensemble observes of the states, phase by phase: ranks of the information, and what is new.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InformationRecord {
    /// Rank of this phase's information on all states that enter it: its estimated states and those that inherit.
    pub own_rank: usize,
    /// Number of states that enter it.
    pub entering: usize,
    /// Rank of the information of all phases up to this one on their estimated states.
    pub rank_so_far: usize,
    /// Number of estimated states of these phases.
    pub of: usize,
    /// Combinations of these states that become known in this phase; their number is `rank_so_far` minus that of the
    /// phase before.
    pub entered: Vec<EnteredRecord>,
}

/// A combination of states that is known from some phase on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EnteredRecord {
    /// Unit vector.
    pub direction: Vec<f64>,
    /// The states that its entries stand for, as `phase.state`.
    pub elements: Vec<String>,
}

/// A filter that need not be the optimal one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FilterRecord {
    /// `kalman-schmidt`.
    pub kind: String,
    /// States whose uncertainty it accounts for but which it does not estimate.
    pub consider: Vec<String>,
    /// Information lost in comparison with the measurements; null if these are not known.
    pub information_lost: Option<InformationLostRecord>,
}

/// Information lost by a filter: expected figures at the fit, from estimates and from measurements.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InformationLostRecord {
    /// Standard error of each mean from the estimates over that from the measurements, 1 or more; null where not free.
    pub mean_std_error_ratio: Vec<Option<f64>>,
    /// Ratio of the standard errors of each element of the covariance; null where not free.
    pub covariance_std_error_ratio: Vec<Vec<Option<f64>>>,
    /// log of the ratio of the determinants of the information on all free quantities, from the estimates and from the
    /// measurements: 0 or less.
    pub log_det_ratio: Option<f64>,
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
    /// Tests with few tests, under `reml`; empty where there are no degrees of freedom.
    #[serde(flatten)]
    pub few_tests: MeanLawRecord,
    /// Whether each element is fixed, not estimated.
    pub fixed: Vec<bool>,
    /// α_μ of a proportional mean.
    pub scale: Option<ScaleRecord>,
    /// Regression coefficients.
    pub regression: Vec<RegressionRecord>,
}

/// Tests of means with few tests by the method in `df_method`, one entry for each element of μ; null where fixed or not
/// identified. `std_error` and `interval95` are then by the same method.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct MeanLawRecord {
    /// Standard errors of generalised least squares at the estimated covariance, which few tests make too small.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub std_error_plain: Vec<Option<f64>>,
    /// Degrees of freedom; null too where no covariance is estimated.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub df: Vec<Option<f64>>,
    /// Degrees of freedom by Satterthwaite among covariances of the estimated rank, as lmerTest has them: for comparison.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub df_face: Vec<Option<f64>>,
    /// t: estimate over `std_error`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub statistic: Vec<Option<f64>>,
    /// Two-sided p-value of the hypothesis that the mean is zero.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub p_value: Vec<Option<f64>>,
}

/// The test of a regression coefficient with few tests, as for means.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CoefficientLawRecord {
    /// Standard error of generalised least squares at the estimated covariance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std_error_plain: Option<f64>,
    /// Degrees of freedom.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub df: Option<f64>,
    /// Degrees of freedom by Satterthwaite among covariances of the estimated rank.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub df_face: Option<f64>,
    /// t: estimate over `std_error`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub statistic: Option<f64>,
    /// Two-sided p-value of the hypothesis that the coefficient is zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p_value: Option<f64>,
}

/// A scale factor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScaleRecord {
    /// Value of the factor.
    pub estimate: f64,
    /// Standard error of the factor.
    pub std_error: Option<f64>,
    /// 95 % interval.
    #[serde(default)]
    pub interval95: Interval,
}

/// One regression coefficient.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RegressionRecord {
    /// State whose mean depends on the column.
    pub state: String,
    /// Column that the mean depends on.
    pub column: String,
    /// Coefficient.
    pub estimate: f64,
    /// Standard error of the coefficient.
    pub std_error: Option<f64>,
    /// 95 % interval.
    #[serde(default)]
    pub interval95: Interval,
    /// The test of the coefficient with few tests, under `reml`.
    #[serde(flatten)]
    pub few_tests: CoefficientLawRecord,
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
    /// Whether each element is fixed, not estimated.
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
    /// Number of states whose variance is not fixed at zero.
    pub of: usize,
    /// The states of the block that is singular.
    #[serde(default)]
    pub states: Vec<String>,
    /// States whose estimated variance is zero.
    #[serde(default)]
    pub zero_variances: Vec<String>,
}

/// A direction that the data do not determine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct UnidentifiedRecord {
    /// `mean` or `covariance`.
    pub what: String,
    /// Unit vector over the states and regression coefficients (mean), or over the covariance elements, in their units:
    /// zero where an element takes no part. Where the direction mixes phases, this phase's part of it; a note names the
    /// whole.
    pub direction: Vec<f64>,
    /// Names of the entries of `direction`.
    #[serde(default)]
    pub elements: Vec<String>,
    /// Ids of the tests that inform any of its states, when they are at most twenty.
    #[serde(default)]
    pub tests: Vec<String>,
    /// Why the data do not determine it, in words.
    #[serde(default)]
    pub reason: String,
    /// The phases that the direction mixes; none where it is of this phase alone.
    #[serde(default)]
    pub phases: Vec<String>,
}

/// How well the ensemble determines one state.
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
    /// The test with the most information on its mean; null if the mean is fixed or not identified.
    pub leading_test: Option<String>,
    /// That test's share of the information, 0 to 1.
    pub leading_share: Option<f64>,
}

/// A weakly determined direction of the mean.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WeakRecord {
    /// Unit vector over the states. Where the direction mixes phases, this phase's part of it; a note names the whole.
    pub direction: Vec<f64>,
    /// Condition index: how many times less precisely it is known than the best known direction, states in comparable
    /// units.
    pub condition: f64,
    /// The test with the most information on it.
    pub leading_test: Option<String>,
    /// That test's share of the information, 0 to 1.
    pub leading_share: Option<f64>,
    /// The phases that the direction mixes; none where it is of this phase alone.
    #[serde(default)]
    pub phases: Vec<String>,
}
