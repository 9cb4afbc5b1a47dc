//! A module of Python: plain arrays of numpy and lists of names.

use kalfit::record::{ExportRecord, directs_text};

use super::origin;

/// The module.
pub(super) fn module(record: &ExportRecord) -> String {
    let (n, m, k) = (record.states.len(), record.measurements.len(), record.inputs.len());
    let mut text = documentation(record) + "\nimport numpy as np\n\n";
    let step = record.step.map_or("None".to_owned(), |step| format!("{step:?}"));
    text += &format!("step = {step}\n");
    text += &format!("time_unit = {}\n", optional(&record.time_unit));
    let names = [("states", &record.states), ("measurements", &record.measurements), ("columns", &record.columns)];
    for (name, all) in names.into_iter().chain([("inputs", &record.inputs)]) {
        text += &format!("{name} = [{}]\n", all.iter().map(|one| literal(one)).collect::<Vec<_>>().join(", "));
    }
    for (name, all) in [("units", &record.units), ("where", &record.rows)] {
        text += &format!("{name} = [{}]\n", all.iter().map(optional).collect::<Vec<_>>().join(", "));
    }
    for (name, place) in [("x0_at", &record.x0_at), ("input_row", &record.input_row)] {
        text += &format!("{name} = {}\n", literal(place));
    }
    let matrices = [("F", &record.f, n), ("Q", &record.q, n), ("B", &record.b, k), ("H", &record.h, n)];
    for (name, rows, columns) in matrices.into_iter().chain([("D", &record.d, k), ("R", &record.r, m)]) {
        text += &format!("\n{name} = {}\n", matrix(rows, columns));
    }
    let x0 = record.x0.as_ref().map_or("None".to_owned(), |x0| format!("np.array([{}])", numbers(x0)));
    let p0 = record.p0.as_ref().map_or("None".to_owned(), |p0| matrix(p0, n));
    text + &format!("\nx0 = {x0}\n\nP0 = {p0}\n")
}

fn documentation(record: &ExportRecord) -> String {
    let title = if record.title.trim().is_empty() { "A Kalman filter" } else { record.title.trim() };
    let mut text = format!("{}\n\nWritten by kalfit {} from {}.\n\n", title, record.kalfit_version, origin(record));
    text += "    x = F @ x + B @ u + w,  w ~ N(0, Q)\n    z = H @ x + D @ u + v,  v ~ N(0, R)\n\n";
    text += &format!("x0 and P0 are mean and covariance of x of a new test at: {}.\n", record.x0_at);
    if record.input_row == "previous" {
        text += "A step takes u from the row before, a measurement from its own row.\n";
    }
    record.at.iter().for_each(|at| text += &format!("At {at}.\n"));
    record.notes.iter().for_each(|note| text += &format!("Note: {note}.\n"));
    let mut escaped = String::from("\"\"\"");
    for c in text.chars() {
        match c {
            '\\' | '"' => escaped.extend(['\\', c]),
            '\n' => escaped.push(c),
            c if c.is_control() => escaped.push(' '),
            c if directs_text(c) => escaped += &format!("\\u{:04x}", u32::from(c)),
            c => escaped.push(c),
        }
    }
    escaped + "\"\"\"\n"
}

fn matrix(rows: &[Vec<f64>], columns: usize) -> String {
    if columns == 0 {
        return format!("np.zeros(({}, 0))", rows.len());
    }
    let rows: Vec<String> = rows.iter().map(|row| format!("    [{}],\n", numbers(row))).collect();
    format!("np.array([\n{}])", rows.concat())
}

fn numbers(all: &[f64]) -> String {
    all.iter().map(|x| format!("{x:?}")).collect::<Vec<_>>().join(", ")
}

fn optional(text: &Option<String>) -> String {
    text.as_ref().map_or("None".to_owned(), |text| literal(text))
}

/// A text in quotes.
fn literal(text: &str) -> String {
    let mut quoted = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => quoted.extend(['\\', c]),
            c if c.is_control() || directs_text(c) => quoted += &format!("\\u{:04x}", u32::from(c)),
            c => quoted.push(c),
        }
    }
    quoted + "\""
}
