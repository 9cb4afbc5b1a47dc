//! Large square matrices put aside in half their memory, while it is wanted for others.

use nalgebra::DMatrix;

use crate::linalg::symmetric::{pair, pairs};

/// Smaller matrices are left as they are.
const LARGE: usize = 500;

/// The upper half of a matrix that follows from it.
#[derive(Debug)]
pub(crate) struct Folded {
    size: usize,
    /// Element (i, k), i ≤ k, at pair(k, i).
    half: Vec<f64>,
    /// The lower half is as the upper one; it is zero otherwise.
    symmetric: bool,
}

impl Folded {
    /// Takes a large matrix that is symmetric to the last bit, or upper triangular, and leaves an empty one.
    pub(crate) fn of(matrix: &mut DMatrix<f64>) -> Option<Folded> {
        let size = matrix.nrows();
        if size < LARGE || size != matrix.ncols() {
            return None;
        }
        let below = |of: &dyn Fn(usize, usize) -> bool| (0..size).all(|k| (k + 1..size).all(|i| of(i, k)));
        let symmetric = below(&|i, k| matrix[(i, k)].to_bits() == matrix[(k, i)].to_bits());
        if !symmetric && !below(&|i, k| matrix[(i, k)] == 0.0) {
            return None;
        }
        let mut half = Vec::with_capacity(pairs(size));
        (0..size).for_each(|k| half.extend_from_slice(&matrix.column(k).as_slice()[..=k]));
        *matrix = DMatrix::zeros(0, 0);
        Some(Folded { size, half, symmetric })
    }

    /// The matrix as it was.
    pub(crate) fn unfolded(self) -> DMatrix<f64> {
        let mut matrix = DMatrix::zeros(self.size, self.size);
        for k in 0..self.size {
            matrix.column_mut(k).rows_mut(0, k + 1).copy_from_slice(&self.half[pair(k, 0)..][..=k]);
        }
        if self.symmetric {
            matrix.fill_lower_triangle_with_upper_triangle();
        }
        matrix
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_unfolded_is_what_was_folded() {
        let symmetric = DMatrix::from_fn(LARGE, LARGE, |i, k| ((i * k + i + k) as f64).sin());
        let mut upper = symmetric.clone();
        upper.fill_lower_triangle(0.0, 1);
        for whole in [symmetric.clone(), upper] {
            let mut matrix = whole.clone();
            let folded = Folded::of(&mut matrix).expect("it follows from its upper half");
            assert!(matrix.is_empty());
            assert!(folded.unfolded() == whole);
        }
        let mut other = symmetric;
        other[(3, 1)] += 1e-9;
        assert!(Folded::of(&mut other).is_none());
        assert_eq!(other.nrows(), LARGE);
    }
}
