//! Inference on a small bench of instruments.

use kalfit_estimate::{Criterion, Silent, Stop};
use kalfit_fixtures::bench::{ensemble, model, scaled_model};
use kalfit_model::Value;
use kalfit_search::{Method, Settings, fit};

use crate::dynamic::infer;
use crate::{Choices, IntervalKind};

fn settings(method: Method, criterion: Criterion) -> Settings {
    let mut settings = Settings { method, ..Settings::default() };
    settings.inner.criterion = criterion;
    settings
}

#[test]
fn of_one_test_the_restricted_likelihood_says_nothing_of_the_covariance() {
    let model = scaled_model();
    let settings = settings(Method::Hybrid, Criterion::Reml);
    for rows in [8, 15, 30, 60] {
        // the mean takes all that the test says of its initial state; what is left of the covariance is rounding
        let (labels, tests) = ensemble(&model, 1, rows);
        let fit = fit(&model, &labels, &tests, &settings, &mut Silent).expect("a fit");
        assert_eq!(fit.stop, Stop::Certified, "{rows} rows");
        let (inference, _) = infer(&model, (&labels, &tests), &fit, Choices::default(), &mut Silent).expect("inferred");
        let found = inference.uncertainty;
        assert!(found.errors.mean.iter().all(Option::is_some), "{rows} rows: {found:?}");
        assert!(found.errors.covariance.iter().flatten().all(Option::is_none), "{rows} rows: {found:?}");
        assert!(found.errors.std_dev.iter().all(Option::is_none), "{rows} rows: {found:?}");
    }
}

#[test]
fn profile_intervals_end_where_the_likelihood_has_fallen_by_the_quantile() {
    for (tests, rows) in [(12, 8), (15, 6)] {
        let model = model(false);
        let (labels, tests) = ensemble(&model, tests, rows);
        let settings = settings(Method::Hybrid, Criterion::Ml);
        let best = fit(&model, &labels, &tests, &settings, &mut Silent).expect("a fit");
        let choices = Choices { intervals: IntervalKind::Profile, ..Choices::default() };
        let (_, parameters) = infer(&model, (&labels, &tests), &best, choices, &mut Silent).expect("inferred");
        for (slot, parameter) in best.slots.slots().iter().zip(&parameters).filter(|(slot, _)| slot.level.is_none()) {
            for end in parameter.interval.expect("determined").into_iter().flatten().filter(|end| *end != 0.0) {
                let mut held = model.clone();
                held.phases[0].model.parameters[slot.parameter].value = Value::Fixed(end);
                let there = fit(&held, &labels, &tests, &settings, &mut Silent).expect("a fit");
                let fallen = 2.0 * (best.estimate.log_likelihood - there.estimate.log_likelihood);
                let near = (fallen - 3.841_458_8).abs() < 2e-3;
                assert!(near, "{}: {end} has {fallen}, the quantile is 3.841", slot.parameter);
            }
        }
    }
}
