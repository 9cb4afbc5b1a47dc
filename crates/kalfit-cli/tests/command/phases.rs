//! Tests in several phases: fits, checks, hypotheses, and what is refused of them.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use insta::assert_snapshot;
use kalfit::FitRecord;

use crate::folder::{Folder, shown, steady};

/// A bench phase that all of twelve tests have, and a flight that eight of them have.
fn folder() -> Folder {
    let folder = Folder::new(&[]);
    ["tests/data/phases.toml", "tests/data/phases.csv"].iter().for_each(|path| folder.copy(path));
    folder
}

fn text(folder: &Folder, name: &str) -> String {
    std::fs::read_to_string(folder.path(name)).unwrap()
}

fn record(folder: &Folder, options: &str) -> FitRecord {
    let output = folder.run(&format!("fit phases.toml phases.csv --quiet --out fit.json {options}"));
    assert!(output.status.success(), "{options}: {}", shown(&output));
    serde_json::from_str(&text(folder, "fit.json")).unwrap()
}

#[test]
fn a_summary_of_two_phases() {
    assert_snapshot!(steady(&shown(&folder().run("fit phases.toml phases.csv --innovations off"))), @"");
}

#[test]
fn chain_and_stacked_are_one_fit_and_marginal_is_another() {
    let folder = folder();
    let (chain, stacked, marginal) =
        (record(&folder, ""), record(&folder, "--phases stacked"), record(&folder, "--phases marginal"));
    let kinds: Vec<&str> = [&chain, &stacked, &marginal].iter().map(|r| r.solver.phases.as_str()).collect();
    assert_eq!(kinds, ["chain", "stacked", "marginal"]);
    let gap = (chain.log_likelihood - stacked.log_likelihood).abs();
    assert!(gap < 1e-8, "{} {}", chain.log_likelihood, stacked.log_likelihood);
    for (a, b) in chain.phases.iter().zip(&stacked.phases) {
        for (x, y) in a.mean.estimate.iter().zip(&b.mean.estimate) {
            assert!((x - y).abs() < 1e-6, "phase {}: {x} {y}", a.name);
        }
    }
    assert!(chain.composite_log_likelihood.is_none() && chain.aic.is_some());
    assert!(marginal.composite_log_likelihood.is_some_and(f64::is_finite));
    assert!(marginal.aic.is_none() && marginal.bic.is_none(), "ℓ is not what was maximised");
    assert!(marginal.log_likelihood < chain.log_likelihood, "{}", marginal.log_likelihood);
    let said = shown(&folder.run("fit phases.toml phases.csv --phases marginal"));
    assert!(said.contains("the correlation of their errors is"), "{said}");
}

#[test]
fn tests_that_lack_the_flight_have_one_phase() {
    let record = record(&folder(), "--deletion all");
    let names = |test: &kalfit::record::TestRecord| -> Vec<String> {
        test.phases.iter().map(|phase| phase.name.clone()).collect()
    };
    assert_eq!(names(&record.tests[0]), ["bench", "flight"]);
    assert_eq!(names(&record.tests[2]), ["bench"]);
    assert_eq!(record.phases.iter().map(|phase| phase.tests).collect::<Vec<_>>(), [Some(12), Some(8)]);
    assert_eq!(record.tests[2].deletion.as_ref().unwrap().phases.len(), 2);
    let [constraint] = &record.constraints[..] else { panic!("{:?}", record.constraints) };
    assert_eq!((constraint.phase.as_str(), constraint.element.as_str()), ("flight", "covariance[bias, trend]"));
}

#[test]
fn one_phase_cannot_be_put_together_with_others() {
    let folder = Folder::new(&[]);
    assert_snapshot!(shown(&folder.run("fit m.toml d.csv --phases stacked")), @"");
    assert_snapshot!(shown(&folder.run("fit m.toml d.csv --phases marginal")), @"");
    assert!(folder.run("fit m.toml d.csv --phases chain --quiet").status.success());
}

/// The data with one text replaced, once.
fn changed(from: &str, to: &str) -> String {
    let folder = folder();
    let data = text(&folder, "phases.csv");
    assert!(data.contains(from), "`{from}` is in the data");
    folder.write("phases.csv", data.replacen(from, to, 1).as_bytes());
    let output = folder.run("fit phases.toml phases.csv --out fit.json");
    assert!(!folder.path("fit.json").exists());
    shown(&output)
}

#[test]
fn rows_of_no_phase_are_refused() {
    assert_snapshot!(changed("r02,flight,0", "r02,fligth,0"), @"");
    assert_snapshot!(changed("r02,flight,0", "r02,,0"), @"");
    assert_snapshot!(changed("id,phase", "id,leg"), @"");
}

#[test]
fn a_test_without_an_earlier_phase_is_refused() {
    let folder = folder();
    let data = text(&folder, "phases.csv");
    let kept: Vec<&str> = data.lines().filter(|line| !line.starts_with("r02,bench")).collect();
    folder.write("phases.csv", kept.join("\n").as_bytes());
    assert_snapshot!(shown(&folder.run("fit phases.toml phases.csv")), @"");
}

#[test]
fn rows_of_phases_may_stand_in_any_order() {
    let folder = folder();
    let whole = record(&folder, "");
    let data = text(&folder, "phases.csv");
    let (header, rows) = data.split_once('\n').unwrap();
    let (flight, bench): (Vec<&str>, Vec<&str>) = rows.lines().partition(|row| row.contains("flight"));
    let rows: Vec<&str> = flight.into_iter().chain(bench).collect();
    folder.write("phases.csv", format!("{header}\n{}\n", rows.join("\n")).as_bytes());
    let mixed = record(&folder, "");
    assert_eq!(mixed.phases, whole.phases);
    assert_eq!(mixed.log_likelihood, whole.log_likelihood);
}

#[test]
fn a_check_of_two_phases() {
    assert_snapshot!(shown(&folder().run("check phases.toml phases.csv")), @"");
}

#[test]
fn a_check_of_phases_with_a_parameter_that_has_no_value() {
    let folder = folder();
    let model = text(&folder, "phases.toml").replace("sigma = 0.1", "sigma = {}");
    folder.write("phases.toml", model.as_bytes());
    let said = shown(&folder.run("check phases.toml phases.csv"));
    assert!(said.contains("flight   8 of 12    32"), "{said}");
}

#[test]
fn a_parameter_of_both_phases_is_found() {
    let folder = folder();
    let known = record(&folder, "");
    let model = text(&folder, "phases.toml").replace("sigma = 0.1", "sigma = { start = 0.3 }");
    folder.write("phases.toml", model.as_bytes());
    let free = record(&folder, "");
    let [sigma] = &free.parameters[..] else { panic!("{:?}", free.parameters) };
    let error = sigma.std_error.unwrap();
    assert!((sigma.estimate - 0.1).abs() < 4.0 * error, "{} ± {error}", sigma.estimate);
    assert!(free.log_likelihood > known.log_likelihood, "{} {}", free.log_likelihood, known.log_likelihood);
    assert_eq!(free.free_parameters, known.free_parameters + 1);
    let said = shown(&folder.run("fit phases.toml phases.csv --phases marginal"));
    assert!(said.starts_with("exit 2"), "{said}");
}

#[test]
fn a_hypothesis_about_one_phase() {
    let folder = folder();
    folder.write("null.toml", b"[phases.flight.mean]\nfixed = { trend = 0 }\n");
    let output = folder.run("test phases.toml phases.csv --null null.toml --out test.json --bootstrap 20");
    assert!(output.status.success(), "{}", shown(&output));
    let record: kalfit::record::RatioRecord = serde_json::from_str(&text(&folder, "test.json")).unwrap();
    assert_eq!(record.null.states, ["bench.bias", "bench.slope", "flight.bias", "flight.trend"]);
    assert_eq!(record.null.mean[3], 0.0);
    assert_eq!(record.df, 1);
    assert_eq!(record.bootstrap.unwrap().failed, 0);
    let model = text(&folder, "phases.toml").replace("sigma = 0.1", "sigma = { start = 0.1 }");
    folder.write("phases.toml", model.as_bytes());
    let output = folder.run("test phases.toml phases.csv --null null.toml --out test.json --bootstrap 5");
    assert!(output.status.success(), "{}", shown(&output));
    let free: kalfit::record::RatioRecord = serde_json::from_str(&text(&folder, "test.json")).unwrap();
    assert_eq!((free.df, free.null.parameters.len()), (1, 1));
}
