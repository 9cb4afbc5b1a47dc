//! What `kalfit datasheet` made.

use kalfit::record::{CurveRecord, DatasheetRecord, EntryRecord, Interval};
use kalfit::time_unit::nanoseconds;

use crate::TextStyle;
use crate::number::plain;
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, sentence};

const DIGITS: usize = 4;

/// The numbers of a datasheet in words and tables. Every line fits `style.width` and ends with a line feed.
pub fn datasheet_summary(record: &DatasheetRecord, style: &TextStyle) -> String {
    let page = PageLayout::new(style);
    let mut sections = Vec::new();
    if !record.title.trim().is_empty() {
        sections.push(page.heading(&clean(&record.title)) + "\n");
    }
    let at: Vec<String> = record.at.iter().map(|at| clean(at)).collect();
    let at = if at.is_empty() { String::new() } else { format!(", where {}", at.join(", ")) };
    sections.push(page.paragraph(&format!("All values follow from {}{at}.", clean(&record.from))));
    let phases = record.entries.iter().any(|entry| entry.phase != kalfit::model::MAIN);
    let of = |entry: &EntryRecord| {
        let phase = if phases { format!("{}.", entry.phase) } else { String::new() };
        let at = entry.at.as_ref().map_or(String::new(), |at| format!(", {}", clean(at)));
        format!("{phase}{}{at}", entry.of)
    };
    sections.push(page.section("Datasheet", &page.table(&entries(&record.entries, &of))));
    let known = |known: &dyn Fn(&kalfit::record::AllanPoint) -> bool| {
        record.allan.iter().filter(|curve| curve.points.iter().any(known)).count()
    };
    if known(&|point| point.model.is_some() || point.data.is_some()) > 0 {
        for curve in record.allan.iter().filter(|curve| !curve.points.is_empty()) {
            let unit = curve.unit.as_ref().map_or(String::new(), |unit| format!(" in {}", clean(unit)));
            let name =
                if phases { format!("{}.{}", curve.phase, curve.measurement) } else { curve.measurement.clone() };
            let heading = format!("Allan deviation of {}{unit}", clean(&name));
            sections.push(page.section(&heading, &page.table(&points(curve, record.time_unit.as_deref()))));
        }
    }
    sections.push(page.section("Definitions", &page.items(&definitions(&record.entries))));
    sections.push(page.section("Notes", &page.items(&notes(record))));
    sections.retain(|section| !section.is_empty());
    sections.join("\n")
}

fn entries(entries: &[EntryRecord], of: &dyn Fn(&EntryRecord) -> String) -> Vec<TextColumn> {
    let column = |heading: &str, side: ColumnSide, cell: &dyn Fn(&EntryRecord) -> String| {
        TextColumn::new(heading, side, entries.iter().map(cell).collect())
    };
    vec![
        column("quantity", ColumnSide::Left, &|entry| entry.name.clone()),
        column("of", ColumnSide::Left, of),
        column("value", ColumnSide::Right, &|entry| match entry.value {
            Some(value) => plain(value, DIGITS),
            None if entry.varies_with == ["step"] => "needs a step".to_owned(),
            None if entry.varies_with.is_empty() => "unknown".to_owned(),
            None => format!("varies with {}", entry.varies_with.join(", ")),
        }),
        column("95 % interval", ColumnSide::Left, &|entry| interval(entry.interval95)),
        column("unit", ColumnSide::Left, &|entry| entry.unit.clone().unwrap_or_default()),
    ]
}

fn interval(interval: Interval) -> String {
    let end = |end: Option<f64>| end.map_or("?".to_owned(), |end| plain(end, DIGITS));
    interval.map_or(String::new(), |[low, high]| format!("{} to {}", end(low), end(high)))
}

fn points(curve: &CurveRecord, time: Option<&str>) -> Vec<TextColumn> {
    let of = |heading: &str, side: ColumnSide, cell: &dyn Fn(&kalfit::record::AllanPoint) -> String| {
        TextColumn::new(heading, side, curve.points.iter().map(cell).collect())
    };
    let figure = |x: Option<f64>| x.map_or(String::new(), |x| plain(x, DIGITS));
    let second = f64::from(1_000_000_000);
    // parts of a second are shown in seconds
    let (factor, time) = match time.and_then(nanoseconds) {
        Some(part) if (part as f64) < second => (part as f64 / second, Some("s")),
        _ => (1.0, time),
    };
    let heading = time.map_or("time".to_owned(), |time| format!("time, {}", clean(time)));
    vec![
        of(&heading, ColumnSide::Right, &|point| plain(factor * point.time, DIGITS)),
        of("values", ColumnSide::Right, &|point| point.values.to_string()),
        of("model", ColumnSide::Right, &|point| figure(point.model)),
        of("records", ColumnSide::Right, &|point| figure(point.data)),
        of("95 % interval", ColumnSide::Left, &|point| interval(point.interval95)),
    ]
}

/// Each once, in the order of the entries.
fn definitions(entries: &[EntryRecord]) -> Vec<String> {
    let mut all: Vec<(String, &str)> = Vec::new();
    for entry in entries {
        // spreads and means of all kinds mean the same
        let name = ["repeatability", "mean"].iter().find_map(|kind| entry.name.rfind(kind)).unwrap_or(0);
        let name = entry.name[name..].to_owned();
        if !all.iter().any(|(other, definition)| *other == name && *definition == entry.definition) {
            all.push((name, &entry.definition));
        }
    }
    all.iter().map(|(name, definition)| sentence(&format!("{}: {}", clean(name), clean(definition)))).collect()
}

fn notes(record: &DatasheetRecord) -> Vec<String> {
    let of = |curve: &CurveRecord, note: &String| format!("`{}`: {note}", curve.measurement);
    let curves = record.allan.iter().flat_map(|curve| curve.notes.iter().map(move |note| of(curve, note)));
    let all = curves.chain(record.notes.iter().cloned());
    all.map(|note| sentence(&clean(&note))).collect()
}
