//! Where the numbers of tests in lanes stand: the steps and measurements of all of them, which no value of α changes.

use std::sync::Arc;

use kalfit_lanes::{Isa, MOST};

use crate::ensemble::Test;
use crate::reduce::design::{Design, Run};
use crate::reduce::instances::Instance;
use crate::reduce::lanes::is_short;
use crate::reduce::motion::Transitions;
use crate::reduce::prepare::{Opening, Preparer, Workspace};

/// No row.
pub(super) const NONE: u32 = u32::MAX;

/// Numbers of one test that its passes remember: no more than these.
const MOST_NUMBERS: usize = 1 << 16;

/// The steps of a test.
#[derive(Debug)]
pub(super) struct Skeleton {
    pub(super) number: usize,
    pub(super) digest: u128,
    pub(super) covariates: Vec<f64>,
    steps: Vec<Step>,
    instances: Vec<Instance>,
    /// Where tests have other laws of x_0.
    opening: Option<Opening>,
}

#[derive(Debug)]
struct Step {
    moves: bool,
    dt: f64,
    /// The row that its motion reads.
    source: u32,
    /// End of its scalar measurements.
    end: usize,
}

impl Skeleton {
    /// Of a test; `None` where something is wrong with it, or where it goes better by itself.
    pub(super) fn new(preparer: &Preparer, test: &Test, number: usize, work: &mut Workspace) -> Option<Skeleton> {
        preparer.prepare(test, work).ok()?;
        let (design, frame) = (&work.design, &work.design.frame);
        let reads = !preparer.dynamics.uses.is_empty();
        if reads && !work.step_rows().all(|rows| rows.len() == 1) {
            return None; // cells of several rows are gathered one by one
        }
        let kept = (design.steps() + design.rows()) * (frame.n + frame.r * frame.r + frame.n * frame.p);
        if !is_short(design) || kept > MOST_NUMBERS {
            return None;
        }
        let step = |(k, step): (usize, crate::reduce::Step<'_>)| {
            let source = work.rows_of(&(k..k + 1), preparer.reads_previous()).start as u32;
            Step { moves: step.transition.is_some(), dt: work.dt(k), source, end: step.rows.end }
        };
        let steps = design.each_step().enumerate().map(step).collect();
        let (digest, covariates) = (design.digest(), work.covariates.clone());
        let opening = preparer.law().is_none().then(|| work.opening());
        Some(Skeleton { number, digest, covariates, steps, instances: work.instances.iter().collect(), opening })
    }

    pub(super) fn len(&self) -> usize {
        self.steps.len()
    }

    pub(super) fn observations(&self) -> usize {
        self.instances.len()
    }

    /// Scalar measurements of a step; none where the test has ended.
    fn of(&self, k: usize) -> &[Instance] {
        let Some(step) = self.steps.get(k) else { return &[] };
        let start = if k == 0 { 0 } else { self.steps[k - 1].end };
        &self.instances[start..step.end]
    }

    /// Which measurements its steps have: tests that agree go together.
    pub(super) fn pattern(&self) -> impl Iterator<Item = (usize, usize)> {
        (0..self.steps.len()).flat_map(|k| self.of(k).iter().map(move |instance| (k, instance.meter)))
    }
}

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
    pub(super) fn new(preparer: &Preparer, tests: &[&Test], own: &[Skeleton]) -> Layout {
        let lanes = Isa::best().lanes();
        let mut layout = Layout {
            lanes,
            tests: own.iter().map(|skeleton| skeleton.number).collect(),
            design: Design::new(preparer.order.frame.clone()),
            meters: Vec::new(),
            measured: Vec::new(),
            cells: Vec::new(),
            dt: Vec::new(),
            z: Vec::new(),
            transitions: Transitions::default(),
            openings: own.iter().filter_map(|skeleton| skeleton.opening.clone()).collect(),
        };
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
        layout.design.h = vec![0.0; layout.design.states.len()];
        layout.design.noise = vec![1.0; layout.meters.len()];
        layout
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

impl Skeleton {
    fn moves(&self, k: usize) -> bool {
        self.steps.get(k).is_some_and(|step| step.moves)
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
