//! μ and the standard deviations, state by state, with what else shifts the mean.

use kalfit::FitRecord;
use kalfit::record::{BoundaryRecord, PhaseRecord, RegressionRecord, ScaleRecord, UnidentifiedRecord};

use super::combination::covariance_of;
use super::{few_tests, levels, places};
use crate::number::{FigurePrecision, p_value, plain};
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::clean;

/// A figure and what is known of its error, in two cells.
pub(crate) type FigureCells = (String, String);

/// The standard error by its name, where it is not the usual one.
pub(crate) fn std_error(kind: &str) -> String {
    match kind {
        "expected" | "sandwich" => format!("{kind} standard error"),
        _ => "standard error".to_owned(),
    }
}

pub(crate) fn section(
    record: &FitRecord,
    phase: &PhaseRecord,
    title: &dyn Fn(&str) -> String,
    page: &PageLayout<'_>,
) -> String {
    if phase.states.is_empty() {
        return page.paragraph(&title("Initial state: nothing of it is estimated."));
    }
    if !record.levels.is_empty() {
        return by_level(record, phase, title, page);
    }
    let p = phase.states.len();
    let (mean, mean_error): (Vec<_>, Vec<_>) = (0..p).map(|i| mean(phase, i)).unzip();
    let (std_dev, std_dev_error): (Vec<_>, Vec<_>) = (0..p).map(|i| std_dev(phase, i)).unzip();
    let units = (0..p).map(|i| phase.units.get(i).cloned().flatten().unwrap_or_default()).collect();
    let mut columns = vec![
        TextColumn::new("state", ColumnSide::Left, phase.states.clone()),
        TextColumn::new("unit", ColumnSide::Left, units),
        TextColumn::new("mean", ColumnSide::Right, mean),
        TextColumn::new("", ColumnSide::Left, mean_error),
        TextColumn::new("std dev", ColumnSide::Right, std_dev),
        TextColumn::new("", ColumnSide::Left, std_dev_error),
    ];
    if record.df_method.is_some() {
        let df = |i: usize| phase.mean.few_tests.df.get(i).copied().flatten();
        columns
            .insert(4, TextColumn::new("df", ColumnSide::Right, (0..p).map(|i| few_tests::freedom(df(i))).collect()));
        let intervals = (0..p).map(|i| interval(phase, i)).collect();
        columns.insert(5, TextColumn::new("95 % interval", ColumnSide::Left, intervals));
    }
    let heading = title(&format!("Initial state over the tests (± {})", std_error(&record.std_errors)));
    let said = few_tests::items(record, phase).into_iter().chain(heterogeneity(record, phase));
    let body = page.table(&columns) + &page.items(&said.collect::<Vec<_>>());
    page.section(&heading, &body) + &scales(phase, page) + &regression(phase, page)
}

/// How much tests differ beyond their noise, where that is known.
fn heterogeneity(record: &FitRecord, phase: &PhaseRecord) -> Vec<String> {
    let found = record.heterogeneity.as_ref().filter(|_| record.phases.len() == 1);
    let (Some(found), Some(state)) = (found, phase.states.first()) else { return Vec::new() };
    let state = clean(state);
    let mut said = vec![format!(
        "Spread of {state} between tests: I² = {} % of the variance of typical estimates, H² = {}. Cochran's Q = {} with {} degrees \
         of freedom: {}.",
        plain(100.0 * found.i_squared, 3),
        plain(found.h_squared, 3),
        plain(found.q, 4),
        found.degrees_of_freedom,
        p_value(found.p_value)
    )];
    if let Some([low, high]) = found.prediction95 {
        let precision = FigurePrecision::of(high, Some(0.2 * (high - low)));
        let law = match found.prediction_df {
            Some(freedom) => format!(", by Student's t with {} degrees of freedom", plain(freedom, 3)),
            None => String::new(),
        };
        let (low, high) = (precision.show(low), precision.show(high));
        said.push(format!("The {state} of a new test is between {low} and {high} with probability 95 %{law}."));
    }
    said
}

/// Tests in groups: the mean of each state, and its standard deviation at each level, side by side.
fn by_level(record: &FitRecord, phase: &PhaseRecord, title: &dyn Fn(&str) -> String, page: &PageLayout<'_>) -> String {
    let p = phase.states.len();
    let column = |heading: &str, cell: &dyn Fn(usize) -> String| {
        TextColumn::new(heading, ColumnSide::Right, (0..p).map(cell).collect())
    };
    let both = |(figure, beside): FigureCells| format!("{figure} {beside}").trim().to_owned();
    let mut columns = vec![
        column("unit", &|i| phase.units.get(i).cloned().flatten().unwrap_or_default()),
        column("mean", &|i| both(mean(phase, i))),
    ];
    if record.df_method.is_some() {
        columns.push(column("df", &|i| few_tests::freedom(phase.mean.few_tests.df.get(i).copied().flatten())));
        columns.push(column("95 % interval", &|i| interval(phase, i)));
    }
    let places = places::places(record);
    columns.extend(record.all_levels().zip(&places).map(|(level, place)| {
        let varying = |i: usize| level.effect_on(&phase.states, i).filter(|&e| !levels::is_held_at_zero(level, e));
        column(place, &|i| varying(i).map_or(String::new(), |e| both(levels::std_dev(level, e))))
    }));
    let heading = title(&format!(
        "Initial state: mean, and standard deviation at each level (± {})",
        std_error(&record.std_errors)
    ));
    let table = page.wide_table(&TextColumn::new("state", ColumnSide::Left, phase.states.clone()), &columns);
    let body = table + &page.items(&few_tests::items(record, phase));
    page.section(&heading, &body) + &scales(phase, page) + &regression(phase, page)
}

/// The interval of a mean in the digits of the mean; empty where there is none.
fn interval(phase: &PhaseRecord, i: usize) -> String {
    let ends = phase.mean.interval95.get(i).copied().flatten();
    let (Some(&estimate), Some([Some(low), Some(high)])) = (phase.mean.estimate.get(i), ends) else {
        return String::new();
    };
    let precision = FigurePrecision::of(estimate, phase.mean.std_error.get(i).copied().flatten());
    format!("{} to {}", precision.show(low), precision.show(high))
}

pub(crate) fn mean(phase: &PhaseRecord, i: usize) -> FigureCells {
    let Some(&estimate) = phase.mean.estimate.get(i) else { return Default::default() };
    let fixed = phase.mean.fixed.get(i).copied().unwrap_or(false);
    let error = phase.mean.std_error.get(i).copied().flatten();
    cells(estimate, error, fixed, &|| {
        touches(&phase.unidentified, "mean", &phase.states, &|e| e == phase.states[i]).then_some("not identified")
    })
}

pub(crate) fn std_dev(phase: &PhaseRecord, i: usize) -> FigureCells {
    let Some(&estimate) = phase.std_dev.estimate.get(i) else { return Default::default() };
    let fixed = phase.covariance.fixed.get(i).and_then(|row| row.get(i)).copied().unwrap_or(false);
    let error = phase.std_dev.std_error.get(i).copied().flatten();
    spread(&phase.states[i], (estimate, error, fixed), &phase.boundary, &phase.unidentified)
}

/// The standard deviation of a state, from its figure, its error and whether it is fixed.
pub(crate) fn spread(
    name: &str,
    (estimate, error, fixed): (f64, Option<f64>, bool),
    boundary: &[BoundaryRecord],
    unidentified: &[UnidentifiedRecord],
) -> FigureCells {
    let among = |names: &[String]| names.iter().any(|other| other == name);
    if boundary.iter().any(|b| among(&b.zero_variances)) {
        return ("0".to_owned(), "at zero (boundary)".to_owned());
    }
    let singular = boundary.iter().any(|b| among(&b.states));
    let (figure, beside) = cells(estimate, error, fixed, &|| {
        let is_variance = |element: &str| covariance_of(element).is_some_and(|(a, b)| a == name && b == name);
        match touches(unidentified, "covariance", &[], &is_variance) {
            true => Some("not identified"),
            false => singular.then_some("boundary"),
        }
    });
    let both = singular && error.is_some_and(|e| e.is_finite()) && !fixed;
    (figure, if both { format!("{beside} boundary") } else { beside })
}

/// The figure with `± error`, or with the reason why there is none.
pub(crate) fn cells(
    estimate: f64,
    error: Option<f64>,
    fixed: bool,
    why: &dyn Fn() -> Option<&'static str>,
) -> FigureCells {
    let precision = FigurePrecision::of(estimate, error.filter(|_| !fixed));
    let beside = match error.filter(|e| e.is_finite()) {
        _ if fixed => "fixed".to_owned(),
        Some(error) => format!("± {}", precision.show_error(error)),
        None => why().unwrap_or("± unknown").to_owned(),
    };
    (precision.show(estimate), beside)
}

/// True when some unidentified direction of this kind has weight on an element that `wanted` picks. `names` stand for the
/// elements of a direction that does not name its own.
fn touches(directions: &[UnidentifiedRecord], what: &str, names: &[String], wanted: &dyn Fn(&str) -> bool) -> bool {
    directions.iter().filter(|u| u.what == what).any(|u| {
        let names = if u.elements.is_empty() { names } else { &u.elements };
        names.iter().zip(&u.direction).any(|(name, w)| wanted(name) && *w != 0.0)
    })
}

pub(crate) fn scales(phase: &PhaseRecord, page: &PageLayout<'_>) -> String {
    let line = |scale: &Option<ScaleRecord>, what: &str| {
        scale.as_ref().map_or(String::new(), |s| {
            let (value, error) = cells(s.estimate, s.std_error, false, &|| None);
            page.items(&[format!("{what}: {value} {error}.")])
        })
    };
    line(&phase.mean.scale, "The mean is the given direction times a scale")
        + &line(&phase.covariance.scale, "The covariance is the given matrix times a scale")
}

/// Why a regression coefficient has no standard error.
fn coefficient(phase: &PhaseRecord, row: &RegressionRecord) -> Option<&'static str> {
    let own = format!("{} per {}", row.state, row.column);
    touches(&phase.unidentified, "mean", &[], &|element| element == own).then_some("not identified")
}

pub(crate) fn regression(phase: &PhaseRecord, page: &PageLayout<'_>) -> String {
    let rows = &phase.mean.regression;
    let with_df = |r: &RegressionRecord| {
        let (value, error) = cells(r.estimate, r.std_error, false, &|| coefficient(phase, r));
        (value, error + &few_tests::beside(r.few_tests.df))
    };
    let (values, errors): (Vec<_>, Vec<_>) = rows.iter().map(with_df).unzip();
    if rows.is_empty() {
        return String::new();
    }
    let columns = [
        TextColumn::new("mean of", ColumnSide::Left, rows.iter().map(|r| r.state.clone()).collect()),
        TextColumn::new("per unit of", ColumnSide::Left, rows.iter().map(|r| clean(&r.column)).collect()),
        TextColumn::new("coefficient", ColumnSide::Right, values),
        TextColumn::new("", ColumnSide::Left, errors),
    ];
    format!("\n{}", page.table(&columns))
}
