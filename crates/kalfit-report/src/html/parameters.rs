//! Dynamic parameters.

use kalfit::FitRecord;
use kalfit::record::ParameterRecord;
use maud::{Markup, PreEscaped, html};

use crate::html::chart::PageCharts;
use crate::html::forest::{self, ForestGroup, ForestRow};
use crate::html::section::PageSection;
use crate::page::PageLayout;
use crate::summary::parameters::{self, ends_in_words, level};
use crate::summary::states::cells;
use crate::words::{clean, sentence};

/// Notes of parameters that are shown.
const MOST_NOTES: usize = 40;

pub(super) fn section(record: &FitRecord, charts: &mut PageCharts) -> Option<PageSection> {
    let page = PageLayout::html();
    let notes: Vec<String> = record.parameters.iter().filter_map(note).take(MOST_NOTES).collect();
    let body = html! {
        (PreEscaped(parameters::section(record, &page)))
        (PreEscaped(page.items(&notes)))
        (chart(record, charts).unwrap_or_default())
        (PreEscaped(parameters::methods(record, &page)))
    };
    PageSection::new("parameters", "Dynamic parameters", body)
}

fn note(row: &ParameterRecord) -> Option<String> {
    row.note.as_ref().map(|note| sentence(&format!("`{}` {}", clean(&name(row)), clean(note))))
}

fn name(row: &ParameterRecord) -> String {
    format!("{} {}", row.name, level(row)).trim_end().to_owned()
}

/// Free values, those of one unit together.
pub(crate) fn groups(record: &FitRecord) -> Vec<ForestGroup> {
    let mut groups: Vec<ForestGroup> = Vec::new();
    for row in record.parameters.iter().filter(|row| !row.fixed) {
        let label = match row.unit.as_ref().filter(|unit| !unit.is_empty()) {
            Some(unit) => format!("value [{}]", clean(unit)),
            None => "value".to_owned(),
        };
        let (shown, beside) = cells(row.estimate, row.std_error, false, &|| Some(""));
        let interval = row.interval95.map_or_else(String::new, |ends| ends_in_words(row.estimate, row.std_error, ends));
        let drawn = ForestRow {
            name: clean(&name(row)),
            estimate: row.estimate,
            ends: row.interval95,
            words: forest::words(&shown, &beside, &interval),
            reference: None,
        };
        match groups.iter_mut().find(|group| group.label == label) {
            Some(group) => group.rows.push(drawn),
            None => groups.push(ForestGroup { label, rows: vec![drawn] }),
        }
    }
    groups
}

/// Free values, those of one unit on one axis where that can be read.
fn chart(record: &FitRecord, charts: &mut PageCharts) -> Option<Markup> {
    let caption = "Free values with their 95 % intervals. Levels whose intervals do not overlap differ; an open mark has no \
                   interval: it is at a bound or not identified.";
    forest::forest("Dynamic parameters with 95 % intervals", caption, groups(record), charts)
}
