//! A filter as named values, for files that hold such.

use kalfit::record::ExportRecord;

/// One value.
#[derive(Debug)]
pub(super) enum FieldValue<'a> {
    Number(f64),
    Text(&'a str),
    Texts(Vec<&'a str>),
    Vector(&'a [f64]),
    /// Rows, columns and their values, row after row.
    Matrix(usize, usize, Vec<f64>),
}

/// All values with the names that they have in JSON. What is not there has none; a step that is not known is no number.
pub(super) fn fields(record: &ExportRecord) -> Vec<(&'static str, FieldValue<'_>)> {
    let (n, m, k) = (record.states.len(), record.measurements.len(), record.inputs.len());
    let matrix = |columns: usize, rows: &[Vec<f64>]| FieldValue::Matrix(rows.len(), columns, rows.concat());
    let mut all = vec![
        ("title", FieldValue::Text(&record.title)),
        ("phase", FieldValue::Text(&record.phase)),
        ("step", FieldValue::Number(record.step.unwrap_or(f64::NAN))),
        ("time_unit", FieldValue::Text(record.time_unit.as_deref().unwrap_or(""))),
        ("states", texts(&record.states)),
        ("units", optional(&record.units)),
        ("measurements", texts(&record.measurements)),
        ("columns", texts(&record.columns)),
        ("where", optional(&record.rows)),
        ("inputs", texts(&record.inputs)),
        ("F", matrix(n, &record.f)),
        ("Q", matrix(n, &record.q)),
        ("B", matrix(k, &record.b)),
        ("H", matrix(n, &record.h)),
        ("D", matrix(k, &record.d)),
        ("R", matrix(m, &record.r)),
        ("x0_at", FieldValue::Text(&record.x0_at)),
        ("input_row", FieldValue::Text(&record.input_row)),
    ];
    if let (Some(x0), Some(p0)) = (&record.x0, &record.p0) {
        all.extend([("x0", FieldValue::Vector(x0)), ("P0", matrix(n, p0))]);
    }
    all
}

fn texts(all: &[String]) -> FieldValue<'_> {
    FieldValue::Texts(all.iter().map(String::as_str).collect())
}

/// Nothing is an empty text.
fn optional(all: &[Option<String>]) -> FieldValue<'_> {
    FieldValue::Texts(all.iter().map(|one| one.as_deref().unwrap_or("")).collect())
}
