//! The first lines: can the result be trusted, and what was fitted to what.

use kalfit::FitRecord;
use kalfit::record::{DataRecord, ModelCheckRecord, TestRecord};

use super::{phases, places};
use crate::number::{hundredths, plain};
use crate::page::Page;
use crate::words::{clean, count, list, sentence};

/// What such a log-likelihood is good for.
pub(crate) const OF_ESTIMATES: &str = "This is the log-likelihood of what the filters made of the measurements. It compares with                             fits to the same estimates only, not with fits to the measurements.";

/// Rounding errors above this many standard errors are told.
const NOTABLE: f64 = 1e-6;

pub(crate) fn section(record: &FitRecord, page: &Page<'_>) -> String {
    let mut text = String::new();
    if !record.title.trim().is_empty() {
        text.push_str(&format!("{}\n\n", page.heading(&clean(&record.title))));
    }
    let checked = ModelCheckRecord::of(record);
    let paint = |line: &str| match (record.converged, checked.is_doubtful()) {
        (true, false) => page.style.good(line),
        (true, true) => page.style.fair(line),
        (false, _) => page.style.bad(line),
    };
    let mut verdicts = page.paragraph(&verdict(record));
    verdicts.extend(model_check(record, &checked).map(|sentence| page.paragraph(&sentence)));
    text.extend(verdicts.lines().map(|line| paint(line) + "\n"));
    if !record.converged {
        text.push_str(&page.paragraph(&shortfall(record)));
    }
    text.push('\n');
    text.push_str(&page.paragraph(&data(&record.data)));
    text.extend(phases::combined(record).iter().map(|sentence| page.paragraph(sentence)));
    text.extend(places::counted(record).iter().map(|sentence| page.paragraph(sentence)));
    text.push_str(&page.paragraph(&likelihood(record)));
    if record.log_likelihood_kind == "estimates" {
        text.push_str(&page.paragraph(OF_ESTIMATES));
    }
    text
}

/// One sentence on whether the result can be trusted.
pub(crate) fn verdict(record: &FitRecord) -> String {
    if !record.converged {
        let reason = clean(&record.reason);
        let reason = reason.trim().trim_end_matches('.');
        let reason = if reason.is_empty() { "no reason was given" } else { reason };
        return format!(
            "Not converged: {reason}. The figures below are where the solver stopped, not a maximum of the likelihood."
        );
    }
    let what = if record.criterion == "reml" { "restricted maximum-likelihood" } else { "maximum-likelihood" };
    let edge = record.phases.iter().any(|p| !p.boundary.is_empty())
        || record.levels.iter().any(|level| !level.boundary.is_empty());
    let blind = record.phases.iter().any(|p| !p.unidentified.is_empty())
        || record.levels.iter().any(|level| !level.unidentified.is_empty())
        || record.parameters.iter().any(|p| p.standing.as_deref() == Some("unidentified"));
    let where_ = match (edge, blind) {
        (false, false) => "",
        (true, false) => " on the boundary of the possible covariances",
        (false, true) => " of all that the data identify",
        (true, true) => " of all that the data identify, on the boundary of the possible covariances",
    };
    let rounding = record.certificate.rounding;
    let but = match rounding > NOTABLE {
        true => format!(", but for rounding errors of up to {} standard errors", plain(rounding, 2)),
        false => String::new(),
    };
    let local = match record.parameters.iter().any(|p| !p.fixed) {
        true => " In the dynamic parameters this is a local maximum; no higher one was found.",
        false => "",
    };
    format!("Converged: the optimality certificate holds, so these are the {what} estimates{where_}{but}.{local}")
}

/// What the figures of the fit say of the model, beside convergence; nothing where it did not converge.
pub(crate) fn model_check(record: &FitRecord, checked: &ModelCheckRecord) -> Option<String> {
    if !record.converged {
        return None;
    }
    let findings: Vec<String> = checked.findings.iter().map(|finding| clean(&finding.text)).collect();
    let looked_at = |innovations: bool| {
        let has = |test: &TestRecord| if innovations { test.innovations.is_some() } else { test.p_value.is_some() };
        record.tests.iter().any(has)
    };
    let said = match (checked.verdict.as_str(), looked_at(true), looked_at(false)) {
        ("doubtful", ..) => format!("Model check doubtful: {}.", findings.join("; ")),
        ("passed", true, true) => "Model check passed: innovations and tests agree with the model.".to_owned(),
        ("passed", true, false) => "Model check passed: the innovations agree with the model.".to_owned(),
        ("passed", false, _) => {
            "Model check passed: the tests agree with the population; there are no innovations to look at.".to_owned()
        }
        _ => "Model check not made: this record has no figures of single tests.".to_owned(),
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
    format!("Optimality conditions are missed, in standard errors, by: {}.", figures.join(", "))
}

/// Counts of the data, in one sentence.
pub(crate) fn data(d: &DataRecord) -> String {
    let counts = [count(d.tests, "test"), count(d.steps, "step"), count(d.observations, "observation")].join(", ");
    let from = from(&d.files);
    let designs = match (d.design_classes, d.tests) {
        (_, 0 | 1) => String::new(),
        (1, _) => "; all tests share one design".to_owned(),
        (n, tests) if n == tests => "; every test has a design of its own".to_owned(),
        (n, _) => format!("; {n} different designs"),
    };
    let roots = match d.square_root_tests {
        0 => String::new(),
        1 => "; 1 test took the square-root path".to_owned(),
        n => format!("; {n} tests took the square-root path"),
    };
    format!("Data: {counts}{from}{designs}{roots}.")
}

/// ` from a.csv, b.csv and 7 more`
pub(crate) fn from(files: &[String]) -> String {
    let files: Vec<String> = files.iter().map(|f| clean(f)).collect();
    if files.is_empty() { String::new() } else { format!(" from {}", list(&files, 3)) }
}

pub(crate) fn likelihood(record: &FitRecord) -> String {
    let name = match (record.log_likelihood_kind.as_str(), record.criterion.as_str()) {
        ("estimates", _) => "Log-likelihood of the estimates",
        (_, "reml") => "Restricted log-likelihood",
        _ => "Log-likelihood",
    };
    let mut parts =
        vec![format!("{name} {}", hundredths(record.log_likelihood)), count(record.free_parameters, "free parameter")];
    parts.extend(record.aic.map(|x| format!("AIC {}", hundredths(x))));
    parts.extend(record.bic.map(|x| format!("BIC {}", hundredths(x))));
    parts.join(", ") + "."
}
