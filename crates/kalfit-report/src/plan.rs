//! What `kalfit plan` found.

use kalfit::record::{ArrangementRecord, PlanRecord, PlannedRecord};

use crate::TextStyle;
use crate::best_plan;
use crate::number::{FigurePrecision, plain};
use crate::page::PageLayout;
use crate::summary::headline;
use crate::table::{ColumnSide, TextColumn, wide_table};
use crate::words::{clean, count, list};

/// No more names than this in a sentence.
const MOST_NAMES: usize = 12;

/// A plan in words and tables. Every line fits `style.width` and ends with a line feed.
pub fn plan_summary(record: &PlanRecord, style: &TextStyle) -> String {
    let page = PageLayout::new(style);
    if let Some(best) = &record.best {
        return best_plan::summary(record, best, &page);
    }
    let mut sections = Vec::new();
    if !record.title.trim().is_empty() {
        sections.push(page.heading(&clean(&record.title)) + "\n");
    }
    let facts = headline::data(&record.design);
    let design = format!("Design: {}", facts.trim_start_matches("Data: "));
    let from = page.paragraph(&format!("Population: {}.", clean(&record.from)));
    let columns = record.arrangements.first().map_or_else(String::new, |one| page.paragraph(&explained(one)));
    sections.push(page.paragraph(&design) + &from + &columns);
    for (kind, heading) in [
        ("mean", "Expected standard errors of the means"),
        ("regression", "Expected standard errors of the regression coefficients"),
        ("std_dev", "Expected standard errors of the standard deviations"),
        ("correlation", "Expected standard errors of the correlations"),
    ] {
        // of tests in groups, most states vary at some levels only
        let is_still = |q: &PlannedRecord| {
            !record.arrangements.is_empty() && q.reason.as_deref() == Some("fixed") && q.value == Some(0.0)
        };
        let shown = record.quantities.iter().filter(|q| is_shown(q, kind) && !(kind == "std_dev" && is_still(q)));
        let rows: Vec<&PlannedRecord> = shown.collect();
        sections.push(page.section(heading, &table(record, &rows, page.width())));
    }
    sections.push(page.section("How to read this", &page.items(&notes(record))));
    sections.retain(|section| !section.is_empty());
    sections.join("\n")
}

/// Correlations that the model holds fill pages in models of many states, and say nothing.
fn is_shown(quantity: &PlannedRecord, kind: &str) -> bool {
    quantity.quantity == kind && !(kind == "correlation" && quantity.reason.as_deref() == Some("fixed"))
}

fn table(record: &PlanRecord, rows: &[&PlannedRecord], width: usize) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let smallest = |q: &PlannedRecord| q.std_error.iter().flatten().copied().reduce(f64::min);
    let value = |q: &PlannedRecord| q.value.map_or("-".to_owned(), |v| FigurePrecision::of(v, smallest(q)).show(v));
    // of a pair, the phase is said once
    let several = record.quantities.iter().any(|q| q.phase != record.quantities[0].phase);
    let name = |q: &PlannedRecord| {
        let states = q.states.join(", ");
        if let Some(level) = &q.level {
            return format!("{level}.{states}");
        }
        if several { format!("{}.{states}", q.phase) } else { states }
    };
    let names = rows.iter().map(|q| name(q)).collect();
    let mut columns = vec![
        TextColumn::new(
            "per unit of",
            ColumnSide::Left,
            rows.iter().map(|q| q.column.clone().unwrap_or_default()).collect(),
        ),
        TextColumn::new("unit", ColumnSide::Left, rows.iter().map(|q| q.unit.clone().unwrap_or_default()).collect()),
        TextColumn::new("value", ColumnSide::Right, rows.iter().map(|q| value(q)).collect()),
    ];
    for (k, &tests) in record.tests.iter().enumerate() {
        let cell = |q: &&PlannedRecord| match (q.std_error.get(k).copied().flatten(), k) {
            (Some(error), _) => two_digits(error),
            (None, 0) if q.reason.is_some() => reason(q).to_owned(),
            (None, _) => "-".to_owned(),
        };
        let heading = match record.arrangements.get(k) {
            Some(one) => arranged(one),
            None => count(tests, "test"),
        };
        columns.push(TextColumn::new(&heading, ColumnSide::Right, rows.iter().map(cell).collect()));
    }
    wide_table(&TextColumn::new("state", ColumnSide::Left, names), &columns, width)
}

/// `10 × 4`: groups of each level, the outermost first, and tests; then `bench 6`: levels of each crossed factor.
fn arranged(one: &ArrangementRecord) -> String {
    let (factors, nested) = one.groups.split_at(one.crossed.min(one.groups.len()));
    let groups = nested.iter().map(|(_, groups)| groups);
    let nested = groups.chain([&one.tests]).map(usize::to_string).collect::<Vec<_>>().join(" × ");
    let factors = factors.iter().map(|(name, levels)| format!("{} {levels}", clean(name)));
    std::iter::once(nested).chain(factors).collect::<Vec<_>>().join(", ")
}

/// What such a heading means, for any names of levels.
fn explained(one: &ArrangementRecord) -> String {
    let (factors, nested) = one.groups.split_at(one.crossed.min(one.groups.len()));
    let of_level = |(name, groups): &(String, usize)| format!("{} of `{}`", count(*groups, "group"), clean(name));
    let groups: Vec<String> = nested.iter().map(of_level).collect();
    let tests = match groups.is_empty() {
        true => count(one.tests, "test"),
        false => format!("{}, {} in each", groups.join(", in each of them "), count(one.tests, "test")),
    };
    let levels = factors.iter().map(|(name, levels)| format!("{} of `{}`", count(*levels, "level"), clean(name)));
    let in_turn = match factors.is_empty() {
        true => String::new(),
        false => format!("; {}, which the tests meet in turn", levels.collect::<Vec<_>>().join(" and ")),
    };
    format!("Column {}: {tests}{in_turn}.", arranged(one))
}

pub(crate) fn two_digits(error: f64) -> String {
    if error > 0.0 { FigurePrecision::of(error, Some(error)).show_error(error) } else { plain(error, 2) }
}

fn reason(quantity: &PlannedRecord) -> &'static str {
    match quantity.reason.as_deref() {
        Some("fixed") => "fixed",
        Some("unidentified") => "not identified",
        Some("boundary") => "boundary",
        _ => "unknown",
    }
}

fn notes(record: &PlanRecord) -> Vec<String> {
    if record.quantities.is_empty() {
        return vec!["No initial state is estimated, so there is nothing to plan for.".to_owned()];
    }
    let first = match record.arrangements.is_empty() {
        true => format!("N tests count as N/{} times the design", record.design.tests),
        false => "groups and tests are like those of the design, one after the other".to_owned(),
    };
    let mut notes = vec![format!(
        "Standard errors come from the expected information at these values; {first}. With few tests, estimates scatter more than \
         this, and those of standard deviations are skewed."
    )];
    if record.quantities.iter().any(|q| q.reason.as_deref() == Some("boundary")) {
        notes.push(
            "Boundary: the covariance is singular, and a standard error does not describe its estimates.".to_owned(),
        );
    }
    if record.quantities.iter().any(|q| q.reason.as_deref() == Some("unidentified")) {
        notes.push("Not identified: more tests like these would not help.".to_owned());
    }
    let in_part = |q: &PlannedRecord| q.reason.is_none() && q.std_error.iter().any(Option::is_none);
    if record.quantities.iter().any(in_part) {
        notes.push("A dash: not identified by so few groups and tests.".to_owned());
    }
    let names: Vec<String> = record.parameters_taken_as_known.iter().map(|name| clean(name)).collect();
    if !names.is_empty() {
        let (are, values) = if names.len() == 1 { ("is", "its value") } else { ("are", "their values") };
        notes.push(format!(
            "{} {are} free in the model but {are} taken as known here, at {values} in {}; if {} were estimated too, standard errors \
             would be larger.",
            list(&names, MOST_NAMES),
            clean(&record.from),
            if names.len() == 1 { "it" } else { "they" }
        ));
    }
    notes
}
