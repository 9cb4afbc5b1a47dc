//! One cell of text, read as a number or found missing.

/// Texts that stand for a missing cell.
#[derive(Debug, Clone, Default)]
pub(crate) struct Tokens {
    texts: Vec<Vec<u8>>,
    /// Those of `texts` that are numbers: -99 also stands for -99.0 in a numeric column, whatever the format of the file.
    values: Vec<f64>,
}

/// Why a cell is not a finite number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fault {
    NotANumber,
    Infinite,
    NotUtf8,
}

impl Tokens {
    pub(crate) fn new(missing: &[String]) -> Tokens {
        let values = missing.iter().filter_map(|text| text.trim().parse().ok()).collect();
        Tokens { texts: missing.iter().map(|text| text.clone().into_bytes()).collect(), values }
    }

    /// True for a cell that stands for nothing.
    pub(crate) fn is_missing(&self, cell: &[u8]) -> bool {
        matches!(cell, b"" | b"NA" | b"NaN" | b"nan" | b"NAN" | b"null" | b"NULL" | b"Null")
            || self.texts.iter().any(|text| text == cell)
    }

    /// The number in a cell, spaces around it apart; NaN when it is missing.
    pub(crate) fn number(&self, cell: &[u8]) -> Result<f64, Fault> {
        let cell = cell.trim_ascii();
        if self.is_missing(cell) {
            return Ok(f64::NAN);
        }
        let text = std::str::from_utf8(cell).map_err(|_| Fault::NotUtf8)?;
        self.finite(text.parse().map_err(|_| Fault::NotANumber)?)
    }

    /// A number that is already one: NaN when missing.
    pub(crate) fn finite(&self, value: f64) -> Result<f64, Fault> {
        if value.is_infinite() {
            return Err(Fault::Infinite);
        }
        // Equality is meant: the sentinel was written as this very number.
        Ok(if self.values.contains(&value) { f64::NAN } else { value })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spaces_around_numbers_and_tokens_do_not_count() {
        let tokens = Tokens::new(&["-99".into(), ".".into()]);
        assert_eq!(tokens.number(b" 1.5e3 "), Ok(1500.0));
        assert_eq!(tokens.number(b"+2"), Ok(2.0));
        for missing in ["", "  ", "NA", " NaN", "null ", ".", "-99", "-99.0", "-9.9e1"] {
            assert!(tokens.number(missing.as_bytes()).is_ok_and(f64::is_nan), "`{missing}` is missing");
        }
    }

    #[test]
    fn numbers_too_large_to_hold_are_infinite() {
        let tokens = Tokens::default();
        for text in ["inf", "-Infinity", "1e999"] {
            assert_eq!(tokens.number(text.as_bytes()), Err(Fault::Infinite), "{text}");
        }
        assert_eq!(tokens.number(b"1,5"), Err(Fault::NotANumber));
        assert_eq!(tokens.number(b"\xff"), Err(Fault::NotUtf8));
    }
}
