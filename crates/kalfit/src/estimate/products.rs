//! Sums of products over tests, as second derivatives need them.

use nalgebra::DMatrix;

use crate::linalg::elements::Elements;
use crate::linalg::symmetric::pair;

/// Products that are gathered before they are added, where they are many: one matrix product costs less than their sum one by one.
const GATHERED: usize = 32;

/// Σ a b' over vectors a, b.
#[derive(Debug, Clone)]
struct Outer {
    sum: DMatrix<f64>,
    left: DMatrix<f64>,
    right: DMatrix<f64>,
    filled: usize,
}

impl Outer {
    fn zero(rows: usize, columns: usize, gathered: usize) -> Outer {
        Outer {
            // memory that nothing is written to is not taken
            sum: DMatrix::from_vec(rows, columns, vec![0.0; rows * columns]),
            left: DMatrix::zeros(rows, gathered),
            right: DMatrix::zeros(gathered, columns),
            filled: 0,
        }
    }

    /// Takes in a product whose left side is written by `left`.
    fn push(&mut self, left: impl FnOnce(&mut [f64]), right: impl Iterator<Item = f64>) {
        let (at, rows) = (self.filled, self.left.nrows());
        left(&mut self.left.as_mut_slice()[at * rows..][..rows]);
        self.right.row_mut(at).iter_mut().zip(right).for_each(|(to, x)| *to = x);
        self.filled += 1;
        if self.filled == self.left.ncols() {
            self.settle();
        }
    }

    /// Adds sums that are given by rows.
    fn take(&mut self, sums: &[f64]) {
        let columns = self.sum.ncols().max(1);
        for (row, sums) in sums.chunks_exact(columns).enumerate() {
            self.sum.row_mut(row).iter_mut().zip(sums).for_each(|(sum, x)| *sum += x);
        }
    }

    /// Adds what is gathered.
    fn settle(&mut self) {
        let n = std::mem::take(&mut self.filled);
        if self.left.ncols() == 1 && n == 1 {
            let (left, rows) = (self.left.as_slice(), self.sum.nrows().max(1));
            for (column, right) in self.sum.as_mut_slice().chunks_exact_mut(rows).zip(self.right.iter()) {
                column.iter_mut().zip(left).for_each(|(sum, l)| *sum += l * right);
            }
        } else if n > 0 {
            self.sum.gemm(1.0, &self.left.columns(0, n), &self.right.rows(0, n), 1.0);
        }
    }
}

/// Sums of A ⊗ B over tests, A and B symmetric, as far as second derivatives by two elements of Σ need them: A_la B_bk with k, l
/// of one phase and a, b of one phase. Within a phase entry (l a, b k) stands at a pair of pairs, between phases at a pair of places
/// of the block.
#[derive(Debug, Clone)]
pub(crate) struct Products {
    elements: Elements,
    /// For phases f ≥ g at f(f+1)/2 + g; none where they are not wanted.
    blocks: Vec<Outer>,
    /// Where the entries of each block stand in a matrix by rows.
    places: Vec<Vec<usize>>,
}

impl Products {
    pub(crate) fn zero(elements: &Elements, wanted: bool) -> Products {
        let p = elements.states();
        let ranges = elements.blocks();
        let count = if wanted { ranges.len() } else { 0 };
        let places = (0..count).flat_map(|f| (0..=f).map(move |g| (f, g))).map(|(f, g)| {
            let row = |i: usize| ranges[g].clone().filter(move |&k| f != g || k <= i).map(move |k| i * p + k);
            ranges[f].clone().flat_map(row).collect::<Vec<usize>>()
        });
        let places: Vec<Vec<usize>> = places.collect();
        let gathered = gathered(elements);
        let blocks = places.iter().map(|places| Outer::zero(places.len(), places.len(), gathered)).collect();
        Products { elements: elements.clone(), blocks, places }
    }

    pub(crate) fn plus(&mut self, other: &Products) {
        self.blocks.iter_mut().zip(&other.blocks).for_each(|(own, other)| own.sum += &other.sum);
    }

    pub(crate) fn minus(&mut self, other: &Products) {
        self.blocks.iter_mut().zip(&other.blocks).for_each(|(own, other)| own.sum -= &other.sum);
    }

    /// Adds sums of a single phase, pairs × pairs by rows; none where they are not wanted.
    pub(crate) fn take(&mut self, sums: Vec<f64>) {
        self.blocks.iter_mut().for_each(|block| block.take(&sums));
    }

    /// Adds sums by pairs of phases, places × places by rows; none where they are not wanted.
    pub(crate) fn take_pairs(&mut self, sums: &[Vec<f64>]) {
        self.blocks.iter_mut().zip(sums).for_each(|(block, sums)| block.take(sums));
    }

    /// Adds scale × A ⊗ B; both p × p by rows.
    pub(crate) fn add(&mut self, (scale, a): (f64, &[f64]), b: &[f64]) {
        for (block, places) in self.blocks.iter_mut().zip(&self.places) {
            let left = |to: &mut [f64]| to.iter_mut().zip(places).for_each(|(to, &at)| *to = scale * a[at]);
            block.push(left, places.iter().map(|&at| b[at]));
        }
    }

    /// All of it, once it is settled.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> {
        self.blocks.iter().flat_map(|block| block.sum.iter().copied())
    }

    /// The same, to be set.
    pub(super) fn places_mut(&mut self) -> impl Iterator<Item = &mut f64> {
        self.blocks.iter_mut().flat_map(|block| block.sum.iter_mut())
    }

    pub(crate) fn settle(&mut self) {
        self.blocks.iter_mut().for_each(Outer::settle);
    }

    /// A_la B_bk, k and l of one phase, a and b of one phase.
    pub(crate) fn get(&self, (l, a): (usize, usize), (b, k): (usize, usize)) -> f64 {
        let (f, g) = (self.elements.block_of(l), self.elements.block_of(a));
        let ranges = self.elements.blocks();
        let (of_f, of_g) = (ranges[f].start, ranges[g].start);
        let (l, a, b, k) = (l - of_f, a - of_g, b - of_g, k - of_f);
        let sum = &self.blocks[pair(f, g)].sum;
        if f == g {
            return sum[(pair(l, a), pair(b, k))];
        }
        let (one, other) = if f > g { ((l, a), (k, b)) } else { ((a, l), (b, k)) };
        let width = ranges[f.min(g)].len();
        sum[(one.0 * width + one.1, other.0 * width + other.1)]
    }
}

/// Sums of A ⊗ r over tests: A_mk r_l for each mean coordinate m, k and l of one phase.
#[derive(Debug, Clone)]
pub(crate) struct Crosses {
    elements: Elements,
    coordinates: usize,
    /// By phase: entry (m, k, l) at (k × coordinates + m, l).
    blocks: Vec<Outer>,
}

impl Crosses {
    pub(crate) fn zero(elements: &Elements, coordinates: usize, wanted: bool) -> Crosses {
        let ranges = if wanted { elements.blocks() } else { &[] };
        let gathered = gathered(elements);
        let block = |p: usize| Outer::zero(p * coordinates, p, gathered);
        let blocks = ranges.iter().map(|range| block(range.len())).collect();
        Crosses { elements: elements.clone(), coordinates, blocks }
    }

    pub(crate) fn plus(&mut self, other: &Crosses) {
        self.blocks.iter_mut().zip(&other.blocks).for_each(|(own, other)| own.sum += &other.sum);
    }

    pub(crate) fn minus(&mut self, other: &Crosses) {
        self.blocks.iter_mut().zip(&other.blocks).for_each(|(own, other)| own.sum -= &other.sum);
    }

    /// Adds sums by phases, in the order in which they are kept here; none where they are not wanted.
    pub(crate) fn take_phases(&mut self, sums: &[Vec<f64>]) {
        self.blocks.iter_mut().zip(sums).for_each(|(block, sums)| block.take(sums));
    }

    /// Adds sums of A ⊗ r of a single phase without regression, pairs × p by rows; none where they are not wanted.
    pub(crate) fn take(&mut self, sums: &[f64]) {
        let coordinates = self.coordinates;
        for block in &mut self.blocks {
            let p = block.sum.ncols();
            let places = (0..p).flat_map(|i| (0..=i).map(move |k| (i, k)));
            for ((i, k), sums) in places.zip(sums.chunks_exact(p)) {
                for (m, k) in if i == k { vec![(i, k)] } else { vec![(i, k), (k, i)] } {
                    let mut row = block.sum.row_mut(k * coordinates + m);
                    row.iter_mut().zip(sums).for_each(|(sum, x)| *sum += x);
                }
            }
        }
    }

    /// Adds A ⊗ r, A_mk given by `weight(m, k)`.
    pub(crate) fn add(&mut self, weight: impl Fn(usize, usize) -> f64, r: &[f64]) {
        let coordinates = self.coordinates.max(1);
        for (block, range) in self.blocks.iter_mut().zip(self.elements.blocks()) {
            let left = |to: &mut [f64]| {
                for (to, k) in to.chunks_exact_mut(coordinates).zip(range.clone()) {
                    to.iter_mut().enumerate().for_each(|(m, to)| *to = weight(m, k));
                }
            };
            block.push(left, r[range.clone()].iter().copied());
        }
    }

    /// All of it, once it is settled.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> {
        self.blocks.iter().flat_map(|block| block.sum.iter().copied())
    }

    /// The same, to be set.
    pub(super) fn places_mut(&mut self) -> impl Iterator<Item = &mut f64> {
        self.blocks.iter_mut().flat_map(|block| block.sum.iter_mut())
    }

    pub(crate) fn settle(&mut self) {
        self.blocks.iter_mut().for_each(Outer::settle);
    }

    /// A_mk r_l.
    pub(crate) fn get(&self, m: usize, (k, l): (usize, usize)) -> f64 {
        let f = self.elements.block_of(k);
        let start = self.elements.blocks()[f].start;
        self.blocks[f].sum[((k - start) * self.coordinates + m, l - start)]
    }
}

/// Products of one phase are few: they are added one by one.
fn gathered(elements: &Elements) -> usize {
    if elements.is_single() { 1 } else { GATHERED }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_between_blocks_stand_where_they_are_looked_for() {
        let elements = Elements::new(vec![0..2, 2..5]);
        let matrix = |seed: f64| {
            let of = |i: usize, k: usize| (seed + (i * k) as f64 + (i + k) as f64 * 0.7).sin();
            (0..25).map(|at| of(at / 5, at % 5)).collect::<Vec<f64>>()
        };
        let mut sums = Products::zero(&elements, true);
        let mut crosses = Crosses::zero(&elements, 6, true);
        let tests: Vec<_> = (0..40).map(|j| (matrix(f64::from(j)), matrix(0.3 * f64::from(j)))).collect();
        for (a, b) in &tests {
            sums.add((2.0, a), b);
            crosses.add(|m, k| if m < 5 { a[m * 5 + k] } else { b[k] }, &a[5..10]);
        }
        sums.settle();
        crosses.settle();
        let close = |what: &str, found: f64, expected: f64| {
            assert!((found - expected).abs() < 1e-12, "{what}: {found} {expected}");
        };
        for (k, l) in elements.all() {
            for (x, y) in elements.all() {
                let expected: f64 = tests.iter().map(|(a, b)| 2.0 * a[l * 5 + x] * b[y * 5 + k]).sum();
                close(&format!("{k} {l} {x} {y}"), sums.get((l, x), (y, k)), expected);
            }
            let expected: f64 = tests.iter().map(|(a, _)| a[3 * 5 + k] * a[5 + l]).sum();
            close("cross", crosses.get(3, (k, l)), expected);
            let expected: f64 = tests.iter().map(|(a, b)| b[k] * a[5 + l]).sum();
            close("cross of a regressor", crosses.get(5, (k, l)), expected);
        }
    }
}
