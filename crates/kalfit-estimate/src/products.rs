//! Sums of products over tests, for second derivatives.

use nalgebra::DMatrix;

use kalfit_algebra::elements::Elements;
use kalfit_algebra::symmetric::{pair, pairs};

/// own += sign × other.
pub(super) fn add_times(own: &mut DMatrix<f64>, sign: f64, other: &DMatrix<f64>) {
    own.zip_apply(other, |own, x| *own += sign * x);
}

/// Sums in blocks; there are no blocks where the sums are not wanted.
#[derive(Debug, Clone)]
pub(crate) struct ProductBlocks(Vec<ProductBlock>);

/// The sums of one block.
#[derive(Debug, Clone)]
struct ProductBlock {
    shape: (usize, usize),
    /// The matrix of sums; empty until something is added.
    sum: DMatrix<f64>,
}

impl ProductBlock {
    fn zero(rows: usize, columns: usize) -> ProductBlock {
        ProductBlock { shape: (rows, columns), sum: DMatrix::zeros(0, 0) }
    }

    fn matrix_mut(&mut self) -> &mut DMatrix<f64> {
        if self.sum.is_empty() {
            self.sum = DMatrix::zeros(self.shape.0, self.shape.1);
        }
        &mut self.sum
    }

    fn get(&self, at: (usize, usize)) -> f64 {
        if self.sum.is_empty() { 0.0 } else { self.sum[at] }
    }

    /// Adds sums given by rows. The first sums of a square block become the matrix without a copy.
    fn take(&mut self, sums: Vec<f64>) {
        let (rows, columns) = self.shape;
        if self.sum.is_empty() && rows == columns {
            self.sum = DMatrix::from_vec(rows, columns, sums);
            return self.sum.transpose_mut();
        }
        let sum = self.matrix_mut();
        for (row, sums) in sums.chunks_exact(columns.max(1)).enumerate() {
            sum.row_mut(row).iter_mut().zip(sums).for_each(|(sum, x)| *sum += x);
        }
    }
}

impl ProductBlocks {
    /// Adds the sums of another set of blocks, times a sign.
    pub(crate) fn add(&mut self, sign: f64, other: &ProductBlocks) {
        let added = self.0.iter_mut().zip(&other.0).filter(|(_, other)| !other.sum.is_empty());
        added.for_each(|(own, other)| add_times(own.matrix_mut(), sign, &other.sum));
    }

    /// Adds sums given by rows, one list for each block.
    pub(crate) fn take(&mut self, sums: Vec<Vec<f64>>) {
        self.0.iter_mut().zip(sums).for_each(|(block, sums)| block.take(sums));
    }

    /// All sums, block by block.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> {
        let of = |block: &ProductBlock| {
            let missing = block.shape.0 * block.shape.1 - block.sum.len();
            std::iter::repeat_n(0.0, missing)
        };
        self.0.iter().flat_map(move |block| block.sum.iter().copied().chain(of(block)))
    }

    /// All sums, block by block, as mutable references.
    pub(super) fn elements_mut(&mut self) -> impl Iterator<Item = &mut f64> {
        self.0.iter_mut().flat_map(|block| block.matrix_mut().iter_mut())
    }
}

/// Sums of A ⊗ B over tests, A and B symmetric: the entries A_la B_bk that second derivatives by two elements of Σ
/// need, with k, l of one phase and a, b of one phase. Within a phase entry (l a, b k) is indexed by a pair of pairs,
/// between phases by a pair of positions in the block.
#[derive(Debug, Clone)]
pub(crate) struct Products {
    elements: Elements,
    /// The block of phases f ≥ g has the index f(f+1)/2 + g.
    pub(super) blocks: ProductBlocks,
}

impl Products {
    pub(crate) fn zero(elements: &Elements, wanted: bool) -> Products {
        let sizes: Vec<usize> = elements.blocks().iter().map(ExactSizeIterator::len).collect();
        let places = |f: usize, g: usize| if f == g { pairs(sizes[f]) } else { sizes[f] * sizes[g] };
        let square = |(f, g)| ProductBlock::zero(places(f, g), places(f, g));
        let count = if wanted { sizes.len() } else { 0 };
        let blocks = (0..count).flat_map(|f| (0..=f).map(move |g| (f, g))).map(square).collect();
        Products { elements: elements.clone(), blocks: ProductBlocks(blocks) }
    }

    /// Sum of A_la B_bk, with k and l of one phase, a and b of one phase.
    pub(crate) fn get(&self, (l, a): (usize, usize), (b, k): (usize, usize)) -> f64 {
        let (f, g) = (self.elements.block_of(l), self.elements.block_of(a));
        let ranges = self.elements.blocks();
        let (of_f, of_g) = (ranges[f].start, ranges[g].start);
        let (l, a, b, k) = (l - of_f, a - of_g, b - of_g, k - of_f);
        let sum = &self.blocks.0[pair(f, g)];
        if f == g {
            return sum.get((pair(l, a), pair(b, k)));
        }
        let (one, other) = if f > g { ((l, a), (k, b)) } else { ((a, l), (b, k)) };
        let width = ranges[f.min(g)].len();
        sum.get((one.0 * width + one.1, other.0 * width + other.1))
    }
}

/// Sums of A ⊗ r over tests: A_mk r_l for each mean coordinate m, k and l of one phase.
#[derive(Debug, Clone)]
pub(crate) struct Crosses {
    elements: Elements,
    coordinates: usize,
    /// One block for each phase, with entry (m, k, l) at (k × coordinates + m, l).
    pub(super) blocks: ProductBlocks,
}

impl Crosses {
    pub(crate) fn zero(elements: &Elements, coordinates: usize, wanted: bool) -> Crosses {
        let ranges = if wanted { elements.blocks() } else { &[] };
        let blocks = ranges.iter().map(|range| ProductBlock::zero(range.len() * coordinates, range.len())).collect();
        Crosses { elements: elements.clone(), coordinates, blocks: ProductBlocks(blocks) }
    }

    /// Sum of A_mk r_l.
    pub(crate) fn get(&self, m: usize, (k, l): (usize, usize)) -> f64 {
        let f = self.elements.block_of(k);
        let start = self.elements.blocks()[f].start;
        self.blocks.0[f].get(((k - start) * self.coordinates + m, l - start))
    }
}

#[cfg(test)]
mod tests {
    use kalfit_fixtures::near;

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
        // the positions of each pair of phases in a matrix by rows
        let places = [(0..2, 0..2), (2..5, 0..2), (2..5, 2..5)].map(|(rows, columns)| {
            let within = rows == columns;
            let row = |i: usize| columns.clone().filter(move |&k| !within || k <= i).map(move |k| i * 5 + k);
            rows.flat_map(row).collect::<Vec<usize>>()
        });
        for (a, b) in &tests {
            let outer = |left: Vec<f64>, right: &[f64]| -> Vec<f64> {
                left.iter().flat_map(|l| right.iter().map(move |r| l * r)).collect()
            };
            let of = |places: &Vec<usize>, m: &[f64]| places.iter().map(|&at| m[at]).collect::<Vec<f64>>();
            sums.blocks
                .take(places.iter().map(|at| outer(of(at, a).iter().map(|x| 2.0 * x).collect(), &of(at, b))).collect());
            let weight = |k: usize, m: usize| if m < 5 { a[m * 5 + k] } else { b[k] };
            let left = |own: std::ops::Range<usize>| own.flat_map(|k| (0..6).map(move |m| weight(k, m))).collect();
            crosses.blocks.take([0..2, 2..5].map(|own| outer(left(own.clone()), &a[5..10][own])).to_vec());
        }
        for (k, l) in elements.all() {
            for (x, y) in elements.all() {
                let expected: f64 = tests.iter().map(|(a, b)| 2.0 * a[l * 5 + x] * b[y * 5 + k]).sum();
                near::absolute(format_args!("{k} {l} {x} {y}"), sums.get((l, x), (y, k)), expected, 1e-12);
            }
            let expected: f64 = tests.iter().map(|(a, _)| a[3 * 5 + k] * a[5 + l]).sum();
            near::absolute("cross", crosses.get(3, (k, l)), expected, 1e-12);
            let expected: f64 = tests.iter().map(|(a, b)| b[k] * a[5 + l]).sum();
            near::absolute("cross of a regressor", crosses.get(5, (k, l)), expected, 1e-12);
        }
    }
}
