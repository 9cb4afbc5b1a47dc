//! The record of a constraint: its cost in likelihood and its score test.

use serde::{Deserialize, Serialize};

use crate::FigureUnit;
use crate::figure::figures;

figures! {
    /// The cost of one constraint.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    pub struct ConstraintRecord {
        /// `mean[a]` or `covariance[a, b]`.
        pub element: String = figure {},
        /// Phase of the element.
        pub phase: String = figure {},
        /// Level of groups whose covariance it belongs to; null for the covariance of a phase.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub level: Option<String> = figure {},
        /// Value at which it is fixed.
        pub value: f64 = figure { heading: "held at", unit: FigureUnit::Element },
        /// dℓ_max / d value.
        pub sensitivity: Option<f64> = figure { heading: "dℓ/dvalue" },
        /// Score (Lagrange multiplier) statistic from the expected information, χ² with one degree of freedom.
        pub score_statistic: Option<f64> = figure {},
        /// p-value of the score statistic.
        pub p_value: Option<f64> = figure { heading: "p-value", unit: FigureUnit::Probability },
        /// Expected change of the element if it were freed, to first order, as far as Σ stays positive semidefinite.
        pub expected_change: Option<f64> = figure { unit: FigureUnit::Element },
        /// Likelihood ratio -2 log λ of a fit with only this element freed, for constraints that the score tests reject
        /// at the 5 % level after Bonferroni correction; where a fit at the same dynamic parameters decides, a lower
        /// bound.
        #[serde(default)]
        pub likelihood_ratio: Option<f64> = figure {},
        /// p-value of the likelihood ratio.
        #[serde(default)]
        pub likelihood_ratio_p_value: Option<f64> = figure { unit: FigureUnit::Probability },
        /// F of a fit with only this element freed, by the laws of few tests and with one degree of freedom in the
        /// numerator, for means that the score tests reject under the restricted likelihood.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub f: Option<f64> = figure {},
        /// Degrees of freedom of the denominator of F; absent where no covariance is estimated.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub f_df: Option<f64> = figure {},
        /// p-value of F.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub f_p_value: Option<f64> = figure { unit: FigureUnit::Probability },
    }
}
