//! Sums of products over tests side by side: Σ a b' over vectors a, b.

use kalfit_lanes::{Isa, Kernel, Lanes};

use crate::linalg::parts::{Columns, in_parts};

/// Blocks whose products are added together: each sum is then read and written once for so many, and summed over its lanes once.
const TOGETHER: usize = 16;

/// Σ a b'. Products of a few blocks are added together.
#[derive(Debug, Clone)]
pub(super) struct Gather {
    isa: Isa,
    rows: usize,
    columns: usize,
    /// In lanes, block after block.
    left: Vec<f64>,
    right: Vec<f64>,
    filled: usize,
    /// Over all lanes, by rows.
    sum: Vec<f64>,
}

impl Gather {
    /// Of products that are wanted, or of none.
    pub(super) fn new(isa: Isa, (rows, columns): (usize, usize), wanted: bool) -> Gather {
        let rows = if wanted { rows } else { 0 };
        let room = |size: usize| vec![0.0; size * isa.lanes() * if wanted { TOGETHER } else { 0 }];
        Gather { isa, rows, columns, left: room(rows), right: room(columns), filled: 0, sum: vec![0.0; rows * columns] }
    }

    /// Room for the next a and b in lanes, both to be written whole.
    pub(super) fn next(&mut self) -> (&mut [f64], &mut [f64]) {
        if self.filled == TOGETHER {
            self.settle();
        }
        let (at, lanes) = (self.filled, self.isa.lanes());
        self.filled += 1;
        let (rows, columns) = (self.rows * lanes, self.columns * lanes);
        (&mut self.left[at * rows..][..rows], &mut self.right[at * columns..][..columns])
    }

    fn settle(&mut self) {
        self.isa.run(Settle(self));
        self.filled = 0;
    }

    /// The sums, by rows.
    pub(super) fn total(mut self) -> Vec<f64> {
        self.settle();
        self.sum
    }
}

/// Adds what is gathered.
struct Settle<'a>(&'a mut Gather);

/// Rows that are worked on at once.
const TALLEST: usize = 4;

impl Kernel for Settle<'_> {
    type Output = ();

    #[inline(always)]
    fn run<T: Lanes>(self) {
        let gather = self.0;
        let mut row = 0;
        while row < gather.rows {
            let left = gather.rows - row;
            match left.div_ceil(left.div_ceil(TALLEST)) {
                1 => row += some_rows::<T, 1>(gather, row),
                2 => row += some_rows::<T, 2>(gather, row),
                3 => row += some_rows::<T, 3>(gather, row),
                _ => row += some_rows::<T, TALLEST>(gather, row),
            }
        }
    }
}

/// Adds to so many rows of the sums; says how many.
#[inline(always)]
fn some_rows<T: Lanes, const M: usize>(gather: &mut Gather, row: usize) -> usize {
    let Gather { rows, columns, left, right, filled, sum, .. } = gather;
    let sum = &mut sum[row * *columns..][..M * *columns];
    let (left, blocks) = (&left[row * T::COUNT..], *filled);
    let rows = *rows * T::COUNT;
    in_parts(0, &mut Tile::<T, M> { left, rows, blocks, right, columns: *columns, sum, zero: T::splat(0.0) });
    M
}

/// M rows of the sums.
struct Tile<'a, T, const M: usize> {
    /// M numbers in lanes of each block, so far apart.
    left: &'a [f64],
    rows: usize,
    blocks: usize,
    right: &'a [f64],
    columns: usize,
    sum: &'a mut [f64],
    zero: T,
}

impl<T: Lanes, const M: usize> Columns for Tile<'_, T, M> {
    #[inline(always)]
    fn count(&self) -> usize {
        self.columns
    }

    #[inline(always)]
    fn part<const N: usize>(&mut self, from: usize) {
        let mut sums = [[self.zero; N]; M];
        for k in 0..self.blocks {
            let a = &self.left[k * self.rows..][..M * T::COUNT];
            let right = &self.right[(k * self.columns + from) * T::COUNT..][..N * T::COUNT];
            let mut b = [self.zero; N];
            for n in 0..N {
                b[n] = T::load(&right[n * T::COUNT..]);
            }
            for m in 0..M {
                let a = T::load(&a[m * T::COUNT..]);
                for n in 0..N {
                    sums[m][n] = a.fma(b[n], sums[m][n]);
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
