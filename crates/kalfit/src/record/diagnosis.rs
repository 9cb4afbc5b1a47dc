//! What the data identify and how well the model describes them, as records, with reasons in words.

use std::collections::HashMap;

use crate::infer::{Direction, Explanation, Leading, Observability, Quantity, Reason};
use crate::innovations::{Innovations, Whiteness};
use crate::model::Model;
use crate::record::{
    FitRecord, InnovationRecord, ObservabilityRecord, UnidentifiedRecord, WeakRecord, WhitenessRecord,
};

/// No more names than this in a sentence.
const MOST_NAMES: usize = 8;

impl UnidentifiedRecord {
    /// Directions with their elements named and their reasons in words.
    pub fn all(model: &Model, directions: &[Direction], explanations: &[Explanation]) -> Vec<UnidentifiedRecord> {
        let (what, states) = (|d: &Direction| d.quantity, model.estimated_names());
        let record = |(direction, explanation): (&Direction, &Explanation)| UnidentifiedRecord {
            what: match what(direction) {
                Quantity::Mean => "mean".to_owned(),
                Quantity::Covariance => "covariance".to_owned(),
            },
            direction: direction.direction.clone(),
            elements: match what(direction) {
                Quantity::Mean => mean_elements(model, &states),
                Quantity::Covariance => {
                    let pairs = (0..states.len()).flat_map(|i| (0..=i).map(move |j| (i, j)));
                    pairs.map(|(i, j)| format!("{}, {}", states[j], states[i])).collect()
                }
            },
            tests: explanation.tests.clone(),
            reason: words(model, &states, &explanation.reason),
        };
        directions.iter().zip(explanations).map(record).collect()
    }
}

/// States, then regression coefficients as `state per column`.
fn mean_elements(model: &Model, states: &[String]) -> Vec<String> {
    let coefficient =
        |r: &crate::model::Regression| format!("{} per {}", states[r.element], model.columns[r.column].name);
    states.iter().cloned().chain(model.mean.regression.iter().map(coefficient)).collect()
}

impl ObservabilityRecord {
    /// One for each estimated state of a model.
    pub fn all(model: &Model, seen: &Observability) -> Vec<ObservabilityRecord> {
        let record = |(name, state): (String, &crate::infer::StateObservability)| {
            let (leading_test, leading_share) = named(&state.leading);
            ObservabilityRecord {
                state: name,
                informed_by: state.informed_by,
                observed_by: state.observed_by,
                tests: state.tests.clone(),
                leading_test,
                leading_share,
            }
        };
        model.estimated_names().into_iter().zip(&seen.states).map(record).collect()
    }
}

impl WeakRecord {
    /// The weakly determined directions.
    pub fn all(seen: &Observability) -> Vec<WeakRecord> {
        let record = |weak: &crate::infer::WeakDirection| {
            let (leading_test, leading_share) = named(&weak.leading);
            WeakRecord { direction: weak.direction.clone(), condition: weak.condition, leading_test, leading_share }
        };
        seen.weak.iter().map(record).collect()
    }
}

fn named(leading: &Option<Leading>) -> (Option<String>, Option<f64>) {
    (leading.as_ref().map(|l| l.test.clone()), leading.as_ref().map(|l| l.share))
}

impl InnovationRecord {
    /// Figures of innovations at an estimate of p states.
    pub fn new(found: &Innovations, p: usize) -> InnovationRecord {
        let finite = |x: f64| Some(x).filter(|x| x.is_finite());
        let whiteness = |w: Whiteness| WhitenessRecord {
            statistic: w.statistic,
            lags: w.lags,
            degrees_of_freedom: w.degrees_of_freedom,
            p_value: w.p_value,
        };
        InnovationRecord {
            count: found.count,
            nis: finite(found.nis).filter(|_| found.count > 0),
            nis_p_value: found.p_value(p).and_then(finite),
            mean: found.mean.and_then(finite),
            whiteness: found.whiteness.filter(|w| w.statistic.is_finite() && w.p_value.is_finite()).map(whiteness),
        }
    }
}

impl FitRecord {
    /// Adds innovations to the tests of these ids; those of other tests are dropped.
    pub fn add_innovations(&mut self, found: Vec<(String, InnovationRecord)>) {
        let mut found: HashMap<String, InnovationRecord> = found.into_iter().collect();
        for test in &mut self.tests {
            test.innovations = found.remove(&test.id);
        }
    }
}

/// A reason in words, without a full stop.
fn words(model: &Model, states: &[String], reason: &Reason) -> String {
    let names = |of: &[usize]| list(of.iter().map(|&i| states[i].as_str()), "and");
    match reason {
        Reason::Unseen { states: dark } => {
            format!("no test observes {}", list(dark.iter().map(|&i| states[i].as_str()), "or"))
        }
        Reason::NeverTogether { states: both } => format!("{} are never observed in one test", names(both)),
        Reason::NeverApart { states: joined } => {
            format!("no test tells {} apart: only combinations of them are measured", names(joined))
        }
        Reason::TooFewCombinations { states: few } => {
            format!("the tests see too few different combinations of {}", names(few))
        }
        Reason::Confounded { regressions } => {
            let of = regressions.iter().map(|&r| &model.mean.regression[r]);
            let mut columns: Vec<&str> = of.map(|r| model.columns[r.column].name.as_str()).collect();
            columns.dedup();
            let vary = if columns.len() == 1 {
                "varies too little over the tests to tell its effect from the mean"
            } else {
                "vary too little, or together, over the tests to tell their effects apart"
            };
            format!("{} {vary}", list(columns.into_iter(), "and"))
        }
    }
}

/// What too few tests mean for Σ, in sentences without a full stop.
pub fn shortage_notes(model: &Model, seen: &Observability) -> Vec<String> {
    let states = model.estimated_names();
    let sentence = |s: &crate::infer::Shortage| {
        let names = list(s.states.iter().map(|&i| states[i].as_str()), "and");
        let tests =
            if s.tests == 1 { "only 1 test informs".to_owned() } else { format!("only {} tests inform", s.tests) };
        match (s.states.len(), s.rank) {
            (1, _) => format!("{tests} {names}, so its variance can only be estimated as zero"),
            (n, 0) => format!("{tests} {names}, so all their {n} variances can only be estimated as zero"),
            (n, rank) => format!(
                "{tests} {names}, so their covariance can only be estimated as singular, of rank {rank} at most out of {n}"
            ),
        }
    };
    seen.shortages.iter().map(sentence).collect()
}

/// `a`, `a and b`, `a, b and c`, each name in backticks.
pub(super) fn list<'a>(names: impl ExactSizeIterator<Item = &'a str>, last: &str) -> String {
    let all = names.len();
    let mut shown: Vec<String> = names.take(MOST_NAMES).map(|name| format!("`{name}`")).collect();
    if all > MOST_NAMES {
        shown.push(format!("{} more", all - MOST_NAMES));
    }
    match shown.pop() {
        Some(end) if shown.is_empty() => end,
        Some(end) => format!("{} {last} {end}", shown.join(", ")),
        None => String::new(),
    }
}
