//! Times as numbers and as date-times.

#![expect(clippy::unwrap_used, reason = "also in what the tests share")]

use crate::support;

use std::sync::Arc;

use arrow_array::{ArrayRef, Date32Array, Int64Array, TimestampMillisecondArray, TimestampNanosecondArray};
use kalfit::Layout;
use support::*;

fn times(bytes: &[u8], unit: &str) -> Vec<Vec<f64>> {
    let model = with_unit(model(&["t"], &[], Some("t")), unit);
    let (sink, _) = collect_stdin(&model, &by("id"), bytes).unwrap();
    sink.tests.iter().map(|test| (0..test.rows()).map(|row| test.numbers(row)[0]).collect()).collect()
}

#[test]
fn date_times_are_read_as_time_since_the_first_row_of_each_test() {
    let csv = b"id,t\na,2024-02-28T23:59:59.5Z\na,2024-02-29 00:00:00+00:00\na,2024-02-29T01:00:00.25+01:00\nb,2024-01-01T00:00:00Z\nb,2024-01-02T00:00:00Z\n";
    assert_eq!(times(csv, "s"), [vec![0.0, 0.5, 0.75], vec![0.0, 86_400.0]]);
    assert_eq!(times(csv, "ms"), [vec![0.0, 500.0, 750.0], vec![0.0, 86_400_000.0]]);
    assert_eq!(times(csv, "days")[1], [0.0, 1.0]);
}

#[test]
fn dates_without_a_clock_are_midnights() {
    let csv = b"id,t\na,2023-12-31\na,2024-01-01\na,2024-01-01 06:00\na,2025-01-01\n";
    assert_eq!(times(csv, "d"), [[0.0, 1.0, 1.25, 367.0]]);
}

#[test]
fn scattered_date_times_count_from_the_first_row_of_their_test() {
    let csv = b"id,t\na,2024-01-01T00:00:10Z\nb,2024-01-01T00:00:00Z\na,2024-01-01T00:00:13Z\n";
    assert_eq!(times(csv, "s"), [vec![0.0, 3.0], vec![0.0]]);
}

#[test]
fn timestamps_and_dates_of_parquet_and_arrow_are_date_times() {
    let id = || Arc::new(Int64Array::from(vec![1, 1, 1])) as ArrayRef;
    let at = 1_700_000_000_000;
    let ms = batch(vec![("id", id()), ("t", Arc::new(TimestampMillisecondArray::from(vec![at, at + 1, at + 1500])))]);
    assert_eq!(times(&parquet(&ms, 2), "s"), [[0.0, 0.001, 1.5]]);
    let ns = TimestampNanosecondArray::from(vec![at, at + 1, at + 5]).with_timezone("+01:00");
    let ns = batch(vec![("id", id()), ("t", Arc::new(ns) as ArrayRef)]);
    assert_eq!(times(&arrow_stream(&ns, 2), "us"), [[0.0, 0.001, 0.005]]);
    let days = batch(vec![("id", id()), ("t", Arc::new(Date32Array::from(vec![-1, 0, 31])) as ArrayRef)]);
    assert_eq!(times(&parquet(&days, 2), "h"), [[0.0, 24.0, 768.0]]);
}

#[test]
fn numbers_stay_as_they_are_and_need_no_unit() {
    let model = model(&["t", "y"], &[], Some("t"));
    let (sink, _) = collect_stdin(&model, &Layout::default(), b"t,y\n-5,1\n-5,2\n0.1,3\n1e3,4\n").unwrap();
    let found: Vec<f64> = (0..4).map(|row| sink.tests[0].numbers(row)[0]).collect();
    assert_eq!(found, [-5.0, -5.0, 0.1, 1000.0]);
}

#[test]
fn times_may_restart_with_the_next_test() {
    let model = model(&["t"], &[], Some("t"));
    let (sink, _) = collect_stdin(&model, &by("id"), b"id,t\na,5\na,6\nb,1\nb,1\n").unwrap();
    assert_eq!(sink.tests.len(), 2);
}

fn phased(unit: Option<&str>) -> kalfit::PhasedModel {
    let mut model = model(&["t"], &["phase"], Some("t"));
    model.phases[0].model.clock.unit = unit.map(str::to_owned);
    model.column = Some(0);
    model
}

#[test]
fn times_may_restart_with_the_next_phase_and_a_phase_may_come_back() {
    let csv = b"id,phase,t\na,up,5\na,up,6\na,down,0\na,down,1\na,up,6\na,down,3\nb,up,2\n";
    let (sink, _) = collect_stdin(&phased(None), &by("id"), csv).unwrap();
    let found: Vec<f64> = (0..6).map(|row| sink.tests[0].numbers(row)[0]).collect();
    assert_eq!(found, [5.0, 6.0, 0.0, 1.0, 6.0, 3.0]);
}

#[test]
fn times_must_not_decrease_within_a_phase() {
    let refused = |csv: &[u8]| {
        let error = collect_stdin(&phased(None), &by("id"), csv).expect_err("times decrease");
        format!("{error}\nhint: {}", error.hint().unwrap())
    };
    insta::assert_snapshot!(refused(b"id,phase,t\na,up,5\na,down,0\na,down,1\na,up,4\n"), @"
    standard input, row 5, column `t`: found time 4 after time 5 in phase `up` of test `a`, expected times that do not decrease
    hint: sort the rows of each phase by time; times may start again with the next phase only
    ");
    insta::assert_snapshot!(refused(b"id,phase,t\na,,5\na,,4\n"), @"
    standard input, row 3, column `t`: found time 4 after time 5 in test `a`, expected times that do not decrease
    hint: sort the rows of each test by time; if these are two tests, give them two ids
    ");
}

/// Nanoseconds since 1970 are no floats: they are compared, and printed, as they stand in the file.
#[test]
fn whole_times_of_many_digits_are_told_as_they_stand() {
    let model = model(&["t"], &[], Some("t"));
    let refused = |csv: &str| collect_stdin(&model, &by("id"), csv.as_bytes()).expect_err("times decrease").to_string();
    insta::assert_snapshot!(refused("id,t\na,1403643780707532394\na,1403643768757536499\n"), @"standard input, row 3, column `t`: found time 1403643768757536499 after time 1403643780707532394 in test `a`, expected times that do not decrease");
    insta::assert_snapshot!(refused("id,t\na,1403643780707532394\na,1403643780707532393\n"), @"standard input, row 3, column `t`: found time 1403643780707532393 after time 1403643780707532394 in test `a`, expected times that do not decrease");
    let sound = "id,t\na,1\na,1403643780707532394\na,1403643780707532395\nb,2.5\n";
    let (sink, _) = collect_stdin(&model, &by("id"), sound.as_bytes()).unwrap();
    let found: Vec<f64> = (0..3).map(|row| sink.tests[0].numbers(row)[0]).collect();
    assert_eq!(found, [1.0, 1_403_643_780_707_532_394_i64 as f64, 1_403_643_780_707_532_395_i64 as f64]);
}

#[test]
fn date_times_of_all_phases_count_from_the_first_row_of_the_test() {
    let csv = b"id,phase,t\na,up,2024-01-01T00:00:10Z\na,down,2024-01-01T00:00:13Z\na,up,2024-01-01T00:00:12Z\n";
    let (sink, _) = collect_stdin(&phased(Some("s")), &by("id"), csv).unwrap();
    let found: Vec<f64> = (0..3).map(|row| sink.tests[0].numbers(row)[0]).collect();
    assert_eq!(found, [0.0, 3.0, 2.0]);
}
