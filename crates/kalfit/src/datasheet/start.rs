//! What differs from turn-on to turn-on and from unit to unit: mean and spread of the initial states.

use crate::datasheet::units::{Quantity, Unit};
use crate::model::{Expression, Model, PhasedModel, Population};
use crate::record::{EntryRecord, FitRecord, Interval};

/// Name of the tests' own level.
const TESTS: &str = "tests";

/// Entries of the estimated states of a phase, from its results where there are any.
pub(super) fn entries(
    model: &PhasedModel,
    at: usize,
    population: &Population,
    record: Option<&FitRecord>,
) -> Vec<EntryRecord> {
    let (phase, first) = (&model.phases[at], model.ranges()[at].start);
    let own = record.and_then(|record| record.phases.iter().find(|own| own.name == phase.name));
    let p = model.dimension();
    let levels = population.mean.len().checked_div(p).unwrap_or(1);
    let mut entries = Vec::new();
    for (k, &state) in phase.model.estimated.iter().enumerate() {
        let of = &phase.model.states[state];
        let unit = Unit::shown(of.unit.as_deref());
        let word = word(&phase.model, state, unit.quantity);
        let place = |names: &[String]| names.iter().position(|name| *name == of.name);
        let scaled = |interval: Interval| interval.map(|ends| ends.map(|end| end.map(|end| unit.factor * end)));
        let entry =
            |name: String, level: Option<String>, value: f64, interval: Interval, definition: String| EntryRecord {
                name,
                of: of.name.clone(),
                kind: "state".to_owned(),
                phase: phase.name.clone(),
                level,
                value: Some(unit.factor * value),
                unit: unit.label.clone(),
                interval95: scaled(interval),
                definition,
                from: Vec::new(),
                varies_with: Vec::new(),
            };
        let mean_of = own.and_then(|own| own.mean.interval95.get(place(&own.states)?).copied().flatten());
        let covariates = phase.model.mean.regression.iter().any(|regression| regression.element == k);
        let definition = match covariates {
            true => "mean over the population of tests, where the columns that it moves with are zero",
            false => "mean over the population of tests",
        };
        let mut mean = entry(format!("{word} mean"), None, population.mean[first + k], mean_of, definition.to_owned());
        mean.from = vec![format!("mean[{}]", of.name)];
        entries.push(mean);
        // the outermost level first, the tests' own last
        for level in (0..levels).rev() {
            let i = level * p + first + k;
            let value = population.covariance[(i, i)].max(0.0).sqrt();
            let name = match (levels, level) {
                (1, _) => None,
                (_, 0) => Some(TESTS.to_owned()),
                (_, level) => Some(model.levels[model.levels.len() - level].name.clone()),
            };
            let known = match &name {
                None => own.map(|own| (&own.states, &own.std_dev)),
                Some(name) => record
                    .and_then(|record| record.levels.iter().find(|level| level.name == *name))
                    .map(|level| (&level.states, &level.std_dev)),
            };
            let interval = known.and_then(|(states, spread)| spread.interval95.get(place(states)?).copied().flatten());
            if value == 0.0 && interval.is_none() {
                continue; // it does not vary there
            }
            let (suffix, definition) = match name.as_deref() {
                None => (String::new(), "standard deviation from test to test".to_owned()),
                Some(TESTS) => {
                    (", run to run".to_owned(), "standard deviation from test to test of one unit".to_owned())
                }
                Some(level) => (
                    format!(", unit to unit ({level})"),
                    format!("standard deviation from one `{level}` to the next of what their tests have in common"),
                ),
            };
            let mut spread = entry(format!("{word} repeatability{suffix}"), name.clone(), value, interval, definition);
            let element = format!("std_dev[{}]", of.name);
            spread.from = vec![name.map_or_else(|| element.clone(), |level| format!("{level}.{element}"))];
            entries.push(spread);
        }
    }
    entries
}

/// What a state is to its measurements: added as it is, or times columns.
fn word(model: &Model, state: usize, quantity: Quantity) -> String {
    let mut columns: Vec<&str> = Vec::new();
    let mut measured = false;
    for (_, coefficient) in
        model.measurements.iter().flat_map(|own| &own.equation.terms).filter(|(own, _)| *own == state)
    {
        measured = true;
        coefficient.any(&mut |part| {
            if let Expression::Column(column) = part {
                let name = model.columns[*column].name.as_str();
                if !columns.contains(&name) {
                    columns.push(name);
                }
            }
            false
        });
    }
    match (quantity, columns.is_empty()) {
        (Quantity::Part, _) => "scale factor".to_owned(),
        (_, false) => format!("sensitivity to {}", columns.join(", ")),
        (_, true) if measured => "turn-on".to_owned(),
        _ => "initial".to_owned(),
    }
}
