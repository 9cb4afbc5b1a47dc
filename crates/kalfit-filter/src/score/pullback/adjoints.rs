//! The accumulator of the adjoints of one test, the pullback of the start of the test, and the resulting dℓ/dα.

use std::ops::Range;

use crate::reduce::{Fault, GatheredCells, LawAdjoint, Replay, StartAdjoint, Unwhitened, Workspace};
use crate::score::backward::MeasurementAdjoint;
use crate::score::pullback::Pullback;
use crate::score::pullback::groups::Groups;
use crate::score::pullback::taps::{CellRead, Gradient, Pending};
use kalfit_model::Scope;
use kalfit_model::Test;

/// Accumulator of the adjoints of one test, from the last step of the test to the first, for dℓ/dα.
#[derive(Debug)]
pub(crate) struct Adjoints<'a> {
    pub(super) pullback: &'a Pullback<'a>,
    pub(super) pending: Pending,
    pub(super) moving: TransitionSums,
    pub(super) unwhitening: UnwhiteningScratch,
    pub(super) replay: Replay,
    pub(super) start: StartAdjoint,
}

/// Accumulated adjoints of the transitions of a test.
#[derive(Debug, Clone)]
pub(super) struct TransitionSums {
    pub(super) groups: Groups,
    /// (number of entries of φ, number of entries of Q).
    pub(super) entries: (usize, usize),
    pub(super) cells: GatheredCells,
    /// Scratch for the sums of one group, and for the adjoints of the coefficients of the group.
    pub(super) sums: Vec<f64>,
    pub(super) bars: Vec<f64>,
    pub(super) flows: Vec<f64>,
}

/// Scratch for measurements whose noises are correlated.
#[derive(Debug, Clone, Default)]
pub(super) struct UnwhiteningScratch {
    pub(super) raw: Vec<f64>,
    pub(super) unwhitened: Unwhitened,
    /// Adjoints of the measurements before they were whitened.
    pub(super) bars: MeasurementAdjoint,
}

impl TransitionSums {
    pub(super) fn new(pullback: &Pullback<'_>) -> TransitionSums {
        let preparer = pullback.preparer;
        let (phi, q) = preparer.plan.entries();
        let flows = preparer.plan.flow_len;
        TransitionSums {
            groups: Groups::new(phi + q + flows, if pullback.needs.inputs { flows } else { 0 }),
            entries: (phi, q),
            cells: GatheredCells::default(),
            sums: Vec::new(),
            bars: Vec::new(),
            flows: Vec::new(),
        }
    }
}

impl Pullback<'_> {
    /// An empty accumulator, to be used for one test after the other.
    pub(crate) fn adjoints(&self) -> Adjoints<'_> {
        Adjoints {
            pullback: self,
            pending: Pending::new(&self.taps, &self.preparer.at(), self.slots),
            moving: TransitionSums::new(self),
            unwhitening: UnwhiteningScratch::default(),
            replay: Replay::default(),
            start: StartAdjoint::default(),
        }
    }
}

impl Adjoints<'_> {
    /// Whether the coefficients of `steps`, equal steps of one measurement each, depend on the free values in one way,
    /// so that the sums of the adjoints can be taken as the adjoints of the first step without changing the gradient.
    pub(crate) fn uniform(&self, test: &Test, steps: Range<usize>, work: &Workspace) -> bool {
        let pullback = self.pullback;
        let (first, last) = (work.design.step(steps.start).rows, work.design.step(steps.end - 1).rows);
        if first.is_empty() || !work.instances.uniform(first.start..last.end) {
            return false;
        }
        let Some(reads) = &pullback.cells else { return true };
        if !work.same_dt(&steps) {
            return false;
        }
        let rows = work.rows_of(&steps, pullback.preparer.clock_previous());
        let (numbers, texts) = (test.numbers(rows.start), test.texts(rows.start));
        reads.iter().all(|read| match *read {
            CellRead::Step => true,
            CellRead::Number(column) => {
                rows.clone().all(|row| test.numbers(row)[column].to_bits() == numbers[column].to_bits())
            }
            CellRead::Text(column) => rows.clone().all(|row| test.texts(row)[column] == texts[column]),
        })
    }

    /// Takes the adjoints of the start of a test, after [`Preparer::prepare`](crate::reduce::Preparer::prepare) into
    /// `work`. `mean`: ∂ℓ/∂a, n numbers in kernel order; `variance`: ∂ℓ/∂P0, r × r, symmetric, with the entries of P0
    /// taken as independent. `mean` and `variance` are not read unless `Pullback::needs_start`.
    pub(crate) fn started(
        &mut self,
        test: &Test,
        work: &Workspace,
        mean: &[f64],
        variance: &[f64],
    ) -> Result<(), Box<Fault>> {
        let pullback = self.pullback;
        if !pullback.needs.start {
            return Ok(());
        }
        let mut cells = std::mem::take(&mut self.moving.cells);
        let starting = pullback.preparer.starting(work);
        if pullback.preparer.start.has_stationary_states() {
            let settled = pullback.preparer.settled(test, work, &mut cells)?;
            self.started_at((&settled, &starting), mean, variance)?;
        } else {
            self.started_at((&starting, &starting), mean, variance)?;
        }
        self.moving.cells = cells;
        Ok(())
    }

    /// Takes the adjoints of the start of a test; `settled`: scope of the stationary law; `starting`: scope of the law
    /// of x_0.
    pub(super) fn started_at(
        &mut self,
        (settled, starting): (&Scope<'_>, &Scope<'_>),
        mean: &[f64],
        variance: &[f64],
    ) -> Result<(), Box<Fault>> {
        let Adjoints { pullback, pending, replay, start: out, .. } = self;
        if !pullback.needs.start {
            return Ok(());
        }
        let (preparer, context) = (pullback.preparer, pullback.context());
        let law = LawAdjoint { place: &preparer.order.place, r: preparer.order.frame.r, mean, variance };
        if !preparer.start.has_stationary_states() {
            preparer.start.backward(&context.at, (&[], &[]), &law, out)?;
        } else {
            preparer.stationary_coefficients(settled, replay)?;
            preparer.start.backward(&context.at, (&replay.values, &replay.inputs), &law, out)?;
            let slots = pullback.values.iter().zip(&out.values).chain(pullback.inputs.iter().zip(&out.inputs));
            for (tap, &bar) in slots {
                if let Some(tap) = *tap {
                    pending.add(&context, tap, bar, settled)?;
                }
            }
        }
        for (tap, &bar) in pullback.start.iter().zip(&out.coefficients) {
            if let Some(tap) = *tap {
                pending.add(&context, tap, bar, starting)?;
            }
        }
        Ok(())
    }

    /// Returns the gradient of the test and clears the accumulator for the next one.
    pub(crate) fn finish(&mut self, test: &Test, work: &Workspace) -> Result<Gradient, Box<Fault>> {
        let result = self.flush_groups(test, work).and_then(|()| self.pending.finish(&self.pullback.context()));
        self.clear();
        result
    }

    /// The gradient after all adjoints were given; the accumulator is cleared where `given` is an error.
    pub(crate) fn finish_after(
        &mut self,
        given: Result<(), Box<Fault>>,
        test: &Test,
        work: &Workspace,
    ) -> Result<Gradient, Box<Fault>> {
        if given.is_err() {
            self.clear();
        }
        given.and_then(|()| self.finish(test, work))
    }

    /// Discards all adjoints given so far.
    pub(super) fn clear(&mut self) {
        self.pending.clear();
        self.moving.groups.clear();
    }
}
