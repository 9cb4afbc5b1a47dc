//! What suboptimal filters lost, where the measurements are at hand to compare with.

use kalfit::estimate::Structure;
use kalfit::model::{PhasedModel, Population};
use kalfit::plan::information_lost;
use kalfit::record::InformationLostRecord;
use kalfit::{Alpha, Evidence, FitRecord, PhasedTest, Reductions};
use kalfit_data::DataReading;

use crate::reductions;

/// True when rows of some phase go through a filter of the model.
pub(crate) fn filters_rows(model: &PhasedModel) -> bool {
    model.phases.iter().any(|phase| phase.filter.is_some())
}

/// Says of each filter what its estimates lost, against the same fit with the measurements of its phase. A filter whose
/// measurements some test does not give is left without: there is nothing to compare with.
pub(crate) fn add(
    record: &mut FitRecord,
    (model, alpha, population): (&PhasedModel, &Alpha, &Population),
    reductions: &Reductions,
    (tests, reading): (&[PhasedTest], &DataReading),
) {
    for i in 0..model.phases.len() {
        let measured =
            |test: &PhasedTest| !matches!(test.phases.get(i), Some(Evidence::Estimates(_) | Evidence::Reduced(_)));
        if model.phases[i].filter.is_none() || !tests.iter().all(measured) {
            continue;
        }
        let mut optimal = model.clone();
        optimal.phases[i].filter = None;
        let Ok(raw) = reductions::of(&optimal, alpha, tests, reading) else {
            record.notes.push(format!(
                "the information lost by the filter of phase `{}` is not known: its measurements cannot be reduced by themselves",
                model.phases[i].name
            ));
            continue;
        };
        match information_lost(&raw, reductions, &Structure::of(model, alpha, None), population) {
            Ok(lost) => record.add_information_lost(i, InformationLostRecord::new(model, i, &lost)),
            Err(error) => record.notes.push(format!("the information lost by a filter is not known: {error}")),
        }
    }
}
