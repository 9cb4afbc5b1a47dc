//! What each free value of α is worth.

use statrs::distribution::{ContinuousCDF, Normal};

use crate::dynamic::covariances::ValueCovariances;
use crate::dynamic::{Coordinate, DynamicFit, ParameterInference, Standing};
use crate::model::PhasedModel;

/// A logarithm with a standard error beyond this is not determined by the data.
const UNDETERMINED: f64 = 10.0;

/// Standard errors by the delta method; intervals by Wald in the coordinate, so that those of positive values are positive.
pub(crate) fn parameters(
    model: &PhasedModel,
    fit: &DynamicFit,
    covariances: &ValueCovariances,
) -> Vec<ParameterInference> {
    let coordinates = Coordinate::of(model, &fit.slots);
    let normal = Normal::standard().inverse_cdf(0.975);
    let one = |s: usize| {
        let (coordinate, value) = (coordinates[s], fit.values[s]);
        let nothing = |standing| ParameterInference { std_error: None, interval: None, standing };
        if fit.standing[s] != Standing::Inside {
            return nothing(fit.standing[s]);
        }
        let Some(error) = covariances.alpha[s].map(f64::sqrt).filter(|e| e.is_finite()) else {
            return nothing(Standing::Unidentified);
        };
        if coordinate.log && error > UNDETERMINED {
            return nothing(Standing::Unidentified);
        }
        let ends = if coordinate.log {
            [value * (-normal * error).exp(), value * (normal * error).exp()]
        } else {
            [value - normal * error, value + normal * error]
        };
        let ends = ends.map(|end| end.clamp(coordinate.lower, coordinate.upper));
        ParameterInference {
            std_error: Some(error * coordinate.slope(value)),
            interval: Some(ends.map(Some)),
            standing: Standing::Inside,
        }
    };
    (0..fit.values.len()).map(one).collect()
}
