//! Symmetric matrices: eigenvalues, pseudo-inverse, indices of pairs. Dense and small; not for inner loops.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// Eigenvalues below this fraction of the largest count as zero in [`pseudo_solve`] and [`pseudo_inverse`].
const RANK_TOLERANCE: f64 = 1e-11;

/// Number of pairs (i ≥ j): p(p+1)/2.
pub fn pairs(p: usize) -> usize {
    p * (p + 1) / 2
}

/// Index of the pair {i, j} in the packed order (0,0), (1,0), (1,1), (2,0), …
pub fn pair(i: usize, j: usize) -> usize {
    let (i, j) = if i >= j { (i, j) } else { (j, i) };
    i * (i + 1) / 2 + j
}

/// Eigenvalues in ascending order, and eigenvectors as columns, each with the sign that makes the entry of largest
/// magnitude positive.
pub fn eigen(a: &DMatrix<f64>) -> (Vec<f64>, DMatrix<f64>) {
    let n = a.nrows();
    if n == 0 {
        return (Vec::new(), DMatrix::zeros(0, 0));
    }
    let (eigenvalues, mut vectors) = decomposed(a);
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&i, &j| eigenvalues[i].total_cmp(&eigenvalues[j]));
    let values = order.iter().map(|&i| eigenvalues[i]).collect();
    for c in 0..n {
        // earlier swaps moved columns: follow the swaps to the present place of the wanted column
        let mut place = order[c];
        while place < c {
            place = order[place];
        }
        vectors.swap_columns(c, place);
    }
    for mut column in vectors.column_iter_mut() {
        if column[column.icamax()] < 0.0 {
            column.neg_mut();
        }
    }
    (values, vectors)
}

/// Eigenvalues and eigenvectors in any order. The tridiagonal method of nalgebra occasionally returns NaN for a sparse
/// singular matrix; plane rotations never do.
fn decomposed(a: &DMatrix<f64>) -> (Vec<f64>, DMatrix<f64>) {
    let symmetric = || DMatrix::from_fn(a.nrows(), a.ncols(), |i, k| (a[(i, k)] + a[(k, i)]) * 0.5);
    let all_known = a.iter().all(|x| x.is_finite());
    let found = SymmetricEigen::new(symmetric());
    let all_finite = found.eigenvalues.iter().chain(found.eigenvectors.iter()).all(|x| x.is_finite());
    if all_finite || !all_known {
        (found.eigenvalues.as_slice().to_vec(), found.eigenvectors)
    } else {
        jacobi(symmetric())
    }
}

/// Largest number of sweeps of rotations; the method converges quadratically, after some six to ten sweeps.
const MAX_SWEEPS: usize = 60;

/// Eigenvalues and eigenvectors by Jacobi's method: a rotation sets each off-diagonal element to zero in turn (Golub
/// and Van Loan, section 8.5).
fn jacobi(mut a: DMatrix<f64>) -> (Vec<f64>, DMatrix<f64>) {
    let n = a.nrows();
    let size = a.amax();
    let mut vectors = DMatrix::identity(n, n);
    if size > 0.0 {
        a /= size;
        for _ in 0..MAX_SWEEPS {
            let largest_off_diagonal: f64 =
                (0..n).flat_map(|i| (0..i).map(move |k| (i, k))).map(|at| a[at].abs()).fold(0.0, f64::max);
            if largest_off_diagonal <= f64::EPSILON * f64::EPSILON {
                break;
            }
            (0..n).flat_map(|i| (0..i).map(move |k| (k, i))).for_each(|(k, i)| rotate(&mut a, &mut vectors, k, i));
        }
    }
    (a.diagonal().iter().map(|x| x * size).collect(), vectors)
}

/// Rotates rows and columns k and i of `a` so that element (k, i) becomes zero, and columns k and i of `vectors`.
fn rotate(a: &mut DMatrix<f64>, vectors: &mut DMatrix<f64>, k: usize, i: usize) {
    if a[(k, i)] == 0.0 {
        return;
    }
    let tau = (a[(i, i)] - a[(k, k)]) / (2.0 * a[(k, i)]);
    let t = tau.signum() / (tau.abs() + tau.hypot(1.0));
    let c = t.hypot(1.0).recip();
    let turn = |x: f64, y: f64| (c * x - t * c * y, t * c * x + c * y);
    let n = a.nrows();
    for m in 0..n {
        (a[(m, k)], a[(m, i)]) = turn(a[(m, k)], a[(m, i)]);
        (vectors[(m, k)], vectors[(m, i)]) = turn(vectors[(m, k)], vectors[(m, i)]);
    }
    for m in 0..n {
        (a[(k, m)], a[(i, m)]) = turn(a[(k, m)], a[(i, m)]);
    }
}

/// Minimum-norm solution of a x = b for positive semidefinite a.
pub fn pseudo_solve(a: &DMatrix<f64>, b: &DVector<f64>) -> DVector<f64> {
    pseudo_inverse(a) * b
}

/// Moore-Penrose inverse of a positive semidefinite matrix.
pub fn pseudo_inverse(a: &DMatrix<f64>) -> DMatrix<f64> {
    let (values, vectors) = eigen(a);
    let floor = values.last().copied().unwrap_or(0.0) * RANK_TOLERANCE;
    from_eigen(&vectors, values.iter().map(|&v| if v > floor && v > 0.0 { 1.0 / v } else { 0.0 }))
}

/// V diag(values) V'.
pub fn from_eigen(vectors: &DMatrix<f64>, values: impl Iterator<Item = f64>) -> DMatrix<f64> {
    let mut scaled = vectors.clone();
    scaled.column_iter_mut().zip(values).for_each(|(mut column, value)| column *= value);
    scaled * vectors.transpose()
}

/// A square root F of a positive semidefinite matrix, FF' = a; eigenvalues below zero count as zero. The eigenvalues
/// are taken after scaling to unit diagonal, so that a large element costs a small element no digits.
pub fn square_root(a: &DMatrix<f64>) -> DMatrix<f64> {
    let (size, values, vectors) = scaled_eigen(a);
    DMatrix::from_fn(a.nrows(), a.ncols(), |i, k| size[i] * vectors[(i, k)] * values[k].max(0.0).sqrt())
}

/// The [`sizes`] s of the diagonal, and eigenvalues and eigenvectors of the matrix with elements a_ij / (s_i s_j).
pub fn scaled_eigen(a: &DMatrix<f64>) -> (Vec<f64>, Vec<f64>, DMatrix<f64>) {
    let size = sizes(a);
    let (values, vectors) = eigen(&divided_by_sizes(a, &size));
    (size, values, vectors)
}

/// [`pseudo_inverse`] taken after scaling to unit diagonal, and scaled back.
pub fn scaled_inverse(a: &DMatrix<f64>) -> DMatrix<f64> {
    let size = sizes(a);
    divided_by_sizes(&pseudo_inverse(&divided_by_sizes(a, &size)), &size)
}

/// Orthonormal basis of the span of the vectors (s_i v_ik)_i for which `seen(λ_k)` is true, with the sizes s,
/// eigenvalues λ and eigenvectors v of [`scaled_eigen`].
pub fn range(a: &DMatrix<f64>, seen: impl Fn(f64) -> bool) -> DMatrix<f64> {
    let (size, values, vectors) = scaled_eigen(a);
    let seen: Vec<usize> = (0..values.len()).filter(|&k| seen(values[k])).collect();
    if seen.is_empty() {
        return DMatrix::zeros(a.nrows(), 0);
    }
    DMatrix::from_fn(values.len(), seen.len(), |i, c| size[i] * vectors[(i, seen[c])]).qr().q()
}

fn divided_by_sizes(a: &DMatrix<f64>, size: &[f64]) -> DMatrix<f64> {
    DMatrix::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)] / size[i] / size[j])
}

/// √a_ii, or 1 where a_ii is not positive.
pub fn sizes(a: &DMatrix<f64>) -> Vec<f64> {
    a.diagonal().iter().map(|x| if *x > 0.0 { x.sqrt() } else { 1.0 }).collect()
}

/// Smallest and largest eigenvalue after scaling to unit diagonal; rows with a zero diagonal are not scaled.
pub fn scaled_range(a: &DMatrix<f64>) -> (f64, f64) {
    let scale: Vec<f64> =
        (0..a.nrows()).map(|i| if a[(i, i)] > 0.0 { a[(i, i)].sqrt().recip() } else { 1.0 }).collect();
    let scaled = DMatrix::from_fn(a.nrows(), a.ncols(), |i, j| scale[i] * a[(i, j)] * scale[j]);
    let (values, _) = eigen(&scaled);
    (values.first().copied().unwrap_or(0.0), values.last().copied().unwrap_or(0.0))
}

/// DAD, D = diag(scale), of a symmetric matrix given by its entries (i, j), i ≥ j. Entries (i, j) and (j, i) get the
/// same bits, although (d_i a_ij) d_j and (d_j a_ji) d_i may round differently.
pub fn scaled(scale: &[f64], entry: impl Fn(usize, usize) -> f64) -> DMatrix<f64> {
    let p = scale.len();
    let mut matrix = DMatrix::zeros(p, p);
    write_scaled(scale, entry, matrix.as_mut_slice());
    matrix
}

/// Writes DAD, as computed by [`scaled`], to a list, row-major.
pub fn write_scaled(scale: &[f64], entry: impl Fn(usize, usize) -> f64, out: &mut [f64]) {
    let p = scale.len();
    for i in 0..p {
        for j in 0..=i {
            let value = scale[i] * entry(i, j) * scale[j];
            (out[i * p + j], out[j * p + i]) = (value, value);
        }
    }
}

/// Whether no eigenvalue is negative beyond rounding, after scaling to unit diagonal.
pub fn is_semidefinite(a: &DMatrix<f64>) -> bool {
    let (least, largest) = scaled_range(a);
    least >= -1e-10 * largest.abs().max(f64::MIN_POSITIVE)
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

    #[test]
    fn a_scaled_matrix_is_symmetric_to_the_last_bit() {
        let scale = [0.1, 0.7, 1.1e-7, 3.3e5];
        let entry = |i: usize, j: usize| ((3 * i + 5 * j) as f64).sin() / 3.0;
        let found = scaled(&scale, entry);
        assert_eq!(found, found.transpose());
        let plain = |i: usize, j: usize| scale[i] * entry(i.max(j), i.min(j)) * scale[j];
        assert_ne!(plain(2, 1).to_bits(), plain(1, 2).to_bits(), "without care two places differ");
        for (i, j) in [(0, 0), (2, 1), (1, 2), (3, 0)] {
            let (found, expected) = (found[(i, j)], plain(i, j));
            assert!((found - expected).abs() <= 1e-15 * expected.abs(), "{found} {expected}");
        }
    }

    #[test]
    fn a_sparse_singular_matrix_has_eigenvalues() {
        // a matrix of which the library's method finds no eigenvalues
        let places = [3, 4, 5, 36, 37, 38];
        let rows = [
            vec![1.7594237517537539],
            vec![1.5670157131225884, 1.3956491395125643],
            vec![0.5794209558922123, 0.5160563175815781, 0.1908173876772996],
            vec![0.07396617788410087, 0.06587734357256113, 0.024358858092361033, 0.0031095382595176906],
            vec![
                -0.3033057773350621,
                -0.2701366958875882,
                -0.0998859559875424,
                -0.01275097545845827,
                0.05228666173974764,
            ],
            vec![
                2.6891571650958435,
                2.395074824107046,
                0.8856047405243294,
                0.11305217235672638,
                -0.4635818423631818,
                4.1101901979998,
            ],
        ];
        let mut a = DMatrix::zeros(55, 55);
        for (i, row) in rows.iter().enumerate() {
            for (k, &x) in row.iter().enumerate() {
                a[(places[i], places[k])] = x;
                a[(places[k], places[i])] = x;
            }
        }
        let (values, vectors) = eigen(&a);
        assert!(values.iter().all(|x| x.is_finite()), "{values:?}");
        let again = &vectors * DMatrix::from_diagonal(&DVector::from_vec(values)) * vectors.transpose();
        assert!((&again - &a).amax() < 1e-14, "{}", (again - &a).amax());
        assert!((vectors.transpose() * &vectors - DMatrix::identity(55, 55)).amax() < 1e-14);
    }

    #[test]
    fn rotations_find_what_the_library_finds() {
        let half = DMatrix::from_fn(6, 6, |i, k| ((3 * i + 5 * k * k) as f64).sin() * 10f64.powi(i as i32 - 3));
        let a = &half * half.transpose();
        let (mut found, vectors) = jacobi(a.clone());
        let again = &vectors * DMatrix::from_diagonal(&DVector::from_vec(found.clone())) * vectors.transpose();
        assert!((&again - &a).amax() < 1e-14 * a.amax(), "{again}{a}");
        found.sort_by(f64::total_cmp);
        for (found, expected) in found.iter().zip(eigen(&a).0) {
            assert!((found - expected).abs() < 1e-14 * a.amax(), "{found} {expected}");
        }
    }
}
