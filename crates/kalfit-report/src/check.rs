//! What `kalfit check` says of a model and its data.

use kalfit::record::{DataRecord, InformationRecord, ObservabilityRecord, UnidentifiedRecord, WeakRecord};

use serde::Serialize;

use crate::TextStyle;
use crate::number::plain;
use crate::page::PageLayout;
use crate::summary::doubts;
use crate::summary::{headline, observability, phases};
use crate::table::{ColumnSide, TextColumn, table};
use crate::words::{clean, count, list, sentence};

/// No more names than this in a sentence.
const MOST_NAMES: usize = 12;
/// Rows of the table of free parameters.
const MOST_PARAMETERS: usize = 40;
/// Levels that are named.
const MOST_LEVELS: usize = 6;

/// A model and its data, looked at without a fit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckRecord {
    /// What kind of results these are: [`CheckRecord::SCHEMA`].
    pub schema: String,
    /// The version that made them.
    pub kalfit_version: String,
    /// Title of the model.
    pub title: String,
    /// The model in words, one fact a line.
    pub model: Vec<String>,
    /// Dynamic parameters some values of which are free, counted in the data.
    pub parameters: Vec<ParameterCounts>,
    /// How far the check went.
    pub checked: CheckFindings,
}

impl CheckRecord {
    /// The name of this form of results.
    pub const SCHEMA: &str = "kalfit-check/1";

    /// What this version found.
    pub fn new(
        title: String,
        model: Vec<String>,
        parameters: Vec<ParameterCounts>,
        checked: CheckFindings,
    ) -> CheckRecord {
        let kalfit_version = env!("CARGO_PKG_VERSION").to_owned();
        CheckRecord { schema: CheckRecord::SCHEMA.to_owned(), kalfit_version, title, model, parameters, checked }
    }
}

/// The values of one dynamic parameter that the data have use for.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ParameterCounts {
    /// Its name.
    pub name: String,
    /// Column whose levels have a value each.
    pub per: Option<String>,
    /// Free values.
    pub free: usize,
    /// Levels of the data whose value is fixed.
    pub fixed: usize,
    /// Start value, if one is given.
    pub start: Option<f64>,
    /// Start values that a fit works out from the data, one for each free value, where none is given.
    pub found: Vec<f64>,
    /// Each level with the number of tests that have it; empty for a common parameter.
    pub levels: Vec<(String, usize)>,
}

/// How far a check went.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum CheckFindings {
    /// There were no data.
    Model,
    /// The filters ran over the data.
    Reduced {
        /// Counts.
        data: DataRecord,
        /// What they say of each phase.
        phases: Vec<CheckedPhase>,
        /// The crossed factors, then the levels of groups that tests stand in, the outermost first.
        levels: Vec<CheckedLevel>,
        /// What else a fit will run into, in sentences.
        notes: Vec<String>,
        /// Free parameters that were held at their start values.
        at_start_of: Vec<String>,
    },
}

/// How much there is of a phase.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PhaseCounts {
    /// Its name.
    pub name: String,
    /// Number of tests that have it.
    pub tests: usize,
    /// Number of its rows in all tests.
    pub rows: usize,
    /// Number of tests of which no rows are there, but what somebody's filter made of them.
    pub without_rows: usize,
}

/// How the groups of one level are filled, and what they say of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckedLevel {
    /// Its name.
    pub name: String,
    /// Whether it is a crossed factor.
    pub crossed: bool,
    /// Number of its groups.
    pub groups: usize,
    /// What its members are: the next level's name, or `test`.
    pub members: String,
    /// The least and the most members that a group of it has.
    pub members_each: (usize, usize),
    /// Estimated states.
    pub states: Vec<String>,
    /// Directions of its Σ the data say nothing about.
    pub unidentified: Vec<UnidentifiedRecord>,
}

/// What the data say of one phase.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckedPhase {
    /// How much there is of it.
    pub counts: PhaseCounts,
    /// Estimated states, in the order of μ and Σ.
    pub states: Vec<String>,
    /// Which tests say what of each state.
    pub observability: Vec<ObservabilityRecord>,
    /// Directions of μ and Σ the data say nothing about.
    pub unidentified: Vec<UnidentifiedRecord>,
    /// Directions of μ that are weakly determined.
    pub weak: Vec<WeakRecord>,
    /// What the phase adds to what is observable of all phases.
    pub information: Option<InformationRecord>,
}

/// The check in words. Every line fits `style.width` and ends with a line feed.
pub fn check_summary(record: &CheckRecord, style: &TextStyle) -> String {
    let page = PageLayout::new(style);
    let mut sections = Vec::new();
    if !record.title.trim().is_empty() {
        sections.push(page.heading(&clean(&record.title)) + "\n");
    }
    let facts: Vec<String> = record.model.iter().map(|fact| clean(fact)).collect();
    sections.push(page.section("Model", &page.items(&facts)));
    match &record.checked {
        CheckFindings::Model => {
            sections.push(page.paragraph("The model is valid. Give data as well to see what they can identify."))
        }
        CheckFindings::Reduced { data, phases, .. } => sections.extend(reduced(record, (data, phases), &page)),
    }
    sections.retain(|section| !section.is_empty());
    sections.join("\n")
}

/// Data, observability, identifiability.
fn reduced(record: &CheckRecord, (data, phases): (&DataRecord, &[CheckedPhase]), page: &PageLayout<'_>) -> Vec<String> {
    let CheckFindings::Reduced { levels, notes, at_start_of, .. } = &record.checked else { return Vec::new() };
    let facts = format!("{} {}", headline::data(data).trim_start_matches("Data: "), headline::designs(data));
    let counts: Vec<PhaseCounts> = phases.iter().map(|phase| phase.counts.clone()).collect();
    let mut sections = vec![
        page.section("Data", &(page.items(&[facts.trim_end().to_owned()]) + &counted(&counts, data.tests, page))),
        parameters(record, data.tests, page),
    ];
    let mut said: Vec<String> = notes.iter().map(|note| sentence(&clean(note))).collect();
    said.extend(held_at_start(at_start_of));
    match phases {
        [only] => {
            let mut sentences = examined(only, levels);
            sentences.append(&mut said);
            sentences.splice(0..0, grouped(levels));
            sections.push(page.section("Observability", &seen(only, page)));
            sections.push(page.section("Identifiability", &page.items(&sentences)));
        }
        several => {
            for phase in several {
                let name = clean(&phase.counts.name);
                sections.push(page.section(&format!("Phase {name}: observability"), &seen(phase, page)));
                sections
                    .push(page.section(&format!("Phase {name}: identifiability"), &page.items(&examined(phase, &[]))));
            }
            let information: Vec<_> =
                several.iter().map(|p| (p.counts.name.as_str(), p.information.as_ref())).collect();
            sections.push(phases::information(&information, true, page));
            sections.push(page.section("All phases", &page.items(&said)));
        }
    }
    sections
}

/// How many groups each level has, and what they cannot tell.
fn grouped(levels: &[CheckedLevel]) -> Vec<String> {
    let one = |level: &CheckedLevel| {
        let (least, most) = level.members_each;
        let each = if least == most {
            count(least, &level.members)
        } else {
            format!("{least} to {}", count(most, &level.members))
        };
        let (what, groups) = match level.crossed {
            true => ("Crossed factor", count(level.groups, "level")),
            false => ("Level", count(level.groups, "group")),
        };
        let mut sentences = vec![format!("{what} `{}`: {groups} of {each}.", clean(&level.name))];
        sentences.extend(doubts::unidentified(&level.unidentified, &level.states, false));
        sentences
    };
    levels.iter().flat_map(one).collect()
}

/// Rows and tests by phase, where there are several.
fn counted(phases: &[PhaseCounts], tests: usize, page: &PageLayout<'_>) -> String {
    if phases.len() < 2 {
        return String::new();
    }
    let column = |of: &dyn Fn(&PhaseCounts) -> String| phases.iter().map(of).collect();
    let mut columns = vec![
        TextColumn::new("phase", ColumnSide::Left, column(&|p| p.name.clone())),
        TextColumn::new("tests", ColumnSide::Right, column(&|p| observability::of_all(p.tests, tests))),
        TextColumn::new("rows", ColumnSide::Right, column(&|p| p.rows.to_string())),
    ];
    if phases.iter().any(|phase| phase.without_rows > 0) {
        columns.push(TextColumn::new("tests without rows", ColumnSide::Right, column(&|p| p.without_rows.to_string())));
    }
    format!("\n{}", table(&columns, page.width()))
}

fn seen(phase: &CheckedPhase, page: &PageLayout<'_>) -> String {
    observability::overview(&phase.observability, phase.counts.tests, page)
}

/// What is identified of a phase, and on what that rests.
fn examined(phase: &CheckedPhase, levels: &[CheckedLevel]) -> Vec<String> {
    let mut sentences = identified(phase, levels);
    sentences.extend(observability::warnings(&phase.observability, &phase.weak, phase.counts.tests));
    sentences.extend(observability::few_tests(&phase.observability, phase.counts.tests));
    sentences
}

/// Free parameters, with how many tests each value of them has to be learnt from.
fn parameters(record: &CheckRecord, tests: usize, page: &PageLayout<'_>) -> String {
    let rows = &record.parameters[..record.parameters.len().min(MOST_PARAMETERS)];
    if rows.is_empty() {
        return String::new();
    }
    let column = |of: &dyn Fn(&ParameterCounts) -> String| rows.iter().map(of).collect();
    let free = |row: &ParameterCounts| match row.fixed {
        0 => row.free.to_string(),
        fixed => format!("{}, and {fixed} fixed", row.free),
    };
    let start = |row: &ParameterCounts| match (row.free, row.start) {
        (0, _) => String::new(),
        (_, Some(start)) => plain(start, 6),
        (_, None) => worked_out(&row.found),
    };
    let columns = [
        TextColumn::new("parameter", ColumnSide::Left, column(&|row| row.name.clone())),
        TextColumn::new("free values", ColumnSide::Left, column(&free)),
        TextColumn::new("one for each", ColumnSide::Left, column(&|row| row.per.clone().unwrap_or_default())),
        TextColumn::new("tests each", ColumnSide::Left, column(&|row| tests_each(row, tests))),
        TextColumn::new("start", ColumnSide::Left, column(&start)),
    ];
    let mut remarks: Vec<String> = Vec::new();
    for row in rows.iter().filter(|row| !row.levels.is_empty()) {
        let level = |(level, n): &(String, usize)| format!("{} in {}", clean(level), count(*n, "test"));
        let levels: Vec<String> = row.levels.iter().map(level).collect();
        remarks.push(format!("Levels of {}: {}.", clean(&row.name), list(&levels, MOST_LEVELS)));
    }
    if record.parameters.len() > rows.len() {
        remarks.push(format!("… and {} more parameters.", record.parameters.len() - rows.len()));
    }
    page.section("Free parameters", &(table(&columns, page.width()) + &page.items(&remarks)))
}

fn tests_each(row: &ParameterCounts, tests: usize) -> String {
    let counts = || row.levels.iter().map(|(_, n)| *n);
    match (counts().min(), counts().max()) {
        (Some(least), Some(most)) if least == most => least.to_string(),
        (Some(least), Some(most)) => format!("{least} to {most}"),
        _ => format!("all {tests}"),
    }
}

/// Start values that nobody gave.
fn worked_out(found: &[f64]) -> String {
    let least = found.iter().copied().reduce(f64::min);
    match (least, found.iter().copied().reduce(f64::max)) {
        (Some(least), Some(most)) if least == most => format!("{}, from the data", plain(least, 3)),
        (Some(least), Some(most)) => format!("{} to {}, from the data", plain(least, 3), plain(most, 3)),
        _ => "not given".to_owned(),
    }
}

fn identified(phase: &CheckedPhase, levels: &[CheckedLevel]) -> Vec<String> {
    let mut sentences = doubts::unidentified(&phase.unidentified, &phase.states, false);
    if phase.states.is_empty() {
        sentences.push("No initial state is estimated, so there is nothing to identify.".to_owned());
    } else if phase.unidentified.is_empty() {
        let covariances = match (levels, levels.iter().all(|level| level.unidentified.is_empty())) {
            ([], _) => "the covariance",
            (_, true) => "the covariances of all levels and of the tests",
            (_, false) => "the tests' own covariance",
        };
        sentences.push(format!("The data identify all free elements of the mean and {covariances}."));
    } else if sentences.is_empty() {
        sentences.push("Not identified: combinations with states of other phases or levels; see below.".to_owned());
    }
    sentences
}

fn held_at_start(at_start_of: &[String]) -> Option<String> {
    let names: Vec<String> = at_start_of.iter().map(|name| clean(name)).collect();
    let (them, value) = if names.len() == 1 { ("its", "value") } else { ("their", "values") };
    (!names.is_empty()).then(|| format!("Computed with {} at {them} start {value}.", list(&names, MOST_NAMES)))
}
