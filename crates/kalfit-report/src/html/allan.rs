//! The Allan deviation of each measurement: of the records, and of the fitted model.

use kalfit::record::{AllanPoint, AlongRecord, CurveRecord};
use maud::{Markup, html};
use serde_json::{Value, json};

use crate::html::chart::{PageChart, PageCharts, figure};
use crate::words::{clean, count, list, sentence};

/// Measurements that can be chosen.
const MOST_CURVES: usize = 60;
/// Measurements that are named at a note.
const MOST_NAMES: usize = 12;

pub(super) fn part(along: &AlongRecord, charts: &mut PageCharts) -> Option<Markup> {
    if along.allan.is_empty() {
        return None;
    }
    let drawn: Vec<&CurveRecord> = along.allan.iter().filter(|curve| curve.points.iter().any(is_known)).collect();
    let chart = chart(along, &drawn[..drawn.len().min(MOST_CURVES)], charts);
    let mut said = notes(along);
    if drawn.len() > MOST_CURVES {
        said.push(format!("The first {MOST_CURVES} of {} can be chosen.", count(drawn.len(), "measurement")));
    }
    Some(html! {
        h3 { "Allan deviation" }
        (chart.unwrap_or_default())
        @if said.len() > 1 { ul.hint { @for one in &said { li { (one) } } } }
        @else { @for one in &said { p.hint { (one) } } }
    })
}

fn is_known(point: &AllanPoint) -> bool {
    point.model.is_some() || point.data.is_some()
}

/// A name that tells it from those of other phases.
fn name(along: &AlongRecord, curve: &CurveRecord) -> String {
    let first = along.allan.first().map_or("", |first| first.phase.as_str());
    let one_phase = along.allan.iter().all(|other| other.phase == first);
    if one_phase {
        clean(&curve.measurement)
    } else {
        format!("{}: {}", clean(&curve.phase), clean(&curve.measurement))
    }
}

fn chart(along: &AlongRecord, curves: &[&CurveRecord], charts: &mut PageCharts) -> Option<Markup> {
    let first = curves.first()?;
    let data = json!({
        "timeUnit": along.time_unit.as_deref().map_or_else(String::new, clean),
        "curves": curves.iter().map(|curve| curve_data(along, curve)).collect::<Vec<Value>>(),
    });
    let points = first.points.iter().filter(|point| is_known(point)).count();
    let alternative = format!(
        "{}; of {} there are {}.",
        count(curves.len(), "measurement"),
        name(along, first),
        count(points, "averaging time")
    );
    let caption = "How much neighbouring averages differ, against the averaging time. Points with bars: the records of all tests with \
                   95 % limits. Line: the fitted model. Where the line misses the bars, the model lacks noise or a process at that time \
                   scale: a slope of −½ is white noise, a flat floor slow drift, +½ a random walk, +1 a ramp.";
    Some(charts.figure(PageChart { kind: "allan", title: "Allan deviation", caption, alternative: &alternative, data }))
}

fn curve_data(along: &AlongRecord, curve: &CurveRecord) -> Value {
    let point = |point: &AllanPoint| {
        let [low, high] = point.interval95.unwrap_or_default();
        let or_null = |x: Option<f64>| x.filter(|x| *x > 0.0).map_or(Value::Null, figure);
        json!({
            "time": figure(point.time), "n": point.values, "model": or_null(point.model), "data": or_null(point.data),
            "low": or_null(low), "high": or_null(high),
        })
    };
    json!({
        "name": name(along, curve), "unit": curve.unit.as_deref().map_or_else(String::new, clean),
        "said": curve.tests.map_or_else(String::new, |tests| format!("Records of {}.", count(tests, "test"))),
        "points": curve.points.iter().filter(|point| is_known(point)).map(point).collect::<Vec<Value>>(),
    })
}

/// Why there is no curve, and what the curves are.
fn notes(along: &AlongRecord) -> Vec<String> {
    let mut own: Vec<(Vec<String>, &String)> = Vec::new();
    for curve in &along.allan {
        for note in &curve.notes {
            let name = format!("`{}`", name(along, curve));
            match own.iter_mut().find(|(_, other)| *other == note) {
                Some((names, _)) => names.push(name),
                None => own.push((vec![name], note)),
            }
        }
    }
    let own = own.iter().map(|(names, note)| format!("{}: {note}", list(names, MOST_NAMES)));
    let all = own.chain(along.allan_notes.iter().cloned());
    // what `kalfit datasheet` can be told, a fit cannot
    let elsewhere = |note: String| {
        ["`--at", "`--step"]
            .iter()
            .fold(note, |note, option| note.replace(option, &option.replace('`', "`kalfit datasheet ")))
    };
    all.map(|note| sentence(&clean(&elsewhere(note)))).collect()
}
