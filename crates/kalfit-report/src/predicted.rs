//! What `kalfit predict` found.

use kalfit::record::{PairRecord, PredictedRecord, PredictedValueRecord};

use crate::TextStyle;
use crate::number::plain;
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn, wide_table};
use crate::words::{clean, count, list};

/// Parameters with other values are named up to this many.
const MOST: usize = 10;
/// Digits of a figure.
const DIGITS: usize = 4;

/// Predictions in words and tables. Every line fits `style.width` and ends with a line feed.
pub fn predicted_summary(record: &PredictedRecord, style: &TextStyle) -> String {
    let page = PageLayout::new(style);
    let mut sections = Vec::new();
    if !record.title.trim().is_empty() {
        sections.push(page.heading(&clean(&record.title)) + "\n");
    }
    let names: Vec<String> = record.changed.iter().map(|name| format!("`{}`", clean(name))).collect();
    let but = if names.is_empty() { String::new() } else { format!(" but {}", list(&names, MOST)) };
    let whose = if record.units == "known" { ", for units that were in the fit" } else { "" };
    let facts = format!(
        "Predictions for {} with {}; all parameters are taken from {}{but}{whose}.",
        count(record.tests, "test"),
        count(record.rows, "row"),
        clean(&record.from)
    );
    sections.push(page.paragraph(&facts));
    for values in record.last.chunk_by(|a, b| a.test == b.test) {
        let place = match values[0].time {
            Some(time) => format!("at time {}", plain(time, 8)),
            None => format!("in row {}", values.iter().map(|value| value.row).max().unwrap_or_default()),
        };
        let heading = format!("Test {}, {place}", clean(&values[0].test));
        sections.push(page.section(&heading, &table(values, page.width())));
    }
    let shown = record.last.chunk_by(|a, b| a.test == b.test).count();
    if let Some(more) = record.tests.checked_sub(shown).filter(|more| *more > 0) {
        let those = count(more, "more test");
        sections.push(page.paragraph(&format!("And {those}: `--out` writes a table of all rows of all of them.")));
    }
    let pairs: Vec<String> = record.pairs.iter().map(|pair| together(record, pair)).collect();
    sections.push(page.section("Two outputs together", &page.items(&pairs)));
    sections.push(page.section("How to read this", &page.items(&notes(record))));
    sections.retain(|section| !section.is_empty());
    sections.join("\n")
}

fn table(values: &[PredictedValueRecord], width: usize) -> String {
    let column = |heading: &str, cell: &dyn Fn(&PredictedValueRecord) -> String| {
        TextColumn::new(heading, ColumnSide::Right, values.iter().map(cell).collect())
    };
    let limits = |ends: Option<[f64; 2]>| match ends {
        Some([lower, upper]) => format!("{} to {}", plain(lower, DIGITS), plain(upper, DIGITS)),
        None => "unknown".to_owned(),
    };
    let names = values.iter().map(|value| match &value.unit {
        Some(unit) => format!("{} [{unit}]", value.name),
        None => value.name.clone(),
    });
    let name = TextColumn::new("", ColumnSide::Left, names.collect());
    let others = [
        column("mean", &|value| plain(value.mean, DIGITS)),
        column("std. dev.", &|value| plain(value.std_dev, DIGITS)),
        column("population", &|value| plain(value.std_dev_population, DIGITS)),
        column("process", &|value| plain(value.std_dev_process, DIGITS)),
        column("estimation", &|value| value.std_dev_estimation.map_or("unknown".to_owned(), |x| plain(x, DIGITS))),
        column("one new test", &|value| limits(value.prediction)),
        column("limits of the mean", &|value| limits(value.confidence)),
        column("tolerance limits", &|value| limits(value.tolerance)),
    ];
    wide_table(&name, &others, width)
}

fn together(record: &PredictedRecord, pair: &PairRecord) -> String {
    let [first, second] = pair.names.each_ref().map(|name| clean(name));
    let [long, short] = pair.axes.map(|axis| plain(axis, DIGITS));
    let [cep, about_zero] = [pair.cep, pair.cep_about_zero].map(|radius| plain(radius, DIGITS));
    format!(
        "Test {}, {first} and {second}: the ellipse about the means that holds {} % of all tests has half axes {long} and {short}, \
         the longer one {}° from {first} towards {second}. Half of all tests are within {cep} of the means (the circular error \
         probable, CEP), and within {about_zero} of zero.",
        clean(&pair.test),
        plain(100.0 * record.content, 4),
        plain(pair.angle, 3)
    )
}

fn notes(record: &PredictedRecord) -> Vec<String> {
    let (sure, part) = (plain(100.0 * record.confidence, 4), plain(100.0 * record.content, 4));
    let mut notes = vec![
        "Standard deviations: \"population\" is the spread of the estimated initial states from test to test, \"process\" that of \
         process noise and of initial states with a given spread, and \"estimation\" the error of the estimated mean. The column \
         \"std. dev.\" combines those that are known."
            .to_owned(),
    ];
    notes.push(format!(
        "\"One new test\": the limits that contain its value with probability {part} %, by Student's t where the fit has degrees of \
         freedom."
    ));
    let limits = match record.one_sided {
        true => format!(
            "Tolerance limits, each with confidence {sure} %: {part} % of all tests are below the upper limit, and {part} % are above \
             the lower one."
        ),
        false => format!("Tolerance limits, with confidence {sure} %: {part} % of all tests are between them."),
    };
    notes.push(format!("Limits of the mean: a two-sided interval with confidence {sure} %. {limits}"));
    if record.profile {
        notes.push(
            "The limits of the mean come from the profile likelihood of the data: they contain the values that a likelihood-ratio test \
             does not reject. The test treats twice the drop in log-likelihood as chi-squared, which is exact for many tests."
                .to_owned(),
        );
    }
    notes.extend(record.covariance_errors.filter(|_| record.estimation).map(of_known_units));
    notes.push(match (record.estimation, record.fitted) {
        (false, _) => format!(
            "{} does not contain the covariance of its estimates (there are more than 200 of them, or an older version wrote it), so \
             the error of estimation is unknown.",
            clean(&record.from)
        ),
        (true, None) => "The parameters are taken as exactly known, so the limits are quantiles.".to_owned(),
        (true, Some(_)) => {
            let these = if record.profile { "The tolerance limits" } else { "The limits" };
            format!(
                "{these} treat the estimated variance as chi-squared, with degrees of freedom that follow from its standard error, or \
                 from those of the fit by restricted likelihood. That is exact where every test determines its initial state exactly, and a good approximation for many tests. A limit is \
                 \"unknown\" where there are too few tests for it or the data do not determine the quantity."
            )
        }
    });
    notes
}

/// What the error of the mean of a known unit contains.
fn of_known_units(covariance_errors: bool) -> String {
    let start = "The estimated mean of a known unit is its posterior mean.";
    match covariance_errors {
        true => format!(
            "{start} Its error is that of the posterior together with those of the population's mean and covariances, at the estimated \
             parameters. It is unknown how far the unit is from the others where the variance between units was estimated as zero: \
             limits are then unknown."
        ),
        false => format!(
            "{start} Its error is that of the posterior together with that of the population's mean. The errors of the covariances are \
             left out, which the results do not hold: with few units the limits are too narrow."
        ),
    }
}
