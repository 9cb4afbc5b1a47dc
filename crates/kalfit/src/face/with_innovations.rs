//! Innovations at the fit, from a second pass over the data.

use crate::face::fit::Fit;
use kalfit_filter::innovations::innovations;
use kalfit_infer::misfit::{FittedEnsemble, misfit};
use kalfit_model::PhasedTest;
use kalfit_record::{InnovationRecord, InnovationRecords, SeriesKeeper};

/// Adds innovations to the record, or a note why innovations were not computed; the fit does not depend on innovations.
pub(super) fn add_innovations(fit: &mut Fit, tests: &[PhasedTest]) {
    let model = &fit.model;
    let population = fit.population();
    let found = match innovations(model, &fit.alpha, &population.together(model.dimension(), &model.slots()), tests) {
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
    let of = FittedEnsemble { model: &fit.model, alpha: &fit.alpha, population: &population, tests, grouping };
    fit.record.set_misfit(misfit(&of, &mut |_| true), &fit.model);
}
