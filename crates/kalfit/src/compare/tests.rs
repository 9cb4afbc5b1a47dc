//! Records written by hand: which fits are nested, and what is reported of them.

use serde_json::{Value, json};

use crate::compare::{CompareError, ComparedRecord, PValueKind, compare};
use kalfit_fixtures::near;
use kalfit_record::FitRecord;

/// Two states, full Σ and a noise level; `fixed` lists what is not free: `mean`, `variance`, `covariance`, `sigma`.
fn record(log_likelihood: f64, fixed: &[&str]) -> Value {
    let is = |what: &str| fixed.contains(&what);
    let free = 6
        - usize::from(is("mean"))
        - 2 * usize::from(is("variance"))
        - usize::from(is("sigma"))
        - usize::from(is("covariance") && !is("variance"));
    let off = is("covariance") || is("variance");
    let slope = if is("variance") { 0.0 } else { 2.0 };
    let cross = if off { 0.0 } else { 0.5 };
    let kind = if is("covariance") { "diagonal" } else { "full" };
    let sigma = if is("sigma") { "fixed at 0, not negative" } else { "free, not negative" };
    let vector = json!({ "estimate": [1.0, slope], "std_error": [null, null] });
    let none = json!([[null, null], [null, null]]);
    let test = |id: &str, density: f64| {
        json!({ "id": id, "log_likelihood": -1.0, "observations": 5, "phases": [], "distance": null,
            "degrees_of_freedom": 2, "p_value": null,
            "deletion": { "log_density": density, "distance": null, "p_value": null, "displacement": 0.0, "phases": [] } })
    };
    json!({
        "schema": "kalfit-fit/1", "kalfit_version": "0", "title": "a fit", "model_digest": null,
        "model": ["tests: one for each value of column `unit`", "steps: one for each row; x_0 is at the first row",
            "state `a`: constant; start estimated", "state `b`: constant; start estimated",
            "measurement `y`: column `y` reads a + b * t; noise of standard deviation sigma",
            format!("parameter `sigma`: {sigma}"), "order of μ and Σ: a, b", format!("covariance Σ: {kind}")],
        "data": { "tests": 2, "steps": 10, "observations": 10, "design_classes": 1 },
        "criterion": "ml", "log_likelihood_kind": "measurements", "log_likelihood": log_likelihood,
        "free_parameters": free, "aic": 2.0 * free as f64 - 2.0 * log_likelihood,
        "bic": 10_f64.ln() * free as f64 - 2.0 * log_likelihood, "converged": true, "reason": "certified",
        "certificate": { "mean": 0.0, "covariance": 0.0, "null_space": 0.0, "parameters": 0.0 },
        "solver": { "method": "hybrid", "solver": "newton", "phases": "chain", "iterations": 1, "filter_passes": 1,
            "trace": [], "seconds": 0.0 },
        "phases": [{ "name": "main", "states": ["a", "b"],
            "mean": { "estimate": [1.0, if is("mean") { 0.0 } else { 0.3 }], "std_error": [null, null],
                "fixed": [false, is("mean")], "scale": null, "regression": [] },
            "covariance": { "estimate": [[1.0, cross], [cross, slope]], "std_error": none, "scale": null,
                "fixed": [[false, off], [off, is("variance")]] },
            "std_dev": vector, "correlation": { "estimate": none, "std_error": none },
            "boundary": [], "unidentified": [] }],
        "parameters": [{ "name": "sigma", "per": null, "level": null, "estimate": if is("sigma") { 0.0 } else { 0.4 },
            "std_error": null, "interval95": [null, null], "fixed": is("sigma"), "at_bound": false }],
        "constraints": [], "tests": [test("u1", log_likelihood / 2.0 - 1.0), test("u2", log_likelihood / 2.0 - 2.0)]
    })
}

fn read(value: Value) -> FitRecord {
    serde_json::from_value(value).expect("a record")
}

fn compared(fits: Vec<Value>) -> Result<ComparedRecord, CompareError> {
    let name = |k: usize| format!("{k}.json");
    let fits: Vec<_> = fits.into_iter().enumerate().map(|(k, fit)| (name(k), read(fit))).collect();
    compare(&fits)
}

#[test]
fn a_fixed_mean_lies_within_a_free_one() {
    let all = compared(vec![record(-22.0, &["mean"]), record(-20.0, &[])]).expect("the same data");
    assert!(all.comparable && all.notes.is_empty(), "{:?}", all.notes);
    let [test] = &all.nested[..] else { panic!("one test: {:?}", all.nested) };
    assert_eq!((test.null, test.alternative, test.df, test.p_value_kind), (0, 1, 1, PValueKind::LargeSample));
    near::mixed("lr", test.lr, 4.0, 1e-12);
    // the tail of χ² with one degree of freedom beyond 4
    assert!((test.p_value.expect("a law") - 0.045_500_263_896_358_4).abs() < 1e-12, "{:?}", test.p_value);
    // AIC 54 against 52: weights 1 : e
    near::mixed("ΔAIC", all.fits[0].delta_aic.expect("certified"), 2.0, 1e-12);
    near::mixed("weight", all.fits[1].akaike_weight.expect("certified"), 1.0 / (1.0 + (-1.0_f64).exp()), 1e-12);
    assert_eq!(all.differences.len(), 1, "{:?}", all.differences);
    assert_eq!(all.differences[0].element, "mean[b]");
    near::mixed("predictive", all.fits[1].log_predictive_density.expect("all have one"), -23.0, 1e-12);
    let difference = all.fits[0].predictive_difference.expect("all have one");
    near::mixed("its difference", difference.difference, 2.0, 1e-12);
    near::mixed("which is the same for both tests", difference.std_error.expect("two tests"), 0.0, 1e-12);
}

#[test]
fn predictions_at_other_free_parameters_are_not_ranked() {
    let all = compared(vec![record(-21.0, &["sigma"]), record(-20.0, &[])]).expect("the same data");
    assert_eq!([&all.fits[0], &all.fits[1]].map(|fit| fit.parameters_held), [false, true]);
    assert!(all.fits.iter().all(|fit| fit.log_predictive_density.is_some() && fit.predictive_difference.is_none()));
}

#[test]
fn a_variance_at_zero_has_an_upper_bound_of_the_p_value() {
    let all = compared(vec![record(-20.0, &[]), record(-23.0, &["variance"])]).expect("the same data");
    let [test] = &all.nested[..] else { panic!("one test: {:?}", all.nested) };
    assert_eq!((test.null, test.alternative, test.df, test.p_value_kind), (1, 0, 2, PValueKind::UpperBound));
    // the tail of χ² with two degrees of freedom is exp(-x/2)
    near::mixed("p", test.p_value.expect("a bound"), (-3.0_f64).exp(), 1e-12);
    assert!(test.reason.as_deref().is_some_and(|reason| reason.contains("covariance[b, b]")), "{:?}", test.reason);
}

#[test]
fn a_noise_level_at_zero_is_at_the_end_of_its_range() {
    let all = compared(vec![record(-21.0, &["sigma"]), record(-20.0, &[])]).expect("the same data");
    assert_eq!(all.nested[0].p_value_kind, PValueKind::UpperBound, "{:?}", all.nested);
}

#[test]
fn of_fits_that_are_not_nested_nothing_is_said() {
    let all = compared(vec![record(-21.0, &["mean"]), record(-20.0, &["variance"])]).expect("the same data");
    assert!(all.nested.is_empty() && all.notes.is_empty(), "{:?}", all.nested);
    // other equations with the same elements
    let mut other = record(-22.0, &["mean"]);
    other["model"][4] = json!("measurement `y`: column `y` reads a + b * t^2; noise of standard deviation sigma");
    let all = compared(vec![other, record(-20.0, &[])]).expect("the same data");
    assert!(all.nested.is_empty(), "{:?}", all.nested);
    assert_eq!(all.lines.len(), 2, "{:?}", all.lines);
    // two elements that are one free quantity
    let mut tied = record(-22.0, &["mean"]);
    tied["free_parameters"] = json!(4);
    assert!(compared(vec![tied, record(-20.0, &[])]).expect("the same data").nested.is_empty());
}

#[test]
fn what_is_not_certified_has_no_p_value() {
    let mut null = record(-22.0, &["mean"]);
    null["converged"] = json!(false);
    let all = compared(vec![null, record(-20.0, &[])]).expect("the same data");
    assert_eq!((all.nested[0].p_value, all.nested[0].p_value_kind), (None, PValueKind::None));
    assert!(all.notes[0].contains("`0.json` is not certified"), "{:?}", all.notes);
    assert_eq!(all.fits[0].akaike_weight, None);
    near::mixed("the other has all the weight", all.fits[1].akaike_weight.expect("certified"), 1.0, 1e-12);
}

#[test]
fn a_larger_fit_below_its_part_gives_no_test() {
    let all = compared(vec![record(-19.0, &["mean"]), record(-20.0, &[])]).expect("the same data");
    assert!(all.nested.is_empty() && all.notes[0].contains("has the higher log-likelihood"), "{:?}", all.notes);
}

#[test]
fn other_data_are_refused_and_other_criteria_not_compared() {
    let mut other = record(-22.0, &["mean"]);
    other["tests"][1]["id"] = json!("u9");
    let error = compared(vec![record(-20.0, &[]), other]).expect_err("other tests");
    assert_eq!(
        error.to_string(),
        "`0.json` and `1.json` are not fits of the same data: test `u2` is in the first only"
    );
    let mut more = record(-22.0, &["mean"]);
    more["data"]["observations"] = json!(11);
    let error = compared(vec![record(-20.0, &[]), more]).expect_err("other values");
    assert!(error.to_string().ends_with("10 measured values against 11"), "{error}");
    assert!(matches!(compared(vec![record(-20.0, &[])]), Err(CompareError::TooFew { found: 1 })));
    let mut restricted = record(-22.0, &["mean"]);
    restricted["criterion"] = json!("reml");
    let all = compared(vec![record(-20.0, &[]), restricted.clone()]).expect("the same data");
    assert!(!all.comparable && all.nested.is_empty() && all.fits[0].delta_aic.is_none());
    let mut whole = record(-20.0, &[]);
    whole["criterion"] = json!("reml");
    let all = compared(vec![whole.clone(), restricted]).expect("the same data");
    assert!(!all.comparable && all.notes[0].contains("differ in structure"), "{:?}", all.notes);
    let mut variance = record(-23.0, &["variance"]);
    variance["criterion"] = json!("reml");
    assert!(compared(vec![whole, variance]).expect("the same data").comparable);
}

#[test]
fn one_value_for_all_levels_lies_within_one_for_each() {
    let mut each = record(-18.0, &[]);
    let mut second = each["parameters"][0].clone();
    (second["per"], second["level"]) = (json!("lot"), json!("B"));
    (each["parameters"][0]["per"], each["parameters"][0]["level"]) = (json!("lot"), json!("A"));
    each["parameters"].as_array_mut().expect("a list").push(second);
    each["free_parameters"] = json!(7);
    let all = compared(vec![each, record(-20.0, &[])]).expect("the same data");
    let [test] = &all.nested[..] else { panic!("one test: {:?}", all.nested) };
    assert_eq!((test.null, test.df, test.p_value_kind), (1, 1, PValueKind::LargeSample));
}
