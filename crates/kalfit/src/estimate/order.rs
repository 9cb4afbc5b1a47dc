//! What a pass is asked for.

use nalgebra::DMatrix;

use crate::estimate::point::Regressors;
use crate::linalg::elements::Elements;

/// Which derivatives a pass computes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Order {
    /// ℓ and the first derivatives: all that EM needs. The information on the mean only within phases.
    First,
    /// And all of the information on the mean.
    Mean,
    /// And the observed information.
    Second,
    /// And the expected information of Σ.
    Expected,
}

/// What the restricted likelihood needs of every class: X = E × jacobian, the mean by its free coordinates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FlatMean<'a> {
    /// d(mean coordinates) / d(free mean coordinates).
    pub(crate) jacobian: &'a DMatrix<f64>,
    /// V, the covariance of the free mean coordinates.
    pub(crate) covariance: Option<&'a DMatrix<f64>>,
}

/// What a pass adds up.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted<'a> {
    pub(crate) elements: &'a Elements,
    pub(crate) regressors: &'a Regressors,
    pub(crate) order: Order,
    pub(crate) flat: Option<&'a FlatMean<'a>>,
}
