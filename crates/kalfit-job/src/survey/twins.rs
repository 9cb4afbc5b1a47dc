//! Rows that stand twice.

use std::collections::{HashMap, HashSet};
use std::hash::{BuildHasherDefault, Hasher};

use kalfit::{Model, Test};

/// A test of more rows is looked at as far as this one.
const MOST_ROWS: usize = 1 << 20;

/// Rows of a test that equal one before, in all that is read of them or in measured values alone.
pub(super) struct TwinRows {
    /// Numeric columns that are measured.
    measured: Vec<usize>,
    /// Numeric columns that are read otherwise: something that tells rows of a test apart.
    others: Vec<usize>,
    /// The column of times, where it is not measured.
    time: Option<usize>,
    pairs: usize,
    /// Rows with the values of one before, but of another row otherwise.
    by_chance: usize,
    /// Rows that are as one before but for their values: measured again.
    repeats: usize,
    all: usize,
}

impl TwinRows {
    pub(super) fn of(model: &Model) -> TwinRows {
        let is_measured = |column: &usize| model.measurements.iter().any(|own| own.column == *column);
        let (measured, others): (Vec<usize>, Vec<usize>) = (0..model.columns.len()).partition(is_measured);
        let time = model.clock.time.filter(|time| others.contains(time));
        TwinRows { measured, others, time, pairs: 0, by_chance: 0, repeats: 0, all: 0 }
    }

    /// Adds a test. `measured`: its rows that have a value, in order.
    pub(super) fn add(&mut self, rows: &Test, measured: &[usize]) {
        self.all += rows.rows();
        if self.others.is_empty() {
            return;
        }
        let values = |row: usize| hash((rows, row), &self.measured);
        if self.time.is_some_and(|time| increases(rows, measured, time)) {
            // no two rows are alike, so that equal values are equal by chance
            let looked = &measured[..measured.len().min(MOST_ROWS)];
            self.by_chance += repeated(looked.iter().map(|row| values(*row)).collect());
            return;
        }
        let (mut seen, mut last, mut seen_others) = (WordSet::default(), WordMap::default(), WordSet::default());
        for row in measured {
            if seen.len() >= MOST_ROWS {
                break;
            }
            let (values, others) = (values(*row), hash((rows, *row), &self.others));
            let is_repeat = !seen_others.insert(others);
            let before = last.insert(values, others);
            if !seen.insert(mixed(values, others)) {
                self.pairs += 1;
                continue;
            }
            self.repeats += usize::from(is_repeat);
            self.by_chance += usize::from(before.is_some_and(|before| before != others));
        }
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

/// Whether a column increases from each of these rows to the next.
fn increases(test: &Test, rows: &[usize], column: usize) -> bool {
    rows.windows(2).all(|pair| test.numbers(pair[0])[column] < test.numbers(pair[1])[column])
}

/// Number of words that equal one before.
fn repeated(mut words: Vec<u64>) -> usize {
    words.sort_unstable();
    words.windows(2).filter(|pair| pair[0] == pair[1]).count()
}

/// Hash of some numeric cells of a row and of its texts.
fn hash((test, row): (&Test, usize), columns: &[usize]) -> u64 {
    let (numbers, texts) = (test.numbers(row), test.texts(row));
    let cells = columns.iter().fold(0, |hash, column| mixed(hash, numbers[*column].to_bits()));
    texts.iter().fold(cells, |hash, text| mixed(hash, text.index() as u64))
}

/// A word of which every bit depends on all bits of both: two rounds of multiplication, as in SplitMix64.
fn mixed(hash: u64, word: u64) -> u64 {
    let mut x = hash.rotate_left(23).wrapping_add(word).wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

type WordSet = HashSet<u64, BuildHasherDefault<MixedWord>>;
type WordMap = HashMap<u64, u64, BuildHasherDefault<MixedWord>>;

/// The hasher of a word that is a hash itself.
#[derive(Default)]
struct MixedWord(u64);

impl Hasher for MixedWord {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.0 = mixed(self.0, u64::from(*byte)));
    }

    fn write_u64(&mut self, word: u64) {
        self.0 = word;
    }
}

#[cfg(test)]
mod tests {
    use kalfit::{Label, Source};

    use super::*;

    /// A survey of a measured column, a time and an input.
    fn survey() -> TwinRows {
        TwinRows { measured: vec![0], others: vec![1, 2], time: Some(1), pairs: 0, by_chance: 0, repeats: 0, all: 0 }
    }

    /// (pairs, by chance, repeats) of rows, each compared with all before.
    fn by_all_pairs(rows: &[([f64; 3], Label)]) -> (usize, usize, usize) {
        let (mut pairs, mut by_chance, mut repeats) = (0, 0, 0);
        let others = |(cells, text): &([f64; 3], Label)| (cells[1].to_bits(), cells[2].to_bits(), *text);
        let values = |(cells, text): &([f64; 3], Label)| (cells[0].to_bits(), *text);
        for (k, row) in rows.iter().enumerate() {
            let before = &rows[..k];
            if before.iter().any(|other| values(other) == values(row) && others(other) == others(row)) {
                pairs += 1;
                continue;
            }
            repeats += usize::from(before.iter().any(|other| others(other) == others(row)));
            by_chance += usize::from(before.iter().any(|other| values(other) == values(row)));
        }
        (pairs, by_chance, repeats)
    }

    #[test]
    fn counts_are_those_of_all_pairs_of_rows() {
        let mut seed = 1_u64;
        let mut drawn = |below: u64| {
            seed = mixed(seed, 7);
            seed % below
        };
        for round in 0..200 {
            let mut test = Test::new("t", 3, 1);
            let mut rows = Vec::new();
            for k in 0..30 {
                let time = if round % 2 == 0 { k } else { drawn(8) };
                let cells = [drawn(9) as f64, time as f64, drawn(2) as f64];
                let text = Label::literal(drawn(2) as usize);
                test.push(&cells, &[text], Source::default());
                rows.push((cells, text));
            }
            let mut found = survey();
            found.add(&test, &(0..30).collect::<Vec<usize>>());
            assert_eq!((found.pairs, found.by_chance, found.repeats), by_all_pairs(&rows), "round {round}");
        }
    }

    #[test]
    fn rows_without_values_are_counted_but_not_compared() {
        let mut test = Test::new("t", 3, 0);
        (0..5).for_each(|_| test.push(&[1.0, 2.0, 3.0], &[], Source::default()));
        let mut found = survey();
        found.add(&test, &[0, 4]);
        assert_eq!((found.all, found.pairs), (5, 1));
    }
}
