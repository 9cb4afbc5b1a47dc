//! Symmetric matrices: eigenvalues, pseudo-inverse, indices of pairs. Dense and small; not for inner loops.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// Eigenvalues below this part of the largest count as zero in [`pseudo_solve`] and [`pseudo_inverse`].
pub const RANK_TOLERANCE: f64 = 1e-11;

/// Number of pairs (i ≥ j): p(p+1)/2.
pub fn pairs(p: usize) -> usize {
    p * (p + 1) / 2
}

/// Index of the pair {i, j} in the packed order (0,0), (1,0), (1,1), (2,0), …
pub fn pair(i: usize, j: usize) -> usize {
    let (i, j) = if i >= j { (i, j) } else { (j, i) };
    i * (i + 1) / 2 + j
}

/// Eigenvalues and eigenvectors (columns), in ascending order, signs fixed so that the largest entry is positive.
pub fn eigen(a: &DMatrix<f64>) -> (Vec<f64>, DMatrix<f64>) {
    let n = a.nrows();
    if n == 0 {
        return (Vec::new(), DMatrix::zeros(0, 0));
    }
    let symmetric = (a + a.transpose()) * 0.5;
    let decomposition = SymmetricEigen::new(symmetric);
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&i, &j| decomposition.eigenvalues[i].total_cmp(&decomposition.eigenvalues[j]));
    let values = order.iter().map(|&i| decomposition.eigenvalues[i]).collect();
    let mut vectors = DMatrix::zeros(n, n);
    for (c, &i) in order.iter().enumerate() {
        let column = decomposition.eigenvectors.column(i);
        let largest = column[column.icamax()];
        vectors.set_column(c, &(column * if largest < 0.0 { -1.0 } else { 1.0 }));
    }
    (values, vectors)
}

/// Minimum-norm solution of a x = b for positive semidefinite a.
pub fn pseudo_solve(a: &DMatrix<f64>, b: &DVector<f64>) -> DVector<f64> {
    pseudo_inverse(a) * b
}

/// Moore-Penrose inverse of a positive semidefinite matrix.
pub fn pseudo_inverse(a: &DMatrix<f64>) -> DMatrix<f64> {
    let (values, vectors) = eigen(a);
    let floor = values.last().copied().unwrap_or(0.0) * RANK_TOLERANCE;
    let inverse = values.iter().map(|&v| if v > floor && v > 0.0 { 1.0 / v } else { 0.0 });
    let inverse = DMatrix::from_diagonal(&DVector::from_iterator(values.len(), inverse));
    &vectors * inverse * vectors.transpose()
}

/// A square root F of a positive semidefinite matrix, FF' = a; eigenvalues below zero count as zero. They are those after
/// scaling to unit diagonal, so that a large element costs a small one no digits.
pub fn square_root(a: &DMatrix<f64>) -> DMatrix<f64> {
    let size = sizes(a);
    let (values, vectors) = eigen(&DMatrix::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)] / size[i] / size[j]));
    DMatrix::from_fn(a.nrows(), a.ncols(), |i, k| size[i] * vectors[(i, k)] * values[k].max(0.0).sqrt())
}

/// √a_ii, or one where that is zero.
pub fn sizes(a: &DMatrix<f64>) -> Vec<f64> {
    a.diagonal().iter().map(|x| if *x > 0.0 { x.sqrt() } else { 1.0 }).collect()
}

/// Smallest and largest eigenvalue after scaling to unit diagonal; zero diagonals are left as they are.
pub fn scaled_range(a: &DMatrix<f64>) -> (f64, f64) {
    let scale: Vec<f64> =
        (0..a.nrows()).map(|i| if a[(i, i)] > 0.0 { a[(i, i)].sqrt().recip() } else { 1.0 }).collect();
    let scaled = DMatrix::from_fn(a.nrows(), a.ncols(), |i, j| scale[i] * a[(i, j)] * scale[j]);
    let (values, _) = eigen(&scaled);
    (values.first().copied().unwrap_or(0.0), values.last().copied().unwrap_or(0.0))
}

/// True when no eigenvalue is negative beyond rounding.
pub fn is_semidefinite(a: &DMatrix<f64>) -> bool {
    let (least, largest) = scaled_range(a);
    least >= -1e-10 * largest.abs().max(f64::MIN_POSITIVE)
}

/// Matrix over pairs of elements of symmetric matrices whose entry (σ_kl, σ_ab) sums `term(k, l, a, b)` over the places
/// that the two elements stand in: one for a diagonal element, two for another.
pub fn over_pairs(p: usize, term: impl Fn(usize, usize, usize, usize) -> f64) -> DMatrix<f64> {
    let mut result = DMatrix::zeros(pairs(p), pairs(p));
    for k in 0..p {
        for l in 0..p {
            for a in 0..p {
                for b in 0..p {
                    result[(pair(k, l), pair(a, b))] += term(k, l, a, b);
                }
            }
        }
    }
    (&result + result.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_root_keeps_the_digits_of_small_elements() {
        let a = DMatrix::from_row_slice(3, 3, &[4e18, 3e9, 0.0, 3e9, 2.5, 0.0, 0.0, 0.0, 0.0]);
        let root = square_root(&a);
        let product = &root * root.transpose();
        for (found, expected) in product.iter().zip(&a) {
            assert!((found - expected).abs() <= 1e-14 * expected.abs(), "{found} {expected}");
        }
    }
}
