//! Variation from turn-on to turn-on and from unit to unit: mean and standard deviation of the initial states.

use crate::datasheet::units::{ShownUnit, UnitQuantity};
use kalfit_infer::Interval;
use kalfit_model::{Expression, Model, PhasedModel, Population};
use kalfit_record::{EntryRecord, FitRecord, PhaseRecord};

/// Name of the level of the tests themselves.
const TESTS: &str = "tests";
/// Definition of the standard deviation over tests that belong to no units.
const WITHOUT_UNITS: &str = "standard deviation from test to test; it is the repeatability of IEEE 528 and 647, the agreement of one unit's values over turn-ons under the same conditions, only if all tests are of one unit";
/// Definition of the standard deviation over tests of one unit.
const WITHIN_UNIT: &str = "standard deviation from test to test of one unit, the repeatability of IEEE 528 and 647 if the tests are under the same conditions";

/// Entries of the estimated states of a phase, with intervals from `record` where there is a record.
pub(super) fn entries(
    model: &PhasedModel,
    at: usize,
    population: &Population,
    record: Option<&FitRecord>,
) -> Vec<EntryRecord> {
    let phase = &model.phases[at];
    let own = record.and_then(|record| record.phases.iter().find(|own| own.name == phase.name));
    let blocks = population.mean.len().checked_div(model.dimension()).unwrap_or(1);
    let mut entries = Vec::new();
    for (k, &state) in phase.model.estimated.iter().enumerate() {
        let of = &phase.model.states[state];
        let unit = ShownUnit::shown(of.unit.as_deref());
        let word = word(&phase.model, state, unit.quantity);
        let i = model.ranges()[at].start + k;
        let own = StateEntries { model, phase: at, name: &of.name, unit, word, record, own };
        let covariates = phase.model.mean.regression.iter().any(|regression| regression.element == k);
        entries.push(own.mean(population.mean[i], covariates));
        // the outermost level comes first, the level of the tests last
        let deviation = |block: usize| {
            let i = block * model.dimension() + i;
            population.covariance[(i, i)].max(0.0).sqrt()
        };
        entries.extend((0..blocks).rev().filter_map(|block| own.deviation_entry(deviation(block), (block, blocks))));
    }
    entries
}

/// Data that the entries of one state share.
struct StateEntries<'a> {
    model: &'a PhasedModel,
    phase: usize,
    name: &'a str,
    unit: ShownUnit,
    word: String,
    record: Option<&'a FitRecord>,
    /// The results of the phase.
    own: Option<&'a PhaseRecord>,
}

impl StateEntries<'_> {
    fn entry(&self, name: String, value: f64, interval: Interval) -> EntryRecord {
        let factor = self.unit.factor;
        EntryRecord {
            name,
            of: self.name.to_owned(),
            kind: "state".to_owned(),
            phase: self.model.phases[self.phase].name.clone(),
            level: None,
            at: None,
            value: Some(factor * value),
            unit: self.unit.label.clone(),
            interval95: interval.map(|ends| ends.map(|end| end.map(|end| factor * end))),
            definition: String::new(),
            from: Vec::new(),
            varies_with: Vec::new(),
        }
    }

    /// The interval of this state among `intervals`, the intervals of `states`.
    fn interval(&self, states: &[String], intervals: &[Interval]) -> Interval {
        let place = states.iter().position(|state| state == self.name)?;
        intervals.get(place).copied().flatten()
    }

    fn mean(&self, value: f64, covariates: bool) -> EntryRecord {
        let interval = self.own.and_then(|own| self.interval(&own.states, &own.mean.interval95));
        let definition = match covariates {
            true => "mean over the population of tests, at zero values of its regression columns",
            false => "mean over the population of tests",
        };
        EntryRecord {
            definition: definition.to_owned(),
            from: vec![format!("mean[{}]", self.name)],
            ..self.entry(format!("{} mean", self.word), value, interval)
        }
    }

    /// Entry of the standard deviation in one of the `blocks` blocks of Σ; `None` where the state does not vary there.
    fn deviation_entry(&self, value: f64, (block, blocks): (usize, usize)) -> Option<EntryRecord> {
        let level = match (blocks, block) {
            (1, _) => None,
            (_, 0) => Some(TESTS.to_owned()),
            (_, block) => Some(self.model.levels[self.model.levels.len() - block].name.clone()),
        };
        let interval = match &level {
            None => self.own.and_then(|own| self.interval(&own.states, &own.std_dev.interval95)),
            Some(name) => {
                let own = self.record.and_then(|record| record.all_levels().find(|level| level.name == *name));
                own.and_then(|own| self.interval(&own.states, &own.std_dev.interval95))
            }
        };
        if value == 0.0 && interval.is_none() {
            return None;
        }
        let (suffix, definition) = match level.as_deref() {
            None => (String::new(), WITHOUT_UNITS.to_owned()),
            Some(TESTS) => (", run to run".to_owned(), WITHIN_UNIT.to_owned()),
            Some(factor) if self.model.factors().iter().any(|own| own.name == factor) => (
                format!(", {factor} to {factor}"),
                format!(
                    "standard deviation, from one `{factor}` to the next, of the part that tests there share; it is of what tests meet, not of the instruments"
                ),
            ),
            Some(level) => (
                format!(", unit to unit ({level})"),
                format!(
                    "standard deviation, from one `{level}` to the next, of the part that its tests share; it is a spread of the population, no repeatability in the sense of IEEE 528 and 647"
                ),
            ),
        };
        let element = format!("std_dev[{}]", self.name);
        let from = vec![level.as_ref().map_or_else(|| element.clone(), |level| format!("{level}.{element}"))];
        let entry = self.entry(format!("{} repeatability{suffix}", self.word), value, interval);
        Some(EntryRecord { level, definition, from, ..entry })
    }
}

/// Word for the role of a state in measurements: the state is added unchanged, or multiplied by columns.
fn word(model: &Model, state: usize, quantity: UnitQuantity) -> String {
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
        (UnitQuantity::Part, _) => "scale factor".to_owned(),
        (_, false) => format!("sensitivity to {}", columns.join(", ")),
        (_, true) if measured => "turn-on".to_owned(),
        _ => "initial".to_owned(),
    }
}
