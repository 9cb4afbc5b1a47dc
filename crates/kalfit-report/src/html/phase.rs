//! The figures of one phase as rows of tables and of forest plots.

use kalfit::FitRecord;
use kalfit::record::{Interval, LevelRecord, PhaseRecord};
use maud::{Markup, PreEscaped, html};

use crate::html::forest::{self, ForestRow};
use crate::page::PageLayout;
use crate::summary::parameters::ends_in_words;
use crate::summary::states::{self, FigureCells, cells};
use crate::summary::{few_tests, levels, places};
use crate::table::{ColumnSide, TextColumn};
use crate::words::clean;

/// Elements of Σ in the table.
const MOST_ELEMENTS: usize = 210;

/// What is known of a state over the tests.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum StateFigure {
    Mean,
    StdDev,
}

impl StateFigure {
    pub(super) fn name(self) -> &'static str {
        match self {
            StateFigure::Mean => "mean",
            StateFigure::StdDev => "standard deviation",
        }
    }

    pub(super) fn estimate(self, phase: &PhaseRecord, i: usize) -> Option<f64> {
        match self {
            StateFigure::Mean => phase.mean.estimate.get(i).copied(),
            StateFigure::StdDev => phase.std_dev.estimate.get(i).copied(),
        }
    }

    pub(super) fn std_error(self, phase: &PhaseRecord, i: usize) -> Option<f64> {
        match self {
            StateFigure::Mean => phase.mean.std_error.get(i).copied().flatten(),
            StateFigure::StdDev => phase.std_dev.std_error.get(i).copied().flatten(),
        }
    }

    pub(super) fn ends(self, phase: &PhaseRecord, i: usize) -> Interval {
        match self {
            StateFigure::Mean => phase.mean.interval95.get(i).copied().flatten(),
            StateFigure::StdDev => phase.std_dev.interval95.get(i).copied().flatten(),
        }
    }

    pub(super) fn fixed(self, phase: &PhaseRecord, i: usize) -> bool {
        match self {
            StateFigure::Mean => phase.mean.fixed.get(i).copied().unwrap_or(false),
            StateFigure::StdDev => phase.covariance.fixed.get(i).and_then(|row| row.get(i)).copied().unwrap_or(false),
        }
    }

    /// The estimate and what is said beside it.
    pub(super) fn cells(self, phase: &PhaseRecord, i: usize) -> FigureCells {
        match self {
            StateFigure::Mean => {
                let (figure, beside) = states::mean(phase, i);
                (figure, beside + &few_tests::beside(phase.mean.few_tests.df.get(i).copied().flatten()))
            }
            StateFigure::StdDev => states::std_dev(phase, i),
        }
    }

    /// The interval in words; empty where there is none.
    pub(super) fn interval(self, phase: &PhaseRecord, i: usize) -> String {
        match (self.estimate(phase, i), self.ends(phase, i).filter(|_| !self.fixed(phase, i))) {
            (Some(estimate), Some(ends)) => ends_in_words(estimate, self.std_error(phase, i), ends),
            _ => String::new(),
        }
    }
}

/// State by state: mean with intervals, and standard deviation with intervals or, of tests in groups, at every level.
pub(super) fn columns(record: &FitRecord, phase: &PhaseRecord) -> Vec<TextColumn> {
    let p = phase.states.len();
    let units = (0..p).map(|i| phase.units.get(i).cloned().flatten().unwrap_or_default()).collect();
    let mut columns = vec![
        TextColumn::new("state", ColumnSide::Left, phase.states.clone()),
        TextColumn::new("unit", ColumnSide::Left, units),
    ];
    for (kind, name) in [(StateFigure::Mean, "mean"), (StateFigure::StdDev, "std dev")] {
        if kind == StateFigure::StdDev && !record.levels.is_empty() {
            columns.extend(of_levels(record, phase));
            continue;
        }
        let (values, beside): (Vec<_>, Vec<_>) = (0..p).map(|i| kind.cells(phase, i)).unzip();
        columns.push(TextColumn::new(name, ColumnSide::Right, values));
        columns.push(TextColumn::new("", ColumnSide::Left, beside));
        let intervals = (0..p).map(|i| kind.interval(phase, i)).collect();
        columns.push(TextColumn::new(&format!("95 % interval of the {name}"), ColumnSide::Left, intervals));
    }
    columns
}

/// The standard deviation of each state at every level; empty where it does not vary.
fn of_levels(record: &FitRecord, phase: &PhaseRecord) -> Vec<TextColumn> {
    let of_level = |(level, place): (&LevelRecord, String)| {
        let cells = |i: usize| {
            let varying = level.effect_on(&phase.states, i).filter(|&e| !levels::is_held_at_zero(level, e));
            varying.map_or_else(FigureCells::default, |e| levels::std_dev(level, e))
        };
        let (values, beside): (Vec<_>, Vec<_>) = (0..phase.states.len()).map(cells).unzip();
        [TextColumn::new(&place, ColumnSide::Right, values), TextColumn::new("", ColumnSide::Left, beside)]
    };
    record.all_levels().zip(places::places(record)).flat_map(of_level).collect()
}

/// The elements of Σ, folded away.
pub(super) fn elements(phase: &PhaseRecord, page: &PageLayout<'_>) -> Markup {
    let covariance = &phase.covariance;
    let p = phase.states.len().min(covariance.estimate.len());
    let (mut names, mut rows, mut intervals) = (Vec::new(), Vec::new(), Vec::new());
    for (i, k) in (0..p).flat_map(|i| (0..=i).map(move |k| (i, k))).take(MOST_ELEMENTS) {
        let Some(&estimate) = covariance.estimate[i].get(k) else { continue };
        let error = covariance.std_error.get(i).and_then(|row| row.get(k)).copied().flatten();
        let fixed = covariance.fixed.get(i).and_then(|row| row.get(k)).copied().unwrap_or(false);
        let ends = covariance.interval95.get(i).and_then(|row| row.get(k)).copied().flatten();
        names.push(match i == k {
            true => format!("variance of {}", clean(&phase.states[i])),
            false => format!("covariance of {} and {}", clean(&phase.states[k]), clean(&phase.states[i])),
        });
        rows.push(cells(estimate, error, fixed, &|| Some("")));
        intervals.push(ends.filter(|_| !fixed).map_or_else(String::new, |ends| ends_in_words(estimate, error, ends)));
    }
    let (values, beside): (Vec<_>, Vec<_>) = rows.into_iter().unzip();
    let columns = [
        TextColumn::new("element", ColumnSide::Left, names),
        TextColumn::new("estimate", ColumnSide::Right, values),
        TextColumn::new("", ColumnSide::Left, beside),
        TextColumn::new("95 % interval", ColumnSide::Left, intervals),
    ];
    let all = p * (p + 1) / 2;
    html! { details { summary { "Elements of the covariance" } (PreEscaped(page.table(&columns)))
    @if all > MOST_ELEMENTS { p { "The first " (MOST_ELEMENTS) " of " (all) " elements; all are in fit.json." } } } }
}

/// The model says that a state does not vary.
pub(super) fn is_held_at_zero(one: &PhaseRecord, kind: StateFigure, i: usize) -> bool {
    kind == StateFigure::StdDev && kind.fixed(one, i) && kind.estimate(one, i) == Some(0.0)
}

/// An estimate in a forest plot; nothing where there is none.
pub(super) fn forest_row(one: &PhaseRecord, kind: StateFigure, i: usize) -> Option<ForestRow> {
    let estimate = kind.estimate(one, i)?;
    let (shown, beside) = kind.cells(one, i);
    let interval = kind.interval(one, i);
    Some(ForestRow {
        name: clean(&one.states[i]),
        estimate,
        ends: if kind.fixed(one, i) { None } else { kind.ends(one, i) },
        words: forest::words(&shown, &beside, &interval),
        reference: None,
    })
}
