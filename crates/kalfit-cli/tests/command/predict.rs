//! `kalfit predict` through the built command.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use insta::assert_snapshot;
use kalfit::FitRecord;
use kalfit_fixtures::near;

use crate::folder::{Folder, number, shown};

const MODEL: &str = r#"
title = "Wandering gyros"

[data]
test = "unit"
time = "t"
group = "place"
[states.bias]
[states.walk]
process = "random-walk"
noise_density = "q"
initial = { mean = 0, sigma = 0 }
[measurements.rate]
column = "y"
equation = "bias + walk"
noise = "sigma"
[parameters]
q = { start = 0.3 }
sigma = { start = 0.3 }
"#;

/// No rate and no place: those are measured, and this is not.
const MISSION: &str = "unit,t,gain\nm,0,1\nm,4,2\nm,9,3\n";

const OUTPUTS: &str = r#"
[outputs.angle]
equation = "gain * bias"
unit = "deg"
[outputs.rate]
equation = "bias + walk + 0.5"
unit = "deg"
"#;

/// Twelve units of ten rows.
fn data() -> String {
    let mut text = "unit,t,y,place\n".to_owned();
    for j in 0..12 {
        let bias = f64::from((j * 23) % 31 - 15) / 8.0;
        let mut walk = 0.0;
        for k in 0..10 {
            walk += f64::from((11 * j + 5 * k * k + j * k) % 23 - 11) / 12.0;
            let wave = f64::from((13 * j + 7 * k) % 19 - 9) / 60.0;
            text.push_str(&format!("u{j:02},{k},{},A\n", bias + walk + wave));
        }
    }
    text
}

fn fitted() -> Folder {
    let own = data();
    let files = [("m.toml", MODEL), ("d.csv", &own), ("mission.csv", MISSION), ("out.toml", OUTPUTS)];
    let folder = Folder::new(&files.map(|(name, text)| (name, text.as_bytes())));
    let output = folder.run("fit m.toml d.csv --out fit.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    folder
}

fn record(folder: &Folder) -> FitRecord {
    serde_json::from_str(&std::fs::read_to_string(folder.path("fit.json")).unwrap()).unwrap()
}

#[test]
fn a_mission_is_what_the_fit_makes_of_it() {
    let folder = fitted();
    let output =
        folder.run("predict m.toml --from fit.json --design mission.csv --outputs out.toml --out mission.out.csv");
    assert_snapshot!(shown(&output), @r#"
    exit 0
    ----- stdout
    Wandering gyros

    Predictions for 1 test with 3 rows; all parameters are taken from fit.json.

    Test m, at time 9
                     mean  std. dev.  population  process  estimation
      bias         0.1701      1.665         1.6        0      0.4619
      walk              0      1.732           0    1.732           0
      angle [deg]  0.5104      4.996         4.8        0       1.386
      rate [deg]   0.6701      2.403         1.6    1.732      0.4619

                      one new test  limits of the mean  tolerance limits
      bias         -3.659 to 3.999    -0.6963 to 1.037   -4.628 to 4.968
      walk         -3.434 to 3.434              0 to 0   -3.727 to 3.727
      angle [deg]     -10.98 to 12      -2.089 to 3.11    -13.88 to 14.9
      rate [deg]   -4.283 to 5.623    -0.1963 to 1.537   -4.963 to 6.303

    Two outputs together
      Test m, angle and rate: the ellipse about the means that holds 95 % of all
        tests has half axes 12.97 and 3.999, the longer one 20.5° from angle towards
        rate. Half of all tests are within 3.997 of the means (the circular error
        probable, CEP), and within 4.058 of zero.

    How to read this
      Standard deviations: "population" is the spread of the estimated initial
        states from test to test, "process" that of process noise and of initial
        states with a given spread, and "estimation" the error of the estimated
        mean. The column "std. dev." combines those that are known.
      "One new test": the limits that contain its value with probability 95 %, by
        Student's t where the fit has degrees of freedom.
      Limits of the mean: a two-sided interval with confidence 90 %. Tolerance
        limits, with confidence 90 %: 95 % of all tests are between them.
      The limits treat the estimated variance as chi-squared, with degrees of
        freedom that follow from its standard error, or from those of the fit by
        restricted likelihood. That is exact where every test determines its initial
        state exactly, and a good approximation for many tests. A limit is "unknown"
        where there are too few tests for it or the data do not determine the
        quantity.
    ----- stderr
    Wrote mission.out.csv
    "#);
    let record = record(&folder);
    let (mean, phase) = (record.phases[0].mean.estimate[0], &record.phases[0]);
    let variance = phase.covariance.estimate[0][0];
    let error = phase.mean.std_error[0].unwrap();
    let q = record.parameters.iter().find(|parameter| parameter.name == "q").unwrap().estimate;
    let rows = folder.table("mission.out.csv");
    assert_eq!(rows.len(), 3 * 4, "two states and two outputs at three times");
    for row in &rows {
        let time = number(row, "time");
        let gain = 1.0 + number(row, "row") - 1.0;
        let (expected, population, process, estimation) = match row["name"].as_str() {
            "bias" => (mean, variance, 0.0, error),
            "walk" => (0.0, 0.0, q * q * time, 0.0),
            "angle" => (gain * mean, gain * gain * variance, 0.0, gain * error),
            _ => (mean + 0.5, variance, q * q * time, error),
        };
        near::mixed("mean", number(row, "mean"), expected, 1e-7);
        near::mixed("population", number(row, "std_dev_population"), population.sqrt(), 1e-7);
        near::mixed("process", number(row, "std_dev_process"), process.sqrt(), 1e-7);
        near::mixed("estimation", number(row, "std_dev_estimation"), estimation, 1e-7);
        let all = population + process + estimation * estimation;
        near::mixed("all", number(row, "std_dev"), all.sqrt(), 1e-7);
        let half = number(row, "tolerance_upper") - expected;
        assert!(half >= 1.96 * (population + process).sqrt(), "{row:?}");
        near::mixed("both sides", expected - number(row, "tolerance_lower"), half, 1e-7);
        assert!(number(row, "confidence_upper") <= number(row, "tolerance_upper") + 1e-12, "{row:?}");
    }
}

#[test]
fn one_limit_by_itself_is_nearer() {
    let folder = fitted();
    let limit = |options: &str| {
        let output =
            folder.run(&format!("predict m.toml --from fit.json --design mission.csv --out p.csv --quiet {options}"));
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
        number(&folder.table("p.csv")[0], "tolerance_upper")
    };
    let [two, one, sure, much] = ["", "--one-sided", "--confidence 0.99", "--content 0.99"].map(limit);
    assert!(one < two && two < sure && two < much, "{one} {two} {sure} {much}");
}

/// With the data of the fit, limits of the mean are by profile likelihood: those of a constant bias are those of its μ.
#[test]
fn limits_of_the_mean_by_profile_are_those_of_the_fit() {
    let folder = fitted();
    let with = "--design mission.csv --outputs out.toml --confidence 0.95 --profile d.csv --out p.csv";
    let output = folder.run(&format!("predict m.toml --from fit.json {with}"));
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    assert!(shown(&output).contains("profile likelihood of the data"), "{}", shown(&output));
    let output = folder.run("fit m.toml d.csv --intervals profile --out profiled.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let fit: FitRecord = serde_json::from_slice(&std::fs::read(folder.path("profiled.json")).unwrap()).unwrap();
    let ends = fit.phases[0].mean.interval95[0].unwrap().map(Option::unwrap);
    let width = ends[1] - ends[0];
    let rows = folder.table("p.csv");
    for (name, factor, constant) in [("bias", 1.0, 0.0), ("angle", 3.0, 0.0), ("rate", 1.0, 0.5)] {
        let row = rows.iter().rfind(|row| row["name"] == name).unwrap();
        for (column, end) in ["confidence_lower", "confidence_upper"].into_iter().zip(ends) {
            let (found, expected) = (number(row, column), factor * end + constant);
            assert!((found - expected).abs() < 1e-3 * factor * width, "{name}: {found} against {expected}");
        }
    }
}

#[test]
fn profiles_need_the_data_of_the_fit() {
    let folder = fitted();
    let short: String = data().lines().take(61).map(|line| format!("{line}\n")).collect();
    std::fs::write(folder.path("half.csv"), short).unwrap();
    let run = |options: &str| shown(&folder.run(&format!("predict m.toml --design mission.csv --out p.csv {options}")));
    let text = run("--from fit.json --profile half.csv");
    assert!(text.starts_with("exit 2") && text.contains("the log-likelihood of these data is"), "{text}");
    assert!(text.contains("hint: give the data, and all the data, that the fit was made from"), "{text}");
    let text = run("--from fit.json --profile d.csv --set q=0.2");
    assert!(text.starts_with("exit 2") && text.contains("`--set` changed parameters that were estimated"), "{text}");
    assert!(!folder.path("p.csv").exists(), "nothing was written");
}

#[test]
fn values_that_are_given_are_exact() {
    let folder = fitted();
    let output =
        folder.run("predict m.toml --from fit.json --set q=0.2 --set sigma=1 --design mission.csv --out p.csv --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let rows = folder.table("p.csv");
    let walk = rows.iter().rfind(|row| row["name"] == "walk").unwrap();
    near::mixed("process", number(walk, "std_dev_process"), 0.2 * 3.0, 1e-7);
    near::mixed("tolerance", number(walk, "tolerance_upper"), 0.6 * 1.959_963_984_5, 1e-7);
}

#[test]
fn what_cannot_be_told_is_not_told() {
    let folder = fitted();
    let json = std::fs::read_to_string(folder.path("fit.json")).unwrap();
    // the walk's noise was estimated as zero: how large it may be is not known
    let mut record: serde_json::Value = serde_json::from_str(&json).unwrap();
    record["estimates"]["at_zero"] = serde_json::json!(["q"]);
    std::fs::write(folder.path("zero.json"), record.to_string()).unwrap();
    let output = folder.run("predict m.toml --from zero.json --design mission.csv --out p.csv --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    for row in folder.table("p.csv") {
        let is_unknown = row["tolerance_upper"].is_empty();
        assert_eq!(is_unknown, row["name"] == "walk" && row["time"] != "0", "{row:?}");
        assert!(!row["confidence_upper"].is_empty(), "{row:?}");
    }
    // an older fit says nothing of how its estimates vary together
    record["estimates"] = serde_json::Value::Null;
    std::fs::write(folder.path("old.json"), record.to_string()).unwrap();
    let output = folder.run("predict m.toml --from old.json --design mission.csv --out p.csv");
    assert!(shown(&output).contains("does not contain the covariance of its estimates"), "{}", shown(&output));
    assert!(folder.table("p.csv").iter().all(|row| row["std_dev_estimation"].is_empty()));
    // beyond all numbers
    std::fs::write(folder.path("huge.toml"), "[outputs.a]\nequation = \"1e308 * bias * gain * 1e10\"\n").unwrap();
    let output = folder.run("predict m.toml --from fit.json --design mission.csv --outputs huge.toml --out none.csv");
    assert_eq!(output.status.code(), Some(2), "{}", shown(&output));
    assert!(!folder.path("none.csv").exists(), "nothing is written");
}

const UNITS: &str = r#"
[data]
test = "run"
levels = ["unit"]
[states.level]
[measurements.y]
column = "y"
equation = "level"
noise = 0.5
"#;

#[test]
fn runs_of_a_known_unit_are_near_its_own_level() {
    let mut text = "run,unit,y\n".to_owned();
    for unit in 0..8 {
        for run in 0..4 {
            let level = 3.0 * f64::from((unit * 5) % 8 - 4) + f64::from((unit * 7 + run * 3) % 5 - 2) / 4.0;
            for row in 0..3 {
                text.push_str(&format!("{run},u{unit},{}\n", level + f64::from((row + run + unit) % 3 - 1) / 2.0));
            }
        }
    }
    let files = [("m.toml", UNITS), ("d.csv", &text), ("known.csv", "run,unit\n9,u0\n9,u5\n"), ("new.csv", "run\n9\n")];
    let strange = ("strange.csv", "run,unit\n9,x7\n");
    let folder = Folder::new(
        &files.into_iter().chain([strange]).map(|(name, text)| (name, text.as_bytes())).collect::<Vec<_>>(),
    );
    let output = folder.run("fit m.toml d.csv --out fit.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let predicted = |options: &str| {
        let output = folder.run(&format!("predict m.toml --from fit.json {options} --out p.csv --quiet"));
        assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
        folder.table("p.csv")
    };
    let record = record(&folder);
    let [unit, own] = [0, 1].map(|level| record.levels[level].covariance.estimate[0][0]);
    let new = &predicted("--design new.csv")[0];
    near::mixed("mean of a new unit", number(new, "mean"), record.phases[0].mean.estimate[0], 1e-7);
    near::mixed("spread of a new unit", number(new, "std_dev_population").powi(2), unit + own, 1e-7);
    for (row, name) in predicted("--design known.csv --units known").iter().zip(["u0", "u5"]) {
        let known = record.groups.iter().find(|unit| unit.id == [name]).unwrap();
        near::mixed("mean of a known unit", number(row, "mean"), known.mean[0], 1e-7);
        near::mixed("spread of its runs", number(row, "std_dev_population").powi(2), own, 1e-7);
        let left = known.covariance[0][0];
        let hangs = left / unit * record.phases[0].mean.std_error[0].unwrap();
        // the share of its own mean in what is known of a unit: 1 - v/a, with v = w/4 of runs and a of means of units, which are
        // independent estimates of variances 2w²/24 and 2a²/8
        let of_runs = (own + 0.25 / 3.0) / 4.0;
        let of_means = unit + of_runs;
        let share = unit / of_means;
        let share_error = of_runs / of_means * (2.0_f64 / 24.0 + 2.0 / 8.0).sqrt();
        let by_share = (known.mean[0] - record.phases[0].mean.estimate[0]) / share * share_error;
        let expected = left.sqrt().hypot(hangs).hypot(by_share);
        near::mixed("what is left of the mean", number(row, "std_dev_estimation"), expected, 1e-6);
        let half = number(row, "confidence_upper") - number(row, "mean");
        assert!(half > left.sqrt(), "limits of the mean: {half} of {}", left.sqrt());
    }
    let output = folder.run("predict m.toml --from fit.json --design strange.csv --units known");
    assert_snapshot!(shown(&output), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: test `x7/9` is of unit `x7`, which is not in `fit.json`: it knows `u0`, `u1`, `u2`, `u3`, `u4`, `u5`, `u6`, `u7`

    hint: `--units new` predicts tests of units that nobody has seen
    "#);
}

/// Where a covariate counts from is no matter of what is known of a unit: its own runs make up for the error of the coefficient.
#[test]
fn a_known_unit_is_known_wherever_covariates_count_from() {
    let model = UNITS.to_owned() + "[mean.regression]\nlevel = [\"w\"]\n";
    let predicted = |from: f64| {
        let mut text = "run,unit,y,w\n".to_owned();
        for (unit, run) in (0..8).flat_map(|unit| (0..4).map(move |run| (unit, run))) {
            let w = f64::from((unit * 3 + run * 5) % 11 - 5) / 3.0;
            let level = 3.0 * f64::from((unit * 5) % 8 - 4) + 0.7 * w + f64::from((unit * 7 + run * 3) % 5 - 2) / 4.0;
            for row in 0..3 {
                let y = level + f64::from((row + run + unit) % 3 - 1) / 2.0;
                text.push_str(&format!("{run},u{unit},{y},{}\n", w - from));
            }
        }
        let design = format!("run,unit,w\n9,u0,{}\n9,u5,{}\n", 0.4 - from, -1.1 - from);
        let files = [("m.toml", &model), ("d.csv", &text), ("known.csv", &design)];
        let folder = Folder::new(&files.map(|(name, text)| (name, text.as_bytes())));
        for line in ["fit m.toml d.csv", "predict m.toml --from fit.json --design known.csv --units known"] {
            let out = if line.starts_with("fit") { "fit.json" } else { "p.csv" };
            let output = folder.run(&format!("{line} --out {out} --quiet"));
            assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
        }
        folder.table("p.csv")
    };
    let (near_by, far) = (predicted(0.0), predicted(1000.0));
    for (near_by, far) in near_by.iter().zip(&far) {
        for column in ["mean", "std_dev_population", "std_dev_estimation", "confidence_lower", "confidence_upper"] {
            near::mixed(column, number(far, column), number(near_by, column), 1e-5);
        }
    }
}

#[test]
fn mistakes_are_said_plainly() {
    let folder = fitted();
    let outputs = [
        ("wrong.toml", "[outputs.a]\nequation = \"bias * walk\"\n"),
        ("state.toml", "[outputs.bias]\nequation = \"2 * bias\"\n"),
        ("none.toml", "[a]\nequation = \"2 * bias\"\n"),
        ("phase.toml", "[outputs.a]\nequation = \"2 * bias\"\nphase = \"flight\"\n"),
        ("column.toml", "[outputs.a]\nequation = \"speed * bias\"\n"),
    ];
    for (name, text) in outputs {
        std::fs::write(folder.path(name), text).unwrap();
    }
    let run =
        |options: &str| shown(&folder.run(&format!("predict m.toml --from fit.json --design mission.csv {options}")));
    assert_snapshot!(run("--outputs wrong.toml"), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: state `bias` times state `walk` is not linear in the states
      --> wrong.toml:2:13 | equation = "bias * walk"
                          |             ^^^^^^^^^^^
    "#);
    assert_snapshot!(run("--outputs state.toml"), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: `bias` cannot be the name of an output: a state has it
      --> state.toml:1:10 | [outputs.bias]
                          |          ^^^^

    hint: states are told anyway
    "#);
    assert_snapshot!(run("--outputs none.toml"), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: unknown key `a` in the file of outputs
      --> none.toml:1:2 | [a]
                        |  ^

    hint: its keys are `outputs`
    "#);
    assert_snapshot!(run("--outputs phase.toml"), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: `phase` has no effect with a model without phases
      --> phase.toml:3:1 | phase = "flight"
                         | ^^^^^
    "#);
    assert_snapshot!(run("--outputs column.toml"), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: mission.csv has no column `speed`, which is used in `equation` of output `a`

    hint: its columns are `unit`, `t`, `gain`
    "#);
    assert_snapshot!(run("--units known"), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: `--units known` has no effect: the model has no levels of groups

    hint: leave it out
    "#);
    assert_snapshot!(run("--content 0.3"), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: invalid value '0.3' for '--content <P>': expected a number from 0.5 to 0.999999, such as 0.9

    For more information, try '--help'.
    "#);
}
