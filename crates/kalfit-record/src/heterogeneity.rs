//! How much tests differ beyond their noise, as a record.

use serde::{Deserialize, Serialize};

use kalfit_infer::Heterogeneity;

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
}

impl From<Heterogeneity> for HeterogeneityRecord {
    fn from(found: Heterogeneity) -> HeterogeneityRecord {
        let Heterogeneity { q, degrees_of_freedom, p_value, i_squared, h_squared, typical_variance } = found;
        HeterogeneityRecord { q, degrees_of_freedom, p_value, i_squared, h_squared, typical_variance }
    }
}
