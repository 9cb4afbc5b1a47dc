//! Batches of units with different designs, one unit in each lane.

use kalfit_lanes::{Isa, MAX_LANES};

use crate::levels::design::{UnitDesign, UnitGroup};

/// Units in lanes with a common layout: where a unit has fewer groups or tests than the layout, the lane has empty
/// groups or tests, which add nothing.
#[derive(Debug, Clone)]
pub(super) struct UnitBatch {
    /// The groups, each group before the group that contains it; the last group is the unit.
    pub(super) groups: Vec<UnitGroup>,
    /// The group of each test.
    pub(super) tests: Vec<usize>,
    /// The unit in each lane.
    pub(super) lanes: Vec<UnitInLane>,
}

/// A unit that takes a lane of a batch.
#[derive(Debug, Clone)]
pub(super) struct UnitInLane {
    /// Index of the unit's design.
    pub(super) design: usize,
    /// Index of the unit among the units of the design.
    pub(super) unit: usize,
    /// For each test of the batch the index of the test in the design; `None` where the unit has no such test.
    pub(super) tests: Vec<Option<usize>>,
}

/// Batches of the units whose design is not shared by enough units for columns. The number of units in a batch depends
/// on the machine, everything else on the tests alone.
pub(super) fn batches(designs: &[UnitDesign]) -> Vec<UnitBatch> {
    let isa = Isa::best();
    let few = |(number, design): (usize, &UnitDesign)| {
        let units = if design.is_shared() { 0 } else { design.units.len() };
        let shape = UnitShape::of(design, &design.contents(), design.groups.len() - 1);
        (0..units).map(move |unit| (shape.clone(), number, unit)).collect::<Vec<_>>()
    };
    let mut units: Vec<(UnitShape, usize, usize)> = designs.iter().enumerate().flat_map(few).collect();
    units.sort_by_cached_key(|(shape, design, unit)| (shape.size(), shape.signature(), *design, *unit));
    units.chunks(isa.lanes().min(MAX_LANES)).map(|units| UnitBatch::of(units, designs)).collect()
}

impl UnitDesign {
    /// Whether enough units share the design that one computation of the matrices for all units is cheaper than lanes.
    pub(super) fn is_shared(&self) -> bool {
        self.units.len() >= Isa::best().lanes()
    }

    /// Members of each group of the design.
    fn contents(&self) -> Vec<Contents> {
        let mut all = vec![Contents::default(); self.groups.len()];
        for (group, node) in self.groups.iter().enumerate().filter(|(group, node)| node.parent != *group) {
            all[node.parent].inner.push(group);
        }
        self.tests.iter().enumerate().for_each(|(test, member)| all[member.group].tests.push(test));
        all
    }
}

/// Members of a group: indices of the inner groups, and of the tests that are in no inner group.
#[derive(Debug, Clone, Default)]
struct Contents {
    inner: Vec<usize>,
    tests: Vec<usize>,
}

/// Shape of a group: level, number of tests that are in no inner group, and shapes of the inner groups.
#[derive(Debug, Clone)]
struct UnitShape {
    level: usize,
    tests: usize,
    inner: Vec<UnitShape>,
}

impl UnitShape {
    fn of(design: &UnitDesign, contents: &[Contents], group: usize) -> UnitShape {
        let inner = contents[group].inner.iter().map(|&inner| UnitShape::of(design, contents, inner)).collect();
        UnitShape { level: design.groups[group].level, tests: contents[group].tests.len(), inner }
    }

    /// Number of tests, including the tests in inner groups.
    fn size(&self) -> usize {
        self.tests + self.inner.iter().map(UnitShape::size).sum::<usize>()
    }

    /// A list of numbers that is equal for equal shapes.
    fn signature(&self) -> Vec<usize> {
        let inner = self.inner.iter().flat_map(UnitShape::signature);
        [self.tests, self.inner.len()].into_iter().chain(inner).collect()
    }

    /// Enlarges the shape so that another shape of the same level fits into it.
    fn enlarge(&mut self, other: &UnitShape) {
        self.tests = self.tests.max(other.tests);
        self.inner.iter_mut().zip(&other.inner).for_each(|(own, other)| own.enlarge(other));
        let more = other.inner.get(self.inner.len()..).unwrap_or_default();
        self.inner.extend_from_slice(more);
    }

    /// Appends the inner groups, then this group, to `groups`, and the index of each test's group to `tests`; returns
    /// the index of this group.
    fn append_layout(&self, groups: &mut Vec<UnitGroup>, tests: &mut Vec<usize>) -> usize {
        let inner: Vec<usize> = self.inner.iter().map(|shape| shape.append_layout(groups, tests)).collect();
        let own = groups.len();
        groups.push(UnitGroup { level: self.level, parent: own });
        inner.into_iter().for_each(|child| groups[child].parent = own);
        tests.extend(std::iter::repeat_n(own, self.tests));
        own
    }

    /// Appends for each test of this shape the index in the design of a test in `group`, or `None`, in the order of
    /// [`UnitShape::append_layout`].
    fn append_tests(&self, contents: &[Contents], group: Option<usize>, test_numbers: &mut Vec<Option<usize>>) {
        let inner = |at: usize| contents[group?].inner.get(at).copied();
        self.inner.iter().enumerate().for_each(|(at, shape)| shape.append_tests(contents, inner(at), test_numbers));
        test_numbers.extend((0..self.tests).map(|at| contents[group?].tests.get(at).copied()));
    }
}

impl UnitBatch {
    fn of(units: &[(UnitShape, usize, usize)], designs: &[UnitDesign]) -> UnitBatch {
        let mut shape = units[0].0.clone();
        units.iter().for_each(|(other, ..)| shape.enlarge(other));
        let (mut groups, mut tests) = (Vec::new(), Vec::new());
        shape.append_layout(&mut groups, &mut tests);
        let lane = |&(_, number, unit): &(UnitShape, usize, usize)| {
            let (design, mut test_numbers) = (&designs[number], Vec::with_capacity(tests.len()));
            shape.append_tests(&design.contents(), Some(design.groups.len() - 1), &mut test_numbers);
            UnitInLane { design: number, unit, tests: test_numbers }
        };
        UnitBatch { lanes: units.iter().map(lane).collect(), groups, tests }
    }
}
