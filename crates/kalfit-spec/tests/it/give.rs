//! Values for free parameters from elsewhere.

use crate::Only as _;
use kalfit::model::{Level, Value};
use kalfit::{Alpha, Label};
use kalfit_spec::Spec;

const MODEL: &str = r#"
[states]
level = {}
[measurements.y]
column = "y"
equation = "level + q"
noise = "s"
[parameters]
s = { per = "lot", upper = 9, fixed = { B = 5 } }
q = {}
"#;

fn spec() -> Spec {
    Spec::parse("m.toml", MODEL).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn levels_get_values_and_the_model_keeps_its_own() {
    let mut spec = spec();
    spec.give("s", &[(None, 1.0), (Some("A"), 2.0), (Some("B"), 3.0)]).expect("sound");
    spec.give("q", &[(None, -4.0)]).expect("sound");
    assert_eq!(spec.model.shared().parameters[1].value, Value::Fixed(-4.0));
    let alpha = Alpha::fixed(&spec.model.shared().parameters).expect("nothing is free");
    let Level::Each { values, other, .. } = &alpha.values[0] else { panic!("`s` has levels: {alpha:?}") };
    let found: Vec<(&str, f64)> =
        values.iter().map(|(label, value)| (spec.model.shared().literals[label.index()].as_str(), *value)).collect();
    assert_eq!((found, other), (vec![("B", 5.0), ("A", 2.0)], &Some(1.0)));
    assert!(!values.contains_key(&Label::MISSING));
}

#[test]
fn values_that_cannot_be_are_refused_and_change_nothing() {
    let mut spec = spec();
    let before = spec.only();
    for (name, values, part) in [
        ("S", vec![(None, 1.0)], "unknown parameter `S`"),
        ("s", vec![(Some("A"), 1.0), (None, 10.0)], "at most 9"),
        ("s", vec![(Some("A"), -1.0)], "-1"),
        ("q", vec![(Some("A"), 1.0)], "has no `per`"),
    ] {
        let error = spec.give(name, &values).expect_err("refused").to_string();
        assert!(error.contains(part), "{error}");
        assert_eq!(spec.only(), before);
    }
}

#[test]
fn a_hundred_thousand_levels_are_no_trouble() {
    let mut spec = spec();
    let levels: Vec<String> = (0..100_000).map(|k| format!("unit {k}")).collect();
    let values: Vec<(Option<&str>, f64)> = levels.iter().map(|level| (Some(level.as_str()), 1.0)).collect();
    spec.give("s", &values).expect("sound");
    assert_eq!(spec.model.shared().parameters[0].fixed_levels.len(), 100_001);
}
