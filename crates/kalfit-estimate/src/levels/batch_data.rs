//! Units that are evaluated together: in columns where all designs are equal, in lanes where designs differ.

use std::ops::Range;

use kalfit_lanes::{Lanes, MAX_LANES};

use crate::levels::batches::UnitBatch;
use crate::levels::design::{Leaf, UnitDesign, UnitGroup, UnitTest};
use crate::levels::units::Units;
use kalfit_algebra::rows::Rows;

/// Designs and data of units that are evaluated together.
pub(super) struct BatchData<'a, T> {
    /// The groups, each group before the group that contains it; the last group is the unit.
    pub(super) groups: &'a [UnitGroup],
    /// Leaf, as an index into `leaves`, and group of each test.
    pub(super) tests: Vec<UnitTest>,
    pub(super) leaves: Vec<Leaf<T>>,
    /// d of each test relative to the centre, p × columns.
    pub(super) data: Vec<Rows<T>>,
    /// Number of units in columns; one for units in lanes.
    pub(super) columns: usize,
}

impl<'a> BatchData<'a, f64> {
    /// The units `some` of one design, one unit in each column.
    pub(super) fn equal_designs(
        units: &Units,
        design: &'a UnitDesign,
        selected_units: Range<usize>,
    ) -> BatchData<'a, f64> {
        let mut leaves: Vec<Leaf> = Vec::new();
        let mut last = None;
        let tests = design.tests.iter().map(|member| {
            // tests of a group with the same leaf are consecutive
            if last != Some(member.leaf) {
                leaves.push(units.leaves[member.leaf].clone());
                last = Some(member.leaf);
            }
            UnitTest { leaf: leaves.len() - 1, group: member.group }
        });
        let columns = selected_units.len();
        let of = |data: &Rows| Rows::from_fn(data.nrows(), columns, |i, at| data[(i, selected_units.start + at)]);
        let tests = tests.collect();
        BatchData { groups: &design.groups, tests, leaves, data: design.data.iter().map(of).collect(), columns }
    }
}

impl<T> BatchData<'_, T> {
    /// Whether `group` is `other` or a group within `other`.
    pub(super) fn is_within(&self, mut group: usize, other: usize) -> bool {
        while group != other && self.groups[group].parent != group {
            group = self.groups[group].parent;
        }
        group == other
    }
}

impl<'a, T: Lanes> BatchData<'a, T> {
    /// The units of a batch, one in each lane. Lanes without a unit, and tests that a unit does not have, hold zeros,
    /// which add nothing.
    #[inline(always)]
    pub(super) fn of(units: &Units, batch: &'a UnitBatch) -> BatchData<'a, T> {
        let p = units.states;
        let (mut tests, mut leaves, mut data) = (Vec::new(), Vec::new(), Vec::new());
        for (test, &group) in batch.tests.iter().enumerate() {
            let mut lane_tests = [None; MAX_LANES];
            for (lane, lane_tests) in batch.lanes.iter().zip(&mut lane_tests) {
                if let Some(number) = lane.tests[test] {
                    let design = &units.designs[lane.design];
                    *lane_tests = Some((&units.leaves[design.tests[number].leaf], &design.data[number], lane.unit));
                }
            }
            tests.push(UnitTest { leaf: test, group });
            leaves.push(leaf_in_lanes(&lane_tests, p));
            let mut own = Rows::zeros(p, 1);
            for i in 0..p {
                own[(i, 0)] = in_lanes(
                    &lane_tests,
                    #[inline(always)]
                    |&(_, data, unit)| data[(i, unit)],
                );
            }
            data.push(own);
        }
        BatchData { groups: &batch.groups, tests, leaves, data, columns: 1 }
    }
}

/// The test in each lane: leaf, d in every unit of the design (p × units), and the unit's column of d.
type TestLanes<'a> = [Option<(&'a Leaf, &'a Rows, usize)>; MAX_LANES];

#[inline(always)]
fn leaf_in_lanes<T: Lanes>(lane_tests: &TestLanes<'_>, p: usize) -> Leaf<T> {
    let regressors = lane_tests.iter().flatten().next().map_or(0, |(leaf, ..)| leaf.covariates.len());
    let mut leaf = Leaf { factor: Rows::zeros(p, p), covariates: Vec::with_capacity(regressors) };
    for i in 0..p {
        for k in i..p {
            leaf.factor[(i, k)] = in_lanes(
                lane_tests,
                #[inline(always)]
                |(leaf, ..)| leaf.factor[(i, k)],
            );
        }
    }
    for c in 0..regressors {
        leaf.covariates.push(in_lanes(
            lane_tests,
            #[inline(always)]
            |(leaf, ..)| leaf.covariates[c],
        ));
    }
    leaf
}

/// One number of the test in each lane, zero where there is no test.
#[inline(always)]
fn in_lanes<T: Lanes>(lane_tests: &TestLanes<'_>, number: impl Fn(&(&Leaf, &Rows, usize)) -> f64) -> T {
    let mut all = [0.0; MAX_LANES];
    for (to, test) in all.iter_mut().zip(lane_tests) {
        if let Some(test) = test {
            *to = number(test);
        }
    }
    T::load(&all)
}
