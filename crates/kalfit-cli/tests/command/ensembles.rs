//! Ensembles of tests in phases: what is drawn can be fitted and planned for.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use insta::assert_snapshot;
use kalfit::FitRecord;
use kalfit::record::PlanRecord;
use serde_json::Value;

use crate::folder::{Folder, shown};

const PHASES: &str = r#"title = "Inertial platform: ground alignment, then flight"

[data]
test = "test"
time = "t"
phase = "phase"

[phases.align.states]
velocity_error = { derivative = "0.00980665 * tilt", noise_density = "vrw", unit = "m/s" }
tilt = { derivative = "bias / 60", noise_density = "arw", unit = "mrad" }
bias = { unit = "mrad/min" }

[phases.align.measurements.stationary]
column = "vel"
equation = "velocity_error"
noise = "sigma_vel"

[phases.flight.states]
velocity_error = { derivative = "0.00980665 * tilt", noise_density = "vrw", unit = "m/s" }
tilt = { derivative = "bias / 60", noise_density = "arw", unit = "mrad" }
bias = { unit = "mrad/min" }

[phases.flight.carry]
velocity_error = "velocity_error"
tilt = "tilt"
bias = "bias"

[phases.flight.measurements.doppler]
column = "doppler"
equation = "velocity_error"
noise = "sigma_doppler"

[phases.flight.measurements.star]
column = "star"
equation = "tilt"
noise = "sigma_star"

[parameters]
vrw = 0.01
arw = 0.02
sigma_vel = 0.05
sigma_doppler = 0.2
sigma_star = 0.3
"#;

const ALIGN: &str = r#"
[phases.align.mean]
start = { velocity_error = 0.1, tilt = 2, bias = -0.5 }
[phases.align.covariance]
start = [[0.25, 0, 0], [0, 4, 0.5], [0, 0.5, 0.25]]
"#;

const FLIGHT: &str = r#"
[phases.flight.mean]
start = { velocity_error = -0.3, tilt = 1, bias = 0.2 }
[phases.flight.covariance]
start = [[0.09, 0.1, 0], [0.1, 1, 0], [0, 0, 0.04]]
"#;

/// Rows of both phases mixed, two of three tests with flight.
fn design() -> String {
    let mut text = "phase,test,t,vel,doppler,star\n".to_owned();
    for j in 0..6 {
        let flies = j % 3 != 2;
        for k in 0..24 {
            let t = 6.0 * f64::from(k) + f64::from(j);
            let vel = if (j + k) % 5 == 0 { "" } else { "1" };
            text.push_str(&format!("align,u{j},{t},{vel},,\n"));
            if flies {
                let star = if k % 2 == 0 { "1" } else { "" };
                text.push_str(&format!("flight,u{j},{},,1,{star}\n", 150.0 + 10.0 * f64::from(k)));
            }
        }
    }
    text
}

/// The model, its population in `t.toml`, and a design.
fn folder() -> Folder {
    let truth = format!("{PHASES}{ALIGN}{FLIGHT}");
    Folder::new(&[("p.toml", PHASES.as_bytes()), ("t.toml", truth.as_bytes()), ("design.csv", design().as_bytes())])
}

#[track_caller]
fn done(folder: &Folder, args: &str) -> String {
    let output = folder.run(args);
    assert_eq!(output.status.code(), Some(0), "`kalfit {args}`: {}", shown(&output));
    shown(&output)
}

fn text(folder: &Folder, name: &str) -> String {
    std::fs::read_to_string(folder.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn cells(folder: &Folder, name: &str) -> Vec<Vec<String>> {
    text(folder, name).lines().map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

#[test]
fn rows_of_all_phases_come_out_in_the_order_of_the_design() {
    let folder = folder();
    let said = done(&folder, "simulate p.toml --from t.toml --design design.csv --seed 1 --out s.csv --truth xi.csv");
    assert_snapshot!(said, @"
    exit 0
    ----- stdout
    ----- stderr
    Wrote s.csv: 6 tests, 240 rows, drawn with seed 1
    Wrote xi.csv: the initial states that were drawn
    ");
    let (before, after) = (cells(&folder, "design.csv"), cells(&folder, "s.csv"));
    let place = |table: &[Vec<String>], name: &str| table[0].iter().position(|other| other == name).unwrap();
    let column = |table: &[Vec<String>], name: &str| -> Vec<String> {
        let at = place(table, name);
        table[1..].iter().map(|row| row[at].clone()).collect()
    };
    for name in ["test", "phase", "t"] {
        assert_eq!(column(&after, name), column(&before, name), "column `{name}`");
    }
    for name in ["vel", "doppler", "star"] {
        let empty = |table: &[Vec<String>]| -> Vec<bool> { column(table, name).iter().map(String::is_empty).collect() };
        assert_eq!(empty(&after), empty(&before), "missing values of `{name}`");
        assert!(column(&after, name).iter().all(|cell| cell != "1"), "`{name}` is drawn");
    }
    let xi = cells(&folder, "xi.csv");
    let states = ["velocity_error", "tilt", "bias"];
    let names: Vec<String> =
        ["align", "flight"].iter().flat_map(|phase| states.map(|state| format!("{phase}.{state}"))).collect();
    assert_eq!((xi[0][0].as_str(), &xi[0][1..]), ("test", names.as_slice()));
    for row in &xi[1..] {
        let flies = row[0] != "u2" && row[0] != "u5";
        assert!(row[1..4].iter().all(|cell| !cell.is_empty()), "{row:?}");
        assert!(row[4..].iter().all(|cell| cell.is_empty() != flies), "{row:?}");
    }
    done(&folder, "simulate p.toml --from t.toml --design design.csv --seed 1 --out more.csv --tests 20 --threads 1");
    assert_eq!(cells(&folder, "more.csv")[..241], after[..], "a longer ensemble begins with the shorter one");
}

#[test]
fn a_drawn_ensemble_gives_its_population_back_and_what_the_plan_says() {
    let folder = folder();
    done(&folder, "simulate p.toml --from t.toml --design design.csv --seed 11 --tests 150 --out s.parquet");
    done(&folder, "fit p.toml s.parquet --out fit.json --quiet");
    let fit: FitRecord = serde_json::from_str(&text(&folder, "fit.json")).unwrap();
    assert!(fit.converged, "{}", fit.reason);
    let means = [[0.1, 2.0, -0.5], [-0.3, 1.0, 0.2]];
    let std_devs = [[0.5, 2.0, 0.5], [0.3, 1.0, 0.2]];
    for (phase, (means, std_devs)) in fit.phases.iter().zip(means.iter().zip(std_devs)) {
        for i in 0..3 {
            for (what, found, expected, error) in [
                ("mean", phase.mean.estimate[i], means[i], phase.mean.std_error[i]),
                ("std dev", phase.std_dev.estimate[i], std_devs[i], phase.std_dev.std_error[i]),
            ] {
                let away = (found - expected) / error.expect("identified");
                let state = &phase.states[i];
                assert!(away.abs() < 4.0, "{what} of {}.{state}: {found} {expected}, {away:.1} errors", phase.name);
            }
        }
    }
    white(&folder, fit.tests.len());
    // at the number of tests of the fit, the plan's standard errors are near the fit's
    done(&folder, "plan p.toml --from fit.json --design design.csv --tests 150,600 --out plan.json --quiet");
    let plan: PlanRecord = serde_json::from_str(&text(&folder, "plan.json")).unwrap();
    assert_eq!(plan.quantities.len(), 2 * (3 + 3 + 3 + 6), "no pair of two phases");
    for planned in plan.quantities.iter().filter(|planned| planned.quantity == "mean") {
        let phase = fit.phases.iter().find(|phase| phase.name == planned.phase).unwrap();
        let i = phase.states.iter().position(|state| *state == planned.states[0]).unwrap();
        let (a, b) = (planned.std_error[0].unwrap(), phase.mean.std_error[i].unwrap());
        assert!((a / b - 1.0).abs() < 0.1, "{}.{}: {a} against {b}", planned.phase, planned.states[0]);
        let half = planned.std_error[1].unwrap();
        assert!((2.0 * half / a - 1.0).abs() < 1e-12, "{half} is half of {a}");
    }
    let text = done(&folder, "plan p.toml --from fit.json --design design.csv --tests 150");
    assert!(text.contains("align.tilt") && text.contains("flight.bias"), "{text}");
}

/// The innovations of the fit in the folder are white, each phase's and measurement's.
fn white(folder: &Folder, tests: usize) {
    let fit: Value = serde_json::from_str(&text(folder, "fit.json")).unwrap();
    let mut sizes = std::collections::BTreeMap::<String, (f64, f64)>::new();
    let mut improbable = 0;
    for test in fit["tests"].as_array().unwrap() {
        let found = &test["innovations"];
        improbable += usize::from(found["whiteness"]["p_value"].as_f64().unwrap() < 0.05);
        for part in found["parts"].as_array().unwrap() {
            let name = format!("{}.{}", part["phase"].as_str().unwrap(), part["measurement"].as_str().unwrap());
            let size = sizes.entry(name).or_default();
            *size = (size.0 + part["nis"].as_f64().unwrap(), size.1 + part["count"].as_f64().unwrap());
        }
    }
    assert_eq!(sizes.keys().collect::<Vec<_>>(), ["align.stationary", "flight.doppler", "flight.star"]);
    for (name, (nis, count)) in sizes {
        let (mean, spread) = (nis / count, (2.0 / count).sqrt());
        assert!((mean - 1.0).abs() < 5.0 * spread, "{name}: mean square {mean} ± {spread}");
    }
    assert!(improbable < tests / 8, "{improbable} of {tests} tests are correlated in time at 5 %");
    assert!(!fit["notes"].to_string().contains("innovations"), "{}", fit["notes"]);
}

#[test]
fn a_population_of_other_phases_is_refused() {
    let folder = folder();
    let other = format!("{PHASES}{ALIGN}{FLIGHT}").replace("flight", "cruise");
    folder.write("other.toml", other.as_bytes());
    assert_snapshot!(shown(&folder.run("simulate p.toml --from other.toml --design design.csv --seed 1 --out s.csv")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: `other.toml`: the estimated states are `align.velocity_error`, `align.tilt`, `align.bias`, `cruise.velocity_error`, `cruise.tilt`, `cruise.bias`, expected `align.velocity_error`, `align.tilt`, `align.bias`, `flight.velocity_error`, `flight.tilt`, `flight.bias` as in the model

    hint: it is of another model: phases, states, regressions and parameters must have the same names
    ");
    let half = format!("{PHASES}{ALIGN}");
    folder.write("half.toml", half.as_bytes());
    assert_snapshot!(shown(&folder.run("plan p.toml --from half.toml --design design.csv --tests 5")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: `half.toml`: no value is given for mean[flight.velocity_error], mean[flight.tilt], mean[flight.bias], covariance[flight.velocity_error, flight.velocity_error], covariance[flight.velocity_error, flight.tilt], covariance[flight.tilt, flight.tilt], covariance[flight.velocity_error, flight.bias], covariance[flight.tilt, flight.bias], covariance[flight.bias, flight.bias]

    hint: fix it or give it a start value in `[phases.flight.mean]` and `[phases.flight.covariance]`, or take a fit
    ");
    assert!(!folder.path("s.csv").exists());
}

#[test]
fn a_design_with_wrong_phases_is_refused() {
    let folder = folder();
    let rows = "phase,test,t,vel,doppler,star\nalign,a,0,1,,\nclimb,a,1,1,,\n";
    folder.write("wrong.csv", rows.as_bytes());
    assert_snapshot!(shown(&folder.run("simulate p.toml --from t.toml --design wrong.csv --seed 1 --out s.csv")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: wrong.csv, row 3 (test `a`): found phase `climb` in column `phase`, expected `align`, `flight`

    hint: add the phase to the model, or leave its rows out
    ");
    let rows = "phase,test,t,vel,doppler,star\nalign,a,0,1,,\nflight,b,1,,1,\n";
    folder.write("early.csv", rows.as_bytes());
    assert_snapshot!(shown(&folder.run("plan p.toml --from t.toml --design early.csv --tests 5")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: early.csv, row 3 (test `b`): phase `flight` follows phase `align`, of which the test has no row

    hint: later phases may be missing, earlier ones not: a row with empty cells is a phase in which nothing was measured
    ");
}
