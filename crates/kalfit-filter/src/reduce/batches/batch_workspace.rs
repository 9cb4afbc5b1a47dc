//! Tests that are evaluated once, at one α, side by side.

use kalfit_lanes::{Isa, Width};

use crate::reduce::batches::layout::BatchLayout;
use crate::reduce::batches::reduced::TestHeader;
use crate::reduce::batches::values::BatchValues;
use crate::reduce::design::Identity;
use crate::reduce::equal_steps::FEW;
use crate::reduce::lanes::{BatchColumns, DataWorkspace};
use crate::reduce::prepare::{Preparer, Skeleton};
use crate::reduce::reduced_tests::ReducedTests;
use crate::reduce::reducer::Reducer;
use crate::reduce::terminal::TerminalState;
use kalfit_model::Test;

/// Bytes of a batch of several tests: longer tests go one by one.
const BYTES: usize = 128 << 20;

/// How many of these tests, at least one and in their order, go together in so many lanes.
pub(super) fn together(preparer: &Preparer, own: &[Skeleton], lanes: usize) -> usize {
    let many = own.iter().take(lanes).take_while(|other| other.goes_with(&own[0])).count();
    if size(preparer, &own[..many], lanes) > BYTES { 1 } else { many }
}

/// What so many tests together are worked on with. Lanes that are empty take as long as others: one test has none beside it.
pub(super) fn width_for(tests: usize) -> Width {
    if tests == 1 { Isa::best().alone().into() } else { Isa::best().into() }
}

/// Bytes of a batch of these tests in so many lanes, about so many.
pub(super) fn size(preparer: &Preparer, own: &[Skeleton], lanes: usize) -> usize {
    let (frame, transition, dynamics) = (&preparer.order.frame, preparer.plan.blank(), &preparer.dynamics);
    let terms = preparer.meters.shapes().iter().map(|(line, _)| line.len()).max().unwrap_or(0);
    let varying = dynamics.table.varying.len() + dynamics.inputs.varying.len();
    let of_row = 8 + terms + frame.r + frame.p;
    let of_step = 3 + transition.phi.len() + transition.q.len() + frame.driven.len() + preparer.plan.flow_len + varying;
    let most = |of: fn(&Skeleton) -> usize| own.iter().map(of).max().unwrap_or(0);
    let (rows, steps) = (most(|own| own.instances.len()), most(Skeleton::len));
    // the numbers of all lanes, and the shape of their designs
    8 * (lanes * (rows * of_row + steps * of_step) + rows * (4 + 2 * terms) + steps * 7)
}

/// Work space that evaluates and filters one batch after another.
#[derive(Debug)]
pub(crate) struct BatchWorkspace {
    lanes: usize,
    layout: BatchLayout,
    values: BatchValues,
    /// Of batches of one test, where the others are of batches of several, and the other way round.
    spare: (BatchLayout, BatchValues),
    own: Vec<TestHeader>,
    identities: Vec<Identity>,
}

/// What is added to a and to P0 of a test, by its place there.
#[derive(Debug, Default)]
pub(crate) struct EnteringMoments {
    pub(crate) mean: Vec<(usize, f64)>,
    pub(crate) variance: Vec<(usize, f64)>,
}

/// What the filter of a test has found.
#[derive(Debug)]
pub(crate) struct FilteredLane<'a> {
    beside: &'a BatchWorkspace,
    lane: usize,
    room: &'a DataWorkspace,
    /// Where it ends, if that is wanted.
    pub(crate) end: Option<TerminalState>,
}

impl FilteredLane<'_> {
    /// e and 1/S of each of its measurements.
    pub(crate) fn innovations(&self) -> impl Iterator<Item = (f64, f64)> {
        let BatchLayout { lanes, measured, design, .. } = &self.beside.layout;
        let filter = &self.beside.values.batch_filter;
        let weights = filter.design_batch.weights((self.lane, *lanes), design.rows());
        let has = measured.iter().skip(self.lane).step_by(*lanes);
        let all = filter.block.innovations(self.lane, self.room).zip(weights).zip(has);
        all.filter(|(_, has)| **has != 0.0).map(|(found, _)| found)
    }
}

impl BatchWorkspace {
    /// For tests of a model.
    pub(crate) fn new(isa: Isa, reducer: &Reducer) -> BatchWorkspace {
        let of = |width| (BatchLayout::new(width, reducer.preparer()), BatchValues::new(width));
        let (layout, values) = of(isa.into());
        BatchWorkspace {
            lanes: isa.lanes(),
            layout,
            values,
            spare: of(isa.alone().into()),
            own: Vec::new(),
            identities: Vec::new(),
        }
    }

    /// Evaluates tests and runs their filters. What is found of a test does not depend on the others.
    pub(crate) fn reduce(
        &mut self,
        reducer: &Reducer,
        (tests, skeletons): (&[&Test], &mut [Skeleton]),
        room: &mut DataWorkspace,
        found: &mut ReducedTests,
    ) {
        each_group(reducer.preparer(), skeletons, self.lanes, |group| {
            self.take(reducer, tests, group);
            self.take_headers(group);
            let BatchWorkspace { layout, values, own, .. } = self;
            own.iter()
                .zip(values.sound)
                .filter(|(_, sound)| *sound)
                .for_each(|(own, _)| reducer.count_design_run(own.digest));
            values.reduce((layout, own), (reducer, |own: &TestHeader| own.digest), tests, room, found);
        });
    }

    /// The same where more is known of the starts of the tests, each by its number. `show` is shown what is found of each, nothing
    /// where it must be looked at by itself.
    pub(crate) fn pass(
        &mut self,
        reducer: &Reducer,
        (tests, skeletons, entering): (&[&Test], &mut [Skeleton], &[EnteringMoments]),
        room: &mut DataWorkspace,
        mut show: impl FnMut(&Skeleton, Option<FilteredLane<'_>>),
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
            values.batch_filter.run(&layout.design, group.len(), room);
            for (lane, own) in group.iter().enumerate() {
                let found = self.values.lane_result(lane, (&self.layout, own.instances.len()), reducer, room);
                let end = found.map(|(.., end)| end);
                show(own, end.map(|end| FilteredLane { beside: self, lane, room, end }));
            }
        });
    }

    /// Takes tests, in place of others.
    fn take(&mut self, reducer: &Reducer, tests: &[&Test], group: &[Skeleton]) {
        if (self.layout.lanes == 1) != (group.len() == 1) {
            std::mem::swap(&mut self.layout, &mut self.spare.0);
            std::mem::swap(&mut self.values, &mut self.spare.1);
        }
        let BatchWorkspace { layout, values, .. } = self;
        layout.take(reducer.preparer(), tests, group);
        values.take(layout, (reducer.preparer(), tests));
        for (lane, skeleton) in group.iter().enumerate() {
            // so many equal steps have a pass of their own
            values.sound[lane] &= skeleton.len() <= FEW || !values.is_long(layout, lane, skeleton.len());
        }
    }

    /// What the reductions of these tests have from their cells, and the digests of their designs.
    fn take_headers(&mut self, group: &mut [Skeleton]) {
        let BatchWorkspace { layout, values, own, identities, .. } = self;
        own.clear();
        let steps: Vec<usize> = group.iter().map(Skeleton::len).collect();
        let digests = values.identities(layout, &steps, identities);
        for (skeleton, digest) in group.iter_mut().zip(digests) {
            let covariates = std::mem::take(&mut skeleton.covariates);
            let (steps, observations) = (skeleton.len(), skeleton.instances.len());
            own.push(TestHeader { digest, covariates, steps, observations });
        }
    }
}

/// Shows tests that go together in so many lanes, all of them in turn.
fn each_group(preparer: &Preparer, mut left: &mut [Skeleton], lanes: usize, mut show: impl FnMut(&mut [Skeleton])) {
    left.sort_by(Skeleton::by_shape);
    while !left.is_empty() {
        let (group, rest) = left.split_at_mut(together(preparer, left, lanes));
        show(group);
        left = rest;
    }
}
