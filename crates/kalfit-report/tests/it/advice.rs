//! What to do next follows from the reason, and from what the model has already.

use kalfit::FitRecord;
use kalfit_report::{TextStyle, html, summary};

use crate::common;

fn part(record: &FitRecord, heading: &str) -> String {
    let text = summary(record, &TextStyle::default());
    let found = text.split("\n\n").find(|part| part.starts_with(heading));
    found.unwrap_or_default().to_owned() + "\n"
}

fn failed(reason: &str) -> FitRecord {
    FitRecord { converged: false, reason: reason.to_owned(), ..common::sleepstudy() }
}

const UNBOUNDED: &str = "the log-likelihood has no maximum: it rises without bound as `s` for test a and `s` for test b go to zero together, because the data fit the model exactly";

#[test]
fn a_likelihood_without_bound_asks_for_a_floor() {
    insta::assert_snapshot!(part(&failed(UNBOUNDED), "What to do next"), @"
    What to do next
      Do not use these figures. Give the noise levels named above a floor (`lower`
        in `[parameters]`), such as the resolution of the instrument divided by √12,
        or fix them, or tie them to levels that the data determine: one value for
        all tests, or for several, instead of one each.
    ");
}

#[test]
fn other_failures_ask_for_what_the_model_lacks() {
    let mut record =
        failed("the search reached its limit of iterations (3) about 1e1 standard errors from the optimum");
    insta::assert_snapshot!(part(&record, "What to do next"), @"
    What to do next
      Do not use these figures. Give start values for the free parameters, allow
        more iterations (`--max-iterations`), or use a simpler model: fewer states,
        or a diagonal covariance.
    ");
    record.reason = "no step increases the log-likelihood, but the optimality conditions do not hold".to_owned();
    let fixed = &mut record.phases[0].covariance.fixed;
    (fixed[0][1], fixed[1][0]) = (true, true);
    insta::assert_snapshot!(part(&record, "What to do next"), @"
    What to do next
      Do not use these figures. Give start values for the free parameters, or use a
        simpler model, with fewer states.
    ");
}

#[test]
fn code_in_sentences_is_code_in_the_page() {
    let page = html(&failed(UNBOUNDED));
    assert!(page.contains("a floor (<code>lower</code> in <code>[parameters]</code>)"), "the advice is in the page");
    let body = page.split("What to do next").nth(1).expect("a section").split("</section>").next().unwrap_or_default();
    assert!(!body.contains('`'), "{body}");
}

#[test]
fn one_test_is_said_to_be_one() {
    let mut record = common::sleepstudy();
    record.data.tests = 1;
    let text = summary(&record, &TextStyle::default());
    assert!(text.contains("This is one test alone: it shows nothing of how tests differ."), "{text}");
}

#[test]
fn a_score_test_alone_does_not_contradict() {
    let mut record = common::constrained();
    record.constraints[0].likelihood_ratio_p_value = Some(0.4);
    let said = |record: &FitRecord| {
        part(record, "Constraints").split("temperature_coefficient]\n").nth(1).unwrap_or_default().to_owned()
    };
    insta::assert_snapshot!(said(&record), @"
    The score test rejects the constraint on mean[scale_factor], but the
      likelihood ratio of a fit without it does not (5 % level, after Bonferroni
      correction for 2 tests).
    ");
    (record.constraints[0].likelihood_ratio, record.constraints[0].likelihood_ratio_p_value) = (None, None);
    insta::assert_snapshot!(said(&record), @"
    The score test rejects the constraint on mean[scale_factor] (5 % level, after
      Bonferroni correction for 2 tests); no fit without it confirms this.
    ");
}
