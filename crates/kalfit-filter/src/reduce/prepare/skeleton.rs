//! The part of a test that does not depend on α: the steps, and the cells that each step reads.

use std::cmp::Ordering;

use crate::reduce::equal_steps::EqualStepCount;
use crate::reduce::instances::Instance;
use crate::reduce::prepare::{Preparer, StartCells, Workspace};
use kalfit_model::Scope;
use kalfit_model::Test;

/// Largest number of steps plus number of scalar measurements of a test that has a skeleton.
const MOST_STEPS_AND_ROWS: usize = 1 << 23;

/// The steps of a test, found from the cells of the test alone.
#[derive(Debug, Default)]
pub struct Skeleton {
    /// Index of the test in the ensemble.
    pub(crate) number: usize,
    pub(crate) covariates: Vec<f64>,
    pub(crate) steps: Vec<StepCells>,
    /// Scalar measurements, in the order of the design.
    pub(crate) instances: Vec<Instance>,
    /// Cells of the law of x_0, where it differs from test to test.
    pub(crate) opening: Option<StartCells>,
    /// Whether each step is one row.
    one_row_steps: bool,
    /// Bits that mark the measurements of each step, one for each measurement of the model in each step, from the
    /// highest bit of the first word on.
    pattern: Vec<u64>,
}

/// One step and the cells that it reads.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StepCells {
    pub(crate) moves: bool,
    pub(crate) dt: f64,
    /// Row from which the motion of the step is read.
    pub(crate) source: u32,
    /// End of the step's scalar measurements in `instances`.
    pub(crate) end: usize,
}

impl Skeleton {
    /// Number of steps.
    pub(crate) fn len(&self) -> usize {
        self.steps.len()
    }

    /// Scalar measurements of step `k`; none after the end of the test.
    pub(crate) fn of(&self, k: usize) -> &[Instance] {
        let Some(step) = self.steps.get(k) else { return &[] };
        let start = if k == 0 { 0 } else { self.steps[k - 1].end };
        &self.instances[start..step.end]
    }

    /// Whether a transition leads to step `k`.
    pub(crate) fn moves(&self, k: usize) -> bool {
        self.steps.get(k).is_some_and(|step| step.moves)
    }

    /// (index of the step, measurement) of each scalar measurement.
    pub(crate) fn measured(&self) -> impl Iterator<Item = (usize, Instance)> {
        (0..self.steps.len()).flat_map(|k| self.of(k).iter().map(move |&instance| (k, instance)))
    }

    /// Order in which tests are batched: by descending number of steps, then by the pattern of measurements.
    pub(crate) fn by_shape(&self, other: &Skeleton) -> Ordering {
        other.len().cmp(&self.len()).then_with(|| other.pattern.cmp(&self.pattern))
    }

    /// Whether both tests have the same number of steps, and step by step the same transitions and measurements.
    pub(crate) fn has_steps_of(&self, other: &Skeleton) -> bool {
        let step = |(own, other): (&StepCells, &StepCells)| (own.moves, own.end) == (other.moves, other.end);
        (self.steps.len(), self.instances.len()) == (other.steps.len(), other.instances.len())
            && self.steps.iter().zip(&other.steps).all(step)
            && self.instances.iter().zip(&other.instances).all(|(own, other)| own.meter == other.meter)
    }

    /// Whether the test fits in one batch with `longer`, a test of at least as many steps. Each step of both tests must
    /// be one row, with measurements in the order of the model, or the steps of both tests must have the same
    /// measurements. The shorter test must also have at least half as many steps as `longer`.
    pub(crate) fn fits_batch_of(&self, longer: &Skeleton) -> bool {
        let same_measurements = |k: usize| {
            let (own, other) = (self.of(k), longer.of(k));
            own.len() == other.len() && own.iter().zip(other).all(|(own, other)| own.meter == other.meter)
        };
        2 * self.len() >= longer.len()
            && (self.one_row_steps && longer.one_row_steps || (0..self.len()).all(same_measurements))
    }

    /// Empties the skeleton for another test.
    fn clear(&mut self) {
        let Skeleton { covariates, steps, instances, opening, pattern, .. } = self;
        covariates.clear();
        steps.clear();
        instances.clear();
        pattern.clear();
        *opening = None;
    }
}

impl Preparer {
    /// Writes the steps of a test to `made`. Returns false where the test is in error, or is better reduced alone
    /// because cells are gathered from several rows or most steps are in long stretches of equal steps. This choice
    /// depends only on the cells of the test.
    pub(crate) fn skeleton(&self, test: &Test, number: usize, work: &mut Workspace, made: &mut Skeleton) -> bool {
        made.clear();
        made.number = number;
        if !self.columnwise || !self.find_spans(test, work) {
            return false;
        }
        made.covariates.extend(&work.covariates);
        made.steps.reserve(test.rows());
        made.instances.reserve(test.rows());
        made.opening = self.law.is_none().then(|| work.opening());
        made.one_row_steps = work.spans.iter().all(|span| span.height() == 1);
        if !(made.one_row_steps || self.dynamics.uses.is_empty()) || !self.append_steps(test, work, made) {
            return false;
        }
        !made.instances.is_empty() && made.steps.len() + made.instances.len() <= MOST_STEPS_AND_ROWS
    }

    /// Gathers the cells that are constant within a test, and finds the steps of the test; false where the test is in
    /// error.
    fn find_spans(&self, test: &Test, work: &mut Workspace) -> bool {
        let at = self.at();
        if test.rows() == 0 || work.whole.gather(&at, test, 0..test.rows(), (&self.start.uses, true)).is_err() {
            return false;
        }
        let Workspace { whole, spans: steps, .. } = &mut *work;
        let scope = Scope { numbers: &whole.numbers, texts: &whole.texts, step: f64::NAN, alpha: &self.alpha };
        let initial = self.start.initial_time.as_ref().map(|time| at.value(time, &scope)).transpose();
        let found = initial.and_then(|initial| self.spans(test, initial, steps));
        found.is_ok() && self.covariates(&at, work).is_ok()
    }

    /// Appends the steps of the test in the work space; false where a step is in error, or most steps are in long
    /// stretches of equal steps.
    fn append_steps(&self, test: &Test, work: &Workspace, made: &mut Skeleton) -> bool {
        let at = self.at();
        let has_unknown_length = |moves: bool, dt: f64| moves && dt.is_nan() && !self.dynamics.components.is_empty();
        let mut count = EqualStepCount::new(work.spans.iter().map(|span| span.count).sum());
        let mut before = 0..0;
        for span in &work.spans {
            if has_unknown_length(span.moves, span.dt) {
                return false;
            }
            for number in 0..span.count {
                let (rows, k, first) = (span.step(number), made.steps.len(), made.instances.len());
                for row in rows.clone() {
                    if !self.meters.measured(&at, test, (row, span.dt), &mut made.instances) {
                        return false;
                    }
                }
                for instance in &made.instances[first..] {
                    set_bit(&mut made.pattern, k * self.meters.count() + instance.meter);
                }
                let source = if self.clock_previous() && k > 0 { before.start } else { rows.start } as u32;
                made.steps.push(StepCells { moves: span.moves, dt: span.dt, source, end: made.instances.len() });
                let may_repeat = (number > 0 || self.plan.is_still()) && rows.len() == before.len();
                let repeats = may_repeat && self.design_columns.repeat(test, &rows) && made.repeats(k);
                if count.take(repeats) {
                    return false;
                }
                before = rows;
            }
        }
        true
    }
}

/// Sets a bit, counted from the highest bit of the first word.
fn set_bit(pattern: &mut Vec<u64>, bit: usize) {
    let word = bit / 64;
    if pattern.len() <= word {
        pattern.resize(word + 1, 0);
    }
    pattern[word] |= 1 << (63 - bit % 64);
}

impl Skeleton {
    /// Whether step `k` has the measurements of the step before.
    fn repeats(&self, k: usize) -> bool {
        let (before, current) = (self.of(k - 1), self.of(k));
        before.len() == current.len()
            && before.iter().zip(current).all(|(before, current)| before.meter == current.meter)
    }
}
