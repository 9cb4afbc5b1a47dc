//! What `kalfit validate` found.

use kalfit::validate::{AgainstRecord, PieceRecord, ValidatedRecord};

use crate::TextStyle;
use crate::number::{p_value, plain};
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, count, list};

/// Tests are listed up to this many, folds up to this many.
const MOST: usize = 10;
const MOST_FOLDS: usize = 30;
/// A difference with a smaller p-value is one.
const LEVEL: f64 = 0.05;

/// How well a model predicts, in words and tables. Every line fits `style.width` and ends with a line feed.
pub fn validated_summary(record: &ValidatedRecord, style: &TextStyle) -> String {
    let page = PageLayout::new(style);
    let mut sections = Vec::new();
    if !record.title.trim().is_empty() {
        sections.push(page.heading(&clean(&record.title)) + "\n");
    }
    let verdict = Some(verdict(record)).filter(|verdict| !verdict.is_empty());
    sections.push(page.paragraph(&facts(record)) + &verdict.map_or(String::new(), |verdict| page.paragraph(&verdict)));
    sections
        .push(page.section("Predictions of tests that were left out of the fit", &page.items(&predictions(record))));
    if let Some(other) = &record.against {
        sections.push(page.section("The other model", &page.items(&against(record, other))));
    }
    sections.push(page.section("Folds", &folds(record, &page)));
    sections.push(page.section(&format!("The {} that are predicted worst", whose(record, 2)), &worst(record, &page)));
    sections.push(page.section("How to read this", &page.items(&notes(record))));
    sections.retain(|section| !section.is_empty());
    sections.join("\n")
}

/// `3 tests`, or `3 groups of unit`.
fn whose(record: &ValidatedRecord, number: usize) -> String {
    match (record.of.as_str(), number) {
        ("test", 2) => "tests".to_owned(),
        ("test", number) => count(number, "test"),
        (level, 2) => format!("groups of `{}`", clean(level)),
        (level, number) => format!("{} of `{}`", count(number, "group"), clean(level)),
    }
}

fn facts(record: &ValidatedRecord) -> String {
    let tests = record.folds.iter().map(|fold| fold.tests).sum();
    let how = match (&record.by, record.seed) {
        (Some(column), _) => format!("one for each value of `{}`", clean(column)),
        (None, _) if record.folds.len() == tests => "one for each test".to_owned(),
        (None, seed) => format!("drawn with seed {}", seed.unwrap_or_default()),
    };
    format!(
        "{} with {} in {}, {how}: each fold is predicted by a fit to the others.",
        count(tests, "test"),
        count(record.observations, "measured value"),
        count(record.folds.len(), "fold")
    )
}

fn verdict(record: &ValidatedRecord) -> String {
    let uncertain: Vec<String> =
        record.folds.iter().filter(|fold| !fold.converged).map(|fold| clean(&fold.name)).collect();
    let doubt = match (record.converged, uncertain.is_empty()) {
        (true, true) => String::new(),
        (false, _) => " The fit to all tests did not converge.".to_owned(),
        (true, false) => {
            format!(" The fits without these folds did not converge: {}.", list(&uncertain, MOST))
        }
    };
    let first = match &record.against {
        None => String::new(),
        Some(other) => {
            let better = if other.difference >= 0.0 { "This model" } else { "The other model" };
            match other.p_value {
                Some(p) if p < LEVEL => format!("{better} predicts better."),
                Some(_) => "Neither model predicts better: the difference is within its scatter.".to_owned(),
                None => "The two models give the same predictions.".to_owned(),
            }
        }
    };
    format!("{first}{doubt}").trim().to_owned()
}

fn predictions(record: &ValidatedRecord) -> Vec<String> {
    let error = record.std_error.map_or(String::new(), |error| format!(" ± {}", plain(error, 3)));
    let each = record.log_density / record.observations.max(1) as f64;
    let mut items = vec![
        format!(
            "Log predictive density: {}{error}, {} for each measured value.",
            plain(record.log_density, 7),
            plain(each, 4)
        ),
        format!(
            "The fit to all tests gives {}, which is {} more than for tests that were left out.",
            plain(record.fitted, 7),
            plain(record.fitted - record.log_density, 3)
        ),
    ];
    let parts: Vec<String> = record
        .coverage
        .iter()
        .filter_map(|one| {
            Some(format!("{:.1} % within the {} % interval", 100.0 * one.found?, plain(100.0 * one.expected, 3)))
        })
        .collect();
    if let Some(first) = record.coverage.first().filter(|_| !parts.is_empty()) {
        let all = count(first.innovations, "measured value");
        items.push(format!("Of {all}, each predicted from those before it in its test: {}.", list(&parts, MOST)));
    }
    if record.compared > 0 {
        items.push(format!(
            "Initial states: {} of {} are within the 95 % limit of their distance from the population of the others.",
            record.near,
            count(record.compared, "test")
        ));
    }
    items
}

fn against(record: &ValidatedRecord, other: &AgainstRecord) -> Vec<String> {
    let error = other.std_error.map_or(String::new(), |error| format!(" ± {}", plain(error, 3)));
    let p = other.p_value.map_or(String::new(), |p| format!(" ({})", p_value(p)));
    vec![
        format!(
            "{}: log predictive density {}; the fit to all tests gives {}.",
            clean(&other.title),
            plain(other.log_density, 7),
            plain(other.fitted, 7)
        ),
        format!(
            "Difference, this model minus the other: {}{error} over {}{p}.",
            plain(other.difference, 4),
            whose(record, record.pieces.len())
        ),
    ]
}

fn folds(record: &ValidatedRecord, page: &PageLayout<'_>) -> String {
    if record.folds.len() > MOST_FOLDS {
        return String::new();
    }
    let column = |heading: &str, side: ColumnSide, cell: &dyn Fn(&kalfit::validate::FoldRecord) -> String| {
        TextColumn::new(heading, side, record.folds.iter().map(cell).collect())
    };
    page.table(&[
        column("fold", ColumnSide::Left, &|fold| fold.name.clone()),
        column("tests", ColumnSide::Right, &|fold| fold.tests.to_string()),
        column("log density", ColumnSide::Right, &|fold| plain(fold.log_density, 6)),
        column("", ColumnSide::Left, &|fold| {
            if fold.converged { String::new() } else { "not converged".to_owned() }
        }),
    ])
}

/// Those with the lowest density for each measured value.
fn worst(record: &ValidatedRecord, page: &PageLayout<'_>) -> String {
    let each = |piece: &&PieceRecord| piece.log_density / piece.observations.max(1) as f64;
    let mut pieces: Vec<&PieceRecord> = record.pieces.iter().filter(|piece| piece.observations > 0).collect();
    pieces.sort_by(|a, b| each(a).total_cmp(&each(b)).then_with(|| a.name.cmp(&b.name)));
    pieces.truncate(MOST.min(record.pieces.len() / 2).max(1));
    let column = |heading: &str, side: ColumnSide, cell: &dyn Fn(&&PieceRecord) -> String| {
        TextColumn::new(heading, side, pieces.iter().map(cell).collect())
    };
    page.table(&[
        column("name", ColumnSide::Left, &|piece| clean(&piece.name)),
        column("fold", ColumnSide::Left, &|piece| clean(&piece.fold)),
        column("measured", ColumnSide::Right, &|piece| piece.observations.to_string()),
        column("log density", ColumnSide::Right, &|piece| plain(piece.log_density, 6)),
        column("for each", ColumnSide::Right, &|piece| plain(each(piece), 4)),
        column("other model", ColumnSide::Right, &|piece| piece.against.map_or(String::new(), |other| plain(other, 6))),
    ])
}

fn notes(record: &ValidatedRecord) -> Vec<String> {
    let mut notes = vec![format!(
        "The log predictive density of a test is the logarithm of the probability density of its measured values, given a fit without \
         its fold. Larger is better; the standard error comes from the scatter between {}.",
        whose(record, 2)
    )];
    if record.against.is_some() {
        notes.push(
            "The models are compared test by test on the same folds, so a test that is hard to predict for both does not count."
                .to_owned(),
        );
    }
    notes
}
