//! What `kalfit check` says of a model and its data.

use kalfit::record::{DataRecord, ObservabilityRecord, UnidentifiedRecord, WeakRecord};

use crate::Style;
use crate::page::Page;
use crate::summary::doubts;
use crate::summary::{headline, observability};
use crate::words::{clean, count, list, sentence};

/// No more names than this in a sentence.
const MOST_NAMES: usize = 12;

/// A model and its data, looked at without a fit.
#[derive(Debug, Clone, PartialEq)]
pub struct CheckRecord {
    /// Title of the model.
    pub title: String,
    /// The model in words, one fact a line.
    pub model: Vec<String>,
    /// Estimated states, in the order of μ and Σ.
    pub states: Vec<String>,
    /// How far the check went.
    pub checked: Checked,
}

/// How far a check went.
#[derive(Debug, Clone, PartialEq)]
pub enum Checked {
    /// There were no data.
    Model,
    /// The data could be read, but parameters without a value keep the filters from running.
    Read {
        /// Number of tests.
        tests: usize,
        /// Number of rows.
        rows: u64,
        /// Files, as named by the user.
        files: Vec<String>,
        /// Names of those parameters.
        free: Vec<String>,
    },
    /// The filters ran over the data.
    Reduced {
        /// Counts.
        data: DataRecord,
        /// Which tests say what of each state.
        observability: Vec<ObservabilityRecord>,
        /// Directions of μ and Σ the data say nothing about.
        unidentified: Vec<UnidentifiedRecord>,
        /// Directions of μ that are weakly determined.
        weak: Vec<WeakRecord>,
        /// What else a fit will run into, in sentences.
        notes: Vec<String>,
        /// Free parameters that were held at their start values.
        at_start_of: Vec<String>,
    },
}

/// The check in words. Every line fits `style.width` and ends with a line feed.
pub fn check_summary(record: &CheckRecord, style: &Style) -> String {
    let page = Page::new(style);
    let mut sections = Vec::new();
    if !record.title.trim().is_empty() {
        sections.push(page.heading(&clean(&record.title)) + "\n");
    }
    let facts: Vec<String> = record.model.iter().map(|fact| clean(fact)).collect();
    sections.push(page.section("Model", &page.items(&facts)));
    match &record.checked {
        Checked::Model => {
            sections.push(page.paragraph("The model is sound. Give data too, to see what they identify."))
        }
        Checked::Read { tests, rows, files, free } => {
            let rows = count(usize::try_from(*rows).unwrap_or(usize::MAX), "row");
            let facts = format!("{}, {rows}{}.", count(*tests, "test"), headline::from(files));
            sections.push(page.section("Data", &page.items(&[facts])));
            sections.push(page.section("Identifiability", &page.items(&[not_examined(free)])));
        }
        Checked::Reduced { data, .. } => sections.extend(reduced(record, data, &page)),
    }
    sections.retain(|section| !section.is_empty());
    sections.join("\n")
}

/// Data, observability, identifiability.
fn reduced(record: &CheckRecord, data: &DataRecord, page: &Page<'_>) -> Vec<String> {
    let Checked::Reduced { observability, unidentified, weak, notes, at_start_of, .. } = &record.checked else {
        return Vec::new();
    };
    let facts = headline::data(data);
    let mut sentences = identified(record, unidentified);
    sentences.extend(observability::warnings(observability, weak, data.tests));
    sentences.extend(observability::few_tests(observability, data.tests));
    sentences.extend(notes.iter().map(|note| sentence(&clean(note))));
    sentences.extend(held_at_start(at_start_of));
    vec![
        page.section("Data", &page.items(&[facts.trim_start_matches("Data: ").to_owned()])),
        page.section("Observability", &observability::overview(observability, data.tests, page)),
        page.section("Identifiability", &page.items(&sentences)),
    ]
}

fn not_examined(free: &[String]) -> String {
    let first = free.first().map_or("NAME", String::as_str);
    let (are, have) = if free.len() == 1 { ("is", "it has") } else { ("are", "they have") };
    format!(
        "Not examined: {} {are} free and {have} no start value; give one, as by `--set {}=VALUE`.",
        list(&free.iter().map(|name| clean(name)).collect::<Vec<_>>(), MOST_NAMES),
        clean(first)
    )
}

fn identified(record: &CheckRecord, unidentified: &[UnidentifiedRecord]) -> Vec<String> {
    let mut sentences = doubts::unidentified(unidentified, &record.states, false);
    if record.states.is_empty() {
        sentences.push("No state has an estimated start, so there is nothing to identify.".to_owned());
    } else if sentences.is_empty() {
        sentences.push("The data identify all that is free in the mean and the covariance.".to_owned());
    }
    sentences
}

fn held_at_start(at_start_of: &[String]) -> Option<String> {
    let names: Vec<String> = at_start_of.iter().map(|name| clean(name)).collect();
    let (them, value) = if names.len() == 1 { ("its", "value") } else { ("their", "values") };
    (!names.is_empty()).then(|| format!("Examined with {} at {them} start {value}.", list(&names, MOST_NAMES)))
}
