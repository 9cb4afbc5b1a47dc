//! The built command on public data sets whose maximum-likelihood figures are known from other programs.
//!
//! Each folder of `reference` is a case: tables, one model a fit, and `expected.json`. Each fit is made twice: with the
//! dynamic parameters set to their reference values, so that the mean and the covariance of the initial state are
//! estimated, and with the parameters estimated too.

#![expect(clippy::unwrap_used, reason = "also in what the tests share")]

#[path = "reference/compare.rs"]
mod compare;
#[path = "reference/ratios.rs"]
mod ratios;

use compare::{Comparison, freed, list, text};
use serde_json::Value;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// What solves when the command is not told.
const DEFAULT_SOLVER: &str = "newton";
/// How dynamic parameters are found.
const METHODS: [&str; 3] = ["hybrid", "innovations", "em"];
/// EM stops where its steps are small, which is further from the optimum than where Newton's method stops.
const EM_LIMIT: f64 = 100.0;
/// Passes over the reductions within which every fit ends.
const MOST_PASSES: u64 = 15;

/// A test for each case, and the list of them.
macro_rules! cases {
    ($($test:ident: $case:literal,)*) => {
        const CASES: &[&str] = &[$($case),*];

        $(
            #[test]
            fn $test() {
                holds($case);
            }
        )*
    };
}

cases! {
    alpha_per_group_is_at_its_reference: "alpha-per-group",
    gm_ovary_is_at_its_reference: "gm-ovary",
    inertial_gyro_is_at_its_reference: "inertial-gyro",
    lmm_dyestuff_is_at_its_reference: "lmm-dyestuff",
    lmm_nested_is_at_its_reference: "lmm-nested",
    lmm_sleepstudy_is_at_its_reference: "lmm-sleepstudy",
    meta_bcg_is_at_its_reference: "meta-bcg",
    meta_berkey1998_is_at_its_reference: "meta-berkey1998",
    meta_kalaian1996_is_at_its_reference: "meta-kalaian1996",
    meta_riley2003_is_at_its_reference: "meta-riley2003",
    phases_single_is_at_its_reference: "phases-single",
    phases_two_is_at_its_reference: "phases-two",
    schmidt_single_is_at_its_reference: "schmidt-single",
    ssm_continuous3_is_at_its_reference: "ssm-continuous3",
    ssm_nile_is_at_its_reference: "ssm-nile",
}

/// A test for each case with parameters to estimate.
macro_rules! free_cases {
    ($($test:ident: $case:literal,)*) => {
        $(
            #[test]
            fn $test() {
                finds_the_parameters_of($case);
            }
        )*
    };
}

free_cases! {
    alpha_per_group_is_found_from_its_start_values: "alpha-per-group",
    gm_ovary_is_found_from_its_start_values: "gm-ovary",
    inertial_gyro_is_found_from_its_start_values: "inertial-gyro",
    lmm_dyestuff_is_found_from_its_start_values: "lmm-dyestuff",
    lmm_nested_is_found_from_its_start_values: "lmm-nested",
    lmm_sleepstudy_is_found_from_its_start_values: "lmm-sleepstudy",
    ssm_continuous3_is_found_from_its_start_values: "ssm-continuous3",
    ssm_nile_is_found_from_its_start_values: "ssm-nile",
}

/// Every fit of a case whose parameters are set elsewhere is at its reference when they are estimated too, by each method.
fn finds_the_parameters_of(case: &str) {
    let mut failures = Vec::new();
    for want in list(&expected(case)).iter().filter(|want| !list(&want["set"]).is_empty()) {
        let want = freed(want);
        // EM converges linearly: there it needs several hundred runs of the filters, a minute of them
        let methods = if case == "ssm-continuous3" { &METHODS[..2] } else { &METHODS };
        for method in methods {
            let by: &[&str] = if *method == METHODS[0] { &[] } else { &["--method", method] };
            let lines = match fit_by(case, &want, DEFAULT_SOLVER, by) {
                Ok(found) => Comparison::of(&found, &want).failures(1.0),
                Err(said) => vec![said],
            };
            failures.extend(lines.iter().map(|line| format!("{case}/{} by {method}: {line}", text(&want["fit"]))));
        }
    }
    assert!(failures.is_empty(), "{} failures\n{}", failures.len(), failures.join("\n"));
}

/// Every fit of a case is at its reference, as by default and by EM; all failures are reported together.
fn holds(case: &str) {
    let mut failures = Vec::new();
    for want in list(&expected(case)) {
        for phases in combinations(want) {
            let mut check = |solver: &str, limit: f64| {
                let lines = match fit_by(case, want, solver, &phases) {
                    Ok(found) => Comparison::of(&found, want).failures(limit),
                    Err(said) => vec![said],
                };
                let name = text(&want["fit"]);
                failures.extend(lines.iter().map(|line| format!("{case}/{name} by {solver}{phases:?}: {line}")));
            };
            check(DEFAULT_SOLVER, 1.0);
            // towards a boundary EM creeps, and the default number of iterations ends before the certificate holds
            if list(&want["boundary"]).is_empty() {
                check("em", EM_LIMIT);
            }
        }
    }
    assert!(failures.is_empty(), "{} failures\n{}", failures.len(), failures.join("\n"));
}

#[test]
fn work_of_every_fit_is_as_recorded() {
    let mut table = String::from("case/fit: passes, design_classes, square_root_tests\n");
    let mut excess = Vec::new();
    for case in CASES {
        for want in list(&expected(case)) {
            let name = text(&want["fit"]);
            let found = fit_by(case, want, DEFAULT_SOLVER, &combinations(want)[0])
                .unwrap_or_else(|said| panic!("{case}/{name}: {said}"));
            let passes = found["solver"]["iterations"].as_u64().unwrap();
            let data = &found["data"];
            writeln!(table, "{case}/{name}: {passes}, {}, {}", data["design_classes"], data["square_root_tests"])
                .unwrap();
            if passes > MOST_PASSES {
                excess.push(format!("{case}/{name}: {passes} passes, expected at most {MOST_PASSES}"));
            }
        }
    }
    assert!(excess.is_empty(), "{}", excess.join("\n"));
    let mut settings = insta::Settings::clone_current();
    settings.set_snapshot_path("reference");
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    settings.bind(|| insta::assert_snapshot!("work", table));
}

fn folder(case: &str) -> PathBuf {
    Path::new("tests/reference").join(case)
}

fn expected(case: &str) -> Value {
    let path = folder(case).join("expected.json");
    let content = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_str(&content).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Options under which a fit has the figures of its entry: none but for tests in several phases.
fn combinations(want: &Value) -> Vec<Vec<&str>> {
    match list(&want["combinations"]) {
        [] => vec![vec![]],
        all => all.iter().map(|phases| vec!["--phases", text(phases)]).collect(),
    }
}

/// The fit.json of one certified fit; what went wrong if the fit failed or is not certified.
fn fit_by(case: &str, want: &Value, solver: &str, options: &[&str]) -> Result<Value, String> {
    let home = tempfile::tempdir().unwrap();
    let out = home.path().join("fit.json");
    let mut command = Command::new(env!("CARGO_BIN_EXE_kalfit"));
    command.arg("fit").arg(folder(case).join(text(&want["model"]))).arg(folder(case).join(text(&want["data"])));
    for set in list(&want["set"]) {
        command.arg("--set").arg(text(set));
    }
    if !want["criterion"].is_null() {
        command.arg("--criterion").arg(text(&want["criterion"]));
    }
    command.args(options);
    if solver != DEFAULT_SOLVER {
        command.arg("--solver").arg(solver);
    }
    command.arg("--out").arg(&out);
    let output = command.stdin(Stdio::null()).output().unwrap();
    if output.status.code() != Some(0) {
        let said = String::from_utf8_lossy(&output.stderr);
        let written = std::fs::read_to_string(&out).unwrap_or_default();
        let reason = serde_json::from_str::<Value>(&written).unwrap_or_default()["reason"].clone();
        return Err(format!("found {}, expected exit status 0: {} {reason}", output.status, said.trim()));
    }
    let found: Value = serde_json::from_str(&std::fs::read_to_string(&out).unwrap()).unwrap();
    if found["criterion"] != *want.get("criterion").unwrap_or(&Value::from("ml")) {
        return Err(format!("found criterion {}", found["criterion"]));
    }
    if found["converged"] != true || found["solver"]["solver"] != solver {
        let solver = &found["solver"]["solver"];
        return Err(format!("found converged {} by {solver}: {}", found["converged"], found["reason"]));
    }
    Ok(found)
}
