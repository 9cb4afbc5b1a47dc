//! Symmetric matrices stored in half their memory while they are not in use.

use nalgebra::DMatrix;

use crate::symmetric::{pair, pairs};

/// A matrix; of a symmetric matrix, only the upper half is stored.
#[derive(Debug, Clone)]
pub enum Folded {
    /// Number of rows of a symmetric matrix, and the elements (i, k), i ≤ k, at index pair(k, i).
    Symmetric(usize, Vec<f64>),
    /// All elements of a matrix that is not symmetric to the last bit.
    Whole(DMatrix<f64>),
}

impl Folded {
    /// Stores the upper half of a matrix that is symmetric to the last bit, else the whole matrix.
    pub fn of(matrix: DMatrix<f64>) -> Folded {
        let size = matrix.nrows();
        let is_mirrored = |k: usize| (k + 1..size).all(|i| matrix[(i, k)].to_bits() == matrix[(k, i)].to_bits());
        if !matrix.is_square() || !(0..size).all(is_mirrored) {
            return Folded::Whole(matrix);
        }
        let mut half = Vec::with_capacity(pairs(size));
        (0..size).for_each(|k| half.extend_from_slice(&matrix.column(k).as_slice()[..=k]));
        Folded::Symmetric(size, half)
    }

    /// The matrix with all elements.
    pub fn unfolded(&self) -> DMatrix<f64> {
        let (size, half) = match self {
            Folded::Symmetric(size, half) => (*size, half),
            Folded::Whole(matrix) => return matrix.clone(),
        };
        let mut matrix = DMatrix::zeros(size, size);
        for k in 0..size {
            matrix.column_mut(k).rows_mut(0, k + 1).copy_from_slice(&half[pair(k, 0)..][..=k]);
        }
        matrix.fill_lower_triangle_with_upper_triangle();
        matrix
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_unfolded_is_what_was_folded() {
        let symmetric = DMatrix::from_fn(40, 40, |i, k| ((i * k + i + k) as f64).sin());
        let mut other = symmetric.clone();
        other[(3, 1)] += 1e-9;
        for (matrix, in_half) in [(symmetric, true), (other, false), (DMatrix::zeros(2, 3), false)] {
            let folded = Folded::of(matrix.clone());
            assert_eq!(matches!(folded, Folded::Symmetric(..)), in_half);
            assert!(folded.unfolded() == matrix);
        }
    }
}
