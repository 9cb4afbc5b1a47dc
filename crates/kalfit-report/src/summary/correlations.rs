//! Correlations between the states, the lower triangle.

use super::spread::StateSpread;
use crate::number::FigurePrecision;
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};

/// What is shown for a correlation with a state that does not vary.
const UNDEFINED: &str = "-";

/// `place` says in words where the states vary so, with a space in front, when there is more than one such place.
pub(crate) fn section(
    spread: StateSpread<'_>,
    place: &str,
    title: &dyn Fn(&str) -> String,
    page: &PageLayout<'_>,
) -> String {
    let random: Vec<usize> = (0..spread.states.len()).filter(|&i| !held_at_zero(spread, i)).collect();
    if random.len() < 2 {
        return String::new();
    }
    let pairs = || random.iter().flat_map(|&i| random.iter().filter(move |&&k| k < i).map(move |&k| (i, k)));
    if pairs().all(|(i, k)| is_fixed_zero(spread, i, k)) {
        let sentence = "The states are held uncorrelated.".to_owned();
        return page.section(&title(&format!("Correlations{place}")), &page.items(&[sentence]));
    }
    let rows = &random[1..];
    let names = TextColumn::new("", ColumnSide::Left, rows.iter().map(|&i| spread.states[i].clone()).collect());
    let columns: Vec<TextColumn> = random[..random.len() - 1]
        .iter()
        .map(|&k| {
            let cells = rows.iter().map(|&i| if i > k { cell(spread, i, k) } else { String::new() });
            TextColumn::new(&spread.states[k], ColumnSide::Right, cells.collect())
        })
        .collect();
    let mut body = page.wide_table(&names, &columns);
    if pairs().any(|(i, k)| cell(spread, i, k) == UNDEFINED) {
        body += &page.items(&[format!("{UNDEFINED} not defined: a standard deviation is zero.")]);
    }
    page.section(&title(&format!("Correlations{place} (± standard error)")), &body)
}

fn cell(spread: StateSpread<'_>, i: usize, k: usize) -> String {
    let of = |m: &[Vec<Option<f64>>]| m.get(i).and_then(|row| row.get(k)).copied().flatten().filter(|x| x.is_finite());
    if is_fixed_zero(spread, i, k) {
        return "0 fixed".to_owned();
    }
    let Some(value) = of(&spread.correlation.estimate) else { return UNDEFINED.to_owned() };
    match of(&spread.correlation.std_error).filter(|e| *e > 0.0) {
        Some(error) => {
            let decimals = match FigurePrecision::of(value, Some(error)) {
                FigurePrecision::Decimals(d) => d.clamp(2, 3),
                _ => 3,
            };
            format!("{} ± {error:.decimals$}", FigurePrecision::Decimals(decimals).show(value))
        }
        None => FigurePrecision::Decimals(3).show(value),
    }
}

fn element(spread: StateSpread<'_>, i: usize, k: usize) -> (f64, bool) {
    let covariance = &spread.covariance;
    let value = covariance.estimate.get(i).and_then(|row| row.get(k)).copied().unwrap_or(f64::NAN);
    (value, covariance.fixed.get(i).and_then(|row| row.get(k)).copied().unwrap_or(false))
}

/// A state whose variance is fixed at zero has no correlations to speak of.
fn held_at_zero(spread: StateSpread<'_>, i: usize) -> bool {
    is_fixed_zero(spread, i, i)
}

fn is_fixed_zero(spread: StateSpread<'_>, i: usize, k: usize) -> bool {
    let (value, fixed) = element(spread, i, k);
    fixed && value == 0.0
}
