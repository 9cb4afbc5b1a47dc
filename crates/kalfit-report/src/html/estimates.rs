//! μ and Σ, phase by phase: tables with intervals, forest plot, correlations, ellipses.

use kalfit::FitRecord;
use kalfit::record::{LevelRecord, PhaseRecord};
use maud::{Markup, PreEscaped, html};
use serde_json::{Value, json};

use crate::html::chart::{PageChart, PageCharts, figure};
use crate::html::forest::{self, ForestGroup, ForestRow};
use crate::html::math::{self, equation, hat, op, row};
use crate::html::phase::forest_row;
use crate::html::section::PageSection;
use crate::html::{across, phase, posteriors};
use crate::number::plain;
use crate::page::PageLayout;
use crate::summary::{correlations, intervals, levels, phases, places, states};
use crate::words::clean;

/// A larger Σ is not written as a matrix.
pub(super) const MOST_IN_MATRIX: usize = 6;
/// States of a heat map.
const MOST_IN_MAP: usize = 40;
/// Digits of an element of a matrix.
pub(super) const DIGITS: usize = 5;

pub(super) fn section(record: &FitRecord, charts: &mut PageCharts) -> Option<PageSection> {
    let page = PageLayout::html();
    let mut parts: Vec<Markup> = Vec::new();
    for one in &record.phases {
        parts.push(phase_part(record, one, charts, &page));
    }
    parts.extend(across::section(record, charts));
    parts.push(html! { (PreEscaped(phases::filters(record, &page))) });
    PageSection::new("estimates", "Initial state", html! { @for part in &parts { (part) } })
}

fn phase_part(record: &FitRecord, one: &PhaseRecord, charts: &mut PageCharts, page: &PageLayout<'_>) -> Markup {
    let several = record.phases.len() > 1;
    let name = if several { format!("Phase {}: ", clean(&one.name)) } else { String::new() };
    let title = |what: &str| match several {
        true => format!("{name}{}{}", what[..1].to_lowercase(), &what[1..]),
        false => what.to_owned(),
    };
    if one.states.is_empty() {
        return html! { h3 { (name) "nothing of the initial state is estimated" } };
    }
    let rest = states::scales(one, page) + &states::regression(one, page);
    html! {
        h3 { (name) (if several { "mean" } else { "Mean" }) (spread_of_what(record)) }
        (PreEscaped(page.table(&phase::columns(record, one))))
        @if let Some(sentence) = places::elsewhere(record) { p { (sentence) } }
        (PreEscaped(rest))
        p.hint { "± " (states::std_error(&record.std_errors)) "; intervals are 95 %, "
            (by_intervals(&record.intervals)) "." }
        (matrices(one))
        @if let Some(unit) = places::innermost(record) { p.hint { "Σ is the covariance within one " (unit) "." } }
        (phase::elements(one, page))
        (forest_plot(record, one, &name, charts).unwrap_or_default())
        (PreEscaped(correlations::section(one.into(), &places::within(record), &title, page)))
        (heat_map(record, one, &name, charts).unwrap_or_default())
        (PreEscaped(intervals::section(record, one, &title, page)))
        (posteriors::ellipses(record, one, &name, charts).unwrap_or_default())
    }
}

/// Whose spread it is, after "Mean".
fn spread_of_what(record: &FitRecord) -> &'static str {
    if record.levels.is_empty() { " and spread over the tests" } else { ", and standard deviation at each level" }
}

fn matrices(one: &PhaseRecord) -> Markup {
    let (mean, covariance) = (&one.mean.estimate, &one.covariance.estimate);
    if mean.is_empty() || mean.len() > MOST_IN_MATRIX || covariance.len() > MOST_IN_MATRIX {
        return html! {};
    }
    let column: Vec<Vec<f64>> = mean.iter().map(|x| vec![*x]).collect();
    html! { div.equations.matrices {
        (equation(row([hat("μ"), op("="), math::matrix(&column, DIGITS)])))
        (equation(row([hat("Σ"), op("="), math::matrix(covariance, DIGITS)])))
    } }
}

/// Means and standard deviations, those of one unit together; of tests in groups the deviations of every level.
pub(crate) fn groups(record: &FitRecord, one: &PhaseRecord) -> Vec<ForestGroup> {
    let mut groups: Vec<ForestGroup> = Vec::new();
    for kind in [phase::StateFigure::Mean, phase::StateFigure::StdDev] {
        let mut units: Vec<String> = Vec::new();
        for i in 0..one.states.len() {
            let unit = one.units.get(i).cloned().flatten().unwrap_or_default();
            if !units.contains(&unit) {
                units.push(unit);
            }
        }
        for unit in units {
            let of_unit = |i: &usize| one.units.get(*i).cloned().flatten().unwrap_or_default() == unit;
            let of_state = |i: usize| match kind {
                phase::StateFigure::StdDev if !record.levels.is_empty() => spreads(record, one, i),
                _ if phase::is_held_at_zero(one, kind, i) => Vec::new(),
                _ => forest_row(one, kind, i).into_iter().collect(),
            };
            let rows = (0..one.states.len()).filter(of_unit).flat_map(of_state).collect();
            let label =
                if unit.is_empty() { kind.name().to_owned() } else { format!("{} [{}]", kind.name(), clean(&unit)) };
            groups.push(ForestGroup { label, rows });
        }
    }
    groups
}

/// The standard deviations of a state at every level where it varies.
fn spreads(record: &FitRecord, one: &PhaseRecord, i: usize) -> Vec<ForestRow> {
    let row = |(level, place): (&LevelRecord, String)| {
        let e = level.effect_on(&one.states, i).filter(|&e| !levels::is_held_at_zero(level, e))?;
        let (shown, beside) = levels::std_dev(level, e);
        Some(ForestRow {
            name: format!("{}, {place}", clean(&one.states[i])),
            estimate: *level.std_dev.estimate.get(e)?,
            ends: level.std_dev.interval95.get(e).copied().flatten(),
            words: forest::words(&shown, &beside, &levels::interval(level, e)),
            reference: None,
        })
    };
    record.all_levels().zip(places::places(record)).filter_map(row).collect()
}

fn forest_plot(record: &FitRecord, one: &PhaseRecord, name: &str, charts: &mut PageCharts) -> Option<Markup> {
    let title = format!("{name}Estimates with 95 % intervals");
    let caption = format!(
        "Top: the mean over all tests. Below: how much {} differ (standard deviation). If the interval of a mean contains zero, \
         the mean may be zero; a long interval means that more tests are needed. Open marks have no interval: the value is fixed, on \
         the boundary or not identified.",
        if record.levels.is_empty() { "tests" } else { "groups of every level and tests" }
    );
    forest::forest(&title, &caption, groups(record, one), charts)
}

fn heat_map(record: &FitRecord, one: &PhaseRecord, name: &str, charts: &mut PageCharts) -> Option<Markup> {
    let p = one.states.len().min(MOST_IN_MAP);
    let of = |i: usize, k: usize| one.correlation.estimate.get(i).and_then(|row| row.get(k)).copied().flatten();
    let random: Vec<usize> = (0..p).filter(|&i| of(i, i).is_some()).collect();
    if random.len() < 2 {
        return None;
    }
    let cells: Vec<Vec<Value>> =
        random.iter().map(|&i| random.iter().map(|&k| of(i, k).map_or(Value::Null, figure)).collect()).collect();
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (a, &i) in random.iter().enumerate() {
        pairs.extend(random[..a].iter().filter_map(|&k| Some((of(i, k).filter(|r| r.is_finite())?, k, i))));
    }
    pairs.sort_by(|a, b| b.0.abs().total_cmp(&a.0.abs()));
    let said = pairs
        .iter()
        .take(12)
        .map(|(r, k, i)| format!("{} and {}: {}", clean(&one.states[*k]), clean(&one.states[*i]), plain(*r, 2)));
    let alternative = said.collect::<Vec<_>>().join("; ");
    let names: Vec<String> = random.iter().map(|&i| clean(&one.states[i])).collect();
    let cut =
        if one.states.len() > p { format!(" The first {p} of {} states.", one.states.len()) } else { String::new() };
    let caption = format!(
        "Correlations of the initial states over the tests{}. Dark colours: one state largely determines the other. Pale colours: the \
         two vary independently.{cut}",
        places::within(record)
    );
    let data = json!({ "names": names, "cells": cells });
    let title = format!("{name}Correlations{}", places::within(record));
    Some(charts.figure(PageChart { kind: "heat", title: &title, caption: &caption, alternative: &alternative, data }))
}

/// How intervals were computed, after "intervals are".
fn by_intervals(kind: &str) -> &'static str {
    match kind {
        "profile" => "by profile likelihood",
        "bootstrap" => "by profile likelihood, with quantiles from drawn ensembles",
        _ => "by standard errors",
    }
}
