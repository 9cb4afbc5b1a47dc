//! Units of time that convert.

const SECOND: i128 = 1_000_000_000;

/// Nanoseconds in a unit of time, by its symbol or its English name; `None` when it is not one of fixed length.
pub fn nanoseconds(unit: &str) -> Option<i128> {
    let unit = unit.trim();
    let name = if unit.chars().count() > 2 { unit.to_lowercase() } else { unit.to_owned() };
    Some(match name.as_str() {
        "ns" | "nanosecond" | "nanoseconds" => 1,
        "us" | "µs" | "μs" | "usec" | "microsecond" | "microseconds" => 1_000,
        "ms" | "msec" | "millisecond" | "milliseconds" => 1_000_000,
        "s" | "sec" | "secs" | "second" | "seconds" => SECOND,
        "min" | "mins" | "minute" | "minutes" => 60 * SECOND,
        "h" | "hr" | "hrs" | "hour" | "hours" => 3_600 * SECOND,
        "d" | "day" | "days" => 86_400 * SECOND,
        "week" | "weeks" => 7 * 86_400 * SECOND,
        _ => return None,
    })
}

/// Hours in a unit of time, as [`nanoseconds`].
pub fn hours(unit: &str) -> Option<f64> {
    let hour = 3_600 * SECOND;
    nanoseconds(unit).map(|unit| if unit >= hour { (unit / hour) as f64 } else { 1.0 / (hour / unit) as f64 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_known_by_symbol_and_name() {
        for (unit, expected) in [("ms", 1_000_000), (" s ", 1_000_000_000), ("Hours", 3_600_000_000_000)] {
            assert_eq!(nanoseconds(unit), Some(expected), "{unit}");
        }
        for unit in ["m", "month", "", "S", "fortnight"] {
            assert_eq!(nanoseconds(unit), None, "{unit}");
        }
        assert_eq!([hours("d"), hours("min"), hours("month")], [Some(24.0), Some(1.0 / 60.0), None]);
    }
}
