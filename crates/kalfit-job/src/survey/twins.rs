//! Rows that stand twice.

use std::collections::{HashMap, HashSet};
use std::hash::{DefaultHasher, Hash, Hasher};

use kalfit::{Label, Model};

/// A test of more rows is looked at as far as this one.
const MOST_ROWS: usize = 1 << 20;

/// Rows of a test that equal one before, in all that is read of them or in measured values alone.
pub(super) struct TwinRows {
    /// Numeric columns that are measured.
    measured: Vec<bool>,
    /// Something else is read of a row that tells rows of a test apart.
    has_others: bool,
    rows: HashSet<u64>,
    values: HashMap<u64, u64>,
    others: HashSet<u64>,
    pairs: usize,
    /// Rows with the values of one before, but of another row otherwise.
    by_chance: usize,
    /// Rows that are as one before but for their values: measured again.
    repeats: usize,
    all: usize,
}

impl TwinRows {
    pub(super) fn of(model: &Model) -> TwinRows {
        let is_measured = |column: usize| model.measurements.iter().any(|own| own.column == column);
        let measured: Vec<bool> = (0..model.columns.len()).map(is_measured).collect();
        let has_others = measured.iter().any(|own| !own);
        let (rows, values, others) = (HashSet::new(), HashMap::new(), HashSet::new());
        TwinRows { measured, has_others, rows, values, others, pairs: 0, by_chance: 0, repeats: 0, all: 0 }
    }

    /// The next row of the test.
    pub(super) fn push(&mut self, numbers: &[f64], texts: &[Label], is_measured: bool) {
        self.all += 1;
        if !self.has_others || !is_measured || self.rows.len() >= MOST_ROWS {
            return;
        }
        let hash = |measured: Option<bool>| {
            let mut hasher = DefaultHasher::new();
            let cells = numbers.iter().zip(&self.measured).filter(|(_, own)| measured.is_none_or(|m| **own == m));
            cells.for_each(|(number, _)| number.to_bits().hash(&mut hasher));
            texts.iter().for_each(|text| text.hash(&mut hasher));
            hasher.finish()
        };
        let (row, values, others) = (hash(None), hash(Some(true)), hash(Some(false)));
        let is_repeat = !self.others.insert(others);
        let before = self.values.insert(values, others);
        if !self.rows.insert(row) {
            self.pairs += 1;
            return;
        }
        self.repeats += usize::from(is_repeat);
        self.by_chance += usize::from(before.is_some_and(|before| before != others));
    }

    pub(super) fn end(&mut self) {
        self.rows.clear();
        self.values.clear();
        self.others.clear();
    }

    /// Rows stand twice, more often than values are equal by chance, or than rows are measured again.
    pub(super) fn note(&self) -> Option<String> {
        let (pairs, all) = (self.pairs, self.all);
        let stand = if pairs == 1 { "equals" } else { "equal" };
        (pairs > self.by_chance.max(self.repeats)).then(|| {
            format!("{pairs} of {all} rows {stand} another row of the same test in all that is read of them: if they are copies, remove them")
        })
    }
}
