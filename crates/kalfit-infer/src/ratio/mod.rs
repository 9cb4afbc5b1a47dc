//! Likelihood-ratio tests of nested hypotheses (theory §9; Shumway, Olsen and Levy): -2 log λ and the law of -2 log λ.

mod bootstrap;
pub(crate) mod calibrated;
mod cone;
mod law;
mod nested;
mod restricted;

pub(crate) use bootstrap::replicates;
pub use bootstrap::{Bootstrap, BootstrapResult, GoesOn, bootstrap, bootstrap_while};
pub use law::{Component, ReferenceLaw};
pub use nested::NotNested;
pub(crate) use nested::regressions;
pub use restricted::{NotNestedParameter, Restricted, restricted};

use kalfit_estimate::{Estimate, FitError, Progress, Settings, Silent, Structure, fit, fit_from};
use kalfit_filter::reduce::Reductions;

/// A test of a hypothesis within a model.
#[derive(Debug, Clone, PartialEq)]
pub struct LikelihoodRatio {
    /// -2 log λ = 2 (ℓ of the model - ℓ of the hypothesis).
    pub statistic: f64,
    /// Number of identified free quantities that the hypothesis removes; where the hypothesis bounds a sum of
    /// quantities that are identified only together, the number of all quantities that the hypothesis removes.
    pub degrees_of_freedom: usize,
    /// Large-sample law of the statistic under the hypothesis.
    pub law: ReferenceLaw,
    /// Whether the estimated Σ of the hypothesis has a lower rank than the hypothesis requires: p-values from the law
    /// are then unreliable.
    pub null_on_boundary: bool,
}

impl LikelihoodRatio {
    /// Tail probability of the statistic under `law`.
    pub fn p_value(&self) -> f64 {
        self.law.tail(self.statistic)
    }

    /// Tail probability of the statistic under χ² with `degrees_of_freedom`.
    pub fn chi_squared_p_value(&self) -> f64 {
        law::chi_squared_tail(self.degrees_of_freedom, self.statistic)
    }
}

/// Relative difference up to which two log-likelihoods count as equal.
const EQUAL_LIKELIHOODS: f64 = 1e-8;

/// Tests a hypothesis within a model, both fitted to the same reductions.
pub fn likelihood_ratio(null: &Estimate, alternative: &Estimate) -> Result<LikelihoodRatio, NotNested> {
    nested::check(null, alternative)?;
    let statistic = (2.0 * (alternative.log_likelihood - null.log_likelihood)).max(0.0);
    let is_rounding = statistic <= EQUAL_LIKELIHOODS * (1.0 + null.log_likelihood.abs());
    let tangent = cone::tangent(null, alternative, is_rounding);
    Ok(LikelihoodRatio {
        statistic: if is_rounding && tangent.degrees_of_freedom == 0 { 0.0 } else { statistic },
        degrees_of_freedom: tangent.degrees_of_freedom,
        law: tangent.law,
        null_on_boundary: tangent.null_on_boundary,
    })
}

/// Fits a hypothesis to the reductions of a model, with only the covariates of the hypothesis' regressions. `None` when
/// the hypothesis has a regression that the model does not have.
pub fn fit_null(
    reductions: &Reductions,
    model: &Structure<'_>,
    null: &Structure<'_>,
    settings: &Settings,
    progress: &mut dyn Progress,
) -> Option<Result<Estimate, FitError>> {
    let regression_indices = nested::regressions(null, model)?;
    Some(fit(&bootstrap::select_covariates(reductions, &regression_indices), null, settings, progress))
}

/// The fit of the model, repeated from the estimate of the hypothesis when this estimate has the higher likelihood: the
/// search for the model then ended at a local maximum.
pub fn at_least(alternative: Estimate, null: &Estimate, reductions: &Reductions) -> Result<Estimate, FitError> {
    if alternative.log_likelihood >= null.log_likelihood - 1e-9 * null.log_likelihood.abs().max(1.0) {
        return Ok(alternative);
    }
    let Some(regression_indices) = nested::regressions(&null.state.structure(), &alternative.state.structure()) else {
        return Ok(alternative);
    };
    let start = bootstrap::as_model_values(null, &regression_indices, alternative.coefficients.len());
    let state = &alternative.state;
    let again = fit_from(reductions, &state.structure(), &start, &state.settings, &mut Silent)?;
    Ok(if again.log_likelihood > alternative.log_likelihood { again } else { alternative })
}
