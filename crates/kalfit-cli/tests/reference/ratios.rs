//! `kalfit test` against likelihood ratios of the references.
//!
//! Only cases without dynamic parameters: where a noise level is free, the two fits of the reference have different
//! ones, and a test that holds it at one value is another test.

use super::compare::{list, text};
use super::{fit_by, folder};
use serde_json::Value;
use std::process::{Command, Stdio};

/// The references have 10 digits of the ratios and 8 of the probabilities.
const RATIO: f64 = 1e-6;
const PROBABILITY_REL: f64 = 1e-6;

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("a number expected, found {value}"))
}

/// What is not as in the reference.
fn differences(found: &Value, want: &Value) -> Vec<String> {
    let mut all = Vec::new();
    let mut figure = |what: &str, tolerance: &dyn Fn(f64) -> f64| {
        let (found, expected) = (&found[what], &want[what]);
        let off = match (found.as_f64(), expected.as_f64()) {
            (Some(x), Some(y)) => (x - y).abs() > tolerance(y),
            _ => found != expected,
        };
        if off {
            all.push(format!("{what}: found {found}, expected {expected}"));
        }
    };
    figure("lr", &|expected| RATIO * expected.abs().max(1.0));
    figure("p_chi2_df", &|expected| PROBABILITY_REL * expected);
    figure("p_mixture", &|expected| PROBABILITY_REL * expected);
    figure("df", &|_| 0.0);
    figure("mixture", &|_| 0.0);
    if found["converged"] != true {
        all.push("not certified".to_owned());
    }
    all
}

/// The test.json of one test; what went wrong if it failed.
fn test(case: &str, want: &Value) -> Result<Value, String> {
    let home = tempfile::tempdir().unwrap();
    let (null, out) = (home.path().join("null.toml"), home.path().join("test.json"));
    std::fs::write(&null, text(&want["hypothesis"])).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_kalfit"));
    command.arg("test").arg(folder(case).join(text(&want["alternative"]))).arg(folder(case).join(text(&want["data"])));
    command.arg("--null").arg(&null).arg("--out").arg(&out);
    let output = command.stdin(Stdio::null()).output().unwrap();
    if output.status.code() != Some(0) {
        let said = String::from_utf8_lossy(&output.stderr);
        return Err(format!("found {}, expected exit status 0: {}", output.status, said.trim()));
    }
    Ok(serde_json::from_str(&std::fs::read_to_string(&out).unwrap()).unwrap())
}

fn wanted(case: &str) -> Value {
    let path = folder(case).join("lr_tests.json");
    let content = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_str(&content).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn hold(case: &str, tests: usize) {
    let wanted = wanted(case);
    assert_eq!(list(&wanted).len(), tests, "tests of {case}");
    let mut failures = Vec::new();
    for want in list(&wanted) {
        let lines = test(case, want).map_or_else(|said| vec![said], |found| differences(&found, want));
        failures.extend(lines.iter().map(|line| format!("{case}, {}: {line}", text(&want["what"]))));
    }
    assert!(failures.is_empty(), "{} failures\n{}", failures.len(), failures.join("\n"));
}

#[test]
fn tests_of_meta_bcg_are_at_their_reference() {
    hold("meta-bcg", 3);
}

#[test]
fn tests_of_meta_berkey1998_are_at_their_reference() {
    hold("meta-berkey1998", 7);
}

#[test]
fn tests_of_meta_kalaian1996_are_at_their_reference() {
    hold("meta-kalaian1996", 1);
}

#[test]
fn tests_of_meta_riley2003_are_at_their_reference() {
    hold("meta-riley2003", 5);
}

/// The hypothesis in the model is the model that the reference fits as the null.
#[test]
fn both_sides_of_a_test_are_fits_of_two_models() {
    let mut failures = Vec::new();
    for case in ["meta-bcg", "meta-berkey1998", "meta-kalaian1996", "meta-riley2003"] {
        for want in list(&wanted(case)) {
            let found = test(case, want).unwrap_or_else(|said| panic!("{case}: {said}"));
            let model = format!("{}.toml", text(&want["null"]));
            for (side, model) in [("null", model.as_str()), ("alternative", text(&want["alternative"]))] {
                let alone = serde_json::json!({"model": model, "data": want["data"], "set": []});
                let alone =
                    fit_by(case, &alone, super::DEFAULT_SOLVER, &[]).unwrap_or_else(|said| panic!("{case}: {said}"));
                let (x, y) = (number(&found[side]["log_likelihood"]), number(&alone["log_likelihood"]));
                if (x - y).abs() > 1e-8 * y.abs().max(1.0) {
                    failures.push(format!("{case}/{model} as {side}: found ℓ {x}, expected {y}"));
                }
                let (n, m) = (&found[side]["free_parameters"], &alone["free_parameters"]);
                if n != m {
                    failures.push(format!("{case}/{model} as {side}: found {n} free, expected {m}"));
                }
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
