//! The evidence of a test, phase by phase.

use std::ops::{Deref, DerefMut};
use std::{iter, option, vec};

use crate::evidence::Evidence;

/// The evidence of the phases of a test, from the first phase on. `Phases` derefs to a slice, and needs no heap memory
/// for a single phase.
#[derive(Debug, Clone, PartialEq)]
pub struct Phases(PhaseStorage);

#[derive(Debug, Clone, PartialEq)]
enum PhaseStorage {
    One([Evidence; 1]),
    /// No phases, or two and more phases.
    Several(Vec<Evidence>),
}

impl Phases {
    /// Keeps the first `phases` phases.
    pub fn truncate(&mut self, phases: usize) {
        *self = std::mem::take(self).into_iter().take(phases).collect();
    }
}

impl Default for Phases {
    /// No phases.
    fn default() -> Phases {
        Phases::from(Vec::new())
    }
}

impl Extend<Evidence> for Phases {
    fn extend<I: IntoIterator<Item = Evidence>>(&mut self, more: I) {
        *self = std::mem::take(self).into_iter().chain(more).collect();
    }
}

impl Deref for Phases {
    type Target = [Evidence];

    fn deref(&self) -> &[Evidence] {
        match &self.0 {
            PhaseStorage::One(one) => one,
            PhaseStorage::Several(all) => all,
        }
    }
}

impl DerefMut for Phases {
    fn deref_mut(&mut self) -> &mut [Evidence] {
        match &mut self.0 {
            PhaseStorage::One(one) => one,
            PhaseStorage::Several(all) => all,
        }
    }
}

impl From<Evidence> for Phases {
    fn from(only: Evidence) -> Phases {
        Phases(PhaseStorage::One([only]))
    }
}

impl From<Vec<Evidence>> for Phases {
    fn from(mut all: Vec<Evidence>) -> Phases {
        match all.len() {
            1 => Phases::from(all.remove(0)),
            _ => Phases(PhaseStorage::Several(all)),
        }
    }
}

impl FromIterator<Evidence> for Phases {
    fn from_iter<I: IntoIterator<Item = Evidence>>(all: I) -> Phases {
        let mut all = all.into_iter();
        match (all.next(), all.next()) {
            (Some(only), None) => Phases::from(only),
            (first, second) => Phases(PhaseStorage::Several(first.into_iter().chain(second).chain(all).collect())),
        }
    }
}

impl IntoIterator for Phases {
    type Item = Evidence;
    type IntoIter = iter::Chain<option::IntoIter<Evidence>, vec::IntoIter<Evidence>>;

    fn into_iter(self) -> Self::IntoIter {
        let (one, several) = match self.0 {
            PhaseStorage::One([one]) => (Some(one), Vec::new()),
            PhaseStorage::Several(all) => (None, all),
        };
        one.into_iter().chain(several)
    }
}

impl<'a> IntoIterator for &'a Phases {
    type Item = &'a Evidence;
    type IntoIter = std::slice::Iter<'a, Evidence>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}
