//! A fit with all that came of it, and what can be asked of one.

use kalfit_estimate as estimate;
use kalfit_estimate::{Estimate, Structure};
use kalfit_filter::reduce::Reductions;
use kalfit_infer::{Choices, Inference};
use kalfit_model::{Alpha, PhasedModel, Population};
use kalfit_record::FitRecord;
use kalfit_search::Method;

/// What is asked of a fit.
#[derive(Debug, Clone)]
pub struct Options {
    /// Of the search for μ and Σ.
    pub settings: estimate::Settings,
    /// How free parameters are sought.
    pub method: Method,
    /// Random starts of that search besides the one worked out from the data.
    pub starts: usize,
    /// Their seed.
    pub seed: u64,
    /// What is inferred, and how.
    pub choices: Choices,
    /// Look at the innovations after the fit.
    pub innovations: bool,
}

impl Default for Options {
    fn default() -> Options {
        let (settings, choices) = (estimate::Settings::default(), Choices::default());
        Options { settings, method: Method::default(), starts: 0, seed: 1, choices, innovations: true }
    }
}

/// A model fitted to tests. [`Fit::mean`], [`Fit::std_dev`] and [`Fit::parameter`] give figures by name; the fields give everything.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The model.
    pub model: PhasedModel,
    /// Every value of α.
    pub alpha: Alpha,
    /// The tests at α.
    pub reductions: Reductions,
    /// μ and Σ with their certificate.
    pub estimate: Estimate,
    /// What each number is worth, and what each test says.
    pub inference: Inference,
    /// All of it with names, ready to be written: fit.json.
    pub record: FitRecord,
}

impl Fit {
    /// The optimality certificate holds, of μ, Σ and α.
    pub fn converged(&self) -> bool {
        self.record.converged
    }

    /// log p of all measurements, including all constants; under REML the restricted one.
    pub fn log_likelihood(&self) -> f64 {
        self.estimate.log_likelihood
    }

    /// The population that was found, to draw from or to plan with.
    pub fn population(&self) -> Population {
        Population::from(&self.estimate)
    }

    /// What the model says of μ and Σ, for another fit to the same reductions.
    pub fn structure(&self) -> Structure<'_> {
        Structure::of(&self.model, &self.alpha, self.estimate.grouping())
    }
}
