//! Where the numbers of tests in lanes stand: the steps and measurements of all of them, which no value of α changes.

use std::ops::Range;
use std::sync::Arc;

use kalfit_lanes::{Isa, MOST};

use crate::ensemble::Test;
use crate::reduce::design::{Design, Run};
use crate::reduce::instances::Instance;
use crate::reduce::motion::Transitions;
use crate::reduce::prepare::{Opening, Preparer, Skeleton};

/// No row.
pub(super) const NONE: u32 = u32::MAX;

/// Tests side by side, at least one and no more than there are lanes. Number k of the test in a lane stands at k × lanes + lane.
#[derive(Debug)]
pub(crate) struct Layout {
    pub(crate) lanes: usize,
    /// Number of the test in each lane.
    pub(crate) tests: Vec<usize>,
    /// The shape of their designs: each step is a run, and each row has a line of its own.
    pub(crate) design: Design,
    /// States of the line of each measurement of the model, and the places of its terms among them.
    pub(super) shapes: Vec<(Vec<u32>, Vec<usize>)>,
    /// The measurement of the model that each row is of.
    pub(crate) meters: Vec<usize>,
    /// 1 where a test has the measurement of a row, else 0.
    pub(crate) measured: Vec<f64>,
    /// The row of the test that it is read from.
    pub(super) cells: Vec<u32>,
    /// The length of its step.
    pub(super) dt: Vec<f64>,
    /// What was measured.
    pub(super) z: Vec<f64>,
    pub(crate) transitions: Transitions,
    /// What the law of x_0 of each test is evaluated on; empty where all have one.
    pub(crate) openings: Vec<Opening>,
}

/// A measurement of a step: which of the model, and its row in each test.
type Line = (usize, [u32; MOST]);

impl Layout {
    /// Of no test yet.
    pub(super) fn new(isa: Isa, preparer: &Preparer) -> Layout {
        Layout {
            lanes: isa.lanes(),
            tests: Vec::new(),
            design: Design::new(preparer.order.frame.clone()),
            shapes: preparer.meters.shapes(),
            meters: Vec::new(),
            measured: Vec::new(),
            cells: Vec::new(),
            dt: Vec::new(),
            z: Vec::new(),
            transitions: Transitions::default(),
            openings: Vec::new(),
        }
    }

    /// Of these tests, in place of others.
    pub(super) fn take(&mut self, preparer: &Preparer, tests: &[&Test], own: &[Skeleton]) {
        self.clear();
        let (lanes, layout) = (self.lanes, self);
        layout.tests.extend(own.iter().map(|skeleton| skeleton.number));
        layout.openings.extend(own.iter().filter_map(|skeleton| skeleton.opening.clone()));
        layout.design.moves.push(Arc::new(preparer.plan.blank()));
        let mut found = Vec::new();
        for k in 0..own.iter().map(Skeleton::len).max().unwrap_or(0) {
            layout.step(own, k);
            lines(own, k, layout.shapes.len(), &mut found);
            for &(meter, rows) in &found {
                let rows = &rows[..lanes];
                layout.design.states.extend(&layout.shapes[meter].0);
                layout.design.ends.push(layout.design.states.len());
                layout.meters.push(meter);
                layout.cells.extend(rows);
                layout.measured.extend(rows.iter().map(|&row| f64::from(u8::from(row != NONE))));
                let (column, at) = (preparer.meters.column(meter), |lane: usize| tests[own[lane].number]);
                let z = |(lane, &row): (usize, &u32)| match row {
                    NONE => 0.0,
                    row => at(lane).numbers(row as usize)[column],
                };
                layout.z.extend(rows.iter().enumerate().map(z));
                let dt = |(lane, &row): (usize, &u32)| if row == NONE { 0.0 } else { own[lane].steps[k].dt };
                layout.dt.extend(rows.iter().enumerate().map(dt));
            }
            let (lines, moves) = (layout.meters.len(), own.iter().any(|own| own.moves(k)));
            let transition = moves.then_some(0);
            layout.design.runs.push(Run { transition, lines, count: 1, rows: lines, steps: k + 1 });
        }
        layout.design.h.resize(layout.design.states.len(), 0.0);
        layout.design.noise.resize(layout.meters.len(), 1.0);
    }

    fn clear(&mut self) {
        let Layout { tests, design, meters, measured, cells, dt, z, transitions, openings, .. } = self;
        tests.clear();
        design.clear();
        meters.clear();
        measured.clear();
        cells.clear();
        dt.clear();
        z.clear();
        transitions.clear();
        openings.clear();
    }

    /// The transition to a step, if any test has one.
    fn step(&mut self, own: &[Skeleton], k: usize) {
        if !own.iter().any(|own| own.moves(k)) {
            return;
        }
        for lane in 0..self.lanes {
            let step = own.get(lane).filter(|own| own.moves(k)).map(|own| &own.steps[k]);
            self.transitions.dt.push(step.map_or(0.0, |step| step.dt));
            self.transitions.moving.push(f64::from(u8::from(step.is_some())));
            self.transitions.sources.push(step.map_or(NONE, |step| step.source));
        }
    }

    /// The lines among these that the test in a lane has.
    pub(crate) fn rows_of(&self, lane: usize, lines: Range<usize>) -> impl Iterator<Item = usize> {
        lines.filter(move |row| self.measured[row * self.lanes + lane] != 0.0)
    }

    /// Numbers of the terms of a line.
    pub(super) fn terms(&self, row: usize) -> Range<usize> {
        let first = if row == 0 { 0 } else { self.design.ends[row - 1] };
        first..self.design.ends[row]
    }

    /// What these lines of one step are, at least one, and the length of the step.
    pub(crate) fn instances_of(&self, lane: usize, rows: &[usize]) -> (Vec<Instance>, f64) {
        let place = |row: usize| row * self.lanes + lane;
        let instance = |&row: &usize| Instance { meter: self.meters[row], row: self.cells[place(row)] as usize };
        (rows.iter().map(instance).collect(), self.dt[place(rows[0])])
    }

    /// How many transitions there are.
    pub(crate) fn moves(&self) -> usize {
        self.transitions.dt.len() / self.lanes
    }
}

/// The measurements of a step to `out`: those of each test that has any, where they agree, in their order; else by measurement of the
/// model, as many of each as some test has.
fn lines(own: &[Skeleton], k: usize, meters: usize, out: &mut Vec<Line>) {
    out.clear();
    let same = |a: &[Instance], b: &[Instance]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.meter == b.meter);
    let longest = own.iter().map(|own| own.of(k)).max_by_key(|own| own.len()).unwrap_or(&[]);
    if own.iter().map(|own| own.of(k)).all(|own| own.is_empty() || same(own, longest)) {
        out.extend(longest.iter().map(|instance| (instance.meter, [NONE; MOST])));
        for (lane, own) in own.iter().enumerate() {
            out.iter_mut().zip(own.of(k)).for_each(|(line, instance)| line.1[lane] = instance.row as u32);
        }
        return;
    }
    for meter in 0..meters {
        let first = out.len();
        for (lane, own) in own.iter().enumerate() {
            for (number, instance) in own.of(k).iter().filter(|instance| instance.meter == meter).enumerate() {
                if out.len() == first + number {
                    out.push((meter, [NONE; MOST]));
                }
                out[first + number].1[lane] = instance.row as u32;
            }
        }
    }
}
