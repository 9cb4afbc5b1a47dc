//! One cell of text, read as a number or found missing.

/// Texts that stand for a missing cell.
#[derive(Debug, Clone, Default)]
pub(crate) struct MissingTexts {
    texts: Vec<Vec<u8>>,
    /// Those of `texts` that are numbers: -99 also stands for -99.0 in a numeric column, whatever the format of the file.
    values: Vec<f64>,
}

/// Why a cell is not a finite number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CellFault {
    NotANumber,
    Infinite,
    NotUtf8,
}

impl MissingTexts {
    pub(crate) fn new(missing: &[String]) -> MissingTexts {
        let values = missing.iter().filter_map(|text| text.trim().parse().ok()).collect();
        MissingTexts { texts: missing.iter().map(|text| text.clone().into_bytes()).collect(), values }
    }

    /// True for a cell that stands for nothing.
    pub(crate) fn is_missing(&self, cell: &[u8]) -> bool {
        matches!(cell, b"" | b"NA" | b"NaN" | b"nan" | b"NAN" | b"null" | b"NULL" | b"Null")
            || self.texts.iter().any(|text| text == cell)
    }

    /// The number in a cell, spaces around it apart; NaN when it is missing.
    #[inline]
    pub(crate) fn number(&self, cell: &[u8]) -> Result<f64, CellFault> {
        match plain(cell).or_else(|| finite(cell)) {
            Some(value) => self.finite(value),
            None => self.unusual(cell),
        }
    }

    /// The same of a cell that is no number as it stands.
    fn unusual(&self, cell: &[u8]) -> Result<f64, CellFault> {
        let cell = cell.trim_ascii();
        if self.is_missing(cell) {
            return Ok(f64::NAN);
        }
        let fault = |_| std::str::from_utf8(cell).map_or(CellFault::NotUtf8, |_| CellFault::NotANumber);
        self.finite(lexical_core::parse(cell).map_err(fault)?)
    }

    /// A number that is already one: NaN when missing.
    pub(crate) fn finite(&self, value: f64) -> Result<f64, CellFault> {
        if value.is_infinite() {
            return Err(CellFault::Infinite);
        }
        // Equality is meant: the sentinel was written as this very number.
        Ok(if self.values.contains(&value) { f64::NAN } else { value })
    }
}

/// The powers of ten that a float holds exactly.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];

/// A decimal without exponent whose digits a float holds exactly, as most in tables are: one division then rounds it as
/// correctly as the library does (Clinger 1990). None for any other text.
fn plain(cell: &[u8]) -> Option<f64> {
    const MOST: usize = 16; // digits and a point: below 10^16 no digit overflows
    let (negative, digits) = match cell {
        [b'-', rest @ ..] => (true, rest),
        _ => (false, cell),
    };
    if digits.is_empty() || digits.len() > MOST {
        return None;
    }
    let (mut whole, mut point) = (0_u64, None);
    for (at, &byte) in digits.iter().enumerate() {
        match byte {
            b'0'..=b'9' => whole = 10 * whole + u64::from(byte - b'0'),
            b'.' if point.is_none() => point = Some(at),
            _ => return None,
        }
    }
    let fraction = point.map_or(0, |point| digits.len() - point - 1);
    if whole > 1 << 53 || (point.is_some() && digits.len() == 1) {
        return None;
    }
    let value = whole as f64 / POWERS[fraction];
    Some(if negative { -value } else { value })
}

/// Any other finite number without spaces around it, of many digits or with an exponent.
fn finite(cell: &[u8]) -> Option<f64> {
    lexical_core::parse(cell).ok().filter(|value: &f64| value.is_finite())
}

/// Text of a cell for a message: not too long, and without characters that could play tricks on a terminal.
pub(crate) fn shown(cell: &[u8]) -> String {
    const LONGEST: usize = 60;
    let text = String::from_utf8_lossy(&cell[..cell.len().min(4 * LONGEST)]);
    let mut short = String::new();
    for character in text.chars().take(LONGEST) {
        if character.is_control() || kalfit::record::directs_text(character) {
            short.extend(character.escape_default());
        } else {
            short.push(character);
        }
    }
    if text.chars().count() > LONGEST || cell.len() > 4 * LONGEST {
        short.push('…');
    }
    short
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn numbers_are_read_to_the_bit_as_by_the_standard_library(
            short in "-?[0-9]{0,17}[.]?[0-9]{0,17}", long in "[-+]?[0-9]{0,30}[.]?[0-9]{0,30}([eE][-+]?[0-9]{1,3})?",
            other in "[-+0-9.eEinf_x ]{0,8}", any in any::<f64>()
        ) {
            for text in [short, long, other, any.to_string(), format!("{any:e}")] {
                let expected = text.parse().ok().map(f64::to_bits);
                prop_assert_eq!(lexical_core::parse(text.as_bytes()).ok().map(f64::to_bits), expected, "{}", text);
                if let Some(value) = plain(text.as_bytes()) {
                    prop_assert_eq!(Some(value.to_bits()), expected, "{}", text);
                }
            }
        }
    }

    #[test]
    fn most_decimals_take_the_short_way() {
        for text in ["0", "-0", "5.", ".5", "-12.34567", "9007199254740992", "0.00000000000001", "123456789.123456"] {
            let value = plain(text.as_bytes()).unwrap_or_else(|| panic!("`{text}` is plain"));
            assert_eq!(value.to_bits(), text.parse::<f64>().unwrap().to_bits(), "{text}");
        }
        for text in ["", "-", ".", "-.", "+1", "1e3", " 1", "1_0", "9007199254740993", "12345678901234567", "1.2.3"] {
            assert_eq!(plain(text.as_bytes()), None, "{text}");
        }
    }

    #[test]
    fn spaces_around_numbers_and_tokens_do_not_count() {
        let tokens = MissingTexts::new(&["-99".into(), ".".into()]);
        assert_eq!(tokens.number(b" 1.5e3 "), Ok(1500.0));
        assert_eq!(tokens.number(b"+2"), Ok(2.0));
        for missing in ["", "  ", "NA", " NaN", "null ", ".", "-99", "-99.0", "-9.9e1"] {
            assert!(tokens.number(missing.as_bytes()).is_ok_and(f64::is_nan), "`{missing}` is missing");
        }
    }

    #[test]
    fn numbers_too_large_to_hold_are_infinite() {
        let tokens = MissingTexts::default();
        for text in ["inf", "-Infinity", "1e999"] {
            assert_eq!(tokens.number(text.as_bytes()), Err(CellFault::Infinite), "{text}");
        }
        assert_eq!(tokens.number(b"1,5"), Err(CellFault::NotANumber));
        assert_eq!(tokens.number(b"\xff"), Err(CellFault::NotUtf8));
    }
}
