//! Designs of tests and of units.

use kalfit_algebra::rows::Rows;

/// Design that the tests of one class share.
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
    /// Leaf and group of each test.
    pub(super) tests: Vec<UnitTest>,
    /// The groups, each group before the group that contains it; the last group is the unit.
    pub(super) groups: Vec<UnitGroup>,
    /// The units with this design.
    pub(super) units: Vec<UnitMembers>,
    /// d of each test relative to the centre, p × units.
    pub(super) data: Vec<Rows>,
}

/// A test of a unit: leaf (design) and innermost group.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct UnitTest {
    pub(super) leaf: usize,
    pub(super) group: usize,
}

/// A group of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct UnitGroup {
    /// Level of the group, 1 for the innermost: the index of the block of Σ.
    pub(super) level: usize,
    /// Index of the group that contains this group; the unit has the index of the unit.
    pub(super) parent: usize,
}

/// A unit: indices of the tests' reductions, and of the groups.
#[derive(Debug, Clone)]
pub(super) struct UnitMembers {
    /// Indices of the reductions of the unit's tests, in the order of the tests of the design.
    pub(super) tests: Vec<usize>,
    /// Index of each group of the unit among all groups of a level, in the order of the groups of the design.
    pub(super) groups: Vec<usize>,
}

impl UnitDesign {
    /// The design with only the given units (indices into `units`).
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
