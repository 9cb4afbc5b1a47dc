//! Fits of the same data side by side.

use kalfit::compare::{ComparedFit, ComparedRecord, ComparedValidation, NestedRecord, PValueKind, StandingRecord};

use crate::TextStyle;
use crate::number::{hundredths, plain, probability};
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{capital, clean, count, sentence};

/// Rows of the table of what differs.
const MOST: usize = 30;

/// The comparison in words and tables. Every line fits `style.width` and ends with a line feed.
pub fn compared_summary(record: &ComparedRecord, style: &TextStyle) -> String {
    let page = PageLayout::new(style);
    let names: Vec<String> = record.fits.iter().map(|fit| clean(&fit.name)).collect();
    let (what, number) = match record.fits.len() {
        0 => ("validation", record.validated.len()),
        fits => ("fit", fits),
    };
    let facts = format!(
        "{} {} {} with {}.",
        capital(&count(number, what)),
        if what == "fit" { "to" } else { "on" },
        count(record.tests, "test"),
        count(record.observations, "measured value")
    );
    let mut sections = vec![page.paragraph(&(facts + &verdict(record)))];
    sections.push(page.section("Likelihoods", &likelihoods(record, &names, &page)));
    sections.push(page.section("Predictions of tests left out", &predictive(record, &names, &page)));
    sections.push(page.section("Predictions of folds left out", &validated(&record.validated, &page)));
    sections.push(page.section("Nested fits", &nested(record, &names, &page)));
    sections.push(page.section("What differs", &differences(record, &names, &page)));
    sections.push(page.section("Equations that differ", &page.items(&lines(record, &names))));
    let notes: Vec<String> = record.notes.iter().map(|note| sentence(&clean(note))).collect();
    sections.push(page.section("Notes", &page.items(&notes)));
    sections.push(page.section("How to read this", &page.items(&reading(record))));
    sections.retain(|section| !section.is_empty());
    sections.join("\n")
}

/// Which fit has the smallest AIC.
fn verdict(record: &ComparedRecord) -> String {
    if record.fits.is_empty() {
        return String::new();
    }
    if !record.comparable {
        return " Their log-likelihoods cannot be compared: see the notes.".to_owned();
    }
    let best = record.fits.iter().find(|fit| fit.delta_aic == Some(0.0));
    match best {
        Some(best) => format!(" The smallest AIC is that of {}.", clean(&best.name)),
        None => String::new(),
    }
}

fn column(record: &ComparedRecord, heading: &str, cell: &dyn Fn(&ComparedFit) -> String) -> TextColumn {
    TextColumn::new(heading, ColumnSide::Right, record.fits.iter().map(cell).collect())
}

fn likelihoods(record: &ComparedRecord, names: &[String], page: &PageLayout<'_>) -> String {
    if record.fits.is_empty() {
        return String::new();
    }
    let or = |x: Option<f64>, show: &dyn Fn(f64) -> String| x.map_or("-".to_owned(), show);
    let fit = TextColumn::new("fit", ColumnSide::Left, names.to_vec());
    let mut columns = vec![
        column(record, "log-likelihood", &|fit| plain(fit.log_likelihood, 8)),
        column(record, "free", &|fit| fit.free_parameters.to_string()),
        column(record, "converged", &|fit| if fit.converged { "yes" } else { "no" }.to_owned()),
    ];
    if record.fits.iter().any(|fit| fit.criterion != "ml") {
        columns.push(column(record, "criterion", &|fit| fit.criterion.clone()));
    }
    let mut criteria = vec![column(record, "AIC", &|fit| or(fit.aic, &hundredths))];
    if record.comparable {
        criteria.push(column(record, "ΔAIC", &|fit| or(fit.delta_aic, &hundredths)));
        criteria.push(column(record, "weight", &|fit| or(fit.akaike_weight, &|x| format!("{x:.3}"))));
    }
    criteria.push(column(record, "BIC", &|fit| or(fit.bic, &hundredths)));
    if record.comparable {
        criteria.push(column(record, "ΔBIC", &|fit| or(fit.delta_bic, &hundredths)));
    }
    format!("{}\n{}", page.wide_table(&fit, &columns), page.wide_table(&fit, &criteria))
}

fn predictive(record: &ComparedRecord, names: &[String], page: &PageLayout<'_>) -> String {
    if record.fits.iter().all(|fit| fit.log_predictive_density.is_none()) {
        return String::new();
    }
    let or = |x: Option<f64>, digits: usize| x.map_or("-".to_owned(), |x| plain(x, digits));
    let difference = |fit: &ComparedFit| fit.predictive_difference.map(|own| own.difference);
    let error = |fit: &ComparedFit| fit.predictive_difference.and_then(|own| own.std_error);
    let mut columns = vec![
        TextColumn::new("fit", ColumnSide::Left, names.to_vec()),
        column(record, "log density", &|fit| or(fit.log_predictive_density, 7)),
    ];
    if is_ranked_by_predictions(record) {
        columns.push(column(record, "below the best", &|fit| or(difference(fit), 4)));
        columns.push(column(record, "std. error", &|fit| or(error(fit), 2)));
    }
    page.table(&columns)
}

fn is_ranked_by_predictions(record: &ComparedRecord) -> bool {
    record.fits.iter().any(|fit| fit.predictive_difference.is_some())
}

/// What `kalfit validate` found.
fn validated(all: &[ComparedValidation], page: &PageLayout<'_>) -> String {
    if all.is_empty() {
        return String::new();
    }
    let column = |heading: &str, side: ColumnSide, cell: &dyn Fn(&ComparedValidation) -> String| {
        TextColumn::new(heading, side, all.iter().map(cell).collect())
    };
    let or = |x: Option<f64>, digits: usize| x.map_or("-".to_owned(), |x| plain(x, digits));
    let difference = |own: &ComparedValidation| own.difference.map(|own| own.difference);
    let error = |own: &ComparedValidation| own.difference.and_then(|own| own.std_error);
    let name = column("validation", ColumnSide::Left, &|own| clean(&own.name));
    page.wide_table(
        &name,
        &[
            column("folds", ColumnSide::Right, &|own| own.folds.to_string()),
            column("log density", ColumnSide::Right, &|own| plain(own.log_density, 7)),
            column("std. error", ColumnSide::Right, &|own| or(own.std_error, 2)),
            column("below the best", ColumnSide::Right, &|own| or(difference(own), 4)),
            column("std. error of that", ColumnSide::Right, &|own| or(error(own), 2)),
            column("converged", ColumnSide::Right, &|own| if own.converged { "yes" } else { "no" }.to_owned()),
        ],
    )
}

fn nested(record: &ComparedRecord, names: &[String], page: &PageLayout<'_>) -> String {
    if record.nested.is_empty() {
        return String::new();
    }
    let cells = |cell: &dyn Fn(&NestedRecord) -> String| record.nested.iter().map(cell).collect::<Vec<String>>();
    let p_value = |test: &NestedRecord| match (test.p_value, test.p_value_kind) {
        (Some(p), PValueKind::UpperBound) if probability(p).starts_with('<') => probability(p),
        (Some(p), PValueKind::UpperBound) => format!("≤ {}", probability(p)),
        (Some(p), PValueKind::Approximate) => format!("about {}", probability(p)),
        (Some(p), _) => probability(p),
        (None, _) => "-".to_owned(),
    };
    let table = page.table(&[
        TextColumn::new("hypothesis", ColumnSide::Left, cells(&|test| names[test.null].clone())),
        TextColumn::new("within", ColumnSide::Left, cells(&|test| names[test.alternative].clone())),
        TextColumn::new("-2 log λ", ColumnSide::Right, cells(&|test| plain(test.lr, 5))),
        TextColumn::new("df", ColumnSide::Right, cells(&|test| test.df.to_string())),
        TextColumn::new("p-value", ColumnSide::Right, cells(&p_value)),
    ]);
    let mut reasons: Vec<String> = Vec::new();
    for test in &record.nested {
        if let Some(reason) = &test.reason {
            let of = format!("{} within {}", names[test.null], names[test.alternative]);
            reasons.push(format!("{of}: {}", sentence(&clean(reason))));
        }
    }
    table + &page.items(&reasons)
}

fn differences(record: &ComparedRecord, names: &[String], page: &PageLayout<'_>) -> String {
    if record.differences.is_empty() {
        return String::new();
    }
    let rows = &record.differences[..record.differences.len().min(MOST)];
    let cell = |standing: &Option<StandingRecord>| match standing {
        None => "-".to_owned(),
        Some(StandingRecord { fixed: true, value }) => format!("{} fixed", plain(*value, 5)),
        Some(StandingRecord { fixed: false, value }) => plain(*value, 5),
    };
    let first = TextColumn::new("", ColumnSide::Left, rows.iter().map(|row| clean(&row.element)).collect());
    let others: Vec<TextColumn> = names
        .iter()
        .enumerate()
        .map(|(k, name)| {
            TextColumn::new(name, ColumnSide::Right, rows.iter().map(|row| cell(&row.standing[k])).collect())
        })
        .collect();
    let more = match record.differences.len() - rows.len() {
        0 => Vec::new(),
        more => vec![format!("… and {more} more.")],
    };
    page.wide_table(&first, &others) + &page.items(&more)
}

fn lines(record: &ComparedRecord, names: &[String]) -> Vec<String> {
    let of = |fits: &[bool]| {
        let own = names.iter().zip(fits).filter(|(_, has)| **has).map(|(name, _)| name.as_str());
        own.collect::<Vec<_>>().join(", ")
    };
    record.lines.iter().map(|line| format!("{}: {}.", of(&line.fits), clean(&line.line))).collect()
}

fn reading(record: &ComparedRecord) -> Vec<String> {
    let mut notes = Vec::new();
    if !record.validated.is_empty() {
        notes.push(
            "Folds left out: the sum over all folds of the log density of their tests, given the fit to the other folds. Larger is \
             better. A difference of more than two standard errors is unlikely to be chance."
                .to_owned(),
        );
    }
    if record.fits.is_empty() {
        return notes;
    }
    notes.push(
        "Results files do not contain the data. Whether the fits used the same data is judged from the names of the tests and the \
         numbers of measured values."
            .to_owned(),
    );
    if record.comparable {
        notes.push(
            "AIC and BIC weigh the log-likelihood against the number of free parameters; smaller is better. The weights are Akaike \
             weights among these fits."
                .to_owned(),
        );
    }
    notes.extend(reading_of_tests_left_out(record));
    if !record.nested.is_empty() {
        notes.push(
            "Nested fits are listed where the results files show that they are. `kalfit test` also handles boundaries, and has a \
             bootstrap."
                .to_owned(),
        );
    }
    notes
}

/// What the densities of tests left out are given.
fn reading_of_tests_left_out(record: &ComparedRecord) -> Option<String> {
    let shown: Vec<&ComparedFit> = record.fits.iter().filter(|fit| fit.log_predictive_density.is_some()).collect();
    if shown.is_empty() {
        return None;
    }
    let start = "Tests left out: the sum over all tests of the log density of each, given";
    if !shown.iter().any(|fit| fit.parameters_held) {
        return Some(format!("{start} the fit to the others."));
    }
    let end = match is_ranked_by_predictions(record) {
        true => "Here all fits have the same free parameters.",
        false => {
            "Fits that differ in their free parameters therefore do not compare by these densities: AIC weighs the \
             parameters, and `kalfit validate` refits them without each fold."
        }
    };
    Some(format!(
        "{start} the mean and covariance of the fit to the others. Parameters have their values from all tests, the \
         one left out included, which flatters every free parameter. {end}"
    ))
}
