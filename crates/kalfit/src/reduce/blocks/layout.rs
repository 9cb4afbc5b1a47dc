//! Where the numbers of tests in lanes stand: the steps and measurements of all of them, which no value of α changes.

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
        let terms: Vec<Vec<u32>> =
            preparer.meters.parts().map(|(.., terms)| terms.iter().map(|(state, _)| *state).collect()).collect();
        for k in 0..own.iter().map(Skeleton::len).max().unwrap_or(0) {
            layout.step(own, k);
            for (meter, rows) in lines(own, k, terms.len()) {
                layout.design.states.extend(&terms[meter]);
                layout.design.ends.push(layout.design.states.len());
                layout.meters.push(meter);
                for lane in 0..lanes {
                    let has = rows[lane] != NONE;
                    let z = || tests[own[lane].number].numbers(rows[lane] as usize)[preparer.meters.column(meter)];
                    layout.cells.push(rows[lane]);
                    layout.measured.push(f64::from(u8::from(has)));
                    layout.z.push(if has { z() } else { 0.0 });
                    layout.dt.push(if has { own[lane].steps[k].dt } else { 0.0 });
                }
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

    /// How many transitions there are.
    pub(crate) fn moves(&self) -> usize {
        self.transitions.dt.len() / self.lanes
    }
}

/// The measurements of a step: those of each test that has any, where they agree, in their order; else by measurement of the
/// model, as many of each as some test has.
fn lines(own: &[Skeleton], k: usize, meters: usize) -> Vec<Line> {
    let same = |a: &[Instance], b: &[Instance]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.meter == b.meter);
    let longest = own.iter().map(|own| own.of(k)).max_by_key(|own| own.len()).unwrap_or(&[]);
    if own.iter().map(|own| own.of(k)).all(|own| own.is_empty() || same(own, longest)) {
        let line = |(number, instance): (usize, &Instance)| {
            let row = |lane: usize| own.get(lane).and_then(|own| own.of(k).get(number)).map_or(NONE, |i| i.row as u32);
            (instance.meter, std::array::from_fn(row))
        };
        return longest.iter().enumerate().map(line).collect();
    }
    let mut lines: Vec<Line> = Vec::new();
    for meter in 0..meters {
        let first = lines.len();
        for (lane, own) in own.iter().enumerate() {
            for (number, instance) in own.of(k).iter().filter(|instance| instance.meter == meter).enumerate() {
                if lines.len() == first + number {
                    lines.push((meter, [NONE; MOST]));
                }
                lines[first + number].1[lane] = instance.row as u32;
            }
        }
    }
    lines
}
