//! Whole summaries, as they are read.

use crate::common;

use common::{constrained, phase, record, singular, sleepstudy};
use kalfit::record::{BoundaryRecord, TestRecords};
use kalfit_report::{TextStyle, summary};

fn at_80(record: &kalfit::FitRecord) -> String {
    summary(record, &TextStyle::default())
}

#[test]
fn a_healthy_fit_reads_from_verdict_to_figures() {
    insta::assert_snapshot!(at_80(&sleepstudy()), @"
    Reaction time under sleep deprivation

    Data: 18 tests, 180 steps, 180 observations from data.csv.

    Initial state over the tests (± standard error)
      state      unit     mean        std dev
      intercept  ms      251.4 ± 6.6     23.8 ± 5.1
      slope      ms/day   10.5 ± 1.5      5.7 ± 1.1
      With 18 tests, ± 1.96 standard errors hold the mean about 92 % of the time;
        --criterion reml allows for that.

    Correlations (± standard error)
               intercept
      slope  0.08 ± 0.33

    Dynamic parameters (± standard error)
      parameter  unit  value        95 % interval
      sigma      ms     25.6 ± 1.5  22.8 to 28.7

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates. For the dynamic parameters this is a local maximum; the search found
    no higher one.
    Model check passed: the tests agree with the population (innovations were not
    computed).
    Log-likelihood -875.97, 6 free parameters, AIC 1763.94, BIC 1783.10.

    What to do next
      Nothing needs attention: the fit converged and the model describes the data.

    Outlying tests
      No test is an outlier: the smallest of 4 p-values is 0.02 (test 310), or 0.08
        after Bonferroni correction.

    All tests have the same design (times, inputs and missing values).
    Computation: solver newton, 9 iterations, 1 filter run, 12 ms.
    ");
}

#[test]
fn a_singular_covariance_keeps_its_word_beside_a_standard_error() {
    let mut record = singular();
    record.phases[0].unidentified.clear();
    record.phases[0].std_dev.estimate[1] = 0.512_345;
    record.phases[0].std_dev.std_error[1] = Some(0.083);
    let text = at_80(&record);
    assert!(text.contains("0.512 ± 0.083 boundary"), "{text}");
}

#[test]
fn singular_covariances_and_unidentified_directions_are_said_in_words() {
    insta::assert_snapshot!(at_80(&singular()), @"
    Static IMU

    Data: 18 tests, 180 steps, 180 observations from data.csv.

    Initial state over the tests (± standard error)
      state         mean                 std dev
      bias             1 not identified        1 boundary
      scale            2 not identified      0.5 boundary
      misalignment  3.00 ± 0.10                0 at zero (boundary)
      With 18 tests, ± 1.96 standard errors hold the mean about 92 % of the time;
        --criterion reml allows for that.

    Correlations (± standard error)
                     bias  scale
      scale         1.000
      misalignment      -      -
      - not defined: a standard deviation is zero.

    What the data cannot determine
      Σ is singular: rank 1 of 3; the variance of misalignment is estimated as zero.
      Not identified: the combination 0.8 scale - 0.6 bias of the means, whose value
        here is one of many that fit as well.
      Not identified: the covariance of bias and scale, whose value here is one of
        many that fit as well. `bias` and `scale` are never observed in one test.

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates. The estimated covariance is singular, on the boundary of the possible
    covariances. Some quantities are not identified by the data.
    Model check passed: the tests agree with the population (innovations were not
    computed).
    Log-likelihood -875.97, 6 free parameters, AIC 1763.94, BIC 1783.10.

    What to do next
      Fix what the data do not identify, or leave it out of the model, or add tests
        with information on it; `kalfit check` shows which tests see which states.
      A singular covariance is a valid result: these tests do not show that the
        states vary in all directions. Fewer varying states describe the data
        equally well; more tests may separate them.

    Outlying tests
      No test is an outlier: the smallest of 4 p-values is 0.02 (test 310), or 0.08
        after Bonferroni correction.

    Notes
      Units of the states span 9 powers of ten; they were scaled.

    The tests have 4 different designs (times, inputs and missing values). 3 tests
    needed the more accurate square-root filter.
    Computation: solver newton, 9 iterations, 1 filter run, 12 ms.
    ");
}

#[test]
fn constraints_show_what_they_cost() {
    insta::assert_snapshot!(at_80(&constrained()), @"
    Gyro bench

    Data: 18 tests, 180 steps, 180 observations from data.csv.

    Initial state over the tests (± standard error)
      state                    mean         std dev
      bias                     1.00 ± 0.25     1.00 ± 0.15
      scale_factor                0 fixed      1.00 ± 0.15
      temperature_coefficient  3.00 ± 0.25        0 fixed
      With 18 tests, ± 1.96 standard errors hold the mean about 92 % of the time;
        --criterion reml allows for that.
      The mean is the given direction times a scale: 1.021 ± 0.035.

      mean of  per unit of  coefficient
      bias     temperature       0.0123 ± 0.0012

    Correlations
      The states are held uncorrelated.

    Dynamic parameters (± standard error)
      parameter  for    unit  value               95 % interval
      sigma_v    lot A          0.7 fixed
      sigma_v    lot B        0.123 ± 0.012       0.099 to 0.147
      tau               s         1 at its bound

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates. For the dynamic parameters this is a local maximum; the search found
    no higher one.
    Model check doubtful: 2 tests are outliers.
    Log-likelihood -875.97, 6 free parameters, AIC 1763.94, BIC 1783.10.

    What to do next
      Look for faults in the data of tests 309 and 310, and see whether a fit
        without them changes the estimates.

    Constraints (score test of each one separately)
      element                    held at  dℓ/dvalue  p-value  p of refit  if freed
      mean[scale_factor]               0      -12.3    0.008       0.009    -0.457
      covariance[scale_factor,         0      -12.3     0.43           -    -0.457
      bias]
      covariance[temperature_co        0          -        -           -         -
      efficient,
      temperature_coefficient]
      The data contradict the constraint on mean[scale_factor] (5 % level, after
        Bonferroni correction for 2 tests).

    Outlying tests
      test  distance²  expected  p-value  times 4
      309        55.3         2  < 1e-10  < 1e-10
      310        15.6         2   0.0004    0.002
      These tests are outliers at the 5 % level, after Bonferroni correction for 4
        tests. Distance²: squared distance of the test's initial state from the
        population, in standard deviations.

    All tests have the same design (times, inputs and missing values).
    Computation: solver newton, 9 iterations, 1 filter run, 12 ms.
    ");
}

#[test]
fn without_random_states_the_means_remain() {
    let mut main = phase("main", &["level"]);
    main.covariance.fixed[0][0] = true;
    main.covariance.estimate[0][0] = 0.0;
    main.std_dev.estimate[0] = 0.0;
    main.std_dev.std_error[0] = None;
    insta::assert_snapshot!(at_80(&record("", vec![main])), @"
    Data: 18 tests, 180 steps, 180 observations from data.csv.

    Initial state over the tests (± standard error)
      state  mean         std dev
      level  1.00 ± 0.25        0 fixed
      With 18 tests, ± 1.96 standard errors hold the mean about 92 % of the time;
        --criterion reml allows for that.

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates.
    Model check passed: the tests agree with the population (innovations were not
    computed).
    Log-likelihood -875.97, 6 free parameters, AIC 1763.94, BIC 1783.10.

    What to do next
      Nothing needs attention: the fit converged and the model describes the data.

    Outlying tests
      No test is an outlier: the smallest of 4 p-values is 0.02 (test 310), or 0.08
        after Bonferroni correction.

    All tests have the same design (times, inputs and missing values).
    Computation: solver newton, 9 iterations, 1 filter run, 12 ms.
    ");
}

#[test]
fn without_estimated_states_the_likelihood_remains() {
    let mut record = record("Known start", vec![phase("main", &[])]);
    record.tests = TestRecords::default();
    insta::assert_snapshot!(at_80(&record), @"
    Known start

    Data: 18 tests, 180 steps, 180 observations from data.csv.

    Initial state: nothing of it is estimated.

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates.
    No model check: the results have no figures of single tests.
    Log-likelihood -875.97, 6 free parameters, AIC 1763.94, BIC 1783.10.

    What to do next
      To check the model, fit with the figures of single tests: without
        `--no-tests`, and with `--innovations on`.

    All tests have the same design (times, inputs and missing values).
    Computation: solver newton, 9 iterations, 1 filter run, 12 ms.
    ");
}

fn ten_states() -> kalfit::FitRecord {
    let names =
        ["accelerometer_bias_x", "accelerometer_bias_y", "gx", "gy", "gz", "kx", "ky", "kz", "misalignment_xy", "m2"];
    let mut main = phase("main", &names);
    for i in 0..10 {
        for k in 0..i {
            let r = (((7 * i + 3 * k) % 19) as f64 - 9.0) / 10.0;
            main.correlation.estimate[i][k] = Some(r);
            main.correlation.std_error[i][k] = Some(0.03 * (1.0 + k as f64));
        }
    }
    record("Ten states", vec![main])
}

#[test]
fn wide_matrices_are_cut_into_parts_that_fit_80_columns() {
    insta::assert_snapshot!(at_80(&ten_states()), @"
    Ten states

    Data: 18 tests, 180 steps, 180 observations from data.csv.

    Initial state over the tests (± standard error)
      state                  mean         std dev
      accelerometer_bias_x   1.00 ± 0.25     1.00 ± 0.15
      accelerometer_bias_y   2.00 ± 0.25     1.00 ± 0.15
      gx                     3.00 ± 0.25     1.00 ± 0.15
      gy                     4.00 ± 0.25     1.00 ± 0.15
      gz                     5.00 ± 0.25     1.00 ± 0.15
      kx                     6.00 ± 0.25     1.00 ± 0.15
      ky                     7.00 ± 0.25     1.00 ± 0.15
      kz                     8.00 ± 0.25     1.00 ± 0.15
      misalignment_xy        9.00 ± 0.25     1.00 ± 0.15
      m2                    10.00 ± 0.25     1.00 ± 0.15
      With 18 tests, ± 1.96 standard errors hold the mean about 92 % of the time;
        --criterion reml allows for that.

    Correlations (± standard error)
                            accelerometer_bias_x  accelerometer_bias_y
      accelerometer_bias_y        -0.200 ± 0.030
      gx                           0.500 ± 0.030         0.800 ± 0.060
      gy                          -0.700 ± 0.030        -0.400 ± 0.060
      gz                           0.000 ± 0.030         0.300 ± 0.060
      kx                           0.700 ± 0.030        -0.900 ± 0.060
      ky                          -0.500 ± 0.030        -0.200 ± 0.060
      kz                           0.200 ± 0.030         0.500 ± 0.060
      misalignment_xy              0.900 ± 0.030        -0.700 ± 0.060
      m2                          -0.300 ± 0.030         0.000 ± 0.060

                                   gx            gy            gz
      gy               -0.100 ± 0.090
      gz                0.600 ± 0.090   0.90 ± 0.12
      kx               -0.600 ± 0.090  -0.30 ± 0.12   0.00 ± 0.15
      ky                0.100 ± 0.090   0.40 ± 0.12   0.70 ± 0.15
      kz                0.800 ± 0.090  -0.80 ± 0.12  -0.50 ± 0.15
      misalignment_xy  -0.400 ± 0.090  -0.10 ± 0.12   0.20 ± 0.15
      m2                0.300 ± 0.090   0.60 ± 0.12   0.90 ± 0.15

                                 kx            ky            kz
      ky               -0.90 ± 0.18
      kz               -0.20 ± 0.18   0.10 ± 0.21
      misalignment_xy   0.50 ± 0.18   0.80 ± 0.21  -0.80 ± 0.24
      m2               -0.70 ± 0.18  -0.40 ± 0.21  -0.10 ± 0.24

          misalignment_xy
      m2      0.20 ± 0.27

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates.
    Model check passed: the tests agree with the population (innovations were not
    computed).
    Log-likelihood -875.97, 6 free parameters, AIC 1763.94, BIC 1783.10.

    What to do next
      Nothing needs attention: the fit converged and the model describes the data.

    Outlying tests
      No test is an outlier: the smallest of 4 p-values is 0.02 (test 310), or 0.08
        after Bonferroni correction.

    All tests have the same design (times, inputs and missing values).
    Computation: solver newton, 9 iterations, 1 filter run, 12 ms.
    ");
}

#[test]
fn wide_matrices_use_120_columns_where_there_are() {
    insta::assert_snapshot!(summary(&ten_states(), &TextStyle { width: 120, color: false }), @"
    Ten states

    Data: 18 tests, 180 steps, 180 observations from data.csv.

    Initial state over the tests (± standard error)
      state                  mean         std dev
      accelerometer_bias_x   1.00 ± 0.25     1.00 ± 0.15
      accelerometer_bias_y   2.00 ± 0.25     1.00 ± 0.15
      gx                     3.00 ± 0.25     1.00 ± 0.15
      gy                     4.00 ± 0.25     1.00 ± 0.15
      gz                     5.00 ± 0.25     1.00 ± 0.15
      kx                     6.00 ± 0.25     1.00 ± 0.15
      ky                     7.00 ± 0.25     1.00 ± 0.15
      kz                     8.00 ± 0.25     1.00 ± 0.15
      misalignment_xy        9.00 ± 0.25     1.00 ± 0.15
      m2                    10.00 ± 0.25     1.00 ± 0.15
      With 18 tests, ± 1.96 standard errors hold the mean about 92 % of the time; --criterion reml allows for that.

    Correlations (± standard error)
                            accelerometer_bias_x  accelerometer_bias_y              gx            gy            gz
      accelerometer_bias_y        -0.200 ± 0.030
      gx                           0.500 ± 0.030         0.800 ± 0.060
      gy                          -0.700 ± 0.030        -0.400 ± 0.060  -0.100 ± 0.090
      gz                           0.000 ± 0.030         0.300 ± 0.060   0.600 ± 0.090   0.90 ± 0.12
      kx                           0.700 ± 0.030        -0.900 ± 0.060  -0.600 ± 0.090  -0.30 ± 0.12   0.00 ± 0.15
      ky                          -0.500 ± 0.030        -0.200 ± 0.060   0.100 ± 0.090   0.40 ± 0.12   0.70 ± 0.15
      kz                           0.200 ± 0.030         0.500 ± 0.060   0.800 ± 0.090  -0.80 ± 0.12  -0.50 ± 0.15
      misalignment_xy              0.900 ± 0.030        -0.700 ± 0.060  -0.400 ± 0.090  -0.10 ± 0.12   0.20 ± 0.15
      m2                          -0.300 ± 0.030         0.000 ± 0.060   0.300 ± 0.090   0.60 ± 0.12   0.90 ± 0.15

                                 kx            ky            kz  misalignment_xy
      ky               -0.90 ± 0.18
      kz               -0.20 ± 0.18   0.10 ± 0.21
      misalignment_xy   0.50 ± 0.18   0.80 ± 0.21  -0.80 ± 0.24
      m2               -0.70 ± 0.18  -0.40 ± 0.21  -0.10 ± 0.24      0.20 ± 0.27

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood estimates.
    Model check passed: the tests agree with the population (innovations were not computed).
    Log-likelihood -875.97, 6 free parameters, AIC 1763.94, BIC 1783.10.

    What to do next
      Nothing needs attention: the fit converged and the model describes the data.

    Outlying tests
      No test is an outlier: the smallest of 4 p-values is 0.02 (test 310), or 0.08 after Bonferroni correction.

    All tests have the same design (times, inputs and missing values).
    Computation: solver newton, 9 iterations, 1 filter run, 12 ms.
    ");
}

#[test]
fn what_did_not_converge_says_so_first() {
    let mut record = sleepstudy();
    record.converged = false;
    record.reason = "200 passes were not enough".into();
    record.certificate.mean = 0.31;
    record.certificate.covariance = 12.7;
    let main = &mut record.phases[0];
    main.mean.std_error.fill(None);
    main.std_dev.std_error.fill(None);
    insta::assert_snapshot!(at_80(&record), @"
    Reaction time under sleep deprivation

    Not converged: 200 passes were not enough. The figures below are where the
    solver stopped, not a maximum of the likelihood.
    Distance from the optimality conditions, in standard errors: mean 0.31,
    covariance 13, null space of Σ 0, parameters 0.

    Data: 18 tests, 180 steps, 180 observations from data.csv.

    Initial state over the tests (± standard error)
      state      unit       mean            std dev
      intercept  ms      251.405 ± unknown  23.7807 ± unknown
      slope      ms/day  10.4673 ± unknown  5.71685 ± unknown

    Correlations (± standard error)
               intercept
      slope  0.08 ± 0.33

    Dynamic parameters (± standard error)
      parameter  unit  value        95 % interval
      sigma      ms     25.6 ± 1.5  22.8 to 28.7

    Log-likelihood -875.97, 6 free parameters, AIC 1763.94, BIC 1783.10.

    What to do next
      Do not use these figures. Give start values for the free parameters, or use a
        simpler model: fewer states, or a diagonal covariance.

    Outlying tests
      No test is an outlier: the smallest of 4 p-values is 0.02 (test 310), or 0.08
        after Bonferroni correction.

    All tests have the same design (times, inputs and missing values).
    Computation: solver newton, 9 iterations, 1 filter run, 12 ms.
    ");
}

#[test]
fn phases_have_a_section_each() {
    let mut record = record("Two phases", vec![phase("align", &["bias"]), phase("coast", &["bias", "tilt"])]);
    let states = vec!["bias".to_owned(), "tilt".to_owned()];
    record.phases[1].boundary =
        vec![BoundaryRecord { what: "covariance".into(), rank: 0, of: 2, zero_variances: states.clone(), states }];
    record.criterion = "reml".into();
    insta::assert_snapshot!(at_80(&record), @"
    Two phases

    Data: 18 tests, 180 steps, 180 observations from data.csv.
    Phases: align and coast; combined exactly, phase by phase (chain).

    Phase align: initial state over the tests (± standard error)
      state  mean         std dev
      bias   1.00 ± 0.25     1.00 ± 0.15

    Phase coast: initial state over the tests (± standard error)
      state  mean         std dev
      bias   1.00 ± 0.25        0 at zero (boundary)
      tilt   2.00 ± 0.25        0 at zero (boundary)

    Phase coast: correlations (± standard error)
                   bias
      tilt  0.00 ± 0.20

    Phase coast: what the data cannot determine
      Σ is estimated as zero: measurement noise explains all differences between the
        tests.

    Convergence and model check
    Converged: the optimality conditions hold, so these are the restricted
    maximum-likelihood estimates. The estimated covariance is singular, on the
    boundary of the possible covariances.
    Model check passed: the tests agree with the population (innovations were not
    computed).
    Restricted log-likelihood -875.97, 6 free parameters, AIC 1763.94, BIC 1783.10.

    What to do next
      A singular covariance is a valid result: these tests do not show that the
        states vary in all directions. Fewer varying states describe the data
        equally well; more tests may separate them.

    Outlying tests
      No test is an outlier: the smallest of 4 p-values is 0.02 (test 310), or 0.08
        after Bonferroni correction.

    All tests have the same design (times, inputs and missing values).
    Computation: solver newton, 9 iterations, 1 filter run, 12 ms.
    ");
}

#[test]
fn colour_changes_no_letter() {
    for record in [sleepstudy(), singular(), constrained()] {
        let colored = summary(&record, &TextStyle { width: 80, color: true });
        let mut plain = String::new();
        let mut rest = colored.as_str();
        while let Some(start) = rest.find('\u{1b}') {
            plain.push_str(&rest[..start]);
            rest = &rest[start..];
            rest = &rest[rest.find('m').expect("an escape sequence ends with m") + 1..];
        }
        plain.push_str(rest);
        assert_eq!(plain, at_80(&record));
        assert!(colored.len() > plain.len(), "the coloured summary has colour");
    }
}

#[test]
fn every_line_fits_the_page() {
    for record in [sleepstudy(), singular(), constrained(), ten_states()] {
        for width in [60, 72, 80, 100, 120, 200] {
            for line in summary(&record, &TextStyle { width, color: false }).lines() {
                assert!(line.chars().count() <= width, "{} > {width}: {line}", line.chars().count());
                assert_eq!(line.trim_end(), line, "no spaces at the end of a line");
            }
        }
    }
}

#[test]
fn damaged_records_are_summarised_all_the_same() {
    let mut record = constrained();
    record.log_likelihood = f64::NAN;
    record.aic = Some(f64::INFINITY);
    record.solver.seconds = f64::NAN;
    common::change_test(&mut record, 0, |test| test.p_value = Some(f64::NAN));
    common::change_test(&mut record, 1, |test| test.distance = Some(f64::INFINITY));
    record.parameters[1].estimate = f64::NAN;
    record.constraints[0].sensitivity = Some(f64::NAN);
    let main = &mut record.phases[0];
    main.mean.estimate = vec![f64::NAN];
    main.mean.std_error = vec![Some(f64::INFINITY)];
    main.mean.fixed = vec![];
    main.covariance.fixed = vec![];
    main.std_dev.estimate = vec![f64::NEG_INFINITY; 7];
    main.std_dev.std_error = vec![];
    main.correlation.estimate = vec![vec![], vec![Some(f64::NAN)]];
    main.correlation.std_error = vec![];
    main.units = vec![];
    let text = at_80(&record);
    for word in text.split(|c: char| !c.is_alphanumeric()) {
        assert!(!["nan", "inf"].contains(&word.to_lowercase().as_str()), "`{word}` in:\n{text}");
    }
    assert!(text.contains("unknown"), "{text}");
}
