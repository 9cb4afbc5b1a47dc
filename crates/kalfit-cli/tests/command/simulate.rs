//! `kalfit simulate`: what it draws can be fitted again.

use crate::folder::{DATA, Folder, MODEL, shown};
use insta::assert_snapshot;
use kalfit::FitRecord;

const TRUTH: &str = "\n[mean]\nstart = { level = 1, slope = 0.5 }\n[covariance]\nstart = [[1, 0.2], [0.2, 0.25]]\n";

/// The sound model and data, with values for the model in `t.toml`.
fn folder(files: &[(&str, &str)]) -> Folder {
    let folder = Folder::new(&[("t.toml", format!("{MODEL}{TRUTH}").as_bytes())]);
    files.iter().for_each(|(name, text)| folder.write(name, text.as_bytes()));
    folder
}

/// Runs a command that must succeed; all that it said.
#[track_caller]
fn done(folder: &Folder, args: &str) -> String {
    let output = folder.run(args);
    assert_eq!(output.status.code(), Some(0), "`kalfit {args}`: {}", shown(&output));
    shown(&output)
}

fn text(folder: &Folder, name: &str) -> String {
    std::fs::read_to_string(folder.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn record(folder: &Folder, name: &str) -> FitRecord {
    serde_json::from_str(&text(folder, name)).expect("a record")
}

#[test]
fn an_ensemble_from_a_fit_gives_the_fit_back() {
    let folder = Folder::new(&[]);
    folder.copy("../../examples/gyro-bench/bench.toml");
    folder.copy("../../examples/gyro-bench/bench.csv");
    done(&folder, "fit bench.toml bench.csv --out true.json --quiet");
    let truth = record(&folder, "true.json");
    let mut likelihoods = Vec::new();
    for extension in ["csv", "tsv", "parquet", "arrow"] {
        let said = done(
            &folder,
            &format!(
                "simulate bench.toml --from true.json --design bench.csv --tests 600 --seed 3 --out s.{extension}"
            ),
        );
        assert!(said.contains(&format!("Wrote s.{extension}: 600 tests, ")), "{said}");
        done(&folder, &format!("fit bench.toml s.{extension} --out back.json --quiet"));
        let found = record(&folder, "back.json");
        likelihoods.push(found.log_likelihood.to_bits());
        let (a, b) = (&found.phases[0], &truth.phases[0]);
        for i in 0..3 {
            for (what, found, expected, error) in [
                ("mean", a.mean.estimate[i], b.mean.estimate[i], a.mean.std_error[i]),
                ("std dev", a.std_dev.estimate[i], b.std_dev.estimate[i], a.std_dev.std_error[i]),
            ] {
                let away = (found - expected) / error.expect("identified");
                assert!(away.abs() < 4.0, "{what} {i}: {found} against {expected}, {away:.1} standard errors");
            }
        }
    }
    assert!(likelihoods.windows(2).all(|pair| pair[0] == pair[1]), "every format holds the same bits");
}

#[test]
fn the_file_has_the_rows_of_the_design() {
    let data = "y,id,x,other\n1.1,007,0,k\n,007,1,k\n3.2,007,2.5,k\n0.4,b,0,\n";
    let folder = folder(&[("d.csv", data)]);
    assert_snapshot!(done(&folder, "simulate m.toml --from t.toml --design d.csv --seed 1 --out s.csv"), @"
    exit 0
    ----- stdout
    ----- stderr
    Wrote s.csv: 2 tests, 4 rows, drawn with seed 1
    ");
    let cells = |name: &str| -> Vec<Vec<String>> {
        text(&folder, name).lines().map(|line| line.split(',').map(str::to_owned).collect()).collect()
    };
    let drawn = cells("s.csv");
    assert_eq!(drawn[0], ["id", "y", "x"]);
    let known: Vec<String> = drawn[1..].iter().map(|row| format!("{} {}", row[0], row[2])).collect();
    assert_eq!(known, ["007 0", "007 1", "007 2.5", "b 0"]);
    assert_eq!(drawn[2][1], "", "missing stays missing");
    done(&folder, "simulate m.toml --from t.toml --design d.csv --seed 1 --tests 5 --out more.csv --truth xi.csv");
    let ids = |name: &str| {
        let mut ids: Vec<String> = cells(name)[1..].iter().map(|row| row[0].clone()).collect();
        ids.dedup();
        ids
    };
    assert_eq!(ids("more.csv"), ["007", "b", "007#2", "b#2", "007#3"]);
    assert_eq!(ids("xi.csv"), ids("more.csv"));
    assert_eq!(cells("xi.csv")[0], ["test", "level", "slope"]);
    done(&folder, "simulate m.toml --from t.toml --design d.csv --seed 1 --tests 5 --out more.csv --truth xi.parquet");
    assert!(std::fs::read(folder.path("xi.parquet")).expect("written").starts_with(b"PAR1"), "as its name says");
    assert_eq!(cells("more.csv")[1..5], drawn[1..5], "a longer ensemble begins with the shorter one");
    // x = 0 measures the level with a noise of 0.1
    for (row, xi) in [(1, 1), (4, 2)] {
        let number = |cell: &str| cell.parse::<f64>().expect("a number");
        let (y, level) = (number(&cells("more.csv")[row][1]), number(&cells("xi.csv")[xi][1]));
        assert!((y - level).abs() < 0.5, "{y} measures {level}");
    }
}

#[test]
fn one_seed_is_one_file_for_any_number_of_threads() {
    let folder = folder(&[]);
    let draw = |out: &str, more: &str| {
        done(&folder, &format!("simulate m.toml --from t.toml --design d.csv --tests 3000 --out {out} {more}"));
        text(&folder, out)
    };
    let one = draw("a.csv", "--seed 18446744073709551615 --threads 1");
    assert_eq!(one, draw("b.csv", "--seed 18446744073709551615 --threads 2"));
    assert_ne!(one, draw("c.csv", "--seed 1"));
}

#[test]
fn free_parameters_come_from_the_truth_and_set_comes_last() {
    let free = MODEL.replace("noise = 0.1", "noise = \"s\"") + "[parameters]\ns = { per = \"x\" }\n";
    let truth = format!("{}{TRUTH}", MODEL.replace("noise = 0.1", "noise = \"s\""))
        + "[parameters]\ns = { value = 0.1, per = \"x\", fixed = { 1 = 0.2 } }\n";
    let folder = folder(&[("m.toml", &free), ("t.toml", &truth)]);
    let draw = |out: &str, more: &str| {
        done(&folder, &format!("simulate m.toml --from t.toml --design d.csv --seed 1 --out {out} {more}"));
        let column = |line: &str| line.split(',').nth(1).and_then(|y| y.parse::<f64>().ok());
        text(&folder, out).lines().filter_map(column).collect::<Vec<f64>>()
    };
    let (plain, same, wider) = (draw("a.csv", ""), draw("b.csv", "--set s[1]=0.2"), draw("c.csv", "--set s[1]=0.4"));
    assert_eq!(plain, same);
    for k in 0..9 {
        // rows k = 1, 4, 7 have x = 1; there the noise is drawn with twice the standard deviation
        assert_eq!(plain[k] == wider[k], k % 3 != 1, "row {k}: {} and {}", plain[k], wider[k]);
    }
    // through a fit
    done(&folder, "fit m.toml d.csv --set s=0.1 --set s[1]=0.2 --out fit.json --quiet");
    done(&folder, "simulate m.toml --from fit.json --design d.csv --seed 1 --out d1.csv");
    done(&folder, "simulate m.toml --from fit.json --design d.csv --seed 1 --out d2.csv --set s=0.1 --set s[1]=0.2");
    assert_eq!(text(&folder, "d1.csv"), text(&folder, "d2.csv"));
}

#[test]
fn date_times_come_out_as_elapsed_time() {
    let model = MODEL.replace("test = \"id\"", "test = \"id\"\ntime = \"when\"\ntime_unit = \"min\"");
    let truth = format!("{model}{TRUTH}");
    let data = "id,when,x,y\na,2024-03-01T12:00:00,0,1\na,2024-03-01T12:01:30,1,2\nb,2024-03-02,0,1\n";
    let folder = folder(&[("m.toml", &model), ("t.toml", &truth), ("d.csv", data)]);
    done(&folder, "simulate m.toml --from t.toml --design d.csv --seed 1 --out s.csv --tests 40");
    let begins: Vec<String> =
        text(&folder, "s.csv").lines().take(4).map(|l| l.rsplitn(3, ',').nth(2).unwrap_or("").to_owned()).collect();
    assert_eq!(begins, ["id,when", "a,0", "a,1.5", "b,0"]);
    done(&folder, "fit m.toml s.csv --quiet");
}

#[test]
fn tests_that_are_files_or_one_get_a_column_of_ids() {
    let files = MODEL.replace("\"id\"", "\"@file\"");
    let truth = format!("{files}{TRUTH}");
    let rows = "x,y\n0,1\n1,2\n2,3\n";
    let folder = folder(&[("m.toml", &files), ("t.toml", &truth), ("run1.csv", rows), ("run2.csv", rows)]);
    assert_snapshot!(done(&folder, "simulate m.toml --from t.toml --design run1.csv run2.csv --tests 30 --seed 1 --out s.csv"), @r#"
    exit 0
    ----- stdout
    ----- stderr
    Wrote s.csv: 30 tests, 90 rows, drawn with seed 1
    The tests are told apart by column `test`: to fit this file, set `test = "test"` in `[data]`
    "#);
    folder.write("by_id.toml", MODEL.replace("\"id\"", "\"test\"").as_bytes());
    done(&folder, "fit by_id.toml s.csv --quiet");
    // one test without ids stays one test without ids
    let single = MODEL.replace("[data]\ntest = \"id\"\n", "");
    folder.write("m.toml", single.as_bytes());
    folder.write("t.toml", format!("{single}{TRUTH}").as_bytes());
    done(&folder, "simulate m.toml --from t.toml --design run1.csv --seed 1 --out one.csv");
    assert!(text(&folder, "one.csv").starts_with("y,x\n"), "{}", text(&folder, "one.csv"));
    let said = done(&folder, "simulate m.toml --from t.toml --design run1.csv --tests 2 --seed 1 --out two.csv");
    assert!(said.contains("column `test`") && text(&folder, "two.csv").contains("\nall#2,"), "{said}");
}

#[test]
fn differences_between_truth_and_model_are_said() {
    let model = |value: &str| MODEL.replace("noise = 0.1", "noise = \"q\"") + &format!("[parameters]\nq = {value}\n");
    let folder = folder(&[("d.csv", DATA), ("m.toml", &model("0.1"))]);
    done(&folder, "fit m.toml d.csv --out fit.json --quiet");
    folder.write("m.toml", model("0.2").as_bytes());
    assert_snapshot!(done(&folder, "simulate m.toml --from fit.json --design d.csv --seed 1 --out s.csv"), @"
    exit 0
    ----- stdout
    ----- stderr
    warning: `fit.json` was made with another version of `m.toml`
    warning: `q` is 0.2 in `m.toml` and 0.1 in `fit.json`: 0.2 is used
    Wrote s.csv: 3 tests, 9 rows, drawn with seed 1
    ");
    let said = done(&folder, "simulate m.toml --from fit.json --design d.csv --seed 1 --out s.csv --quiet");
    assert_eq!(said, "exit 0\n----- stdout\n----- stderr\n");
}
