//! What to do next, from what the fit found.

use std::cmp::Ordering;

use kalfit::FitRecord;
use kalfit::record::{FindingRecord, ModelCheckRecord};

use super::headline::{is_blind, is_singular};
use super::innovations::{self, ImprobableKinds};
use super::{influence, outliers};
use crate::page::PageLayout;
use crate::words::{capital, clean, list};

/// Tests that are named.
const MOST_TESTS: usize = 3;

pub(crate) fn section(record: &FitRecord, page: &PageLayout<'_>) -> String {
    page.section("What to do next", &page.items(&all(record)))
}

/// One sentence for each thing, the gravest first; one where there is nothing to do.
pub(crate) fn all(record: &FitRecord) -> Vec<String> {
    if !record.converged {
        return not_converged(record);
    }
    let checked = ModelCheckRecord::of(record);
    let mut advice: Vec<String> = checked.findings.iter().flat_map(|finding| against(record, finding)).collect();
    if is_blind(record) {
        advice.push(UNIDENTIFIED.to_owned());
    }
    if is_singular(record) {
        advice.push(SINGULAR.to_owned());
    }
    if !checked.remarks.is_empty() {
        let (tests, it) = named(&influence::influential(record));
        advice.push(format!(
            "Check the data of {tests} with care, because the estimates depend on {it}; the results file has the estimates \
             without {it}."
        ));
    }
    match (advice.is_empty(), checked.verdict.as_str()) {
        (false, _) => advice,
        (true, "passed") => vec![NOTHING.to_owned()],
        (true, _) => vec![UNCHECKED.to_owned()],
    }
}

/// What to do where there is no certified maximum, by the reason.
fn not_converged(record: &FitRecord) -> Vec<String> {
    if record.has_no_maximum() {
        return vec![NO_MAXIMUM.to_owned()];
    }
    let mut ways = Vec::new();
    if record.parameters.iter().any(|p| !p.fixed) {
        ways.push("give start values for the free parameters");
    }
    if record.is_at_limit() {
        ways.push("allow more iterations (`--max-iterations`)");
    }
    let simpler = match (record.phases.iter().any(|p| p.states.len() > 1), has_free_covariance(record)) {
        (true, true) => Some("use a simpler model: fewer states, or a diagonal covariance"),
        (true, false) => Some("use a simpler model, with fewer states"),
        (false, _) => None,
    };
    ways.extend(simpler);
    let ways = match ways.split_last() {
        None => "Look for faults in the data".to_owned(),
        Some((only, [])) => capital(only),
        Some((last, [one])) => format!("{}, or {last}", capital(one)),
        Some((last, others)) => format!("{}, or {last}", capital(&others.join(", "))),
    };
    vec![format!("Do not use these figures. {ways}.")]
}

/// Whether some covariance of two states is free.
fn has_free_covariance(record: &FitRecord) -> bool {
    let free = |fixed: &[Vec<bool>]| fixed.iter().enumerate().any(|(i, row)| row[..i].iter().any(|fixed| !fixed));
    record.phases.iter().any(|phase| free(&phase.covariance.fixed))
        || record.all_levels().any(|level| free(&level.covariance.fixed))
}

const NO_MAXIMUM: &str = "Do not use these figures. Give the noise levels named above a floor (`lower` in `[parameters]`), such as \
                          the resolution of the instrument divided by √12, or fix them, or tie them to levels that the data \
                          determine: one value for all tests, or for several, instead of one each.";
const UNIDENTIFIED: &str = "Fix what the data do not identify, or leave it out of the model, or add tests with information on it; \
                            `kalfit check` shows which tests see which states.";
const SINGULAR: &str = "A singular covariance is a valid result: these tests do not show that the states vary in all directions. \
                        Fewer varying states describe the data equally well; more tests may separate them.";
const NOTHING: &str = "Nothing needs attention: the fit converged and the model describes the data.";
const UNCHECKED: &str = "To check the model, fit with the figures of single tests: without `--no-tests`, and with \
                         `--innovations on`.";

/// What to do about a finding that speaks against the model.
fn against(record: &FitRecord, finding: &FindingRecord) -> Vec<String> {
    match finding.kind.as_str() {
        "distance" => {
            let outlying = outliers::outlying(record);
            let (tests, it) = named(&outlying.iter().map(|(_, test)| test.id).collect::<Vec<_>>());
            vec![format!(
                "Look for faults in the data of {tests}, and see whether a fit without {it} changes the estimates."
            )]
        }
        "mean_square" => match innovations::size(record) {
            Ordering::Greater if !record.parameters.iter().any(|p| !p.fixed) => vec![FREE_NOISE.to_owned()],
            _ => vec![OTHER_NOISE.to_owned()],
        },
        "innovations" => match innovations::kinds(record) {
            ImprobableKinds { size: true, whiteness: false } => vec![noise_each(record)],
            ImprobableKinds { size: false, .. } => vec![process(record)],
            ImprobableKinds { size: true, whiteness: true } => vec![noise_each(record), process(record)],
        },
        "misfit" => vec![COMMON.to_owned()],
        "row" => vec![ROWS.to_owned()],
        "unlike" => vec![UNLIKE.to_owned()],
        "normality" => vec![NOT_NORMAL.to_owned()],
        _ => Vec::new(),
    }
}

const COMMON: &str = "Look at what all tests do at the places listed under Misfit: leave clipped values out (`where`), or add the term \
                      that the model lacks.";
const ROWS: &str = "Look at the rows listed under Misfit in the data files; correct them, or leave the cells empty.";
const UNLIKE: &str = "Look for faults in the tests that are unlike the others of their groups, listed under Misfit.";
const NOT_NORMAL: &str = "Look at the innovations in the report: a few far values, or noise levels that differ, make them far from \
                          normal.";

const FREE_NOISE: &str = "Estimate the noise levels instead of fixing them: leave out their values in `[parameters]`.";
const OTHER_NOISE: &str = "Look at the noise levels and processes of the model: their sizes do not fit the data.";
/// What to do where the size of innovations differs between tests: levels by test, unless there are such already.
fn noise_each(record: &FitRecord) -> String {
    let levels = record.parameters.iter().filter(|p| !p.fixed);
    let differs = levels.clone().any(|p| p.per.is_some());
    if differs && levels.clone().all(|p| p.per.is_some()) { FAULTS.to_owned() } else { NOISE_EACH.to_owned() }
}

const FAULTS: &str = "Look for faults in the tests named under Innovations.";
const NOISE_EACH: &str = "Let noise levels differ between tests (`per = \"test\"`, or `per` a column), or look for faults in the \
                          tests named under Innovations.";
/// A process, in continuous time only where there are times.
fn process(record: &FitRecord) -> String {
    let correlates = record.correlates();
    let other = if correlates == "in time" { "a Gauss-Markov state" } else { "a state with `next`" };
    format!(
        "Add a process for what is correlated {correlates}, such as a random walk or {other}, or another one beside it."
    )
}

/// `test A` and `it`, `tests A, B and C` and `them`.
fn named(ids: &[&str]) -> (String, &'static str) {
    let names: Vec<String> = ids.iter().map(|id| clean(id)).collect();
    let (tests, it) = if names.len() == 1 { ("test", "it") } else { ("tests", "them") };
    (format!("{tests} {}", list(&names, MOST_TESTS)), it)
}
