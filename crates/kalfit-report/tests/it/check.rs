//! What `kalfit check` prints.

use kalfit::record::{DataRecord, ObservabilityRecord, UnidentifiedRecord};
use kalfit_report::{CheckFindings, CheckRecord, CheckedPhase, PhaseCounts, TextStyle, check_summary};

fn shown(checked: CheckFindings) -> String {
    let record = CheckRecord::new(
        "Reaction time".into(),
        vec![
            "tests: one for each value of column `Subject`".into(),
            "measurement `reaction`: column `Reaction` = intercept + Days × slope; noise of variance 654.94103".into(),
        ],
        vec![],
        checked,
    );
    check_summary(&record, &TextStyle::default())
}

fn reduced(unidentified: Vec<UnidentifiedRecord>, at_start_of: Vec<String>) -> CheckFindings {
    let files = vec!["a.csv".into(), "b.csv".into()];
    let data = DataRecord { tests: 18, steps: 180, observations: 180, design_classes: 2, square_root_tests: 0, files };
    let state = |state: &str, informed_by, observed_by, share| ObservabilityRecord {
        state: state.into(),
        informed_by,
        observed_by,
        tests: vec![],
        leading_test: Some("308".into()),
        leading_share: Some(share),
    };
    let phase = CheckedPhase {
        counts: PhaseCounts { name: "main".into(), tests: 18, rows: 180, without_rows: 0 },
        states: vec!["intercept".into(), "slope".into()],
        observability: vec![state("intercept", 18, 18, 0.0612), state("slope", 17, 0, 0.93)],
        unidentified,
        weak: vec![],
        information: None,
    };
    CheckFindings::Reduced { data, phases: vec![phase], levels: vec![], notes: vec![], at_start_of }
}

#[test]
fn a_model_alone() {
    insta::assert_snapshot!(shown(CheckFindings::Model), @"
    Reaction time

    Model
      tests: one for each value of column `Subject`
      measurement `reaction`: column `Reaction` = intercept + Days × slope; noise of
        variance 654.94103

    The model is valid. Give data as well to see what they can identify.
    ");
}

#[test]
fn identified_quantities_are_all_there_is_to_say() {
    insta::assert_snapshot!(shown(reduced(vec![], vec!["sigma".into()])), @"
    Reaction time

    Model
      tests: one for each value of column `Subject`
      measurement `reaction`: column `Reaction` = intercept + Days × slope; noise of
        variance 654.94103

    Data
      18 tests, 180 steps, 180 observations from a.csv and b.csv. The tests have 2
        different designs (times, inputs and missing values).

    Observability
      state       seen by  determined by  largest share
      intercept    all 18         all 18  6.1 %, 308
      slope      17 of 18           none  93 %, 308
      Seen by: tests whose measurements depend on the state. Determined by: tests
        that could estimate it by themselves. Largest share: the test with the most
        information on the mean, and its part of all information.

    Identifiability
      The data identify all free elements of the mean and the covariance.
      93 % of the information on the mean of slope comes from one test, 308.
      Computed with sigma at its start value.
    ");
}

#[test]
fn unidentified_directions_are_named() {
    let direction = |what: &str, direction: Vec<f64>, elements: Vec<&str>| UnidentifiedRecord {
        what: what.into(),
        direction,
        elements: elements.into_iter().map(String::from).collect(),
        tests: vec![],
        reason: "no test observes `slope`".into(),
        phases: vec![],
    };
    let pairs = vec!["intercept, intercept", "intercept, slope", "slope, slope"];
    let unidentified = vec![
        direction("mean", vec![0.0, 1.0], vec![]),
        direction("covariance", vec![0.0, 1.0, 0.0], pairs.clone()),
        direction("covariance", vec![0.6, 0.0, -0.8], pairs),
    ];
    insta::assert_snapshot!(shown(reduced(unidentified, vec![])), @"
    Reaction time

    Model
      tests: one for each value of column `Subject`
      measurement `reaction`: column `Reaction` = intercept + Days × slope; noise of
        variance 654.94103

    Data
      18 tests, 180 steps, 180 observations from a.csv and b.csv. The tests have 2
        different designs (times, inputs and missing values).

    Observability
      state       seen by  determined by  largest share
      intercept    all 18         all 18  6.1 %, 308
      slope      17 of 18           none  93 %, 308
      Seen by: tests whose measurements depend on the state. Determined by: tests
        that could estimate it by themselves. Largest share: the test with the most
        information on the mean, and its part of all information.

    Identifiability
      Not identified: the mean of slope, the covariance of intercept and slope and
        the combination 0.8 var(slope) - 0.6 var(intercept). No test observes
        `slope`.
      93 % of the information on the mean of slope comes from one test, 308.
    ");
}
