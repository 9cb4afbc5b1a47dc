//! What stands in a block, and where.

use crate::linalg::symmetric::pairs;

/// What stands in a block, each number of all its classes side by side: R by columns, d, the vectors of the scatter of classes of
/// several tests, the covariates, and n of classes of several tests.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Layout {
    pub(super) p: usize,
    pub(super) covariates: usize,
    pub(super) several: bool,
}

impl Layout {
    /// Where the vectors of the scatter stand.
    pub(super) fn scatter(&self) -> usize {
        pairs(self.p) + self.p
    }

    /// Where the covariates stand.
    pub(super) fn covariates(&self) -> usize {
        self.scatter() + if self.several { self.p * self.p } else { 0 }
    }

    /// Where n stands, if it does.
    pub(super) fn count(&self) -> usize {
        self.covariates() + self.covariates
    }

    /// Numbers of a class.
    pub(super) fn size(&self) -> usize {
        self.count() + usize::from(self.several)
    }
}
