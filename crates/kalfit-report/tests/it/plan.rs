//! The text of a plan.

use insta::assert_snapshot;
use kalfit::record::DataRecord;
use kalfit::record::{PlanRecord, PlannedRecord};
use kalfit_report::{TextStyle, plan_summary};

fn quantity(kind: &str, states: &[&str], value: Option<f64>, errors: Result<[f64; 3], &str>) -> PlannedRecord {
    PlannedRecord {
        level: None,
        quantity: kind.to_owned(),
        phase: "main".to_owned(),
        states: states.iter().map(|&s| s.to_owned()).collect(),
        column: (kind == "regression").then(|| "lot\u{1b}[31m".to_owned()),
        unit: matches!(kind, "mean" | "std_dev").then(|| "deg/h".to_owned()),
        value,
        std_error: errors.map_or_else(|_| vec![None; 3], |errors| errors.iter().map(|&e| Some(e)).collect()),
        reason: errors.err().map(str::to_owned),
        relative_std_error: Vec::new(),
        parameter: None,
        std_error_before: None,
        df: None,
        informed_by: None,
    }
}

fn record() -> PlanRecord {
    PlanRecord {
        arrangements: Vec::new(),
        schema: "kalfit-plan/1".to_owned(),
        kalfit_version: "0.1.0".to_owned(),
        title: "Gyros".to_owned(),
        model_digest: None,
        from: "fit.json".to_owned(),
        design: DataRecord {
            tests: 4,
            steps: 40,
            observations: 39,
            design_classes: 4,
            square_root_tests: 0,
            files: vec!["bench.csv".to_owned()],
        },
        information: "expected".to_owned(),
        parameters_taken_as_known: vec!["tau".to_owned(), "sigma".to_owned()],
        tests: vec![1, 20, 500],
        quantities: vec![
            quantity("mean", &["bias"], Some(0.5), Ok([0.4, 0.09, 0.018])),
            quantity("mean", &["scale"], Some(300.0), Err("fixed")),
            quantity("mean", &["rate"], Some(1e-6), Err("unidentified")),
            quantity("regression", &["bias"], Some(2.0), Ok([0.0, f64::MIN_POSITIVE, 1e300])),
            quantity("std_dev", &["scale"], Some(0.0), Err("boundary")),
            quantity("correlation", &["bias", "scale"], None, Err("boundary")),
            quantity("correlation", &["bias", "rate"], Some(0.0), Err("fixed")),
            quantity("covariance", &["bias", "bias"], Some(1.0), Ok([1.0, 0.2, 0.04])),
        ],
        best: None,
    }
}

#[test]
fn a_plan_says_what_is_expected_and_why_something_is_not() {
    assert_snapshot!(plan_summary(&record(), &TextStyle::default()), @"
    Gyros

    Design: 4 tests, 40 steps, 39 observations from bench.csv.
    Population: fit.json.

    Expected standard errors of the means
      state  unit   value          1 test  20 tests  500 tests
      bias   deg/h  0.500            0.40     0.090      0.018
      scale  deg/h    300           fixed         -          -
      rate   deg/h   1e-6  not identified         -          -

    Expected standard errors of the regression coefficients
      state  per unit of  value  1 test  20 tests  500 tests
      bias   lot [31m         2       0  2.2e-308    1.0e300

    Expected standard errors of the standard deviations
      state  unit   value    1 test  20 tests  500 tests
      scale  deg/h      0  boundary         -          -

    Expected standard errors of the correlations
      state        value    1 test  20 tests  500 tests
      bias, scale      -  boundary         -          -

    How to read this
      Standard errors come from the expected information at these values; N tests
        count as N/4 times the design. With few tests, estimates scatter more than
        this, and those of standard deviations are skewed.
      Boundary: the covariance is singular, and a standard error does not describe
        its estimates.
      Not identified: more tests like these would not help.
      tau and sigma are free in the model but are taken as known here, at their
        values in fit.json; if they were estimated too, standard errors would be
        larger.
    ");
}

#[test]
fn every_line_fits_and_holds_no_control_character() {
    for width in 60..130 {
        let text = plan_summary(&record(), &TextStyle { width, color: false });
        for line in text.lines() {
            assert!(line.chars().count() <= width, "{} > {width}: {line}", line.chars().count());
            assert!(!line.chars().any(char::is_control), "{line:?}");
        }
        assert!(!text.contains("NaN"), "{text}");
    }
}
