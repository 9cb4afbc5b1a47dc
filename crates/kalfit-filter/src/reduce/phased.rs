//! Reduces tests in phases: first each phase by the filter of the phase, then all phases together (theory §7).

mod batches;
mod reduce;
mod replicates;
mod whole;

use std::sync::Arc;

use rayon::prelude::*;

use crate::reduce::Reductions;
use crate::reduce::error::{ReduceError, ReduceErrorKind, refuse};
use crate::reduce::known_steps::KnownSteps;
use crate::reduce::part::{PhasePosition, PhaseReducer, ReducedPhase};
use crate::reduce::prepare::Workspace;
use crate::reduce::reducer::{ReducedWithEnd, Reducer, Work};
use crate::reduce::steps::GatheredCells;
use crate::reduce::subject::WHOLE;
use kalfit_model::Test;
use kalfit_model::{Alpha, Model, PhasedModel, Slots};
use kalfit_model::{Evidence, PhaseReduction, PhasedTest};

pub use batches::FilteredPhases;
pub use batches::PhasedBatches;
pub use replicates::PhaseReplicates;

/// Reduces the tests of a model in phases at α.
///
/// A phased reducer, like a [`Reducer`], caches from call to call what tests share; results do not depend on that
/// cache, on threads, on batches or on the order of the tests.
#[derive(Debug)]
pub struct PhasedReducer {
    phases: Vec<PhaseReducer>,
    /// Σ p_i, the number of elements of ξ in all phases.
    dimension: usize,
    /// Number of regressions in all phases.
    regressions: usize,
}

/// Work space of all passes over a test in phases.
#[derive(Debug)]
pub struct PhasedWork {
    /// Work space of each phase.
    pub phases: Vec<Workspace>,
    /// Work space for the cells on which the inheritance of a phase is evaluated.
    pub cells: GatheredCells,
}

impl PhasedReducer {
    /// A reducer of a model at α. An error when some coefficient has no value, whatever the data are.
    pub fn new(model: &PhasedModel, alpha: &Alpha) -> Result<PhasedReducer, ReduceError> {
        PhasedReducer::with_reducers(model, alpha, &|model| Reducer::new(model, alpha))
    }

    /// A reducer for scores: coefficients that depend on free values are retained even where such a coefficient is zero
    /// at this α. All design classes of all phases are cached, since the scores of linked phases need the classes
    /// again.
    pub fn scoring(model: &PhasedModel, alpha: &Alpha, slots: &Slots) -> Result<PhasedReducer, ReduceError> {
        PhasedReducer::with_reducers(model, alpha, &|one| Reducer::scoring(one, alpha, slots))
    }

    /// A reducer that retains coefficients as [`PhasedReducer::scoring`] does, for values of ℓ that no backward pass
    /// follows.
    pub fn passing(model: &PhasedModel, alpha: &Alpha, slots: &Slots) -> Result<PhasedReducer, ReduceError> {
        PhasedReducer::with_reducers(model, alpha, &|model| Reducer::passing(model, alpha, slots))
    }

    fn with_reducers(
        model: &PhasedModel,
        alpha: &Alpha,
        reducer: &dyn Fn(&Model) -> Result<Reducer, ReduceError>,
    ) -> Result<PhasedReducer, ReduceError> {
        let last = model.phases.len() - 1;
        let phase = |at: usize| -> Result<PhaseReducer, ReduceError> {
            let position = PhasePosition {
                name: (!model.is_single()).then(|| model.phases[at].name.clone()),
                before: at.checked_sub(1).map(|at| model.phases[at].model.states.len()),
                followed: at < last,
            };
            PhaseReducer::new((&model.phases[at], alpha), position, reducer)
        };
        Ok(PhasedReducer {
            phases: (0..=last).map(phase).collect::<Result<_, _>>()?,
            dimension: model.dimension(),
            regressions: model.phases.iter().map(|phase| phase.model.mean.regression.len()).sum(),
        })
    }

    /// The reducer that freezes no gains, for comparison in tests and benchmarks: every step of every record is
    /// computed in full, even where gains no longer change.
    #[doc(hidden)]
    #[must_use]
    pub fn unfrozen(mut self) -> PhasedReducer {
        self.phases = self.phases.into_iter().map(PhaseReducer::unfrozen).collect();
        self
    }

    /// Reuses `steps`, the known steps of the tests of each phase, and adds newly found steps.
    pub(crate) fn share_steps(&mut self, steps: &[Arc<KnownSteps>]) {
        for (phase, steps) in self.phases.iter_mut().zip(steps) {
            phase.reducer.share_steps(steps.clone());
        }
    }

    /// The phases, in order.
    pub fn phases(&self) -> &[PhaseReducer] {
        &self.phases
    }

    /// Work space for all passes.
    pub fn workspace(&self) -> PhasedWork {
        let phases = self.phases.iter().map(|phase| phase.reducer.workspace()).collect();
        PhasedWork { phases, cells: GatheredCells::default() }
    }

    /// Work done so far, summed over all phases.
    pub fn work(&self) -> Work {
        let add = |sum: Work, phase: &PhaseReducer| {
            let one = phase.reducer.work();
            Work {
                design_runs: sum.design_runs + one.design_runs,
                root_runs: sum.root_runs + one.root_runs,
                data_runs: sum.data_runs + one.data_runs,
                transitions: sum.transitions + one.transitions,
            }
        };
        self.phases.iter().fold(Work::default(), add)
    }

    /// The only phase and the rows of all tests; `None` where there are several phases or other evidence than rows.
    fn plain<'a>(&'a self, tests: &'a [PhasedTest]) -> Option<(&'a PhaseReducer, Vec<&'a Test>)> {
        let [phase] = &*self.phases else { return None };
        let rows = |test: &'a PhasedTest| self.rows_of(0, test).filter(|_| test.phases.len() == 1);
        Some((phase, tests.iter().map(rows).collect::<Option<_>>()?))
    }

    /// The rows of phase `at` of a test, where the optimal filter reduces these rows; else `None`.
    pub(crate) fn rows_of<'t>(&self, at: usize, test: &'t PhasedTest) -> Option<&'t Test> {
        match test.phases.get(at)? {
            Evidence::Rows(rows) if self.phases[at].is_optimal() => Some(rows),
            _ => None,
        }
    }

    /// The reduction of each phase of each test, in the entering coordinates of the phase.
    ///
    /// # Errors
    /// As [`PhasedReducer::reduce`].
    pub fn pieces(&self, tests: &[PhasedTest]) -> Result<Vec<Vec<PhaseReduction>>, ReduceError> {
        self.reduce_each(tests, &|test, work| self.pieces_of(test, work))
    }

    /// The reduction of each phase of one test, as from [`PhasedReducer::pieces`].
    pub fn pieces_of(&self, test: &PhasedTest, work: &mut PhasedWork) -> Result<Vec<PhaseReduction>, ReduceError> {
        Ok(self.parts(test, Vec::new(), work, false)?.into_iter().map(ReducedPhase::into_piece).collect())
    }

    /// The reductions of designs: information and covariates as in [`PhasedReducer::reduce`], from times, inputs and
    /// which values are missing. Measured values are not read; `data` and `constant` are zero, and there is no chain.
    ///
    /// # Errors
    /// As [`PhasedReducer::reduce`].
    pub fn reduce_designs(&self, tests: &[PhasedTest]) -> Result<Reductions, ReduceError> {
        let all = self.reduce_each(tests, &|test, work| {
            let mut reduction = self.whole(test, self.parts(test, Vec::new(), work, true))?;
            reduction.constant = 0.0;
            reduction.residual = None;
            reduction.data.fill(0.0);
            reduction.chain = None;
            Ok(reduction)
        })?;
        Ok(all.into())
    }

    fn reduce_each<T: Send>(
        &self,
        tests: &[PhasedTest],
        one: &(dyn Fn(&PhasedTest, &mut PhasedWork) -> Result<T, ReduceError> + Sync),
    ) -> Result<Vec<T>, ReduceError> {
        let all: Vec<Result<T, ReduceError>> =
            tests.par_iter().map_init(|| self.workspace(), |work, test| one(test, work)).collect();
        all.into_iter().collect()
    }

    /// Checks that a test has at least one phase and no more phases than the model.
    pub(crate) fn check(&self, test: &PhasedTest) -> Result<(), ReduceError> {
        match (test.phases.len(), self.phases.len()) {
            (0, _) => Err(refuse(Some(&test.id), WHOLE, ReduceErrorKind::NoRows)),
            (found, expected) if found > expected => {
                Err(refuse(Some(&test.id), WHOLE, ReduceErrorKind::TooManyPhases { found, expected }))
            }
            _ => Ok(()),
        }
    }

    /// The separately reduced phases of a test. `found`: results of the optimal filters that have run already, by
    /// phase; `designs`: no measured value is read.
    fn parts<'a>(
        &'a self,
        test: &'a PhasedTest,
        found: Vec<Option<ReducedWithEnd>>,
        work: &mut PhasedWork,
        designs: bool,
    ) -> Result<Vec<ReducedPhase<'a>>, ReduceError> {
        self.check(test)?;
        let part = |((at, evidence), found): ((usize, &'a Evidence), Option<ReducedWithEnd>)| {
            self.part((&test.id, at, evidence), found, work, (designs, at + 1 < test.phases.len()))
        };
        let found = found.into_iter().chain(std::iter::repeat_with(|| None));
        test.phases.iter().enumerate().zip(found).map(part).collect()
    }

    /// The reduction of one phase of a test, given as (id of the test, index of the phase, evidence).
    fn part<'a>(
        &'a self,
        (id, at, evidence): (&str, usize, &'a Evidence),
        found: Option<ReducedWithEnd>,
        work: &mut PhasedWork,
        (designs, linked): (bool, bool),
    ) -> Result<ReducedPhase<'a>, ReduceError> {
        let phase = &self.phases[at];
        match (evidence, found) {
            (Evidence::Rows(rows), Some(found)) => phase.complete(rows, found, &mut work.cells),
            _ => phase.part((id, evidence), (&mut work.phases[at], &mut work.cells), (designs, linked)),
        }
    }
}
