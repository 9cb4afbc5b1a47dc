//! A source file with switches: each change becomes a choice between the old text and the new, made when the program runs.

use std::ops::Range;

use super::find::{Replacement, SourceChange};

/// Where a switch stands in the text that holds it.
pub(super) struct MutantSwitch {
    pub(super) mutant: usize,
    pub(super) range: Range<usize>,
}

/// The text with a switch for each change; the changes must not overlap.
pub(super) fn rewritten(source: &str, changes: &[(usize, &SourceChange)]) -> (String, Vec<MutantSwitch>) {
    let mut edits: Vec<_> =
        changes.iter().flat_map(|(mutant, change)| change.edits.iter().map(|edit| (*mutant, edit))).collect();
    edits.sort_by_key(|(_, (range, _))| range.start);
    let (mut text, mut switches, mut from) = (String::new(), Vec::new(), 0);
    for (mutant, (range, other)) in edits {
        text.push_str(&source[from..range.start]);
        let start = text.len();
        let old = &source[range.clone()];
        match other {
            Replacement::Value(new) => {
                text.push_str(&format!("(if crate::mutant::on({mutant}) {{ {new} }} else {{ {old} }})"));
            }
            Replacement::Nothing => text.push_str(&format!("if !crate::mutant::on({mutant}) {{ {old} }}")),
        }
        switches.push(MutantSwitch { mutant, range: start..text.len() });
        from = range.end;
    }
    text.push_str(&source[from..]);
    (text, switches)
}

/// Whether two changes of one file share bytes.
pub(super) fn overlap(a: &SourceChange, b: &SourceChange) -> bool {
    a.edits.iter().any(|(one, _)| b.edits.iter().any(|(other, _)| one.start < other.end && other.start < one.end))
}

#[cfg(test)]
mod tests {
    use super::super::find::changes;
    use super::*;

    const SOURCE: &str = r#"
const FLOOR: f64 = 1e-9;
const STEPS: usize = 40;

/// Größe − and other letters of two bytes.
fn norm(x: &[f64], y: f64) -> f64 {
    let (mut sum, mut seen) = (0.0, Vec::with_capacity(7));
    for k in 0..x.len() {
        if x[k + 1] > 0.0 && !x.is_empty() {
            sum += x[k] * y;
        }
        seen.push(sum);
    }
    match STEPS {
        3 if sum > FLOOR => -sum,
        _ => sum.abs().max(FLOOR),
    }
}

#[cfg(test)]
mod tests {
    fn not_here() -> f64 { 1.0 + 2.0 }
}
"#;

    /// All changes of a file by their words; each is applied by itself, and what then stands in the file is a program again.
    #[test]
    fn every_change_is_found_and_leaves_a_program() {
        let found = changes(SOURCE).expect("it is a program");
        let said: Vec<&str> = found.iter().map(|change| change.what.as_str()).collect();
        let expected = [
            "`0.0` → `1.0`",
            "`0` → `1`",
            "`x[k + 1] > 0.0 && !x.is_empty()` → `true`",
            "`x[k + 1] > 0.0 && !x.is_empty()` → `false`",
            "`x[k + 1] > 0.0 && !x.is_empty()` → `x[k + 1] > 0.0 || !x.is_empty()`",
            "`x[k + 1] > 0.0` → `x[k + 1] <= 0.0`",
            "`x[k + 1] > 0.0` → `x[k + 1] >= 0.0`",
            "`0.0` → `1.0`",
            "`!x.is_empty()` → `x.is_empty()`",
            "`sum += x[k] * y` → `sum -= x[k] * y`",
            "`x[k] * y` → `x[k] / y`",
            "`seen.push(sum);` left out",
            "`sum > FLOOR` → `sum <= FLOOR`",
            "`-sum` → `sum`",
            "`sum.abs().max(FLOOR)` → `sum.abs().min(FLOOR)`",
            "`sum.abs()` → `sum`",
            "`FLOOR` → `(FLOOR * 1000.0)`",
            "`STEPS` → `1`",
        ];
        assert_eq!(said, expected);
        for (mutant, change) in found.iter().enumerate() {
            let (text, switches) = rewritten(SOURCE, &[(mutant, change)]);
            assert!(syn::parse_file(&text).is_ok(), "{}:\n{text}", change.what);
            for switch in switches {
                let part = &text[switch.range];
                assert!(part.contains(&format!("crate::mutant::on({mutant})")), "{part}");
            }
        }
    }

    #[test]
    fn several_changes_stand_side_by_side() {
        let found = changes(SOURCE).expect("it is a program");
        let of = |what: &str| found.iter().position(|change| change.what == what).expect("it is among them");
        let (product, minus, floor) =
            (of("`x[k] * y` → `x[k] / y`"), of("`-sum` → `sum`"), of("`FLOOR` → `(FLOOR * 1000.0)`"));
        let chosen: Vec<(usize, &SourceChange)> = [product, minus, floor].map(|k| (k, &found[k])).to_vec();
        let (text, switches) = rewritten(SOURCE, &chosen);
        assert!(
            text.contains(&format!("sum += (if crate::mutant::on({product}) {{ x[k] / y }} else {{ x[k] * y }});"))
        );
        assert_eq!(switches.len(), 4, "one constant is used twice:\n{text}");
        assert!(overlap(&found[of("`sum += x[k] * y` → `sum -= x[k] * y`")], &found[product]));
        assert!(!overlap(&found[minus], &found[product]));
    }
}
