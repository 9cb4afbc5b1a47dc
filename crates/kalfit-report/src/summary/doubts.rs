//! What the data leave open: a singular Σ, directions that nothing was observed of.

use kalfit::FitRecord;
use kalfit::record::{BoundaryRecord, PhaseRecord, UnidentifiedRecord};

use super::combination::{combination, covariance_of, weighted};
use super::{observability, pairs, places};
use crate::page::PageLayout;
use crate::words::{clean, list, sentence};

/// Of what parameters move, by the words that the fit gives: it was estimated beside them, at one of many places.
const FOLLOWS: &str = "other values fit the data as well with";
/// No more directions than this in a sentence; all are in fit.json.
const MOST_DIRECTIONS: usize = 8;
/// No more names than this in a list.
const MOST_NAMES: usize = 12;

pub(crate) fn section(
    record: &FitRecord,
    phase: &PhaseRecord,
    title: &dyn Fn(&str) -> String,
    page: &PageLayout<'_>,
) -> String {
    let (tests, place) = (phase.tests.unwrap_or(record.data.tests), places::within(record));
    let own = |b: &BoundaryRecord| at_level(&place, &singular(b, phase.states.len(), "test to test"));
    let mut sentences: Vec<String> = phase.boundary.iter().map(own).collect();
    sentences.extend(unidentified(&phase.unidentified, &phase.states, true));
    sentences.extend(observability::warnings(&phase.observability, &phase.weakly_determined, tests));
    page.section(&title("What the data cannot determine"), &page.items(&sentences))
}

/// What the data say nothing about, one sentence for each reason; directions that mix phases are left to the notes, which name
/// them whole. `estimated`: a fit gives values all the same, which say nothing.
pub(crate) fn unidentified(found: &[UnidentifiedRecord], states: &[String], estimated: bool) -> Vec<String> {
    let one_reason = |a: &UnidentifiedRecord, b: &UnidentifiedRecord| !a.reason.is_empty() && a.reason == b.reason;
    let sentence = |group: &[UnidentifiedRecord]| {
        let what: Vec<String> = group.iter().map(|u| direction(u, states)).collect();
        let is_open = estimated && !group[0].reason.contains(FOLLOWS);
        let open = match (is_open, group.len()) {
            (false, _) => "",
            (true, 1) => ", whose value here is one of many that fit as well",
            (true, _) => ", whose values here are some of many that fit as well",
        };
        format!("Not identified: {}{open}.{}", list(&what, MOST_DIRECTIONS), reason(&group[0]))
    };
    let mut own: Vec<UnidentifiedRecord> = found.iter().filter(|u| u.phases.is_empty()).cloned().collect();
    let joined = pairs::joined(&mut own, states, estimated);
    own.chunk_by(one_reason).map(sentence).chain(joined).collect()
}

/// Why, as a sentence of its own with a space in front.
fn reason(found: &UnidentifiedRecord) -> String {
    if found.reason.is_empty() { String::new() } else { format!(" {}", sentence(&clean(&found.reason))) }
}

/// A sentence on the covariance of a level, after the place where it holds; as it is where there is but one place.
pub(crate) fn at_level(place: &str, sentence: &str) -> String {
    let mut letters = sentence.chars();
    match letters.next().filter(|_| !place.is_empty()) {
        // Σ stays as large as it is
        Some(first) => {
            let place = crate::words::capital(place.trim_start());
            format!("{place}, {}{}", first.to_ascii_lowercase(), letters.as_str())
        }
        None => sentence.to_owned(),
    }
}

/// `from` whom to whom, as in `test to test`, nothing varies.
pub(crate) fn singular(boundary: &BoundaryRecord, all: usize, from: &str) -> String {
    let (rank, of) = (boundary.rank, boundary.of);
    let names = |states: &[String]| list(&states.iter().map(|s| clean(s)).collect::<Vec<_>>(), MOST_NAMES);
    if let ([state], 0) = (boundary.states.as_slice(), rank) {
        return format!("The variance of {} is estimated as zero.", clean(state));
    }
    let part = boundary.states.len() < all && !boundary.states.is_empty();
    let whose = if part { format!("Σ of {}", names(&boundary.states)) } else { "Σ".to_owned() };
    if rank == 0 {
        return format!("{whose} is estimated as zero: measurement noise explains all differences between the tests.");
    }
    let why = match (boundary.zero_variances.len(), of.saturating_sub(rank)) {
        (0, 1) => format!("no variation from {from} was found in one combination of these states"),
        (0, missing) => {
            format!("no variation from {from} was found in {missing} combinations of these states")
        }
        (1, _) => format!("the variance of {} is estimated as zero", names(&boundary.zero_variances)),
        _ => format!("the variances of {} are estimated as zero", names(&boundary.zero_variances)),
    };
    format!("{whose} is singular: rank {rank} of {of}; {why}.")
}

/// A direction of μ or Σ in words.
pub(crate) fn direction(found: &UnidentifiedRecord, states: &[String]) -> String {
    let mean = found.what == "mean";
    let names = if found.elements.is_empty() { states } else { &found.elements };
    let terms = weighted(&found.direction, names);
    match (terms.as_slice(), mean) {
        ([], _) => format!("a direction of the {}", clean(&found.what)),
        ([(_, only)], true) => match only.split_once(" per ").filter(|_| !states.contains(only)) {
            Some((state, column)) => format!("the coefficient of {} in the mean of {}", clean(column), clean(state)),
            None => format!("the mean of {}", clean(only)),
        },
        ([(_, only)], false) => match covariance_of(only) {
            Some((a, b)) if a == b => format!("the variance of {}", clean(a)),
            Some((a, b)) => format!("the covariance of {} and {}", clean(a), clean(b)),
            None => format!("the covariance {}", clean(only)),
        },
        (terms, true) => format!("the combination {} of the means", combination(terms, &|name| clean(name))),
        (terms, false) => format!("the combination {}", combination(terms, &short)),
    }
}

fn short(element: &str) -> String {
    match covariance_of(element) {
        Some((a, b)) if a == b => format!("var({})", clean(a)),
        Some((a, b)) => format!("cov({}, {})", clean(a), clean(b)),
        None => clean(element),
    }
}
