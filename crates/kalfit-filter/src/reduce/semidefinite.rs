//! Factors of positive semidefinite matrices that may be singular.

/// A pivot below minus this fraction of the variance a_jj is negative beyond rounding.
const NEGATIVE_PIVOT: f64 = 1e-12;
/// A pivot up to this fraction of the variance a_jj counts as zero.
const ZERO_PIVOT: f64 = 1e-14;
/// Largest covariance at a zero pivot, as a fraction of the product of the standard deviations: √[`NEGATIVE_PIVOT`].
const ZERO_PIVOT_CORRELATION: f64 = 1e-6;

/// The matrix is not positive semidefinite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NotSemidefinite {
    pub(crate) left: f64,
    pub(crate) variance: f64,
}

/// A = L D L' in place: unit-lower L below the diagonal, D ≥ 0 on it; the upper triangle is not read.
/// Shape: `a` m × m, row-major. Zero pivots are exact zeros, with zeros below them in L.
pub fn ldl(a: &mut [f64], m: usize) -> Result<(), NotSemidefinite> {
    for j in 0..m {
        let variance = a[j * m + j];
        let mut pivot = variance;
        for k in 0..j {
            pivot -= a[j * m + k] * a[j * m + k] * a[k * m + k];
        }
        if variance < 0.0 || pivot < -NEGATIVE_PIVOT * variance {
            return Err(NotSemidefinite { left: pivot, variance });
        }
        let singular = pivot <= ZERO_PIVOT * variance;
        a[j * m + j] = if singular { 0.0 } else { pivot };
        for i in j + 1..m {
            let mut below = a[i * m + j];
            for k in 0..j {
                below -= a[i * m + k] * a[j * m + k] * a[k * m + k];
            }
            if singular && below.abs() > ZERO_PIVOT_CORRELATION * (variance * a[i * m + i].max(0.0)).sqrt() {
                return Err(NotSemidefinite { left: -below.abs(), variance });
            }
            a[i * m + j] = if singular { 0.0 } else { below / pivot };
        }
    }
    Ok(())
}

/// U upper triangular with U'U = A, from the lower triangle of A. Shapes: `a`, result m × m, row-major.
pub(crate) fn root(a: &[f64], m: usize) -> Result<Vec<f64>, NotSemidefinite> {
    let mut factor = a.to_vec();
    ldl(&mut factor, m)?;
    let mut u = vec![0.0; m * m];
    for k in 0..m {
        let pivot = factor[k * m + k].sqrt();
        for i in k..m {
            u[k * m + i] = if i == k { pivot } else { factor[i * m + k] * pivot };
        }
    }
    Ok(u)
}

/// The square-root information form (R, least pivot) of J = R'R, both triangles packed by columns (entry i ≤ k at i +
/// k(k+1)/2). The least pivot is that of J scaled to unit diagonal, without columns of zeros; a pivot up to `zero`
/// gives a row of zeros in R.
pub(crate) fn information_root(j: &[f64], p: usize, zero: f64) -> (Vec<f64>, f64) {
    let mut root = Vec::new();
    let least = information_root_to(&mut root, j, p, zero);
    (root, least)
}

/// As `information_root`, but writes R to `root` in place of the old contents, and returns the least pivot.
pub(crate) fn information_root_to(root: &mut Vec<f64>, j: &[f64], p: usize, zero: f64) -> f64 {
    let at = |i: usize, k: usize| i + k * (k + 1) / 2;
    root.clear();
    root.resize(j.len() + p, 0.0);
    let (r, scale) = root.split_at_mut(j.len());
    (0..p).for_each(|i| scale[i] = j[at(i, i)].sqrt());
    let mut least = f64::INFINITY;
    for k in 0..p {
        if scale[k] == 0.0 {
            continue;
        }
        for i in 0..=k {
            if scale[i] == 0.0 {
                continue;
            }
            let mut left = j[at(i, k)] / (scale[i] * scale[k]);
            for l in 0..i {
                left -= r[at(l, i)] * r[at(l, k)];
            }
            let pivot = r[at(i, i)];
            r[at(i, k)] = if i < k {
                if pivot > 0.0 { left / pivot } else { 0.0 }
            } else {
                least = if left < least || left.is_nan() { left } else { least };
                if left > zero { left.sqrt() } else { 0.0 }
            };
        }
    }
    for k in 0..p {
        for i in 0..=k {
            r[at(i, k)] *= scale[k];
        }
    }
    root.truncate(j.len());
    least
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn singular_matrices_have_roots() {
        let a = [4.0, 0.0, 0.0, 2.0, 1.0, 0.0, -4.0, -2.0, 9.0]; // rank 2, lower triangle
        let u = root(&a, 3).expect("semidefinite");
        for i in 0..3 {
            for j in 0..=i {
                let back: f64 = (0..3).map(|k| u[k * 3 + i] * u[k * 3 + j]).sum();
                assert!((back - a[i * 3 + j]).abs() < 1e-14, "{i},{j}: {back} against {}", a[i * 3 + j]);
            }
        }
        assert_eq!(u[4], 0.0);
        assert_eq!(root(&[0.0; 4], 2), Ok(vec![0.0; 4]));
    }

    #[test]
    fn indefinite_matrices_are_refused_with_the_figures() {
        assert_eq!(root(&[1.0, 0.0, 2.0, 1.0], 2), Err(NotSemidefinite { left: -3.0, variance: 1.0 }));
        assert_eq!(root(&[0.0, 0.0, 0.1, 1.0], 2), Err(NotSemidefinite { left: -0.1, variance: 0.0 }));
        assert_eq!(root(&[-1.0], 1), Err(NotSemidefinite { left: -1.0, variance: -1.0 }));
    }

    #[test]
    fn information_has_a_root_with_zero_columns_and_its_least_pivot() {
        let (r, least) = information_root(&[4.0, 0.0, 0.0, 2.0, 0.0, 1.0 + 1e-6], 3, 1e-13);
        assert_eq!(&r[..5], &[2.0, 0.0, 0.0, 1.0, 0.0]);
        assert!((r[5] - 1e-3).abs() < 1e-12, "{}", r[5]);
        assert!((least - 1e-6).abs() < 1e-11, "{least}");
    }
}
