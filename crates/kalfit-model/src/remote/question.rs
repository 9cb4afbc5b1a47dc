//! Questions to remote tests.

use serde::{Deserialize, Serialize};

use crate::remote::coordinates::Coordinates;

/// A question at a given α.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Asked {
    /// The free values of α, in the order of [`Slots`](crate::model::Slots).
    pub values: Vec<f64>,
    /// The requested sum over tests.
    pub question: Question,
}

/// A requested sum over tests. Matrices are lists of numbers by columns.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Question {
    /// The number of tests, and a value that the tests suggest for each free value of α.
    Opening,
    /// The number of tests, and sums over tests that do not depend on Σ.
    Survey,
    /// For each state, the excess of the scatter of tests about a mean over the scatter that noise explains.
    Excess {
        /// Centre and scale of η.
        frame: Coordinates,
        /// The mean in η.
        mean: Vec<f64>,
    },
    /// The number of tests that inform about each state, and the number of tests that observe each state.
    Observability {
        /// Centre and scale of η.
        frame: Coordinates,
    },
    /// ℓ and the derivatives of ℓ with respect to μ and Σ (theory §3).
    Pass {
        /// Centre and scale of η.
        frame: Coordinates,
        /// μ and Σ in η.
        place: Place,
        /// Which derivatives are requested.
        detail: Detail,
        /// The free coordinates of the mean, for the restricted likelihood; `None` for the full likelihood.
        flat: Option<Flat>,
    },
    /// dℓ/dα at a law of ξ (theory §6).
    Score {
        /// The law of ξ.
        law: Law,
    },
}

/// μ, regression coefficients and a root of Σ, in η.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// μ, p numbers.
    pub mean: Vec<f64>,
    /// Regression coefficients, one for each regression.
    pub coefficients: Vec<f64>,
    /// F with Σ = FF', p × any number of columns, by columns.
    pub root: Vec<f64>,
}

/// Which derivatives a pass computes; each choice includes all earlier choices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Detail {
    /// ℓ, the first derivatives, and the information on the mean within phases only: all that EM needs.
    First,
    /// In addition, all of the information on the mean.
    Mean,
    /// In addition, for groups that cross, the average of observed and expected information, in place of both: enough
    /// to climb by.
    Average,
    /// In addition, the observed information.
    Second,
    /// In addition, the expected information of Σ.
    Expected,
}

/// The mean as a linear function of free coordinates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Flat {
    /// Number of free coordinates.
    pub free: usize,
    /// d(mean coordinates) / d(free mean coordinates).
    pub jacobian: Vec<f64>,
    /// V, the covariance of the free mean coordinates; `None` where V is not known.
    pub covariance: Option<Vec<f64>>,
}

/// The law ξ_j ~ N(μ_j, FF'), in the user's units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Law {
    /// μ without regression, p numbers.
    pub mean: Vec<f64>,
    /// (element, coefficient) of each covariate: the element of μ to which coefficient × covariate is added.
    pub regression: Vec<(usize, f64)>,
    /// F, p × any number of columns, by columns.
    pub root: Vec<f64>,
    /// A root of the covariance of (μ, coefficients) at a known Σ, under the restricted likelihood.
    pub mean_half: Option<Vec<f64>>,
    /// For tests in groups: μ and Σ of all levels, from which the law of ξ of each test given all tests of the unit
    /// follows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub given: Option<InGroups>,
}

/// μ and Σ of the tests and of every level of groups, the tests first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InGroups {
    /// Centre and scale of η.
    pub frame: Coordinates,
    /// μ and Σ in η.
    pub place: Place,
}

impl Asked {
    /// Whether every number of the question is finite; otherwise the answer is not defined.
    pub(crate) fn is_finite(&self) -> bool {
        let finite = |numbers: &[f64]| numbers.iter().all(|x| x.is_finite());
        let framed =
            |frame: &Coordinates| finite(&frame.centre) && finite(&frame.scale) && finite(&frame.covariate_scale);
        let placed = |place: &Place| finite(&place.mean) && finite(&place.coefficients) && finite(&place.root);
        let own = match &self.question {
            Question::Opening | Question::Survey => true,
            Question::Excess { frame, mean } => framed(frame) && finite(mean),
            Question::Observability { frame } => framed(frame),
            Question::Pass { frame, place, flat, .. } => {
                let flat = flat
                    .as_ref()
                    .is_none_or(|flat| finite(&flat.jacobian) && flat.covariance.as_deref().is_none_or(finite));
                framed(frame) && placed(place) && flat
            }
            Question::Score { law } => {
                let coefficients = law.regression.iter().all(|(_, x)| x.is_finite());
                let given = law.given.as_ref().is_none_or(|given| framed(&given.frame) && placed(&given.place));
                let own = finite(&law.mean) && coefficients && finite(&law.root);
                own && law.mean_half.as_deref().is_none_or(finite) && given
            }
        };
        own && finite(&self.values)
    }
}
