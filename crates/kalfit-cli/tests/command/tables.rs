//! `kalfit fit --tests --parameters --constraints`: the numbers of fit.json as tables.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use std::collections::HashMap;

use insta::assert_snapshot;
use kalfit::FitRecord;

use crate::folder::{Folder, shown};

/// Two lots of three units of two runs, and a covariance that is held.
const MODEL: &str = r#"
[data]
test = "run"
levels = ["lot"]
[states.bias]
unit = "deg/h"
[states.scale]
[measurements.y]
column = "y"
equation = "bias + scale * x"
noise = "sigma"
[covariance]
structure = "diagonal"
[levels.lot.covariance]
states = ["bias"]
[parameters]
sigma = { start = 0.3, unit = "deg/h" }
"#;

fn data() -> String {
    let wave = |k: i32| f64::from((k * 7919 + 13) % 101 - 50) / 50.0;
    let mut text = "lot,run,x,y\n".to_owned();
    for lot in 0..6 {
        for run in 0..4 {
            let (bias, scale) = (2.0 * wave(lot * 17 + 3) + wave(lot * 31 + run * 7), 0.5 * wave(run * 41 + lot));
            for k in 0..8 {
                let y = bias + scale * f64::from(k - 3) + 0.3 * wave(lot * 57 + run * 29 + k * 5);
                text += &format!("l{lot},l{lot}r{run},{},{y}\n", k - 3);
            }
        }
    }
    text
}

fn folder() -> Folder {
    Folder::new(&[("m.toml", MODEL.as_bytes()), ("d.csv", data().as_bytes())])
}

fn record(folder: &Folder) -> FitRecord {
    serde_json::from_slice(&std::fs::read(folder.path("fit.json")).unwrap()).unwrap()
}

type Row = HashMap<String, String>;

fn rows(folder: &Folder, name: &str) -> Vec<Row> {
    let mut reader = csv::Reader::from_path(folder.path(name)).unwrap();
    let head = reader.headers().unwrap().clone();
    let distinct: std::collections::BTreeSet<&str> = head.iter().collect();
    assert_eq!(distinct.len(), head.len(), "each column once: {head:?}");
    let row = |row: csv::StringRecord| head.iter().zip(row.iter()).map(|(k, v)| (k.to_owned(), v.to_owned())).collect();
    reader.records().map(|found| row(found.unwrap())).collect()
}

/// What the cell says, or nothing.
fn number(row: &Row, column: &str) -> Option<f64> {
    Some(&row[column]).filter(|cell| !cell.is_empty()).map(|cell| cell.parse().unwrap())
}

#[test]
fn tables_have_the_numbers_of_the_results() {
    let folder = folder();
    let output = folder
        .run("fit m.toml d.csv --out fit.json --tests t.csv --parameters p.csv --constraints c.csv --deletion all");
    let said = shown(&output);
    assert!(
        output.status.success() && said.ends_with("Wrote fit.json\nWrote t.csv\nWrote p.csv\nWrote c.csv\n"),
        "{said}"
    );
    let fit = record(&folder);
    let tests = rows(&folder, "t.csv");
    assert_eq!(tests.len(), fit.tests.len());
    for (row, test) in tests.iter().zip(fit.tests.iter()) {
        let place = ["test", "lot", "phase"].map(|column| row[column].as_str());
        assert_eq!(place, [test.id, &test.groups[0], "main"]);
        let (seen, without) = (test.innovations.as_ref().unwrap(), test.deletion.as_ref());
        for (column, expected) in [
            ("log_likelihood", Some(test.log_likelihood)),
            ("observations", Some(test.observations as f64)),
            ("distance", test.distance),
            ("p_value", test.p_value),
            ("nis", seen.nis),
            ("nis_p_value", seen.nis_p_value),
            ("displacement", without.map(|own| own.displacement)),
            ("log_density_without", without.map(|own| own.log_density)),
            ("mean[bias]", Some(test.phases.get(0).mean[0])),
            ("std_dev[scale]", Some(test.phases.get(0).covariance[1][1].sqrt())),
        ] {
            assert_eq!(number(row, column), expected, "{column} of {}", test.id);
        }
    }
    let constraints = rows(&folder, "c.csv");
    assert!(!constraints.is_empty() && constraints.len() == fit.constraints.len());
    for (row, own) in constraints.iter().zip(&fit.constraints) {
        assert_eq!((&row["element"], &row["phase"]), (&own.element, &own.phase));
        assert_eq!(row["level"], own.level.clone().unwrap_or_default());
        assert_eq!(number(row, "value"), Some(own.value));
        assert_eq!(number(row, "score_statistic"), own.score_statistic);
        assert_eq!(number(row, "p_value"), own.p_value);
    }
}

#[test]
fn the_table_of_the_parameters_has_each_number_once() {
    let folder = folder();
    let output = folder.run("fit m.toml d.csv --out fit.json --parameters p.csv --quiet");
    assert!(output.status.success(), "{}", shown(&output));
    let (fit, rows) = (record(&folder), rows(&folder, "p.csv"));
    let names: std::collections::BTreeSet<&String> = rows.iter().map(|row| &row["name"]).collect();
    assert_eq!(names.len(), rows.len(), "each name once");
    let row = |name: &str| rows.iter().find(|row| row["name"] == name).unwrap_or_else(|| panic!("{name}: {names:?}"));
    let same = |name: &str, estimate: f64, std_error: Option<f64>, interval: kalfit::record::Interval| {
        let (row, [lower, upper]) = (row(name), interval.unwrap_or_default());
        assert_eq!(number(row, "estimate"), Some(estimate), "{name}");
        let found = ["std_error", "lower", "upper"].map(|column| number(row, column));
        assert_eq!(found, [std_error, lower, upper], "{name}");
    };
    let (mean, [lot, own]) = (&fit.phases[0].mean, [&fit.levels[0], &fit.levels[1]]);
    same("mean[scale]", mean.estimate[1], mean.std_error[1], mean.interval95[1]);
    for (name, level, i) in [("lot: std_dev[bias]", lot, 0), ("std_dev[bias]", own, 0), ("std_dev[scale]", own, 1)] {
        same(name, level.std_dev.estimate[i], level.std_dev.std_error[i], level.std_dev.interval95[i]);
    }
    same(
        "covariance[scale, scale]",
        own.covariance.estimate[1][1],
        own.covariance.std_error[1][1],
        own.covariance.interval95[1][1],
    );
    let sigma = &fit.parameters[0];
    same("sigma", sigma.estimate, sigma.std_error, sigma.interval95);
    assert_eq!((row("sigma")["unit"].as_str(), row("sigma")["kind"].as_str()), ("deg/h", "parameter"));
    let shown: String =
        rows.iter().map(|row| format!("{}, {}: {}\n", row["name"], row["level"], row["status"])).collect();
    assert_snapshot!(shown, @"
    mean[bias], : estimated
    mean[scale], : estimated
    lot: std_dev[bias], lot: estimated
    lot: std_dev[scale], lot: fixed
    lot: covariance[bias, bias], lot: estimated
    lot: covariance[bias, scale], lot: fixed
    lot: covariance[scale, scale], lot: fixed
    lot: correlation[bias, scale], lot: undefined
    std_dev[bias], tests: estimated
    std_dev[scale], tests: estimated
    covariance[bias, bias], tests: estimated
    covariance[bias, scale], tests: fixed
    covariance[scale, scale], tests: estimated
    correlation[bias, scale], tests: fixed
    sigma, : estimated
    ");
}

#[test]
fn the_same_table_comes_in_every_format() {
    let folder = folder();
    for name in ["p.csv", "p.tsv", "p.parquet", "p.arrow"] {
        let output = folder.run(&format!("fit m.toml d.csv --parameters {name} --quiet"));
        assert!(output.status.success(), "{}", shown(&output));
    }
    let (comma, tab) = (
        std::fs::read_to_string(folder.path("p.csv")).unwrap(),
        std::fs::read_to_string(folder.path("p.tsv")).unwrap(),
    );
    assert_eq!(comma.lines().count(), tab.lines().count());
    assert!(std::fs::read(folder.path("p.parquet")).unwrap().starts_with(b"PAR1"));
    assert!(std::fs::read(folder.path("p.arrow")).unwrap().starts_with(b"ARROW1"));
}

#[test]
fn files_that_cannot_be_are_refused_before_the_work() {
    let folder = folder();
    let before = folder.contents();
    let refused = |args: &str| {
        let output = folder.run(&format!("fit m.toml d.csv {args}"));
        let said = shown(&output);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert_eq!(before, folder.contents(), "`{args}` left the folder as it was");
        String::from_utf8(output.stderr).unwrap()
    };
    assert_snapshot!(refused("--tests t.csv --parameters t.csv"), @"
    error: both outputs are `t.csv`, expected two files

    hint: give the output a name of its own
    ");
    assert_snapshot!(refused("--out fit.json --constraints d.csv"), @"
    error: the output `d.csv` is one of the inputs

    hint: give the output a name of its own
    ");
    assert_snapshot!(refused("--parameters p.json"), @"error: cannot tell the format of `p.json`: found `.json`, expected one of `.csv`, `.tsv`, `.parquet`, `.arrow`");
    assert_snapshot!(refused("--tests no/t.csv"), @"
    error: the folder `no` for the output does not exist

    hint: name a folder that exists
    ");
    assert_snapshot!(refused("--tests t.csv --no-tests"), @"
    error: the argument '--tests <FILE>' cannot be used with '--no-tests'

    Usage: kalfit fit --tests <FILE> <MODEL> <DATA>...

    For more information, try '--help'.
    ");
}

/// A table without rows would say that every measurement agrees with the others.
#[test]
fn rows_that_were_not_examined_are_no_empty_table() {
    let folder = Folder::new(&[]);
    folder.copy("../../examples/random-coefficients/sleepstudy.toml");
    folder.copy("../../examples/random-coefficients/sleepstudy.csv");
    let fit = |options: &str| {
        folder.run(&format!("fit sleepstudy.toml sleepstudy.csv --set sigma=25.6 --rows rows.csv {options}"))
    };
    for (option, said) in [
        (
            "--innovations off",
            "`--rows` has nothing to write: single measurements are examined by innovations, which are off",
        ),
        ("--no-tests", "cannot be used with"),
    ] {
        let output = fit(option);
        assert_eq!(output.status.code(), Some(2), "{option}");
        assert!(shown(&output).contains(said), "{option}: {}", shown(&output));
        assert!(!folder.path("rows.csv").exists(), "{option}");
    }
    assert_eq!(fit("").status.code(), Some(0));
    let table = folder.table("rows.csv");
    assert_eq!((table[0]["test"].as_str(), table[0]["row"].as_str()), ("332", "58"));
}
