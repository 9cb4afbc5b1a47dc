//! `kalfit validate` through the built command.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use insta::assert_snapshot;
use kalfit::record::ValidatedRecord;

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
kind = "diagonal"
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
    assert_snapshot!(shown(&output), @"");
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
    assert_snapshot!(run("m.toml d.csv --against x.toml --by bench"), @"");
    assert_snapshot!(run("units.toml d.csv --by unit"), @"");
    assert_snapshot!(run("m.toml d.csv --by colour"), @"");
    assert_snapshot!(run("m.toml d.csv --by bench --seed 3"), @"");
    assert_snapshot!(run("m.toml d.csv --folds 1"), @"");
}
