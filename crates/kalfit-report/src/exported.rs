//! What `kalfit export` made.

use kalfit::record::ExportRecord;

use crate::TextStyle;
use crate::number::plain;
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, count, sentence};

/// A filter in words and tables. Every line fits `style.width` and ends with a line feed.
pub fn exported_summary(record: &ExportRecord, style: &TextStyle) -> String {
    let page = PageLayout::new(style);
    let mut sections = Vec::new();
    if !record.title.trim().is_empty() {
        sections.push(page.heading(&clean(&record.title)) + "\n");
    }
    sections.push(page.paragraph(&facts(record)));
    sections.push(page.section("States of a new test", &page.table(&states(record))));
    sections.push(page.section("Measurements", &page.table(&measurements(record))));
    if !record.inputs.is_empty() {
        sections.push(page.section("Inputs", &page.table(&inputs(record))));
    }
    sections.push(page.section("How to use it", &page.items(&notes(record))));
    sections.join("\n")
}

fn facts(record: &ExportRecord) -> String {
    let step = match (record.step, &record.time_unit) {
        (None, _) => "from row to row".to_owned(),
        (Some(step), unit) => {
            let unit = unit.as_ref().map_or(String::new(), |unit| format!(" {}", clean(unit)));
            format!("at a step of {}{unit}", plain(step, 6))
        }
    };
    let phase = if record.phase == kalfit::model::MAIN {
        String::new()
    } else {
        format!(" of phase `{}`", clean(&record.phase))
    };
    let at = match record.at.is_empty() {
        true => String::new(),
        false => format!(", where {}", record.at.iter().map(|at| clean(at)).collect::<Vec<_>>().join(", ")),
    };
    let but = match record.changed.is_empty() {
        true => String::new(),
        false => format!(" but {}", record.changed.iter().map(|name| clean(name)).collect::<Vec<_>>().join(", ")),
    };
    format!(
        "The filter{phase} {step}{at}, all parameters as in {}{but}: {}, {} and {}.",
        clean(&record.from),
        count(record.states.len(), "state"),
        count(record.measurements.len(), "measurement"),
        count(record.inputs.len(), "input")
    )
}

fn states(record: &ExportRecord) -> Vec<TextColumn> {
    let n = record.states.len();
    let column = |heading: &str, side: ColumnSide, cell: &dyn Fn(usize) -> String| {
        TextColumn::new(heading, side, (0..n).map(cell).collect())
    };
    let mut columns = vec![column("state", ColumnSide::Left, &|i| clean(&record.states[i]))];
    if record.units.iter().any(Option::is_some) {
        columns.push(column("unit", ColumnSide::Left, &|i| clean(record.units[i].as_deref().unwrap_or(""))));
    }
    if let (Some(x0), Some(p0)) = (&record.x0, &record.p0) {
        columns.push(column("x0", ColumnSide::Right, &|i| plain(x0[i], 5)));
        columns.push(column("std. dev.", ColumnSide::Right, &|i| plain(p0[i][i].max(0.0).sqrt(), 5)));
    }
    columns.push(column("of a step", ColumnSide::Right, &|i| plain(record.q[i][i].max(0.0).sqrt(), 5)));
    columns
}

fn measurements(record: &ExportRecord) -> Vec<TextColumn> {
    let column = |heading: &str, side: ColumnSide, cell: &dyn Fn(usize) -> String| {
        TextColumn::new(heading, side, (0..record.measurements.len()).map(cell).collect())
    };
    let mut columns = vec![
        column("measurement", ColumnSide::Left, &|i| clean(&record.measurements[i])),
        column("column", ColumnSide::Left, &|i| clean(&record.columns[i])),
        column("noise", ColumnSide::Right, &|i| plain(record.r[i][i].max(0.0).sqrt(), 5)),
    ];
    if record.rows.iter().any(Option::is_some) {
        columns.push(column("rows where", ColumnSide::Left, &|i| clean(record.rows[i].as_deref().unwrap_or("all"))));
    }
    columns
}

fn inputs(record: &ExportRecord) -> Vec<TextColumn> {
    let reached = |matrix: &[Vec<f64>], names: &[String], input: usize| {
        let own = matrix.iter().zip(names).filter(|(row, _)| row[input] != 0.0);
        own.map(|(_, name)| clean(name)).collect::<Vec<_>>()
    };
    let of = |input: usize| {
        [reached(&record.b, &record.states, input), reached(&record.d, &record.measurements, input)].concat().join(", ")
    };
    vec![
        TextColumn::new("input", ColumnSide::Left, record.inputs.iter().map(|input| clean(input)).collect()),
        TextColumn::new("goes to", ColumnSide::Left, (0..record.inputs.len()).map(of).collect()),
    ]
}

fn notes(record: &ExportRecord) -> Vec<String> {
    let mut notes =
        vec!["x = F x + B u + w with w ~ N(0, Q) from step to step; z = H x + D u + v with v ~ N(0, R).".to_owned()];
    let mut start = format!("x0 is at: {}.", clean(&record.x0_at));
    if record.x0.is_none() {
        start.clear();
    }
    if !record.inputs.is_empty() {
        start += match record.input_row.as_str() {
            "previous" => " A step takes u from the row that it leaves, a measurement from its own.",
            _ => " A step takes u from the row that it leads to, a measurement from its own.",
        };
    }
    notes.push(start.trim().to_owned());
    notes.retain(|note| !note.is_empty());
    notes.extend(record.notes.iter().map(|note| sentence(&clean(note))));
    notes
}
