//! What is known of units that were in a fit, and of new ones: `kalfit predict` and `kalfit apply` of models with levels.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use kalfit_fixtures::near;
use serde_json::{Value, json};

use crate::folder::{Folder, number, shown};

/// Both states vary from unit to unit, the first also from test to test.
pub(crate) const SOME_STATES: &str = r#"[data]
test = "test"
levels = ["unit"]
[states]
a = {}
b = {}
[measurements.y]
column = "y"
equation = "a + b * x"
noise = 0.3
[covariance]
states = ["a"]
"#;
/// One state, known noise.
const ONE_STATE: &str = r#"[data]
test = "test"
levels = ["unit"]
[states.a]
[measurements.y]
column = "y"
equation = "a"
noise = 0.3
"#;

/// Numbers that look random.
fn wave(j: u32, k: u32) -> f64 {
    (f64::from(j) * 2.7 + f64::from(k) * 11.3 + 0.2).cos()
}

/// Eight units of three tests of three rows; `spread`: size of what units have in common.
pub(crate) fn rows(spread: f64) -> String {
    let mut text = "unit,test,x,y\n".to_owned();
    for (u, t, x) in (0..8).flat_map(|u| (0..9).map(move |k| (u, k / 3, k % 3))) {
        let (a, b) = (2.0 + spread * wave(u, 1) + 0.6 * wave(u, 10 + t), 1.5 + spread * wave(u, 2));
        text += &format!("u{u},r{t},{x},{}\n", a + b * f64::from(x) + 0.3 * wave(9 * u + 3 * t + x, 4));
    }
    text
}

/// A folder with the fit of a model.
fn fitted(model: &str, data: &str) -> (Folder, Value) {
    let folder = Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", data.as_bytes())]);
    let output = folder.run("fit m.toml d.csv --out fit.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let record = serde_json::from_slice(&std::fs::read(folder.path("fit.json")).unwrap()).unwrap();
    (folder, record)
}

/// Σ of a level, the outermost first.
fn variance(record: &Value, level: usize, state: usize) -> f64 {
    record["levels"][level]["covariance"]["estimate"][state][state].as_f64().unwrap()
}

#[test]
fn a_new_unit_varies_by_all_levels_also_in_states_that_do_not_vary_from_test_to_test() {
    let (folder, record) = fitted(SOME_STATES, &rows(1.0));
    folder.write("design.csv", b"test,x\nn,0\n");
    let output = folder.run("predict m.toml --from fit.json --design design.csv --out p.csv --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    for (state, row) in folder.table("p.csv").iter().enumerate() {
        let mean = record["phases"][0]["mean"]["estimate"][state].as_f64().unwrap();
        near::mixed("mean", number(row, "mean"), mean, 1e-12);
        let expected = (variance(&record, 0, state) + variance(&record, 1, state)).sqrt();
        near::mixed("spread", number(row, "std_dev_population"), expected, 1e-12);
    }
}

/// Units of n = 3 tests with variances τ between units and w within: k = τ / (τ + v), v = (w + s²/3) / n, and m = μ +
/// k (ȳ - μ), so that dm/dτ = (1 - k)(m - μ)/τ and dm/dw = -(m - μ) / (n (τ + v)).
#[test]
fn the_mean_of_a_known_unit_follows_the_estimated_variances() {
    let (folder, record) = fitted(ONE_STATE, &rows(1.0));
    let (between, within) = (variance(&record, 0, 0), variance(&record, 1, 0));
    let mean = record["phases"][0]["mean"]["estimate"][0].as_f64().unwrap();
    let v = (within + 0.09 / 3.0) / 3.0;
    let names: Vec<&str> =
        record["estimates"]["names"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
    assert_eq!(names.len(), 3, "{names:?}");
    folder.write("design.csv", b"unit,test\nu0,n\nu1,n\nu2,n\n");
    let output = folder.run("predict m.toml --from fit.json --design design.csv --units known --out p.csv");
    assert!(shown(&output).contains("together with those of the population's mean"), "{}", shown(&output));
    for (unit, row) in record["groups"].as_array().unwrap().iter().zip(folder.table("p.csv")) {
        let above = unit["mean"][0].as_f64().unwrap() - mean;
        let mut slopes = Vec::new();
        for (c, name) in names.iter().enumerate() {
            let expected = match *name {
                "mean[a]" => 0.0,
                "unit: covariance[a, a]" => v / (between + v) * above / between,
                "covariance[a, a]" => -above / (3.0 * (between + v)),
                other => panic!("{other} of {names:?}"),
            };
            near::mixed(name, unit["by_estimates"][0][c].as_f64().unwrap(), expected, 1e-6);
            slopes.push(if *name == "mean[a]" { v / (between + v) } else { expected });
        }
        let covariance = |i: usize, k: usize| record["estimates"]["covariance"][i][k].as_f64().unwrap();
        let by_estimates: f64 = (0..9).map(|at| slopes[at / 3] * slopes[at % 3] * covariance(at / 3, at % 3)).sum();
        let expected = (between * v / (between + v) + by_estimates).sqrt();
        near::mixed("error", number(&row, "std_dev_estimation"), expected, 1e-6);
    }
}

#[test]
fn of_units_that_seem_to_be_equal_no_limits_are_known() {
    let (folder, record) = fitted(ONE_STATE, &rows(0.01));
    assert_eq!(variance(&record, 0, 0), 0.0, "the data are to give no variance between units");
    folder.write("design.csv", b"unit,test\nu0,n\n");
    let output = folder.run("predict m.toml --from fit.json --design design.csv --units known --out p.csv --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let row = &folder.table("p.csv")[0];
    assert_eq!((row["confidence_lower"].as_str(), row["tolerance_upper"].as_str()), ("", ""), "{row:?}");
}

/// As a fit writes it where `a` and `c` vary together, `b` does not vary, and the covariance of `a` and `b` is fixed.
#[test]
fn a_variance_of_the_size_of_rounding_is_a_variance_of_zero() {
    let model = SOME_STATES.replace("[covariance]\nstates = [\"a\"]\n", "").replace("b = {}", "b = {}\nc = {}");
    let model = model.replace("b * x", "b * x + c * x * x");
    let (folder, mut record) = fitted(&model, &rows(1.0));
    let mut write = |matrix: Value| {
        record["levels"][0]["covariance"]["estimate"] = matrix;
        folder.write("edited.json", record.to_string().as_bytes());
        shown(&folder.run("simulate m.toml --from edited.json --design d.csv --seed 1 --out drawn.csv --quiet"))
    };
    let rounded = json!([[4.2, 0.0, -4.8], [0.0, 1.7e-34, -3.0e-17], [-4.8, -3.0e-17, 4.8 * 4.8 / 4.2]]);
    assert!(write(rounded).starts_with("exit 0"));
    let wrong = write(json!([[4.2, 0.0, -4.8], [0.0, 1.7e-6, -3.0e-3], [-4.8, -3.0e-3, 4.8 * 4.8 / 4.2]]));
    assert!(wrong.contains("not positive semidefinite"), "{wrong}");
}
