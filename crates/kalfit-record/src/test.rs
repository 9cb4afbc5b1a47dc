//! Results of one test, as a record.

use serde::{Deserialize, Serialize};

use crate::figure::{figures, viewed_figures};
use crate::posteriors::PosteriorRecords;
use crate::{FigureUnit, OwnRecord, SeriesRecord, SquareRecord};

viewed_figures! {
    /// Results of one test.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize)]
    pub struct TestRecord<'a> {
        /// Id of the test.
        pub id: &'a str as String,
        /// Text of the test in the column that tests are grouped by; null where there is none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub group: Option<&'a String> as Option<String>,
        /// Names of its groups where the model has levels, the outermost first.
        #[serde(default, skip_serializing_if = "<[String]>::is_empty")]
        pub groups: &'a [String] as Vec<String>,
        /// log p of the measurements of the test; where tests are in groups, without the other tests of the group.
        pub log_likelihood: f64 = figure { heading: "log-likelihood", unit: FigureUnit::LogLikelihood },
        /// Scalar measurements used.
        pub observations: usize = figure { heading: "observations" },
        /// Number of steps; null in records without it.
        #[serde(default)]
        pub steps: Option<usize> = figure {},
        /// Number of its design class, from 1 in the order of the tests; null in records without it.
        #[serde(default)]
        pub design_class: Option<usize> = figure {},
        /// Posterior of ξ, by phase.
        pub phases: PosteriorRecords<'a> as Vec<PosteriorRow>,
        /// Standardised squared distance of the test from the population.
        pub distance: Option<f64> = figure {
            heading: "distance²",
            sentence: "Distance²: squared distance of the test's initial state from the population, in standard \
                       deviations.",
        },
        /// Degrees of freedom of the distance: rank of J.
        pub degrees_of_freedom: usize = figure { heading: "expected" },
        /// χ² p-value of the distance.
        pub p_value: Option<f64> = figure { heading: "p-value", unit: FigureUnit::Probability },
        /// The fit without this test; null if it was not requested or has no certified optimum.
        #[serde(default)]
        pub deletion: Option<&'a DeletionRecord> as Option<DeletionRecord>,
        /// Innovations of the filter at the estimate; null if they were not requested or cannot be computed.
        #[serde(default)]
        pub innovations: Option<&'a InnovationRecord> as Option<InnovationRecord>,
    }

    /// A [`TestRecord`] that owns its data, as it is read or put together by hand.
    #[derive(Debug, Clone, PartialEq, Deserialize)]
    pub struct TestRow;

    /// The figures of a [`TestRecord`], which every test has.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub(crate) struct TestFigures;
}

/// Posterior of ξ in one phase.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PosteriorRecord<'a> {
    /// Name of the phase.
    pub name: &'a str,
    /// E[ξ | z].
    pub mean: &'a [f64],
    /// Var[ξ | z].
    pub covariance: SquareRecord<&'a [f64]>,
    /// The estimate from the test alone; null if it determines no state alone, and in very large ensembles.
    pub own: Option<&'a OwnRecord>,
}

/// A [`PosteriorRecord`] that owns its data.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[expect(missing_docs, reason = "its fields are those of the record")]
pub struct PosteriorRow {
    pub name: String,
    pub mean: Vec<f64>,
    pub covariance: SquareRecord,
    #[serde(default)]
    pub own: Option<OwnRecord>,
}

impl From<TestRecord<'_>> for TestRow {
    fn from(test: TestRecord<'_>) -> TestRow {
        TestRow::with(
            test.figures(),
            test.id.to_owned(),
            test.group.cloned(),
            test.groups.to_vec(),
            test.phases.iter().map(PosteriorRow::from).collect(),
            test.deletion.cloned(),
            test.innovations.cloned(),
        )
    }
}

impl From<PosteriorRecord<'_>> for PosteriorRow {
    fn from(part: PosteriorRecord<'_>) -> PosteriorRow {
        PosteriorRow {
            name: part.name.to_owned(),
            mean: part.mean.to_vec(),
            covariance: part.covariance.to_owned(),
            own: part.own.cloned(),
        }
    }
}

figures! {
    /// Innovations of one test at the estimate, as figures: e of variance S, in the order of the filter.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    pub struct InnovationRecord {
        /// Number of innovations, n.
        pub count: usize = figure { column: None, heading: "innovations" },
        /// Normalised innovation squared, Σ e²/S; its expectation is n. Null without innovations.
        pub nis: Option<f64> = figure {},
        /// Σ e²/S of innovations made independent of those of other tests of its groups, by the law of the whole model;
        /// null without levels.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub whitened_nis: Option<f64> = figure { column: None },
        /// Two-sided p-value of `nis`: twice the smaller of the upper tail of χ²_n and the lower tail of χ² with n less
        /// the number of estimated states, which the estimate may have absorbed.
        pub nis_p_value: Option<f64> = figure { heading: "p-value", unit: FigureUnit::Probability },
        /// Mean of e/√S; its standard deviation is 1/√n.
        pub mean: Option<f64> = figure {
            column: Some("innovations_mean"),
            heading: "mean",
            sentence: "Mean: of the innovations in their standard deviations; expected 0.",
            unit: FigureUnit::Deviations,
        },
        /// Ljung and Box's test of whiteness; null when there are too few innovations.
        pub whiteness: Option<WhitenessRecord>,
        /// Innovations of each measurement of each phase, where the model has several phases.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        pub parts: Vec<InnovationPartRecord>,
        /// The innovations in order; null but for the least probable tests.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub series: Option<Box<SeriesRecord>>,
    }
}

/// Innovations of one measurement of one phase of a test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InnovationPartRecord {
    /// Name of the phase.
    pub phase: String,
    /// Name of the measurement.
    pub measurement: String,
    /// Figures of these innovations, as for those of a test.
    #[serde(flatten)]
    pub innovations: InnovationRecord,
}

figures! {
    /// Ljung and Box's test of the e/√S, summed over the measurements.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    pub struct WhitenessRecord {
        /// The statistic.
        pub statistic: f64 = figure {
            column: Some("whiteness"),
            heading: "whiteness",
            sentence: "Whiteness: Ljung and Box's statistic.",
        },
        /// The longest lag: at most 10, and one for every five innovations of a measurement.
        pub lags: usize = figure { column: None },
        /// Degrees of freedom: the lags of all measurements together.
        pub degrees_of_freedom: usize = figure {
            column: Some("whiteness_degrees_of_freedom"),
            heading: "expected",
        },
        /// Probability of a statistic as large as this, by its law for series of these lengths: in the tail it is far
        /// from χ².
        pub p_value: f64 = figure {
            column: Some("whiteness_p_value"),
            heading: "p-value of whiteness",
            unit: FigureUnit::Probability,
        },
    }
}

figures! {
    /// The fit without one test.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    pub struct DeletionRecord {
        /// log p of the test's measurements at the fit without it, with parameters from all tests: its predictive
        /// density.
        pub log_density: f64 = figure { column: Some("log_density_without"), unit: FigureUnit::LogLikelihood },
        /// Standardised squared distance from the population estimated from the other tests.
        pub distance: Option<f64> = figure { column: Some("distance_without") },
        /// χ² p-value of the distance.
        pub p_value: Option<f64> = figure {
            column: Some("p_value_without"),
            heading: "p-value without it",
            sentence: "The p-value says how well the test agrees with the estimates from the other tests.",
            unit: FigureUnit::Probability,
        },
        /// 2 (ℓ(θ̂) - ℓ(θ̂ without the test)) over all tests: how far the test pulls the estimate.
        pub displacement: f64 = figure {
            heading: "displacement",
            sentence: "Displacement (Cook's): twice the drop in the log-likelihood of all tests when the estimates from \
                       the other tests are used.",
        },
        /// The estimates without the test, by phase.
        pub phases: Vec<DeletedRecord>,
    }
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
