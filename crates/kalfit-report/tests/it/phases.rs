//! Fits and checks of tests in several phases.

use kalfit::FitRecord;
use kalfit::record::{
    ConstraintRecord, DataRecord, EnteredRecord, FilterRecord, InformationLostRecord, InformationRecord,
    ObservabilityRecord, UnidentifiedRecord, WeakRecord,
};
use kalfit_report::{CheckFindings, CheckRecord, CheckedPhase, PhaseCounts, TextStyle, check_summary, summary};

use crate::common::{phase, record};

/// Alignment, then flight, which 14 of 18 tests have.
fn two() -> FitRecord {
    let mut align = phase("align", &["tilt", "bias"]);
    align.tests = Some(18);
    align.units = vec![Some("mrad".into()), Some("mrad/min".into())];
    let mut flight = phase("flight", &["tilt"]);
    flight.tests = Some(14);
    record("Inertial platform", vec![align, flight])
}

fn information(own_rank: usize, rank_so_far: usize, of: usize) -> Option<InformationRecord> {
    let entered =
        vec![EnteredRecord { direction: vec![0.6, 0.8], elements: vec!["align.tilt".into(), "flight.tilt".into()] }];
    let entered = if own_rank == 0 { entered } else { vec![] };
    Some(InformationRecord { own_rank, entering: 2, rank_so_far, of, entered })
}

#[test]
fn each_phase_has_sections_of_its_own() {
    let mut fit = two();
    let constraint = |element: &str, p: f64| ConstraintRecord {
        level: None,
        element: element.into(),
        phase: "flight".into(),
        value: 0.0,
        sensitivity: Some(1.5),
        score_statistic: Some(9.0),
        p_value: Some(p),
        expected_change: Some(0.2),
        likelihood_ratio: (p < 0.02).then_some(6.8),
        likelihood_ratio_p_value: (p < 0.02).then_some(0.009),
        f: None,
        f_df: None,
        f_p_value: None,
    };
    fit.constraints = vec![constraint("mean[tilt]", 0.002)];
    insta::assert_snapshot!(summary(&fit, &TextStyle::default()), @"
    Inertial platform

    Data: 18 tests, 180 steps, 180 observations from data.csv.
    Phases: align (18 tests) and flight (14 of 18 tests); combined exactly, phase by
    phase (chain).

    Phase align: initial state over the tests (± standard error)
      state  unit      mean         std dev
      tilt   mrad      1.00 ± 0.25     1.00 ± 0.15
      bias   mrad/min  2.00 ± 0.25     1.00 ± 0.15
      With 18 tests, ± 1.96 standard errors hold the mean about 92 % of the time;
        --criterion reml allows for that.

    Phase align: correlations (± standard error)
                   tilt
      bias  0.00 ± 0.20

    Phase flight: initial state over the tests (± standard error)
      state  mean         std dev
      tilt   1.00 ± 0.25     1.00 ± 0.15

    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates.
    Model check passed: the tests agree with the population (innovations were not
    computed).
    Log-likelihood -875.97, 6 free parameters, AIC 1763.94, BIC 1783.10.

    What to do next
      Nothing needs attention: the fit converged and the model describes the data.

    Constraints (score test of each one separately)
      element             held at  dℓ/dvalue  p-value  p of refit  if freed
      flight: mean[tilt]        0        1.5    0.002       0.009       0.2
      The data contradict the constraint on flight: mean[tilt] (5 % level).

    Outlying tests
      No test is an outlier: the smallest of 4 p-values is 0.02 (test 310), or 0.08
        after Bonferroni correction.

    All tests have the same design (times, inputs and missing values).
    Computation: solver newton, 9 iterations, 1 filter run, 12 ms.
    ");
}

#[test]
fn what_the_marginal_combination_leaves_out_is_said() {
    let mut fit = two();
    fit.solver.phases = "marginal".into();
    fit.composite_log_likelihood = Some(-900.123);
    (fit.aic, fit.bic) = (None, None);
    let text = summary(&fit, &TextStyle::default());
    let lines: Vec<&str> = text.lines().skip(7).take(9).collect();
    insta::assert_snapshot!(lines.join("\n"), @"
    between phases.

    Phase align: initial state over the tests (± standard error)
      state  unit      mean         std dev
      tilt   mrad      1.00 ± 0.25     1.00 ± 0.15
      bias   mrad/min  2.00 ± 0.25     1.00 ± 0.15
      With 18 tests, ± 1.96 standard errors hold the mean about 92 % of the time;
        --criterion reml allows for that.
    ");
    fit.composite_log_likelihood = Some(f64::NAN);
    assert!(!summary(&fit, &TextStyle::default()).contains("NaN"));
}

#[test]
fn a_likelihood_of_estimates_is_said_to_be_one_and_what_the_filters_lost_is_said() {
    let mut fit = two();
    fit.log_likelihood_kind = "estimates".into();
    (fit.aic, fit.bic) = (None, None);
    let lost = InformationLostRecord {
        mean_std_error_ratio: vec![Some(1.045), None],
        covariance_std_error_ratio: vec![vec![Some(1.0897), Some(1.05)], vec![Some(1.05), None]],
        log_det_ratio: Some(-0.488),
    };
    let filter = |consider: &[&str], information_lost| {
        let consider = consider.iter().map(|&name| name.into()).collect();
        Some(FilterRecord { kind: "kalman-schmidt".into(), consider, information_lost })
    };
    fit.phases[0].filter = filter(&["scale"], Some(lost));
    fit.phases[1].filter = filter(&[], None);
    let text = summary(&fit, &TextStyle::default());
    let part = |from: &str, lines: usize| -> String {
        let at = text.find(from).unwrap_or_else(|| panic!("no {from} in\n{text}"));
        text[at..].lines().take(lines).collect::<Vec<_>>().join("\n")
    };
    insta::assert_snapshot!(part("Log-likelihood", 3), @"
    Log-likelihood of the estimates -875.97, 6 free parameters.
    This log-likelihood is that of the filters' estimates, not of the measurements.
    Compare it only with fits to the same estimates.
    ");
    insta::assert_snapshot!(part("Filters", 6), @"
    Filters
      Phase align: the estimates of a filter replace the measurements; it accounts
        for the uncertainty of scale without estimating it. Information was lost:
        expected standard errors are up to 9 % larger than those of a fit to the
        measurements (for the variance of tilt).
      Phase flight: the estimates of a filter replace the measurements.
    ");
}

#[test]
fn directions_that_mix_phases_are_left_to_the_notes() {
    let mut fit = two();
    let part = |direction: &[f64], elements: &[&str]| UnidentifiedRecord {
        what: "mean".into(),
        direction: direction.to_vec(),
        elements: elements.iter().map(|&name| name.into()).collect(),
        tests: vec![],
        reason: "no test separates `align.tilt` and `flight.tilt`".into(),
        phases: vec!["align".into(), "flight".into()],
    };
    fit.phases[0].unidentified = vec![part(&[0.7, 0.0], &["tilt", "bias"])];
    fit.phases[1].unidentified = vec![part(&[-0.7], &["tilt"])];
    fit.phases[0].mean.std_error[0] = None;
    fit.phases[1].mean.std_error[0] = None;
    fit.phases[0].weakly_determined = vec![WeakRecord {
        direction: vec![0.0, 0.7],
        condition: 50.0,
        leading_test: None,
        leading_share: None,
        phases: vec!["align".into(), "flight".into()],
    }];
    fit.notes = vec!["the phases together say nothing about 0.71 align.tilt - 0.71 flight.tilt".into()];
    let text = summary(&fit, &TextStyle::default());
    assert!(!text.contains("What the data cannot determine"), "{text}");
    assert!(text.contains("The phases together say nothing about 0.71 align.tilt - 0.71 flight.tilt."), "{text}");
    assert_eq!(text.matches("1 not identified").count(), 2, "beside both means:\n{text}");
}

#[test]
fn what_enters_at_each_phase_is_a_table() {
    let mut fit = two();
    fit.phases[0].information = information(2, 2, 2);
    fit.phases[1].information = information(0, 3, 3);
    let text = summary(&fit, &TextStyle::default());
    let at = text.find("What the phases observe").expect("it is there");
    insta::assert_snapshot!(text[at..].lines().take(8).collect::<Vec<_>>().join("\n"), @"
    What the phases observe
      phase   observed by itself  observed so far
      align   2 of 2              2 of 2
      flight  0 of 2              3 of 3
      Number of directions that the tests together observe. By itself: of all states
        that enter the phase (its own and inherited ones). So far: of the estimated
        states of this and all earlier phases.
      From phase flight on: 0.8 flight.tilt + 0.6 align.tilt.
    ");
    assert!(!summary(&two(), &TextStyle::default()).contains("What the phases observe"), "nothing is known of it");
    fit.phases[1].information = information(2, 3, 3);
    let text = summary(&fit, &TextStyle::default());
    assert!(!text.contains("What the phases observe"), "each phase observes all that enters it:\n{text}");
}

fn checked(phases: Vec<CheckedPhase>, notes: Vec<String>) -> String {
    let data = DataRecord {
        tests: 18,
        steps: 180,
        observations: 150,
        design_classes: 2,
        square_root_tests: 0,
        files: vec!["data.csv".into()],
    };
    let checked = CheckFindings::Reduced { data, phases, levels: vec![], notes, at_start_of: vec![] };
    let record = CheckRecord::new("Platform".into(), vec!["phases".into()], vec![], checked);
    check_summary(&record, &TextStyle::default())
}

fn seen(name: &str, tests: usize, states: &[&str]) -> CheckedPhase {
    let state = |state: &&str| ObservabilityRecord {
        state: (*state).into(),
        informed_by: tests,
        observed_by: tests,
        tests: vec![],
        leading_test: Some("p01".into()),
        leading_share: Some(1.0 / tests as f64),
    };
    CheckedPhase {
        counts: PhaseCounts { name: name.into(), tests, rows: 10 * tests, without_rows: 0 },
        states: states.iter().map(|&name| name.into()).collect(),
        observability: states.iter().map(state).collect(),
        unidentified: vec![],
        weak: vec![],
        information: None,
    }
}

#[test]
fn a_check_looks_at_each_phase() {
    let align = CheckedPhase { information: information(2, 2, 2), ..seen("align", 18, &["tilt", "bias"]) };
    let mut flight = CheckedPhase { information: information(0, 3, 3), ..seen("flight", 14, &["tilt"]) };
    flight.counts.without_rows = 4;
    insta::assert_snapshot!(checked(vec![align, flight], vec!["all is not well".into()]), @"
    Platform

    Model
      phases

    Data
      18 tests, 180 steps, 150 observations from data.csv. The tests have 2
        different designs (times, inputs and missing values).

      phase      tests  rows  tests without rows
      align     all 18   180                   0
      flight  14 of 18   140                   4

    Phase align: observability
      state  seen by  determined by  largest share
      tilt    all 18         all 18  all equal
      bias    all 18         all 18  all equal
      Seen by: tests whose measurements depend on the state. Determined by: tests
        that could estimate it by themselves. Largest share: the test with the most
        information on the mean, and its part of all information.

    Phase align: identifiability
      The data identify all free elements of the mean and the covariance.

    Phase flight: observability
      state  seen by  determined by  largest share
      tilt    all 14         all 14  all equal
      Seen by: tests whose measurements depend on the state. Determined by: tests
        that could estimate it by themselves. Largest share: the test with the most
        information on the mean, and its part of all information.

    Phase flight: identifiability
      The data identify all free elements of the mean and the covariance.

    What the phases observe
      phase   observed by itself  observed so far
      align   2 of 2              2 of 2
      flight  0 of 2              3 of 3
      Number of directions that the tests together observe. By itself: of all states
        that enter the phase (its own and inherited ones). So far: of the estimated
        states of this and all earlier phases.
      From phase flight on: 0.8 flight.tilt + 0.6 align.tilt.

    All phases
      All is not well.
    ");
}

#[test]
fn a_check_says_where_a_combination_over_the_phases_is_not_identified() {
    let mut flight = seen("flight", 14, &["tilt"]);
    flight.unidentified = vec![UnidentifiedRecord {
        what: "mean".into(),
        direction: vec![0.7],
        elements: vec!["tilt".into()],
        tests: vec![],
        reason: String::new(),
        phases: vec!["align".into(), "flight".into()],
    }];
    let text = checked(vec![seen("align", 18, &["tilt"]), flight], vec!["the whole combination".into()]);
    let at = text.find("Phase flight: identifiability").expect("it is there");
    insta::assert_snapshot!(&text[at..], @"
    Phase flight: identifiability
      Not identified: combinations with states of other phases or levels; see below.

    All phases
      The whole combination.
    ");
}
