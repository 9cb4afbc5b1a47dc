//! Parameters that act linearly on what is measured: the fit is that of the same model with a state in place of each,
//! and takes a few runs of the filters. Noise far below the size of the data.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use kalfit_fixtures::near;
use serde_json::Value;

use crate::folder::{Folder, shown};
use crate::unidentified::{number, parameter};

/// Most runs of the filters for two coefficients and a noise level: a start, its search, and two-sided differences.
const FEW_RUNS: u64 = 14;

fn wave(j: u32, k: u32) -> f64 {
    (f64::from(j) * 2.7 + f64::from(k) * 11.3 + 0.2).cos()
}

/// Fifteen tests of six rows in five units: y = level + 0.7 x - 0.4 x² + noise.
fn data(noise: f64) -> String {
    let row = |(j, k): (u32, u32)| {
        let x = wave(j, k) + 0.3 * f64::from(k);
        let level = 3.0 + 1.1 * wave(j, 50) + 0.9 * wave(j / 3, 70);
        let y = level + 0.7 * x - 0.4 * x * x + noise * wave(j + 40, k + 1);
        format!("t{j:02},u{},{k},{x:.16e},{y:.16e}\n", j / 3)
    };
    let rows: String = (0..15).flat_map(|j| (0..6).map(move |k| (j, k))).map(row).collect();
    format!("test,unit,t,x,y\n{rows}")
}

fn model(levels: bool, states: &[&str], parameters: &[&str]) -> String {
    let head = if levels { "levels = [\"unit\"]\n" } else { "" };
    let states: String = states.iter().map(|name| format!("{name} = {{ random = false }}\n")).collect();
    let parameters: String = parameters.iter().map(|line| format!("{line}\n")).collect();
    format!(
        "[data]\ntest = \"test\"\n{head}[states]\nlevel = {{}}\n{states}[measurements.y]\ncolumn = \"y\"\n\
         equation = \"level + q * x + k * x^2\"\nnoise = \"s\"\n[parameters]\ns = {{}}\n{parameters}"
    )
}

fn fit(model: &str, data: &str, options: &str) -> Value {
    let folder = Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", data.as_bytes())]);
    let output = folder.run(&format!("fit m.toml d.csv --out fit.json {options}"));
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    serde_json::from_str(&std::fs::read_to_string(folder.path("fit.json")).unwrap()).unwrap()
}

#[test]
fn parameters_in_place_of_states_give_the_same_fit_in_a_few_runs() {
    let data = data(0.3);
    for levels in [false, true] {
        let found = fit(&model(levels, &[], &["q = {}", "k = {}"]), &data, "");
        let states = fit(&model(levels, &["q", "k"], &[]), &data, "");
        near::mixed("ℓ", number(&found["log_likelihood"]), number(&states["log_likelihood"]), 1e-10);
        for field in ["estimate", "std_error"] {
            let s = |fit: &Value| number(&parameter(fit, "s")[field]);
            near::mixed("s", s(&found), s(&states), 1e-5);
            for (at, name) in [(1, "q"), (2, "k")] {
                let state = number(&states["phases"][0]["mean"][field][at]);
                near::mixed(name, number(&parameter(&found, name)[field]), state, 1e-5);
            }
        }
        let runs = found["solver"]["filter_passes"].as_u64().unwrap();
        assert!(runs <= FEW_RUNS, "levels: {levels}, {runs} runs");
        let stages = found["search"]["stages"].as_array().unwrap();
        let counted: u64 = stages.iter().map(|stage| stage["filter_runs"].as_u64().unwrap()).sum();
        assert_eq!(counted, runs, "every run belongs to a stage: {stages:?}");
        assert_eq!(found["search"]["found_by"], "the first start");
    }
}

#[test]
fn a_coefficient_stops_at_its_bound() {
    let data = data(0.3);
    let free = fit(&model(false, &[], &["q = {}", "k = {}"]), &data, "");
    let held = fit(&model(false, &[], &["q = { lower = 1 }", "k = {}"]), &data, "");
    let known = fit(&model(false, &[], &["q = 1", "k = {}"]), &data, "");
    assert!(number(&parameter(&free, "q")["estimate"]) < 1.0, "the bound binds");
    assert_eq!(number(&parameter(&held, "q")["estimate"]), 1.0);
    assert_eq!(parameter(&held, "q")["at_bound"], true);
    near::mixed("ℓ", number(&held["log_likelihood"]), number(&known["log_likelihood"]), 1e-8);
}

/// Fifteen tests of six rows, each of one level near ten.
#[test]
fn noise_of_a_billionth_of_the_data_is_found_without_a_start() {
    let row = |(j, k): (u32, u32)| {
        let y = 10.0 + 1.1 * wave(j, 50) + 1e-9 * wave(j + 40, k + 1);
        format!("t{j:02},{k},{y:.16e}\n")
    };
    let rows: String = (0..15).flat_map(|j| (0..6).map(move |k| (j, k))).map(row).collect();
    let data = format!("test,t,y\n{rows}");
    let model = |s: &str| {
        format!(
            "[data]\ntest = \"test\"\n[states]\nlevel = {{}}\n[measurements.y]\ncolumn = \"y\"\n\
             equation = \"level\"\nnoise = \"s\"\n[parameters]\ns = {s}\n"
        )
    };
    let [found, known] = ["{}", "{ start = 1e-9 }"].map(|s| fit(&model(s), &data, ""));
    let s = |fit: &Value| number(&parameter(fit, "s")["estimate"]);
    assert!((1e-10..1e-8).contains(&s(&known)), "{}", s(&known));
    assert!((s(&found) / s(&known) - 1.0).abs() < 1e-3, "{} against {}", s(&found), s(&known));
    near::mixed("ℓ", number(&found["log_likelihood"]), number(&known["log_likelihood"]), 1e-4);
}

/// Two values of each of twenty units: of the noise and Σ only the sum of the covariances is known.
#[test]
fn noise_that_may_be_a_part_of_the_states_is_not_identified() {
    let row = |j: u32| {
        let (a, b) = (2.0 + 1.2 * wave(j, 3), 1.0 - wave(j, 3) + 0.7 * wave(j, 9));
        format!("t{j:02},a,{a}\nt{j:02},b,{b}\n")
    };
    let data: String = std::iter::once("test,which,y\n".to_owned()).chain((0..20).map(row)).collect();
    let model = "[data]\ntest = \"test\"\n[states]\na = {}\nb = {}\n[measurements.y]\ncolumn = \"y\"\n\
                 equation = \"if(which == 'a', a, 0) + if(which == 'b', b, 0)\"\nnoise = \"s\"\n[parameters]\ns = {}\n";
    let found = fit(model, &data, "");
    assert_eq!(parameter(&found, "s")["standing"], "unidentified", "{}", found["parameters"]);
    assert_eq!(found["phases"][0]["covariance"]["std_error"][0][0], Value::Null);
}

/// Under the restricted likelihood a parameter is no mean; a note says so, and that the state is one.
#[test]
fn the_restricted_likelihood_says_what_it_does_not_allow_for() {
    let data = data(0.3);
    let notes = |fit: &Value| fit["notes"].to_string();
    let found = fit(&model(false, &[], &["q = {}", "k = {}"]), &data, "--criterion reml");
    assert!(
        notes(&found).contains("does not allow for the estimation of `q` and `k`, which act on"),
        "{}",
        found["notes"]
    );
    for (states, parameters, criterion) in [(&["q", "k"][..], &[][..], "reml"), (&[], &["q = {}", "k = {}"], "ml")] {
        let other = fit(&model(false, states, parameters), &data, &format!("--criterion {criterion}"));
        assert!(!notes(&other).contains("does not allow for the estimation"), "{}", other["notes"]);
    }
}
