//! Which test and which phase a row of an exchange file is of.

use kalfit::{Layout, PhasedModel, TestKey};

use super::error::ExchangeError;
use super::schema::{PHASE, TEST};
use super::sheet::SheetRow;
use crate::error::DataError;
use crate::reading::SINGLE_TEST;

/// Finds the id of a row's test: in `test`, else in the model's own column of ids.
pub(super) struct TestIdFinder {
    own: Option<String>,
    single: bool,
}

impl TestIdFinder {
    pub(super) fn new(layout: &Layout) -> TestIdFinder {
        let own = match &layout.test {
            TestKey::Column(name) if name != TEST => Some(name.clone()),
            _ => None,
        };
        TestIdFinder { own, single: layout.test == TestKey::Single }
    }

    pub(super) fn id(&self, row: SheetRow<'_>) -> Result<String, DataError> {
        let own = self.own.as_deref().filter(|_| !row.has(TEST));
        let column = own.filter(|own| row.has(own)).unwrap_or(TEST);
        match row.text(column) {
            Some(id) if !id.is_empty() => Ok(id),
            _ if self.single && !row.has(column) => Ok(SINGLE_TEST.to_owned()),
            _ => Err(DataError::MissingTest { at: row.place(column) }),
        }
    }
}

/// The phases of a model by name.
pub(super) struct PhaseFinder<'a>(Vec<&'a str>);

impl<'a> PhaseFinder<'a> {
    pub(super) fn new(model: &'a PhasedModel) -> PhaseFinder<'a> {
        PhaseFinder(model.phases.iter().map(|phase| phase.name.as_str()).collect())
    }

    /// The phase of a row: the only one where none is named.
    pub(super) fn of(&self, row: SheetRow<'_>) -> Result<usize, ExchangeError> {
        let place = match row.with_text(PHASE, |found| self.0.iter().position(|name| *name == found)) {
            None if self.0.len() == 1 => Some(0),
            place => place.flatten(),
        };
        place.ok_or_else(|| ExchangeError::Phase {
            at: row.place(PHASE),
            found: row.shown(PHASE),
            phases: self.0.iter().map(|&name| name.to_owned()).collect(),
        })
    }
}
