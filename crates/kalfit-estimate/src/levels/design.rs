//! Designs of tests and of units.

use kalfit_algebra::rows::Rows;

/// What tests of one class share.
#[derive(Debug, Clone)]
pub(super) struct Leaf<T = f64> {
    /// R, p × p.
    pub(super) factor: Rows<T>,
    /// Scaled covariates of the regressions.
    pub(super) covariates: Vec<T>,
}

/// Units whose tests have the same designs in the same groups.
#[derive(Debug, Clone)]
pub(super) struct UnitDesign {
    /// Of each test the number of its leaf and its group.
    pub(super) tests: Vec<UnitTest>,
    /// The groups, those of inner levels before those that they stand in; the last one is the unit.
    pub(super) groups: Vec<UnitGroup>,
    /// The units, each by the numbers of its reductions and of its groups in their levels.
    pub(super) units: Vec<UnitMembers>,
    /// d of the tests from the centre on: of each test p rows of as many numbers as there are units.
    pub(super) data: Vec<Rows>,
}

/// A test of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct UnitTest {
    pub(super) leaf: usize,
    pub(super) group: usize,
}

/// A group of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct UnitGroup {
    /// Its level, the innermost being 1: that of its Σ among the blocks.
    pub(super) level: usize,
    /// The group that it stands in; itself for the unit.
    pub(super) parent: usize,
}

/// One group of the outermost level.
#[derive(Debug, Clone)]
pub(super) struct UnitMembers {
    /// Numbers of its reductions, in the order of the tests of the design.
    pub(super) tests: Vec<usize>,
    /// Numbers of its groups in their levels, in the order of the groups of the design.
    pub(super) groups: Vec<usize>,
}

impl UnitDesign {
    /// Some of the units.
    pub(super) fn some(&self, units: &[usize]) -> UnitDesign {
        let of = |data: &Rows| Rows::from_fn(data.nrows(), units.len(), |i, at| data[(i, units[at])]);
        UnitDesign {
            tests: self.tests.clone(),
            groups: self.groups.clone(),
            units: units.iter().map(|&unit| self.units[unit].clone()).collect(),
            data: self.data.iter().map(of).collect(),
        }
    }
}
