//! The steps from a model and tests to a fit: reductions, estimates, inference and record.

use std::sync::Arc;

use crate::dynamic;
use crate::face::ensemble::Ensemble;
use crate::face::error::EnsembleError;
use crate::face::fit::{Fit, Options};
use crate::face::with_innovations;
use kalfit_estimate as estimate;
use kalfit_estimate::{Progress, Silent, Structure};
use kalfit_filter::reduce::{Reductions, grouping};
use kalfit_infer as infer;
use kalfit_lanes::Isa;
use kalfit_model::build::Columns;
use kalfit_model::{Alpha, PhasedModel, Slots};
use kalfit_model::{Grouping, Labels};
use kalfit_record::{DynamicParts, FitRecord, LevelCounts, Provenance, TestGroups, level_notes};
use kalfit_search::{DynamicError, DynamicFit};

/// Fits a model to tests: μ, Σ and free dynamic parameters by maximum likelihood, with the inference about these
/// estimates. The result depends neither on the order of the tests nor on the number of threads.
///
/// # Errors
/// The columns do not fit the model, the filter cannot work with the numbers, or there are no tests.
pub fn fit(model: &PhasedModel, tests: &[Columns]) -> Result<Fit, EnsembleError> {
    Ensemble::new(model, tests)?.fit()
}

impl Ensemble {
    /// Fits the model with default options, as [`fit`](crate::fit).
    ///
    /// # Errors
    /// The errors of the function `fit`.
    pub fn fit(&self) -> Result<Fit, EnsembleError> {
        self.fit_with(&Options::default(), &mut Silent)
    }

    /// Fits the model with the given options, and reports progress.
    ///
    /// # Errors
    /// The errors of [`fit`](crate::fit); also options that cannot be combined.
    pub fn fit_with(&self, options: &Options, progress: &mut dyn Progress) -> Result<Fit, EnsembleError> {
        fit_tests(self, options, progress)
    }
}

/// Reduces, estimates, infers and records; with free parameters, the search for α replaces the reduction and the
/// estimation.
fn fit_tests(ensemble: &Ensemble, options: &Options, progress: &mut dyn Progress) -> Result<Fit, EnsembleError> {
    Isa::chosen()?;
    let (model, labels, tests) = (ensemble.model(), ensemble.labels(), ensemble.tests());
    let slots = Slots::in_phases(model, labels, tests);
    let mut fit = if slots.is_empty() {
        let alpha = slots.alpha(model.shared(), &[]);
        let reductions = ensemble.reduce(&alpha)?;
        let grouping = grouping(model, tests).map_err(DynamicError::from)?.map(Arc::new);
        let mut fit = fit_at_alpha((model, &alpha), (reductions, grouping.as_ref()), options, progress)?;
        fit.record.add_levels((model, labels), (grouping.as_deref(), &fit.reductions), &fit.inference);
        fit
    } else {
        let search = dynamic::Settings {
            method: options.method,
            inner: options.settings.clone(),
            starts: options.starts,
            seed: options.seed,
        };
        let found = dynamic::fit(model, labels, tests, &search, progress)?;
        let (inference, parameters) = dynamic::infer(model, (labels, tests), &found, options.choices, progress)?;
        let parts = DynamicParts { model, labels, fit: &found, inference: &inference, parameters: &parameters };
        let mut record = FitRecord::dynamic(&parts, Provenance::default());
        let grouping = found.estimate.grouping().map(|grouping| &**grouping);
        record.add_levels((model, labels), (grouping, &found.reductions), &inference);
        let DynamicFit { alpha, reductions, estimate, .. } = found;
        Fit { model: model.clone(), alpha, reductions, estimate, inference, record }
    };
    fit.record.notes.extend(notes(model, labels, ensemble));
    if options.innovations {
        with_innovations::add_innovations(&mut fit, tests);
    }
    if let Some(mut groups) = TestGroups::new(model.shared()) {
        groups.take(tests, labels)?;
        fit.record.add_groups(&groups);
        fit.record.add_by_group();
    }
    fit.record.add_model_check();
    Ok(fit)
}

/// Estimates, infers and records, from reductions at a known α.
pub(super) fn fit_at_alpha(
    (model, alpha): (&PhasedModel, &Alpha),
    (reductions, grouping): (Reductions, Option<&Arc<Grouping>>),
    options: &Options,
    progress: &mut dyn Progress,
) -> Result<Fit, EnsembleError> {
    let estimate = estimate::fit(&reductions, &Structure::of(model, alpha, grouping), &options.settings, progress)?;
    let inference = infer::infer_while(model, (&estimate, &reductions), options.choices, progress);
    let record = FitRecord::new(model, alpha, &reductions, &estimate, &inference, Provenance::default());
    Ok(Fit { model: model.clone(), alpha: alpha.clone(), reductions, estimate, inference, record })
}

fn notes(model: &PhasedModel, labels: &Labels, ensemble: &Ensemble) -> Vec<String> {
    let shared = model.shared();
    level_notes(shared, &LevelCounts::all(shared, labels, ensemble.tests()))
}
