//! Innovations of tests in phases: one filter over all phases, by square roots (theory §7).
//!
//! The filter of a phase runs with σ = 0, as for its reduction, and gives e, S and T of each measurement: given σ, the
//! innovation is e - Tσ with variance S. The law of σ is known from all earlier measurements, of the phase and of
//! earlier phases ([`EnteringLaw`]), so that the innovation of the test is e - Tσ̂ with variance S + T Var(σ) T'. At
//! the last step the link between phases turns the law of σ into that of the next phase's σ. The contribution of Σ is
//! in square roots, because Σ may be singular, zero or huge. For tests that do not need square roots, [`PhaseFilters`]
//! is faster.

use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{DMatrix, DVector};

use crate::innovations::change::Change;
use crate::innovations::law::EnteringLaw;
use crate::innovations::phase_prior::PhasePrior;
use crate::innovations::plain::{PhaseFilters, PhaseWorkspace};
use crate::innovations::rows;
use crate::innovations::rows::{Figures, ListedInnovation};
use crate::reduce::{
    Gains, GatheredCells, PhasedReducer, PhasedWork, ReduceError, ReduceErrorKind, ReductionRef, Terminal, Workspace,
    refuse,
};
use kalfit_algebra::symmetric;
use kalfit_model::Test;
use kalfit_model::{Alpha, Phase, PhasedModel, Population};
use kalfit_model::{Evidence, Inherited, PhasedTest};

/// The filter of tests in phases at (α, μ, Σ).
#[derive(Debug)]
pub struct ChainedFilter {
    reducer: Arc<PhasedReducer>,
    phases: Vec<PhasePrior>,
    plain: Arc<PhaseFilters>,
    /// Work spaces that wait for further tests.
    rooms: Arc<Mutex<Vec<InnovationWorkspace>>>,
}

/// (innovations, log p of the phases without innovations) of a test; `None` for a test without innovations.
pub(crate) type TestInnovations<T> = Result<Option<(Vec<T>, f64)>, ReduceError>;

/// Work space for a test.
#[derive(Debug)]
pub(crate) struct InnovationWorkspace {
    phases: PhasedWork,
    plain: Vec<PhaseWorkspace>,
}

/// A work space that goes back to those that wait.
pub(crate) struct Room<'a> {
    rooms: &'a Mutex<Vec<InnovationWorkspace>>,
    space: Option<InnovationWorkspace>,
}

impl Room<'_> {
    pub(crate) fn space(&mut self) -> &mut InnovationWorkspace {
        self.space.as_mut().expect("it goes back at the end")
    }
}

impl Drop for Room<'_> {
    fn drop(&mut self) {
        self.rooms.lock().unwrap_or_else(PoisonError::into_inner).extend(self.space.take());
    }
}

/// A function that takes the rows of a phase, (index of the phase, rows), into the law of σ of the phase.
pub(crate) type GainsVisitor<'a> = dyn FnMut((usize, &Test), &Gains, &mut Workspace, &mut EnteringLaw) + 'a;

impl ChainedFilter {
    /// The filter at α and `initial`, which must have the shape of the model.
    pub fn new(model: &PhasedModel, alpha: &Alpha, initial: &Population) -> Result<ChainedFilter, ReduceError> {
        let reducer = Arc::new(PhasedReducer::new(model, alpha)?);
        let phases = priors(model, initial)?;
        let plain = Arc::new(PhaseFilters::new(model, alpha)?);
        Ok(ChainedFilter { reducer, phases, plain, rooms: Arc::default() })
    }

    /// The filter at the same α and another `initial`, which must have the shape of the model. Both filters share what
    /// they find of designs.
    pub(crate) fn at(&self, model: &PhasedModel, initial: &Population) -> Result<ChainedFilter, ReduceError> {
        let phases = priors(model, initial)?;
        let ChainedFilter { reducer, plain, rooms, .. } = self;
        Ok(ChainedFilter { reducer: reducer.clone(), phases, plain: plain.clone(), rooms: rooms.clone() })
    }

    /// The reducer of tests in phases at the same α.
    pub fn reducer(&self) -> &PhasedReducer {
        &self.reducer
    }

    /// A work space, which waits for further tests afterwards: of long tests it is much memory.
    pub(crate) fn room(&self) -> Room<'_> {
        let waiting = self.rooms.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let new = || InnovationWorkspace { phases: self.reducer.workspace(), plain: self.plain.workspace() };
        Room { rooms: &self.rooms, space: Some(waiting.unwrap_or_else(new)) }
    }

    /// Column of a measurement of a phase.
    pub(crate) fn column(&self, phase: usize, measurement: usize) -> usize {
        self.reducer.phases()[phase].reducer.preparer().model.measurements[measurement].column
    }

    /// e/√S of a test with each of these changes; `None` where copies of the test must be filtered.
    pub(crate) fn changed(
        &self,
        test: &PhasedTest,
        changes: &[Change<'_>],
        room: &mut InnovationWorkspace,
    ) -> Option<Vec<Vec<f64>>> {
        self.reducer.check(test).ok()?;
        let (starts, carries) = (&self.phases[..], self.reducer.phases());
        self.plain.changed(test, changes, (starts, carries), (&mut room.plain, &mut room.phases.cells))
    }

    /// The innovations of tests; `None` for a test without a phase that is given by rows alone.
    pub(crate) fn innovations<T: ListedInnovation>(
        &self,
        tests: &[PhasedTest],
        room: &mut InnovationWorkspace,
    ) -> Vec<TestInnovations<T>> {
        let carries = self.reducer.phases();
        let plain = self.plain.series(tests, (&self.phases, carries), (&mut room.plain, &mut room.phases.cells));
        tests.iter().zip(plain).map(|(whole, series)| self.test_innovations(whole, series, &mut room.phases)).collect()
    }

    /// The innovations of a test: `plain`, if plain covariances gave innovations, else the result of `by_square_roots`,
    /// which decides whether an invalid covariance is only rounding, and reports any other error.
    fn test_innovations<T: ListedInnovation>(
        &self,
        whole: &PhasedTest,
        plain: Option<Vec<T>>,
        work: &mut PhasedWork,
    ) -> TestInnovations<T> {
        self.reducer.check(whole)?;
        let (series, other_log_density, has_innovations) = match plain {
            Some(series) => (series, 0.0, true),
            None => self.by_square_roots(whole, work)?,
        };
        if !rows::are_finite(&series) {
            return Err(refuse(Some(&whole.id), "innovations", ReduceErrorKind::NotFinite));
        }
        Ok(has_innovations.then_some((series, other_log_density)))
    }

    /// (innovations, log p of the phases without innovations, true if a phase has innovations) of a test, computed in
    /// square roots.
    fn by_square_roots<T: ListedInnovation>(
        &self,
        whole: &PhasedTest,
        work: &mut PhasedWork,
    ) -> Result<(Vec<T>, f64, bool), ReduceError> {
        let (mut series, mut has_innovations) = (Vec::new(), false);
        let other_log_density = self.through(whole, work, &mut |(at, rows), gains, work, law| {
            let take = |e: f64, weight: f64, sensitivity: &[f64]| {
                let (value, variance) = law.take(e, sensitivity, weight);
                Figures { value, variance, standardised: value / variance.sqrt() }
            };
            series.extend(rows::series::<T>((at, rows, self.phases[at].time), gains, work, take));
            has_innovations = true;
        })?;
        Ok((series, other_log_density, has_innovations))
    }

    /// Filters a test phase by phase, in square roots. `take` takes the rows of each phase that is filtered here into
    /// the law of σ of the phase, and writes x̂_K to the work space. Returns log p of the phases not filtered here.
    pub fn through(
        &self,
        whole: &PhasedTest,
        work: &mut PhasedWork,
        take: &mut GainsVisitor<'_>,
    ) -> Result<f64, ReduceError> {
        let mut other_log_density = 0.0;
        let mut before: Option<FilteredPhase> = None;
        for (at, evidence) in whole.phases.iter().enumerate() {
            let room = (&mut work.phases[at], &mut work.cells);
            let linked = at + 1 < whole.phases.len();
            let after = match evidence {
                Evidence::Rows(rows) if !self.phases[at].filtered => {
                    self.filtered((at, rows), room, before.as_ref(), take)?
                }
                _ => self.take_given_phase(at, (whole, linked), room, before.as_ref(), &mut other_log_density)?,
            };
            before = Some(after);
        }
        Ok(other_log_density)
    }

    /// Filters the rows of a phase.
    fn filtered(
        &self,
        (at, rows): (usize, &Test),
        (work, cells): (&mut Workspace, &mut GatheredCells),
        before: Option<&FilteredPhase>,
        take: &mut GainsVisitor<'_>,
    ) -> Result<FilteredPhase, ReduceError> {
        let (start, phase) = (&self.phases[at], &self.reducer.phases()[at]);
        let link = before.map(|before| Ok((before, phase.inherited(rows, cells)?))).transpose()?;
        let found = phase.reducer.with_gains(rows, work, |gains, work| {
            let q = work.design.frame.p;
            let mut law =
                start.law(&work.covariates, q, link.as_ref().map(|(before, inherited)| before.link(inherited)));
            take((at, rows), gains, work, &mut law);
            let states = &phase.reducer.preparer().order.states;
            FilteredPhase { law: law.posterior(), terminal: gains.terminal(states, &work.pass.x) }
        });
        found.map_err(|error| phase.named(error))
    }

    /// Takes in a phase that is given otherwise than by rows, and adds log p of the phase given all earlier phases to
    /// `log_density`.
    fn take_given_phase(
        &self,
        at: usize,
        (whole, linked): (&PhasedTest, bool),
        room: (&mut Workspace, &mut GatheredCells),
        before: Option<&FilteredPhase>,
        log_density: &mut f64,
    ) -> Result<FilteredPhase, ReduceError> {
        let part = self.reducer.phases()[at].part((&whole.id, &whole.phases[at]), room, (false, linked))?;
        let reduction = &part.reduction;
        let link = before.map(|before| before.link(part.inherits()));
        let mut law = self.phases[at].law(&reduction.covariates, reduction.data.len(), link);
        *log_density += absorb(reduction.view(), &mut law);
        Ok(FilteredPhase { law: law.posterior(), terminal: part.into_piece().terminal })
    }
}

/// The priors of the phases.
fn priors(model: &PhasedModel, initial: &Population) -> Result<Vec<PhasePrior>, ReduceError> {
    let prior = |(phase, own): (&Phase, Population)| -> Result<PhasePrior, ReduceError> {
        if !symmetric::is_semidefinite(&own.covariance) {
            let (least, largest) = symmetric::scaled_range(&own.covariance);
            let kind = ReduceErrorKind::NotSemidefinite { left: least, variance: largest };
            let what = format!("covariance of the initial state of phase `{}`", phase.name);
            return Err(refuse(None, &what, kind));
        }
        Ok(PhasePrior {
            regressions: phase.model.mean.regression.iter().map(|r| r.element).zip(own.coefficients).collect(),
            root: symmetric::square_root(&own.covariance),
            covariance: own.covariance,
            time: phase.model.clock.time,
            filtered: phase.filter.is_some(),
            mean: own.mean,
        })
    };
    model.phases.iter().zip(initial.by_phase(model)).map(prior).collect()
}

/// A phase after its measurements have been taken in.
struct FilteredPhase {
    /// (mean of σ, F), where FF' is the covariance of σ.
    law: (DVector<f64>, DMatrix<f64>),
    /// Law of x_K given σ.
    terminal: Option<Terminal>,
}

impl FilteredPhase {
    /// (mean, root of the covariance) of T x_K + t, which the next phase inherits.
    fn link(&self, inherited: &Inherited) -> (DVector<f64>, DMatrix<f64>) {
        let Inherited { transition, input } = inherited;
        let Terminal { mean, sensitivity, root } = self.terminal.as_ref().expect("another phase follows");
        let (m, f) = &self.law;
        let state = mean + sensitivity * m;
        let (carried, own) = (sensitivity * f, root.ncols());
        let mut joint_root = carried.resize_horizontally(f.ncols() + own, 0.0);
        joint_root.columns_mut(f.ncols(), own).copy_from(root);
        (transition * state + input, transition * joint_root)
    }
}

/// Takes a phase that is given otherwise than by rows into `law`; returns log p of the phase given all earlier phases.
fn absorb(phase: ReductionRef<'_>, law: &mut EnteringLaw) -> f64 {
    let q = phase.data.len();
    let mut log_density = phase.constant;
    let mut factor_row = vec![0.0; q];
    for i in 0..q {
        factor_row.fill(0.0);
        (i..q).for_each(|k| factor_row[k] = phase.factor[i + k * (k + 1) / 2]);
        let (value, variance) = law.take(phase.data[i], &factor_row, 1.0);
        log_density -= 0.5 * (variance.ln() + value * value / variance);
    }
    log_density
}
