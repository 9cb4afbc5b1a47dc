//! Work space for batches of tests that are evaluated at one α only.

use kalfit_lanes::{Isa, Width};

use crate::reduce::batches::layout::BatchLayout;
use crate::reduce::batches::reduced::TestHeader;
use crate::reduce::batches::values::BatchValues;
use crate::reduce::design::DesignDigest;
use crate::reduce::equal_steps::MAX_UNSCANNED_STEPS;
use crate::reduce::lanes::{BatchColumns, DataWorkspace};
use crate::reduce::prepare::{Preparer, Skeleton};
use crate::reduce::reduced_tests::ReducedTests;
use crate::reduce::reducer::Reducer;
use crate::reduce::terminal::TerminalState;
use kalfit_model::Test;

/// Memory limit of a batch of several tests, in bytes; beyond the limit, a batch has one test.
const MAX_BATCH_BYTES: usize = 128 << 20;

/// Number of tests, from the first one on and at least one, that form a batch of at most `lanes` tests.
pub(super) fn batch_len(preparer: &Preparer, own: &[Skeleton], lanes: usize) -> usize {
    let fitting_tests = own.iter().take(lanes).take_while(|other| other.fits_batch_of(&own[0])).count();
    if batch_bytes(preparer, &own[..fitting_tests], lanes) > MAX_BATCH_BYTES { 1 } else { fitting_tests }
}

/// Width of a batch of `tests` tests: one lane for a single test, because empty lanes take as long as full lanes.
pub(super) fn width_for(tests: usize) -> Width {
    if tests == 1 { Isa::best().alone().into() } else { Isa::best().into() }
}

/// Approximate memory of a batch of these tests, in bytes.
pub(super) fn batch_bytes(preparer: &Preparer, own: &[Skeleton], lanes: usize) -> usize {
    let (frame, transition, dynamics) = (&preparer.order.frame, preparer.plan.blank(), &preparer.dynamics);
    let terms = preparer.meters.shapes().iter().map(|(line, _)| line.len()).max().unwrap_or(0);
    let varying = dynamics.table.varying.len() + dynamics.inputs.varying.len();
    let values_per_row = 8 + terms + frame.r + frame.p;
    let values_per_step =
        3 + transition.phi.len() + transition.q.len() + frame.driven.len() + preparer.plan.flow_len + varying;
    let largest = |of: fn(&Skeleton) -> usize| own.iter().map(of).max().unwrap_or(0);
    let (rows, steps) = (largest(|own| own.instances.len()), largest(Skeleton::len));
    // values in all lanes, then the common shape of the designs
    8 * (lanes * (rows * values_per_row + steps * values_per_step) + rows * (4 + 2 * terms) + steps * 7)
}

/// Work space that evaluates and filters one batch after another.
#[derive(Debug)]
pub(crate) struct BatchWorkspace {
    lanes: usize,
    layout: BatchLayout,
    values: BatchValues,
    /// Layout and values for one test while `layout` and `values` are for several tests, else for several tests.
    other_width: (BatchLayout, BatchValues),
    own: Vec<TestHeader>,
    design_digests: Vec<DesignDigest>,
}

/// Terms to be added to a and to P0 of a test: (index in a, term), and (index in P0, r × r by rows, term).
#[derive(Debug, Default)]
pub(crate) struct EnteringMoments {
    pub(crate) mean: Vec<(usize, f64)>,
    pub(crate) variance: Vec<(usize, f64)>,
}

/// The filter's results for one test of a batch.
#[derive(Debug)]
pub(crate) struct FilteredLane<'a> {
    workspace: &'a BatchWorkspace,
    lane: usize,
    scratch: &'a DataWorkspace,
    /// The last state of the test; `None` if no last states are wanted.
    pub(crate) end: Option<TerminalState>,
}

impl FilteredLane<'_> {
    /// (e, 1/S) of each scalar measurement of the test.
    pub(crate) fn innovations(&self) -> impl Iterator<Item = (f64, f64)> {
        let BatchLayout { lanes, measured, design, .. } = &self.workspace.layout;
        let filter = &self.workspace.values.batch_filter;
        let weights = filter.design_batch.weights((self.lane, *lanes), design.rows());
        let has_row = measured.iter().skip(self.lane).step_by(*lanes);
        let row_innovations = filter.block.innovations(self.lane, self.scratch).zip(weights).zip(has_row);
        row_innovations.filter(|(_, has_row)| **has_row != 0.0).map(|(found, _)| found)
    }
}

impl BatchWorkspace {
    /// Work space for tests of the model of a reducer.
    pub(crate) fn new(isa: Isa, reducer: &Reducer) -> BatchWorkspace {
        let of = |width| (BatchLayout::new(width, reducer.preparer()), BatchValues::new(width));
        let (layout, values) = of(isa.into());
        BatchWorkspace {
            lanes: isa.lanes(),
            layout,
            values,
            other_width: of(isa.alone().into()),
            own: Vec::new(),
            design_digests: Vec::new(),
        }
    }

    /// Evaluates tests, runs the filters and adds the results to `found`. The reduction of a test does not depend on
    /// the other tests.
    pub(crate) fn reduce(
        &mut self,
        reducer: &Reducer,
        (tests, skeletons): (&[&Test], &mut [Skeleton]),
        scratch: &mut DataWorkspace,
        found: &mut ReducedTests,
    ) {
        each_group(reducer.preparer(), skeletons, self.lanes, |group| {
            self.take(reducer, tests, group);
            self.take_headers(group);
            let BatchWorkspace { layout, values, own, .. } = self;
            own.iter()
                .zip(values.valid)
                .filter(|(_, valid)| *valid)
                .for_each(|(own, _)| reducer.count_design_run(own.digest));
            values.reduce((layout, own), (reducer, |own: &TestHeader| own.digest), tests, scratch, found);
        });
    }

    /// Evaluates and filters tests, with `entering[k]` added to a and P0 of test k. `visit` receives each test with the
    /// results of the filter, or with `None` if the test must be filtered alone.
    pub(crate) fn pass(
        &mut self,
        reducer: &Reducer,
        (tests, skeletons, entering): (&[&Test], &mut [Skeleton], &[EnteringMoments]),
        scratch: &mut DataWorkspace,
        mut visit: impl FnMut(&Skeleton, Option<FilteredLane<'_>>),
    ) {
        each_group(reducer.preparer(), skeletons, self.lanes, |group| {
            self.take(reducer, tests, group);
            let BatchWorkspace { layout, values, .. } = self;
            let BatchColumns { start, variance, .. } = values.batch_filter.columns();
            for (lane, &number) in layout.tests.iter().enumerate() {
                let EnteringMoments { mean, variance: own } = &entering[number];
                mean.iter().for_each(|&(place, x)| start[place * layout.lanes + lane] += x);
                own.iter().for_each(|&(place, x)| variance[place * layout.lanes + lane] += x);
            }
            values.batch_filter.design_batch.with_ends = reducer.wants_ends();
            values.batch_filter.run(&layout.design, group.len(), scratch);
            for (lane, own) in group.iter().enumerate() {
                let found = self.values.lane_result(lane, (&self.layout, own.instances.len()), reducer, scratch);
                let end = found.map(|(.., end)| end);
                visit(own, end.map(|end| FilteredLane { workspace: self, lane, scratch, end }));
            }
        });
    }

    /// Evaluates a group of tests in place of the previous group.
    fn take(&mut self, reducer: &Reducer, tests: &[&Test], group: &[Skeleton]) {
        if (self.layout.lanes == 1) != (group.len() == 1) {
            std::mem::swap(&mut self.layout, &mut self.other_width.0);
            std::mem::swap(&mut self.values, &mut self.other_width.1);
        }
        let BatchWorkspace { layout, values, .. } = self;
        layout.take(reducer.preparer(), tests, group);
        values.take(layout, (reducer.preparer(), tests));
        for (lane, skeleton) in group.iter().enumerate() {
            // a test of mostly equal steps is filtered alone, with scans
            values.valid[lane] &=
                skeleton.len() <= MAX_UNSCANNED_STEPS || !values.is_long(layout, lane, skeleton.len());
        }
    }

    /// Stores the header of each test of a group: covariates, counts and the digest of the design.
    fn take_headers(&mut self, group: &mut [Skeleton]) {
        let BatchWorkspace { layout, values, own, design_digests, .. } = self;
        own.clear();
        let steps: Vec<usize> = group.iter().map(Skeleton::len).collect();
        let digests = values.design_digests(layout, &steps, design_digests);
        for (skeleton, digest) in group.iter_mut().zip(digests) {
            let covariates = std::mem::take(&mut skeleton.covariates);
            let (steps, observations) = (skeleton.len(), skeleton.instances.len());
            own.push(TestHeader { digest, covariates, steps, observations });
        }
    }
}

/// Sorts tests by shape and calls `visit` with each group that shares a batch of at most `lanes` tests.
fn each_group(
    preparer: &Preparer,
    mut remaining: &mut [Skeleton],
    lanes: usize,
    mut visit: impl FnMut(&mut [Skeleton]),
) {
    remaining.sort_by(Skeleton::by_shape);
    while !remaining.is_empty() {
        let (group, rest) = remaining.split_at_mut(batch_len(preparer, remaining, lanes));
        visit(group);
        remaining = rest;
    }
}
