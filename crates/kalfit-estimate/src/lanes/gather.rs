//! Sums of products Σ a b' over tests in lanes.

use kalfit_lanes::{Lanes, Part};
use rayon::prelude::*;

use kalfit_algebra::parts::{ColumnWork, by_column_blocks};

/// Number of blocks whose products are added in one go: each sum is then read, written and reduced over the lanes once
/// for all these blocks.
const BUFFERED_BLOCKS: usize = 16;

/// Smallest number of sums for which several threads share the work.
const PARALLEL_SUMS: usize = 1 << 20;
/// Number of rows of sums that one thread takes at a time.
const ROWS_PER_TASK: usize = 64;

/// Σ a b', `rows` × `columns`; a and b of several blocks are buffered before the products a b' are added.
#[derive(Debug, Clone)]
pub(super) struct ProductSums<T> {
    rows: usize,
    columns: usize,
    /// The vectors a, block after block.
    left: Vec<T>,
    right: Vec<T>,
    filled: usize,
    /// Sums over all lanes and the blocks added so far, by rows.
    sum: Vec<f64>,
}

impl<T: Lanes> ProductSums<T> {
    /// Sums that are zero; unless `wanted`, sums without rows, which cost nothing.
    pub(super) fn new((rows, columns): (usize, usize), wanted: bool) -> ProductSums<T> {
        let rows = if wanted { rows } else { 0 };
        let zero_buffer = |size: usize| vec![T::splat(0.0); size * if wanted { BUFFERED_BLOCKS } else { 0 }];
        ProductSums {
            rows,
            columns,
            left: zero_buffer(rows),
            right: zero_buffer(columns),
            filled: 0,
            sum: vec![0.0; rows * columns],
        }
    }

    /// Buffers for the next a and b; the caller writes every number of both.
    #[inline(always)]
    pub(super) fn next(&mut self) -> (&mut [T], &mut [T]) {
        if self.filled == BUFFERED_BLOCKS {
            self.flush();
        }
        let at = self.filled;
        self.filled += 1;
        let (rows, columns) = (self.rows, self.columns);
        (&mut self.left[at * rows..][..rows], &mut self.right[at * columns..][..columns])
    }

    #[inline(always)]
    fn flush(&mut self) {
        let ProductSums { rows, columns, left, right, filled, sum } = self;
        let strip = |(at, sum): (usize, &mut [f64])| {
            T::apart(RowSums {
                left: &left[at * ROWS_PER_TASK..],
                rows: *rows,
                blocks: *filled,
                right,
                columns: *columns,
                sum,
            });
        };
        if sum.len() < PARALLEL_SUMS {
            strip((0, &mut sum[..]));
        } else {
            sum.par_chunks_mut(ROWS_PER_TASK * *columns).enumerate().for_each(strip);
        }
        *filled = 0;
    }

    /// The sums, by rows.
    #[inline(always)]
    pub(super) fn total(mut self) -> Vec<f64> {
        self.flush();
        self.sum
    }
}

/// Adds the buffered products to some rows of the sums.
struct RowSums<'a, T> {
    /// The vectors a, from the first row of `sum` on; a of block k starts at index k × `rows`.
    left: &'a [T],
    rows: usize,
    blocks: usize,
    right: &'a [T],
    columns: usize,
    sum: &'a mut [f64],
}

/// Most rows of sums that are updated at once.
const MAX_ROWS: usize = 4;

impl<T: Lanes> Part for RowSums<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        let count = self.sum.len() / self.columns.max(1);
        let mut row = 0;
        while row < count {
            let left = count - row;
            match left.div_ceil(left.div_ceil(MAX_ROWS)) {
                1 => row += add_rows::<T, 1>(&mut self, row),
                2 => row += add_rows::<T, 2>(&mut self, row),
                3 => row += add_rows::<T, 3>(&mut self, row),
                _ => row += add_rows::<T, MAX_ROWS>(&mut self, row),
            }
        }
    }
}

/// Adds to M rows of the sums from `row` on; returns M.
#[inline(always)]
fn add_rows<T: Lanes, const M: usize>(row_sums: &mut RowSums<'_, T>, row: usize) -> usize {
    let RowSums { left, rows, blocks, right, columns, ref mut sum } = *row_sums;
    let sum = &mut sum[row * columns..][..M * columns];
    by_column_blocks(0, &mut Tile::<T, M> { left: &left[row..], rows, blocks, right, columns, sum });
    M
}

/// M rows of the sums.
struct Tile<'a, T, const M: usize> {
    /// M numbers of a for each block; the numbers of block k start at index k × `rows`.
    left: &'a [T],
    rows: usize,
    blocks: usize,
    right: &'a [T],
    columns: usize,
    sum: &'a mut [f64],
}

impl<T: Lanes, const M: usize> ColumnWork for Tile<'_, T, M> {
    #[inline(always)]
    fn count(&self) -> usize {
        self.columns
    }

    #[inline(always)]
    fn part<const N: usize>(&mut self, from: usize) {
        let mut sums = [[T::splat(0.0); N]; M];
        for k in 0..self.blocks {
            let a = &self.left[k * self.rows..][..M];
            let b = &self.right[k * self.columns + from..][..N];
            for m in 0..M {
                for n in 0..N {
                    sums[m][n] = a[m].fma(b[n], sums[m][n]);
                }
            }
        }
        for m in 0..M {
            for n in 0..N {
                self.sum[m * self.columns + from + n] += sums[m][n].sum();
            }
        }
    }
}
