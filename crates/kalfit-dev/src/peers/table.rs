//! Tables in Markdown, with figures of three digits.

/// Prints a row of a table.
pub(super) fn row(cells: &[String]) {
    println!("| {} |", cells.join(" | "));
}

/// Prints the head of a table: the first columns are words, the others figures.
pub(super) fn head(words: usize, columns: &[&str]) {
    row(&columns.iter().map(|&column| column.to_owned()).collect::<Vec<_>>());
    let align = |k: usize| if k < words { "---" } else { "--:" };
    println!("|{}|", (0..columns.len()).map(align).collect::<Vec<_>>().join("|"));
}

/// Seconds, milliseconds or microseconds.
pub(super) fn seconds(value: f64) -> String {
    match value {
        value if value >= 1.0 => format!("{} s", figure(value)),
        value if value >= 1e-3 => format!("{} ms", figure(value * 1e3)),
        _ => format!("{} µs", figure(value * 1e6)),
    }
}

/// Three digits; all of those before the point.
pub(super) fn figure(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let before = value.abs().log10().floor();
    if before < -3.0 {
        return format!("{value:.0e}");
    }
    let decimals = (2.0 - before).clamp(0.0, 6.0);
    format!("{value:.*}", decimals as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_three_digits_and_times_their_unit() {
        let shown = [0.0, 12_345.6, 123.4, 12.34, 1.234, 0.1234, 0.001_234, -4.4e-8].map(figure);
        assert_eq!(shown, ["0", "12346", "123", "12.3", "1.23", "0.123", "0.00123", "-4e-8"]);
        assert_eq!([2.5, 0.0025, 2.5e-6].map(seconds), ["2.50 s", "2.50 ms", "2.50 µs"]);
    }
}
