//! Records along tests agree with the results of `apply`, `innovations` and `datasheet`.

use crate::along::along;
use crate::datasheet::{Source, datasheet};
use crate::face::{Ensemble, Fit, Options};
use kalfit_apply::apply::{Applied, StateKind};
use kalfit_filter::innovations::innovations;
use kalfit_model::build::{Columns, constant, measurement, name, random_walk};
use kalfit_model::{Model, PhasedModel};
use kalfit_record::AlongRecord;

/// y = bias + walk, and z = bias on every third row.
fn model(timed: bool) -> PhasedModel {
    let model = Model::builder("wandering");
    let model = if timed { model.time("t").time_unit("s") } else { model };
    let walk = if timed { random_walk("walk", 0.3) } else { constant("walk") };
    let model = model
        .state(constant("bias").unit("deg/h"))
        .state(walk.known(0.0, 0.0))
        .measurement(measurement("y", name("bias") + name("walk"), 0.2))
        .measurement(measurement("z", name("bias"), 0.5));
    model.build().expect("a model")
}

fn wave(k: usize) -> f64 {
    ((k * 7919 + 13) % 101) as f64 / 50.0 - 1.0
}

/// Tests with the given numbers of rows; the sixth test has an outlier.
fn tests(rows: &[usize]) -> Vec<Columns> {
    let one = |(j, &rows): (usize, &usize)| {
        let bias = 2.0 * wave(j * 11 + 3);
        let mut walk = 0.0;
        let y = |k: usize| {
            walk += 0.1 * wave(j * 57 + k);
            let far = if j + 1 == 6 && k == rows / 2 { 30.0 } else { 0.0 };
            bias + walk + 0.3 * wave(j * 31 + 5 * k) + far
        };
        let y: Vec<f64> = (0..rows).map(y).collect();
        let z: Vec<f64> = (0..rows).map(|k| if k % 3 == 0 { bias + 0.5 * wave(k + j) } else { f64::NAN }).collect();
        let t: Vec<f64> = (0..rows).map(|k| 0.5 * k as f64).collect();
        Columns::new(format!("u{j}")).numbers("t", t).numbers("y", y).numbers("z", z)
    };
    rows.iter().enumerate().map(one).collect()
}

fn fitted(timed: bool, rows: &[usize]) -> (Ensemble, Fit) {
    let ensemble = Ensemble::new(&model(timed), &tests(rows)).expect("an ensemble");
    let fit = ensemble.fit_with(&Options::default(), &mut kalfit_estimate::Silent).expect("a fit");
    (ensemble, fit)
}

fn shown(ensemble: &Ensemble, fit: &Fit) -> AlongRecord {
    along((ensemble.model(), &fit.alpha, &fit.population()), ensemble.tests(), &fit.record, &mut |_| true)
}

#[test]
fn short_records_are_whole_and_as_applied() {
    let (ensemble, fit) = fitted(true, &[30, 30, 20, 30, 30, 30]);
    let found = shown(&ensemble, &fit);
    assert_eq!((found.tests.len(), found.of, found.notes.len()), (6, 6, 0), "{:?}", found.notes);
    assert_eq!(found.tests[0].id, "u5", "the outlier makes it the least probable");
    let population = fit.population();
    let applied = Applied::new(&fit.model, &fit.alpha, &population, ensemble.tests()).expect("it applies");
    let [predicted, smoothed] =
        [StateKind::Predicted, StateKind::Smoothed].map(|kind| applied.states(kind, 0..6).expect("states"));
    let seen = innovations(&fit.model, &fit.alpha, &population, ensemble.tests()).expect("innovations");
    for test in &found.tests {
        let at = ensemble.tests().iter().position(|own| own.id == test.id).expect("it is one of them");
        let phase = &test.phases[0];
        let steps = &smoothed[at][0].steps;
        assert_eq!((phase.steps, phase.at.len(), phase.states.len()), (steps.len(), steps.len(), 2));
        for (k, step) in steps.iter().enumerate() {
            assert_eq!(Some(phase.at[k]), step.time);
            for (i, state) in phase.states.iter().enumerate() {
                let (mean, std_dev) = (state.mean[k], state.std_dev[k]);
                assert!(
                    (mean - step.mean[i]).abs() < 1e-12 && (std_dev - step.std_dev[i]).abs() < 1e-12,
                    "{mean} {step:?}"
                );
            }
        }
        for (m, own) in phase.measurements.iter().enumerate() {
            let expected: Vec<_> = predicted[at][0]
                .steps
                .iter()
                .flat_map(|step| &step.measurements)
                .filter(|one| one.measurement == m)
                .collect();
            assert_eq!((own.values, own.predicted.len()), (expected.len(), expected.len()));
            for (k, one) in expected.iter().enumerate() {
                assert!((own.predicted[k] - one.value).abs() < 1e-12 && (own.std_dev[k] - one.std_dev).abs() < 1e-12);
            }
            let z: Vec<f64> = seen[at]
                .iter()
                .flat_map(|own| &own.series)
                .filter(|one| one.measurement == m)
                .map(|one| one.standardised)
                .collect();
            assert_eq!((own.innovations, &own.standardised), (z.len(), &z));
            assert!(own.quantiles.is_sorted_by(|a, b| a[0] < b[0] && a[1] <= b[1]));
        }
        // y comes first in each step, so it is predicted from the steps before only, as its innovation is
        let y = &phase.measurements[0];
        for k in 0..y.values {
            let z = (y.measured[k] - y.predicted[k]) / y.std_dev[k];
            assert!((z - y.standardised[k]).abs() < 1e-9, "{}: {z} against {}", test.id, y.standardised[k]);
        }
    }
}

#[test]
fn allan_deviations_are_those_of_the_datasheet() {
    let (ensemble, fit) = fitted(true, &[60, 60, 40, 60, 60, 60]);
    let found = shown(&ensemble, &fit);
    let source = Source {
        name: "fit".to_owned(),
        record: Some(&fit.record),
        step: None,
        at: &[],
        tests: Some(ensemble.tests()),
    };
    let sheet = datasheet(&fit.model, &fit.alpha, &fit.population(), &source).expect("a datasheet");
    assert!(!found.allan.is_empty() && found.allan[0].points.len() > 3, "{:?}", found.allan);
    assert_eq!((found.allan, found.allan_notes), (sheet.allan, sheet.notes));
}

#[test]
fn long_records_are_bounded_and_keep_what_is_far() {
    let (ensemble, fit) = fitted(true, &[12_000, 500, 500, 500, 500, 9_000]);
    let found = shown(&ensemble, &fit);
    let long = &found.tests.iter().find(|test| test.id == "u5").expect("it is shown").phases[0];
    assert_eq!((long.steps, long.measurements[0].values), (9_000, 9_000));
    for test in &found.tests {
        for own in &test.phases[0].measurements {
            assert!(
                own.at.len() <= 422 && own.standardised.len() <= 422 && own.quantiles.len() <= 120,
                "{}",
                own.at.len()
            );
        }
        assert!(test.phases[0].at.len() <= 401);
    }
    let own = &long.measurements[0];
    assert!(own.at.contains(&2250.0), "the outlier is kept");
    let far = own.standardised.iter().copied().fold(0.0, f64::max);
    assert!(far > 20.0 && own.quantiles[own.quantiles.len() - 1][1] == far, "{far}");
}

#[test]
fn without_times_and_without_patience_there_is_nothing() {
    let (ensemble, fit) = fitted(false, &[30; 6]);
    let found = shown(&ensemble, &fit);
    assert_eq!((found.allan.len(), found.tests.len(), found.notes.len()), (0, 0, 0));
    let (ensemble, fit) = fitted(true, &[30; 6]);
    let all = (ensemble.model(), &fit.alpha, &fit.population());
    let found = along(all, ensemble.tests(), &fit.record, &mut |done| done < 2);
    assert_eq!(found.tests.len(), 2);
    assert_eq!(found.notes, ["2 of the records are shown: the fit was interrupted"]);
}
