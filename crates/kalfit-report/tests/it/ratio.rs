//! What a likelihood-ratio test reads like.

use kalfit::record::{BootstrapRecord, ComponentRecord, DataRecord, PartRecord, RatioRecord, SideRecord};
use kalfit_report::{TextStyle, ratio_summary};

fn side(log_likelihood: f64, free_parameters: usize) -> SideRecord {
    SideRecord {
        log_likelihood,
        free_parameters,
        converged: true,
        states: vec!["bias".into()],
        mean: vec![0.0],
        covariance: vec![vec![1.0]],
        parameters: vec![],
    }
}

/// χ²(1) at 1.53.
fn plain() -> RatioRecord {
    RatioRecord {
        f: None,
        schema: "kalfit-test/1".into(),
        kalfit_version: "0.1.0".into(),
        title: "Gyro bench".into(),
        hypothesis: "no bias".into(),
        model_digest: None,
        null_digest: None,
        data: DataRecord {
            tests: 13,
            steps: 13,
            observations: 13,
            design_classes: 13,
            square_root_tests: 0,
            files: vec!["data.csv".into()],
        },
        null: side(-8.450369, 2),
        alternative: side(-7.6856655, 3),
        converged: true,
        lr: 1.529407,
        df: 1,
        p_value: 0.2162,
        p_chi2_df: 0.2162,
        p_mixture: None,
        mixture: None,
        law: law(&[(1, 1.0)]),
        law_is_bound: false,
        bootstrap: None,
        parts: vec![],
        notes: vec![],
    }
}

fn law(components: &[(usize, f64)]) -> Vec<ComponentRecord> {
    components.iter().map(|&(df, weight)| ComponentRecord { df, weight }).collect()
}

/// Two variances at zero, whose estimates are correlated.
fn mixture() -> RatioRecord {
    RatioRecord {
        lr: 6.0,
        df: 2,
        p_value: 0.0181,
        p_chi2_df: 0.0498,
        p_mixture: Some(0.0196),
        mixture: Some("0.25 chi2_0; 0.5 chi2_1; 0.25 chi2_2".into()),
        law: law(&[(0, 0.271234), (1, 0.5), (2, 0.228766)]),
        ..plain()
    }
}

fn bound() -> RatioRecord {
    RatioRecord {
        lr: 21.5449,
        df: 3,
        p_value: 5.1e-5,
        p_chi2_df: 8.1e-5,
        law: law(&[(2, 0.5), (3, 0.5)]),
        law_is_bound: true,
        notes: vec!["the law given is an upper bound".into(), "a second finding".into()],
        ..plain()
    }
}

fn drawn(failed: usize) -> RatioRecord {
    let bootstrap = BootstrapRecord {
        replicates: 200,
        failed,
        seed: 7,
        p_value: (failed < 200).then_some(0.0398),
        std_error: (failed < 200).then_some(0.0138),
        quantile95: (failed < 200).then_some(5.5),
    };
    RatioRecord { bootstrap: Some(bootstrap), ..mixture() }
}

fn parts(converged: bool) -> RatioRecord {
    let part = |what: &str, lr: f64, p_value: f64, converged: bool| PartRecord {
        what: what.into(),
        lr,
        df: 1,
        p_value,
        log_likelihood: -8.45,
        converged,
    };
    let parts = vec![part("mean", 1.5294, 0.2162, true), part("covariance", 3.5759, 0.0293, converged)];
    RatioRecord { parts, ..mixture() }
}

fn not_converged() -> RatioRecord {
    let null = SideRecord { converged: false, ..side(-9.0, 2) };
    RatioRecord { converged: false, null, bootstrap: drawn(3).bootstrap, ..plain() }
}

fn hostile() -> RatioRecord {
    let mut record = parts(false);
    record.title = "\u{1b}[31mred\nnext line".into();
    record.hypothesis = format!("{} \u{1b}]0;title\u{7}", "a_very_long_name_of_a_file/".repeat(12));
    record.notes = vec!["\u{1b}[2J cleared".into(), "x".repeat(400)];
    record.law = law(&(0..21).map(|k| (k, 1.0 / 21.0)).collect::<Vec<_>>());
    record.mixture = Some((0..21).map(|k| format!("0.047619 chi2_{k}")).collect::<Vec<_>>().join("; "));
    record
}

fn at(width: usize, record: &RatioRecord) -> String {
    ratio_summary(record, &TextStyle { width, color: false })
}

fn at_80(record: &RatioRecord) -> String {
    ratio_summary(record, &TextStyle::default())
}

#[test]
fn a_plain_test_names_its_law_once() {
    insta::assert_snapshot!(at_80(&plain()), @"
    Gyro bench

    Hypothesis: no bias
    The data do not contradict the hypothesis: p = 0.22 by the large-sample
    distribution.

    Fits to 13 tests
                  log-likelihood  free    AIC  converged
      hypothesis       -8.450369     2  20.90        yes
      model           -7.6856655     3  21.37        yes

    -2 log λ = 1.52941
      reference distribution  p-value
      χ²(1)                      0.22
    ");
}

#[test]
fn a_mixture_stands_beside_what_textbooks_and_habit_give() {
    insta::assert_snapshot!(at_80(&mixture()), @"
    Gyro bench

    Hypothesis: no bias
    The data contradict the hypothesis: p = 0.02 by the large-sample distribution.

    Fits to 13 tests
                  log-likelihood  free    AIC  converged
      hypothesis       -8.450369     2  20.90        yes
      model           -7.6856655     3  21.37        yes

    -2 log λ = 6
      reference distribution                p-value
      0.271 χ²(0) + 0.5 χ²(1) + 0.229          0.02
      χ²(2)
      as if independent: 0.25 χ²(0) + 0.5      0.02
      χ²(1) + 0.25 χ²(2)
      χ²(2), which ignores the boundary        0.05
    ");
    let same = RatioRecord { p_mixture: Some(0.0181), ..mixture() };
    assert!(!at_80(&same).contains("independent"), "nothing to tell apart\n{}", at_80(&same));
}

#[test]
fn a_bound_is_said_to_be_one() {
    insta::assert_snapshot!(at_80(&bound()), @"
    Gyro bench

    Hypothesis: no bias
    The data strongly contradict the hypothesis: p = 5e-5 by the large-sample
    distribution.

    Fits to 13 tests
                  log-likelihood  free    AIC  converged
      hypothesis       -8.450369     2  20.90        yes
      model           -7.6856655     3  21.37        yes

    -2 log λ = 21.5449
      reference distribution              p-value
      upper bound: 0.5 χ²(2) + 0.5 χ²(3)     5e-5
      χ²(3), which ignores the boundary      8e-5

    Notes
      The law given is an upper bound.
      A second finding.
    ");
}

#[test]
fn the_bootstrap_gives_the_verdict_where_there_is_one() {
    insta::assert_snapshot!(at_80(&drawn(3)), @"
    Gyro bench

    Hypothesis: no bias
    The data contradict the hypothesis: p = 0.04 by the bootstrap.

    Fits to 13 tests
                  log-likelihood  free    AIC  converged
      hypothesis       -8.450369     2  20.90        yes
      model           -7.6856655     3  21.37        yes

    -2 log λ = 6
      reference distribution                p-value
      0.271 χ²(0) + 0.5 χ²(1) + 0.229          0.02
      χ²(2)
      as if independent: 0.25 χ²(0) + 0.5      0.02
      χ²(1) + 0.25 χ²(2)
      χ²(2), which ignores the boundary        0.05
      bootstrap of 200, seed 7 (± 0.014)       0.04
      3 draws were left out because their fits did not converge.
    ");
}

#[test]
fn a_bootstrap_of_which_nothing_counts_gives_no_verdict() {
    insta::assert_snapshot!(at_80(&drawn(200)), @"
    Gyro bench

    Hypothesis: no bias
    The data contradict the hypothesis: p = 0.02 by the large-sample distribution.

    Fits to 13 tests
                  log-likelihood  free    AIC  converged
      hypothesis       -8.450369     2  20.90        yes
      model           -7.6856655     3  21.37        yes

    -2 log λ = 6
      reference distribution                p-value
      0.271 χ²(0) + 0.5 χ²(1) + 0.229          0.02
      χ²(2)
      as if independent: 0.25 χ²(0) + 0.5      0.02
      χ²(1) + 0.25 χ²(2)
      χ²(2), which ignores the boundary        0.05
      bootstrap of 200, seed 7              unknown
      200 draws were left out because their fits did not converge.
    ");
}

#[test]
fn a_p_value_that_the_number_of_draws_limits_is_said_to_be_so() {
    let says = |p_value: f64, failed: usize| {
        let mut record = drawn(failed);
        record.bootstrap.as_mut().expect("there is one").p_value = Some(p_value).filter(|_| failed < 200);
        at_80(&record).contains("No draw was as extreme as the data")
    };
    for (counted, failed) in [(200.0, 0), (50.0, 150)] {
        assert!(says(1.0 / (1.0 + counted), failed), "none of {counted}");
        assert!(!says(2.0 / (1.0 + counted), failed), "one of {counted}");
    }
    assert!(!says(1.0, 200), "none counts");
}

#[test]
fn parts_stand_below_each_other() {
    insta::assert_snapshot!(at_80(&parts(false)), @"
    Gyro bench

    Hypothesis: no bias
    The data contradict the hypothesis: p = 0.02 by the large-sample distribution.

    Fits to 13 tests
                  log-likelihood  free    AIC  converged
      hypothesis       -8.450369     2  20.90        yes
      model           -7.6856655     3  21.37        yes

    -2 log λ = 6
      reference distribution                p-value
      0.271 χ²(0) + 0.5 χ²(1) + 0.229          0.02
      χ²(2)
      as if independent: 0.25 χ²(0) + 0.5      0.02
      χ²(1) + 0.25 χ²(2)
      χ²(2), which ignores the boundary        0.05

    Mean and covariance separately
      hypothesis on                     -2 log λ  df  p-value
      mean alone                          1.5294   1     0.22
      covariance alone (not converged)    3.5759   1     0.03
      both                                     6   2     0.02
    ");
}

#[test]
fn what_is_not_certified_has_no_verdict() {
    let text = at_80(&not_converged());
    insta::assert_snapshot!(text, @"
    Gyro bench

    Hypothesis: no bias
    Not converged: one of the fits did not converge, so this test means little.

    Fits to 13 tests
                  log-likelihood  free    AIC  converged
      hypothesis              -9     2  22.00         no
      model           -7.6856655     3  21.37        yes

    -2 log λ = 1.52941
      reference distribution              p-value
      χ²(1)                                  0.22
      bootstrap of 200, seed 7 (± 0.014)     0.04
      3 draws were left out because their fits did not converge.
    ");
    assert!(!text.contains("speak"), "{text}");
}

#[test]
fn verdicts_follow_the_p_value() {
    let verdict = |p_value: f64| {
        let text = at_80(&RatioRecord { p_value, title: String::new(), ..plain() });
        text.lines().nth(3).unwrap_or_default().to_owned()
    };
    insta::assert_snapshot!([0.7, 0.05, 0.0499, 0.001, 0.00099, 1e-12, f64::NAN].map(verdict).join("\n"), @"
    The data do not contradict the hypothesis: p = 0.70 by the large-sample
    The data do not contradict the hypothesis: p = 0.05 by the large-sample
    The data contradict the hypothesis: p = 0.05 by the large-sample distribution.
    The data contradict the hypothesis: p = 0.001 by the large-sample distribution.
    The data strongly contradict the hypothesis: p = 0.001 by the large-sample
    The data strongly contradict the hypothesis: p < 1e-10 by the large-sample
    There is no p-value: p = unknown by the large-sample distribution.
    ");
}

#[test]
fn narrow_and_wide_pages_hold_the_same() {
    insta::assert_snapshot!(at(60, &drawn(3)), @"
    Gyro bench

    Hypothesis: no bias
    The data contradict the hypothesis: p = 0.04 by the
    bootstrap.

    Fits to 13 tests
                  log-likelihood  free    AIC  converged
      hypothesis       -8.450369     2  20.90        yes
      model           -7.6856655     3  21.37        yes

    -2 log λ = 6
      reference distribution                p-value
      0.271 χ²(0) + 0.5 χ²(1) + 0.229          0.02
      χ²(2)
      as if independent: 0.25 χ²(0) + 0.5      0.02
      χ²(1) + 0.25 χ²(2)
      χ²(2), which ignores the boundary        0.05
      bootstrap of 200, seed 7 (± 0.014)       0.04
      3 draws were left out because their fits did not converge.
    ");
    insta::assert_snapshot!(at(120, &bound()), @"
    Gyro bench

    Hypothesis: no bias
    The data strongly contradict the hypothesis: p = 5e-5 by the large-sample distribution.

    Fits to 13 tests
                  log-likelihood  free    AIC  converged
      hypothesis       -8.450369     2  20.90        yes
      model           -7.6856655     3  21.37        yes

    -2 log λ = 21.5449
      reference distribution              p-value
      upper bound: 0.5 χ²(2) + 0.5 χ²(3)     5e-5
      χ²(3), which ignores the boundary      8e-5

    Notes
      The law given is an upper bound.
      A second finding.
    ");
}

#[test]
fn every_line_fits_the_page() {
    let records = [plain(), mixture(), bound(), drawn(3), drawn(200), parts(false), not_converged(), hostile()];
    for record in records {
        for width in [60, 72, 80, 100, 120, 200] {
            for line in at(width, &record).lines() {
                assert!(line.chars().count() <= width, "{} > {width}: {line}", line.chars().count());
                assert_eq!(line.trim_end(), line, "no spaces at the end of a line");
            }
        }
    }
}

#[test]
fn names_cannot_move_the_cursor() {
    let text = at_80(&hostile());
    assert!(text.chars().all(|c| c == '\n' || !c.is_control()), "{text:?}");
    assert!(text.contains("[31mred next line"), "{text}");
}

#[test]
fn colour_changes_no_letter() {
    for record in [plain(), drawn(200), not_converged()] {
        let colored = ratio_summary(&record, &TextStyle { width: 80, color: true });
        let mut plain = String::new();
        for (i, piece) in colored.split('\u{1b}').enumerate() {
            let escape = if i == 0 { None } else { piece.find('m') };
            plain.push_str(escape.map_or(piece, |end| &piece[end + 1..]));
        }
        assert_eq!(plain, at_80(&record));
    }
}

#[test]
fn damaged_records_are_summarised_all_the_same() {
    let mut record = parts(true);
    record.bootstrap = drawn(3).bootstrap;
    record.lr = f64::NAN;
    record.p_value = f64::NAN;
    record.p_chi2_df = f64::INFINITY;
    record.p_mixture = Some(f64::NAN);
    record.law[1].weight = f64::NAN;
    record.null.log_likelihood = f64::NEG_INFINITY;
    record.alternative.log_likelihood = f64::NAN;
    record.parts[0].lr = f64::NAN;
    record.parts[1].p_value = f64::INFINITY;
    let bootstrap = record.bootstrap.as_mut().expect("there is one");
    (bootstrap.p_value, bootstrap.std_error, bootstrap.quantile95) = (Some(f64::NAN), Some(f64::NAN), Some(f64::NAN));
    for law in [record.law.clone(), vec![]] {
        record.law = law;
        let text = at_80(&record);
        for word in text.split(|c: char| !c.is_alphanumeric()) {
            assert!(!["nan", "inf"].contains(&word.to_lowercase().as_str()), "`{word}` in:\n{text}");
        }
        assert!(text.contains("unknown") && !text.contains("speak"), "{text}");
    }
}
