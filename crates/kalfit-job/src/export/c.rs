//! A header for C and C++: sizes, matrices row after row, names.

use std::fmt::Write;

use kalfit::record::{ExportRecord, plain_text};

use super::origin;

/// The header; names in it begin with that of the file.
pub(super) fn header(record: &ExportRecord, file: &str) -> String {
    let prefix = identifier(file);
    let upper = prefix.to_uppercase();
    let (n, m, k) = (record.states.len(), record.measurements.len(), record.inputs.len());
    let mut text = comment(record, &prefix);
    let guard = guard(file, &prefix);
    text += &format!("\n#ifndef {guard}\n#define {guard}\n\n");
    for (what, size) in [("STATES", n), ("MEASUREMENTS", m), ("INPUTS", k)] {
        text += &format!("#define {upper}_{what} {size}\n");
    }
    if let Some(step) = record.step {
        text += &format!("#define {upper}_STEP {step:?}\n");
    }
    let mut matrix = |name: &str, rows: &[Vec<f64>], shape: [&str; 2]| {
        if rows.iter().all(Vec::is_empty) {
            return; // C has no arrays of nothing
        }
        let [a, b] = shape.map(|size| format!("{upper}_{size}"));
        let rows: Vec<String> = rows.iter().map(|row| format!("    {}", numbers(row))).collect();
        text += &format!("\nstatic const double {prefix}_{name}[{a} * {b}] = {{\n{}\n}};\n", rows.join(",\n"));
    };
    matrix("F", &record.f, ["STATES", "STATES"]);
    matrix("Q", &record.q, ["STATES", "STATES"]);
    matrix("B", &record.b, ["STATES", "INPUTS"]);
    matrix("H", &record.h, ["MEASUREMENTS", "STATES"]);
    matrix("D", &record.d, ["MEASUREMENTS", "INPUTS"]);
    matrix("R", &record.r, ["MEASUREMENTS", "MEASUREMENTS"]);
    if let Some(p0) = &record.p0 {
        matrix("P0", p0, ["STATES", "STATES"]);
    }
    if let Some(x0) = &record.x0 {
        text += &format!("\nstatic const double {prefix}_x0[{upper}_STATES] = {{{}}};\n", numbers(x0));
    }
    let names = [
        ("states", "STATES", &record.states),
        ("measurements", "MEASUREMENTS", &record.measurements),
        ("inputs", "INPUTS", &record.inputs),
    ];
    for (name, size, all) in names.into_iter().filter(|(.., all)| !all.is_empty()) {
        let all: Vec<String> = all.iter().map(|text| literal(text)).collect();
        text += &format!("\nstatic const char *const {prefix}_{name}[{upper}_{size}] = {{{}}};\n", all.join(", "));
    }
    text + "\n#endif\n"
}

fn comment(record: &ExportRecord, prefix: &str) -> String {
    let mut lines = vec![match record.title.trim() {
        "" => "A Kalman filter".to_owned(),
        title => title.to_owned(),
    }];
    lines.push(format!("Written by kalfit {} from {}, phase {}.", record.kalfit_version, origin(record), record.phase));
    if let Some(step) = record.step {
        lines.push(format!("Step: {step:?} {}", record.time_unit.as_deref().unwrap_or("")));
    }
    lines.extend(record.at.iter().map(|at| format!("At {at}")));
    lines.push(String::new());
    lines.push(format!("  x = {prefix}_F x + {prefix}_B u + w,  w ~ N(0, {prefix}_Q)"));
    lines.push(format!("  z = {prefix}_H x + {prefix}_D u + v,  v ~ N(0, {prefix}_R)"));
    lines.push(format!("  {prefix}_x0, {prefix}_P0: mean and covariance of x of a new test at: {}", record.x0_at));
    lines.push(
        "Matrices stand row after row. A matrix of nothing, and a start that there is not, are left out.".to_owned(),
    );
    if record.input_row == "previous" {
        lines.push("A step takes u from the row before, a measurement from its own row.".to_owned());
    }
    lines.push(String::new());
    for (i, (state, unit)) in record.states.iter().zip(&record.units).enumerate() {
        let unit = unit.as_ref().map_or(String::new(), |unit| format!(" [{unit}]"));
        lines.push(format!("x[{i}]: {state}{unit}"));
    }
    for (i, ((name, column), rows)) in record.measurements.iter().zip(&record.columns).zip(&record.rows).enumerate() {
        let rows = rows.as_ref().map_or(String::new(), |rows| format!(", rows where {rows}"));
        lines.push(format!("z[{i}]: {name}, column {column}{rows}"));
    }
    lines.extend(record.inputs.iter().enumerate().map(|(i, input)| format!("u[{i}]: {input}")));
    lines.extend(record.notes.iter().map(|note| format!("Note: {note}")));
    let mut text = String::from("/*\n");
    for line in lines {
        let _ = writeln!(text, "{}", format!(" * {}", commented(&line)).trim_end());
    }
    text + " */\n"
}

/// A line as a comment may have it: it neither begins nor ends a comment, and has no trigraph.
fn commented(line: &str) -> String {
    let line = plain_text(line);
    let mut safe = String::with_capacity(line.len());
    for c in line.chars() {
        if matches!((safe.chars().last(), c), (Some('/'), '*') | (Some('*'), '/') | (Some('?'), '?')) {
            safe.push(' ');
        }
        safe.push(c);
    }
    safe.trim_end_matches(['\\', ' ']).to_owned()
}

fn numbers(all: &[f64]) -> String {
    all.iter().map(|x| format!("{x:?}")).collect::<Vec<_>>().join(", ")
}

/// A name that C allows, from that of a file.
fn identifier(file: &str) -> String {
    let letters: String =
        file.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '_' }).collect();
    match letters.chars().next() {
        Some(first) if first.is_ascii_alphabetic() => letters,
        _ => format!("filter_{}", letters.trim_start_matches('_')).trim_end_matches('_').to_owned(),
    }
}

/// The include guard; where the name of the file is not what C calls it, the file has a number of its own.
fn guard(file: &str, prefix: &str) -> String {
    let upper = prefix.to_uppercase();
    if file == prefix {
        return format!("KALFIT_{upper}_H");
    }
    // FNV-1a, which any reader can check
    let hash = file.bytes().fold(0x811c_9dc5u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    format!("KALFIT_{upper}_{hash:08X}_H")
}

/// A text in quotes; bytes beyond ASCII, and question marks, which may begin trigraphs, are escaped.
fn literal(text: &str) -> String {
    let mut quoted = String::from("\"");
    for byte in text.bytes() {
        match byte {
            b'"' | b'\\' | b'?' => quoted.extend(['\\', char::from(byte)]),
            b' '..=b'~' => quoted.push(char::from(byte)),
            _ => quoted += &format!("\\{byte:03o}"),
        }
    }
    quoted + "\""
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_texts_are_those_of_c() {
        assert_eq!(identifier("Gyro bench-2"), "gyro_bench_2");
        assert_eq!(guard("a_b", "a_b"), "KALFIT_A_B_H");
        assert!(guard("a-b", "a_b") != guard("a_b", "a_b") && guard("a-b", "a_b") != guard("A_B", "a_b"));
        assert_eq!(commented("Runs of runs/*.csv */ ??/ \\"), "Runs of runs/ *.csv * / ? ?/");
        assert_eq!(identifier("3axis"), "filter_3axis");
        assert_eq!(identifier("µ"), "filter");
        assert_eq!(literal("a \"b\" \\ ??/ µ"), r#""a \"b\" \\ \?\?/ \302\265""#);
    }
}
