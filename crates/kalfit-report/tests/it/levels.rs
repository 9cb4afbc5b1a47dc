//! What is said of fits with levels: chips of lots, two states of which one combination does not vary from lot to lot.

use crate::common;

use insta::assert_snapshot;
use kalfit::FitRecord;
use kalfit::record::{BoundaryRecord, LevelRecord, PhaseRecord, PosteriorRow, SquareRecord, UnitRecord};
use kalfit_report::{TextStyle, html, summary};

fn level(name: &str, column: Option<&str>, groups: usize, of: PhaseRecord) -> LevelRecord {
    LevelRecord {
        slots: Vec::new(),
        name: name.into(),
        column: column.map(Into::into),
        groups,
        states: of.states,
        covariance: of.covariance,
        std_dev: of.std_dev,
        correlation: of.correlation,
        boundary: of.boundary,
        unidentified: of.unidentified,
    }
}

fn group(level: &str, id: &[&str], p_value: f64) -> UnitRecord {
    UnitRecord {
        level: level.into(),
        id: id.iter().map(|&name| name.into()).collect(),
        tests: 3,
        log_likelihood: -100.0,
        mean: vec![1.0, 2.0],
        covariance: identity(),
        follows: None,
        by_estimates: None,
        with_effects: Vec::new(),
        distance: Some(-2.0 * p_value.ln()),
        degrees_of_freedom: 2,
        p_value: Some(p_value),
        deletion: None,
    }
}

fn identity() -> SquareRecord {
    SquareRecord::try_from(vec![vec![1.0, 0.0], vec![0.0, 1.0]]).expect("it is square")
}

/// Standard deviations 1 within a chip, 2 from chip to chip; from lot to lot Σ has rank one.
fn chips_of_lots() -> FitRecord {
    let own = common::phase("main", &["bias", "scale"]);
    let mut chips = own.clone();
    chips.std_dev.estimate = vec![2.0; 2];
    chips.covariance.estimate = vec![vec![4.0, 0.0], vec![0.0, 4.0]];
    let mut lots = own.clone();
    lots.covariance.estimate = vec![vec![1.0, 1.0], vec![1.0, 1.0]];
    lots.correlation.estimate[1][0] = Some(1.0);
    lots.correlation.std_error = vec![vec![None; 2]; 2];
    lots.boundary.push(BoundaryRecord {
        what: "covariance".into(),
        rank: 1,
        of: 2,
        states: own.states.clone(),
        zero_variances: vec![],
    });
    let mut record = common::record("Chips of lots", vec![own.clone()]);
    record.levels = vec![
        level("lot", Some("lot"), 3, lots),
        level("chip", Some("serial"), 9, chips),
        level("tests", None, 18, own),
    ];
    record.groups = vec![group("lot", &["A"], 0.2), group("lot", &["B"], 0.9), group("chip", &["A", "7"], 0.03)];
    record
}

/// From the first of these headings to the second.
fn between(text: &str, from: &str, to: &str) -> String {
    let (start, end) = (text.find(from).expect("it begins"), text.find(to).expect("it ends"));
    text[start..end].to_owned()
}

#[test]
fn each_level_has_its_spread_and_its_correlations() {
    let text = summary(&chips_of_lots(), &TextStyle::default());
    assert_snapshot!(between(&text, "Data:", "Convergence and"), @r#"
    Data: 18 tests, 180 steps, 180 observations from data.csv.
    Levels: 3 groups of `lot` and 9 groups of `chip`; 18 tests within them.

    Initial state: mean, and standard deviation at each level (± standard error)
      state         mean            lot to lot  chip to chip  within one chip
      bias   1.00 ± 0.25  1.00 ± 0.15 boundary   2.00 ± 0.15      1.00 ± 0.15
      scale  2.00 ± 0.25  1.00 ± 0.15 boundary   2.00 ± 0.15      1.00 ± 0.15
      With 3 groups of lot, ± 1.96 standard errors hold the mean less than 85 % of
        the time; --criterion reml allows for that.

    Correlations within one chip (± standard error)
                    bias
      scale  0.00 ± 0.20

    Spread by level (share: part of the variance of the states)
      state  spread           number  std dev                   share
      bias   lot to lot            3     1.00 ± 0.15 boundary  16.7 %
             chip to chip          9     2.00 ± 0.15           66.7 %
             within one chip      18     1.00 ± 0.15           16.7 %
      scale  lot to lot            3     1.00 ± 0.15 boundary  16.7 %
             chip to chip          9     2.00 ± 0.15           66.7 %
             within one chip      18     1.00 ± 0.15           16.7 %
      From lot to lot, Σ is singular: rank 1 of 2; no variation from lot to lot was
        found in one combination of these states.

    Correlations from lot to lot (± standard error)
              bias
      scale  1.000

    Correlations from chip to chip (± standard error)
                    bias
      scale  0.00 ± 0.20

    Outlying groups
      No group is an outlier: the smallest of 3 p-values is 0.03 (chip A/7), or 0.09
        after Bonferroni correction.
    "#);
}

#[test]
fn a_group_that_stands_out_has_a_row() {
    let mut record = chips_of_lots();
    record.groups[2].p_value = Some(1e-4);
    let text = summary(&record, &TextStyle::default());
    assert_snapshot!(between(&text, "Outlying groups", "Convergence and"), @"
    Outlying groups
      level  group  tests  distance²  expected  p-value  times 3
      chip   A/7        3       7.01         2   0.0001   0.0003
      This group is an outlier at the 5 % level, after Bonferroni correction for 3
        groups.
    ");
}

#[test]
fn a_level_at_which_nothing_varies_is_said_so() {
    let mut record = chips_of_lots();
    let lots = &mut record.levels[0];
    lots.std_dev.estimate = vec![0.0; 2];
    lots.covariance.estimate = vec![vec![0.0; 2]; 2];
    lots.correlation.estimate = vec![vec![None; 2]; 2];
    lots.boundary[0] =
        BoundaryRecord { rank: 0, zero_variances: vec!["bias".into(), "scale".into()], ..lots.boundary[0].clone() };
    let text = summary(&record, &TextStyle::default());
    assert_snapshot!(between(&text, "Spread by level (share", "Outlying groups"), @"
    Spread by level (share: part of the variance of the states)
      state  spread           number  std dev                     share
      bias   lot to lot            3        0 at zero (boundary)    0 %
             chip to chip          9     2.00 ± 0.15               80 %
             within one chip      18     1.00 ± 0.15               20 %
      scale  lot to lot            3        0 at zero (boundary)    0 %
             chip to chip          9     2.00 ± 0.15               80 %
             within one chip      18     1.00 ± 0.15               20 %
      The covariance from lot to lot is estimated as zero: the variation between
        tests explains all differences.

    Correlations from lot to lot (± standard error)
             bias
      scale     -
      - not defined: a standard deviation is zero.

    Correlations from chip to chip (± standard error)
                    bias
      scale  0.00 ± 0.20
    ");
    // of one state that does not vary nothing is said of the other
    let lots = &mut record.levels[0];
    (lots.std_dev.estimate[1], lots.covariance.estimate[1][1]) = (1.0, 1.0);
    lots.boundary[0] = BoundaryRecord {
        of: 1,
        states: vec!["bias".into()],
        zero_variances: vec!["bias".into()],
        ..lots.boundary[0].clone()
    };
    let text = summary(&record, &TextStyle::default());
    assert!(text.contains("From lot to lot, the variance of bias is estimated as zero."), "{text}");
    assert!(!text.contains("Nothing varies"), "{text}");
}

#[test]
fn profiles_name_where_each_quantity_varies() {
    let mut record = chips_of_lots();
    record.intervals = "profile".into();
    record.phases[0].mean.interval95[0] = Some([Some(0.5), Some(1.5)]);
    for (spread, low) in [(&mut record.phases[0].std_dev, 0.7), (&mut record.levels[1].std_dev, 1.4)] {
        spread.interval95[0] = Some([Some(low), Some(2.0 * low)]);
    }
    record.levels[1].correlation.interval95[1][0] = Some([None, Some(0.4)]);
    let text = summary(&record, &TextStyle::default());
    assert_snapshot!(between(&text, "95 % intervals by", "Spread by level (share"), @"
    95 % intervals by profile likelihood
                                  spread           estimate  from    to
      mean of bias                                     1.00  0.50  1.50
      std dev of bias             within one chip      1.00  0.70  1.40
      std dev of bias             chip to chip         2.00  1.40  2.80
      correlation of bias, scale  chip to chip         0.00     -  0.40
      - no limit was found on this side.
    ");
}

/// Ellipses and bands are of a test that nothing is known of: its spread is that of all levels.
#[test]
fn the_population_of_the_report_varies_at_all_levels() {
    let mut record = chips_of_lots();
    let part = PosteriorRow { name: "main".into(), mean: vec![1.0, 2.0], covariance: identity(), own: None };
    common::change_tests(&mut record, |_, test| test.phases = vec![part.clone()]);
    let page = html(&record);
    assert!(
        page.contains(r#""covariance":[[6,1],[1,6]]"#) || page.contains(r#""covariance":[[6.0,1.0],[1.0,6.0]]"#),
        "1 + 4 + 1"
    );
    // a column of the first table, and of that of the initial state
    assert!(page.matches(">chip to chip</th>").count() >= 2, "each level has a column");
    for sentence in [
        "Mean, and standard deviation at each level",
        "Intervals of the standard deviations are in",
        "Covariance from lot to lot",
        "Levels: 3 groups of <code>lot</code> and 9 groups of <code>chip</code>; 18 tests within them.",
        "each group adds its own random contribution to the initial states of its tests",
    ] {
        assert!(page.contains(sentence), "the report does not say: {sentence}");
    }
}
