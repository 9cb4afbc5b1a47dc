//! Whether a matrix can be a covariance.

use nalgebra::{DMatrix, SymmetricEigen};

use crate::error::StructureProblem;

/// Rounding that is forgiven, in units of the correlations.
const TOLERANCE: f64 = 1e-10;

/// Why a matrix is not a covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum CovarianceDefect {
    /// A negative variance.
    Negative(usize, f64),
    /// A covariance beside the zero variance of the first.
    NoVariance(usize, usize),
    /// A correlation beyond one.
    Correlation(usize, usize, f64),
    /// Eigenvalues of the matrix scaled to unit diagonal.
    Eigenvalues { least: f64, largest: f64 },
}

/// The first defect of a symmetric matrix whose entries are known in part; an unknown entry may be anything but the
/// covariance of a zero variance. Eigenvalues are looked at where all entries between known variances are known.
pub(crate) fn defect(matrix: &[Vec<Option<f64>>]) -> Option<CovarianceDefect> {
    let p = matrix.len();
    for i in 0..p {
        if let Some(variance) = matrix[i][i].filter(|variance| *variance < 0.0) {
            return Some(CovarianceDefect::Negative(i, variance));
        }
    }
    let mut correlations = DMatrix::identity(p, p);
    let mut complete = true;
    for i in 0..p {
        for j in 0..i {
            let entry = matrix[i][j];
            for (one, other) in [(i, j), (j, i)] {
                if matrix[one][one] == Some(0.0) && entry != Some(0.0) {
                    return Some(CovarianceDefect::NoVariance(one, other));
                }
            }
            let (Some(a), Some(b)) = (matrix[i][i], matrix[j][j]) else { continue };
            let Some(covariance) = entry else {
                complete = false;
                continue;
            };
            let correlation = if covariance == 0.0 { 0.0 } else { covariance / a.sqrt() / b.sqrt() };
            let possible = correlation.abs() <= 1.0 + TOLERANCE; // false for NaN too
            if !possible {
                return Some(CovarianceDefect::Correlation(i, j, correlation));
            }
            correlations[(i, j)] = correlation;
            correlations[(j, i)] = correlation;
        }
    }
    let eigenvalues = if complete && p > 2 { SymmetricEigen::new(correlations).eigenvalues } else { return None };
    let (least, largest) = (eigenvalues.min(), eigenvalues.max());
    (least < -TOLERANCE * largest).then_some(CovarianceDefect::Eigenvalues { least, largest })
}

impl CovarianceDefect {
    /// The elements that it is about.
    pub(crate) fn element(&self) -> Option<(usize, usize)> {
        match *self {
            CovarianceDefect::Negative(i, _) => Some((i, i)),
            CovarianceDefect::NoVariance(i, j) | CovarianceDefect::Correlation(i, j, _) => Some((i.max(j), i.min(j))),
            CovarianceDefect::Eigenvalues { .. } => None,
        }
    }

    /// The message, with names for the rows.
    pub(crate) fn problem(&self, place: &str, name: &dyn Fn(usize) -> String) -> StructureProblem {
        let place = place.to_owned();
        match *self {
            CovarianceDefect::Negative(i, found) => StructureProblem::NegativeVariance { name: name(i), place, found },
            CovarianceDefect::NoVariance(i, j) => {
                StructureProblem::CovarianceWithoutVariance { first: name(i), second: name(j), place }
            }
            CovarianceDefect::Correlation(i, j, found) => {
                StructureProblem::Correlation { first: name(j), second: name(i), place, found }
            }
            CovarianceDefect::Eigenvalues { least, largest } => {
                StructureProblem::NotSemidefinite { place, least, largest }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known(rows: &[&[f64]]) -> Vec<Vec<Option<f64>>> {
        rows.iter().map(|row| row.iter().copied().map(Some).collect()).collect()
    }

    #[test]
    fn a_singular_covariance_has_no_defect_whatever_its_units() {
        assert_eq!(defect(&known(&[&[1e-12, 1e-3], &[1e-3, 1e6]])), None);
        assert_eq!(defect(&known(&[&[0.0, 0.0], &[0.0, 4.0]])), None);
        assert_eq!(defect(&known(&[&[0.01, 0.1, 0.3], &[0.1, 1.0, 3.0], &[0.3, 3.0, 9.0]])), None);
    }

    #[test]
    fn pairs_may_be_possible_and_the_whole_not() {
        let matrix = known(&[&[1.0, 0.9, -0.9], &[0.9, 1.0, 0.9], &[-0.9, 0.9, 1.0]]);
        let Some(CovarianceDefect::Eigenvalues { least, .. }) = defect(&matrix) else {
            panic!("{:?}", defect(&matrix))
        };
        assert!((least + 0.8).abs() < 1e-12, "smallest eigenvalue {least}, expected -0.8");
    }

    #[test]
    fn extreme_entries_give_a_defect_and_no_nan() {
        assert!(matches!(
            defect(&known(&[&[1e-300, 1e300], &[1e300, 1e-300]])),
            Some(CovarianceDefect::Correlation(..))
        ));
    }

    #[test]
    fn unknown_entries_are_free_unless_a_variance_is_zero() {
        assert_eq!(defect(&[vec![Some(1.0), None], vec![None, Some(1.0)]]), None);
        assert_eq!(defect(&[vec![Some(0.0), None], vec![None, Some(1.0)]]), Some(CovarianceDefect::NoVariance(0, 1)));
    }
}
