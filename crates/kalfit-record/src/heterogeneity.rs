//! How much tests differ beyond their noise, as a record.

use serde::{Deserialize, Serialize};

use crate::{FewTestsLawRecord, PhaseRecord, SquareRecord};
use kalfit_infer::{Heterogeneity, student_quantile};

/// Cochran's Q, I² and H², for a model of one state whose noise is known.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HeterogeneityRecord {
    /// Cochran's Q.
    pub q: f64,
    /// Degrees of freedom of Q.
    pub degrees_of_freedom: usize,
    /// P(χ² at least Q) where tests do not differ.
    pub p_value: f64,
    /// I²: share of the variance of typical estimates that is spread between tests, from 0 to 1.
    pub i_squared: f64,
    /// H²: variance of typical estimates over that of their noise.
    pub h_squared: f64,
    /// Noise variance of a typical test.
    pub typical_variance: f64,
    /// Limits that contain the state of one new test with probability 95 %; null with regressions, and where the spread is
    /// estimated as zero or not identified.
    #[serde(default)]
    pub prediction95: Option<[f64; 2]>,
    /// Degrees of freedom of these limits by Student's t; null where they are normal.
    #[serde(default)]
    pub prediction_df: Option<f64>,
}

impl HeterogeneityRecord {
    /// The record, with what the only phase says of a new test.
    pub(crate) fn new(
        found: &Heterogeneity,
        phase: &PhaseRecord,
        law: Option<&FewTestsLawRecord>,
    ) -> HeterogeneityRecord {
        let Heterogeneity { q, degrees_of_freedom, p_value, i_squared, h_squared, typical_variance } = *found;
        let (prediction95, prediction_df) = prediction(phase, law).unzip();
        let prediction_df = prediction_df.flatten();
        HeterogeneityRecord {
            q,
            degrees_of_freedom,
            p_value,
            i_squared,
            h_squared,
            typical_variance,
            prediction95,
            prediction_df,
        }
    }
}

/// Limits of a new test, μ ± t √(τ² + se²), and their degrees of freedom (theory (14.12)): 2h²/((1 + c')²V) with h = τ² +
/// c, c the plain variance of the mean, c' its derivative with respect to τ², and V the variance of the estimate of τ².
fn prediction(phase: &PhaseRecord, law: Option<&FewTestsLawRecord>) -> Option<([f64; 2], Option<f64>)> {
    let (mean, covariance) = (&phase.mean, &phase.covariance);
    if !mean.regression.is_empty() || phase.states.len() != 1 {
        return None;
    }
    let (estimate, error) = (*mean.estimate.first()?, (*mean.std_error.first()?)?);
    let spread = *covariance.estimate.first()?.first()?;
    if spread <= 0.0 || covariance.std_error.first()?.first()?.is_none() {
        return None;
    }
    let single = |square: &SquareRecord| (square.size() == 1).then(|| square[0][0]);
    let freedom = law.and_then(|law| {
        let (variance, plain) = (single(&law.covariance)?, single(&law.mean_covariance_plain)?);
        let slope = law.mean_slopes.first().and_then(single)?;
        Some(2.0 * (spread + plain).powi(2) / ((1.0 + slope).powi(2) * variance))
    });
    let half = student_quantile(freedom.unwrap_or(f64::INFINITY), 0.975)? * (spread + error * error).sqrt();
    let limits = [estimate - half, estimate + half];
    limits.iter().all(|x| x.is_finite()).then_some((limits, freedom))
}
