//! The information that a suboptimal filter loses, test by test.

use nalgebra::DMatrix;

use crate::reduce::ReductionRef;
use kalfit_algebra::symmetric;
use kalfit_model::unpack;

/// Information below zero by this part of the whole is rounding error.
const ROUNDING: f64 = 1e-7;
/// Scaled information below this part of the largest is none.
const UNINFORMED: f64 = 1e-9;

/// J_raw - J of one test.
#[derive(Debug, Clone, PartialEq)]
pub struct Lost {
    /// J_raw - J, positive semidefinite, p × p.
    pub information: DMatrix<f64>,
    /// The least and the largest part of the information on any direction that J_raw informs of: from 0, where nothing is lost,
    /// to 1, where all is.
    pub range: (f64, f64),
}

/// Why there is no difference.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LostError {
    /// They are not of one test.
    #[error("a reduction of test `{found}` cannot be compared with one of test `{expected}`")]
    OtherTest {
        /// Test of the estimates.
        found: String,
        /// Test of the measurements.
        expected: String,
    },
    /// They are not of one model.
    #[error("test `{test}`: the estimates are of {found} states, the measurements of {expected}")]
    OtherModel {
        /// The test.
        test: String,
        /// Elements of ξ that the estimates speak of.
        found: usize,
        /// Those that the measurements speak of.
        expected: usize,
    },
    /// No function of measurements says more than they do.
    #[error(
        "test `{test}`: the estimates say more than the measurements, by {excess:.1e} of the information: they are not of the same data or model"
    )]
    Gained {
        /// The test.
        test: String,
        /// Minus the smallest eigenvalue.
        excess: f64,
    },
}

/// What the estimates of a test say less than its measurements. Both are reductions at one α and in the same coordinates.
///
/// # Errors
/// Reductions of different tests or models, and estimates that say more than the measurements.
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
    if least < -ROUNDING {
        return Err(LostError::Gained { test: raw.test.to_owned(), excess: -least });
    }
    Ok(Lost { information, range: parts(&scale(&whole), &missing) })
}

/// Least and largest eigenvalue of `missing` relative to `whole`, on what `whole` informs of.
fn parts(whole: &DMatrix<f64>, missing: &DMatrix<f64>) -> (f64, f64) {
    let (values, vectors) = symmetric::eigen(whole);
    let floor = values.last().map_or(0.0, |largest| UNINFORMED * largest);
    let kept: Vec<usize> = (0..values.len()).filter(|&k| values[k] > floor).collect();
    let white = DMatrix::from_fn(whole.nrows(), kept.len(), |i, k| vectors[(i, kept[k])] / values[kept[k]].sqrt());
    let (parts, _) = symmetric::eigen(&(white.transpose() * missing * white));
    let part = |x: Option<&f64>| x.map_or(0.0, |x| x.clamp(0.0, 1.0));
    (part(parts.first()), part(parts.last()))
}

/// J = R'R.
fn information(reduction: ReductionRef<'_>) -> DMatrix<f64> {
    let factor = unpack(reduction.factor, reduction.data.len());
    factor.transpose() * factor
}
