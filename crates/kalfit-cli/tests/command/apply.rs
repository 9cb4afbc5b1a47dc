//! `kalfit apply` through the built command.

use std::collections::HashMap;

use insta::assert_snapshot;
use kalfit::FitRecord;
use kalfit_fixtures::near;

use crate::folder::{Folder, number, shown};

const MODEL: &str = r#"
title = "Wandering gyros"

[data]
test = "unit"
time = "t"
[states.bias]
[states.walk]
process = "random-walk"
noise_density = 0.3
initial = { mean = 0, sigma = 0 }
[measurements.rate]
column = "y"
equation = "bias + walk"
noise = "sigma"
[parameters]
sigma = { start = 0.3 }
"#;

/// Twelve units of ten rows, a value missing in each; biases `shift` higher than those of the others.
fn data(shift: f64, noise: f64) -> String {
    let mut text = "unit,t,y\n".to_owned();
    for j in 0..12 {
        let bias = f64::from((j * 23) % 31 - 15) / 8.0 + shift;
        let mut walk = 0.0;
        for k in 0..10 {
            walk += f64::from((11 * j + 5 * k) % 23 - 11) / 25.0;
            let wave = f64::from((13 * j + 7 * k) % 19 - 9) / 18.0;
            let value = if (j + k) % 10 == 4 { String::new() } else { (bias + walk + noise * wave).to_string() };
            text.push_str(&format!("u{j:02},{k},{value}\n"));
        }
    }
    text
}

/// With the model, its data, others, and the fit.
fn fitted() -> Folder {
    let [own, shifted, noisy] = [data(0.0, 1.0), data(9.0, 1.0), data(0.0, 6.0)];
    let files = [("m.toml", MODEL), ("d.csv", &own), ("shifted.csv", &shifted), ("noisy.csv", &noisy)];
    let folder = Folder::new(&files.map(|(name, text)| (name, text.as_bytes())));
    let output = folder.run("fit m.toml d.csv --out fit.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    folder
}

#[test]
fn the_tests_of_a_fit_are_what_the_fit_says_of_them() {
    let folder = fitted();
    let output = folder.run("apply m.toml d.csv --from fit.json --out tests.csv --states states.csv");
    assert_snapshot!(shown(&output), @"
    exit 0
    ----- stdout
    Wandering gyros

    12 tests with 108 measured values. All parameters are taken from fit.json;
    nothing is estimated.
    Taken together, the tests agree with this population.

    All tests together
      Log predictive density: -87.9287 in all, -7.327 for each test on average.
      Initial states: squared distances of the tests from the population add up to
        12.03, expected 12 ± 4.9 (chi-squared, 12 degrees of freedom): p = 0.89.
      Residuals (differences between measurements and model that no initial state
        explains): their squares add up to 81.51, expected 96 ± 14 (chi-squared, 96
        degrees of freedom): p = 0.29.
      The test furthest from the population is `u00`: p = 0.04 by itself, p = 0.46
        as the furthest of 12.

    How to read this
      The parameters of fit.json were estimated from these same tests, so the sums
        of squares are close to what is expected. New tests are compared with wider
        distributions.
      The p-value of a sum is two-sided. That of a single test is the probability of
        a larger value, corrected by Holm's method for the number of tests.
    ----- stderr
    Wrote tests.csv
    Wrote states.csv
    ");
    let fit: FitRecord = serde_json::from_slice(&std::fs::read(folder.path("fit.json")).unwrap()).unwrap();
    let (tests, states) = (folder.table("tests.csv"), folder.table("states.csv"));
    near::mixed("all", tests.iter().map(|test| number(test, "log_density")).sum(), fit.log_likelihood, 1e-9);
    for (row, test) in tests.iter().zip(fit.tests.iter()) {
        assert_eq!((row["test"].as_str(), row["phase"].as_str()), (test.id, "main"));
        near::mixed("log density", number(row, "log_density"), test.log_likelihood, 1e-9);
        near::mixed("distance", number(row, "distance"), test.distance.unwrap(), 1e-9);
        near::mixed("posterior", number(row, "mean[bias]"), test.phases.get(0).mean[0], 1e-9);
        let innovations = test.innovations.as_ref().unwrap();
        near::mixed("innovations", number(row, "nis"), innovations.nis.unwrap(), 1e-9);
        assert_eq!(row["observations"], innovations.count.to_string());
        // a state that does not move is at every step what its start is
        let own: Vec<_> = states.iter().filter(|state| state["test"] == test.id && state["name"] == "bias").collect();
        assert_eq!(own.len(), 10, "steps with nothing measured too");
        for state in own {
            near::mixed("smoothed", number(state, "value"), number(row, "mean[bias]"), 1e-9);
            near::mixed("its deviation", number(state, "std_dev"), number(row, "std_dev[bias]"), 1e-9);
        }
    }
    // what states say of the measured values is the sum of them
    let measured = states.iter().filter(|state| state["name"] == "rate");
    assert_eq!(measured.clone().count(), 108);
    for rate in measured {
        let same = |name: &str| {
            let own = |row: &&HashMap<String, String>| {
                row["name"] == name && row["row"] == rate["row"] && row["test"] == rate["test"]
            };
            number(states.iter().find(own).unwrap(), "value")
        };
        near::mixed("prediction", number(rate, "value"), same("bias") + same("walk"), 1e-9);
    }
}

#[test]
fn predictions_standardise_innovations() {
    let folder = fitted();
    let output =
        folder.run("apply m.toml d.csv --from fit.json --states states.csv --kind predicted --out tests.csv --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let (tests, states) = (folder.table("tests.csv"), folder.table("states.csv"));
    let measured: HashMap<(String, String), f64> = folder
        .table("d.csv")
        .iter()
        .filter(|row| !row["y"].is_empty())
        .map(|row| ((row["unit"].clone(), row["t"].clone()), number(row, "y")))
        .collect();
    for test in &tests {
        let own = states.iter().filter(|row| row["name"] == "rate" && row["test"] == test["test"]);
        let squares = own.map(|row| {
            let value = measured[&(row["test"].clone(), row["time"].clone())];
            ((value - number(row, "value")) / number(row, "std_dev")).powi(2)
        });
        near::mixed("NIS", squares.sum(), number(test, "nis"), 1e-9);
    }
}

#[test]
fn tests_of_another_population_are_told() {
    let folder = fitted();
    let said = |data: &str| shown(&folder.run(&format!("apply m.toml {data} --from fit.json")));
    let shifted = said("shifted.csv");
    assert!(shifted.contains("The tests do not belong to this population: their initial states"), "{shifted}");
    assert!(!shifted.contains("residuals of"), "records of shifted tests are as good as the others: {shifted}");
    let noisy = said("noisy.csv");
    assert!(noisy.contains("The model does not describe the records of these tests"), "{noisy}");
}

#[test]
fn tables_hold_the_same_in_every_format_and_for_any_number_of_threads() {
    let folder = fitted();
    for (name, options) in [("a.csv", "--threads 1"), ("b.csv", "--threads 2"), ("c.parquet", ""), ("d.arrow", "")] {
        let output = folder
            .run(&format!("apply m.toml d.csv --from fit.json --quiet --states {name} --kind filtered {options}"));
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    }
    let bytes = |name: &str| std::fs::read(folder.path(name)).unwrap();
    assert_eq!(bytes("a.csv"), bytes("b.csv"));
    assert!(bytes("c.parquet").starts_with(b"PAR1") && bytes("d.arrow").starts_with(b"ARROW1"));
}

#[test]
fn what_cannot_be_applied_is_refused_before_work_and_writes_nothing() {
    let folder = fitted();
    let cases = [
        ("apply m.toml d.csv --from fit.json --out t.json", "cannot tell the format of `t.json`"),
        ("apply m.toml d.csv --from fit.json --out t.csv --states t.csv", "both outputs are `t.csv`"),
        ("apply m.toml d.csv --from fit.json --out d.csv", "is one of the inputs"),
        ("apply m.toml d.csv --from fit.json --kind filtered", "--states"),
        ("apply m.toml d.csv --from m.toml", "no value is given for mean[bias]"),
        ("apply m.toml d.csv --from d.csv", "d.csv"),
    ];
    for (line, message) in cases {
        let output = folder.run(line);
        assert_eq!(output.status.code(), Some(2), "{line}: {}", shown(&output));
        assert!(shown(&output).contains(message), "{line}: {}", shown(&output));
    }
    assert!(!folder.path("t.csv").exists());
}

#[test]
fn no_table_is_written_where_states_are_not_known() {
    let folder = fitted();
    assert_eq!(folder.run("reduce m.toml d.csv --at fit.json --out r.parquet --quiet").status.code(), Some(0));
    let output = folder.run("apply m.toml r.parquet --from fit.json --out t.csv --states s.csv");
    assert!(shown(&output).contains("has a reduction, not rows"), "{}", shown(&output));
    assert_eq!((output.status.code(), folder.path("t.csv").exists()), (Some(2), false));
    let output = folder.run("apply m.toml r.parquet --from fit.json --out t.csv");
    assert_eq!((output.status.code(), folder.path("t.csv").exists()), (Some(0), true), "{}", shown(&output));
    assert!(!shown(&output).contains("Residuals"), "no measured value is known: {}", shown(&output));
}

#[test]
fn other_values_than_those_of_the_fit_are_named() {
    let folder = fitted();
    let said = shown(&folder.run("apply m.toml d.csv --from fit.json --set sigma=0.9"));
    assert!(said.contains("All parameters are taken from fit.json but"), "{said}");
}

const UNITS: &str = r#"
[data]
test = "run"
levels = ["unit"]
[states.level]
[measurements.y]
column = "y"
equation = "level"
noise = 0.1
[mean]
fixed = { level = 0 }
[covariance]
structure = "fixed"
matrix = [[0.25]]
[levels.unit.covariance]
structure = "fixed"
matrix = [[4.0]]
"#;

/// Eight units of four runs of two rows; runs differ by so much, units as the model says.
fn runs(apart: f64) -> String {
    let mut text = "unit,run,y\n".to_owned();
    for unit in 0..8 {
        for run in 0..4 {
            let level = f64::from(unit * 5 % 8) - 3.5 + apart * (f64::from((3 * unit + 5 * run) % 7) - 3.0) / 2.0;
            for noise in [-0.07, 0.07] {
                text.push_str(&format!("u{unit},r{run},{}\n", level + noise));
            }
        }
    }
    text
}

#[test]
fn tests_of_one_unit_are_compared_with_each_other() {
    let [sound, equal, wide] = [runs(0.5), runs(0.0), runs(1.0)];
    let files = [("u.toml", UNITS), ("sound.csv", &sound), ("equal.csv", &equal), ("wide.csv", &wide)];
    let folder = Folder::new(&files.map(|(name, text)| (name, text.as_bytes())));
    let said = |data: &str| shown(&folder.run(&format!("apply u.toml {data} --from u.toml")));
    let sound = said("sound.csv");
    assert!(sound.contains("Taken together, the tests agree with this population"), "{sound}");
    for name in ["equal.csv", "wide.csv"] {
        let other = said(name);
        assert!(other.contains("The tests do not belong to this population: their initial states"), "{name}: {other}");
        assert!(other.contains("Within the groups of `unit`"), "{other}");
    }
}

const LEVEL: &str = r#"
[data]
test = "test"
[states.level]
[measurements.y]
column = "y"
equation = "level"
noise = 1
[mean]
start = { level = 0 }
[covariance]
start = [[1]]
"#;

#[test]
fn a_test_beyond_all_measure_is_not_left_out() {
    // whatever the size, the mean of B is ordinary and its residual is not
    for size in ["3e2", "3e5", "3e7", "3e9"] {
        let data = format!("test,y\nA,0.5\nA,-0.3\nB,{size}\nB,-{size}\nC,1.2\nC,0.2\n");
        let folder = Folder::new(&[("c.toml", LEVEL.as_bytes()), ("far.csv", data.as_bytes())]);
        let said = shown(&folder.run("apply c.toml far.csv --from c.toml --out o.csv"));
        assert!(said.contains("The model does not describe the records of these tests"), "{size}: {said}");
        assert!(said.contains("The residuals of 1 test are larger than the model allows"), "{size}: {said}");
        assert!(folder.table("o.csv").iter().all(|row| !row["residual"].is_empty()), "{size}");
    }
}

#[test]
fn what_cannot_be_judged_is_said_to_be_so() {
    // two tests tell two states exactly: of the covariance nothing is known that a law could be made of
    let model = "[data]\ntest = \"test\"\n[states]\na = {}\nb = {}\n[measurements.y]\ncolumn = \"y\"\nequation = \"a\"\nnoise = 1e-5\n\
                 [measurements.z]\ncolumn = \"z\"\nequation = \"b\"\nnoise = 1e-5\n";
    let folder = Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", b"test,y,z\nt0,1,2\nt1,2,2.5\n")]);
    folder.run("fit m.toml d.csv --out fit.json --quiet");
    folder.write("new.csv", b"test,y,z\nn0,1e6,-1e6\nn1,2e6,3e6\n");
    let said = shown(&folder.run("apply m.toml new.csv --from fit.json"));
    assert!(said.contains("cannot be judged") && !said.contains("agree with this population"), "{said}");
}

#[test]
fn a_unit_that_is_far_off_is_named_as_a_unit() {
    let moved: String = runs(0.5)
        .lines()
        .map(|line| match line.strip_prefix("u3,").and_then(|rest| rest.split_once(',')) {
            Some((run, y)) => format!("u3,{run},{}\n", 10.0 + y.parse::<f64>().unwrap()),
            None => line.to_owned() + "\n",
        })
        .collect();
    let folder = Folder::new(&[("u.toml", UNITS.as_bytes()), ("moved.csv", moved.as_bytes())]);
    let said = shown(&folder.run("apply u.toml moved.csv --from u.toml"));
    let flowing = said.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(flowing.contains("One group of tests is an outlier as a whole."), "{said}");
    let (_, table) = said.split_once("Outlying groups\n").unwrap();
    let row: Vec<&str> = table.lines().nth(1).unwrap().split_whitespace().collect();
    // the mean of four runs, each known to 0.1/sqrt(2) from a run that varies by 0.5: squared over 4 + 0.25/4 + 0.01/8
    let mean = moved
        .lines()
        .filter(|line| line.starts_with("u3,"))
        .map(|line| line.rsplit(',').next().unwrap().parse::<f64>().unwrap())
        .sum::<f64>()
        / 8.0;
    let expected = mean * mean / (4.0 + 0.25 / 4.0 + 0.01 / 8.0);
    assert_eq!(row[..3], ["unit", "u3", "4"], "{said}");
    let found: f64 = row[3].parse().unwrap();
    assert!((found - expected).abs() < 0.006 * expected, "{found} and {expected}");
    assert_eq!(row[4], "1");
}

const EXACT: &str = r#"
[data]
test = "unit"
[states.level]
[measurements.y]
column = "y"
equation = "level"
noise = 1e-4
"#;

/// Six units that tell their level exactly, and one more: Student's law of a new value, on five degrees of freedom.
#[test]
fn a_new_unit_is_compared_with_an_estimated_population() {
    let units: String = [1, 2, 3, 4, 5, 9].iter().enumerate().map(|(k, y)| format!("u{k},{y}\n")).collect();
    let old = format!("unit,y\n{units}");
    let files = [("m.toml", EXACT), ("old.csv", &old), ("new.csv", "unit,y\nv,11\n")];
    let folder = Folder::new(&files.map(|(name, text)| (name, text.as_bytes())));
    assert_eq!(folder.run("fit m.toml old.csv --out fit.json --quiet").status.code(), Some(0));
    let said = shown(&folder.run("apply m.toml new.csv --from fit.json --out t.csv"));
    let row = &folder.table("t.csv")[0];
    // mean 4, variance 40/6: 49 over it, and scipy.stats.f.sf(49 / (40 / 6) * 5 / 7, 1, 5)
    near::mixed("distance", number(row, "distance"), 49.0 / (40.0 / 6.0), 1e-6);
    near::mixed("p", number(row, "p_value"), 0.070_535_765_2, 1e-5);
    assert!(said.contains("(F, 1 and 5 degrees of freedom)"), "{said}");
    let flowing = said.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(flowing.contains("allow for the errors of all estimates in fit.json (from 6 tests)"), "{said}");
    let own = shown(&folder.run("apply m.toml old.csv --from fit.json"));
    assert!(
        own.split_whitespace().collect::<Vec<_>>().join(" ").contains("were estimated from these same tests"),
        "{own}"
    );
    // of a fit that does not say how far its estimates can be trusted six tests that told all are taken
    let mut fit: serde_json::Value = serde_json::from_slice(&std::fs::read(folder.path("fit.json")).unwrap()).unwrap();
    fit["estimates"] = serde_json::Value::Null;
    folder.write("silent.json", fit.to_string().as_bytes());
    let said = shown(&folder.run("apply m.toml new.csv --from silent.json --out s.csv"));
    assert!(said.contains("silent.json does not contain the covariance of its estimates"), "{said}");
    near::mixed("p", number(&folder.table("s.csv")[0], "p_value"), 0.070_535_765_2, 1e-5);
}

/// The textbook filter with H, R and K of the two rows together where `e` is measured; `a` is 1.7 from then on.
#[test]
fn a_measurement_without_noise_is_known_from_its_step_on() {
    let model = r#"[data]
test = "test"
time = "t"
[states]
a = {}
b = {}
[measurements.y]
column = "y"
equation = "a + b * x"
noise = 0.5
[measurements.e]
column = "e"
equation = "a"
noise = 0
[mean]
fixed = { a = 1, b = 2 }
[covariance]
structure = "fixed"
matrix = [[1, 0.3], [0.3, 0.5]]
"#;
    let data = "test,t,x,y,e\nA,0,1,3.1,\nA,1,2,5.6,\nA,2,1,2.9,1.7\nA,3,3,8.2,\n";
    let folder = Folder::new(&[("m.toml", model.as_bytes()), ("d.csv", data.as_bytes())]);
    // mean and standard deviation of a and b after each row; those before a row are those after the row before it
    let filtered = [
        [(1.055_319_148_9, 0.529_953_831_8), (2.034_042_553_2, 0.477_136_850_9)],
        [(1.052_991_453_0, 0.529_934_223_1), (2.205_128_205_1, 0.339_683_110_2)],
        [(1.7, 0.0), (1.777_306_273_1, 0.194_481_048_5)],
        [(1.7, 0.0), (2.001_796_875_0, 0.126_552_854_6)],
    ];
    for (kind, later) in [("filtered", 0), ("predicted", 1)] {
        let output = folder.run(&format!("apply m.toml d.csv --from m.toml --kind {kind} --states s.csv --quiet"));
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
        let states: Vec<_> = folder.table("s.csv").into_iter().filter(|row| row["what"] == "state").collect();
        assert_eq!(states.len(), 8);
        for (row, expected) in states[2 * later..].iter().zip(filtered.as_flattened()) {
            let what = format!("{kind} {row:?}");
            near::mixed(&what, number(row, "value"), expected.0, 1e-9);
            near::mixed(&what, number(row, "std_dev"), expected.1, 1e-9);
        }
    }
}
