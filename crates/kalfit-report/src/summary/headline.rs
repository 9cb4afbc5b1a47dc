//! The first lines: can the result be trusted, and what was fitted to what.

use kalfit::FitRecord;
use kalfit::record::{DataRecord, ModelCheckRecord, TestRecord};

use super::{phases, places};
use crate::number::{hundredths, plain};
use crate::page::PageLayout;
use crate::words::{capital, clean, count, list, sentence};

/// What such a log-likelihood is good for.
pub(crate) const OF_ESTIMATES: &str = "This log-likelihood is that of the filters' estimates, not of the measurements. Compare it \
                                       only with fits to the same estimates.";

/// What one test alone cannot show.
const ONE_TEST: &str = "This is one test alone: it shows nothing of how tests differ.";

/// Rounding errors above this many standard errors are told.
const NOTABLE: f64 = 1e-6;

/// What was fitted to what; before all else that a fit failed.
pub(crate) fn section(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let mut text = String::new();
    if !record.title.trim().is_empty() {
        text.push_str(&format!("{}\n\n", page.heading(&clean(&record.title))));
    }
    if !record.converged {
        text.push_str(&(verdicts(record, page) + "\n"));
    }
    text.push_str(&page.paragraph(&data(&record.data)));
    if record.data.tests == 1 {
        text.push_str(&page.paragraph(ONE_TEST));
    }
    text.extend(phases::combined(record).iter().map(|sentence| page.paragraph(sentence)));
    text.extend(places::counted(record).iter().map(|sentence| page.paragraph(sentence)));
    text
}

/// Whether the estimates above can be trusted.
pub(crate) fn trust(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let mut text = if record.converged { verdicts(record, page) } else { String::new() };
    text.push_str(&page.paragraph(&likelihood(record)));
    if record.log_likelihood_kind == "estimates" {
        text.push_str(&page.paragraph(OF_ESTIMATES));
    }
    if record.converged { page.section("Convergence and model check", &text) } else { text }
}

/// Convergence and model check, in colour.
fn verdicts(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let checked = ModelCheckRecord::of(record);
    let paint = |line: &str| match (record.converged, checked.is_doubtful()) {
        (true, false) => page.style.good(line),
        (true, true) => page.style.fair(line),
        (false, _) => page.style.bad(line),
    };
    let mut text = page.paragraph(&verdict(record));
    text.extend(model_check(record, &checked).map(|sentence| page.paragraph(&sentence)));
    let mut painted: String = text.lines().map(|line| paint(line) + "\n").collect();
    if !record.converged {
        painted.push_str(&page.paragraph(&shortfall(record)));
    }
    painted
}

/// Whether the search ended at a maximum, and what is special about it.
pub(crate) fn verdict(record: &FitRecord) -> String {
    if !record.converged {
        let reason = clean(&record.reason);
        let reason = reason.trim().trim_end_matches('.');
        let reason = if reason.is_empty() { "no reason was given" } else { reason };
        return format!(
            "Not converged: {reason}. The figures below are where the solver stopped, not a maximum of the likelihood."
        );
    }
    if record.data.observations == 0 && record.log_likelihood_kind != "estimates" {
        return "Nothing was estimated: no row has a value of any measurement, and every figure is where the search began."
            .to_owned();
    }
    let what = if record.criterion == "reml" { "restricted maximum-likelihood" } else { "maximum-likelihood" };
    let rounding = record.certificate.rounding;
    let but = match rounding > NOTABLE {
        true => format!(", apart from rounding errors of up to {} standard errors", plain(rounding, 2)),
        false => String::new(),
    };
    let mut sentences =
        vec![format!("Converged: the optimality conditions hold, so these are the {what} estimates{but}.")];
    if is_singular(record) {
        sentences.push("The estimated covariance is singular, on the boundary of the possible covariances.".to_owned());
    }
    if is_blind(record) {
        sentences.push("Some quantities are not identified by the data.".to_owned());
    }
    if record.parameters.iter().any(|p| !p.fixed) {
        sentences
            .push("For the dynamic parameters this is a local maximum; the search found no higher one.".to_owned());
    }
    sentences.join(" ")
}

/// Some covariance lies on its boundary.
pub(crate) fn is_singular(record: &FitRecord) -> bool {
    record.phases.iter().any(|p| !p.boundary.is_empty()) || record.all_levels().any(|level| !level.boundary.is_empty())
}

/// Something is not identified.
pub(crate) fn is_blind(record: &FitRecord) -> bool {
    record.phases.iter().any(|p| !p.unidentified.is_empty())
        || record.all_levels().any(|level| !level.unidentified.is_empty())
        || record.parameters.iter().any(|p| p.standing.as_deref() == Some("unidentified"))
}

/// What the figures of the fit say of the model, beside convergence; nothing where it did not converge.
pub(crate) fn model_check(record: &FitRecord, checked: &ModelCheckRecord) -> Option<String> {
    if !record.converged {
        return None;
    }
    let findings: Vec<String> = checked.findings.iter().map(|finding| clean(&finding.text)).collect();
    let looked_at = |innovations: bool| {
        let has = |test: TestRecord<'_>| if innovations { test.innovations.is_some() } else { test.p_value.is_some() };
        record.tests.iter().any(has)
    };
    let said = match (checked.verdict.as_str(), looked_at(true), looked_at(false)) {
        ("doubtful", ..) => format!("Model check doubtful: {}.", findings.join("; ")),
        ("passed", true, true) => "Model check passed: innovations and tests agree with the model.".to_owned(),
        ("passed", true, false) => "Model check passed: the innovations agree with the model.".to_owned(),
        ("passed", false, _) => {
            "Model check passed: the tests agree with the population (innovations were not computed).".to_owned()
        }
        _ => "No model check: the results have no figures of single tests.".to_owned(),
    };
    let remarks = checked.remarks.iter().map(|remark| format!(" {}", sentence(&clean(&remark.text))));
    Some(remarks.fold(said, |said, remark| said + &remark))
}

/// What the certificate lacks.
pub(crate) fn shortfall(record: &FitRecord) -> String {
    let c = &record.certificate;
    let figures = [
        ("mean", c.mean),
        ("covariance", c.covariance),
        ("null space of Σ", c.null_space),
        ("parameters", c.parameters),
    ];
    let mut figures = figures.map(|(name, x)| format!("{name} {}", plain(x, 2))).to_vec();
    if c.rounding >= c.mean && c.rounding > 0.0 {
        figures.push(format!("rounding alone {}", plain(c.rounding, 2)));
    }
    format!("Distance from the optimality conditions, in standard errors: {}.", figures.join(", "))
}

/// Counts of the data, in one sentence.
pub(crate) fn data(d: &DataRecord) -> String {
    let counts = [count(d.tests, "test"), count(d.steps, "step"), count(d.observations, "observation")].join(", ");
    format!("Data: {counts}{}.", from(&d.files))
}

/// How many tests share their times, inputs and missing values, and how they were reduced; for those who ask where time went.
pub(crate) fn designs(d: &DataRecord) -> String {
    let designs = match (d.design_classes, d.tests) {
        (_, 0 | 1) => String::new(),
        (1, _) => "All tests have the same design (times, inputs and missing values).".to_owned(),
        (n, tests) if n == tests => "Every test has its own design (times, inputs and missing values).".to_owned(),
        (n, _) => format!("The tests have {n} different designs (times, inputs and missing values)."),
    };
    let roots = match d.square_root_tests {
        0 => String::new(),
        n => format!("{} needed the more accurate square-root filter.", capital(&count(n, "test"))),
    };
    format!("{designs} {roots}").trim().to_owned()
}

/// ` from a.csv, b.csv and 7 more`
pub(crate) fn from(files: &[String]) -> String {
    let files: Vec<String> = files.iter().map(|f| clean(f)).collect();
    if files.is_empty() { String::new() } else { format!(" from {}", list(&files, 3)) }
}

/// What kind of log-likelihood it is.
pub(crate) fn likelihood_name(record: &FitRecord) -> &'static str {
    match (record.log_likelihood_kind.as_str(), record.criterion.as_str()) {
        ("estimates", _) => "log-likelihood of the estimates",
        (_, "reml") => "restricted log-likelihood",
        _ => "log-likelihood",
    }
}

pub(crate) fn likelihood(record: &FitRecord) -> String {
    let name = capital(likelihood_name(record));
    let mut parts =
        vec![format!("{name} {}", hundredths(record.log_likelihood)), count(record.free_parameters, "free parameter")];
    parts.extend(record.aic.map(|x| format!("AIC {}", hundredths(x))));
    parts.extend(record.bic.map(|x| format!("BIC {}", hundredths(x))));
    parts.join(", ") + "."
}
