//! The table of `kalfit predict`: a row for each state and each output at every row of a design.

use kalfit::PhasedModel;
use kalfit::predict::{Bounds, Output, PhasePredictions, Predicted};
use kalfit::record::name_of;
use kalfit_data::{CellKind, TableCell, WriteError};
use rayon::prelude::*;

use crate::table::OutputTableWriter;

pub(super) fn columns() -> Vec<(String, CellKind)> {
    let texts = ["test", "phase"].map(|name| (name, CellKind::Text));
    let numbers = [
        "mean",
        "std_dev",
        "std_dev_population",
        "std_dev_process",
        "std_dev_estimation",
        "confidence_lower",
        "confidence_upper",
        "tolerance_lower",
        "tolerance_upper",
    ];
    let place = [("row", CellKind::Count), ("time", CellKind::Number), ("name", CellKind::Text)];
    let all = texts.into_iter().chain(place).chain(numbers.map(|name| (name, CellKind::Number)));
    let last = [("what", CellKind::Text)].into_iter();
    let last = last.chain(["df", "prediction_lower", "prediction_upper"].map(|name| (name, CellKind::Number)));
    all.chain(last).map(|(name, kind)| (name.to_owned(), kind)).collect()
}

/// Limits of the mean, of tests, and of one new test with their degrees of freedom.
type AllLimits = (Option<[f64; 2]>, Option<[f64; 2]>, Option<([f64; 2], f64)>);

/// Writes one phase of a test.
pub(super) fn write_phase(
    (model, outputs, bounds): (&PhasedModel, &[Vec<Output>], &Bounds),
    test: &str,
    phase: &PhasePredictions,
    writer: &mut OutputTableWriter<'_>,
) -> Result<(), WriteError> {
    let of =
        |value: &Predicted| -> AllLimits { (bounds.of_mean(value), bounds.of_tests(value), bounds.of_new_test(value)) };
    let ends: Vec<Vec<AllLimits>> = phase.steps.par_iter().map(|step| step.values.iter().map(of).collect()).collect();
    let number_or = |x: Option<f64>| x.map_or(TableCell::Missing, TableCell::Number);
    let both = |ends: Option<[f64; 2]>| [number_or(ends.map(|ends| ends[0])), number_or(ends.map(|ends| ends[1]))];
    for (step, ends) in phase.steps.iter().zip(ends) {
        for (value, (confidence, tolerance, new_test)) in step.values.iter().zip(ends) {
            let Some((name, what, _)) = name_of((model, &outputs[phase.phase]), phase.phase, value.what) else {
                continue;
            };
            let [population, process] = [value.population, value.process].map(f64::sqrt);
            let estimation = value.estimation.map(|estimation| estimation.mean.sqrt());
            let mut cells = vec![
                TableCell::Text(test),
                TableCell::Text(&model.phases[phase.phase].name),
                TableCell::Count(value.row + 1), // rows are counted from one
                number_or(step.time),
                TableCell::Text(name),
                TableCell::Number(value.mean),
                TableCell::Number(value.std_dev()),
                TableCell::Number(population),
                TableCell::Number(process),
                number_or(estimation),
            ];
            cells.extend(both(confidence).into_iter().chain(both(tolerance)));
            cells.push(TableCell::Text(what));
            cells.push(number_or(new_test.map(|(_, degrees)| degrees).filter(|degrees| degrees.is_finite())));
            cells.extend(both(new_test.map(|(limits, _)| limits)));
            writer.write(cells)?;
        }
    }
    Ok(())
}
