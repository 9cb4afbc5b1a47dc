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
    /// The groups, inner groups before the groups that contain them; the last one is the unit.
    pub(super) groups: Vec<UnitGroup>,
    /// The units with this design.
    pub(super) units: Vec<UnitMembers>,
    /// d of each test relative to the centre, p × units.
    pub(super) data: Vec<Rows>,
}

/// A test of a unit: its leaf (design) and its innermost group.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct UnitTest {
    pub(super) leaf: usize,
    pub(super) group: usize,
}

/// A group of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct UnitGroup {
    /// Level of the group, 1 for the innermost: the block of its Σ.
    pub(super) level: usize,
    /// The group that contains this group; the unit itself for the unit.
    pub(super) parent: usize,
}

/// A unit, by the numbers of its reductions and groups.
#[derive(Debug, Clone)]
pub(super) struct UnitMembers {
    /// Numbers of the unit's reductions, in the order of the tests of the design.
    pub(super) tests: Vec<usize>,
    /// Numbers of the unit's groups in their levels, in the order of the groups of the design.
    pub(super) groups: Vec<usize>,
}

impl UnitDesign {
    /// The same design with only some of the units.
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
