//! Innovations at the fit, from a second pass over the data.

use crate::face::fit::Fit;
use kalfit_filter::innovations::innovations;
use kalfit_infer::misfit::{FittedEnsemble, misfit};
use kalfit_model::{Grouping, PhasedTest};
use kalfit_record::{CROSSED_MISFIT, InnovationRecord, InnovationRecords, SeriesKeeper};

/// Adds innovations to the record, or a note why innovations were not computed; the fit does not depend on innovations.
pub(super) fn add_innovations(fit: &mut Fit, tests: &[PhasedTest]) {
    let model = &fit.model;
    let population = fit.population();
    let found = match innovations(model, &fit.alpha, &population.together(model.dimension()), tests) {
        Ok(found) => found,
        Err(error) => {
            fit.record.notes.push(format!("innovations were not computed: {error}"));
            return;
        }
    };
    let (mut series, mut records) = (SeriesKeeper::default(), InnovationRecords::default());
    let numbers = fit.record.tests.by_id();
    for one in found.into_iter().flatten() {
        let record = InnovationRecord::new(&one, model);
        if let Some(&number) = numbers.get(one.test.as_str()) {
            series.offer(&one, &record, model);
            records.put(number, record);
        }
    }
    fit.record.set_innovations(records);
    fit.record.add_series(series);
    let grouping = fit.estimate.grouping().map(|grouping| &**grouping);
    if grouping.is_some_and(Grouping::is_crossed) {
        return fit.record.notes.push(CROSSED_MISFIT.to_owned());
    }
    let of = FittedEnsemble { model: &fit.model, alpha: &fit.alpha, population: &population, tests, grouping };
    match misfit(&of, &mut |_| true) {
        Ok(found) => fit.record.set_misfit(&found, &fit.model),
        Err(error) => fit.record.notes.push(format!("misfit that tests have in common was not looked for: {error}")),
    }
}
