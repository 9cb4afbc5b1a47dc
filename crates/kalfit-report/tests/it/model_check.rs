//! Whether the model describes the data stands beside convergence, and groups of tests in a table.

use kalfit::FitRecord;
use kalfit::record::*;
use kalfit_report::{TextStyle, html, summary};

use crate::common;

/// The first paragraph after the title.
fn verdicts(record: &FitRecord) -> String {
    let text = summary(record, &TextStyle::default());
    let part = |heading: &str| text.split("\n\n").find(|part| part.starts_with(heading)).unwrap_or_default().to_owned();
    part("Convergence and model check") + "\n" + &part("What to do next") + "\n"
}

fn kinds(record: &FitRecord) -> (String, Vec<String>) {
    let found = ModelCheckRecord::of(record);
    (found.verdict, found.findings.into_iter().map(|finding| finding.kind).collect())
}

fn innovations(count: usize, nis: f64, nis_p: f64, white_p: f64) -> InnovationRecord {
    let whiteness = WhitenessRecord { statistic: 4.5, lags: 2, degrees_of_freedom: 2, p_value: white_p };
    InnovationRecord {
        whitened_nis: None,
        count,
        nis: Some(nis),
        nis_p_value: Some(nis_p),
        mean: Some(0.1),
        whiteness: Some(whiteness),
        parts: Vec::new(),
        series: None,
    }
}

fn with(found: &[InnovationRecord]) -> FitRecord {
    let mut record = common::sleepstudy();
    record.tests = common::tests(&vec![0.5; found.len()]);
    common::change_tests(&mut record, |number, test| test.innovations = Some(found[number].clone()));
    record
}

#[test]
fn a_sound_fit_passes_in_a_green_box() {
    let record = with(&[innovations(10, 9.0, 0.9, 0.02), innovations(10, 11.0, 0.7, 0.5)]);
    insta::assert_snapshot!(verdicts(&record), @"
    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates. For the dynamic parameters this is a local maximum; the search found
    no higher one.
    Model check passed: innovations and tests agree with the model.
    Log-likelihood -875.97, 6 free parameters, AIC 1763.94, BIC 1783.10.
    What to do next
      Nothing needs attention: the fit converged and the model describes the data.
    ");
    assert_eq!(kinds(&record), ("passed".to_owned(), vec![]));
    assert!(html(&record).contains("class=\"verdict good\""));
}

/// Without a test that decides much of the answer.
fn decisive() -> DeletionRecord {
    DeletionRecord { log_density: -50.0, distance: Some(9.0), p_value: Some(0.011), displacement: 12.0, phases: vec![] }
}

#[test]
fn no_green_box_stands_over_a_model_that_the_page_refutes() {
    let mut record =
        with(&[innovations(10, 60.0, 7e-9, 0.5), innovations(10, 9.0, 0.9, 1e-5), innovations(10, 9.0, 0.9, 0.9)]);
    common::change_test(&mut record, 2, |test| test.p_value = Some(1e-9));
    common::change_test(&mut record, 0, |test| test.deletion = Some(decisive()));
    record.phases[0].boundary = common::singular().phases[0].boundary.clone();
    insta::assert_snapshot!(verdicts(&record), @r#"
    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates. The estimated covariance is singular, on the boundary of the possible
    covariances. For the dynamic parameters this is a local maximum; the search
    found no higher one.
    Model check doubtful: the innovations of all tests together are larger than the
    model allows; the innovations of 2 of 18 tests are improbable (size or
    correlation in time); test 310 is an outlier. Test 308 is influential: the
    estimates depend on it.
    Log-likelihood -875.97, 6 free parameters, AIC 1763.94, BIC 1783.10.
    What to do next
      Look at the noise levels and processes of the model: their sizes do not fit
        the data.
      Let noise levels differ between tests (`per = "test"`, or `per` a column), or
        look for faults in the tests named under Innovations.
      Add a process for what is correlated in time, such as a random walk or a
        Gauss-Markov state, or another one beside it.
      Look for faults in the data of test 310, and see whether a fit without it
        changes the estimates.
      A singular covariance is a valid result: these tests do not show that the
        states vary in all directions. Fewer varying states describe the data
        equally well; more tests may separate them.
      Check the data of test 308 with care, because the estimates depend on it; the
        results file has the estimates without it.
    "#);
    assert_eq!(kinds(&record).1, ["mean_square", "innovations", "distance"]);
    let page = html(&record);
    assert!(page.contains("class=\"verdict fair\"") && !page.contains("class=\"verdict good\""));
    let painted = summary(&record, &TextStyle { color: true, ..TextStyle::default() });
    assert!(painted.contains("\u{1b}[1;33mConverged") && !painted.contains("\u{1b}[1;32m"), "{painted}");
}

#[test]
fn neither_influence_nor_a_singular_covariance_speaks_against_a_model() {
    let mut record = with(&[innovations(10, 9.0, 0.9, 0.5), innovations(10, 11.0, 0.7, 0.5)]);
    common::change_test(&mut record, 0, |test| test.deletion = Some(decisive()));
    record.phases[0].boundary = common::singular().phases[0].boundary.clone();
    insta::assert_snapshot!(verdicts(&record), @"
    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates. The estimated covariance is singular, on the boundary of the possible
    covariances. For the dynamic parameters this is a local maximum; the search
    found no higher one.
    Model check passed: innovations and tests agree with the model. Test 308 is
    influential: the estimates depend on it.
    Log-likelihood -875.97, 6 free parameters, AIC 1763.94, BIC 1783.10.
    What to do next
      A singular covariance is a valid result: these tests do not show that the
        states vary in all directions. Fewer varying states describe the data
        equally well; more tests may separate them.
      Check the data of test 308 with care, because the estimates depend on it; the
        results file has the estimates without it.
    ");
    let found = ModelCheckRecord::of(&record);
    assert_eq!((kinds(&record), found.remarks.len()), (("passed".to_owned(), vec![]), 1), "{found:?}");
    assert_eq!(found.remarks[0].kind, "influence");
    assert!(html(&record).contains("class=\"verdict good\""));
}

#[test]
fn what_was_not_looked_at_has_not_passed() {
    let mut record = common::sleepstudy();
    record.tests = TestRecords::default();
    insta::assert_snapshot!(verdicts(&record), @"
    Convergence and model check
    Converged: the optimality conditions hold, so these are the maximum-likelihood
    estimates. For the dynamic parameters this is a local maximum; the search found
    no higher one.
    No model check: the results have no figures of single tests.
    Log-likelihood -875.97, 6 free parameters, AIC 1763.94, BIC 1783.10.
    What to do next
      To check the model, fit with the figures of single tests: without
        `--no-tests`, and with `--innovations on`.
    ");
    assert_eq!(kinds(&record).0, "not checked");
    let mut stuck = with(&[innovations(10, 60.0, 7e-9, 0.5)]);
    stuck.converged = false;
    assert_eq!(kinds(&stuck), ("not checked".to_owned(), vec![]));
    assert!(!summary(&stuck, &TextStyle::default()).contains("Model check"));
}

#[test]
fn p_values_are_corrected_for_their_number() {
    // 40 p-values: Holm's first is 0.00046 × 40 = 0.0184, of which nothing follows
    let mut found = vec![innovations(10, 10.0, 0.5, 0.5); 20];
    found[3].nis_p_value = Some(0.00046);
    assert_eq!(kinds(&with(&found)).0, "passed");
    found[3].nis_p_value = Some(0.00044);
    assert_eq!(kinds(&with(&found)), ("doubtful".to_owned(), vec!["innovations".to_owned()]));
    // Holm (1979): p-values 0.01, 0.02, 0.03, 0.04 of four
    let adjusted = holm(&[0.01, 0.02, 0.03, 0.04], 4);
    adjusted.iter().zip([0.04, 0.06, 0.06, 0.06]).for_each(|(a, b)| assert!((a - b).abs() < 1e-15, "{a} {b}"));
    assert_eq!(holm(&[0.01, 0.02], 4), adjusted[..2], "the least of them alone");
}

#[test]
fn groups_are_a_table_with_what_is_known_of_their_difference() {
    let mut record = with(&vec![innovations(10, 9.0, 0.9, 0.5); 4]);
    record.group_column = Some("lot".to_owned());
    common::change_tests(&mut record, |i, test| test.group = Some(["A", "B", "A", "B"][i].to_owned()));
    common::change_test(&mut record, 1, |test| test.innovations = Some(innovations(30, 90.0, 1e-7, 0.5)));
    record.add_by_group();
    record.group_test = Some(GroupTestRecord {
        groups: 2,
        log_likelihood: -860.0,
        statistic: 31.9,
        degrees_of_freedom: 5,
        p_value: 6e-6,
        on_boundary: true,
    });
    let text = summary(&record, &TextStyle::default());
    let section = text.find("Groups by lot").map_or("", |at| &text[at..]).split("\n\n").next().unwrap_or_default();
    insta::assert_snapshot!(section, @"
    Groups by lot
      lot  tests  mean square  p-value  distance²  expected  p-value
      A        2         0.90     0.83       2.77         4     0.60
      B        2         2.48     1e-6       2.77         4     0.60
      The groups differ: p = 6e-6 at most (likelihood-ratio test of a mean and
        covariance for each of the 2 groups against common ones: 31.9 with 5 degrees
        of freedom).
    ");
    assert!(html(&record).contains("Groups by lot"));
}
