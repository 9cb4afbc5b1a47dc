//! Whole commands on sound input.

use std::process::Stdio;

use crate::folder::{DATA, Folder, shown, steady};
use insta::assert_snapshot;
use kalfit::FitRecord;

/// Model and data by the same name: those of the repository, then those of these tests; and the options they need.
const EXAMPLES: [(&str, &str); 6] = [
    ("random-coefficients/sleepstudy", "--set sigma=25.59182"),
    ("meta-analysis/berkey1998", ""),
    ("gyro-bench/bench", ""),
    ("vaccine", ""),
    ("gyro", "--set tau=200"),
    ("sensors", ""),
];

/// An example in a folder of its own.
pub(crate) fn example(name: &str) -> Folder {
    let folder = Folder::new(&[]);
    let base = if name.contains('/') { "../../examples" } else { "tests/data" };
    folder.copy(&format!("{base}/{name}.toml"));
    folder.copy(&format!("{base}/{name}.csv"));
    folder
}

/// The name without its folder.
fn stem(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

/// Fits an example; what was printed, and the record.
pub(crate) fn fit(name: &str, options: &str) -> (String, FitRecord) {
    let folder = example(name);
    let name = stem(name);
    let output = folder.run(&format!("fit {name}.toml {name}.csv --out fit.json {options}"));
    let text =
        std::fs::read_to_string(folder.path("fit.json")).unwrap_or_else(|error| panic!("{error}\n{}", shown(&output)));
    (shown(&output), serde_json::from_str(&text).expect("fit.json is a record: no number in it is null"))
}

#[test]
fn sleep_study_has_the_figures_of_lme4() {
    let (text, record) = fit("random-coefficients/sleepstudy", "--set sigma=25.59182");
    let expected = [
        ("log-likelihood", record.log_likelihood, -875.9697),
        ("intercept", record.phases[0].mean.estimate[0], 251.4051),
    ];
    for (what, found, expected) in expected {
        assert!((found - expected).abs() < 1e-4, "{what}: found {found}, lme4 has {expected}");
    }
    assert_snapshot!(steady(&text), @r#"
    exit 0
    ----- stdout
    Reaction time under sleep deprivation

    Data: 18 tests, 180 steps, 180 observations from sleepstudy.csv.

    Initial state over the tests (± standard error)
      state      unit     mean        std dev
      intercept  ms      251.4 ± 6.6     23.8 ± 5.5
      slope      ms/day   10.5 ± 1.5      5.7 ± 1.2
      With 18 tests, ± 1.96 standard errors hold the mean about 92 % of the time;
        --criterion reml allows for that.

    Correlations (± standard error)
               intercept
      slope  0.08 ± 0.32

    Dynamic parameters (± standard error)
      parameter  unit    value
      sigma      ms    25.5918 fixed

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates.
    Model check doubtful: the innovations of 3 of 18 tests are improbable (size or
    correlation from row to row); `reaction` in row 58 (test 332) is 5.5 standard
    deviations from what the other rows of the test say, and one more row is as
    strange; the innovations are not normal.
    Log-likelihood -875.97, 5 free parameters, AIC 1761.94, BIC 1777.90.

    What to do next
      Let noise levels differ between tests (`per = "test"`, or `per` a column), or
        look for faults in the tests named under Innovations.
      Add a process for what is correlated from row to row, such as a random walk or
        a state with `next`, or another one beside it.
      Look at the rows listed under Misfit in the data files; correct them, or leave
        the cells empty.
      Look at the innovations in the report: a few far values, or noise levels that
        differ, make them far from normal.

    Outlying tests
      No test is an outlier: the smallest of 18 p-values is 0.08 (test 309), or 1
        after Bonferroni correction.

    Influence of single tests
      No single test is influential. Test 309 moves the estimates most: its Cook's
        displacement is 1.3, and 4.4 is the edge of the 50 % confidence region.

    Innovations (measured minus predicted)
      test  what                        found  expected  p-value    Holm
      332   larger than modelled         45.5        10     4e-6  0.0001
      309   correlated from row to row   15.7         2   0.0003   0.009
      335   correlated from row to row   14.9         2   0.0004    0.01
      These are improbable at the 1.8 % level, after Holm correction for 36
        p-values: a size that differs from the model suggests other noise levels, or
        faults in the test; correlation from row to row suggests a missing process,
        such as a drift.
      Mean square of all 180 innovations, each divided by its standard deviation:
        1.00 (expected 1 ± 0.11).

    Misfit that tests have in common, and single rows
      The innovations are not normal (Shapiro-Francia p = 5e-6): intervals of levels
        and Σ are then too short or too long.
      test  row  measurement  deviation  p, all rows
      332    58  reaction      151 ± 27         2e-6
      308     9  reaction     -120 ± 28        0.002
      Each of these values contradicts all other values of its test; at most one of
        a test is listed.

    All tests have the same design (times, inputs and missing values).
    Computation: solver newton, [work].
    ----- stderr
    Wrote fit.json
    "#);
}

#[test]
fn meta_analysis_has_the_figures_of_metafor() {
    let (text, record) = fit("meta-analysis/berkey1998", "");
    let mean = &record.phases[0].mean.estimate;
    let expected = [
        ("log-likelihood", record.log_likelihood, 5.8406568847751),
        ("PD", mean[0], 0.344839168023),
        ("AL", mean[1], -0.337938115107),
    ];
    for (what, found, expected) in expected {
        assert!((found - expected).abs() < 1e-7, "{what}: found {found}, metafor has {expected}");
    }
    assert_snapshot!(steady(&text), @"
    exit 0
    ----- stdout
    Surgical against non-surgical treatment of periodontal disease

    Data: 5 tests, 5 steps, 10 observations from berkey1998.csv.

    Initial state over the tests (± standard error)
      state  unit    mean          std dev
      PD     mm     0.345 ± 0.054    0.084 ± 0.054
      AL     mm    -0.338 ± 0.081    0.162 ± 0.055
      With 5 tests, ± 1.96 standard errors hold the mean about 85 % of the time;
        --criterion reml allows for that.

    Correlations (± standard error)
                   PD
      AL  0.70 ± 0.45

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates.
    Model check passed: innovations and tests agree with the model. Test 2 is
    influential: the estimates depend on it.
    Log-likelihood 5.84, 5 free parameters, AIC -1.68, BIC -0.17.

    What to do next
      Check the data of test 2 with care, because the estimates depend on it; the
        results file has the estimates without it.

    Outlying tests
      No test is an outlier: the smallest of 5 p-values is 0.20 (test 5), or 1 after
        Bonferroni correction.

    Influence of single tests
      test  displacement  p-value without it
      2             10.3              0.0002
      Leaving this test out moves the estimates outside the 50 % confidence region
        of the full fit.
      Displacement (Cook's): twice the drop in the log-likelihood of all tests when
        the estimates from the other tests are used. The p-value says how well the
        test agrees with the estimates from the other tests.

    Innovations (measured minus predicted)
      Mean square of all 10 innovations, each divided by its standard deviation:
        1.08 (expected 1 ± 0.45).
      Innovation checks passed for all tests (smallest p = 0.41, size in 5; 1 after
        Holm correction for 5 tests).

    Notes
      The variance of `PD` is weakly determined: its standard error (0.00905) is no
        smaller than the variance itself (0.007002).

    Every test has its own design (times, inputs and missing values).
    Computation: solver newton, [work].
    ----- stderr
    Wrote fit.json
    ");
}

#[test]
fn gyro_bench_finds_the_error_model_behind_the_simulated_data() {
    assert_snapshot!(steady(&fit("gyro-bench/bench", "").0), @"
    exit 0
    ----- stdout
    Gyros on two bench stations

    Data: 28 tests, 614 steps, 614 observations from bench.csv.

    Initial state over the tests (± standard error)
      state          unit      mean          std dev
      bias           deg/h     0.62 ± 0.15      0.77 ± 0.11
      scale          ppm       47.5 ± 6.6       29.0 ± 5.1
      g_sensitivity  deg/h/g  0.271 ± 0.077    0.313 ± 0.057
      With 28 tests, ± 1.96 standard errors hold the mean about 93 % of the time;
        --criterion reml allows for that.

    Correlations (± standard error)
                             bias         scale
      scale           0.49 ± 0.18
      g_sensitivity  -0.14 ± 0.25  -0.62 ± 0.18

    Dynamic parameters (± standard error)
      parameter    unit   value
      tau          h        0.5 fixed
      sigma_drift  deg/h   0.15 fixed
      noise_a      deg/h   0.06 fixed
      noise_b      deg/h    0.1 fixed

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates.
    Model check passed: innovations and tests agree with the model. Test g07 is
    influential: the estimates depend on it.
    Log-likelihood 377.11, 9 free parameters, AIC -736.23, BIC -696.45.

    What to do next
      Check the data of test g07 with care, because the estimates depend on it; the
        results file has the estimates without it.

    Outlying tests
      No test is an outlier: the smallest of 28 p-values is 0.09 (test g23), or 1
        after Bonferroni correction.

    Influence of single tests
      test  displacement  p-value without it
      g07             23                1e-7
      Leaving this test out moves the estimates outside the 50 % confidence region
        of the full fit.
      Displacement (Cook's): twice the drop in the log-likelihood of all tests when
        the estimates from the other tests are used. The p-value says how well the
        test agrees with the estimates from the other tests.

    Innovations (measured minus predicted)
      Mean square of all 614 innovations, each divided by its standard deviation:
        1.106 (expected 1 ± 0.057).
      Innovation checks passed for all tests (smallest p = 0.006, time correlation
        in g28; 0.33 after Holm correction for 54 tests).

    Groups by station
      station  tests  mean square  p-value  distance²  expected  p-value
      A           15        1.162     0.05       30.3        28     0.35
      B           13        1.048     0.55       30.3        32     0.55

    Notes
      State `scale` is in ppm, but the equation of measurement `rate` multiplies it
        by a column without the factor 1e-6: is `1e-6 * scale` meant?

    Every test has its own design (times, inputs and missing values). 8 tests needed
    the more accurate square-root filter.
    Computation: solver newton, [work].
    ----- stderr
    Wrote fit.json
    ");
}

#[test]
fn vaccine_trials_with_a_regression() {
    assert_snapshot!(steady(&fit("vaccine", "").0), @"
    exit 0
    ----- stdout
    BCG vaccine against tuberculosis, log risk ratios

    Data: 13 tests, 13 steps, 13 observations from vaccine.csv.

    Initial state over the tests (± standard error)
      state   mean         std dev
      effect  0.28 ± 0.19     0.19 ± 0.11
      With 13 tests, ± 1.96 standard errors hold the mean about 91 % of the time;
        --criterion reml allows for that.
      Spread of effect between tests: I² = 49.3 % of the variance of typical
        estimates, H² = 1.97. Cochran's Q = 30.73 with 11 degrees of freedom: p =
        0.001.

      mean of  per unit of  coefficient
      effect   latitude         -0.0295 ± 0.0055

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates.
    Model check passed: innovations and tests agree with the model. Test 6 is
    influential: the estimates depend on it.
    Log-likelihood -7.69, 3 free parameters, AIC 21.37, BIC 23.07.

    What to do next
      Check the data of test 6 with care, because the estimates depend on it; the
        results file has the estimates without it.

    Outlying tests
      No test is an outlier: the smallest of 13 p-values is 0.008 (test 7), or 0.11
        after Bonferroni correction.

    Influence of single tests
      test  displacement  p-value without it
      6             13.3                3e-5
      Leaving this test out moves the estimates outside the 50 % confidence region
        of the full fit.
      Displacement (Cook's): twice the drop in the log-likelihood of all tests when
        the estimates from the other tests are used. The p-value says how well the
        test agrees with the estimates from the other tests.

    Innovations (measured minus predicted)
      Mean square of all 13 innovations, each divided by its standard deviation:
        1.42 (expected 1 ± 0.39).
      Innovation checks passed for all tests (smallest p = 0.02, size in 7; 0.21
        after Holm correction for 13 tests).

    Notes
      The variance of `effect` is weakly determined: its standard error (0.0405) is
        no smaller than the variance itself (0.03435).

    Every test has its own design (times, inputs and missing values).
    Computation: solver newton, [work].
    ----- stderr
    Wrote fit.json
    ");
}

#[test]
fn gyros_with_drift_and_constraints() {
    assert_snapshot!(steady(&fit("gyro", "--set tau=200").0), @"
    exit 0
    ----- stdout
    Gyros on a turntable

    Data: 6 tests, 60 steps, 57 observations from gyro.csv.

    Initial state over the tests (± standard error)
      state                    unit      mean            std dev
      bias                     deg/h    0.401 ± 0.035      0.079 ± 0.027
      scale                    ppm        300 fixed           54 ± 19
      temperature_coefficient         0.00946 ± 0.00099        0 fixed
      With 6 tests, ± 1.96 standard errors hold the mean about 86 % of the time;
        --criterion reml allows for that.

    Correlations
      The states are held uncorrelated.

    Dynamic parameters (± standard error)
      parameter    for    unit  value
      tau                 s       200 fixed
      sigma_drift                0.05 fixed
      sigma_v      lot A         0.02 fixed
      sigma_v      lot B         0.04 fixed

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates.
    Model check passed: innovations and tests agree with the model. Test U03 is
    influential: the estimates depend on it.
    Log-likelihood 84.31, 4 free parameters, AIC -160.62, BIC -152.44.

    What to do next
      Check the data of test U03 with care, because the estimates depend on it; the
        results file has the estimates without it.

    Constraints (score test of each one separately)
      element                               held at  dℓ/dvalue  p-value  if freed
      mean[scale]                               300     0.0391     0.35       322
      covariance[bias, scale]                     0      0.425     0.38      1.79
      covariance[bias,                            0     -17668        -         -
      temperature_coefficient]
      covariance[scale,                           0        -21        -         -
      temperature_coefficient]
      covariance[temperature_coefficient,         0      42721     0.45   4.25e-7
      temperature_coefficient]
      The data do not contradict any of them (5 % level, after Bonferroni correction
        for 3 tests).

    Outlying tests
      No test is an outlier: the smallest of 6 p-values is 0.02 (test U06), or 0.10
        after Bonferroni correction.

    Influence of single tests
      test  displacement  p-value without it
      U03           5.32               0.006
      Leaving this test out moves the estimates outside the 50 % confidence region
        of the full fit.
      Displacement (Cook's): twice the drop in the log-likelihood of all tests when
        the estimates from the other tests are used. The p-value says how well the
        test agrees with the estimates from the other tests.

    Innovations (measured minus predicted)
      Mean square of all 57 innovations, each divided by its standard deviation:
        0.83 (expected 1 ± 0.19).
      Innovation checks passed for all tests (smallest p = 0.23, time correlation in
        U06; 1 after Holm correction for 12 tests).

    Groups by lot
      lot  tests  mean square  p-value  distance²  expected  p-value
      A        3         0.73     0.32        7.2         9     0.62
      B        3         0.93     0.84       13.5         9     0.14

    Every test has its own design (times, inputs and missing values).
    Computation: solver newton, [work].
    ----- stderr
    Wrote fit.json
    ");
}

#[test]
fn two_sensors_in_long_data() {
    assert_snapshot!(steady(&fit("sensors", "").0), @"
    exit 0
    ----- stdout
    Two sensors, long data

    Data: 5 tests, 39 steps, 71 observations from sensors.csv.

    Initial state over the tests (± standard error)
      state   mean         std dev
      x1      0.88 ± 0.18     0.37 ± 0.13
      x2     -1.00 ± 0.15     0.28 ± 0.14
      With 5 tests, ± 1.96 standard errors hold the mean about 85 % of the time;
        --criterion reml allows for that.

    Correlations (± standard error)
                   x1
      x2  0.01 ± 0.57

    Dynamic parameters (± standard error)
      parameter  value
      f            0.9 fixed
      g            0.2 fixed
      s            0.1 fixed

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates.
    Model check passed: innovations and tests agree with the model. 2 tests are
    influential: the estimates depend on each of them.
    Log-likelihood 13.62, 5 free parameters, AIC -17.24, BIC -5.93.

    What to do next
      Check the data of tests s0 and s4 with care, because the estimates depend on
        them; the results file has the estimates without them.

    Outlying tests
      No test is an outlier: the smallest of 5 p-values is 0.15 (test s0), or 0.77
        after Bonferroni correction.

    Influence of single tests
      test  displacement  p-value without it
      s0            27.9                2e-9
      s4             9.8              0.0002
      Leaving any one of these tests out moves the estimates outside the 50 %
        confidence region of the full fit.
      Displacement (Cook's): twice the drop in the log-likelihood of all tests when
        the estimates from the other tests are used. The p-value says how well the
        test agrees with the estimates from the other tests.

    Innovations (measured minus predicted)
      Mean square of all 71 innovations, each divided by its standard deviation:
        1.29 (expected 1 ± 0.17).
      Innovation checks passed for all tests (smallest p = 0.04, size in s2; 0.37
        after Holm correction for 10 tests).

    Notes
      State `x2` takes one step from each row to the next, however long: 1 of 34
        steps in column `step` are not of the usual length 1, but from 1 to 2. If it
        moves with time, let `next` and `step_noise` depend on `dt`, as `f^dt` for a
        factor `f` and `sqrt(dt)` for noise.
      The variance of `x2` is weakly determined: its standard error (0.07601) is no
        smaller than the variance itself (0.07598).

    Every test has its own design (times, inputs and missing values).
    Computation: solver newton, [work].
    ----- stderr
    Wrote fit.json
    ");
}

#[test]
fn without_an_output_the_summary_is_all() {
    let folder = Folder::new(&[]);
    let before = folder.contents();
    let output = folder.run("fit m.toml d.csv");
    assert_eq!(before, folder.contents(), "nothing is written");
    assert_eq!(String::from_utf8_lossy(&output.stderr), "", "nothing on standard error");
    assert_snapshot!(steady(&shown(&output)), @"
    exit 0
    ----- stdout
    Data: 3 tests, 9 steps, 9 observations from d.csv.

    Initial state over the tests (± standard error)
      state  mean         std dev
      level  1.16 ± 0.37     0.63 ± 0.26
      slope  0.53 ± 0.22     0.37 ± 0.16
      With 3 tests, ± 1.96 standard errors hold the mean less than 85 % of the time;
        --criterion reml allows for that.

    Correlations (± standard error)
                    level
      slope  -0.37 ± 0.51

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates.
    Model check passed: innovations and tests agree with the model. 3 tests are
    influential: the estimates depend on each of them.
    Log-likelihood -3.72, 5 free parameters, AIC 17.45, BIC 18.43.

    What to do next
      Check the data of tests b, a and c with care, because the estimates depend on
        them; the results file has the estimates without them.

    Outlying tests
      No test is an outlier: the smallest of 3 p-values is 0.37 (test a), or 1 after
        Bonferroni correction.

    Influence of single tests
      test  displacement  p-value without it
      b              482             < 1e-10
      a              143             < 1e-10
      c              130             < 1e-10
      Leaving any one of these tests out moves the estimates outside the 50 %
        confidence region of the full fit.
      Displacement (Cook's): twice the drop in the log-likelihood of all tests when
        the estimates from the other tests are used. The p-value says how well the
        test agrees with the estimates from the other tests.

    Innovations (measured minus predicted)
      Mean square of all 9 innovations, each divided by its standard deviation: 0.93
        (expected 1 ± 0.47).
      Innovation checks passed for all tests (smallest p = 0.64, size in a; 1 after
        Holm correction for 3 tests).

    All tests have the same design (times, inputs and missing values).
    Computation: solver newton, [work].
    ----- stderr
    ");
}

#[test]
fn quiet_prints_nothing() {
    let folder = Folder::new(&[]);
    assert_eq!(shown(&folder.run("fit m.toml d.csv --quiet --out fit.json")), "exit 0\n----- stdout\n----- stderr\n");
    assert!(folder.path("fit.json").exists(), "the output is written all the same");
}

#[test]
fn what_did_not_converge_is_written_and_says_so() {
    let (text, record) = fit("vaccine", "--max-iterations 1");
    assert!(text.starts_with("exit 1\n"), "{text}");
    assert!(text.contains("Not converged: "), "{text}");
    assert!(!record.converged, "the record says so too");
    assert!(record.reason.contains("limit of iterations"), "the reason is given: {}", record.reason);
}

#[test]
fn both_solvers_end_at_one_point() {
    for (name, options) in EXAMPLES {
        let (newton, em) = (fit(name, options).1, fit(name, &format!("{options} --solver em")).1);
        let difference = (newton.log_likelihood - em.log_likelihood).abs();
        assert!(difference < 1e-6, "{name}: newton {} em {}", newton.log_likelihood, em.log_likelihood);
        assert_eq!((newton.solver.solver.as_str(), em.solver.solver.as_str()), ("newton", "em"));
    }
}

#[test]
fn defaults_of_the_contract_may_be_spelled_out() {
    let spelled = "--set sigma=25 --method hybrid --solver newton --criterion ml --phases chain --intervals wald";
    let (found, expected) =
        (fit("random-coefficients/sleepstudy", spelled).1, fit("random-coefficients/sleepstudy", "--set sigma=25").1);
    assert_eq!(found.log_likelihood, expected.log_likelihood);
}

/// A record without what differs from run to run.
fn timeless(mut record: FitRecord) -> FitRecord {
    record.solver.seconds = 0.0;
    record.data.files.clear();
    record
}

#[test]
fn threads_change_no_bit() {
    for (name, options) in EXAMPLES {
        let one = timeless(fit(name, &format!("{options} --threads 1")).1);
        let three = timeless(fit(name, &format!("{options} --threads 3")).1);
        assert_eq!(one, three, "{name}");
    }
}

#[test]
fn instructions_that_are_fixed_fix_all_bits() {
    let sets: Vec<&str> = kalfit::Isa::all().iter().map(|isa| isa.word()).collect();
    for (name, options) in EXAMPLES {
        let fits: Vec<FitRecord> = sets
            .iter()
            .map(|set| {
                let one = timeless(fit(name, &format!("{options} --instructions {set} --threads 1")).1);
                let two = timeless(fit(name, &format!("{options} --instructions {set} --threads 2")).1);
                assert_eq!(one, two, "{name}, {set}");
                one
            })
            .collect();
        for (found, set) in fits.iter().zip(&sets) {
            let (found, first) = (found.log_likelihood, fits[0].log_likelihood);
            assert!((found - first).abs() <= 1e-7 * (1.0 + first.abs()), "{name}, {set}: {found} and {first}");
        }
    }
}

#[test]
fn instructions_may_stand_in_a_variable() {
    let folder = Folder::new(&[]);
    let with = |variable: &str, args: &str| {
        shown(&folder.command(args).env("KALFIT_INSTRUCTIONS", variable).stdin(Stdio::null()).output().unwrap())
    };
    let fixed = with("portable", "fit m.toml d.csv --quiet --out a.json");
    assert_eq!(fixed, "exit 0\n----- stdout\n----- stderr\n");
    folder.run("fit m.toml d.csv --quiet --out b.json --instructions portable");
    let read = |name: &str| -> FitRecord {
        timeless(serde_json::from_slice(&std::fs::read(folder.path(name)).unwrap()).unwrap())
    };
    assert_eq!(read("a.json"), read("b.json"));
    let refused = with("none", "fit m.toml d.csv");
    assert!(refused.starts_with("exit 2\n"), "{refused}");
    assert!(refused.contains("error: KALFIT_INSTRUCTIONS: found `none`, expected one of `portable`"), "{refused}");
}

#[test]
fn the_order_of_tests_changes_no_bit() {
    let folder = Folder::new(&[]);
    folder.run("fit m.toml d.csv --out a.json");
    let rows: Vec<&str> = DATA.lines().skip(1).collect();
    let turned: Vec<&str> = [6, 3, 0, 1, 7, 4, 2, 5, 8].iter().map(|&i| rows[i]).collect();
    folder.write("d.csv", format!("id,x,y\n{}\n", turned.join("\n")).as_bytes());
    folder.run("fit m.toml d.csv --out b.json");
    let read = |name: &str| -> FitRecord {
        serde_json::from_slice(&std::fs::read(folder.path(name)).unwrap()).expect("the output is a record")
    };
    assert_eq!(timeless(read("a.json")), timeless(read("b.json")));
}

#[test]
fn data_may_come_from_patterns_and_from_standard_input() {
    let folder = Folder::new(&[]);
    let whole = folder.run("fit m.toml d.csv");
    let (head, rows) = DATA.split_once('\n').unwrap();
    for test in ["a", "b", "c"] {
        let own: Vec<&str> = rows.lines().filter(|row| row.starts_with(test)).collect();
        folder.write(&format!("part_{test}.csv"), format!("{head}\n{}\n", own.join("\n")).as_bytes());
    }
    let likelihood = |text: String| text.lines().find(|line| line.starts_with("Log-likelihood")).map(str::to_owned);
    let expected = likelihood(shown(&whole));
    assert!(expected.is_some(), "{}", shown(&whole));
    assert_eq!(likelihood(shown(&folder.run("fit m.toml part_*.csv"))), expected);
    assert_eq!(likelihood(shown(&folder.run_with_input("fit m.toml -", DATA.as_bytes()))), expected);
}

#[test]
fn records_have_the_shape_of_the_contract() {
    for (name, options) in EXAMPLES {
        let (_, record) = fit(name, options);
        let json = serde_json::to_value(&record).expect("a record is JSON");
        walk(&json, name);
        for key in
            "schema kalfit_version title model_digest data criterion log_likelihood free_parameters aic bic converged \
                    reason certificate solver phases parameters constraints tests"
                .split_whitespace()
        {
            assert!(json.get(key).is_some(), "{name} has no `{key}`");
        }
        let sum: f64 = record.tests.iter().map(|t| t.log_likelihood).sum();
        let error = (sum - record.log_likelihood).abs();
        assert!(error < 1e-9 * sum.abs(), "{name}: tests add up to {sum}, the whole is {}", record.log_likelihood);
        assert!(record.model_digest.is_some_and(|digest| digest.starts_with("sha256:")), "{name} has a digest");
        assert!(record.solver.seconds > 0.0, "{name} took time");
        assert_eq!(record.data.files, [format!("{}.csv", stem(name))]);
    }
}

/// Every number is one that a double can hold, and no text smuggles one that it cannot.
fn walk(value: &serde_json::Value, at: &str) {
    match value {
        serde_json::Value::Number(number) => {
            assert!(number.as_f64().is_some_and(f64::is_finite), "{at}: {number}");
        }
        serde_json::Value::Array(items) => items.iter().enumerate().for_each(|(i, v)| walk(v, &format!("{at}[{i}]"))),
        serde_json::Value::Object(fields) => fields.iter().for_each(|(k, v)| walk(v, &format!("{at}.{k}"))),
        serde_json::Value::String(text) => assert!(text != "NaN" && text != "inf", "{at}: {text}"),
        serde_json::Value::Null | serde_json::Value::Bool(_) => {}
    }
}

#[test]
fn an_old_output_is_replaced_whole() {
    let folder = Folder::new(&[("fit.json", &[b'x'; 100_000])]);
    let output = folder.run("fit m.toml d.csv --out fit.json");
    assert!(output.status.success(), "{}", shown(&output));
    let text = std::fs::read_to_string(folder.path("fit.json")).unwrap();
    assert!(text.starts_with('{') && text.ends_with("}\n"), "the new file stands alone: {}", &text[text.len() - 20..]);
    assert_eq!(folder.contents().len(), 3, "no temporary file is left");
}

#[cfg(unix)]
#[test]
fn outputs_keep_links_and_permissions() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::new(&[("real.json", b"old")]);
    std::fs::set_permissions(folder.path("real.json"), std::fs::Permissions::from_mode(0o640)).unwrap();
    std::os::unix::fs::symlink("real.json", folder.path("link.json")).unwrap();
    let output = folder.run("fit m.toml d.csv --out link.json");
    assert!(output.status.success(), "{}", shown(&output));
    assert!(folder.path("link.json").is_symlink(), "the link is still a link");
    let mode = std::fs::metadata(folder.path("real.json")).unwrap().permissions().mode() & 0o777;
    assert_eq!(mode, 0o640, "found {mode:o}");
    assert!(std::fs::read_to_string(folder.path("real.json")).unwrap().starts_with('{'), "the file was replaced");
}

#[cfg(unix)]
#[test]
fn readers_that_go_away_are_no_error() {
    use std::process::Stdio;
    let folder = Folder::new(&[]);
    let mut child = folder.command("fit m.toml d.csv").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(shown(&output), "exit 0\n----- stdout\n----- stderr\n");
}
