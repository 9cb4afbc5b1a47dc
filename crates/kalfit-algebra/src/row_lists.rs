//! Rows of numbers, one after the other.

use std::ops::Range;

/// Rows of numbers. Where all rows have the length of the first row, as is usual, the ends of the rows are not stored.
#[derive(Debug, Clone, Default)]
pub struct RowLists {
    numbers: Vec<f64>,
    /// Length of the first row, and of all rows if `ends` is empty.
    width: usize,
    /// End of each row, if the rows have different lengths; else empty.
    ends: Vec<usize>,
}

impl RowLists {
    /// Appends a row; `rows` is the number of rows so far.
    pub fn push(&mut self, rows: usize, numbers: impl Iterator<Item = f64>) {
        let start = self.numbers.len();
        self.numbers.extend(numbers);
        let size = self.numbers.len() - start;
        if rows == 0 {
            self.width = size;
        }
        if size != self.width && self.ends.is_empty() {
            self.ends = (1..=rows).map(|row| row * self.width).collect();
        }
        if !self.ends.is_empty() {
            self.ends.push(self.numbers.len());
        }
    }

    /// Appends the first `more` rows of `other`; `rows` is the number of rows so far.
    pub fn append(&mut self, rows: usize, other: &RowLists, more: usize) {
        if self.width == other.width && self.ends.is_empty() && other.ends.is_empty() {
            self.numbers.extend_from_slice(&other.numbers);
        } else {
            (0..more).for_each(|row| self.push(rows + row, other.row(row).iter().copied()));
        }
    }

    /// Reserves room for `rows` more rows as long as the first one.
    pub fn reserve(&mut self, rows: usize) {
        self.numbers.reserve_exact(rows * self.width);
    }

    /// The numbers of row `row`.
    #[inline]
    pub fn row(&self, row: usize) -> &[f64] {
        &self.numbers[self.range(row)]
    }

    /// The numbers of row `row`, for writing.
    pub fn row_mut(&mut self, row: usize) -> &mut [f64] {
        let range = self.range(row);
        &mut self.numbers[range]
    }

    /// Multiplies all numbers by one factor.
    pub fn scale(&mut self, factor: f64) {
        self.numbers.iter_mut().for_each(|x| *x *= factor);
    }

    #[inline]
    fn range(&self, row: usize) -> Range<usize> {
        if self.ends.is_empty() {
            return row * self.width..(row + 1) * self.width;
        }
        row.checked_sub(1).map_or(0, |previous| self.ends[previous])..self.ends[row]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_several_lengths_are_kept_as_they_are() {
        let rows: [&[f64]; 5] = [&[1.0, 2.0], &[3.0, 4.0], &[], &[5.0], &[6.0, 7.0]];
        for split in 0..=rows.len() {
            let column = |rows: &[&[f64]]| {
                let mut column = RowLists::default();
                rows.iter().enumerate().for_each(|(at, row)| column.push(at, row.iter().copied()));
                column
            };
            let (mut found, more) = (column(&rows[..split]), column(&rows[split..]));
            found.append(split, &more, rows.len() - split);
            (0..rows.len()).for_each(|row| assert_eq!(found.row(row), rows[row], "{split}: {row}"));
        }
    }
}
