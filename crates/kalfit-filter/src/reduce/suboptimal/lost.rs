//! The information that a suboptimal filter loses, test by test.

use nalgebra::DMatrix;

use crate::reduce::ReductionRef;
use kalfit_algebra::symmetric;
use kalfit_model::unpack;

/// Negative information up to this fraction of the whole is rounding error.
const NEGATIVE_FRACTION: f64 = 1e-7;
/// Scaled information up to this fraction of the largest counts as none.
const UNINFORMED: f64 = 1e-9;

/// The information J_raw - J that is lost for one test.
#[derive(Debug, Clone, PartialEq)]
pub struct Lost {
    /// J_raw - J, positive semidefinite, p × p.
    pub information: DMatrix<f64>,
    /// (smallest, largest) lost fraction of the information, over all directions in which J_raw has information: from
    /// 0, where nothing is lost, to 1, where all is lost.
    pub range: (f64, f64),
}

/// Reason why the lost information cannot be computed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LostError {
    /// The reductions are of different tests.
    #[error("a reduction of test `{found}` cannot be compared with one of test `{expected}`")]
    OtherTest {
        /// Id of the test of the estimates.
        found: String,
        /// Id of the test of the measurements.
        expected: String,
    },
    /// The reductions are of different models.
    #[error("test `{test}`: the estimates are of {found} states, the measurements of {expected}")]
    OtherModel {
        /// Id of the test.
        test: String,
        /// Number of elements of ξ in the reduction of the estimates.
        found: usize,
        /// Number of elements of ξ in the reduction of the measurements.
        expected: usize,
    },
    /// The estimates have more information than the measurements, as no function of the measurements can have.
    #[error(
        "test `{test}`: the estimates say more than the measurements, by {excess:.1e} of the information: they are not of the same data or model"
    )]
    Gained {
        /// Id of the test.
        test: String,
        /// Minus the smallest eigenvalue of the scaled J_raw - J.
        excess: f64,
    },
}

/// The information that the estimates of a test lose compared with the measurements. `raw` and `suboptimal` are
/// reductions of the test at one α, in one system of coordinates.
///
/// # Errors
/// Reductions of different tests or models, and estimates with more information than the measurements.
pub fn lost(raw: ReductionRef<'_>, suboptimal: ReductionRef<'_>) -> Result<Lost, LostError> {
    if raw.test != suboptimal.test {
        return Err(LostError::OtherTest { found: suboptimal.test.to_owned(), expected: raw.test.to_owned() });
    }
    let (found, expected) = (suboptimal.data.len(), raw.data.len());
    if found != expected {
        return Err(LostError::OtherModel { test: raw.test.to_owned(), found, expected });
    }
    let whole = information(raw);
    let size = symmetric::sizes(&whole);
    let information = &whole - information(suboptimal);
    let scale = |a: &DMatrix<f64>| DMatrix::from_fn(expected, expected, |i, j| a[(i, j)] / size[i] / size[j]);
    let missing = scale(&information);
    let least = symmetric::eigen(&missing).0.first().copied().unwrap_or(0.0);
    if least < -NEGATIVE_FRACTION {
        return Err(LostError::Gained { test: raw.test.to_owned(), excess: -least });
    }
    Ok(Lost { information, range: lost_fractions(&scale(&whole), &missing) })
}

/// (smallest, largest) eigenvalue of `missing` relative to `whole`, in the directions in which `whole` has information.
fn lost_fractions(whole: &DMatrix<f64>, missing: &DMatrix<f64>) -> (f64, f64) {
    let (values, vectors) = symmetric::eigen(whole);
    let floor = values.last().map_or(0.0, |largest| UNINFORMED * largest);
    let kept: Vec<usize> = (0..values.len()).filter(|&k| values[k] > floor).collect();
    let white = DMatrix::from_fn(whole.nrows(), kept.len(), |i, k| vectors[(i, kept[k])] / values[kept[k]].sqrt());
    let (lost_fractions, _) = symmetric::eigen(&(white.transpose() * missing * white));
    let part = |x: Option<&f64>| x.map_or(0.0, |x| x.clamp(0.0, 1.0));
    (part(lost_fractions.first()), part(lost_fractions.last()))
}

/// J = R'R.
fn information(reduction: ReductionRef<'_>) -> DMatrix<f64> {
    let factor = unpack(reduction.factor, reduction.data.len());
    factor.transpose() * factor
}
