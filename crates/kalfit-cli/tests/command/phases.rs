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
    assert_snapshot!(steady(&shown(&folder().run("fit phases.toml phases.csv --innovations off"))), @"
    exit 0
    ----- stdout
    Bench, then flight

    Data: 12 tests, 80 steps, 80 observations from phases.csv.
    Phases: bench (12 tests) and flight (8 of 12 tests); combined exactly, phase by
    phase (chain).

    Phase bench: initial state over the tests (± standard error)
      state  unit    mean          std dev
      bias   deg/h   0.80 ± 0.13     0.454 ± 0.094
      slope         0.506 ± 0.048    0.159 ± 0.035
      With 12 tests, ± 1.96 standard errors hold the mean about 91 % of the time;
        --criterion reml allows for that.

    Phase bench: correlations (± standard error)
                     bias
      slope  -0.38 ± 0.26

    Phase flight: initial state over the tests (± standard error)
      state  unit     mean          std dev
      bias   deg/h    0.58 ± 0.15      0.41 ± 0.11
      trend         -0.253 ± 0.045    0.120 ± 0.034

    Phase flight: correlations
      The states are held uncorrelated.

    Dynamic parameters (± standard error)
      parameter  value
      sigma        0.1 fixed

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates.
    Model check passed: the tests agree with the population (innovations were not
    computed). 2 tests are influential: the estimates depend on each of them.
    Log-likelihood 8.91, 9 free parameters, AIC 0.18, BIC 21.62.

    What to do next
      Check the data of tests r05 and r07 with care, because the estimates depend on
        them; the results file has the estimates without them.

    Constraints (score test of each one separately)
      element                          held at  dℓ/dvalue  p-value  if freed
      flight: covariance[bias, trend]        0      -37.2     0.49    -0.013
      The data do not contradict the constraint (5 % level).

    Outlying tests
      No test is an outlier: the smallest of 12 p-values is 0.03 (test r07), or 0.39
        after Bonferroni correction.

    Influence of single tests
      test  displacement  p-value without it
      r05           18.8                6e-7
      r07           14.2                2e-6
      Leaving any one of these tests out moves the estimates outside the 50 %
        confidence region of the full fit.
      Displacement (Cook's): twice the drop in the log-likelihood of all tests when
        the estimates from the other tests are used. The p-value says how well the
        test agrees with the estimates from the other tests.

    The tests have 2 different designs (times, inputs and missing values).
    Computation: solver newton, [work].
    ----- stderr
    ");
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
    assert!(said.contains("and ignores the"), "{said}");
}

#[test]
fn tests_that_lack_the_flight_have_one_phase() {
    let record = record(&folder(), "--deletion all");
    let names =
        |number: usize| -> Vec<&str> { record.tests.get(number).phases.iter().map(|phase| phase.name).collect() };
    assert_eq!(names(0), ["bench", "flight"]);
    assert_eq!(names(2), ["bench"]);
    assert_eq!(record.phases.iter().map(|phase| phase.tests).collect::<Vec<_>>(), [Some(12), Some(8)]);
    assert_eq!(record.tests.get(2).deletion.as_ref().unwrap().phases.len(), 2);
    let [constraint] = &record.constraints[..] else { panic!("{:?}", record.constraints) };
    assert_eq!((constraint.phase.as_str(), constraint.element.as_str()), ("flight", "covariance[bias, trend]"));
}

#[test]
fn one_phase_cannot_be_put_together_with_others() {
    let folder = Folder::new(&[]);
    assert_snapshot!(shown(&folder.run("fit m.toml d.csv --phases stacked")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: `--phases stacked` has no effect: the model has one phase

    hint: leave it out
    ");
    assert_snapshot!(shown(&folder.run("fit m.toml d.csv --phases marginal")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: `--phases marginal` has no effect: the model has one phase

    hint: leave it out
    ");
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
    assert_snapshot!(changed("r02,flight,0", "r02,fligth,0"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: phases.csv, row 15 (test `r02`): found phase `fligth` in column `phase`, expected `bench`, `flight`

    hint: add the phase to the model, or leave its rows out
    ");
    assert_snapshot!(changed("r02,flight,0", "r02,,0"), @"
    exit 2
    ----- stdout
    ----- stderr
    error: phases.csv, row 15 (test `r02`): the cell of phase column `phase` is empty, expected `bench`, `flight`

    hint: every row belongs to one phase: write its name
    ");
    assert_snapshot!(changed("id,phase", "id,leg"), @r#"
    exit 2
    ----- stdout
    ----- stderr
    error: phases.csv has no column `phase`, which is used in `phase` in `[data]`
      --> phases.toml:5:9 | phase = "phase"
                          |         ^^^^^^^ this column is not in the data

    hint: its columns are `id`, `leg`, `x`, `y`
    "#);
}

#[test]
fn a_test_without_an_earlier_phase_is_refused() {
    let folder = folder();
    let data = text(&folder, "phases.csv");
    let kept: Vec<&str> = data.lines().filter(|line| !line.starts_with("r02,bench")).collect();
    folder.write("phases.csv", kept.join("\n").as_bytes());
    assert_snapshot!(shown(&folder.run("fit phases.toml phases.csv")), @"
    exit 2
    ----- stdout
    ----- stderr
    error: phases.csv, row 10 (test `r02`): phase `flight` follows phase `bench`, of which the test has no row

    hint: later phases may be missing, earlier ones not: a row with empty cells is a phase in which nothing was measured
    ");
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
    assert_snapshot!(shown(&folder().run("check phases.toml phases.csv")), @"
    exit 0
    ----- stdout
    Bench, then flight

    Model
      tests: one for each value of column `id`
      steps: one for each row
      phases: `bench`, then `flight`; column `phase` tells the phase of a row
      parameter `sigma`: fixed at 0.1, not negative
      phase `bench`: x_0 is at its first row
      state `bias` [deg/h]: constant; start estimated
      state `slope`: constant; start estimated
      measurement `y`: column `y` reads bias + x * slope; noise of standard
        deviation sigma
      order of μ and Σ: bias, slope
      covariance Σ: full
      phase `flight`: x_0 is at its first row
      state `bias` [deg/h]: constant; start estimated
      state `trend`: constant; start estimated
      state `bias` inherits bias, as phase `bench` ends
      measurement `y`: column `y` reads bias + x * trend; noise of standard
        deviation sigma
      order of μ and Σ: bias, trend
      covariance Σ: diagonal

    Data
      12 tests, 80 steps, 80 observations from phases.csv. The tests have 2
        different designs (times, inputs and missing values).

      phase     tests  rows
      bench    all 12    48
      flight  8 of 12    32

    Phase bench: observability
      state  seen by  determined by  largest share
      bias    all 12         all 12  all equal
      slope   all 12         all 12  all equal
      Seen by: tests whose measurements depend on the state. Determined by: tests
        that could estimate it by themselves. Largest share: the test with the most
        information on the mean, and its part of all information.

    Phase bench: identifiability
      The data identify all free elements of the mean and the covariance.

    Phase flight: observability
      state  seen by  determined by  largest share
      bias     all 8          all 8  all equal
      trend    all 8          all 8  all equal
      Seen by: tests whose measurements depend on the state. Determined by: tests
        that could estimate it by themselves. Largest share: the test with the most
        information on the mean, and its part of all information.

    Phase flight: identifiability
      The data identify all free elements of the mean and the covariance.

    What the phases observe
      phase   observed by itself  observed so far
      bench   2 of 2              2 of 2
      flight  2 of 2              4 of 4
      Number of directions that the tests together observe. By itself: of all states
        that enter the phase (its own and inherited ones). So far: of the estimated
        states of this and all earlier phases.
      From phase bench on: bench.slope and bench.bias.
      From phase flight on: flight.bias and flight.trend.
    ----- stderr
    ");
}

#[test]
fn a_check_of_phases_with_a_parameter_that_has_no_value() {
    let folder = folder();
    let model = text(&folder, "phases.toml").replace("sigma = 0.1", "sigma = {}");
    folder.write("phases.toml", model.as_bytes());
    let said = shown(&folder.run("check phases.toml phases.csv"));
    assert!(said.contains("flight  8 of 12    32"), "{said}");
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
