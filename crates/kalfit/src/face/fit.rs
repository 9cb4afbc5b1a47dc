//! The results of a fit, and the options of a fit.

use kalfit_estimate as estimate;
use kalfit_estimate::{Estimate, Structure};
use kalfit_filter::reduce::Reductions;
use kalfit_infer::{Choices, Inference};
use kalfit_model::{Alpha, PhasedModel, Population};
use kalfit_record::FitRecord;
use kalfit_search::Method;

/// Options of a fit.
#[derive(Debug, Clone)]
pub struct Options {
    /// Settings of the search for μ and Σ.
    pub settings: estimate::Settings,
    /// Method of the search for free parameters.
    pub method: Method,
    /// Number of random starts of the search for free parameters, in addition to the start computed from the data.
    pub starts: usize,
    /// Seed of the random starts.
    pub seed: u64,
    /// Options of the inference.
    pub choices: Choices,
    /// Whether innovations are computed after the fit.
    pub innovations: bool,
}

impl Default for Options {
    fn default() -> Options {
        let (settings, choices) = (estimate::Settings::default(), Choices::default());
        Options { settings, method: Method::default(), starts: 0, seed: 1, choices, innovations: true }
    }
}

/// A model fitted to tests. [`Fit::mean`], [`Fit::std_dev`] and [`Fit::parameter`] give estimates by name; the fields
/// give all results.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The fitted model.
    pub model: PhasedModel,
    /// All values of α.
    pub alpha: Alpha,
    /// The reductions of the tests at α.
    pub reductions: Reductions,
    /// The estimates of μ and Σ, with the optimality certificate.
    pub estimate: Estimate,
    /// Uncertainty of the estimates, and the results of each test.
    pub inference: Inference,
    /// All results with names, ready to be written to fit.json.
    pub record: FitRecord,
}

impl Fit {
    /// Whether the optimality certificate holds for μ, Σ and α.
    pub fn converged(&self) -> bool {
        self.record.converged
    }

    /// log p of all measurements, including all constants; under REML the restricted log-likelihood.
    pub fn log_likelihood(&self) -> f64 {
        self.estimate.log_likelihood
    }

    /// The estimated population, to draw from or to plan with.
    pub fn population(&self) -> Population {
        Population::from(&self.estimate)
    }

    /// The structure that the model gives μ and Σ, for another fit to the same reductions.
    pub fn structure(&self) -> Structure<'_> {
        Structure::of(&self.model, &self.alpha, self.estimate.grouping())
    }
}
