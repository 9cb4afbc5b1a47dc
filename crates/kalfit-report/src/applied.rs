//! What `kalfit apply` found.

use kalfit::record::{AppliedRecord, FarRecord, JointRecord};

use crate::Style;
use crate::number::{p_value, plain, probability};
use crate::page::Page;
use crate::table::{Column, Side};
use crate::words::{clean, count};

/// Tests that stand out are listed up to this many.
const MOST: usize = 10;
/// A joint p-value below this says that the tests are not of the population.
const DOUBTFUL: f64 = 0.01;

/// What a fitted model says of tests, in words and tables. Every line fits `style.width` and ends with a line feed.
pub fn applied_summary(record: &AppliedRecord, style: &Style) -> String {
    let page = Page::new(style);
    let mut sections = Vec::new();
    if !record.title.trim().is_empty() {
        sections.push(page.heading(&clean(&record.title)) + "\n");
    }
    let (tests, values) = (count(record.tests, "test"), count(record.observations, "measured value"));
    let facts = format!("{tests} with {values}, all parameters as in {}: nothing is estimated.", clean(&record.from));
    sections.push(page.paragraph(&facts) + &page.paragraph(&verdict(record)));
    sections.push(page.section("All tests together", &page.items(&together(record))));
    sections.push(page.section("Tests that stand out", &far(record, &page)));
    sections.push(page.section("How to read this", &page.items(&notes(record))));
    sections.retain(|section| !section.is_empty());
    sections.join("\n")
}

/// What all of it comes to, in a sentence or two.
fn verdict(record: &AppliedRecord) -> String {
    let doubtful = |joint: &JointRecord| joint.p_value.is_some_and(|p| p < DOUBTFUL);
    let first = match (doubtful(&record.distance), doubtful(&record.residual)) {
        (true, true) => "The tests are not of this population, and the model does not describe their records.",
        (true, false) => "The tests are not of this population: their initial states do not have its law.",
        (false, true) => "The model does not describe the records of these tests: residuals do not have their law.",
        (false, false) => "As a whole the tests are of this population, as far as they can tell.",
    };
    let mut sentences = vec![first.to_owned()];
    if !record.outlying.is_empty() {
        sentences.push(format!("The initial state of {} stands out.", count(record.outlying.len(), "test")));
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
        0 => "Initial states: the tests say nothing of them.".to_owned(),
        _ => format!("Initial states: squared distances of the {whose} from the population {}", sum(&record.distance)),
    });
    if record.residual.degrees_of_freedom > 0 {
        items.push(format!(
            "Residuals: squares of what the measured values are off the model, whatever the initial states are, {}",
            sum(&record.residual)
        ));
    }
    if let Some(far) = record.furthest.as_ref().filter(|_| record.outlying.is_empty()) {
        items.push(format!(
            "The test furthest from the population is `{}`: {} by itself, {} as the furthest of {}.",
            clean(&far.test),
            p_value(far.p_value),
            p_value(far.p_corrected),
            record.tests
        ));
    }
    items
}

/// `add up to 45.2, expected 40 ± 8.9 (chi-squared with 40 degrees of freedom): p = 0.53.`
fn sum(joint: &JointRecord) -> String {
    let degrees = joint.degrees_of_freedom;
    let p = joint.p_value.map_or("p unknown".to_owned(), p_value);
    let spread = plain((2.0 * degrees as f64).sqrt(), 2);
    let squared = plain(joint.squared, 4);
    format!(
        "add up to {squared}, expected {degrees} ± {spread} (chi-squared, {}): {p}.",
        count(degrees, "degree") + " of freedom"
    )
}

fn far(record: &AppliedRecord, page: &Page<'_>) -> String {
    let outlying = record.outlying.iter().map(|one| (one, "initial state"));
    let all: Vec<(&FarRecord, &str)> = outlying.chain(record.unlikely.iter().map(|one| (one, "residuals"))).collect();
    if all.is_empty() {
        return String::new();
    }
    let shown = &all[..all.len().min(MOST)];
    let column = |heading: &str, side: Side, cell: &dyn Fn(&(&FarRecord, &str)) -> String| {
        Column::new(heading, side, shown.iter().map(cell).collect())
    };
    let table = page.table(&[
        column("test", Side::Left, &|(one, _)| clean(&one.test)),
        column("in its", Side::Left, &|(_, what)| (*what).to_owned()),
        column("squared", Side::Right, &|(one, _)| plain(one.squared, 3)),
        column("expected", Side::Right, &|(one, _)| one.degrees_of_freedom.to_string()),
        column("p", Side::Right, &|(one, _)| probability(one.p_value)),
        column("p corrected", Side::Right, &|(one, _)| probability(one.p_corrected)),
    ]);
    match all.len() - shown.len() {
        0 => table,
        more => table + &page.paragraph(&format!("And {more} more.")),
    }
}

fn notes(record: &AppliedRecord) -> Vec<String> {
    let mut notes = vec![
        "The parameters are taken as exactly known. Those of a fit are not: distances of new tests from a population \
         whose mean was estimated from N tests are larger by about one part in N."
            .to_owned(),
        "p corrected: Holm's correction for the number of tests.".to_owned(),
    ];
    if record.of != "test" {
        notes.push(format!(
            "Tests of one group of `{}` are not independent: distances are added up by groups.",
            clean(&record.of)
        ));
    }
    notes
}
