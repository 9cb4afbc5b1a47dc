//! Along the records: Allan deviations of all of them, and one test in detail.

use kalfit::record::{AlongRecord, MeasurementAlong, PhaseAlong, StateAlong, TestAlong};
use maud::{Markup, html};
use serde_json::{Value, json};

use crate::html::allan;
use crate::html::chart::{Chart, Charts};
use crate::html::section::Section;
use crate::words::{clean, count, sentence};

/// Series of one phase that can be chosen.
const MOST_SERIES: usize = 40;
/// Parts of its range that a series is drawn in.
const PARTS: f64 = 20_000.0;

pub(super) fn section(along: &AlongRecord, charts: &mut Charts) -> Option<Section> {
    let notes: Vec<String> = along.notes.iter().map(|note| sentence(&clean(note))).collect();
    let body = html! {
        (allan::part(along, charts).unwrap_or_default())
        @for figure in &one_test(along, charts) { (figure) }
        @for note in &notes { p { (note) } }
    };
    Section::new("records", "Records", body)
}

/// A chart for each phase.
fn one_test(along: &AlongRecord, charts: &mut Charts) -> Vec<Markup> {
    let mut phases: Vec<&str> = Vec::new();
    for phase in along.tests.iter().flat_map(|test| &test.phases) {
        if !phases.contains(&phase.name.as_str()) {
            phases.push(&phase.name);
        }
    }
    let several = phases.len() > 1;
    let title = |phase: &str| match several {
        true => format!("Phase {}: the record of one test", clean(phase)),
        false => "The record of one test".to_owned(),
    };
    let drawn: Vec<Markup> = phases.iter().filter_map(|phase| chart(along, phase, &title(phase), charts)).collect();
    let heading = (!drawn.is_empty()).then(|| html! { h3 { "Test by test" } });
    heading.into_iter().chain(drawn).collect()
}

fn chart(along: &AlongRecord, phase: &str, title: &str, charts: &mut Charts) -> Option<Markup> {
    let own = |test: &'_ TestAlong| test.phases.iter().position(|own| own.name == phase);
    let tests: Vec<(&TestAlong, &PhaseAlong)> =
        along.tests.iter().filter_map(|test| Some((test, &test.phases[own(test)?]))).collect();
    let first = tests.first()?;
    let data = json!({
        "timeUnit": along.time_unit.as_deref().map_or_else(String::new, clean),
        "tests": tests.iter().map(|(test, phase)| test_data(test, phase)).collect::<Vec<Value>>(),
    });
    let left = along.of.saturating_sub(along.tests.len());
    let left = match left {
        0 => String::new(),
        _ => format!(
            " {} that are more probable cannot be chosen; `kalfit apply --states` writes all.",
            count(left, "test")
        ),
    };
    let caption = format!(
        "Choose a test; the least probable comes first. Top: what was measured, and the band of two standard deviations that was foreseen \
         before each step; one value in twenty lies outside. Below: innovations in their standard deviations; 95 % within the dashed lines, \
         without pattern. Then a state given the whole record, with two standard deviations. Last, innovations in order against those of a \
         normal law: points on the diagonal; ends that bend away are outliers, a steeper line noise that the model has too small.{left}"
    );
    let alternative = format!("For {}; test {} is shown first.", count(tests.len(), "test"), clean(&first.0.id));
    Some(charts.figure(Chart { kind: "record", title, caption: &caption, alternative: &alternative, data }))
}

fn test_data(test: &TestAlong, phase: &PhaseAlong) -> Value {
    let measurements = phase.measurements.iter().take(MOST_SERIES);
    let states = phase.states.iter().take(MOST_SERIES);
    json!({
        "id": clean(&test.id), "at": numbers(&phase.at, &[&phase.at], 1e-3), "steps": phase.steps,
        "measurements": measurements.map(measured).collect::<Vec<Value>>(),
        "states": states.map(state).collect::<Vec<Value>>(),
    })
}

fn measured(own: &MeasurementAlong) -> Value {
    let scale: [&[f64]; 2] = [&own.measured, &own.predicted];
    json!({
        "name": clean(&own.name), "values": own.values, "innovations": own.innovations,
        "at": numbers(&own.at, &[&own.at], 1e-3), "measured": numbers(&own.measured, &scale, 1.0),
        "predicted": numbers(&own.predicted, &scale, 1.0), "sd": numbers(&own.std_dev, &[&own.std_dev], 1.0),
        "zAt": numbers(&own.innovations_at, &[&own.innovations_at], 1e-3), "z": numbers(&own.standardised, &[&own.standardised], 1.0),
        "q": own.quantiles.iter().map(|pair| numbers(pair, &[&[-5.0, 5.0]], 1.0)).collect::<Vec<_>>(),
    })
}

fn state(own: &StateAlong) -> Value {
    json!({
        "name": clean(&own.name), "unit": own.unit.as_deref().map_or_else(String::new, clean),
        "mean": numbers(&own.mean, &[&own.mean, &own.std_dev], 1.0), "sd": numbers(&own.std_dev, &[&own.std_dev], 1.0),
    })
}

/// Numbers with the decimals that a drawing over the range of `of` shows, times `fine`.
fn numbers(all: &[f64], of: &[&[f64]], fine: f64) -> Vec<Value> {
    let known = || of.iter().flat_map(|one| one.iter()).copied().filter(|x| x.is_finite());
    let (low, high) = known().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
    let range = if high > low { high - low } else { high.abs() };
    let grain = (fine * range / PARTS).log10().floor();
    let rounded = |x: f64| -> f64 {
        if !x.is_finite() || !grain.is_finite() {
            return x;
        }
        match grain as i32 {
            decimals @ -15..0 => format!("{x:.*}", decimals.unsigned_abs() as usize).parse().unwrap_or(x),
            0.. => x.round(),
            _ => x,
        }
    };
    all.iter().map(|&x| if x.is_finite() { json!(rounded(x) + 0.0) } else { Value::Null }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_digits_that_are_seen() {
        let all = [0.1 + 0.2, 1.0 / 3.0, -1e-9, f64::NAN];
        assert_eq!(numbers(&all, &[&all], 1.0), [json!(0.3), json!(0.33333), json!(0.0), Value::Null]);
        assert_eq!(numbers(&[123_456_789.123], &[&[0.0, 1e9]], 1.0), [json!(123_456_789.0)]);
        assert_eq!(numbers(&[5.0, 5.0], &[&[5.0, 5.0]], 1.0), [json!(5.0), json!(5.0)]);
        assert_eq!(numbers(&[0.0], &[&[0.0]], 1.0), [json!(0.0)]);
        let tiny = [1e-300, 2e-300];
        assert_eq!(numbers(&tiny, &[&tiny], 1.0), [json!(1e-300), json!(2e-300)]);
    }
}
