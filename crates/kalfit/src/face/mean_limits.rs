//! Limits of predicted means by profile likelihood, for the model and tests of an ensemble.

use std::sync::Arc;

use crate::dynamic;
use crate::face::ensemble::Ensemble;
use crate::face::error::EnsembleError;
use kalfit_estimate as estimate;
use kalfit_estimate::{Progress, Stop, Structure};
use kalfit_filter::reduce::grouping;
use kalfit_infer as infer;
use kalfit_infer::dynamic::MeansAt;
use kalfit_model::Slots;
use kalfit_search::DynamicError;

/// Limits of predicted means, and the quality of the fit that they are computed from.
#[derive(Debug, Clone, PartialEq)]
pub struct MeanProfiles {
    /// log p of all measurements at the maximum.
    pub log_likelihood: f64,
    /// Whether the optimality certificate holds at the maximum; without it there are no limits.
    pub converged: bool,
    /// [lower, upper] limit of each mean; both limits equal the estimate where no estimated number moves the mean;
    /// `None` where a limit is not found.
    pub limits: Vec<Option<[f64; 2]>>,
}

impl Ensemble {
    /// Limits of predicted means by the likelihood-ratio test: values whose highest log-likelihood, over α, μ and Σ, is
    /// within half the square of `quantile` of the maximum. The model is fitted by maximum likelihood, from its start
    /// values.
    ///
    /// # Errors
    /// The errors of [`Ensemble::fit`].
    pub fn mean_limits(
        &self,
        means: MeansAt<'_>,
        quantile: f64,
        progress: &mut dyn Progress,
    ) -> Result<MeanProfiles, EnsembleError> {
        let (model, labels, tests) = (self.model(), self.labels(), self.tests());
        let slots = Slots::in_phases(model, labels, tests);
        if !slots.is_empty() {
            let fit = dynamic::fit(model, labels, tests, &dynamic::Settings::default(), progress)?;
            let converged = fit.stop == Stop::Certified && fit.estimate.stop == Stop::Certified;
            let limits = match converged {
                true => dynamic::mean_limits((model, tests), &fit, (means, quantile), progress),
                false => Vec::new(),
            };
            return Ok(MeanProfiles { log_likelihood: fit.estimate.log_likelihood, converged, limits });
        }
        let alpha = slots.alpha(model.shared(), &[]);
        let reductions = self.reduce(&alpha)?;
        let grouping = grouping(model, tests).map_err(DynamicError::from)?.map(Arc::new);
        let structure = Structure::of(model, &alpha, grouping.as_ref());
        let found = estimate::fit(&reductions, &structure, &estimate::Settings::default(), progress)?;
        let converged = found.stop == Stop::Certified;
        let combinations = if converged { means(&alpha) } else { None };
        let limits = infer::mean_limits(&found, &combinations.unwrap_or_default(), quantile, progress);
        Ok(MeanProfiles { log_likelihood: found.log_likelihood, converged, limits })
    }
}
