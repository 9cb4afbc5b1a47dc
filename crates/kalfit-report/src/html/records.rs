//! Records over time: Allan deviations of all of them, and one test in detail.

use kalfit::record::{AlongRecord, MeasurementAlong, PhaseAlong, StateAlong, TestAlong};
use maud::{Markup, html};
use serde_json::{Value, json};

use crate::html::allan;
use crate::html::chart::{PageChart, PageCharts};
use crate::html::section::PageSection;
use crate::words::{clean, count, sentence};

/// Series of one phase that can be chosen.
const MOST_SERIES: usize = 40;
/// Parts of its range that a series is drawn in.
const PARTS: f64 = 20_000.0;

pub(super) fn section(along: &AlongRecord, charts: &mut PageCharts) -> Option<PageSection> {
    let notes: Vec<String> = along.notes.iter().map(|note| sentence(&clean(note))).collect();
    let body = html! {
        (allan::part(along, charts).unwrap_or_default())
        @for figure in &one_test(along, charts) { (figure) }
        @for note in &notes { p { (note) } }
    };
    PageSection::new("records", "Records", body)
}

/// A chart for each phase.
fn one_test(along: &AlongRecord, charts: &mut PageCharts) -> Vec<Markup> {
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
    let heading = (!drawn.is_empty()).then(|| html! { h3 { "Along one record" } });
    heading.into_iter().chain(drawn).collect()
}

fn chart(along: &AlongRecord, phase: &str, title: &str, charts: &mut PageCharts) -> Option<Markup> {
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
        "Choose a test; the least probable comes first. Top: measured values, and predictions before each step with a band of two \
         standard deviations; about one value in twenty should lie outside. The band of the first steps may extend beyond the chart. Next: \
         innovations divided by their standard deviations; 95 % should lie within the dashed lines, without a pattern. Then: a state \
         estimated from the whole record, with two standard deviations. Last: normal quantile plot of the innovations. Points on the \
         line are as expected; ends that bend away are outliers, and a steeper slope means that the model has too little noise.{left}"
    );
    let alternative = format!("For {}; test {} is shown first.", count(tests.len(), "test"), clean(&first.0.id));
    Some(charts.figure(PageChart { kind: "record", title, caption: &caption, alternative: &alternative, data }))
}

fn test_data(test: &TestAlong, phase: &PhaseAlong) -> Value {
    let measurements = phase.measurements.iter().take(MOST_SERIES);
    let states = phase.states.iter().take(MOST_SERIES);
    json!({
        "id": clean(&test.id), "at": times(&phase.at), "steps": phase.steps,
        "measurements": measurements.map(|own| measured(own, &phase.at)).collect::<Vec<Value>>(),
        "states": states.map(state).collect::<Vec<Value>>(),
    })
}

/// Times that are those of `before` are null.
fn measured(own: &MeasurementAlong, before: &[f64]) -> Value {
    let other = |at: &[f64], before: &[f64]| if at == before { Value::Null } else { times(at) };
    let range = range(&own.measured, &[]);
    let pair = |pair: &[f64; 2]| numbers(pair, 10.0);
    json!({
        "name": clean(&own.name), "values": own.values, "innovations": own.innovations,
        "at": other(&own.at, before), "measured": folded(numbers(&own.measured, range)),
        "predicted": folded(numbers(&own.predicted, range)), "sd": folded(numbers(&own.std_dev, self::range(&own.std_dev, &[]))),
        "zAt": other(&own.innovations_at, &own.at), "z": folded(numbers(&own.standardised, 10.0)),
        "q": own.quantiles.iter().map(pair).collect::<Vec<_>>(),
    })
}

fn state(own: &StateAlong) -> Value {
    json!({
        "name": clean(&own.name), "unit": own.unit.as_deref().map_or_else(String::new, clean),
        "mean": folded(numbers(&own.mean, range(&own.mean, &own.std_dev))),
        "sd": folded(numbers(&own.std_dev, range(&own.std_dev, &[]))),
    })
}

/// What values span with their standard deviations, where there are any; a size of them where that is nothing.
fn range(values: &[f64], std_dev: &[f64]) -> f64 {
    let wide = |i: usize| std_dev.get(i).filter(|sd| sd.is_finite()).map_or(0.0, |sd| 2.0 * sd);
    let known = values.iter().enumerate().filter(|(_, x)| x.is_finite());
    let ends = known
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (i, x)| (low.min(x - wide(i)), high.max(x + wide(i))));
    if ends.1 > ends.0 { ends.1 - ends.0 } else { ends.1.abs() }
}

fn times(at: &[f64]) -> Value {
    json!(numbers(at, 1e-3 * range(at, &[])))
}

/// One number in place of many that are the same.
fn folded(numbers: Vec<Value>) -> Value {
    match numbers.first() {
        Some(first) if numbers.iter().all(|other| other == first) => first.clone(),
        _ => Value::Array(numbers),
    }
}

/// Numbers with the decimals that a drawing over such a range shows.
fn numbers(all: &[f64], range: f64) -> Vec<Value> {
    let grain = (range / PARTS).log10().floor();
    let rounded = |x: f64| -> f64 {
        match grain as i32 {
            _ if !grain.is_finite() => x,
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
        assert_eq!(numbers(&all, range(&all, &[])), [json!(0.3), json!(0.33333), json!(0.0), Value::Null]);
        assert_eq!(numbers(&[123_456_789.123], 1e9), [json!(123_456_789.0)]);
        assert_eq!(numbers(&[0.0], range(&[0.0], &[])), [json!(0.0)]);
        let tiny = [1e-300, 2e-300];
        assert_eq!(numbers(&tiny, range(&tiny, &[])), [json!(1e-300), json!(2e-300)]);
        // a narrow band about a large number is drawn over the band
        let (mean, std_dev) = ([1000.0012, 1000.0034], [0.01, 0.01]);
        assert_eq!(numbers(&mean, range(&mean, &std_dev)), [json!(1000.0012), json!(1000.0034)]);
    }

    #[test]
    fn what_is_the_same_is_written_once() {
        assert_eq!(folded(numbers(&[5.0, 5.0 + 1e-12], 5.0)), json!(5.0));
        assert_eq!(folded(numbers(&[5.0, 6.0], 1.0)), json!([5.0, 6.0]));
        assert_eq!(folded(Vec::new()), json!([]));
        assert_eq!(times(&[3.0, 3.0]), json!([3.0, 3.0]));
    }
}
