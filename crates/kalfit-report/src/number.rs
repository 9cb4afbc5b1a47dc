//! Numbers for people: as many digits as the standard error allows, never a NaN.

pub(crate) use kalfit::record::plain;

/// What stands for a figure that is not known.
const UNKNOWN: &str = "unknown";

/// Digits of a standard error that mean anything.
const ERROR_DIGITS: usize = 2;
/// No more digits than this of a value, however small its standard error.
const MOST_DIGITS: i32 = 10;
/// Digits of a value without a standard error.
pub(crate) const DIGITS: usize = 6;
/// From here up, and below its lower companion, exponents are easier to read than zeros.
const LARGE: f64 = 1e7;
const SMALL: f64 = 1e-4;

/// How to write a figure and all that stands beside it, so that their last digits agree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum FigurePrecision {
    /// This many digits after the point.
    Decimals(usize),
    /// With an exponent; the last digit stands for this power of ten.
    Exponent(i32),
    /// By significant digits, for want of a standard error.
    Significant(usize),
}

impl FigurePrecision {
    /// Two digits of the standard error govern the digits of the estimate.
    pub(crate) fn of(estimate: f64, std_error: Option<f64>) -> FigurePrecision {
        let Some(error) = std_error.filter(|e| e.is_finite() && *e > 0.0) else {
            return FigurePrecision::Significant(DIGITS);
        };
        let size = estimate.abs().max(error);
        let last = power(error, ERROR_DIGITS) + 1 - ERROR_DIGITS as i32;
        let last = if estimate == 0.0 { last } else { last.max(power(estimate, ERROR_DIGITS) + 1 - MOST_DIGITS) };
        if (SMALL..LARGE).contains(&size) {
            FigurePrecision::Decimals(usize::try_from(-last).unwrap_or(0))
        } else {
            FigurePrecision::Exponent(last)
        }
    }

    /// The figure, or `unknown`.
    pub(crate) fn show(self, x: f64) -> String {
        if !x.is_finite() {
            return UNKNOWN.to_owned();
        }
        match self {
            FigurePrecision::Significant(digits) => plain(x, digits),
            FigurePrecision::Decimals(decimals) => unsigned_zero(format!("{x:.decimals$}")),
            FigurePrecision::Exponent(_) if x == 0.0 => "0".to_owned(),
            FigurePrecision::Exponent(last) => {
                let digits = usize::try_from(power(x, 1) - last).unwrap_or(0);
                format!("{x:.digits$e}")
            }
        }
    }

    /// The standard error itself: as the figure, unless that would show no digit of it.
    pub(crate) fn show_error(self, error: f64) -> String {
        let shown = self.show(error);
        if error > 0.0 && error.is_finite() && shown.bytes().all(|b| matches!(b, b'0' | b'.')) {
            format!("{error:.1e}")
        } else {
            shown
        }
    }
}

/// A log-likelihood, AIC or BIC: differences of a hundredth are the smallest that matter.
pub(crate) fn hundredths(x: f64) -> String {
    if x.abs() >= 1e12 { plain(x, 12) } else { FigurePrecision::Decimals(2).show(x) }
}

/// A probability.
pub(crate) fn probability(p: f64) -> String {
    match p {
        p if !p.is_finite() => UNKNOWN.to_owned(),
        p if p < 1e-10 => "< 1e-10".to_owned(),
        p if p < 1e-4 => format!("{p:.0e}"),
        p if p < 0.01 => plain(p, 1),
        p if p > 0.995 => "1".to_owned(),
        p => FigurePrecision::Decimals(2).show(p),
    }
}

/// `p = 0.03`, `p < 1e-10`.
pub(crate) fn p_value(p: f64) -> String {
    let shown = probability(p);
    if shown.starts_with('<') { format!("p {shown}") } else { format!("p = {shown}") }
}

/// A duration in words, two digits: `500 ms`, `4.2 min`.
pub fn seconds(seconds: f64) -> String {
    match seconds {
        s if !s.is_finite() => format!("{UNKNOWN} time"),
        s if s < 0.001 => "less than 1 ms".to_owned(),
        s if s < 1.0 => format!("{:.0} ms", 1e3 * s),
        s if s < 120.0 => format!("{} s", plain(s, 2)),
        s => format!("{} min", plain(s / 60.0, 2)),
    }
}

/// Power of ten of the first digit, once rounded to this many digits.
fn power(x: f64, digits: usize) -> i32 {
    let shown = format!("{x:.*e}", digits.saturating_sub(1));
    shown.split_once('e').and_then(|(_, e)| e.parse().ok()).unwrap_or(0)
}

/// `-0.00` is zero.
fn unsigned_zero(number: String) -> String {
    match number.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|b| matches!(b, b'0' | b'.')) => rest.to_owned(),
        _ => number,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn both(estimate: f64, error: f64) -> String {
        let precision = FigurePrecision::of(estimate, Some(error));
        format!("{} ± {}", precision.show(estimate), precision.show_error(error))
    }

    #[test]
    fn two_digits_of_the_standard_error_govern() {
        for (estimate, error, expected) in [
            (251.405, 6.632, "251.4 ± 6.6"),
            (10.4673, 1.5022, "10.5 ± 1.5"),
            (0.344839, 0.0536, "0.345 ± 0.054"),
            (1.0, 0.0996, "1.00 ± 0.10"),
            (-0.0004, 0.3, "0.00 ± 0.30"),
            (12345.6, 1234.5, "12346 ± 1234"),
            (0.0, 0.25, "0.00 ± 0.25"),
            (1.23456e-6, 1.2e-8, "1.235e-6 ± 1.2e-8"),
            (3.0e9, 2.0e7, "3.000e9 ± 2.0e7"),
            (1e-12, 1e-6, "1e-12 ± 1.0e-6"),
            (100.0, 1e-12, "100.0000000 ± 1.0e-12"),
            (0.00012, 0.000034, "0.000120 ± 0.000034"),
        ] {
            assert_eq!(both(estimate, error), expected, "{estimate} with standard error {error}");
        }
    }

    #[test]
    fn without_a_standard_error_six_digits_and_no_idle_zeros() {
        for (x, expected) in [
            (20.0, "20"),
            (0.003, "0.003"),
            (2.0 / 3.0, "0.666667"),
            (-1.5, "-1.5"),
            (123456789.0, "1.23457e8"),
            (9999999.6, "10000000"),
            (1e-9, "1e-9"),
            (0.0, "0"),
            (-0.0, "0"),
        ] {
            assert_eq!(plain(x, DIGITS), expected, "{x}");
            assert_eq!(FigurePrecision::of(x, None).show(x), expected, "{x} by precision");
        }
    }

    #[test]
    fn no_figure_is_ever_shown_as_nan_or_infinite() {
        for x in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for shown in
                [plain(x, 3), hundredths(x), probability(x), seconds(x), both(x, 1.0), both(1.0, x), both(x, x)]
            {
                let shown = shown.to_lowercase();
                assert!(!shown.contains("nan") && !shown.contains("inf"), "{x} is shown as {shown}");
            }
        }
    }

    #[test]
    fn extremes_of_the_number_range_stay_short() {
        for x in [f64::MAX, f64::MIN_POSITIVE, 5e-324, -f64::MAX] {
            for e in [f64::MAX, f64::MIN_POSITIVE, 5e-324, 1.0] {
                let shown = both(x, e);
                assert!(shown.len() < 60, "{x:e} with standard error {e:e} is shown as {shown}");
            }
            assert!(plain(x, DIGITS).len() < 16, "{}", plain(x, DIGITS));
        }
    }

    #[test]
    fn probabilities_keep_what_matters() {
        for (p, expected) in
            [(0.0, "< 1e-10"), (3e-7, "3e-7"), (0.00312, "0.003"), (0.0478, "0.05"), (0.5, "0.50"), (1.0, "1")]
        {
            assert_eq!(probability(p), expected, "{p}");
        }
    }
}
