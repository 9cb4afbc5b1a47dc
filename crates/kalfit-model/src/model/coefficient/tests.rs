use super::*;
use crate::build::{Formula, StateBuilder, constant, fixed, free, gauss_markov, measurement, moving, name, when};
use crate::model::{Alpha, Level, Scope};

/// A model of one constant state `a` and further states, in which `y` is measured as a + formula.
fn model(formula: Formula, states: Vec<StateBuilder>, parameters: &[&str]) -> PhasedModel {
    let builder = Model::builder("").time("t").state(constant("a"));
    let builder = states.into_iter().fold(builder, |builder, state| builder.state(state));
    let builder =
        builder.measurement(measurement("y", name("a") + formula, name("known"))).parameter(fixed("known", 2.0));
    parameters.iter().fold(builder, |builder, name| builder.parameter(free(*name))).build().expect("a model")
}

/// Names of the coefficients.
fn found(model: &PhasedModel) -> Vec<String> {
    let found = model.with_coefficients_as_states().map_or_else(Vec::new, |found| found.parameters);
    found.iter().map(|&parameter| model.shared().parameters[parameter].name.clone()).collect()
}

fn n(text: &str) -> Formula {
    name(text)
}

#[test]
fn what_multiplies_known_numbers_is_a_coefficient() {
    for (formula, parameters, coefficients) in [
        (n("q") * n("x"), vec!["q"], vec!["q"]),
        (3.0 - (n("q") - n("x")) * n("known") / n("z"), vec!["q"], vec!["q"]),
        (n("q") * n("x") + n("k") * n("x").power(2.0), vec!["q", "k"], vec!["q", "k"]),
        (when(n("x").equals(1.0), n("q"), n("k") * n("x")), vec!["q", "k"], vec!["q", "k"]),
        (n("q") * n("q") * n("x"), vec!["q"], vec![]),
        (n("q") * n("k") * n("x"), vec!["q", "k"], vec![]),
        (n("x") / n("q"), vec!["q"], vec![]),
        ((n("q") * n("x")).exp(), vec!["q"], vec![]),
        (n("known") * n("x"), vec![], vec![]),
        // a free loading of a state is no coefficient of what is known
        (n("q") * n("a"), vec!["q"], vec![]),
    ] {
        assert_eq!(found(&model(formula.clone(), Vec::new(), &parameters)), coefficients, "{formula:?}");
    }
}

#[test]
fn inputs_of_states_have_coefficients_unless_they_move_a_stationary_mean() {
    let rolling = || moving("w", -n("w") / 7.0 + n("q") * n("u"), 0.0);
    let noise = || gauss_markov("n", "tau", "size");
    assert_eq!(found(&model(n("w"), vec![rolling()], &["q"])), ["q"]);
    assert!(found(&model(n("w"), vec![rolling(), noise()], &["q", "tau", "size"])).is_empty());
    assert_eq!(found(&model(n("q") * n("x"), vec![noise()], &["q", "tau", "size"])), ["q"]);
}

#[test]
fn a_measurement_is_the_same_with_the_coefficient_as_a_state() {
    let formula = 3.0 - (n("q") - n("x")) * n("known") / n("z") + n("k");
    let before = model(formula, Vec::new(), &["q", "k"]);
    let found = before.with_coefficients_as_states().expect("two coefficients");
    let (before, after) = (&before.phases[0].model, &found.model.phases[0].model);
    let numbers: Vec<f64> = before.columns.iter().enumerate().map(|(k, _)| 1.5 + k as f64).collect();
    let values = [2.0, -0.7, 0.3];
    let alpha = Alpha { values: values.map(Level::Common).to_vec() };
    let scope = Scope { numbers: &numbers, texts: &[], step: 0.0, alpha: &alpha };
    let value = |expression: &Expression| expression.evaluate(&scope).expect("a value");
    let (plain, form) = (&before.measurements[0].equation, &after.measurements[0].equation);
    let states: f64 = form.terms[plain.terms.len()..]
        .iter()
        .zip(&found.parameters)
        .map(|((_, coefficient), &parameter)| value(coefficient) * values[parameter])
        .sum();
    assert!((value(&plain.constant) - value(&form.constant) - states).abs() < 1e-14);
    assert!(form.expressions().all(|part| found.parameters.iter().all(|&parameter| !part.mentions(parameter))));
    assert_eq!(after.estimated, [0, 1, 2]);
    assert_eq!(
        after.covariance.fixed.iter().map(|one| (one.i, one.j, one.value)).collect::<Vec<_>>(),
        [(1, 1, 0.0), (2, 2, 0.0)]
    );
}
