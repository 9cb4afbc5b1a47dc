//! What a pass is asked for.

use nalgebra::DMatrix;

use crate::estimate::point::Regressors;
use crate::linalg::elements::Elements;
use crate::linalg::symmetric::pairs;

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

/// Bytes that the sums of all tasks of a pass may occupy at the same time, where that is up to us.
const ROOM: usize = 256 << 20;

/// The most tasks that a pass over p states is parted into: each has sums of its own, two matrices over pairs of states.
pub(crate) fn most_tasks(p: usize) -> usize {
    (ROOM / (16 * pairs(p).pow(2)).max(1)).max(2)
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
