//! What there is to say of several phases together, and of phases that a filter worked on first.

use kalfit::FitRecord;
use kalfit::record::{EnteredRecord, FilterRecord, InformationLostRecord, InformationRecord, PhaseRecord};

use super::combination::{combination_of, weighted};
use crate::number::{hundredths, plain};
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, count, list};

/// No more names than this in a sentence.
const MOST_NAMES: usize = 12;
/// No more directions than this of a phase; all are in fit.json.
const MOST_DIRECTIONS: usize = 6;
/// What the columns of ranks mean.
const LEGEND: &str = "Number of directions that the tests together observe. By itself: of all states that enter the phase (its own \
                      and inherited ones). So far: of the estimated states of this and all earlier phases.";
/// Below this part a standard error that grew is not worth a word.
const SLIGHT: f64 = 5e-4;

/// The phases, how many tests have them, and how they were put together: for the first lines.
pub(crate) fn combined(record: &FitRecord) -> Vec<String> {
    if record.phases.len() < 2 {
        return Vec::new();
    }
    let counted = |phase: &PhaseRecord| {
        let tests = phase.tests.map_or(String::new(), |n| format!(" ({})", of_all(n, record.data.tests)));
        format!("{}{tests}", clean(&phase.name))
    };
    let phases: Vec<String> = record.phases.iter().map(counted).collect();
    let (how, caveat) = match record.solver.phases.as_str() {
        "chain" => ("combined exactly, phase by phase", None),
        "stacked" => ("combined exactly, as one large test", None),
        "marginal" => ("each fitted separately", Some(marginal(record))),
        _ => ("combined in some way", None),
    };
    let first = format!("Phases: {}; {how} ({}).", list(&phases, MOST_NAMES), clean(&record.solver.phases));
    std::iter::once(first).chain(caveat).collect()
}

/// `26 tests`, or `20 of 26 tests`.
fn of_all(n: usize, tests: usize) -> String {
    if n == tests { count(n, "test") } else { format!("{n} of {}", count(tests, "test")) }
}

fn marginal(record: &FitRecord) -> String {
    let maximised = record.composite_log_likelihood.filter(|x| x.is_finite());
    let maximised = maximised.map_or(String::new(), |x| format!(" ({})", hundredths(x)));
    format!(
        "The fit maximises the sum of the phases' log-likelihoods{maximised} and ignores the correlation of their errors. \
         Standard errors hold within each phase, not between phases."
    )
}

/// What each phase adds to what is observable, of several phases; `always`: also where everything is observable in each phase.
pub(crate) fn information(
    phases: &[(&str, Option<&InformationRecord>)],
    always: bool,
    page: &PageLayout<'_>,
) -> String {
    let known: Vec<(&str, &InformationRecord)> = phases.iter().filter_map(|(name, i)| Some((*name, (*i)?))).collect();
    let full = |i: &InformationRecord| i.own_rank >= i.entering && i.rank_so_far >= i.of;
    if known.len() < 2 || (!always && known.iter().all(|(_, i)| full(i))) {
        return String::new();
    }
    let column = |of: &dyn Fn(&InformationRecord) -> String| known.iter().map(|(_, i)| of(i)).collect();
    let columns = [
        TextColumn::new("phase", ColumnSide::Left, known.iter().map(|(name, _)| clean(name)).collect()),
        TextColumn::new(
            "observed by itself",
            ColumnSide::Left,
            column(&|i| format!("{} of {}", i.own_rank, i.entering)),
        ),
        TextColumn::new("observed so far", ColumnSide::Left, column(&|i| format!("{} of {}", i.rank_so_far, i.of))),
    ];
    let mut remarks = vec![LEGEND.to_owned()];
    remarks.extend(known.iter().filter_map(|(name, i)| entered(name, i)));
    page.section("What the phases observe", &(page.table(&columns) + &page.items(&remarks)))
}

/// What a phase makes known.
fn entered(phase: &str, information: &InformationRecord) -> Option<String> {
    let combination = |new: &EnteredRecord| match &new.elements[..] {
        [only] => clean(only),
        _ => combination_of(&weighted(&new.direction, &new.elements)),
    };
    let all: Vec<String> = information.entered.iter().map(combination).collect();
    (!all.is_empty()).then(|| format!("From phase {} on: {}.", clean(phase), list(&all, MOST_DIRECTIONS)))
}

/// Phases of which a filter's estimates were taken, and what that cost.
pub(crate) fn filters(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let several = record.phases.len() > 1;
    let of = |phase: &PhaseRecord| {
        let filter = phase.filter.as_ref()?;
        let whose = if several { format!("Phase {}: the", clean(&phase.name)) } else { "The".to_owned() };
        Some(format!("{whose} estimates of a filter replace the measurements{}.{}", considered(filter), lost(phase)))
    };
    let sentences: Vec<String> = record.phases.iter().filter_map(of).collect();
    page.section("Filters", &page.items(&sentences))
}

fn considered(filter: &FilterRecord) -> String {
    let names: Vec<String> = filter.consider.iter().map(|name| clean(name)).collect();
    match names.len() {
        0 => String::new(),
        _ => format!("; it accounts for the uncertainty of {} without estimating it", list(&names, MOST_NAMES)),
    }
}

/// The largest price of the filter, with a space in front.
fn lost(phase: &PhaseRecord) -> String {
    let Some(lost) = phase.filter.as_ref().and_then(|filter| filter.information_lost.as_ref()) else {
        return String::new();
    };
    let Some((ratio, what)) = largest(lost, &phase.states) else { return String::new() };
    if ratio - 1.0 < SLIGHT {
        return " No information was lost: the standard errors are those of a fit to the measurements.".to_owned();
    }
    format!(
        " Information was lost: expected standard errors are up to {} % larger than those of a fit to the measurements (for {what}).",
        plain(100.0 * (ratio - 1.0), 2)
    )
}

fn largest(lost: &InformationLostRecord, states: &[String]) -> Option<(f64, String)> {
    let name = |i: usize| states.get(i).map_or_else(|| "?".to_owned(), |name| clean(name));
    let means = lost.mean_std_error_ratio.iter().enumerate();
    let means = means.filter_map(|(i, ratio)| Some(((*ratio)?, format!("the mean of {}", name(i)))));
    let rows = lost.covariance_std_error_ratio.iter().enumerate();
    let elements = rows.flat_map(|(i, row)| {
        let element = move |(k, ratio): (usize, &Option<f64>)| Some(((*ratio)?, (i, k)));
        row.iter().take(i + 1).enumerate().filter_map(element)
    });
    let elements = elements.map(|(ratio, (i, k))| match i == k {
        true => (ratio, format!("the variance of {}", name(i))),
        false => (ratio, format!("the covariance of {} and {}", name(k), name(i))),
    });
    means.chain(elements).filter(|(ratio, _)| ratio.is_finite()).max_by(|a, b| a.0.total_cmp(&b.0))
}
