//! The layout of tests in lanes: the common steps and measurements of the tests, which do not depend on α.

use std::ops::Range;
use std::sync::Arc;

use kalfit_lanes::Width;

use crate::reduce::design::{Design, EqualSteps};
use crate::reduce::instances::Instance;
use crate::reduce::motion::Transitions;
use crate::reduce::prepare::{Preparer, Skeleton, StartCells};
use kalfit_model::Test;

/// In place of a row index: the test lacks the measurement or the step.
pub(super) const NO_ROW: u32 = u32::MAX;

/// Tests in lanes, one to `lanes` tests. In `measured`, `sources`, `dt` and `z`, entry k of the test in a lane is at
/// k × lanes + lane; k is a row of `design`.
#[derive(Debug)]
pub(crate) struct BatchLayout {
    pub(crate) lanes: usize,
    /// For each lane, the index of the test among all tests.
    pub(crate) tests: Vec<usize>,
    /// The common shape of the designs: each step is a run, and each row has a separate line.
    pub(crate) design: Design,
    /// True if all tests have the same steps and measurements.
    has_one_shape: bool,
    /// For each measurement of the model: (states of the line, position of each term of the measurement in the line).
    pub(super) shapes: Vec<(Vec<u32>, Vec<usize>)>,
    /// For each row, the index of the measurement in the model.
    pub(crate) meters: Vec<usize>,
    /// 1 where a test has the measurement of a row, else 0.
    pub(crate) measured: Vec<f64>,
    /// Row of the test from which each measurement is read; `NO_ROW` where the test lacks the measurement.
    pub(super) sources: Vec<u32>,
    /// Length of the step of each measurement.
    pub(super) dt: Vec<f64>,
    /// Measured values z.
    pub(super) z: Vec<f64>,
    pub(crate) transitions: Transitions,
    /// Cells on which the law of x_0 of each test is evaluated; empty if all tests share one law.
    pub(crate) start_cells: Vec<StartCells>,
}

impl BatchLayout {
    /// A layout without tests.
    pub(super) fn new(width: Width, preparer: &Preparer) -> BatchLayout {
        BatchLayout {
            lanes: width.lanes(),
            tests: Vec::new(),
            design: Design::new(preparer.order.frame.clone()),
            has_one_shape: false,
            shapes: preparer.meters.shapes(),
            meters: Vec::new(),
            measured: Vec::new(),
            sources: Vec::new(),
            dt: Vec::new(),
            z: Vec::new(),
            transitions: Transitions::default(),
            start_cells: Vec::new(),
        }
    }

    /// Lays out `tests` in place of the previous tests.
    pub(super) fn take(&mut self, preparer: &Preparer, tests: &[&Test], own: &[Skeleton]) {
        let have_one_shape = own.iter().all(|other| other.has_steps_of(&own[0]));
        if !(have_one_shape && self.has_shape_of(&own[0])) {
            self.build_shape(preparer, own);
            self.has_one_shape = have_one_shape;
        }
        self.tests.clear();
        self.tests.extend(own.iter().map(|skeleton| skeleton.number));
        self.start_cells.clear();
        self.start_cells.extend(own.iter().filter_map(|skeleton| skeleton.opening.clone()));
        self.transitions.clear();
        for (k, run) in self.design.runs.iter().enumerate().filter(|(_, run)| run.transition.is_some()) {
            debug_assert_eq!(run.steps, k + 1, "each step is a run");
            for lane in 0..self.lanes {
                let step = own.get(lane).filter(|own| own.moves(k)).map(|own| &own.steps[k]);
                self.transitions.dt.push(step.map_or(0.0, |step| step.dt));
                self.transitions.moving.push(f64::from(u8::from(step.is_some())));
                self.transitions.sources.push(step.map_or(NO_ROW, |step| step.source));
            }
        }
        let places = self.meters.len() * self.lanes;
        self.sources.clear();
        self.sources.resize(places, NO_ROW);
        for column in [&mut self.measured, &mut self.dt, &mut self.z] {
            column.clear();
            column.resize(places, 0.0);
        }
        own.iter().enumerate().for_each(|(lane, own)| self.fill_lane(preparer, tests[own.number], (lane, own)));
    }

    /// True if the previous tests all had the shape of this test.
    fn has_shape_of(&self, own: &Skeleton) -> bool {
        let step =
            |(k, run): (usize, &EqualSteps)| (run.lines, run.transition.is_some()) == (own.steps[k].end, own.moves(k));
        self.has_one_shape
            && self.design.runs.len() == own.len()
            && self.design.runs.iter().enumerate().all(step)
            && self.meters.iter().eq(own.instances.iter().map(|instance| &instance.meter))
    }

    /// Builds the common shape of these tests: the steps and the measurements of each step.
    fn build_shape(&mut self, preparer: &Preparer, own: &[Skeleton]) {
        self.meters.clear();
        self.design.clear();
        self.design.moves.push(Arc::new(preparer.plan.blank()));
        for k in 0..own.iter().map(Skeleton::len).max().unwrap_or(0) {
            self.append_lines(own, k);
            let (lines, moves) = (self.meters.len(), own.iter().any(|own| own.moves(k)));
            let transition = moves.then_some(0);
            self.design.runs.push(EqualSteps { transition, lines, count: 1, rows: lines, steps: k + 1 });
        }
        self.design.h.resize(self.design.states.len(), 0.0);
        self.design.noise.resize(self.meters.len(), 1.0);
    }

    /// Appends the lines of step `k`: one for each measurement that any of the tests has in the step, in an order that
    /// agrees with the order in each test.
    fn append_lines(&mut self, own: &[Skeleton], k: usize) {
        let first = self.meters.len();
        let longest = own.iter().map(|own| own.of(k)).max_by_key(|own| own.len()).unwrap_or(&[]);
        self.meters.extend(longest.iter().map(|instance| instance.meter));
        for instance in own.iter().flat_map(|own| own.of(k)) {
            // tests with different measurements have one row per step, measured in the order of the model
            if !self.meters[first..].contains(&instance.meter) {
                let place = self.meters[first..].partition_point(|&meter| meter < instance.meter);
                self.meters.insert(first + place, instance.meter);
            }
        }
        for &meter in &self.meters[first..] {
            self.design.states.extend(&self.shapes[meter].0);
            self.design.ends.push(self.design.states.len());
        }
    }

    /// Fills a lane: the source, the step length and the value of each measurement of a test.
    fn fill_lane(&mut self, preparer: &Preparer, test: &Test, (lane, own): (usize, &Skeleton)) {
        let mut line = 0;
        for (k, step) in own.steps.iter().enumerate() {
            for &Instance { meter, row } in own.of(k) {
                while self.meters[line] != meter {
                    line += 1;
                }
                let place = line * self.lanes + lane;
                self.sources[place] = row as u32;
                self.measured[place] = 1.0;
                self.dt[place] = step.dt;
                self.z[place] = test.numbers(row)[preparer.meters.column(meter)];
                line += 1;
            }
            line = self.design.runs[k].lines;
        }
    }

    /// The lines among `lines` that the test in a lane measures.
    pub(crate) fn rows_of(&self, lane: usize, lines: Range<usize>) -> impl Iterator<Item = usize> {
        lines.filter(move |row| self.measured[row * self.lanes + lane] != 0.0)
    }

    /// Range of the terms of a line.
    pub(super) fn terms(&self, row: usize) -> Range<usize> {
        let first = if row == 0 { 0 } else { self.design.ends[row - 1] };
        first..self.design.ends[row]
    }

    /// (scalar measurements on the lines `rows` of the test in a lane, length of the step). The lines, at least one,
    /// are lines of one step.
    pub(crate) fn instances_of(&self, lane: usize, rows: &[usize]) -> (Vec<Instance>, f64) {
        let place = |row: usize| row * self.lanes + lane;
        let instance = |&row: &usize| Instance { meter: self.meters[row], row: self.sources[place(row)] as usize };
        (rows.iter().map(instance).collect(), self.dt[place(rows[0])])
    }

    /// Number of transitions.
    pub(crate) fn moves(&self) -> usize {
        self.transitions.dt.len() / self.lanes
    }
}
