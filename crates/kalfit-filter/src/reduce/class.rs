//! Design classes: what all tests of one design share.

use std::sync::Arc;

use crate::reduce::design::Design;
use crate::reduce::gains::Gains;
use crate::reduce::root::RootError;
use crate::reduce::shared_store::StoreEntry;
use crate::reduce::terminal::TerminalRoot;

/// A design class: a design and the gains of the design, in the store of classes.
#[derive(Debug, Clone)]
pub(crate) struct DesignClass(pub(super) Arc<StoreEntry<Design, Result<Gains, RootError>>>);

impl DesignClass {
    /// The design of all tests of the class.
    pub(crate) fn design(&self) -> &Design {
        &self.0.key
    }

    /// The gains of the design, or the error of the design pass.
    pub(crate) fn gains(&self) -> &Result<Gains, RootError> {
        self.0.value()
    }

    /// Ψ_K and a root of P_K of the last state; `None` if no last state is wanted.
    pub(crate) fn end(&self) -> Option<&Arc<TerminalRoot>> {
        self.0.value().as_ref().ok()?.end.as_ref()
    }
}

/// Memory of a class in bytes.
pub(super) fn class_bytes(design: &Design, gains: &Result<Gains, RootError>) -> usize {
    design.bytes() + gains.as_ref().map_or(0, Gains::bytes)
}
