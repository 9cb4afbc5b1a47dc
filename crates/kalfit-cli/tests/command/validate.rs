//! `kalfit validate` through the built command.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use insta::assert_snapshot;
use kalfit::validate::ValidatedRecord;

use crate::folder::{Folder, shown};

const LINES: &str = r#"
title = "Lines"

[data]
test = "unit"
[states.level]
[states.slope]
[measurements.y]
column = "y"
equation = "level + slope * x"
noise = "sigma"
[parameters]
sigma = { start = 0.5 }
"#;

/// The same slope in all tests.
const PARALLEL: &str = r#"
title = "Parallel lines"

[data]
test = "unit"
[states.level]
[states.slope]
[covariance]
structure = "diagonal"
fixed = { "slope, slope" = 0 }
[measurements.y]
column = "y"
equation = "level + slope * x"
noise = "sigma"
[parameters]
sigma = { start = 0.5 }
"#;

const UNITS: &str = r#"
[data]
test = "unit"
levels = ["lot"]
[states.level]
[measurements.y]
column = "y"
equation = "level"
noise = 0.5
"#;

/// Sixteen units of three lots; slopes differ.
fn data() -> String {
    let mut text = "unit,lot,bench,x,y\n".to_owned();
    for j in 0..16 {
        let (level, slope) = (f64::from((j * 7) % 11) / 2.0, f64::from((j * 5) % 9 - 4) / 3.0);
        for x in 0..6 {
            let error = f64::from((3 * j + 5 * x) % 7 - 3) / 9.0;
            let y = level + slope * f64::from(x) + error;
            text.push_str(&format!("u{j:02},l{},b{},{x},{y}\n", j % 4, j % 2));
        }
    }
    text
}

fn folder() -> Folder {
    let data = data();
    let short: String = data.lines().take(1 + 6 * 15).map(|line| format!("{line}\n")).collect();
    let reader = LINES.replace("\"y\"", "\"x\"").replace("level + slope * x", "level + slope");
    let files = [
        ("m.toml", LINES),
        ("parallel.toml", PARALLEL),
        ("units.toml", UNITS),
        ("x.toml", &reader),
        ("d.csv", &data),
        ("short.csv", &short),
    ];
    Folder::new(&files.map(|(name, text)| (name, text.as_bytes())))
}

fn record(folder: &Folder, name: &str) -> ValidatedRecord {
    serde_json::from_str(&std::fs::read_to_string(folder.path(name)).unwrap()).unwrap()
}

#[test]
fn the_model_of_the_data_predicts_better_than_a_simpler_one() {
    let folder = folder();
    let output = folder.run("validate m.toml d.csv --folds 4 --against parallel.toml --out v.json");
    assert_snapshot!(shown(&output), @"
    exit 0
    ----- stdout
    Lines

    16 tests with 96 measured values in 4 folds, drawn with seed 1: each fold is
    predicted by a fit to the others.
    This model predicts better.

    Predictions of tests that were left out of the fit
      Log predictive density: -94.19488 ± 4.37, -0.9812 for each measured value.
      The fit to all tests gives -89.66934, which is 4.53 more than for tests that
        were left out.
      Of 96 measured values, each predicted from those before it in its test: 40.6 %
        within the 50 % interval, 91.7 % within the 90 % interval and 94.8 % within
        the 95 % interval.
      Initial states: 14 of 16 tests are within the 95 % limit of their distance
        from the population of the others.

    The other model
      Parallel lines: log predictive density -216.9494; the fit to all tests gives
        -208.1853.
      Difference, this model minus the other: 122.8 ± 10.1 over 16 tests (p = 4e-9).

    Folds
      fold  tests  log density
      1         4     -22.6802
      2         4     -22.5217
      3         4     -26.7323
      4         4     -22.2606

    The tests that are predicted worst
      name  fold  measured  log density  for each  other model
      u09   2            6     -7.66539    -1.278     -16.6044
      u00   3            6     -7.62325    -1.271     -18.2813
      u05   3            6     -7.44312    -1.241     -13.0998
      u07   1            6     -6.76024    -1.127     -20.5328
      u11   3            6     -6.59688    -1.099     -15.5814
      u14   1            6      -6.5037    -1.084     -17.8327
      u03   4            6     -6.01468    -1.002     -13.8813
      u12   4            6     -6.00773    -1.001     -12.9172

    How to read this
      The log predictive density of a test is the logarithm of the probability
        density of its measured values, given a fit without its fold. Larger is
        better; the standard error comes from the scatter between tests.
      The models are compared test by test on the same folds, so a test that is hard
        to predict for both does not count.
    ----- stderr
    Wrote v.json
    ");
    let record = record(&folder, "v.json");
    let other = record.against.as_ref().unwrap();
    let differences: Vec<f64> = record.pieces.iter().map(|one| one.log_density - one.against.unwrap()).collect();
    let sum: f64 = differences.iter().sum();
    assert!((other.difference - sum).abs() < 1e-9, "{} against {sum}", other.difference);
    let mean = sum / 16.0;
    let squares: f64 = differences.iter().map(|one| (one - mean).powi(2)).sum();
    let expected = (squares / 15.0 * 16.0).sqrt();
    assert!((other.std_error.unwrap() - expected).abs() < 1e-9, "{:?} against {expected}", other.std_error);
    assert!(record.log_density < record.fitted, "{} against {}", record.log_density, record.fitted);
    // the other way round it is the other way round
    let output = folder.run("validate parallel.toml d.csv --folds 4 --against m.toml --out back.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let back = self::record(&folder, "back.json").against.unwrap().difference;
    assert!((back + sum).abs() < 1e-6, "{back} against {sum}");
}

#[test]
fn a_column_makes_folds_and_groups_stay_whole() {
    let folder = folder();
    let output = folder.run("validate units.toml d.csv --by lot --out v.json --quiet");
    assert_eq!(output.status.code(), Some(0), "{}", shown(&output));
    let record = record(&folder, "v.json");
    assert_eq!(record.of, "lot");
    let names: Vec<&str> = record.pieces.iter().map(|piece| piece.name.as_str()).collect();
    assert_eq!(names, ["l0", "l1", "l2", "l3"]);
    assert_eq!(record.folds.iter().map(|fold| fold.tests).collect::<Vec<_>>(), [4, 4, 4, 4]);
    let drawn = folder.run("validate units.toml d.csv --out drawn.json --quiet");
    assert_eq!(drawn.status.code(), Some(0), "{}", shown(&drawn));
    let each = self::record(&folder, "drawn.json");
    assert_eq!(each.folds.len(), 4, "there are no more groups to leave out");
    assert!(
        (each.log_density - record.log_density).abs() < 1e-6,
        "{} against {}",
        each.log_density,
        record.log_density
    );
}

#[test]
fn mistakes_are_said_plainly() {
    let folder = folder();
    let run = |line: &str| shown(&folder.run(&format!("validate {line}")));
    assert_snapshot!(run("m.toml d.csv --against x.toml --by bench"), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: `x.toml` cannot be compared: it measures the columns x, the other model y

    hint: log densities are compared of the same measured values: both models must use the same columns
    "#);
    assert_snapshot!(run("units.toml d.csv --by unit"), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: tests of lot `l0` are in folds `u00` and `u04`, expected one fold for all of them

    hint: a fold holds whole groups: name a column that is the same for all tests of one
    "#);
    assert_snapshot!(run("m.toml d.csv --by colour"), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: d.csv has no column `colour`, which is used in `--by`

    hint: its columns are `unit`, `lot`, `bench`, `x`, `y`
    "#);
    assert_snapshot!(run("m.toml d.csv --by bench --seed 3"), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: the argument '--by <COLUMN>' cannot be used with '--seed <N>'

    Usage: kalfit validate --by <COLUMN> <MODEL> <DATA>...

    For more information, try '--help'.
    "#);
    let full = data();
    let empty = full.lines().enumerate().map(|(k, line)| match (k, line.rsplit_once(',')) {
        (1.., Some((head, _))) => format!("{head},\n"),
        _ => format!("{line}\n"),
    });
    folder.write("empty.csv", empty.collect::<String>().as_bytes());
    assert_snapshot!(run("units.toml empty.csv"), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: nothing was measured in any test
    "#);
    let output = folder.run_with_input("validate m.toml - --against units.toml", full.as_bytes());
    assert_snapshot!(shown(&output), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: standard input can be read only once, and `--against` validates a second model on the same data

    hint: put the data in a file, and name it in the place of `-`
    "#);
    assert_snapshot!(run("m.toml d.csv --folds 1"), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: invalid value '1' for '--folds <N>': 1 is not in 2..=4294967295

    For more information, try '--help'.
    "#);
}
