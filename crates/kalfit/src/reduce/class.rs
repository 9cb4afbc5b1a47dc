//! Design classes: what all tests of one design share.

use std::sync::Arc;

use crate::reduce::design::Design;
use crate::reduce::end::End;
use crate::reduce::gains::Gains;
use crate::reduce::root::RootError;
use crate::reduce::shared::Entry;

/// A design with its gains, as it is kept.
pub(super) type Made = Arc<Entry<Design, Result<Gains, RootError>>>;

/// A design class.
#[derive(Debug, Clone)]
pub(crate) struct Class(pub(super) Made);

impl Class {
    /// The design that all tests of it have.
    pub(crate) fn design(&self) -> &Design {
        &self.0.key
    }

    /// Its gains.
    pub(crate) fn gains(&self) -> &Result<Gains, RootError> {
        self.0.value()
    }

    /// The last state, where it was wanted.
    pub(crate) fn end(&self) -> Option<&End> {
        self.0.value().as_ref().ok()?.end.as_ref()
    }
}

/// Bytes that a class occupies.
pub(super) fn class_bytes(design: &Design, gains: &Result<Gains, RootError>) -> usize {
    design.bytes() + gains.as_ref().map_or(0, Gains::bytes)
}
