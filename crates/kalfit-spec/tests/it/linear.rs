//! Equations as linear forms have the value that direct evaluation has.

use kalfit::model::{Alpha, Level, Linear, Model, Scope};
use kalfit_spec::Spec;
use proptest::prelude::*;

/// A random expression, linear in the states a, b, c by construction, and its value.
#[derive(Debug, Clone)]
struct Case {
    text: String,
    value: f64,
    /// Sum of the sizes of all parts: the scale that rounding is measured by.
    scale: f64,
}

/// Values of states, columns and parameters at which expressions are compared.
const NAMES: [(&str, f64); 7] =
    [("a", 1.5), ("b", -0.75), ("c", 3.25), ("u", 0.3), ("v", -2.0), ("p", 1.25), ("q", 0.5)];
const STEP: f64 = 0.125;

fn case(text: String, value: f64, scale: f64) -> Case {
    Case { text, value, scale }
}

fn leaf(names: &'static [(&'static str, f64)]) -> impl Strategy<Value = Case> {
    prop_oneof![
        (0..names.len()).prop_map(move |i| case(names[i].0.to_owned(), names[i].1, names[i].1.abs())),
        (1_u8..9).prop_map(|n| case(n.to_string(), f64::from(n), f64::from(n))),
    ]
}

/// Expressions without states, between about -1e3 and 1e3.
fn coefficient() -> impl Strategy<Value = Case> {
    let leaves = prop_oneof![leaf(&NAMES[3..]), Just(case("dt".to_owned(), STEP, STEP))];
    leaves.prop_recursive(3, 12, 2, |inner| {
        prop_oneof![
            (inner.clone(), inner.clone()).prop_map(|(a, b)| case(
                format!("({} + {})", a.text, b.text),
                a.value + b.value,
                a.scale + b.scale
            )),
            (inner.clone(), inner.clone()).prop_map(|(a, b)| case(
                format!("{} * ({})", a.text, b.text),
                a.value * b.value,
                a.scale * b.scale
            )),
            inner.clone().prop_map(|a| case(format!("sin({})", a.text), a.value.sin(), 1.0 + a.scale)),
            inner.clone().prop_map(|a| case(format!("-({})^2", a.text), -a.value.powi(2), a.scale.powi(2))),
            (inner.clone(), inner.clone()).prop_map(|(a, b)| case(
                format!("if({} < {}, 2, {})", a.text, b.text, a.text),
                if a.value < b.value { 2.0 } else { a.value },
                2.0 + a.scale,
            )),
            inner.prop_map(|a| case(format!("abs({}) / 3", a.text), a.value.abs() / 3.0, a.scale)),
        ]
    })
}

/// Expressions linear in the states.
fn linear() -> impl Strategy<Value = Case> {
    let leaves = prop_oneof![leaf(&NAMES[..3]), coefficient()];
    leaves.prop_recursive(5, 24, 2, |inner| {
        prop_oneof![
            (inner.clone(), inner.clone()).prop_map(|(a, b)| case(
                format!("{} + {}", a.text, b.text),
                a.value + b.value,
                a.scale + b.scale
            )),
            (inner.clone(), inner.clone()).prop_map(|(a, b)| case(
                format!("{} - ({})", a.text, b.text),
                a.value - b.value,
                a.scale + b.scale
            )),
            (coefficient(), inner.clone()).prop_map(|(a, b)| case(
                format!("({}) * ({})", a.text, b.text),
                a.value * b.value,
                a.scale * b.scale
            )),
            (inner.clone(), coefficient()).prop_map(|(a, b)| case(
                format!("({}) * ({})", a.text, b.text),
                a.value * b.value,
                a.scale * b.scale
            )),
            inner.clone().prop_map(|a| case(format!("({}) / (1 + q)", a.text), a.value / 1.5, a.scale)),
            inner.clone().prop_map(|a| case(format!("-({})", a.text), -a.value, a.scale)),
            (coefficient(), inner.clone(), inner).prop_map(|(c, a, b)| case(
                format!("if({} > 0.5 or not dt > 0, {}, {})", c.text, a.text, b.text),
                if c.value > 0.5 { a.value } else { b.value },
                a.scale + b.scale,
            )),
        ]
    })
}

fn read(equation: &str) -> Spec {
    let text = format!(
        "[data]\ntime = 't'\n[states]\na = {{}}\nb = {{}}\nc = {{}}\n[measurements.y]\ncolumn = 'y'\nnoise = 1\n\
         equation = '{equation}'\n[measurements.z]\ncolumn = 'z'\nequation = 'p * a + q * b'\nnoise = 1\n\
         [parameters]\np = 1.25\nq = 0.5\n"
    );
    Spec::parse("model.toml", &text).unwrap_or_else(|error| panic!("{error} in {equation}"))
}

fn value(model: &Model, form: &Linear) -> f64 {
    let named = |name: &str| NAMES.iter().find(|(n, _)| *n == name).map_or(f64::NAN, |(_, value)| *value);
    let numbers: Vec<f64> = model.columns.iter().map(|column| named(&column.name)).collect();
    let alpha = Alpha { values: model.parameters.iter().map(|p| Level::Common(named(&p.name))).collect() };
    let scope = Scope { numbers: &numbers, texts: &[], step: STEP, alpha: &alpha };
    let terms = form
        .terms
        .iter()
        .map(|(state, a)| a.evaluate(&scope).expect("the parts are finite") * named(&model.states[*state].name));
    terms.sum::<f64>() + form.constant.evaluate(&scope).expect("the parts are finite")
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, ..ProptestConfig::default() })]

    #[test]
    fn a_linear_form_has_the_value_of_its_expression(case in linear()) {
        prop_assume!(case.scale < 1e9 && case.text.len() < 2_000);
        let spec = read(&case.text);
        let form = &spec.model.shared().measurements[0].equation;
        prop_assert!(form.terms.is_sorted_by(|a, b| a.0 < b.0), "states ascend: {form:?}");
        let found = value(spec.model.shared(), form);
        // Expansion changes the order of operations: a few roundings of the largest part.
        let tolerance = 1e-13 * (1.0 + case.scale);
        prop_assert!(
            (found - case.value).abs() <= tolerance,
            "{}: {found}, directly {}, tolerance {tolerance}", case.text, case.value
        );
    }
}
