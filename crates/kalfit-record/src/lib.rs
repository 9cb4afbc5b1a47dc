//! The result of a fit as a record: fit.json. Field names are a contract; unknown figures are null, never NaN.

mod along;
mod applied;
mod best_plan;
mod build;
mod by_group;
mod constraint;
mod cut;
mod datasheet;
mod diagnosis;
mod directions;
mod dynamic;
mod dynamic_ratio;
mod estimates;
mod exported;
mod factors;
mod few_tests;
mod figure;
mod group_levels;
mod heterogeneity;
mod known_groups;
mod levels;
mod misfit;
mod model_check;
mod number;
mod own;
mod parameters;
mod phase;
mod phases;
mod plain_text;
mod plan;
mod population;
mod posteriors;
mod predicted;
mod quantities;
mod ratio;
mod search;
mod series;
mod series_keeper;
mod square;
mod test;
mod test_records;

use serde::{Deserialize, Serialize};

pub use kalfit_infer::Interval;

pub use along::{AlongRecord, MeasurementAlong, PhaseAlong, StateAlong, TestAlong};
pub use applied::{AppliedRecord, AppliedSource, Basis, FarGroupRecord, FarRecord, JointRecord, LawRecord};
pub use best_plan::{BestPlanRecord, CandidateRecord, DrawsRecord};
pub use build::Provenance;
pub use by_group::{GroupRecord, GroupTestRecord, MixedGroup, TestGroups};
pub use constraint::ConstraintRecord;
pub use datasheet::{AllanPoint, CurveRecord, DATASHEET_SCHEMA, DatasheetRecord, EntryRecord};
pub use diagnosis::shortage_notes;
pub use directions::crossing_notes;
pub use dynamic::DynamicParts;
pub use dynamic_ratio::DynamicSides;
pub use estimates::{EstimatesRecord, FewTestsLawRecord};
pub use exported::{EXPORT_SCHEMA, ExportRecord, ExportSource, Words};
pub use factors::factor_notes;
pub use figure::{Figure, FigureField, FigureKind, FigureUnit, FigureValue};
pub use group_levels::{EffectCovarianceRecord, EffectRecord, FactorRecord, LevelRecord, SlotRecord, UnitRecord};
pub use heterogeneity::HeterogeneityRecord;
pub use known_groups::{KnownGroups, MetGroup, UnknownGroup};
pub use levels::{LevelCounts, level_notes};
pub use misfit::{MisfitRecord, MisfitTermRecord, NormalityRecord, UnlikeRecord, WrongRowRecord};
pub use model_check::{FindingRecord, ModelCheckRecord, SEARCH_LEVEL, displacement_limit, holm, overall_size};
pub use number::plain;
pub use own::OwnRecord;
pub use parameters::{MethodRecord, ParameterRecord, StartRecord};
pub use phase::{
    BoundaryRecord, CoefficientLawRecord, CovarianceRecord, EnteredRecord, FilterRecord, InformationLostRecord,
    InformationRecord, MatrixRecord, MeanLawRecord, MeanRecord, ObservabilityRecord, PhaseRecord, RegressionRecord,
    ScaleRecord, UnidentifiedRecord, VectorRecord, WeakRecord,
};
pub use plain_text::{directs_text, plain_text, undirected};
pub use plan::{ArrangementRecord, PlanNames, PlanProvenance, PlanRecord, PlannedRecord};
pub use population::{FIT_SCHEMA, RecordError};
pub use posteriors::PosteriorRecords;
pub use predicted::{PairRecord, PredictedRecord, PredictedSource, PredictedValueRecord, name_of};
pub use quantities::QuantityRecord;
pub use ratio::{BootstrapRecord, ComponentRecord, FRecord, PartRecord, RatioProvenance, RatioRecord, SideRecord};
pub use search::{SearchRecord, StageRecord};
pub use series::{AutocorrelationRecord, SeriesRecord, WindowRecord};
pub use series_keeper::SeriesKeeper;
pub use square::{NotSquare, SquareRecord};
pub use test::{
    DeletedRecord, DeletionRecord, InnovationPartRecord, InnovationRecord, PosteriorRecord, PosteriorRow, TestRecord,
    TestRow, WhitenessRecord,
};
pub use test_records::{InnovationRecords, TestRecords};

/// The results of a fit. `None` is written as null: unknown, not identified, or not applicable.
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
    /// The model in words and equations, one fact a line.
    #[serde(default)]
    pub model: Vec<String>,
    /// Counts of the data.
    pub data: DataRecord,
    /// `ml` or `reml`.
    pub criterion: String,
    /// `measurements`, or `estimates` where a phase has a filter of its own.
    pub log_likelihood_kind: String,
    /// log p of all measurements, including all constants; under `reml` the restricted log-likelihood.
    pub log_likelihood: f64,
    /// What was maximised where correlation between phases was ignored (`solver.phases` is `marginal`): the sum of the
    /// phases' log-likelihoods, each by itself. `log_likelihood` is then that of all phases together at the same
    /// estimates.
    #[serde(default)]
    pub composite_log_likelihood: Option<f64>,
    /// Declared free quantities: μ, Σ and α.
    pub free_parameters: usize,
    /// 2k - 2ℓ; null if ℓ is that of estimates, or is not the maximised function.
    pub aic: Option<f64>,
    /// k log(observations) - 2ℓ; null if `aic` is, or if there are no observations.
    pub bic: Option<f64>,
    /// The optimality certificate holds.
    pub converged: bool,
    /// Why the solver stopped, in words.
    pub reason: String,
    /// The optimality certificate.
    pub certificate: CertificateRecord,
    /// Whether the model describes the data, judged from the figures of this record; null in records of older versions.
    #[serde(default)]
    pub model_check: Option<ModelCheckRecord>,
    /// Misfit that tests have in common; null if innovations were not requested or the data were not at hand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub misfit: Option<MisfitRecord>,
    /// How the fit was computed.
    pub solver: SolverRecord,
    /// How the dynamic parameters were found; absent without free parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub search: Option<SearchRecord>,
    /// How standard errors were computed: `observed`, `expected` or `sandwich`.
    #[serde(default)]
    pub std_errors: String,
    /// How 95 % intervals were computed: `wald`, `profile` or `bootstrap`.
    #[serde(default)]
    pub intervals: String,
    /// How standard errors, degrees of freedom and intervals of means and regression coefficients were computed under
    /// `reml`: `kenward-roger` or `satterthwaite`; absent where they are those of many tests.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub df_method: Option<String>,
    /// How much tests differ beyond their noise; absent for models of several states, with levels or with free parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub heterogeneity: Option<HeterogeneityRecord>,
    /// One entry per phase.
    pub phases: Vec<PhaseRecord>,
    /// The variation between groups of each level, the outermost level first, and last that between tests; empty
    /// without levels.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub levels: Vec<LevelRecord>,
    /// The variation of each crossed factor, with the effect of each of its levels; empty without such factors.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub crossed: Vec<FactorRecord>,
    /// Results of each group: those of crossed factors, then level by level, the outermost first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub groups: Vec<UnitRecord>,
    /// Dynamic parameters, one entry per level, in the order of the model and, within a parameter, of the texts of its
    /// levels.
    pub parameters: Vec<ParameterRecord>,
    /// The covariance of all estimates; null for more than 200 of them, and in records of older versions.
    #[serde(default)]
    pub estimates: Option<EstimatesRecord>,
    /// Where searches for α from other starts ended, the best first.
    #[serde(default)]
    pub starts: Vec<StartRecord>,
    /// Where each of the requested methods ended, if there were several.
    #[serde(default)]
    pub methods: Vec<MethodRecord>,
    /// Every constrained element and the cost of its constraint.
    pub constraints: Vec<ConstraintRecord>,
    /// Results of each test.
    pub tests: TestRecords,
    /// The column that tests are grouped by; null where the model names none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub group_column: Option<String>,
    /// The tests of each group together, in the order of the groups' texts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub by_group: Vec<GroupRecord>,
    /// Whether the groups differ; null if it was not requested.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub group_test: Option<GroupTestRecord>,
    /// Findings in plain words, most important first.
    #[serde(default)]
    pub notes: Vec<String>,
}

/// Counts of the data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DataRecord {
    /// Number of tests.
    pub tests: usize,
    /// Steps over all tests.
    pub steps: usize,
    /// Scalar measurements over all tests.
    pub observations: usize,
    /// Sets of tests that share gains and information.
    pub design_classes: usize,
    /// Tests that needed the more accurate square-root filter.
    #[serde(default)]
    pub square_root_tests: usize,
    /// Files, as named on the command line.
    #[serde(default)]
    pub files: Vec<String>,
}

/// How far the optimality conditions are from holding, in standard errors.
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
    /// A bound of the effect of rounding errors on mean and covariance; the first two figures are not smaller.
    #[serde(default)]
    pub rounding: f64,
}

/// How the fit was computed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SolverRecord {
    /// `hybrid`, `innovations` or `em`; how α was found.
    pub method: String,
    /// `newton` or `em`.
    pub solver: String,
    /// `chain`, `marginal` or `stacked`.
    pub phases: String,
    /// Iterations of the solver; each uses the reductions of all tests.
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
