//! A fit with all that came of it: the flow of the whole crate in one place.

use crate::dynamic::{self, DynamicFit, Method};
use crate::ensemble::Labels;
use crate::estimate::{self, Estimate, Progress, Structure};
use crate::face::ensemble::{Ensemble, EnsembleError};
use crate::face::second_look;
use crate::infer::{self, Choices, Inference};
use crate::model::{Alpha, PhasedModel, Population};
use crate::record::{DynamicParts, FitRecord, LevelCounts, Provenance, TestGroups, level_notes};
use crate::reduce::Reduction;
use crate::score::Slots;

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
    pub reductions: Vec<Reduction>,
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

    /// log p of all measurements, every constant included; under REML the restricted one.
    pub fn log_likelihood(&self) -> f64 {
        self.estimate.log_likelihood
    }

    /// The population that was found, to draw from or to plan with.
    pub fn population(&self) -> Population {
        Population::from(&self.estimate)
    }

    /// What the model says of μ and Σ, for another fit to the same reductions.
    pub fn structure(&self) -> Structure<'_> {
        Structure::of(&self.model, &self.alpha)
    }
}

/// Reduce, estimate, infer, record; with free parameters the search for them in place of the first two.
pub(super) fn of_tests(
    ensemble: &Ensemble,
    options: &Options,
    progress: &mut dyn Progress,
) -> Result<Fit, EnsembleError> {
    let (model, labels, tests) = (ensemble.model(), ensemble.labels(), ensemble.tests());
    let slots = Slots::in_phases(model, labels, tests);
    let mut fit = if slots.is_empty() {
        let alpha = slots.alpha(model.shared(), &[]);
        let reductions = ensemble.reduce(&alpha)?;
        of_reductions((model, &alpha), reductions, options, progress)?
    } else {
        let search = dynamic::Settings {
            method: options.method,
            inner: options.settings.clone(),
            starts: options.starts,
            seed: options.seed,
        };
        let found = dynamic::fit(model, labels, tests, &search, progress)?;
        let (inference, parameters) = dynamic::infer(model, tests, &found, options.choices)?;
        let parts = DynamicParts { model, labels, fit: &found, inference: &inference, parameters: &parameters };
        let record = FitRecord::dynamic(&parts, Provenance::default());
        let DynamicFit { alpha, reductions, estimate, .. } = found;
        Fit { model: model.clone(), alpha, reductions, estimate, inference, record }
    };
    fit.record.notes.extend(notes(model, labels, ensemble));
    if options.innovations {
        second_look::add_innovations(&mut fit, tests);
    }
    if let Some(mut groups) = TestGroups::new(model.shared()) {
        groups.take(tests, labels)?;
        fit.record.add_groups(&groups);
        fit.record.add_by_group();
    }
    fit.record.add_model_check();
    Ok(fit)
}

/// The same of reductions at a known α.
pub(super) fn of_reductions(
    (model, alpha): (&PhasedModel, &Alpha),
    reductions: Vec<Reduction>,
    options: &Options,
    progress: &mut dyn Progress,
) -> Result<Fit, EnsembleError> {
    let estimate = estimate::fit(&reductions, &Structure::of(model, alpha), &options.settings, progress)?;
    let inference = infer::infer(&estimate, &reductions, options.choices);
    let record = FitRecord::new(model, alpha, &reductions, &estimate, &inference, Provenance::default());
    Ok(Fit { model: model.clone(), alpha: alpha.clone(), reductions, estimate, inference, record })
}

fn notes(model: &PhasedModel, labels: &Labels, ensemble: &Ensemble) -> Vec<String> {
    let shared = model.shared();
    level_notes(shared, &LevelCounts::all(shared, labels, ensemble.tests()))
}
