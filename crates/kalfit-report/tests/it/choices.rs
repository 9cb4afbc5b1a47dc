//! What the summary says of profile intervals, and of tests left out.

#[allow(dead_code, reason = "each test crate uses its own part of it")]
use crate::common;

use kalfit::FitRecord;
use kalfit::record::{CoefficientLawRecord, DeletionRecord, RegressionRecord};
use kalfit_report::{TextStyle, summary};

fn at(width: usize, record: &FitRecord) -> String {
    summary(record, &TextStyle { width, color: false })
}

/// The section under a heading that starts so.
fn section(width: usize, record: &FitRecord, heading: &str) -> String {
    let text = at(width, record);
    let from = text.find(heading).map_or("", |at| &text[at..]);
    from.split("\n\n").next().unwrap_or_default().to_owned() + "\n"
}

/// The sleep study by profile likelihood.
fn profiled() -> FitRecord {
    let mut record = common::sleepstudy();
    record.intervals = "profile".into();
    let main = &mut record.phases[0];
    main.mean.interval95 = vec![Some([Some(237.68), Some(265.13)]), Some([Some(7.3586), Some(13.576)])];
    main.mean.regression.push(RegressionRecord {
        few_tests: CoefficientLawRecord::default(),
        state: "slope".into(),
        column: "age".into(),
        estimate: -0.1234,
        std_error: Some(0.05),
        interval95: Some([Some(-0.24), Some(-0.02)]),
    });
    main.std_dev.interval95 = vec![Some([Some(14.381), Some(37.716)]), Some([Some(3.801), Some(8.7534)])];
    main.correlation.interval95[1][0] = Some([Some(-0.4815), Some(0.6849)]);
    main.correlation.interval95[0][1] = main.correlation.interval95[1][0];
    record
}

fn intervals(record: &FitRecord) -> String {
    section(80, record, "95 % intervals")
}

#[test]
fn profile_intervals_are_a_table_and_wald_intervals_are_not() {
    insta::assert_snapshot!(intervals(&profiled()), @"
    95 % intervals by profile likelihood
                                       estimate    from      to
      mean of intercept                   251.4   237.7   265.1
      mean of slope                        10.5     7.4    13.6
      mean of slope per age              -0.123  -0.240  -0.020
      std dev of intercept                 23.8    14.4    37.7
      std dev of slope                      5.7     3.8     8.8
      correlation of intercept, slope      0.08   -0.48    0.68
    ");
    let wald = FitRecord { intervals: "wald".into(), ..profiled() };
    assert_eq!(intervals(&wald), "\n");
    assert_eq!(intervals(&FitRecord { phases: common::sleepstudy().phases, ..profiled() }), "\n", "no interval at all");
}

#[test]
fn ends_that_the_data_do_not_set_are_left_open() {
    let mut record = profiled();
    let main = &mut record.phases[0];
    main.mean.interval95[0] = Some([None, Some(265.13)]);
    main.std_dev.interval95[0] = Some([Some(0.0), None]);
    main.correlation.interval95[1][0] = Some([None, None]);
    insta::assert_snapshot!(intervals(&record), @"
    95 % intervals by profile likelihood
                                       estimate    from      to
      mean of intercept                   251.4       -   265.1
      mean of slope                        10.5     7.4    13.6
      mean of slope per age              -0.123  -0.240  -0.020
      std dev of intercept                   24       0       -
      std dev of slope                      5.7     3.8     8.8
      correlation of intercept, slope   0.08132       -       -
      - no limit was found on this side.
    ");
}

#[test]
fn intervals_of_nothing_are_left_out() {
    let mut record = profiled();
    let main = &mut record.phases[0];
    main.mean.interval95 = vec![None];
    main.mean.regression.clear();
    main.std_dev.interval95 = vec![];
    main.correlation.interval95 = vec![];
    assert_eq!(intervals(&record), "\n");
    record.phases[0].std_dev.interval95 = vec![None, Some([Some(3.801), Some(8.7534)])];
    insta::assert_snapshot!(intervals(&record), @"
    95 % intervals by profile likelihood
                        estimate  from   to
      std dev of slope       5.7   3.8  8.8
    ");
}

#[test]
fn an_interval_of_no_width_and_figures_that_are_none_are_shown() {
    let mut record = profiled();
    let main = &mut record.phases[0];
    main.mean.interval95[0] = Some([Some(251.405105), Some(251.405105)]);
    main.mean.interval95[1] = Some([Some(f64::NAN), Some(f64::INFINITY)]);
    main.std_dev.estimate[0] = f64::NAN;
    insta::assert_snapshot!(intervals(&record), @"
    95 % intervals by profile likelihood
                                       estimate     from       to
      mean of intercept                 251.405  251.405  251.405
      mean of slope                     10.4673  unknown  unknown
      mean of slope per age              -0.123   -0.240   -0.020
      std dev of intercept              unknown   14.381   37.716
      std dev of slope                      5.7      3.8      8.8
      correlation of intercept, slope      0.08    -0.48     0.68
    ");
}

#[test]
fn phases_have_intervals_of_their_own() {
    let mut record = common::record("", vec![common::phase("align", &["bias"]), common::phase("coast", &["bias"])]);
    record.intervals = "profile".into();
    record.phases[0].mean.interval95[0] = Some([Some(0.5), Some(1.5)]);
    record.phases[1].mean.interval95[0] = Some([Some(0.4), Some(1.4)]);
    let text = at(80, &record);
    let headings: Vec<&str> = text.lines().filter(|line| line.contains("95 % intervals")).collect();
    insta::assert_snapshot!(headings.join("\n"), @"
    Phase align: 95 % intervals by profile likelihood
    Phase coast: 95 % intervals by profile likelihood
    ");
}

/// Tests `308`, `309`, … with these displacements.
fn deleted(displacements: &[f64]) -> FitRecord {
    let mut record = common::sleepstudy();
    record.tests = common::tests(&vec![0.5; displacements.len()]);
    common::change_tests(&mut record, |number, test| {
        test.deletion = Some(DeletionRecord {
            log_density: -50.0,
            distance: Some(9.0),
            p_value: Some(0.011),
            displacement: displacements[number],
            phases: vec![],
        });
    });
    record
}

fn influence(record: &FitRecord) -> String {
    section(80, record, "Influence of single tests")
}

#[test]
fn where_no_test_decides_the_most_influential_is_named() {
    insta::assert_snapshot!(influence(&deleted(&[0.3, 1.234, 0.8])), @"
    Influence of single tests
      No single test is influential. Test 309 moves the estimates most: its Cook's
        displacement is 1.2, and 5.4 is the edge of the 50 % confidence region.
    ");
    assert_eq!(influence(&deleted(&[])), "\n");
    assert_eq!(influence(&common::sleepstudy()), "\n", "no test was left out");
}

#[test]
fn tests_that_decide_are_a_table() {
    let mut record = deleted(&[0.3, 12.34, 5.4, 7.0]);
    common::change_test(&mut record, 3, |test| test.deletion.as_mut().expect("it was left out").p_value = None);
    insta::assert_snapshot!(influence(&record), @"
    Influence of single tests
      test  displacement  p-value without it
      309           12.3                0.01
      311              7                   -
      310            5.4                0.01
      Leaving any one of these tests out moves the estimates outside the 50 %
        confidence region of the full fit.
      Displacement (Cook's): twice the drop in the log-likelihood of all tests when
        the estimates from the other tests are used. The p-value says how well the
        test agrees with the estimates from the other tests.
    ");
}

#[test]
fn the_most_influential_of_many_are_shown() {
    insta::assert_snapshot!(influence(&deleted(&[9.0, 12.0, 8.0, 7.0, 6.0, 5.5, 10.0, 11.0, 0.1])), @"
    Influence of single tests
      test  displacement  p-value without it
      309             12                0.01
      315             11                0.01
      314             10                0.01
      308              9                0.01
      310              8                0.01
      Leaving any one of these tests (and of 3 more) out moves the estimates outside
        the 50 % confidence region of the full fit.
      Displacement (Cook's): twice the drop in the log-likelihood of all tests when
        the estimates from the other tests are used. The p-value says how well the
        test agrees with the estimates from the other tests.
    ");
}

/// The median of χ²(6) is 5.348.
#[test]
fn a_test_decides_beyond_half_of_the_confidence() {
    let table = |displacement: f64| influence(&deleted(&[displacement])).contains("Displacement (Cook's): ");
    assert!(!table(5.34), "{}", influence(&deleted(&[5.34])));
    assert!(table(5.36), "{}", influence(&deleted(&[5.36])));
}

#[test]
fn displacements_that_are_no_numbers_are_left_out() {
    assert_eq!(influence(&deleted(&[f64::NAN, f64::INFINITY])), "\n");
    insta::assert_snapshot!(influence(&deleted(&[f64::NAN, 1.0, -1e-9])), @"
    Influence of single tests
      No single test is influential. Test 309 moves the estimates most: its Cook's
        displacement is 1, and 5.4 is the edge of the 50 % confidence region.
    ");
}

#[test]
fn every_line_fits_the_page() {
    let mut long = deleted(&[12.0, 30.0]);
    common::change_test(&mut long, 0, |test| test.id = "test_with_a_long_name_".repeat(8));
    common::change_test(&mut long, 1, |test| test.id = "\u{1b}[31mred\nline".into());
    let mut wide = profiled();
    wide.phases[0].states[0] = "a_state_with_a_long_name_".repeat(6);
    for record in [profiled(), long, wide] {
        for width in [60, 72, 80, 120, 200] {
            for line in at(width, &record).lines() {
                assert!(line.chars().count() <= width, "{} > {width}: {line}", line.chars().count());
                assert!(!line.contains('\u{1b}'), "{line:?}");
            }
        }
    }
}
