//! Elements of a mean and of a block-diagonal symmetric matrix, such as μ and Σ of several phases, and the index of
//! each element.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::folded::Folded;
use crate::symmetric::{pair, pairs};

/// An element of μ or Σ, by indices among the states of all phases.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Element {
    /// Element of μ, by the index of the state.
    Mean(usize),
    /// Element of Σ, by the indices of two states of one phase.
    Covariance(usize, usize),
}

/// The elements (i, j), i ≥ j, of a block-diagonal symmetric matrix with one block for each phase: the elements of the
/// first block in the order (0,0), (1,0), (1,1), (2,0), …, then the elements of the second block, and so on. Blocks f
/// of p_f states have Σ p_f(p_f+1)/2 elements.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Elements {
    ranges: Vec<Range<usize>>,
    block: Vec<usize>,
    /// Index of the first element of each block, then the number of all elements.
    first: Vec<usize>,
}

impl Elements {
    /// The elements of blocks with the given ranges of states; the first range begins at 0, each other range where the
    /// range before ends.
    pub fn new(ranges: Vec<Range<usize>>) -> Elements {
        let (mut first, mut block) = (vec![0], Vec::new());
        for (f, range) in ranges.iter().enumerate() {
            debug_assert_eq!(range.start, block.len(), "blocks follow each other");
            first.push(first[f] + pairs(range.len()));
            block.extend(range.clone().map(|_| f));
        }
        Elements { ranges, block, first }
    }

    /// The elements of a matrix of one block with p states.
    pub fn single(p: usize) -> Elements {
        Elements::new(std::iter::once(0..p).collect())
    }

    /// Number of elements.
    pub fn count(&self) -> usize {
        self.first[self.ranges.len()]
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.block.len()
    }

    /// Range of the states of each block.
    pub fn blocks(&self) -> &[Range<usize>] {
        &self.ranges
    }

    /// Whether there is only one block.
    pub fn is_single(&self) -> bool {
        self.ranges.len() == 1
    }

    /// Index of the block of state i.
    pub fn block_of(&self, i: usize) -> usize {
        self.block[i]
    }

    /// Index of element {i, j}; `None` if states i and j are of different blocks.
    pub fn get(&self, i: usize, j: usize) -> Option<usize> {
        let f = self.block[i];
        let start = self.ranges[f].start;
        (self.block[j] == f).then(|| self.first[f] + pair(i - start, j - start))
    }

    /// Index of element {i, j}, for states i and j of one block.
    pub fn index(&self, i: usize, j: usize) -> usize {
        self.get(i, j).expect("both states are of one block")
    }

    /// The elements (i, j), i ≥ j, by ascending index.
    pub fn all(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let of = |range: &Range<usize>| {
            let start = range.start;
            range.clone().flat_map(move |i| (start..=i).map(move |j| (i, j)))
        };
        self.ranges.iter().flat_map(of)
    }

    /// The element (i, j) of index `number`; `None` if there are fewer elements.
    pub fn at(&self, number: usize) -> Option<(usize, usize)> {
        self.all().nth(number)
    }

    /// The symmetric matrix, states × states, with the elements `packed`.
    pub fn unpack(&self, packed: &DVector<f64>) -> DMatrix<f64> {
        let p = self.states();
        DMatrix::from_fn(p, p, |i, j| self.get(i, j).map_or(0.0, |k| packed[k]))
    }

    /// Derivative with respect to each element of a function whose derivative with respect to the matrix is G
    /// (`score`): g_ii on the diagonal, 2 g_ij elsewhere.
    pub fn pack_score(&self, score: &DMatrix<f64>) -> DVector<f64> {
        let one = |(i, j): (usize, usize)| if i == j { score[(i, i)] } else { 2.0 * score[(i, j)] };
        DVector::from_iterator(self.count(), self.all().map(one))
    }

    /// Matrix, elements × elements, whose entry (σ_kl, σ_ab) is the sum of `term(k, l, a, b)` over the positions of
    /// both elements: one position for a diagonal element, two positions for any other element.
    pub fn over(&self, term: impl Fn(usize, usize, usize, usize) -> f64) -> DMatrix<f64> {
        let mut result = DMatrix::zeros(self.count(), self.count());
        self.over_half(term, |row, column, value| {
            result[(row, column)] = value;
            result[(column, row)] = value;
        });
        result
    }

    /// The matrix of `over`, in half the memory.
    pub fn folded_over(&self, term: impl Fn(usize, usize, usize, usize) -> f64) -> Folded {
        let mut half = Vec::with_capacity(pairs(self.count()));
        self.over_half(term, |_, _, value| half.push(value));
        Folded::Symmetric(self.count(), half)
    }

    /// Passes row, column and entry of the upper half of the matrix of `over` to `to`, column by column.
    fn over_half(&self, term: impl Fn(usize, usize, usize, usize) -> f64, mut to: impl FnMut(usize, usize, f64)) {
        let all: Vec<(usize, usize)> = self.all().collect();
        let sum = |one: (usize, usize), other: (usize, usize)| {
            let of = |(k, l)| positions(other).map(|(a, b)| term(k, l, a, b)).fold(0.0, |sum, x| sum + x);
            positions(one).map(of).fold(0.0, |sum, x| sum + x)
        };
        for (column, &other) in all.iter().enumerate() {
            for (row, &one) in all.iter().enumerate().take(column + 1) {
                to(row, column, 0.5 * (sum(one, other) + sum(other, one)));
            }
        }
    }
}

/// Positions of element (i, j), i ≥ j, in a symmetric matrix.
fn positions((i, j): (usize, usize)) -> impl Iterator<Item = (usize, usize)> {
    std::iter::once((j, i)).chain((i != j).then_some((i, j)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_of_one_block_are_numbered_as_pairs() {
        let elements = Elements::single(4);
        assert_eq!(elements.count(), pairs(4));
        for (k, (i, j)) in elements.all().enumerate() {
            assert_eq!((elements.index(i, j), elements.index(j, i), pair(i, j)), (k, k, k));
        }
    }

    #[test]
    fn there_are_no_elements_between_blocks() {
        let elements = Elements::new(vec![0..2, 2..2, 2..5]);
        let all: Vec<_> = elements.all().collect();
        assert_eq!(all, [(0, 0), (1, 0), (1, 1), (2, 2), (3, 2), (3, 3), (4, 2), (4, 3), (4, 4)]);
        assert_eq!((elements.get(1, 2), elements.index(2, 4), elements.at(7)), (None, 6, Some((4, 3))));
        let packed = DVector::from_fn(9, |k, _| k as f64);
        assert_eq!(elements.pack_score(&elements.unpack(&packed))[6], 12.0);
    }
}
