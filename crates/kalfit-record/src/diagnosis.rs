//! What the data identify and how well the model describes them, as records, with reasons in words.

use crate::cut::{BlockCut, regressions};
use crate::{InnovationPartRecord, InnovationRecord, ObservabilityRecord, WhitenessRecord};
use kalfit_filter::innovations::{Innovations, Part, Summary, Whiteness};
use kalfit_infer::{Leading, Observability, Reason, StateObservability};
use kalfit_model::PhasedModel;

/// Largest number of names in a sentence.
const MOST_NAMES: usize = 8;

impl ObservabilityRecord {
    /// One record for each estimated state, by phase.
    pub fn by_phase(model: &PhasedModel, seen: &Observability) -> Vec<Vec<ObservabilityRecord>> {
        let record = |(name, state): (String, &StateObservability)| {
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
        let of = |cut: BlockCut<'_>| cut.states().into_iter().zip(&seen.states[cut.elements]).map(record).collect();
        BlockCut::all(model).into_iter().map(of).collect()
    }
}

/// (Id of the leading test, share of the test in the information).
pub(super) fn named(leading: &Option<Leading>) -> (Option<String>, Option<f64>) {
    (leading.as_ref().map(|l| l.test.clone()), leading.as_ref().map(|l| l.share))
}

impl InnovationRecord {
    /// Figures of innovations at an estimate of a model. Panics when the innovations are of another model with more
    /// phases or measurements.
    pub fn new(found: &Innovations, model: &PhasedModel) -> InnovationRecord {
        let p = model.dimension();
        let part = |part: Part| {
            let phase = &model.phases[part.phase];
            InnovationPartRecord {
                phase: phase.name.clone(),
                measurement: phase.model.measurements[part.measurement].name.clone(),
                innovations: InnovationRecord::figures(&part.summary, p),
            }
        };
        let parts = if model.is_single() { Vec::new() } else { found.parts() };
        InnovationRecord {
            parts: parts.into_iter().map(part).collect(),
            ..InnovationRecord::figures(&found.summary, p)
        }
    }

    fn figures(found: &Summary, p: usize) -> InnovationRecord {
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
            whitened_nis: None,
            nis_p_value: found.p_value(p).and_then(finite),
            mean: found.mean.and_then(finite),
            whiteness: found.whiteness.filter(|w| w.statistic.is_finite() && w.p_value.is_finite()).map(whiteness),
            parts: Vec::new(),
            series: None,
        }
    }
}

/// A reason in words, without a full stop.
pub(super) fn words(model: &PhasedModel, reason: &Reason) -> String {
    let states = &model.estimated_names();
    let names = |of: &[usize]| list(of.iter().map(|&i| states[i].as_str()), "and");
    match reason {
        Reason::Unseen { states: dark } => {
            format!("no test observes {}", list(dark.iter().map(|&i| states[i].as_str()), "or"))
        }
        Reason::NeverTogether { states: both } => format!("{} are never observed in one test", names(both)),
        Reason::NeverApart { states: joined } => {
            format!("no test separates {}: only combinations of them are measured", names(joined))
        }
        Reason::TooFewCombinations { states: few } => {
            format!("the tests see too few different combinations of {}", names(few))
        }
        Reason::LevelsTogether { states: few } => {
            format!("the groups have too few members to separate the levels of {}: only sums are known", names(few))
        }
        Reason::OneGroup { states: few } => {
            format!("there is only one group, so its effect on {} cannot be separated from the mean", names(few))
        }
        Reason::WithParameters { parameters } => {
            let all = &model.shared().parameters;
            let named = list(parameters.iter().map(|&i| all[i].name.as_str()), "and");
            let values = if parameters.len() == 1 { "another value" } else { "other values" };
            format!("other values fit the data as well with {values} of {named}")
        }
        Reason::Confounded { regressions: confounded } => {
            let all = regressions(model);
            let name = |&r: &usize| model.shared().columns[all[r].column].name.as_str();
            let mut columns: Vec<&str> = confounded.iter().map(name).collect();
            columns.dedup();
            let vary = if columns.len() == 1 {
                "varies too little over the tests to separate its effect from the mean"
            } else {
                "vary too little, or together, over the tests to separate their effects"
            };
            format!("{} {vary}", list(columns.into_iter(), "and"))
        }
    }
}

/// Effects of too few tests on Σ, in sentences without a full stop.
pub fn shortage_notes(model: &PhasedModel, seen: &Observability) -> Vec<String> {
    let states = model.estimated_names();
    let sentence = |s: &kalfit_infer::Shortage| {
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
    joined(names.map(|name| format!("`{name}`")), last)
}

/// A list of names as they are, without backticks.
pub(super) fn joined(names: impl ExactSizeIterator<Item = String>, last: &str) -> String {
    let all = names.len();
    let mut shown: Vec<String> = names.take(MOST_NAMES).collect();
    if all > MOST_NAMES {
        shown.push(format!("{} more", all - MOST_NAMES));
    }
    match shown.pop() {
        Some(end) if shown.is_empty() => end,
        Some(end) => format!("{} {last} {end}", shown.join(", ")),
        None => String::new(),
    }
}
