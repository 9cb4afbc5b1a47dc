//! What the data say of each state, and of which tests that hangs.

use kalfit::record::{ObservabilityRecord, WeakRecord};

use super::combination::{combination_of, weighted};
use crate::number::plain;
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, count, list};

/// One test with more than this share of what is known of a mean is named.
const ONE_TEST: f64 = 0.9;
/// Tests are named when there are no more of them.
const FEW: usize = 5;
/// A largest share of this times the average is that of any other test too.
const EQUAL: f64 = 1.0 + 1e-6;
/// A large model would fill the screen; the rest is in fit.json.
const MOST_ROWS: usize = 40;

/// A table for `kalfit check`, with what its columns mean.
pub(crate) fn overview(seen: &[ObservabilityRecord], tests: usize, page: &PageLayout<'_>) -> String {
    if seen.is_empty() {
        return String::new();
    }
    let rows = &seen[..seen.len().min(page.rows(MOST_ROWS))];
    let counted = |of: fn(&ObservabilityRecord) -> usize| -> Vec<String> {
        rows.iter().map(|row| of_all(of(row), tests)).collect()
    };
    let largest = |row: &ObservabilityRecord| match (&row.leading_test, row.leading_share) {
        (Some(_), Some(share)) if share * row.informed_by as f64 <= EQUAL => "all equal".to_owned(),
        (Some(test), Some(share)) => format!("{} %, {}", plain(100.0 * share, 2), clean(test)),
        _ => "-".to_owned(),
    };
    let columns = [
        TextColumn::new("state", ColumnSide::Left, rows.iter().map(|row| row.state.clone()).collect()),
        TextColumn::new("seen by", ColumnSide::Right, counted(|row| row.informed_by)),
        TextColumn::new("determined by", ColumnSide::Right, counted(|row| row.observed_by)),
        TextColumn::new("largest share", ColumnSide::Left, rows.iter().map(largest).collect()),
    ];
    let mut body = page.table(&columns);
    if seen.len() > rows.len() {
        body += &page.items(&[format!("… and {} more states.", seen.len() - rows.len())]);
    }
    let mut legend = "Seen by: tests whose measurements depend on the state. Determined by: tests that could \
                      estimate it by themselves."
        .to_owned();
    if rows.iter().any(|row| row.leading_share.is_some()) {
        legend += " Largest share: the test with the most information on the mean, and its part of all information.";
    }
    body + &page.items(&[legend])
}

/// `all 18`, `7 of 18`, `none`.
pub(crate) fn of_all(n: usize, tests: usize) -> String {
    match n {
        0 => "none".to_owned(),
        n if n == tests => format!("all {n}"),
        n => format!("{n} of {tests}"),
    }
}

/// What a reader must know: states that hang on one test, and weakly determined directions of the mean, those that mix phases
/// left to the notes.
pub(crate) fn warnings(seen: &[ObservabilityRecord], weak: &[WeakRecord], tests: usize) -> Vec<String> {
    let mut sentences: Vec<String> = seen.iter().filter_map(|row| one_test(row, tests)).collect();
    let states: Vec<String> = seen.iter().map(|row| row.state.clone()).collect();
    sentences.extend(weak.iter().filter(|weak| weak.phases.is_empty()).map(|weak| weakly(weak, &states, tests)));
    sentences
}

fn one_test(row: &ObservabilityRecord, tests: usize) -> Option<String> {
    let state = clean(&row.state);
    match (row.informed_by, row.tests.as_slice(), &row.leading_test, row.leading_share) {
        _ if tests < 2 => None,
        (1, [only], ..) => Some(format!("Only one test, {}, contains information on {state}.", clean(only))),
        (_, _, Some(test), Some(share)) if share > ONE_TEST => Some(format!(
            "{} % of the information on the mean of {state} comes from one test, {}.",
            plain(100.0 * share, 2),
            clean(test)
        )),
        _ => None,
    }
}

/// The tests that see a state, when they are few and not all: for `kalfit check`.
pub(crate) fn few_tests(seen: &[ObservabilityRecord], tests: usize) -> Vec<String> {
    let few = |row: &&ObservabilityRecord| (2..=FEW).contains(&row.informed_by) && row.informed_by < tests;
    let sentence = |row: &ObservabilityRecord| {
        let ids: Vec<String> = row.tests.iter().map(|id| clean(id)).collect();
        let only = format!("{} contain information on", count(row.informed_by, "test"));
        match ids.is_empty() {
            true => format!("Only {only} {}.", clean(&row.state)),
            false => format!("Only {only} {}: {}.", clean(&row.state), list(&ids, FEW)),
        }
    };
    seen.iter().filter(few).map(sentence).collect()
}

fn weakly(weak: &WeakRecord, states: &[String], tests: usize) -> String {
    let share = match (&weak.leading_test, weak.leading_share) {
        (Some(test), Some(share)) if share > ONE_TEST && tests > 1 => {
            format!(", and {} % of that information comes from one test, {}", plain(100.0 * share, 2), clean(test))
        }
        _ => String::new(),
    };
    format!(
        "Weakly determined: the combination {} of the means has an error {} times larger than that of the best determined \
         combination, in comparable units{share}.",
        combination_of(&weighted(&weak.direction, states)),
        plain(weak.condition, 2)
    )
}
