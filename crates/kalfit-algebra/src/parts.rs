//! Sums over rows, a few columns at a time, so that the sums stay in registers while terms are added.

use kalfit_lanes::Real;

use crate::rows::Rows;

/// Largest number of columns worked on at a time.
const MAX_COLUMNS: usize = 6;

/// Work on columns that is done for `N` columns at once.
pub trait ColumnWork {
    /// Number of columns.
    fn count(&self) -> usize;

    /// Does the work for `N` columns, the first of which is given.
    fn part<const N: usize>(&mut self, start_column: usize);
}

/// Does the work for all columns from `first` on, in blocks of nearly equal width.
#[inline(always)]
pub fn by_column_blocks(first: usize, columns: &mut impl ColumnWork) {
    let (mut start_column, end) = (first, columns.count());
    while start_column < end {
        let remaining = end - start_column;
        let size = remaining.div_ceil(remaining.div_ceil(MAX_COLUMNS));
        match size {
            1 => columns.part::<1>(start_column),
            2 => columns.part::<2>(start_column),
            3 => columns.part::<3>(start_column),
            4 => columns.part::<4>(start_column),
            5 => columns.part::<5>(start_column),
            _ => columns.part::<MAX_COLUMNS>(start_column),
        }
        start_column += size;
    }
}

/// y ← y + Σ_k a_k x_k, or y ← y - Σ_k a_k x_k, over rows x_k as wide as y.
pub(crate) struct Sum<'a, T, const MINUS: bool> {
    pub(crate) y: &'a mut [T],
    /// (slice, step): a_k is element k × step of the slice.
    pub(crate) a: (&'a [T], usize),
    /// The rows x_k, one after the other.
    pub(crate) x: &'a [T],
    /// Number of rows x_k.
    pub(crate) count: usize,
}

impl<T: Real, const MINUS: bool> ColumnWork for Sum<'_, T, MINUS> {
    #[inline(always)]
    fn count(&self) -> usize {
        self.y.len()
    }

    #[inline(always)]
    fn part<const N: usize>(&mut self, start_column: usize) {
        let (width, (a, step)) = (self.y.len(), self.a);
        let y = chunk_mut::<T, N>(self.y, start_column);
        let mut sum = *y;
        for k in 0..self.count {
            let (a, x) = (a[k * step], chunk::<T, N>(self.x, k * width + start_column));
            for c in 0..N {
                sum[c] = if MINUS { a.fnma(x[c], sum[c]) } else { a.fma(x[c], sum[c]) };
            }
        }
        *y = sum;
    }
}

/// y_c ← Σ_k x_k r_ck, with r_ck the elements of `rows`.
pub(crate) struct Dots<'a, T> {
    pub(crate) y: &'a mut [T],
    pub(crate) x: &'a [T],
    pub(crate) rows: &'a Rows<T>,
}

impl<T: Real> ColumnWork for Dots<'_, T> {
    #[inline(always)]
    fn count(&self) -> usize {
        self.y.len()
    }

    #[inline(always)]
    fn part<const N: usize>(&mut self, start_column: usize) {
        let (width, mut sum) = (self.x.len(), [T::splat(0.0); N]);
        let rows = &self.rows.as_slice()[start_column * width..][..N * width];
        for (k, &a) in self.x.iter().enumerate() {
            for c in 0..N {
                sum[c] = a.fma(rows[c * width + k], sum[c]);
            }
        }
        *chunk_mut::<T, N>(self.y, start_column) = sum;
    }
}

/// Householder reflection I - `scale` v v' that makes column `column` of `rows` zero and folds this column into the row
/// `upper` of a triangle, applied to the other columns. The sign of the row `upper` is flipped afterwards.
pub(crate) struct Reflection<'a, T> {
    pub(crate) upper: &'a mut [T],
    pub(crate) rows: &'a mut Rows<T>,
    pub(crate) column: usize,
    /// First component of v; the other components are the elements of column `column` of `rows`.
    pub(crate) first: T,
    /// 2 / v'v.
    pub(crate) scale: T,
}

impl<T: Real> ColumnWork for Reflection<'_, T> {
    #[inline(always)]
    fn count(&self) -> usize {
        self.upper.len()
    }

    #[inline(always)]
    fn part<const N: usize>(&mut self, start_column: usize) {
        let upper = chunk_mut::<T, N>(self.upper, start_column);
        let mut projection = [self.first; N];
        for c in 0..N {
            projection[c] = projection[c] * upper[c];
        }
        for i in 0..self.rows.nrows() {
            let row = self.rows.row(i);
            let (a, x) = (row[self.column], chunk::<T, N>(row, start_column));
            for c in 0..N {
                projection[c] = a.fma(x[c], projection[c]);
            }
        }
        for c in 0..N {
            projection[c] = projection[c] * self.scale;
            upper[c] = self.first * projection[c] - upper[c];
        }
        for i in 0..self.rows.nrows() {
            let row = self.rows.row_mut(i);
            let a = row[self.column];
            let x = chunk_mut::<T, N>(row, start_column);
            for c in 0..N {
                x[c] = a.fnma(projection[c], x[c]);
            }
        }
    }
}

#[inline(always)]
fn chunk<T, const N: usize>(row: &[T], start_column: usize) -> &[T; N] {
    row[start_column..start_column + N].first_chunk().expect("it is that long")
}

#[inline(always)]
fn chunk_mut<T, const N: usize>(row: &mut [T], start_column: usize) -> &mut [T; N] {
    row[start_column..start_column + N].first_chunk_mut().expect("it is that long")
}
