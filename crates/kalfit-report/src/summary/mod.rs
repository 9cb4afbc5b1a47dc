//! The summary of a fit, in the order in which a reader asks: what are the estimates, can they be trusted, what is to be done;
//! then the figures behind the answers.

pub(crate) mod advice;
mod combination;
pub(crate) mod constraints;
pub(crate) mod correlations;
pub(crate) mod doubts;
pub(crate) mod effects;
pub(crate) mod few_tests;
pub(crate) mod groups;
pub(crate) mod headline;
pub(crate) mod influence;
pub(crate) mod innovations;
pub(crate) mod intervals;
pub(crate) mod levels;
pub(crate) mod misfit;
pub(crate) mod observability;
pub(crate) mod outliers;
pub(crate) mod outlying_groups;
mod pairs;
pub(crate) mod parameters;
pub(crate) mod phases;
pub(crate) mod places;
pub(crate) mod spread;
pub(crate) mod states;

use kalfit::FitRecord;
use kalfit::record::{PhaseRecord, SearchRecord};

use crate::page::PageLayout;
use crate::words::{clean, count, list, sentence};
use crate::{TextStyle, number};

/// The fit in words and tables. Every line fits `style.width` and ends with a line feed. Works from the record alone and copes
/// with any record, also with one whose lists do not match in length; figures that are not finite are said to be unknown.
pub fn summary(record: &FitRecord, style: &TextStyle) -> String {
    let page = PageLayout::new(style);
    let mut sections = vec![headline::section(record, &page)];
    for phase in &record.phases {
        sections.extend(phase_sections(record, phase, &page));
    }
    sections.push(levels::section(record, &page));
    let observed: Vec<_> = record.phases.iter().map(|p| (p.name.as_str(), p.information.as_ref())).collect();
    sections.push(phases::information(&observed, false, &page));
    sections.push(phases::filters(record, &page));
    sections.push(parameters::section(record, &page));
    sections.push(parameters::methods(record, &page));
    sections.push(headline::trust(record, &page));
    sections.push(advice::section(record, &page));
    sections.push(constraints::section(record, &page));
    sections.push(outliers::section(record, &page));
    sections.push(influence::section(record, &page));
    sections.push(innovations::section(record, &page));
    sections.push(misfit::section(record, &page));
    sections.push(groups::section(record, &page));
    sections.push(notes(record, &page));
    sections.push(work(record, &page));
    sections.retain(|s| !s.is_empty());
    sections.join("\n")
}

fn phase_sections(record: &FitRecord, phase: &PhaseRecord, page: &PageLayout<'_>) -> Vec<String> {
    let title = |what: &str| match record.phases.len() {
        1 => what.to_owned(),
        _ => format!("Phase {}: {}{}", clean(&phase.name), what[..1].to_lowercase(), &what[1..]),
    };
    vec![
        states::section(record, phase, &title, page),
        correlations::section(phase.into(), &places::within(record), &title, page),
        intervals::section(record, phase, &title, page),
        doubts::section(record, phase, &title, page),
    ]
}

pub(crate) fn notes(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let lines: Vec<String> = record.notes.iter().map(|note| sentence(&clean(note))).collect();
    page.section("Notes", &page.items(&lines))
}

/// What was computed, and how.
pub(crate) fn work(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let solver = &record.solver;
    let (method, backward) = match solver.score_passes {
        0 => (String::new(), String::new()),
        n => (format!("method {}, ", clean(&solver.method)), format!(", {}", count(n, "backward run"))),
    };
    let designs = headline::designs(&record.data);
    let designs = if designs.is_empty() { designs } else { page.paragraph(&designs) };
    let work = page.paragraph(&format!(
        "Computation: {method}solver {}, {}, {}{backward}, {}.",
        clean(&solver.solver),
        count(solver.iterations, "iteration"),
        count(solver.filter_passes, "filter run"),
        number::seconds(solver.seconds)
    ));
    let is_plain =
        |search: &&SearchRecord| search.stages.len() < 2 && search.starts < 2 && search.returned_from_zero.is_empty();
    let search = record.search.as_ref().filter(|search| !is_plain(search));
    let found = search.map_or_else(String::new, |search| page.paragraph(&how_found(search)));
    designs + &work + &found
}

/// Maximal number of names of levels in the line on the search.
const MOST_RETURNED: usize = 3;

/// What found the maximum in the dynamic parameters, and what was spent on the search.
fn how_found(search: &SearchRecord) -> String {
    let stages: Vec<String> =
        search.stages.iter().map(|stage| format!("{} for {}", stage.filter_runs, clean(&stage.name))).collect();
    let runs = if stages.len() > 1 { format!(" Filter runs: {}.", list(&stages, stages.len())) } else { String::new() };
    let returned = match &search.returned_from_zero[..] {
        [] => String::new(),
        names => format!(", with {} returned from zero", list(names, MOST_RETURNED)),
    };
    format!(
        "Search: {}; the maximum was found from {}{returned}.{runs}",
        count(search.starts, "start"),
        clean(&search.found_by)
    )
}
