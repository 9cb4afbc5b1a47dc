//! Tests among the others: ellipses of the population with what each test says, and each test's posterior.

use kalfit::FitRecord;
use kalfit::record::{PhaseRecord, PosteriorRecord, TestRecord};
use maud::Markup;
use serde_json::{Value, json};

use crate::html::chart::{PageChart, PageCharts, figure, figures};
use crate::html::grouping::{ColoredGroups, place};
use crate::html::outlying::{MOST_TESTS, outlying, stands_out};
use crate::number::plain;
use crate::words::{clean, count};

/// States that can be chosen for a chart of pairs.
const MOST_IN_PAIRS: usize = 12;
/// States that can be chosen for a chart of posteriors.
const MOST_STATES: usize = 40;

/// What a test has of a phase.
fn part<'a>(test: TestRecord<'a>, phase: &PhaseRecord) -> Option<PosteriorRecord<'a>> {
    let p = phase.states.len();
    let sound = |part: &PosteriorRecord<'_>| part.mean.len() == p && part.covariance.size() == p;
    test.phases.iter().find(|part| part.name == phase.name).filter(sound)
}

/// Tests that are drawn, and how that is said.
fn chosen<'a>(record: &'a FitRecord, phase: &PhaseRecord) -> (Vec<TestRecord<'a>>, String) {
    let mut having = outlying(record);
    having.retain(|&number| part(record.tests.get(number), phase).is_some());
    let all = having.len();
    let mut shown: Vec<TestRecord<'_>> =
        having.into_iter().take(MOST_TESTS).map(|number| record.tests.get(number)).collect();
    shown.sort_by_key(|test| test.id);
    let said = match all - shown.len() {
        0 => String::new(),
        _ => format!(" Of {}, the {} most outlying are drawn.", count(all, "test"), shown.len()),
    };
    (shown, said)
}

/// Σ of a test that nothing is known of: where there are levels, the sum over all of them.
fn population(record: &FitRecord, phase: &PhaseRecord) -> Vec<Vec<f64>> {
    let mut sum = phase.covariance.estimate.clone();
    for level in record.all_levels().filter(|level| level.column.is_some()) {
        for effects in level.effects_by_slot(&phase.states) {
            let acting = || effects.iter().enumerate().filter_map(|(state, effect)| Some((state, (*effect)?)));
            for (i, effect) in acting() {
                let own = level.covariance.estimate.get(effect);
                for (k, other) in acting() {
                    let own = own.and_then(|row| row.get(other)).copied().unwrap_or(0.0);
                    sum.get_mut(i).and_then(|row| row.get_mut(k)).into_iter().for_each(|sum| *sum += own);
                }
            }
        }
    }
    sum
}

pub(super) fn ellipses(record: &FitRecord, phase: &PhaseRecord, name: &str, charts: &mut PageCharts) -> Option<Markup> {
    let covariance = population(record, phase);
    let p = phase.states.len().min(phase.mean.estimate.len()).min(covariance.len());
    let varies = |i: &usize| covariance[*i].get(*i).is_some_and(|v| *v > 0.0 && v.is_finite());
    let states: Vec<usize> = (0..p).filter(varies).take(MOST_IN_PAIRS).collect();
    let sound = covariance.iter().all(|row| row.len() >= p);
    if states.len() < 2 || !sound {
        return None;
    }
    let (tests, said) = chosen(record, phase);
    let (all, groups) = (record.data.tests, ColoredGroups::of(record));
    let test = |&test: &TestRecord<'_>| {
        let part = part(test, phase).expect("tests were chosen for having it");
        let own = part.own.filter(|own| {
            own.mean.len() == phase.states.len() && own.covariance.iter().all(|row| row.len() == phase.states.len())
        });
        let own_mean = |i: &usize| own.and_then(|own| own.mean[*i]).map_or(Value::Null, figure);
        let own_covariance = |i: &usize| -> Vec<Value> {
            states.iter().map(|k| own.and_then(|o| o.covariance.get(*i)?[*k]).map_or(Value::Null, figure)).collect()
        };
        json!({
            "id": clean(test.id), "out": stands_out(test, all), "group": place(groups.as_ref(), test),
            "mean": figures(states.iter().map(|&i| part.mean[i])),
            "own": states.iter().map(own_mean).collect::<Vec<Value>>(),
            "ownCovariance": states.iter().map(own_covariance).collect::<Vec<_>>(),
        })
    };
    let mut data = json!({
        "states": states.iter().map(|&i| clean(&phase.states[i])).collect::<Vec<_>>(),
        "units": units(phase, &states),
        "mean": figures(states.iter().map(|&i| phase.mean.estimate[i])),
        "covariance": states.iter().map(|&i| figures(states.iter().map(|&k| covariance[i][k]))).collect::<Vec<_>>(),
        "tests": tests.iter().map(test).collect::<Vec<Value>>(),
    });
    ColoredGroups::tell(groups.as_ref(), &mut data);
    let shifted =
        if phase.mean.regression.is_empty() { "" } else { " The ellipses are for regression columns at zero." };
    let caption = format!(
        "The ellipses contain 50 % and 95 % of the tests of the fitted population. Open marks: estimate from the test alone. Filled \
         marks: estimate shrunk towards the population; the less informative the test, the longer the line between the two. Point at \
         a test to see its own error ellipse. About one test in twenty should lie outside.{said}{shifted}{}",
        ColoredGroups::caption(groups.as_ref())
    );
    let alternative =
        format!("{} against {}, for {}.", "Any two estimated states", "each other", count(tests.len(), "test"));
    let title = format!("{name}Population and tests");
    Some(charts.figure(PageChart {
        kind: "ellipses",
        title: &title,
        caption: &caption,
        alternative: &alternative,
        data,
    }))
}

fn units(phase: &PhaseRecord, states: &[usize]) -> Vec<String> {
    states
        .iter()
        .map(|&i| phase.units.get(i).cloned().flatten().map_or_else(String::new, |unit| clean(&unit)))
        .collect()
}

/// What each test says of each state, given the population.
pub(super) fn posteriors(
    record: &FitRecord,
    phase: &PhaseRecord,
    name: &str,
    charts: &mut PageCharts,
) -> Option<Markup> {
    let covariance = population(record, phase);
    let p = phase.states.len().min(phase.mean.estimate.len()).min(covariance.len());
    let states: Vec<usize> = (0..p).take(MOST_STATES).collect();
    let (tests, said) = chosen(record, phase);
    if states.is_empty() || tests.is_empty() {
        return None;
    }
    let (all, groups) = (record.data.tests, ColoredGroups::of(record));
    let test = |&test: &TestRecord<'_>| {
        let part = part(test, phase).expect("tests were chosen for having it");
        json!({
            "id": clean(test.id), "out": stands_out(test, all), "group": place(groups.as_ref(), test),
            "mean": figures(states.iter().map(|&i| part.mean[i])),
            "sd": figures(states.iter().map(|&i| part.covariance[i][i].max(0.0).sqrt())),
        })
    };
    let mut data = json!({
        "states": states.iter().map(|&i| clean(&phase.states[i])).collect::<Vec<_>>(),
        "units": units(phase, &states),
        "mean": figures(states.iter().map(|&i| phase.mean.estimate[i])),
        "sd": figures(states.iter().map(|&i| covariance[i].get(i).map_or(f64::NAN, |v| v.max(0.0).sqrt()))),
        "tests": tests.iter().map(test).collect::<Vec<Value>>(),
    });
    ColoredGroups::tell(groups.as_ref(), &mut data);
    let caption = format!(
        "The estimate of each test given the population, with its 95 % interval, in order of size. The band is the mean ± 1.96 \
         standard deviations of the population. Filled diamonds are outliers.{said}{}",
        ColoredGroups::caption(groups.as_ref())
    );
    let first = phase.states.first().map_or_else(String::new, |s| clean(s));
    let alternative = format!(
        "{}; population mean of {first}: {}.",
        count(tests.len(), "test"),
        phase.mean.estimate.first().map_or_else(String::new, |x| plain(*x, 4))
    );
    let title = format!("{name}Estimates of single tests");
    Some(charts.figure(PageChart {
        kind: "posteriors",
        title: &title,
        caption: &caption,
        alternative: &alternative,
        data,
    }))
}
