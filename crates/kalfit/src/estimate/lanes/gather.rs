//! Sums of products over tests side by side: Σ a b' over vectors a, b.

use kalfit_lanes::{Isa, Kernel, Lanes};

use crate::estimate::lanes::rows::{TOGETHER, add_four, at};

/// Σ a b' in lanes. Products of a few blocks are added together.
#[derive(Debug, Clone)]
pub(super) struct Gather {
    isa: Isa,
    rows: usize,
    columns: usize,
    left: Vec<f64>,
    right: Vec<f64>,
    filled: usize,
    sum: Vec<f64>,
}

impl Gather {
    /// Of products that are wanted, or of none.
    pub(super) fn new(isa: Isa, (rows, columns): (usize, usize), wanted: bool) -> Gather {
        let rows = if wanted { rows } else { 0 };
        let zeros = |size: usize| vec![0.0; size * isa.lanes()];
        let (left, right) = (zeros(rows * TOGETHER), zeros(columns * TOGETHER));
        Gather { isa, rows, columns, left, right, filled: 0, sum: zeros(rows * columns) }
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
        let (rows, lanes) = (self.rows, self.isa.lanes());
        self.left[self.filled * rows * lanes..].fill(0.0); // nothing more is to be added
        self.isa.run(Settle(self));
        self.filled = 0;
    }

    /// The sums, by rows.
    pub(super) fn total(mut self) -> Vec<f64> {
        self.settle();
        self.isa.run(Total(&self.sum))
    }
}

/// Adds what is gathered.
struct Settle<'a>(&'a mut Gather);

impl Kernel for Settle<'_> {
    type Output = ();

    #[inline(always)]
    fn run<T: Lanes>(self) {
        let Gather { rows, columns, left, right, sum, .. } = self.0;
        let width = *columns * T::COUNT;
        let (a, b) = right.split_at(2 * width);
        let (right, left) = ([&a[..width], &a[width..], &b[..width], &b[width..]], &*left);
        for (i, row) in sum.chunks_exact_mut(width.max(1)).enumerate() {
            let factors = [at(left, i), at(left, *rows + i), at(left, 2 * *rows + i), at(left, 3 * *rows + i)];
            add_four::<T>(row, factors, right);
        }
    }
}

/// Sums over lanes.
struct Total<'a>(&'a [f64]);

impl Kernel for Total<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn run<T: Lanes>(self) -> Vec<f64> {
        let mut all = Vec::with_capacity(self.0.len() / T::COUNT);
        for x in self.0.chunks_exact(T::COUNT) {
            all.push(T::load(x).sum());
        }
        all
    }
}
