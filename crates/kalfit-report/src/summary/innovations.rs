//! Are the innovations of the tests what the model says: independent, of the right size?

use std::cmp::Ordering;

use kalfit::FitRecord;
use kalfit::record::{InnovationRecord, SEARCH_LEVEL, WhitenessRecord, holm, overall_size};

use crate::figures;
use crate::number::{FigurePrecision, plain, probability};
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, count};

const MOST_ROWS: usize = 5;

/// One figure of one test that has a probability.
struct ImprobableFigure<'a> {
    test: &'a str,
    of: InnovationFigure<'a>,
    p_value: f64,
    /// Holm's (1979) adjusted p-value.
    adjusted: f64,
}

enum InnovationFigure<'a> {
    /// The normalised innovation squared.
    Size(&'a InnovationRecord),
    /// Ljung and Box's statistic.
    Whiteness(&'a InnovationRecord),
}

/// Which figures of single tests are improbable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ImprobableKinds {
    pub(super) size: bool,
    pub(super) whiteness: bool,
}

pub(super) fn kinds(record: &FitRecord) -> ImprobableKinds {
    let findings = findings(&of_tests(record));
    let improbable = || findings.iter().take_while(|finding| finding.adjusted < SEARCH_LEVEL);
    ImprobableKinds {
        size: improbable().any(|finding| matches!(finding.of, InnovationFigure::Size(_))),
        whiteness: improbable().any(|finding| matches!(finding.of, InnovationFigure::Whiteness(_))),
    }
}

/// Whether all innovations together are larger or smaller than chance allows.
pub(super) fn size(record: &FitRecord) -> Ordering {
    let (n, nis) = record.overall_innovations();
    overall_size(n, nis, record.free_parameters)
}

fn of_tests(record: &FitRecord) -> Vec<(&str, &InnovationRecord)> {
    record.tests.iter().filter_map(|t| Some((t.id, t.innovations?))).collect()
}

pub(crate) fn section(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let all = of_tests(record);
    let findings = findings(&all);
    let Some(least) = findings.first() else { return String::new() };
    let improbable = findings.iter().take_while(|f| f.adjusted < SEARCH_LEVEL).count();
    let phases: Vec<&str> = record.phases.iter().map(|phase| phase.name.as_str()).collect();
    let overall = match record.overall_innovations() {
        (0, _) => None, // of tests in groups that cross
        all_innovations => Some(overall(all_innovations, record.free_parameters) + &by_phase(&all, &phases)),
    };
    let correlates = record.correlates();
    let body = match improbable {
        0 => {
            let sentences = overall.into_iter().chain([probable(least, findings.len(), correlates)]);
            page.items(&sentences.collect::<Vec<_>>())
        }
        n => {
            let (found, all) = (&findings[..n], findings.len());
            shown(found, (phases.len() > 1, correlates), page)
                + &page
                    .items(&std::iter::once(meaning(found, (all, correlates), page)).chain(overall).collect::<Vec<_>>())
        }
    };
    page.section("Innovations (measured minus predicted)", &body)
}

/// The figures of all tests, the least probable first.
fn findings<'a>(all: &[(&'a str, &'a InnovationRecord)]) -> Vec<ImprobableFigure<'a>> {
    let mut findings: Vec<ImprobableFigure<'a>> = Vec::new();
    for &(test, found) in all {
        let mut add = |of, p: Option<f64>| {
            if let Some(p_value) = p.filter(|p| p.is_finite()) {
                findings.push(ImprobableFigure { test, of, p_value, adjusted: 1.0 });
            }
        };
        add(InnovationFigure::Size(found), found.nis_p_value);
        add(InnovationFigure::Whiteness(found), found.whiteness.as_ref().map(|w| w.p_value));
    }
    findings.sort_by(|a, b| a.p_value.total_cmp(&b.p_value).then_with(|| a.test.cmp(b.test)));
    let p_values: Vec<f64> = findings.iter().map(|finding| finding.p_value).collect();
    let adjusted = holm(&p_values, p_values.len());
    findings.iter_mut().zip(adjusted).for_each(|(finding, adjusted)| finding.adjusted = adjusted);
    findings
}

/// Size of all innovations together.
fn overall((n, nis): (usize, f64), free: usize) -> String {
    let spread = (2.0 / n.max(1) as f64).sqrt();
    let mean = nis / n.max(1) as f64;
    let verdict = match overall_size(n, nis, free) {
        Ordering::Greater => " That is more than chance allows: the model has too little noise, or lacks a process.",
        Ordering::Less => " That is less than chance allows: the model has too much noise.",
        Ordering::Equal => "",
    };
    format!(
        "Mean square of all {}, each divided by its standard deviation: {} (expected 1 ± {}).{verdict}",
        count(n, "innovation"),
        FigurePrecision::of(mean, Some(spread)).show(mean),
        plain(spread, 2)
    )
}

/// The same of each phase that has any, where there are several.
fn by_phase(all: &[(&str, &InnovationRecord)], phases: &[&str]) -> String {
    let of = |name: &str| -> (usize, f64) {
        let parts = all.iter().flat_map(|(_, found)| &found.parts).filter(|part| part.phase == name);
        parts.fold((0, 0.0), |(n, nis), part| {
            (n + part.innovations.count, nis + part.innovations.nis.unwrap_or_default())
        })
    };
    let seen = phases.iter().map(|name| (name, of(name))).filter(|(_, (n, _))| *n > 0);
    let shown = |(name, (n, nis)): (&&str, (usize, f64))| {
        let (mean, spread) = (nis / n as f64, (2.0 / n as f64).sqrt());
        let shown = FigurePrecision::of(mean, Some(spread)).show(mean);
        format!("{shown} in {} ({n}, 1 ± {})", clean(name), plain(spread, 2))
    };
    let each: Vec<String> = seen.map(shown).collect();
    if phases.len() > 1 && !each.is_empty() { format!(" By phase: {}.", each.join(", ")) } else { String::new() }
}

fn probable(least: &ImprobableFigure<'_>, all: usize, correlates: &str) -> String {
    let what = match least.of {
        InnovationFigure::Size(_) => "size".to_owned(),
        InnovationFigure::Whiteness(_) if correlates == "in time" => "time correlation".to_owned(),
        InnovationFigure::Whiteness(_) => format!("correlation {correlates}"),
    };
    let holm = match all {
        1 => String::new(),
        _ => format!("; {} after Holm correction for {all} tests", probability(least.adjusted)),
    };
    format!(
        "Innovation checks passed for all tests (smallest p = {}, {what} in {}{holm}).",
        probability(least.p_value),
        clean(least.test)
    )
}

fn shown(improbable: &[ImprobableFigure<'_>], (phased, correlates): (bool, &str), page: &PageLayout<'_>) -> String {
    let rows = &improbable[..improbable.len().min(page.rows(MOST_ROWS))];
    let figures =
        |of: &dyn Fn(&InnovationFigure<'_>) -> String| -> Vec<String> { rows.iter().map(|f| of(&f.of)).collect() };
    let mut columns = vec![
        TextColumn::new("test", ColumnSide::Left, rows.iter().map(|f| f.test.to_owned()).collect()),
        TextColumn::new("what", ColumnSide::Left, figures(&|of| of.words(correlates))),
        TextColumn::new("found", ColumnSide::Right, figures(&|of| of.found())),
        TextColumn::new("expected", ColumnSide::Right, figures(&|of| of.expected())),
        TextColumn::new("p-value", ColumnSide::Right, rows.iter().map(|f| probability(f.p_value)).collect()),
        TextColumn::new("Holm", ColumnSide::Right, rows.iter().map(|f| probability(f.adjusted)).collect()),
    ];
    if phased {
        columns
            .insert(1, TextColumn::new("most in", ColumnSide::Left, figures(&|of| clean(of.phase().unwrap_or("-")))));
    }
    page.table(&columns)
}

impl InnovationFigure<'_> {
    /// The phase in which it is least probable.
    fn phase(&self) -> Option<&str> {
        let p = |found: &InnovationRecord| match self {
            InnovationFigure::Size(_) => found.nis_p_value,
            InnovationFigure::Whiteness(_) => found.whiteness.as_ref().map(|w| w.p_value),
        };
        let (InnovationFigure::Size(found) | InnovationFigure::Whiteness(found)) = self;
        let known = found.parts.iter().filter_map(|part| Some((p(&part.innovations)?, part.phase.as_str())));
        known.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, phase)| phase)
    }

    fn words(&self, correlates: &str) -> String {
        match self {
            InnovationFigure::Size(found) if found.nis.is_some_and(|nis| nis < found.count as f64) => {
                "smaller than modelled".to_owned()
            }
            InnovationFigure::Size(_) => "larger than modelled".to_owned(),
            InnovationFigure::Whiteness(_) => format!("correlated {correlates}"),
        }
    }

    fn found(&self) -> String {
        match self {
            InnovationFigure::Size(found) => figures::shown(InnovationRecord::nis, Some(found)),
            InnovationFigure::Whiteness(found) => figures::shown(WhitenessRecord::statistic, found.whiteness.as_ref()),
        }
    }

    fn expected(&self) -> String {
        match self {
            InnovationFigure::Size(found) => figures::shown(InnovationRecord::count, Some(found)),
            InnovationFigure::Whiteness(found) => {
                figures::shown(WhitenessRecord::degrees_of_freedom, found.whiteness.as_ref())
            }
        }
    }
}

/// What to make of it.
fn meaning(improbable: &[ImprobableFigure<'_>], (all, correlates): (usize, &str), page: &PageLayout<'_>) -> String {
    let more = match improbable.len().saturating_sub(page.rows(MOST_ROWS)) {
        0 => String::new(),
        n => format!(" (and {n} more)"),
    };
    let these = if improbable.len() == 1 { "This is" } else { "These are" };
    let any = |of: fn(&InnovationFigure<'_>) -> bool| improbable.iter().any(|f| of(&f.of));
    let mut because = Vec::new();
    if any(|of| matches!(of, InnovationFigure::Size(_))) {
        because
            .push("a size that differs from the model suggests other noise levels, or faults in the test".to_owned());
    }
    if any(|of| matches!(of, InnovationFigure::Whiteness(_))) {
        because.push(format!("correlation {correlates} suggests a missing process, such as a drift"));
    }
    let because = because.join("; ");
    format!(
        "{these} improbable{more} at the {} % level, after Holm correction for {}: {because}.",
        plain(100.0 * SEARCH_LEVEL, 2),
        count(all, "p-value")
    )
}
