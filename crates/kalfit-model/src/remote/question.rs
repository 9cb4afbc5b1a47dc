//! What is asked of tests that are elsewhere.

use serde::{Deserialize, Serialize};

use crate::remote::coordinates::Coordinates;

/// A sum over tests at an α.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Asked {
    /// The free values of α, in the order of [`Slots`](crate::model::Slots).
    pub values: Vec<f64>,
    /// What is wanted there.
    pub question: Question,
}

/// What is wanted. Matrices are lists by columns.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Question {
    /// How many tests there are, and what they suggest for each free value.
    Opening,
    /// How many tests there are, and what they say together before anything is known of Σ.
    Survey,
    /// How far tests lie from a mean beyond what their noise explains, state by state.
    Excess {
        /// Where η stands.
        frame: Coordinates,
        /// The mean in η.
        mean: Vec<f64>,
    },
    /// How many tests inform and observe each state.
    Observability {
        /// Where η stands.
        frame: Coordinates,
    },
    /// ℓ and its derivatives by μ and Σ (theory §3).
    Pass {
        /// Where η stands.
        frame: Coordinates,
        /// μ and Σ in η.
        place: Place,
        /// Which derivatives.
        detail: Detail,
        /// What the restricted likelihood wants beside them.
        flat: Option<Flat>,
    },
    /// dℓ/dα at a law of ξ (theory §6).
    Score {
        /// The law.
        law: Law,
    },
}

/// μ, regression coefficients and a root of Σ, in η.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// p numbers.
    pub mean: Vec<f64>,
    /// One for each regression.
    pub coefficients: Vec<f64>,
    /// F with Σ = FF', p rows.
    pub root: Vec<f64>,
}

/// Which derivatives a pass computes, each with all before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Detail {
    /// ℓ and the first derivatives: all that EM needs. The information on the mean only within phases.
    First,
    /// And all of the information on the mean.
    Mean,
    /// And the observed information.
    Second,
    /// And the expected information of Σ.
    Expected,
}

/// The mean by its free coordinates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Flat {
    /// Number of free coordinates.
    pub free: usize,
    /// d(mean coordinates) / d(free mean coordinates).
    pub jacobian: Vec<f64>,
    /// V, the covariance of the free ones, where it is known.
    pub covariance: Option<Vec<f64>>,
}

/// ξ_j ~ N(μ_j, FF') in the user's units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Law {
    /// μ without regression, p numbers.
    pub mean: Vec<f64>,
    /// The element that each covariate moves, and its coefficient.
    pub regression: Vec<(usize, f64)>,
    /// F, p rows.
    pub root: Vec<f64>,
    /// A root of the covariance of (μ, coefficients) at a known Σ, under the restricted likelihood.
    pub mean_half: Option<Vec<f64>>,
    /// Where tests stand in groups: ξ of each is meant given all tests of its unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub given: Option<InGroups>,
}

/// μ and the Σ of every level of groups, that of the tests first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InGroups {
    /// Where η stands.
    pub frame: Coordinates,
    /// μ and Σ in η.
    pub place: Place,
}

impl Asked {
    /// Every number is finite: where one is not, nobody needs to be asked.
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
