//! Estimate from a test alone, without the population: ξ̂ = J⁺ R'd, for the states that the test determines.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use kalfit_algebra::symmetric;
use kalfit_filter::reduce::ReductionRef;
use kalfit_model::FreeStates;
use kalfit_model::unpack;

/// Largest number of tests for which estimates from single tests are recorded; such estimates double the size of the
/// record.
pub(super) const MOST_SINGLE_ESTIMATES: usize = 2000;
/// Eigenvalue of J, scaled to unit diagonal, below which a direction has no information.
const LEAST_EIGENVALUE: f64 = 1e-11;
/// Largest norm of the part of a state's unit vector along directions without information at which the state counts as
/// determined.
const MOST_UNOBSERVED_PART: f64 = 1e-6;

/// The estimate of ξ in one phase from the test alone, without the population.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OwnRecord {
    /// Estimate of each state; null if the test alone does not determine it.
    pub mean: Vec<Option<f64>>,
    /// Error covariance; null where either state is not determined.
    pub covariance: Vec<Vec<Option<f64>>>,
}

/// Estimate from a test alone, over all phases.
pub(super) struct TestEstimate {
    mean: Vec<Option<f64>>,
    covariance: Vec<Vec<Option<f64>>>,
}

impl TestEstimate {
    /// The estimate from a reduction.
    pub(super) fn of(reduction: ReductionRef<'_>) -> TestEstimate {
        let (factor, data) =
            (unpack(reduction.factor, reduction.data.len()), DVector::from_column_slice(reduction.data));
        let Some(exact) = reduction.exact else { return TestEstimate::least_squares(&factor, &data) };
        let FreeStates { origin, basis } = exact.free_states(data.len());
        TestEstimate::least_squares(&(&factor * &basis), &(data - factor * &origin)).transformed(&origin, &basis)
    }

    /// Transforms an estimate of η into that of ξ = origin + basis η.
    fn transformed(&self, origin: &DVector<f64>, basis: &DMatrix<f64>) -> TestEstimate {
        let p = origin.len();
        let needs = |i: usize| (0..self.mean.len()).filter(move |&c| basis[(i, c)] != 0.0);
        let mean = |i: usize| {
            needs(i).map(|c| Some(basis[(i, c)] * self.mean[c]?)).try_fold(origin[i], |sum, x| Some(sum + x?))
        };
        let entry = |i: usize, k: usize| {
            let term = |(c, d): (usize, usize)| Some(basis[(i, c)] * self.covariance[c][d]? * basis[(k, d)]);
            needs(i).flat_map(|c| needs(k).map(move |d| (c, d))).map(term).try_fold(0.0, |sum, x| Some(sum + x?))
        };
        let mean: Vec<Option<f64>> = (0..p).map(mean).collect();
        let of_two = |i: usize, k: usize| mean[i].and(mean[k]).and(entry(i.max(k), i.min(k)));
        let covariance = (0..p).map(|i| (0..p).map(|k| of_two(i, k)).collect()).collect();
        TestEstimate { mean, covariance }
    }

    /// Least-squares solution of R ξ = d.
    fn least_squares(factor: &DMatrix<f64>, data: &DVector<f64>) -> TestEstimate {
        let (rows, p) = factor.shape();
        let scale: Vec<f64> = (0..p).map(|k| factor.column(k).norm()).collect();
        let inverse = |k: usize| if scale[k] > 0.0 { scale[k].recip() } else { 0.0 };
        let scaled = DMatrix::from_fn(rows, p, |i, k| factor[(i, k)] * inverse(k));
        let (values, vectors) = symmetric::eigen(&(scaled.transpose() * &scaled));
        let unobserved_part =
            |i: usize| (0..p).filter(|&k| values[k] < LEAST_EIGENVALUE).fold(0.0, |n: f64, k| n.hypot(vectors[(i, k)]));
        let determined: Vec<bool> =
            (0..p).map(|i| scale[i] > 0.0 && unobserved_part(i) <= MOST_UNOBSERVED_PART).collect();
        // S = V diag(1/λ) V' over directions with information; J⁺ in the units of the states is D S D
        let root =
            DMatrix::from_fn(
                p,
                p,
                |i, k| if values[k] < LEAST_EIGENVALUE { 0.0 } else { vectors[(i, k)] / values[k].sqrt() },
            );
        let inverted = &root * root.transpose();
        let right = scaled.transpose() * data;
        let solution = &inverted * right;
        let known = |x: f64| Some(x).filter(|x| x.is_finite());
        let units: Vec<f64> = (0..p).map(inverse).collect();
        let errors = symmetric::scaled(&units, |i, k| inverted[(i, k)]);
        let entry = |i: usize, k: usize| if determined[i] && determined[k] { known(errors[(i, k)]) } else { None };
        TestEstimate {
            mean: (0..p).map(|i| if determined[i] { known(solution[i] * inverse(i)) } else { None }).collect(),
            covariance: (0..p).map(|i| (0..p).map(|k| entry(i, k)).collect()).collect(),
        }
    }

    /// The estimate in one phase; `None` where no state of the phase is determined.
    pub(super) fn part(&self, cut: &super::cut::BlockCut<'_>) -> Option<OwnRecord> {
        let mean = cut.list(&self.mean);
        mean.iter().any(Option::is_some).then(|| OwnRecord { mean, covariance: cut.square(&self.covariance) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_model::Path;
    use kalfit_model::Reduction;

    fn reduction(factor: &[f64], data: &[f64]) -> Reduction {
        Reduction {
            test: "t".to_owned(),
            constant: 0.0,
            residual: None,
            data: data.to_vec(),
            factor: factor.to_vec(),
            covariates: vec![],
            steps: 1,
            observations: 1,
            path: Path::Information,
            design: 0,
            chain: None,
            exact: None,
        }
    }

    #[test]
    fn a_regular_test_has_the_least_squares_estimate() {
        // R = [2 1; 0 4], d = (4, 8)': ξ = (1, 2)'; J⁻¹ = R⁻¹R⁻ᵀ by hand
        let own = TestEstimate::of(reduction(&[2.0, 1.0, 4.0], &[4.0, 8.0]).view());
        let mean: Vec<f64> = own.mean.iter().map(|x| x.unwrap()).collect();
        assert!((mean[0] - 1.0).abs() < 1e-12 && (mean[1] - 2.0).abs() < 1e-12, "{mean:?}");
        let expected = [[0.25 + 1.0 / 64.0, -1.0 / 32.0], [-1.0 / 32.0, 1.0 / 16.0]];
        for i in 0..2 {
            for k in 0..2 {
                let found = own.covariance[i][k].unwrap();
                assert!((found - expected[i][k]).abs() < 1e-12, "{i} {k}: {found} {}", expected[i][k]);
            }
        }
    }

    #[test]
    fn what_a_test_does_not_determine_is_null_whatever_the_units() {
        // the sum of the first two states is measured, the third by itself, the fourth not at all
        let factor = [1.0, 1e6, 0.0, 0.0, 0.0, 1e-9, 0.0, 0.0, 0.0, 0.0];
        let own = TestEstimate::of(reduction(&factor, &[3.0, 0.0, 2e-9, 0.0]).view());
        assert_eq!((own.mean[0], own.mean[1], own.mean[3]), (None, None, None));
        assert!((own.mean[2].unwrap() - 2.0).abs() < 1e-9, "{:?}", own.mean[2]);
        assert!((own.covariance[2][2].unwrap() * 1e-18 - 1.0).abs() < 1e-9);
        assert!(own.covariance[0].iter().all(Option::is_none));
    }
}
