//! `kalfit check` on sound input.

use crate::folder::{Folder, MODEL, shown, steady};
use crate::sound::example;
use insta::assert_snapshot;

#[test]
fn check_says_the_model_in_words() {
    assert_snapshot!(shown(&example("gyro").run("check gyro.toml")), @"
    exit 0
    ----- stdout
    Gyros on a turntable

    Model
      tests: one for each value of column `unit`; reports are grouped by column
        `lot`
      steps: rows of equal time, column `t` [s]; x_0 is at the first row
      state `bias` [deg/h]: constant; start estimated
      state `scale` [ppm]: constant; start estimated
      state `drift`: d/dt = -1 / tau * drift + noise of variance 2 * sigma_drift^2 /
        tau per unit of time; start in its stationary distribution
      state `temperature_coefficient`: constant; start estimated, one value common
        to all tests
      measurement `gyro`: column `rate_out` reads bias + 1e-6 * rate_in * scale +
        drift + (T - 20) * temperature_coefficient; noise of standard deviation
        sigma_v
      parameter `tau` [s]: free, start 200, not negative, at least 1
      parameter `sigma_drift`: fixed at 0.05, not negative
      parameter `sigma_v`: free, not negative, one value for each value of column
        `lot`, fixed at 0.02 for 'A', fixed at 0.04 for 'B'
      order of μ and Σ: bias, scale, temperature_coefficient
      mean of `scale`: fixed at 300
      covariance Σ: diagonal
      variance of `temperature_coefficient`: fixed at 0

    The model is valid. Give data as well to see what they can identify.
    ----- stderr
    ");
}

#[test]
fn check_says_what_data_identify() {
    let folder = example("random-coefficients/sleepstudy");
    assert_snapshot!(shown(&folder.run("check sleepstudy.toml sleepstudy.csv")), @"
    exit 0
    ----- stdout
    Reaction time under sleep deprivation

    Model
      tests: one for each value of column `Subject`
      steps: one for each row; x_0 is at the first row
      state `intercept` [ms]: constant; start estimated
      state `slope` [ms/day]: constant; start estimated
      measurement `reaction`: column `Reaction` reads intercept + Days * slope;
        noise of standard deviation sigma
      parameter `sigma` [ms]: free, start 20, not negative
      order of μ and Σ: intercept, slope
      covariance Σ: full

    Data
      18 tests, 180 steps, 180 observations from sleepstudy.csv. All tests have the
        same design (times, inputs and missing values).

    Free parameters
      parameter  free values  tests each  start
      sigma      1            all 18      20

    Observability
      state      seen by  determined by  largest share
      intercept   all 18         all 18  all equal
      slope       all 18         all 18  all equal
      Seen by: tests whose measurements depend on the state. Determined by: tests
        that could estimate it by themselves. Largest share: the test with the most
        information on the mean, and its part of all information.

    Identifiability
      The data identify all free elements of the mean and the covariance.
      Computed with sigma at its start value.
    ----- stderr
    ");
    assert_snapshot!(shown(&example("vaccine").run("check vaccine.toml vaccine.csv")), @"
    exit 0
    ----- stdout
    BCG vaccine against tuberculosis, log risk ratios

    Model
      tests: one for each value of column `trial`
      steps: one for each row; x_0 is at the first row
      state `effect`: constant; start estimated
      measurement `log_risk_ratio`: column `yi` reads effect; noise of variance vi
      order of μ and Σ: effect
      mean of `effect`: moves with column `latitude`
      covariance Σ: full

    Data
      13 tests, 13 steps, 13 observations from vaccine.csv. Every test has its own
        design (times, inputs and missing values).

    Observability
      state   seen by  determined by  largest share
      effect   all 13         all 13  11 %, 8
      Seen by: tests whose measurements depend on the state. Determined by: tests
        that could estimate it by themselves. Largest share: the test with the most
        information on the mean, and its part of all information.

    Identifiability
      The data identify all free elements of the mean and the covariance.
    ----- stderr
    ");
}

#[test]
fn check_names_what_data_do_not_identify() {
    let folder = Folder::new(&[("one.csv", b"id,x,y\na,1,1\nb,1,2\nc,1,4\n")]);
    assert_snapshot!(shown(&folder.run("check m.toml one.csv")), @"
    exit 0
    ----- stdout
    Model
      tests: one for each value of column `id`
      steps: one for each row; x_0 is at the first row
      state `level`: constant; start estimated
      state `slope`: constant; start estimated
      measurement `y`: column `y` reads level + x * slope; noise of standard
        deviation 0.1
      order of μ and Σ: level, slope
      covariance Σ: full

    Data
      3 tests, 3 steps, 3 observations from one.csv. All tests have the same design
        (times, inputs and missing values). 3 tests needed the more accurate
        square-root filter.

    Observability
      state  seen by  determined by  largest share
      level    all 3           none  -
      slope    all 3           none  -
      Seen by: tests whose measurements depend on the state. Determined by: tests
        that could estimate it by themselves.

    Identifiability
      Not identified: only the sum level + slope is determined, not each alone
        (means and variances). Fix one, e.g. `slope.initial = { mean = 0, sigma = 0
        }`.
    ----- stderr
    ");
    assert_snapshot!(steady(&shown(&folder.run("fit m.toml one.csv"))), @"
    exit 0
    ----- stdout
    Data: 3 tests, 3 steps, 3 observations from one.csv.

    Initial state over the tests (± standard error)
      state     mean                 std dev
      level  1.16667 not identified  1.07665 not identified
      slope  1.16667 not identified  1.07665 not identified

    Correlations (± standard error)
              level
      slope  -0.333

    What the data cannot determine
      Not identified: only the sum level + slope is determined, not each alone
        (means and variances). Other values of what is not fit as well. Fix one,
        e.g. `slope.initial = { mean = 0, sigma = 0 }`.

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates. Some quantities are not identified by the data.
    Model check passed: innovations and tests agree with the model. Test c is
    influential: the estimates depend on it.
    Log-likelihood -4.92, 5 free parameters, AIC 19.84, BIC 15.33.

    What to do next
      Fix what the data do not identify, or leave it out of the model, or add tests
        with information on it; `kalfit check` shows which tests see which states.
      Check the data of test c with care, because the estimates depend on it; the
        results file has the estimates without it.

    Outlying tests
      No test is an outlier: the smallest of 3 p-values is 0.18 (test c), or 0.54
        after Bonferroni correction.

    Influence of single tests
      test  displacement  p-value without it
      c             18.5                6e-7
      Leaving this test out moves the estimates outside the 50 % confidence region
        of the full fit.
      Displacement (Cook's): twice the drop in the log-likelihood of all tests when
        the estimates from the other tests are used. The p-value says how well the
        test agrees with the estimates from the other tests.

    Innovations (measured minus predicted)
      Mean square of all 3 innovations, each divided by its standard deviation: 1.00
        (expected 1 ± 0.82).
      Innovation checks passed for all tests (smallest p = 0.36, size in c; 1 after
        Holm correction for 3 tests).

    All tests have the same design (times, inputs and missing values). 3 tests
    needed the more accurate square-root filter.
    Computation: solver newton, [work].
    ----- stderr
    ");
}

#[test]
fn check_reads_data_for_parameters_without_values() {
    let model = format!("{}[parameters]\nsigma = {{}}\n", MODEL.replace("noise = 0.1", "noise = \"sigma\""));
    let folder = Folder::new(&[("m.toml", model.as_bytes())]);
    assert_snapshot!(shown(&folder.run("check m.toml d.csv")), @"
    exit 0
    ----- stdout
    Model
      tests: one for each value of column `id`
      steps: one for each row; x_0 is at the first row
      state `level`: constant; start estimated
      state `slope`: constant; start estimated
      measurement `y`: column `y` reads level + x * slope; noise of standard
        deviation sigma
      parameter `sigma`: free, not negative
      order of μ and Σ: level, slope
      covariance Σ: full

    Data
      3 tests, 9 steps, 9 observations from d.csv. All tests have the same design
        (times, inputs and missing values).

    Free parameters
      parameter  free values  tests each  start
      sigma      1            all 3       0.469, from the data

    Observability
      state  seen by  determined by  largest share
      level    all 3          all 3  all equal
      slope    all 3          all 3  all equal
      Seen by: tests whose measurements depend on the state. Determined by: tests
        that could estimate it by themselves. Largest share: the test with the most
        information on the mean, and its part of all information.

    Identifiability
      The data identify all free elements of the mean and the covariance.
      Computed with sigma at its start value.
    ----- stderr
    ");
    assert!(shown(&folder.run("check m.toml d.csv --set sigma=1")).contains("identify all"), "with a value it runs");
}
