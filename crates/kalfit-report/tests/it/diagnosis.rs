//! What the summary says of innovations and observability.

#[allow(dead_code, reason = "each test crate uses its own part of it")]
use crate::common;

use kalfit::FitRecord;
use kalfit::record::{InnovationPartRecord, InnovationRecord, ObservabilityRecord, WeakRecord, WhitenessRecord};
use kalfit_report::{TextStyle, summary};

fn innovations(nis: f64, nis_p: f64, white_p: f64) -> InnovationRecord {
    let whiteness = WhitenessRecord { statistic: 4.5, lags: 2, degrees_of_freedom: 2, p_value: white_p };
    InnovationRecord {
        whitened_nis: None,
        count: 10,
        nis: Some(nis),
        nis_p_value: Some(nis_p),
        mean: Some(0.1),
        whiteness: Some(whiteness),
        parts: Vec::new(),
        series: None,
    }
}

fn record(found: &[InnovationRecord]) -> FitRecord {
    let mut record = common::sleepstudy();
    record.tests = common::tests(&vec![0.5; found.len()]);
    common::change_tests(&mut record, |number, test| test.innovations = Some(found[number].clone()));
    record
}

/// The section on innovations.
fn section(record: &FitRecord) -> String {
    let text = summary(record, &TextStyle::default());
    let from = text.find("Innovations (measured").map_or("", |at| &text[at..]);
    from.split("\n\n").next().unwrap_or_default().to_owned() + "\n"
}

#[test]
fn probable_innovations_are_said_to_be_so() {
    let record = record(&[innovations(9.0, 0.9, 0.4), innovations(14.0, 0.3, 0.03)]);
    insta::assert_snapshot!(section(&record), @"
    Innovations (measured minus predicted)
      Mean square of all 20 innovations, each divided by its standard deviation:
        1.15 (expected 1 ± 0.32).
      Innovation checks passed for all tests (smallest p = 0.03, time correlation in
        309; 0.12 after Holm correction for 4 tests).
    ");
}

#[test]
fn improbable_innovations_are_named_by_test_and_kind() {
    let found = [innovations(9.0, 0.9, 1e-5), innovations(60.0, 7e-9, 0.5), innovations(0.3, 2e-4, 0.6)];
    insta::assert_snapshot!(section(&record(&found)), @"
    Innovations (measured minus predicted)
      test  what                   found  expected  p-value    Holm
      309   larger than modelled      60        10     7e-9    4e-8
      308   correlated in time       4.5         2     1e-5    5e-5
      310   smaller than modelled    0.3        10   0.0002  0.0008
      These are improbable at the 1.8 % level, after Holm correction for 6 p-values:
        a size that differs from the model suggests other noise levels, or faults in
        the test; correlation in time suggests a missing process, such as a drift.
      Mean square of all 30 innovations, each divided by its standard deviation:
        2.31 (expected 1 ± 0.26). That is more than chance allows: the model has too
        little noise, or lacks a process.
    ");
}

#[test]
fn holms_correction_stops_at_the_first_that_is_probable() {
    // of ten p-values 0.0012 passes (times 10), 0.0016 does too (times 9), 0.0024 does not (times 8)
    let p_values = [0.0012, 0.0016, 0.0024, 0.5, 0.6];
    let found: Vec<InnovationRecord> = p_values.iter().map(|&p| innovations(20.0, p, 0.9)).collect();
    let text = section(&record(&found));
    assert_eq!(text.matches("larger than modelled").count(), 2, "{text}");
}

#[test]
fn records_without_innovations_say_nothing_and_broken_ones_do_no_harm() {
    assert_eq!(section(&record(&[])), "\n");
    let broken = InnovationRecord {
        whitened_nis: None,
        count: 0,
        nis: None,
        nis_p_value: Some(f64::NAN),
        mean: None,
        whiteness: None,
        parts: vec![],
        series: None,
    };
    assert_eq!(section(&record(&[broken])), "\n");
    let text = section(&record(&[innovations(f64::INFINITY, 0.0, f64::NAN)]));
    assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
}

#[test]
fn states_that_hang_on_one_test_and_weak_directions_are_warned_of() {
    let mut record = common::sleepstudy();
    let state = |state: &str, informed_by, tests: &[&str], share| ObservabilityRecord {
        state: state.into(),
        informed_by,
        observed_by: 1,
        tests: tests.iter().map(|&t| t.into()).collect(),
        leading_test: Some("335".into()),
        leading_share: Some(share),
    };
    let phase = &mut record.phases[0];
    phase.observability = vec![state("intercept", 1, &["308"], 1.0), state("slope", 18, &[], 0.957)];
    phase.weakly_determined = vec![WeakRecord {
        direction: vec![0.6, -0.8],
        condition: 45.3,
        leading_test: Some("335".into()),
        leading_share: Some(0.4),
        phases: vec![],
    }];
    let text = summary(&record, &TextStyle::default());
    let at = text.find("What the data cannot").expect("a section");
    insta::assert_snapshot!(text[at..].split("\n\n").next().unwrap(), @"
    What the data cannot determine
      Only one test, 308, contains information on intercept.
      96 % of the information on the mean of slope comes from one test, 335.
      Weakly determined: the combination 0.8 slope - 0.6 intercept of the means has
        an error 45 times larger than that of the best determined combination, in
        comparable units.
    ");
}

#[test]
fn innovations_of_phases_are_told_apart() {
    let part = |phase: &str, nis: f64, p: f64| InnovationPartRecord {
        phase: phase.to_owned(),
        measurement: "y".to_owned(),
        innovations: innovations(nis, p, 0.5),
    };
    let mut both = InnovationRecord { count: 20, ..innovations(51.0, 1e-6, 0.5) };
    both.parts = vec![part("align", 9.0, 0.8), part("flight", 42.0, 1e-7)];
    let mut record = record(&[both]);
    let mut flight = record.phases[0].clone();
    record.phases[0].name = "align".to_owned();
    flight.name = "flight".to_owned();
    record.phases.push(flight);
    let text = section(&record);
    let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let expected = "By phase: 0.90 in align (10, 1 ± 0.45), 4.20 in flight (10, 1 ± 0.45).";
    assert!(words.contains(expected), "{text}");
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split_whitespace().collect()).collect();
    assert_eq!(rows[1][..3], ["test", "most", "in"], "{text}");
    assert_eq!(rows[2][1], "flight", "{text}");
}
