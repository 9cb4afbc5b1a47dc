//! Repeated evaluation of single steps of a prepared test, for derivatives.

use std::ops::Range;

use crate::reduce::prepare::{Preparer, StepRows, Workspace};
use crate::reduce::start::StartMoments;
use crate::reduce::steps::{GatheredCells, StepSpan};
use crate::reduce::subject::Fault;
use kalfit_model::{Alpha, Scope};
use kalfit_model::{Label, Test};

/// Work space for the coefficients of one step.
#[derive(Debug, Clone, Default)]
pub struct Replay {
    /// Coefficients of the dynamics on the step, by slot.
    pub(crate) values: Vec<f64>,
    /// Inputs of the dynamics on the step, by slot.
    pub(crate) inputs: Vec<f64>,
}

/// Cells on which the law of a test's x_0 is evaluated.
#[derive(Debug, Clone)]
pub(crate) struct StartCells {
    numbers: Vec<f64>,
    texts: Vec<Label>,
    /// Length of the first step.
    dt: f64,
}

impl StartCells {
    /// Scope with the cells that are constant within the test.
    pub(crate) fn whole<'a>(&'a self, alpha: &'a Alpha) -> Scope<'a> {
        Scope { numbers: &self.numbers, texts: &self.texts, step: self.dt, alpha }
    }

    /// Scope with the cells of the test's first row, on which the stationary law is evaluated.
    pub(crate) fn first<'a>(&self, test: &'a Test, alpha: &'a Alpha) -> Scope<'a> {
        Scope { numbers: test.numbers(0), texts: test.texts(0), step: self.dt, alpha }
    }
}

impl Workspace {
    /// Cells on which the law of x_0 of the test was evaluated.
    pub(crate) fn opening(&self) -> StartCells {
        let GatheredCells { numbers, texts } = &self.whole;
        StartCells { numbers: numbers.clone(), texts: texts.clone(), dt: self.spans[0].dt }
    }

    /// Length of step `k`.
    pub(crate) fn dt(&self, k: usize) -> f64 {
        self.place(k).0.dt
    }

    /// True when all of `steps`, at least one, have the same length, bit for bit.
    pub(crate) fn same_dt(&self, steps: &Range<usize>) -> bool {
        let at = |k: usize| self.firsts.partition_point(|&first| first <= k) - 1;
        let spans = &self.spans[at(steps.start)..=at(steps.end - 1)];
        spans.iter().all(|span| span.dt.to_bits() == spans[0].dt.to_bits())
    }

    /// Range of all rows from which the coefficients of `steps`, at least one, are read. `previous`: the coefficients
    /// of a step are read from the row before the step.
    pub(crate) fn rows_of(&self, steps: &Range<usize>, previous: bool) -> Range<usize> {
        self.moment(steps.start, previous).source.start..self.moment(steps.end - 1, previous).rows.end
    }

    /// (span of step `k`, index of the step in that span).
    fn place(&self, k: usize) -> (&StepSpan, usize) {
        // while successive steps differ in length, each step is a span
        let is_span_start = self.firsts.get(k) == Some(&k);
        let at = if is_span_start { k } else { self.firsts.partition_point(|&first| first <= k) - 1 };
        (&self.spans[at], k - self.firsts[at])
    }

    fn moment(&self, k: usize, previous: bool) -> StepRows {
        let (span, number) = self.place(k);
        let rows = span.step(number);
        let source = if previous && k > 0 {
            let (before, number) = self.place(k - 1);
            before.step(number)
        } else {
            rows.clone()
        };
        StepRows { rows, source, dt: span.dt, moves: span.moves }
    }
}

impl Preparer {
    /// The scope in which the transition to step `k` was evaluated. `cells`: work space for steps of several rows.
    pub(crate) fn moving<'a>(
        &'a self,
        test: &'a Test,
        k: usize,
        work: &Workspace,
        cells: &'a mut GatheredCells,
    ) -> Result<Scope<'a>, Box<Fault>> {
        self.motion_scope(&self.at(), test, &work.moment(k, self.clock_previous()), cells)
    }

    /// The scope in which the start was evaluated: empty where the start is the same for all tests.
    pub(crate) fn starting<'a>(&'a self, work: &'a Workspace) -> Scope<'a> {
        if self.law.is_some() {
            return Scope { numbers: &[], texts: &[], step: 0.0, alpha: &self.alpha };
        }
        Scope { numbers: &work.whole.numbers, texts: &work.whole.texts, step: work.spans[0].dt, alpha: &self.alpha }
    }

    /// The scope in which the stationary distribution was evaluated: empty where the distribution is the same for all
    /// tests.
    pub(crate) fn settled<'a>(
        &'a self,
        test: &'a Test,
        work: &Workspace,
        cells: &'a mut GatheredCells,
    ) -> Result<Scope<'a>, Box<Fault>> {
        match self.law {
            Some(_) => Ok(Scope { numbers: &[], texts: &[], step: 0.0, alpha: &self.alpha }),
            None => self.moving(test, 0, work, cells),
        }
    }

    /// a and P0 of a test, evaluated on the cells `opening`.
    pub(crate) fn law_of(
        &self,
        test: &Test,
        opening: &StartCells,
        out: &mut Replay,
    ) -> Result<StartMoments, Box<Fault>> {
        if self.start.has_stationary_states() {
            self.stationary_coefficients(&opening.first(test, &self.alpha), out)?;
        }
        self.start.law(&self.at(), &opening.whole(&self.alpha), &out.values, &out.inputs)
    }

    /// Writes the coefficients of the dynamics on a step to `out`.
    pub(crate) fn values(&self, scope: &Scope<'_>, out: &mut Replay) -> Result<(), Box<Fault>> {
        self.dynamics.table.evaluate(&self.at(), scope, &mut out.values)
    }

    /// Writes the inputs of the dynamics on a step to `out`.
    pub(crate) fn inputs(&self, scope: &Scope<'_>, out: &mut Replay) -> Result<(), Box<Fault>> {
        self.dynamics.inputs.evaluate(&self.at(), scope, &mut out.inputs)
    }

    /// Writes the coefficients and inputs of the dynamics that the stationary distribution needs to `out`.
    pub(crate) fn stationary_coefficients(&self, scope: &Scope<'_>, out: &mut Replay) -> Result<(), Box<Fault>> {
        let at = self.at();
        self.dynamics.table.evaluate_some(&at, scope, |slot| self.start.needs(slot), &mut out.values)?;
        self.dynamics.inputs.evaluate_some(&at, scope, |slot| self.start.needs_input(slot), &mut out.inputs)
    }
}
