//! The sums and derivatives that a pass computes.

use nalgebra::DMatrix;

use crate::point::Regressors;
use kalfit_algebra::elements::Elements;
use kalfit_algebra::symmetric::pairs;

pub use kalfit_model::remote::Detail as Order;

/// Bytes that the sums of all tasks of a pass may occupy at the same time, if there are several tasks.
const SUMS_BYTES: usize = 64 << 20;

/// Maximum number of tasks of a pass over p states: each task has separate sums, two matrices (pairs of states × pairs
/// of states). A task with many states is itself split over several threads.
pub(crate) fn max_tasks(p: usize) -> usize {
    (SUMS_BYTES / (16 * pairs(p).pow(2)).max(1)).max(1)
}

/// Number of matrices (elements of Σ × elements of Σ) that a fit holds at the same time, as measured.
const FULL_MATRICES: u64 = 5;
/// Number of square matrices over the elements (i, j) with i and j in two different blocks that a fit holds at the same
/// time, as measured.
const BETWEEN_MATRICES: u64 = 4;

/// Approximate number of bytes that a fit needs for second derivatives by the elements of Σ, from the number of states
/// in each block. Memory for the tests is not included.
pub fn memory(blocks: &[usize]) -> u64 {
    let square = |n: usize| (n as u64).saturating_mul(n as u64);
    let elements = blocks.iter().map(|&p| pairs(p)).fold(0, usize::saturating_add);
    let pairs_of_blocks = blocks.iter().enumerate().flat_map(|(f, p)| blocks[..f].iter().map(move |q| p * q));
    let between = pairs_of_blocks.map(square).fold(0, u64::saturating_add);
    (square(elements).saturating_mul(FULL_MATRICES))
        .saturating_add(between.saturating_mul(BETWEEN_MATRICES))
        .saturating_mul(8)
}

/// Input of the restricted likelihood for every class: X = E × jacobian, the derivative of the mean by its free
/// coordinates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FlatMean<'a> {
    /// d(mean coordinates) / d(free mean coordinates).
    pub(crate) jacobian: &'a DMatrix<f64>,
    /// V, the covariance of the free mean coordinates, q × q.
    pub(crate) covariance: Option<&'a DMatrix<f64>>,
}

/// The sums that a pass is to compute.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SumsWanted<'a> {
    pub(crate) elements: &'a Elements,
    pub(crate) regressors: &'a Regressors,
    pub(crate) order: Order,
    pub(crate) flat: Option<&'a FlatMean<'a>>,
}
