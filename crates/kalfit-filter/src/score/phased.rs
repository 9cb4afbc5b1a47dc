//! Scores and complete data of tests in phases: each phase has a forward and a backward pass, which start from the
//! results of the smoother over all phases.
//!
//! ```text
//! phases of a test ── smoother ──> moments of σ_i, adjoints of x_K ── backward of phase i ──> dℓ/dα
//!                             └──> ∂ℓ/∂T, ∂ℓ/∂t ── carry of phase i ──> dℓ/dα
//! ```
//!
//! Phases that are given by estimates or by a reduction do not take part.

mod batches;
mod design_classes;
#[cfg(test)]
mod tests;
mod unclassed;

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::reduce::{
    Fault, FilteredPhases, InheritanceTerm, PhasedReducer, PhasedWork, ReduceError, Reductions, Replicates, SharedStore,
};
use crate::score::InitialLaw;
use crate::score::backward::BackwardWork;
use crate::score::complete::Complete;
use crate::score::moments::moments;
use crate::score::phased::design_classes::{Score, ScoredEnsemble};
use crate::score::pullback::{Adjoints, Gradient};
use crate::score::smoother::{InheritanceAdjoint, PhaseLaws, PlanKey, SmoothedPhase, SmootherPlan};
use crate::score::{Scorer, Smoothed};
use kalfit_model::PhasedTest;
use kalfit_model::Test;
use kalfit_model::{EvaluationError, PhasedModel, Slots, Tape};

/// Most bytes of cached smoother plans; tests of one design share a plan as long as it is cached.
const PLAN_BYTES: usize = 64 << 20;

/// Smoother plans by design, under one law.
type Plans = SharedStore<PlanKey, SmootherPlan>;

/// Scores of tests in phases at the α of a reducer.
#[derive(Debug)]
pub struct PhasedScorer<'a> {
    model: &'a PhasedModel,
    reducer: &'a PhasedReducer,
    slots: &'a Slots,
    phases: Vec<Scorer<'a>>,
    /// For each phase, the coefficients of the carry that depend on free values.
    carries: Vec<Vec<&'a InheritanceTerm>>,
}

/// Moments of the complete data of a test, phase by phase; `None` for phases that have no rows to filter.
pub type PhasedComplete = Vec<Option<Complete>>;

/// Work space of one thread.
struct ScoreWorkspace<'a> {
    work: PhasedWork,
    backward: BackwardWork,
    adjoints: Vec<Adjoints<'a>>,
    tape: Tape,
}

impl<'a> PhasedScorer<'a> {
    /// A scorer at the α of `reducer`, which must have been made for `slots` ([`PhasedReducer::scoring`]).
    pub fn new(
        model: &'a PhasedModel,
        reducer: &'a PhasedReducer,
        slots: &'a Slots,
    ) -> Result<PhasedScorer<'a>, ReduceError> {
        let phases = reducer.phases().iter().map(|phase| Scorer::new(&phase.reducer, slots));
        let free = |phase: &'a crate::reduce::PhaseReducer| -> Vec<&'a InheritanceTerm> {
            let at = phase.reducer.preparer().at();
            let depends = |term: &&InheritanceTerm| term.coefficient.source().is_some_and(|(e, _)| at.depends(e));
            phase.inheritance.iter().flat_map(|inheritance| &inheritance.terms).filter(depends).collect()
        };
        let carries = reducer.phases().iter().map(free).collect();
        Ok(PhasedScorer { model, reducer, slots, phases: phases.collect::<Result<_, _>>()?, carries })
    }

    /// dℓ_j/dα of each test through the phases that have rows to filter. `reductions`: the reductions of the tests;
    /// `law`: the law of ξ; `classes`: which tests are replicates; `filtered`: batches of tests that the filters have
    /// passed.
    pub fn scores(
        &self,
        tests: &[PhasedTest],
        reductions: &Reductions,
        law: &InitialLaw,
        (classes, filtered): (&Replicates, Option<&FilteredPhases>),
    ) -> Result<Vec<Gradient>, ReduceError> {
        let plans = SharedStore::new(PLAN_BYTES);
        let ensemble = ScoredEnsemble { tests, reductions, law, plans: &plans, filtered };
        // the covariance of the mean depends on covariates, so that tests are not replicates
        let own = law.is_restricted() && reductions.iter().any(|reduction| !reduction.covariates.is_empty());
        let none = own.then(|| Replicates::none(tests.len()));
        let classes = none.as_ref().unwrap_or(classes);
        let one = |room: &mut ScoreWorkspace<'_>, members: &Vec<usize>| self.score_class(ensemble, members, room);
        let mut scores: Vec<Score> = classes.sets.par_iter().map_init(|| self.room(), one).flatten_iter().collect();
        scores.extend(self.score_unclassed(ensemble, &classes.alone));
        scores.sort_unstable_by_key(|(number, _)| *number);
        scores.into_iter().map(|(_, score)| score).collect()
    }

    /// Moments of the complete data of each test (the E-step).
    pub fn all_complete(
        &self,
        tests: &[PhasedTest],
        reductions: &Reductions,
        law: &InitialLaw,
    ) -> Result<Vec<PhasedComplete>, ReduceError> {
        let plans = SharedStore::new(PLAN_BYTES);
        let ensemble = ScoredEnsemble { tests, reductions, law, plans: &plans, filtered: None };
        let one = |room: &mut ScoreWorkspace<'_>, (test, number)| {
            self.complete(test, self.begin(ensemble, number, &mut room.work)?, room)
        };
        self.map_tests((tests, (0..tests.len()).into_par_iter()), one)
    }

    /// Smoothed states of each phase of each test, given all data of the test: x_0, then the state after each step.
    pub fn all_smoothed(
        &self,
        tests: &[PhasedTest],
        reductions: &Reductions,
        law: &InitialLaw,
    ) -> Result<Vec<Vec<Option<Vec<Smoothed>>>>, ReduceError> {
        let all = self.all_complete(tests, reductions, law)?;
        Ok(all.into_iter().map(|test| test.into_iter().map(|phase| Some(phase?.states)).collect()).collect())
    }

    /// (Q, gradient of Q) of each test, with Q the expected log-likelihood of the complete data, at the α of the
    /// reducer; `None` where the complete data of some test are impossible at this α.
    pub fn all_expected(
        &self,
        tests: &[PhasedTest],
        complete: &[PhasedComplete],
    ) -> Result<Option<Vec<(f64, Gradient)>>, ReduceError> {
        let one = |room: &mut ScoreWorkspace<'_>, (test, complete)| self.expected(test, complete, room);
        let all = self.map_tests((tests, complete.par_iter()), one)?;
        Ok(all.into_iter().collect())
    }

    fn map_tests<'t, X: Send, T: Send>(
        &self,
        (tests, with): (&'t [PhasedTest], impl IndexedParallelIterator<Item = X>),
        one: impl Fn(&mut ScoreWorkspace<'_>, (&'t PhasedTest, X)) -> Result<T, ReduceError> + Sync + Send,
    ) -> Result<Vec<T>, ReduceError> {
        let all: Vec<Result<T, ReduceError>> =
            tests.par_iter().zip(with).map_init(|| self.room(), |room, pair| one(room, pair)).collect();
        all.into_iter().collect()
    }

    fn room(&self) -> ScoreWorkspace<'_> {
        ScoreWorkspace {
            work: self.reducer.workspace(),
            backward: BackwardWork::default(),
            adjoints: self.phases.iter().map(|phase| phase.pullback.adjoints()).collect(),
            tape: Tape::default(),
        }
    }

    /// Results of the smoother for each phase of a test, from which the passes over the phase start.
    fn begin(
        &self,
        ensemble: ScoredEnsemble<'_>,
        number: usize,
        work: &mut PhasedWork,
    ) -> Result<Vec<SmoothedPhase>, ReduceError> {
        let reduction = ensemble.reductions.get(number);
        if self.model.is_single() {
            return Ok(vec![SmoothedPhase { moments: moments(reduction, ensemble.law), ..SmoothedPhase::default() }]);
        }
        let made;
        let pieces = match ensemble.filtered.and_then(|filtered| filtered.pieces(number)) {
            Some(pieces) => pieces,
            None => {
                made = self.reducer.pieces_of(&ensemble.tests[number], work)?;
                &made
            }
        };
        let laws = PhaseLaws::new(ensemble.law, &self.model.ranges(), reduction.covariates);
        let entry = ensemble.plans.get(
            reduction.design,
            |known| known.equals(pieces, &laws),
            || PlanKey::new(pieces, &laws),
            |_| SmootherPlan::new(pieces, &laws),
            |_, plan| 2 * plan.bytes(),
        );
        Ok(entry.value().smooth(pieces, &laws))
    }

    /// The part of the score of a test that goes through the carries of the phases.
    fn carry_gradient(
        &self,
        test: &PhasedTest,
        phases: &[SmoothedPhase],
        room: &mut ScoreWorkspace<'_>,
    ) -> Result<Gradient, ReduceError> {
        let mut sum = BTreeMap::new();
        for (at, smooth) in phases.iter().enumerate() {
            if let (Some(bar), Some(rows)) = (&smooth.inherited, self.reducer.rows_of(at, test)) {
                self.add_carry_gradient((at, rows), bar, room, &mut sum)?;
            }
        }
        Ok(sum.into_iter().collect())
    }

    /// Adds the part of the score that goes through the coefficients of a phase's carry.
    fn add_carry_gradient(
        &self,
        (at, rows): (usize, &Test),
        bar: &InheritanceAdjoint,
        room: &mut ScoreWorkspace<'_>,
        sum: &mut BTreeMap<usize, f64>,
    ) -> Result<(), ReduceError> {
        let phase = &self.reducer.phases()[at];
        let (Some(inheritance), false) = (&phase.inheritance, self.carries[at].is_empty()) else { return Ok(()) };
        let own = phase.reducer.preparer().at();
        let named = |fault: Box<Fault>| phase.named(fault.name(own.model, Some(rows)));
        let scope = inheritance.scope(&own, rows, &mut room.work.cells).map_err(named)?;
        for term in &self.carries[at] {
            let seed = match term.from {
                Some(state) => bar.transition[(term.row, state)],
                None => bar.input[term.row],
            };
            let (expression, subject) = term.coefficient.source().expect("it depends on free values");
            let mut finite = true;
            let sink = &mut |parameter: usize, x: f64| {
                if let Some(slot) = self.slots.find(parameter, scope.texts) {
                    finite &= x.is_finite();
                    *sum.entry(slot).or_insert(0.0) += x;
                }
            };
            let done = expression.differentiate(seed, &scope, &mut room.tape, sink);
            let done = done.and(if finite { Ok(0.0) } else { Err(EvaluationError::NotFinite) });
            own.finite(done, subject).map_err(|fault| named(fault.on(0)))?;
        }
        Ok(())
    }

    fn complete(
        &self,
        test: &PhasedTest,
        phases: Vec<SmoothedPhase>,
        room: &mut ScoreWorkspace<'_>,
    ) -> Result<PhasedComplete, ReduceError> {
        let one = |(at, smooth): (usize, &SmoothedPhase)| {
            let Some(rows) = self.reducer.rows_of(at, test) else { return Ok(None) };
            let scorer = &self.phases[at];
            let ending = scorer.ending_of(smooth);
            let work = (&mut room.work.phases[at], &mut room.backward);
            let complete = scorer.complete(rows, (&smooth.moments, ending.as_ref()), work);
            complete.map(Some).map_err(|error| self.reducer.phases()[at].named(error))
        };
        phases.iter().enumerate().map(one).collect()
    }

    fn expected(
        &self,
        test: &PhasedTest,
        complete: &PhasedComplete,
        room: &mut ScoreWorkspace<'_>,
    ) -> Result<Option<(f64, Gradient)>, ReduceError> {
        let (mut value, mut sum) = (0.0, BTreeMap::new());
        for (at, complete) in complete.iter().enumerate() {
            let (Some(rows), Some(complete)) = (self.reducer.rows_of(at, test), complete) else { continue };
            let work = (&mut room.work.phases[at], &mut room.adjoints[at]);
            let expected = self.phases[at].expected(rows, complete, work);
            let Some((own, gradient)) = expected.map_err(|error| self.reducer.phases()[at].named(error))? else {
                return Ok(None);
            };
            value += own;
            gradient.into_iter().for_each(|(slot, bar)| *sum.entry(slot).or_insert(0.0) += bar);
        }
        Ok(Some((value, sum.into_iter().collect())))
    }
}
