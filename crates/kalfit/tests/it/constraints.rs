//! Score tests and likelihood ratios of constraints against closed forms: two states that N tests measure once each, with variances
//! of one and a sample correlation r. The score statistic of a zero covariance is N r², the likelihood ratio -N log(1 - r²).

use std::f64::consts::TAU;

use kalfit::build::{Columns, ModelBuilder, constant, measurement, name};
use kalfit::estimate::Silent;
use kalfit::model::Model;
use kalfit::record::ConstraintRecord;
use kalfit::{Ensemble, Options};

fn measured_once() -> ModelBuilder {
    let states = Model::builder("once").state(constant("a")).state(constant("b"));
    states.measurement(measurement("ya", name("a"), 1e-3)).measurement(measurement("yb", name("b"), 1e-3))
}

/// The constraints of a fit to `n` tests with means of zero, variances of one and the correlation `r`.
fn constraints(model: ModelBuilder, n: usize, r: f64) -> Vec<ConstraintRecord> {
    let model = model.build().expect("a model");
    let one = |j: usize| {
        let (sine, cosine) = (TAU * j as f64 / n as f64).sin_cos();
        let (a, b) = (cosine * 2f64.sqrt(), sine * 2f64.sqrt());
        Columns::new(format!("t{j:03}")).numbers("ya", [a]).numbers("yb", [r * a + (1.0 - r * r).sqrt() * b])
    };
    let ensemble = Ensemble::new(&model, &(0..n).map(one).collect::<Vec<_>>()).expect("columns of the model");
    let fit = ensemble.fit_with(&Options { innovations: false, ..Options::default() }, &mut Silent).expect("a fit");
    assert!(fit.converged(), "{}", fit.record.reason);
    fit.record.constraints
}

#[track_caller]
fn close(found: Option<f64>, expected: f64, what: &str) {
    let found = found.unwrap_or_else(|| panic!("{what}: found none, expected {expected}"));
    assert!((found / expected - 1.0).abs() < 1e-6, "{what}: found {found}, expected {expected}");
}

#[test]
fn the_score_statistic_of_a_zero_covariance_divides_by_the_expected_information() {
    // the observed information is n (1 - 4r²)
    for (n, r) in [(12, 0.49), (12, -0.3), (100, 0.8), (8, 0.5)] {
        let found = constraints(measured_once().diagonal(), n, r);
        let own = &found[0];
        let what = |figure: &str| format!("{n} tests, r = {r}: {figure}");
        close(own.score_statistic, n as f64 * r * r, &what("statistic"));
        close(own.expected_change, r, &what("change"));
        let ratio = -(n as f64) * (1.0 - r * r).ln();
        match own.p_value.expect("it is tested") < 0.05 {
            true => close(own.likelihood_ratio, ratio, &what("likelihood ratio")),
            false => assert_eq!(own.likelihood_ratio, None, "{}", what("likelihood ratio")),
        }
    }
}

#[test]
fn a_change_ends_where_the_covariance_ceases_to_be_positive_semidefinite() {
    // with both variances held at a fifth of what they are, the first step of the covariance is five times too long
    let model = measured_once().diagonal().fix_covariance("a", "a", 0.2).fix_covariance("b", "b", 0.2);
    let found = constraints(model, 100, 0.8);
    let own = found.iter().find(|own| own.element == "covariance[a, b]").expect("it is held");
    close(own.expected_change, 0.2, "covariance");
    let variance = found.iter().find(|own| own.element == "covariance[a, a]").expect("it is held");
    close(variance.expected_change, 0.8 - 1e-6, "variance");
    // with the other constraints in place: σ² = 1 in place of s = 0.2 + 1e-6 gains n (1/s - 1 + log s)
    let s: f64 = 0.2 + 1e-6;
    close(variance.likelihood_ratio, 100.0 * (s.recip() - 1.0 + s.ln()), "likelihood ratio of the variance");
}

#[test]
fn a_mean_is_freed_by_itself() {
    let found = constraints(measured_once().fix_mean("a", 0.5), 40, 0.0);
    // of n tests about m with the variance v around it, v = 1 + m²
    close(found[0].score_statistic, 40.0 * 0.25 / 1.25, "statistic");
    close(found[0].likelihood_ratio, 40.0 * 1.25f64.ln(), "likelihood ratio");
    close(found[0].expected_change, -0.5, "change");
}
