//! What a pass is asked for.

use nalgebra::DMatrix;

use crate::point::Regressors;
use kalfit_algebra::elements::Elements;
use kalfit_algebra::symmetric::pairs;

pub use kalfit_model::remote::Detail as Order;

/// Bytes that the sums of all tasks of a pass may occupy at the same time, if they are several.
const ROOM: usize = 64 << 20;

/// The most tasks that a pass over p states is parted into: each has sums of its own, two matrices over pairs of states. A task of many
/// states is itself the work of several threads.
pub(crate) fn most_tasks(p: usize) -> usize {
    (ROOM / (16 * pairs(p).pow(2)).max(1)).max(1)
}

/// Matrices over all elements of Σ that a fit holds at the same time, and those of them by elements between two blocks, as measured.
const MATRICES: u64 = 5;
const BETWEEN: u64 = 4;

/// About how many bytes a fit takes for second derivatives by the elements of Σ, which has blocks of so many states. What tests take
/// comes on top.
pub fn memory(blocks: &[usize]) -> u64 {
    let square = |n: usize| (n as u64).saturating_mul(n as u64);
    let elements = blocks.iter().map(|&p| pairs(p)).fold(0, usize::saturating_add);
    let pairs_of_blocks = blocks.iter().enumerate().flat_map(|(f, p)| blocks[..f].iter().map(move |q| p * q));
    let between = pairs_of_blocks.map(square).fold(0, u64::saturating_add);
    (square(elements).saturating_mul(MATRICES)).saturating_add(between.saturating_mul(BETWEEN)).saturating_mul(8)
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
pub(crate) struct SumsWanted<'a> {
    pub(crate) elements: &'a Elements,
    pub(crate) regressors: &'a Regressors,
    pub(crate) order: Order,
    pub(crate) flat: Option<&'a FlatMean<'a>>,
}
