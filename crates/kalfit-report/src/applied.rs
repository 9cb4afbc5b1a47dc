//! What `kalfit apply` found.

use kalfit::record::{AppliedRecord, Basis, FarGroupRecord, FarRecord, JointRecord, LawRecord};

use crate::TextStyle;
use crate::number::{p_value, plain, probability};
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, count, list};

/// Tests that stand out are listed up to this many.
const MOST: usize = 10;
/// A joint p-value below this says that the tests are not of the population.
const DOUBTFUL: f64 = 0.01;

/// What a fitted model says of tests, in words and tables. Every line fits `style.width` and ends with a line feed.
pub fn applied_summary(record: &AppliedRecord, style: &TextStyle) -> String {
    let page = PageLayout::new(style);
    let mut sections = Vec::new();
    if !record.title.trim().is_empty() {
        sections.push(page.heading(&clean(&record.title)) + "\n");
    }
    let (tests, values) = (count(record.tests, "test"), count(record.observations, "measured value"));
    let but = match record.changed.is_empty() {
        true => String::new(),
        false => format!(
            " but {}",
            list(&record.changed.iter().map(|name| format!("`{}`", clean(name))).collect::<Vec<_>>(), MOST)
        ),
    };
    let facts = format!(
        "{tests} with {values}. All parameters are taken from {}{but}; nothing is estimated.",
        clean(&record.from)
    );
    sections.push(page.paragraph(&facts) + &page.paragraph(&verdict(record)));
    sections.push(page.section("All tests together", &page.items(&together(record))));
    sections.push(page.section("Outlying tests", &far(record, &page)));
    sections.push(page.section("Outlying groups", &far_groups(record, &page)));
    sections.push(page.section("How to read this", &page.items(&notes(record))));
    sections.retain(|section| !section.is_empty());
    sections.join("\n")
}

/// What all of it comes to, in a sentence or two.
fn verdict(record: &AppliedRecord) -> String {
    let doubtful = |joint: &JointRecord| joint.p_value.is_some_and(|p| p < DOUBTFUL);
    let apart = doubtful(&record.distance) || record.within.as_ref().is_some_and(doubtful);
    let nothing = record.distance.degrees_of_freedom + record.residual.degrees_of_freedom == 0;
    let unjudged = record.distance.degrees_of_freedom > 0 && record.distance.p_value.is_none();
    let first = match (apart, doubtful(&record.residual)) {
        _ if nothing => "The measurements contain no information about the population.",
        (true, true) => "The tests do not belong to this population, and the model does not describe their records.",
        (true, false) => {
            "The tests do not belong to this population: their initial states are distributed differently."
        }
        (false, true) => "The model does not describe the records of these tests: the residuals are not as expected.",
        (false, false) if unjudged => {
            "Whether the tests are of this population cannot be judged: it was estimated from too few tests for the law of their distances \
             to be known."
        }
        (false, false) => "Taken together, the tests agree with this population.",
    };
    let mut sentences = vec![first.to_owned()];
    if !record.outlying.is_empty() {
        sentences.push(match record.outlying.len() {
            1 => "The initial state of 1 test is an outlier.".to_owned(),
            number => format!("The initial states of {number} tests are outliers."),
        });
    }
    if !record.outlying_groups.is_empty() {
        sentences.push(match record.outlying_groups.len() {
            1 => "One group of tests is an outlier as a whole.".to_owned(),
            number => format!("{number} groups of tests are outliers as a whole."),
        });
    }
    if !record.unlikely.is_empty() {
        sentences.push(format!(
            "The residuals of {} are larger than the model allows.",
            count(record.unlikely.len(), "test")
        ));
    }
    sentences.join(" ")
}

fn together(record: &AppliedRecord) -> Vec<String> {
    let each = record.log_density / record.tests.max(1) as f64;
    let mut items = vec![format!(
        "Log predictive density: {} in all, {} for each test on average.",
        plain(record.log_density, 7),
        plain(each, 4)
    )];
    let whose = if record.of == "test" { "tests".to_owned() } else { format!("groups of `{}`", clean(&record.of)) };
    items.push(match record.distance.degrees_of_freedom {
        0 => "Initial states: the tests contain no information about them.".to_owned(),
        _ => format!("Initial states: squared distances of the {whose} from the population {}", sum(&record.distance)),
    });
    if let Some(within) = record.within.as_ref().filter(|within| within.degrees_of_freedom > 0) {
        let group = clean(&record.of);
        items.push(format!(
            "Within the groups of `{group}`: squared distances of tests from each other {}",
            sum(within)
        ));
    }
    if record.residual.degrees_of_freedom > 0 {
        items.push(format!(
            "Residuals (differences between measurements and model that no initial state explains): their squares {}",
            sum(&record.residual)
        ));
    }
    if let Some(far) = record.furthest.as_ref().filter(|_| record.outlying.is_empty()) {
        items.push(format!(
            "The test furthest from the population is `{}`: {} by itself, {} as the furthest of {}.",
            clean(&far.test),
            p_value(far.p_value),
            p_value(far.p_corrected),
            record.compared
        ));
    }
    items
}

/// `add up to 45.2, expected 40 ± 8.9 (chi-squared with 40 degrees of freedom): p = 0.53.`
fn sum(joint: &JointRecord) -> String {
    let squared = plain(joint.squared, 4);
    let Some(LawRecord { expected, std_dev, degrees_of_freedom, denominator }) = joint.law else {
        let degrees = count(joint.degrees_of_freedom, "degree") + " of freedom";
        return format!("add up to {squared}, on {degrees}; their distribution is not known.");
    };
    let p = joint.p_value.map_or("p unknown".to_owned(), p_value);
    let expected = match (expected, std_dev) {
        (Some(expected), Some(std_dev)) => format!("expected {} ± {}", plain(expected, 3), plain(std_dev, 2)),
        (Some(expected), None) => format!("expected {}", plain(expected, 3)),
        (None, _) => "expected anything".to_owned(),
    };
    let law = match denominator {
        None => format!("chi-squared, {} degrees of freedom", plain(degrees_of_freedom, 3)),
        Some(below) => format!("F, {} and {} degrees of freedom", plain(degrees_of_freedom, 3), plain(below, 3)),
    };
    format!("add up to {squared}, {expected} ({law}): {p}.")
}

fn far(record: &AppliedRecord, page: &PageLayout<'_>) -> String {
    let outlying = record.outlying.iter().map(|one| (one, "initial state"));
    let all: Vec<(&FarRecord, &str)> = outlying.chain(record.unlikely.iter().map(|one| (one, "residuals"))).collect();
    if all.is_empty() {
        return String::new();
    }
    let shown = &all[..all.len().min(MOST)];
    let column = |heading: &str, side: ColumnSide, cell: &dyn Fn(&(&FarRecord, &str)) -> String| {
        TextColumn::new(heading, side, shown.iter().map(cell).collect())
    };
    let table = page.table(&[
        column("test", ColumnSide::Left, &|(one, _)| clean(&one.test)),
        column("in its", ColumnSide::Left, &|(_, what)| (*what).to_owned()),
        column("squared", ColumnSide::Right, &|(one, _)| plain(one.squared, 3)),
        column("expected", ColumnSide::Right, &|(one, _)| one.degrees_of_freedom.to_string()),
        column("p", ColumnSide::Right, &|(one, _)| probability(one.p_value)),
        column("p corrected", ColumnSide::Right, &|(one, _)| probability(one.p_corrected)),
    ]);
    match all.len() - shown.len() {
        0 => table,
        more => table + &page.paragraph(&format!("And {more} more.")),
    }
}

fn far_groups(record: &AppliedRecord, page: &PageLayout<'_>) -> String {
    let all = &record.outlying_groups;
    let shown = &all[..all.len().min(MOST)];
    let column = |heading: &str, side: ColumnSide, cell: &dyn Fn(&FarGroupRecord) -> String| {
        TextColumn::new(heading, side, shown.iter().map(cell).collect())
    };
    let table = page.table(&[
        column("level", ColumnSide::Left, &|one| clean(&one.level)),
        column("group", ColumnSide::Left, &|one| clean(&one.id.join("/"))),
        column("tests", ColumnSide::Right, &|one| one.tests.to_string()),
        column("squared", ColumnSide::Right, &|one| plain(one.squared, 3)),
        column("expected", ColumnSide::Right, &|one| one.degrees_of_freedom.to_string()),
        column("p", ColumnSide::Right, &|one| probability(one.p_value)),
        column("p corrected", ColumnSide::Right, &|one| probability(one.p_corrected)),
    ]);
    match all.len() - shown.len() {
        _ if all.is_empty() => String::new(),
        0 => table,
        more => table + &page.paragraph(&format!("And {more} more.")),
    }
}

fn notes(record: &AppliedRecord) -> Vec<String> {
    let mut notes = vec![allowed_for(record)];
    let sums = [Some(&record.distance), record.within.as_ref(), Some(&record.residual)];
    if sums.into_iter().flatten().any(|sum| sum.degrees_of_freedom > 0 && sum.law.is_none()) {
        notes.push(format!(
            "The distribution of a sum is unknown if it depends on quantities that the data of the fit do not determine, or if \
             the {} of the fit are too few for its {}. Nothing is concluded from such a sum.",
            fitted(record),
            count(record.states, "state")
        ));
    }
    if !record.at_zero.is_empty() && record.basis != Basis::OwnTests {
        let names: Vec<String> = record.at_zero.iter().map(|name| format!("`{}`", clean(name))).collect();
        notes.push(format!("Estimated as zero and taken as exactly zero: {}.", list(&names, MOST)));
    }
    if record.own > 0 && record.basis != Basis::OwnTests {
        notes.push(format!(
            "{} of these tests were used to estimate the parameters, so they agree with them better than new tests do.",
            record.own
        ));
    }
    notes.push(
        "The p-value of a sum is two-sided. That of a single test is the probability of a larger value, corrected by Holm's method \
         for the number of tests."
            .to_owned(),
    );
    notes
}

/// `12 tests`, `10 groups of `chip``.
fn fitted(record: &AppliedRecord) -> String {
    let number = record.fitted.unwrap_or_default();
    match record.of == "test" {
        true => count(number, "test"),
        false => format!("{} of `{}`", count(number, "group"), clean(&record.of)),
    }
}

/// What expected values and p-values allow for.
fn allowed_for(record: &AppliedRecord) -> String {
    let from = clean(&record.from);
    match record.basis {
        Basis::Given => "The parameters are taken as exactly known.".to_owned(),
        Basis::Crossed => {
            "The parameters are taken as exactly known: where groups cross, errors of the estimates are not allowed \
                           for, so that p-values are too small where the fit rests on few levels."
                .to_owned()
        }
        Basis::OwnTests => format!(
            "The parameters of {from} were estimated from these same tests, so the sums of squares are close to what is expected. New \
             tests are compared with wider distributions."
        ),
        Basis::Estimates => format!(
            "Expected values and p-values allow for the errors of all estimates in {from} (from {}): sums of squares are compared with \
             a multiple of F instead of chi-squared.",
            fitted(record)
        ),
        Basis::Population => format!(
            "Expected values and p-values allow for the errors of mean and covariance in {from} (from {}): distances are compared with \
             a multiple of F instead of chi-squared. Dynamic parameters are taken as exactly known, because some of these tests \
             were reduced with their values.",
            fitted(record)
        ),
        Basis::Tests => format!(
            "{from} does not contain the covariance of its estimates (there are too many, or another kind of fit wrote it). Distances \
             are therefore compared as if each of its {} had determined all its states exactly, which is too strict, and residuals \
             as if the dynamic parameters were exactly known.",
            fitted(record)
        ),
    }
}
