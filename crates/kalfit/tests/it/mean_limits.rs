//! Limits of predicted means by profile likelihood: those of a mean μ itself are its profile interval, and a mean that hangs on α is
//! the μ of the same model in other coordinates.

use kalfit::build::{Columns, Formula, ModelBuilder, constant, free, measurement, moving, name};
use kalfit::estimate::Silent;
use kalfit::infer::{Choices, IntervalKind, MeanCombination};
use kalfit::{Alpha, Ensemble, Options, PhasedModel};
use kalfit_fixtures::near;
use nalgebra::DVector;

const QUANTILE: f64 = 1.959_963_984_540_054;
/// When the mean is predicted.
const AFTER: f64 = 6.0;

/// Twelve units that start anywhere and decay.
fn units(model: &PhasedModel) -> Ensemble {
    let unit = |j: usize| {
        let start = 2.0 + ((7 * j) % 12) as f64 / 4.0;
        let times: Vec<f64> = (0..8).map(|k| 0.5 * f64::from(k) + 0.05 * (j % 3) as f64).collect();
        let noise = |k: usize| ((13 * j + 29 * k + j * k) % 17) as f64 / 40.0 - 0.2;
        let y: Vec<f64> =
            times.iter().enumerate().map(|(k, t)| start * (-(t - times[0]) / 3.0).exp() + noise(k)).collect();
        let since: Vec<f64> = times.iter().map(|t| t - times[0]).collect();
        Columns::new(format!("u{j:02}")).numbers("t", times.clone()).numbers("since", since).numbers("y", y)
    };
    Ensemble::new(model, &(0..12).map(unit).collect::<Vec<_>>()).expect("columns of the model")
}

fn model(states: ModelBuilder, equation: Formula) -> PhasedModel {
    let measured = measurement("y", equation, name("sigma"));
    let built = states.time("t").parameter(free("tau")).parameter(free("sigma")).measurement(measured).build();
    built.expect("a model")
}

/// The state decays: its mean later is μ exp(-t/τ).
fn decaying() -> PhasedModel {
    let state = moving("x", -name("x") / name("tau"), 0.0);
    model(kalfit::Model::builder("decaying").state(state), name("x"))
}

/// The state that it will have later is constant.
fn later() -> PhasedModel {
    let weight = ((AFTER - name("since")) / name("tau")).exp();
    model(kalfit::Model::builder("later").state(constant("z")), name("z") * weight)
}

fn profile_of_mean(ensemble: &Ensemble) -> (f64, [f64; 2]) {
    let choices = Choices { intervals: IntervalKind::Profile, ..Choices::default() };
    let fit = ensemble.fit_with(&Options { choices, ..Options::default() }, &mut Silent).expect("a fit");
    assert!(fit.converged(), "{}", fit.record.reason);
    let ends = fit.inference.intervals.ends.mean[0].expect("an interval").map(|end| end.expect("an end"));
    (fit.log_likelihood(), ends)
}

fn check(what: &str, found: [f64; 2], expected: [f64; 2], part: f64) {
    let width = expected[1] - expected[0];
    found.iter().zip(expected).for_each(|(found, expected)| near::absolute(what, *found, expected, part * width));
}

#[test]
fn limits_of_a_mean_are_its_profile_interval() {
    let ensemble = units(&decaying());
    let (log_likelihood, ends) = profile_of_mean(&ensemble);
    let itself = |_: &Alpha| Some(vec![MeanCombination { weights: DVector::from_element(1, 1.0), constant: 0.0 }]);
    let found = ensemble.mean_limits(&itself, QUANTILE, &mut Silent).expect("a fit");
    assert!(found.converged);
    assert!((found.log_likelihood - log_likelihood).abs() < 1e-6, "{} against {log_likelihood}", found.log_likelihood);
    check("μ", found.limits[0].expect("limits"), ends, 1e-3);
}

/// With α free, of a mean that hangs on it.
#[test]
fn limits_of_a_mean_that_hangs_on_parameters_are_those_of_other_coordinates() {
    let (ensemble, other) = (units(&decaying()), units(&later()));
    let (log_likelihood, ends) = profile_of_mean(&other);
    let after = |alpha: &Alpha| {
        let tau = alpha.value(0, &[]).ok()?;
        let weight = (-AFTER / tau).exp();
        // one and a half times it, and two beside
        Some(vec![
            MeanCombination { weights: DVector::from_element(1, weight), constant: 0.0 },
            MeanCombination { weights: DVector::from_element(1, 1.5 * weight), constant: 2.0 },
            MeanCombination { weights: DVector::zeros(1), constant: 4.0 },
        ])
    };
    let found = ensemble.mean_limits(&after, QUANTILE, &mut Silent).expect("a fit");
    assert!((found.log_likelihood - log_likelihood).abs() < 1e-6, "{} against {log_likelihood}", found.log_likelihood);
    check("μ exp(-t/τ)", found.limits[0].expect("limits"), ends, 1e-3);
    check("2 + 1.5 μ exp(-t/τ)", found.limits[1].expect("limits"), ends.map(|end| 2.0 + 1.5 * end), 1e-3);
    assert_eq!(found.limits[2], Some([4.0; 2]), "nothing moves it");
}

/// With all parameters known.
#[test]
fn limits_at_known_parameters_are_profile_intervals() {
    let mut model = decaying();
    for parameter in &mut model.phases[0].model.parameters {
        parameter.value = kalfit::model::Value::Fixed(if parameter.name == "tau" { 3.0 } else { 0.12 });
    }
    let ensemble = units(&model);
    let (_, ends) = profile_of_mean(&ensemble);
    let twice = |_: &Alpha| Some(vec![MeanCombination { weights: DVector::from_element(1, 2.0), constant: -1.0 }]);
    let found = ensemble.mean_limits(&twice, QUANTILE, &mut Silent).expect("a fit");
    check("2μ - 1", found.limits[0].expect("limits"), ends.map(|end| 2.0 * end - 1.0), 1e-6);
}
