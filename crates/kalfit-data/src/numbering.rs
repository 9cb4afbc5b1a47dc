//! Numbers of rows in their file.

use std::ops::Range;

/// The numbers of rows, as a person counts, in runs that follow each other.
#[derive(Debug, Default)]
pub(crate) struct RowNumbering {
    /// The first row of each run, and its number.
    runs: Vec<(usize, u64)>,
}

impl RowNumbering {
    /// Of rows that follow each other.
    pub(crate) fn from(first: u64) -> RowNumbering {
        RowNumbering { runs: vec![(0, first)] }
    }

    /// Says the number of a row after those before.
    pub(crate) fn push(&mut self, row: usize, number: u64) {
        let follows = self.runs.last().is_some_and(|(first, n)| n + (row - first) as u64 == number);
        if !follows {
            self.runs.push((row, number));
        }
    }

    /// Number of a row.
    pub(crate) fn of(&self, row: usize) -> u64 {
        let run = self.runs.partition_point(|(first, _)| *first <= row) - 1;
        let (first, number) = self.runs[run];
        number + (row - first) as u64
    }

    /// Parts of a range of rows whose numbers follow each other: rows, and the number of the first.
    pub(crate) fn parts(&self, rows: Range<usize>) -> impl Iterator<Item = (Range<usize>, u64)> + use<'_> {
        let first = self.runs.partition_point(|(first, _)| *first <= rows.start).saturating_sub(1);
        (first..self.runs.len()).map_while(move |run| {
            let (start, number) = self.runs[run];
            let end = self.runs.get(run + 1).map_or(rows.end, |(next, _)| *next);
            let part = start.max(rows.start)..end.min(rows.end);
            (part.start < part.end).then(|| (part.clone(), number + (part.start - start) as u64))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_have_numbers_that_need_not_follow_each_other() {
        let mut numbering = RowNumbering::default();
        (0..).zip([2, 3, 7, 8, 9]).for_each(|(row, number)| numbering.push(row, number));
        assert_eq!((0..5).map(|row| numbering.of(row)).collect::<Vec<_>>(), [2, 3, 7, 8, 9]);
        assert_eq!(numbering.parts(1..4).collect::<Vec<_>>(), [(1..2, 3), (2..4, 7)]);
        assert_eq!(numbering.parts(4..5).collect::<Vec<_>>(), [(4..5, 9)]);
        assert_eq!(RowNumbering::from(5).parts(2..4).collect::<Vec<_>>(), [(2..4, 7)]);
    }
}
