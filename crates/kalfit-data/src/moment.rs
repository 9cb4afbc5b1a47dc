//! Times of rows: numbers, or date-times in exact nanoseconds.

use std::fmt;

use jiff::civil::DateTime;
use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp};

/// The time of one row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Moment {
    /// A number in the model's unit.
    Number(f64),
    /// A whole number that a float does not hold, such as nanoseconds since 1970.
    Whole(i64),
    /// A date-time without an offset: nanoseconds since 1970-01-01T00:00 on the same clock.
    Civil(i128),
    /// A date-time with an offset: nanoseconds since 1970-01-01T00:00Z.
    Instant(i128),
}

/// Whole numbers up to this one are floats, exactly.
const EXACT: f64 = 9_007_199_254_740_992.0;

impl PartialOrd for Moment {
    fn partial_cmp(&self, other: &Moment) -> Option<std::cmp::Ordering> {
        match (*self, *other) {
            (Moment::Whole(a), Moment::Whole(b)) => Some(a.cmp(&b)),
            (Moment::Civil(a), Moment::Civil(b)) | (Moment::Instant(a), Moment::Instant(b)) => Some(a.cmp(&b)),
            (a, b) => a.number()?.partial_cmp(&b.number()?),
        }
    }
}

const EPOCH: DateTime = DateTime::constant(1970, 1, 1, 0, 0, 0, 0);

impl Moment {
    /// Reads an ISO 8601 or RFC 3339 date-time; a date alone is its midnight. None when the text is something else,
    /// or names a time zone in brackets, which an offset cannot replace.
    pub(crate) fn parse(text: &str) -> Option<Moment> {
        if text.len() > 64 || text.contains('[') {
            return None;
        }
        if let Ok(instant) = text.parse::<Timestamp>() {
            return Some(Moment::Instant(instant.as_nanosecond()));
        }
        let civil: DateTime = text.parse().ok()?;
        Some(Moment::Civil(civil.duration_since(EPOCH).as_nanos()))
    }

    /// The time in a cell that holds this number.
    pub(crate) fn of_number(value: f64, cell: &[u8]) -> Moment {
        let whole = || std::str::from_utf8(cell).ok()?.trim().parse().ok();
        if value.abs() <= EXACT { Moment::Number(value) } else { whole().map_or(Moment::Number(value), Moment::Whole) }
    }

    /// The nearest float to a number; `None` of a date-time.
    fn number(self) -> Option<f64> {
        match self {
            Moment::Number(value) => Some(value),
            Moment::Whole(value) => Some(value as f64),
            Moment::Civil(_) | Moment::Instant(_) => None,
        }
    }

    /// What it is, in words.
    pub(crate) fn kind(self) -> &'static str {
        match self {
            Moment::Number(_) | Moment::Whole(_) => "a number",
            Moment::Civil(_) => "a date-time without an offset",
            Moment::Instant(_) => "a date-time with an offset",
        }
    }

    /// True when both are numbers, or both date-times of the same kind.
    pub(crate) fn same_kind(self, other: Moment) -> bool {
        let numbers = self.number().is_some() && other.number().is_some();
        numbers || std::mem::discriminant(&self) == std::mem::discriminant(&other)
    }

    /// The number the core sees: the number itself, or the time since `first` in units of `unit` nanoseconds.
    pub(crate) fn value(self, first: Moment, unit: i128) -> f64 {
        match (self, first) {
            (Moment::Civil(now), Moment::Civil(first)) | (Moment::Instant(now), Moment::Instant(first)) => {
                let elapsed = now - first;
                (elapsed / unit) as f64 + (elapsed % unit) as f64 / unit as f64
            }
            _ => self.number().unwrap_or(f64::NAN), // moments of a column are of one kind
        }
    }
}

impl fmt::Display for Moment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let instant = |nanoseconds: i128| Timestamp::from_nanosecond(nanoseconds).ok();
        match *self {
            Moment::Number(value) => write!(f, "{value}"),
            Moment::Whole(value) => write!(f, "{value}"),
            Moment::Civil(ns) => match instant(ns) {
                Some(at) => write!(f, "{}", TimeZone::UTC.to_datetime(at)),
                None => write!(f, "1970-01-01 + {ns} ns"),
            },
            Moment::Instant(ns) => match instant(ns) {
                Some(at) => write!(f, "{at}"),
                None => write!(f, "1970-01-01Z + {ns} ns"),
            },
        }
    }
}

/// Text of a date given in days since 1970-01-01.
pub(crate) fn date_text(days: i64) -> String {
    match EPOCH.checked_add(SignedDuration::from_hours(days.saturating_mul(24).clamp(-100_000_000, 100_000_000))) {
        Ok(date) => date.date().to_string(),
        Err(_) => format!("1970-01-01 + {days} d"),
    }
}

/// Whether a time zone is an offset or has a name that the system knows; true of any name where the system knows none.
pub(crate) fn is_known_zone(zone: &str) -> bool {
    is_offset(zone) || TimeZone::get(zone).is_ok() || jiff::tz::db().is_definitively_empty()
}

/// `+01:00`, `-0530`, `+01`.
fn is_offset(zone: &str) -> bool {
    let Some(digits) = zone.strip_prefix(['+', '-']) else { return matches!(zone, "UTC" | "GMT" | "Z" | "z") };
    let plain = digits.replace(':', "");
    matches!(plain.len(), 2 | 4) && plain.bytes().all(|byte| byte.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zones_are_offsets_or_names() {
        for zone in ["UTC", "+01:00", "-0530", "+01"] {
            assert!(is_known_zone(zone), "{zone}");
        }
        assert!(!is_offset("Mars/Olympus") && !is_offset("+1:00") && !is_offset("+ab:cd"));
    }

    #[test]
    fn iso_texts_are_read_to_the_nanosecond() {
        assert_eq!(Moment::parse("1970-01-02"), Some(Moment::Civil(86_400_000_000_000)));
        assert_eq!(Moment::parse("1970-01-01 00:00:01.5"), Some(Moment::Civil(1_500_000_000)));
        assert_eq!(Moment::parse("1970-01-01T00:00:00.000000001Z"), Some(Moment::Instant(1)));
        assert_eq!(Moment::parse("1970-01-01T02:00:00+02:00"), Some(Moment::Instant(0)));
        assert_eq!(Moment::parse("1969-12-31 23:59:59Z"), Some(Moment::Instant(-1_000_000_000)));
        for other in ["", "12:30", "yesterday", "2024-13-01", "2024-01-01T00:00[Europe/Paris]", "01/02/2024"] {
            assert_eq!(Moment::parse(other), None, "{other}");
        }
    }

    #[test]
    fn whole_numbers_that_are_no_floats_are_compared_and_printed_as_they_stand() {
        let (one, next) = (b"1403643768757536499", b" 1403643768757536500 ");
        let [one, next] = [&one[..], &next[..]].map(|cell| Moment::of_number(1_403_643_768_757_536_500.0, cell));
        assert!(one < next && one.same_kind(Moment::Number(1.0)) && Moment::Number(1.0) < one);
        assert_eq!(one.to_string(), "1403643768757536499");
        assert_eq!(one.value(Moment::Number(1.0), 1), 1_403_643_768_757_536_512.0);
        assert_eq!(Moment::of_number(1e300, b"1e300"), Moment::Number(1e300));
        assert_eq!(Moment::of_number(12.0, b"12"), Moment::Number(12.0));
    }

    #[test]
    fn elapsed_time_is_exact_where_a_difference_of_floats_is_not() {
        let first = Moment::parse("2024-01-01T00:00:00.1Z").unwrap();
        let later = Moment::parse("2024-01-01T00:00:00.3Z").unwrap();
        assert_eq!(later.value(first, 1_000_000_000), 0.2);
        let year = Moment::parse("2025-01-01T00:00:00.1Z").unwrap();
        assert_eq!(year.value(first, 86_400_000_000_000), 366.0);
    }

    #[test]
    fn moments_print_as_iso_even_far_away() {
        assert_eq!(Moment::Civil(1_500_000_000).to_string(), "1970-01-01T00:00:01.5");
        assert_eq!(Moment::Instant(0).to_string(), "1970-01-01T00:00:00Z");
        assert_eq!(Moment::Civil(i128::MAX).to_string(), format!("1970-01-01 + {} ns", i128::MAX));
        assert_eq!(date_text(19_723), "2024-01-01");
        assert_eq!(date_text(i64::MAX), format!("1970-01-01 + {} d", i64::MAX));
    }
}
