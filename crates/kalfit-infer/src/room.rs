//! How far one element of Σ can change while Σ stays positive semidefinite and all other elements stay.
//!
//! With P = Σ⁻¹, the eigenvalues of Σ⁻¹(e_i e_j' + e_j e_i') that are not zero are P_ij ± √(P_ii P_jj), so a covariance
//! can change by -1/(√(P_ii P_jj) + P_ij) to 1/(√(P_ii P_jj) - P_ij), and a variance can fall by 1/P_ii.

use nalgebra::DMatrix;

/// Least and largest change of element (i, j). Where Σ is singular, other elements have to change too, and only the
/// correlation of the two states bounds the change.
pub(crate) fn room(sigma: &DMatrix<f64>, (i, j): (usize, usize)) -> [f64; 2] {
    let varying: Vec<usize> = (0..sigma.nrows()).filter(|&k| sigma[(k, k)] > 0.0).collect();
    let place = |k: usize| varying.iter().position(|&other| other == k);
    let (Some(a), Some(b)) = (place(i), place(j)) else { return [0.0, f64::INFINITY] };
    let unit = (sigma[(i, i)] * sigma[(j, j)]).sqrt();
    let correlation = DMatrix::from_fn(varying.len(), varying.len(), |k, l| {
        let (k, l) = (varying[k], varying[l]);
        sigma[(k, l)] / (sigma[(k, k)] * sigma[(l, l)]).sqrt()
    });
    let rho = correlation[(a, b)];
    let inverse = correlation.cholesky().map(|root| root.inverse()).filter(|p| p.iter().all(|x| x.is_finite()));
    let [low, high] = match (inverse, i == j) {
        (Some(p), true) => [-p[(a, a)].recip(), f64::INFINITY],
        (None, true) => [-1.0, f64::INFINITY],
        (Some(p), false) => {
            let size = (p[(a, a)] * p[(b, b)]).sqrt();
            [-(size + p[(a, b)]).recip(), (size - p[(a, b)]).recip()]
        }
        (None, false) => [(-1.0 - rho).min(0.0), (1.0 - rho).max(0.0)],
    };
    [unit * low, unit * high]
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_algebra::symmetric;

    #[test]
    fn at_either_end_the_matrix_is_singular() {
        let sigma = DMatrix::from_row_slice(3, 3, &[4.0, 1.0, -0.6, 1.0, 0.25, 0.0, -0.6, 0.0, 9.0])
            + DMatrix::from_diagonal_element(3, 3, 0.3);
        for (i, j) in [(0, 0), (1, 0), (2, 0), (2, 1), (2, 2)] {
            for change in room(&sigma, (i, j)).into_iter().filter(|change| change.is_finite()) {
                let mut moved = sigma.clone();
                moved[(i, j)] += change;
                moved[(j, i)] = moved[(i, j)];
                let least = symmetric::eigen(&moved).0[0];
                assert!(least.abs() < 1e-12, "({i}, {j}) by {change}: least eigenvalue {least}");
            }
        }
    }

    #[test]
    fn beside_a_singular_block_the_correlation_counts() {
        let sigma = DMatrix::from_row_slice(3, 3, &[1.0, 2.0, 0.0, 2.0, 4.0, 0.0, 0.0, 0.0, 9.0]);
        assert_eq!(room(&sigma, (2, 0)), [-3.0, 3.0]);
        let mut flat = sigma.clone();
        flat.fill_row(2, 0.0);
        flat.fill_column(2, 0.0);
        assert_eq!(room(&flat, (2, 2)), [0.0, f64::INFINITY], "a variance of zero can only grow");
    }
}
