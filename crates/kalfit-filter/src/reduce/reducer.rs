//! The reducer: from tests to reductions.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::reduce::ReductionRef;
use crate::reduce::class::{DesignClass, class_bytes};
use crate::reduce::data::{Data, Miss, Outcome};
use crate::reduce::design::Design;
use crate::reduce::design_pass::information_gains;
use crate::reduce::error::{ReduceError, ReduceErrorKind};
use crate::reduce::gains::Gains;
use crate::reduce::instances::{Instance, Instances};
use crate::reduce::known_steps::KnownSteps;
use crate::reduce::lanes::innovations;
use crate::reduce::outcome::outcome;
use crate::reduce::prepare::{Preparer, Workspace};
use crate::reduce::root::{RootError, root_gains};
use crate::reduce::schedule::GainsWork;
use crate::reduce::segments::{Prefixes, has_segments};
use crate::reduce::shared_store::SharedStore;
use crate::reduce::subject::{Fault, Subject};
use crate::reduce::terminal::TerminalState;
use kalfit_model::Path;
use kalfit_model::Reduction;
use kalfit_model::Test;
use kalfit_model::{Alpha, Model, Slots};

/// Largest number of bytes of cached design classes: tests of one design share one run of the covariance filter while
/// the classes fit.
const CLASS_BYTES: usize = 256 << 20;
/// Bytes of cached design classes beyond which a class is cached only when a second test is of that class.
const KEEP_ON_FIRST_USE_BYTES: usize = 256 << 10;

/// Reduces the tests of a model at α.
///
/// A reducer caches transitions and design classes from call to call, so one reducer should serve all batches of an
/// ensemble. Reductions do not depend on the cache, on threads, on batches or on the order of the tests: every bit is
/// the same.
#[derive(Debug)]
pub struct Reducer {
    preparer: Preparer,
    classes: SharedStore<Design, Result<Gains, RootError>>,
    /// Gains of every row of designs whose long stretches are cut into segments in `classes`.
    row_classes: SharedStore<Design, Result<Gains, RootError>>,
    prefixes: Arc<Prefixes>,
    unfrozen: bool,
    /// Whether the last states of tests are requested.
    ends: bool,
    /// Whether P and Ψ before equal steps are requested.
    paths: bool,
    design_runs: AtomicU64,
    root_runs: AtomicU64,
    data_runs: AtomicU64,
}

/// The reduction and, where last states are requested, the last state of a test.
pub(crate) type ReducedWithEnd = Result<(Reduction, Option<TerminalState>), ReduceError>;

/// The parts of a reduction that do not depend on measured values.
#[derive(Debug)]
pub(crate) struct ReductionHeader<'a> {
    /// R, packed.
    pub(crate) factor: &'a [f64],
    pub(crate) covariates: &'a [f64],
    pub(crate) steps: usize,
    pub(crate) observations: usize,
    pub(crate) path: Path,
    pub(crate) digest: u128,
}

impl<'a> ReductionHeader<'a> {
    /// The header of the reduction of a test under `gains`.
    pub(crate) fn new(gains: &'a Gains, covariates: &'a [f64], (steps, digest): (usize, u128)) -> ReductionHeader<'a> {
        let path = if gains.rotations.is_some() { Path::SquareRoot } else { Path::Information };
        ReductionHeader { factor: &gains.factor, covariates, steps, observations: gains.active, path, digest }
    }

    /// The reduction of `test` with `outcome`.
    fn reduction(self, test: &'a Test, outcome: &'a Outcome) -> ReductionRef<'a> {
        ReductionRef {
            test: &test.id,
            constant: outcome.constant,
            residual: Some(outcome.residual),
            data: &outcome.data,
            factor: self.factor,
            covariates: self.covariates,
            steps: self.steps,
            observations: self.observations,
            path: self.path,
            design: self.digest,
            chain: None,
            exact: outcome.exact.as_deref(),
        }
    }
}

/// Counts of the work that a reducer has done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Work {
    /// Number of designs whose covariance filter was run.
    pub design_runs: u64,
    /// Number of covariance filters that were run in square-root arrays; a design that is not cached may be run more
    /// than once.
    pub root_runs: u64,
    /// Number of data passes: one for each test.
    pub data_runs: u64,
    /// Number of transitions computed by matrix exponentials: one for each length of step and set of coefficients.
    pub transitions: u64,
}

impl Reducer {
    /// A reducer of a model at α. An error when some coefficient has no value, whatever the data are.
    pub fn new(model: &Model, alpha: &Alpha) -> Result<Reducer, ReduceError> {
        let preparer = Preparer::new(model, alpha).map_err(|fault| fault.name(model, None))?;
        Ok(Reducer::of(preparer, SharedStore::with_second_use_policy(CLASS_BYTES, KEEP_ON_FIRST_USE_BYTES)))
    }

    /// A reducer for scores: coefficients that depend on free values are retained even where such a coefficient is zero
    /// at this α, and every design class is cached for the backward pass.
    pub(crate) fn scoring(model: &Model, alpha: &Alpha, slots: &Slots) -> Result<Reducer, ReduceError> {
        let preparer = Preparer::with_free(model, alpha, slots.free()).map_err(|fault| fault.name(model, None))?;
        let paths = slots.free().contains(&true);
        Ok(Reducer { paths, ..Reducer::of(preparer, SharedStore::new(CLASS_BYTES)) })
    }

    /// A reducer that retains coefficients as [`Reducer::scoring`] does, for values of ℓ that no backward pass follows:
    /// classes of single tests are not cached.
    pub(crate) fn passing(model: &Model, alpha: &Alpha, slots: &Slots) -> Result<Reducer, ReduceError> {
        let preparer = Preparer::with_free(model, alpha, slots.free()).map_err(|fault| fault.name(model, None))?;
        Ok(Reducer::of(preparer, SharedStore::with_second_use_policy(CLASS_BYTES, KEEP_ON_FIRST_USE_BYTES)))
    }

    /// A reducer of tests each of which brings a law of the estimated states, so that no state is unknown.
    pub(crate) fn of_known_starts(model: &Model, alpha: &Alpha) -> Result<Reducer, ReduceError> {
        let preparer = Preparer::of_known_starts(model, alpha).map_err(|fault| fault.name(model, None))?;
        Ok(Reducer::of(preparer, SharedStore::with_second_use_policy(CLASS_BYTES, KEEP_ON_FIRST_USE_BYTES)))
    }

    /// Reuses `steps`, the known steps of the tests of one ensemble, and adds newly found steps. The reducer must then
    /// reduce no other ensemble.
    pub(crate) fn share_steps(&mut self, steps: Arc<KnownSteps>) {
        self.preparer.steps = Some(steps);
    }

    fn of(preparer: Preparer, classes: SharedStore<Design, Result<Gains, RootError>>) -> Reducer {
        Reducer {
            preparer,
            classes,
            row_classes: SharedStore::with_second_use_policy(CLASS_BYTES, KEEP_ON_FIRST_USE_BYTES),
            prefixes: Arc::default(),
            unfrozen: false,
            ends: false,
            paths: false,
            design_runs: AtomicU64::new(0),
            root_runs: AtomicU64::new(0),
            data_runs: AtomicU64::new(0),
        }
    }

    /// The preparer, which evaluates tests.
    pub fn preparer(&self) -> &Preparer {
        &self.preparer
    }

    /// The reducer that freezes no gains, for comparison in tests and benchmarks: every step of every record is
    /// computed in full, even where gains no longer change.
    #[doc(hidden)]
    #[must_use]
    pub fn unfrozen(mut self) -> Reducer {
        self.unfrozen = true;
        self
    }

    /// The reducer with last states requested: each reduction comes with the state after the last step of the test.
    #[must_use]
    pub(crate) fn with_ends(mut self) -> Reducer {
        self.ends = true;
        self
    }

    /// Whether the state after the last step is requested.
    pub(crate) fn wants_ends(&self) -> bool {
        self.ends
    }

    /// The last state of a test of a class, if last states are requested. `x`: x̂ after the last step, in kernel order.
    pub(crate) fn ending(&self, class: &DesignClass, x: impl Iterator<Item = f64>) -> Option<TerminalState> {
        class.end().cloned().map(|end| TerminalState::new(end, &self.preparer.order.states, x))
    }

    /// Whether no gains are frozen.
    pub(crate) fn is_unfrozen(&self) -> bool {
        self.unfrozen
    }

    /// The reduction and the class of a design: information and covariates as in [`Reducer::reduce_one`], from times,
    /// inputs and which values are missing. Measured values are not read; `data` and `constant` are zero.
    pub(crate) fn designed(&self, test: &Test, work: &mut Workspace) -> Result<(Reduction, DesignClass), ReduceError> {
        self.with_class(test, (work, false), |digest, gains, work| {
            if gains.factor.iter().any(|x| !x.is_finite()) {
                return Err(Fault::new(Subject::Test, ReduceErrorKind::NotFinite));
            }
            let exact = gains.rotations.as_ref().and_then(|rotations| rotations.exact.blank());
            let outcome = Outcome { data: vec![0.0; work.design.frame.p], exact, ..Outcome::default() };
            let header = ReductionHeader::new(gains, &work.covariates, (work.design.steps(), digest));
            Ok(Reduction { residual: None, ..header.reduction(test, &outcome).into() })
        })
    }

    /// Work done so far.
    pub fn work(&self) -> Work {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Work {
            design_runs: read(&self.design_runs),
            root_runs: read(&self.root_runs),
            data_runs: read(&self.data_runs),
            transitions: read(&self.preparer.computed),
        }
    }

    /// Work space of all passes over a test.
    pub(crate) fn workspace(&self) -> Workspace {
        let mut work = self.preparer.workspace();
        work.gains.settling.off = self.unfrozen;
        work.gains.keeps_paths = self.paths;
        work.gains.prefixes = self.prefixes.clone();
        work
    }

    /// Evaluates a test into the work space, and calls `pass` with the gains of the test's design, for passes that see
    /// every row.
    pub fn with_gains<T>(
        &self,
        test: &Test,
        work: &mut Workspace,
        pass: impl FnOnce(&Gains, &mut Workspace) -> T,
    ) -> Result<T, ReduceError> {
        self.preparer.prepare(test, work).map_err(|fault| self.named(*fault, test))?;
        self.with_prepared(test, work, pass)
    }

    /// Calls `pass` with the gains of every row of the test that was evaluated into the work space.
    pub(crate) fn with_prepared<T>(
        &self,
        test: &Test,
        work: &mut Workspace,
        pass: impl FnOnce(&Gains, &mut Workspace) -> T,
    ) -> Result<T, ReduceError> {
        let class = self.row_class(work);
        self.with_class_gains((test, &class), work, pass)
    }

    /// As [`Reducer::with_gains`], with long stretches cut into segments, for passes that need sums over rows only.
    pub(crate) fn with_segmented_gains<T>(
        &self,
        test: &Test,
        work: &mut Workspace,
        pass: impl FnOnce(&Gains, &mut Workspace) -> T,
    ) -> Result<T, ReduceError> {
        self.preparer.prepare(test, work).map_err(|fault| self.named(*fault, test))?;
        let class = self.class(work.design.digest(), work, false);
        self.with_class_gains((test, &class), work, pass)
    }

    fn with_class_gains<T>(
        &self,
        (test, class): (&Test, &DesignClass),
        work: &mut Workspace,
        pass: impl FnOnce(&Gains, &mut Workspace) -> T,
    ) -> Result<T, ReduceError> {
        let gains = self.valid_gains(class, (test, &work.instances)).map_err(|fault| self.named(*fault, test))?;
        Ok(pass(gains, work))
    }

    /// Design, data and covariates of a test.
    pub fn evaluated(&self, test: &Test, work: &mut Workspace) -> Result<(Design, Data, Vec<f64>), ReduceError> {
        self.preparer.prepare(test, work).map_err(|fault| self.named(*fault, test))?;
        Ok((work.design.clone(), work.data.clone(), work.covariates.clone()))
    }

    /// (reduction, design class) of a test; x̂_K remains in the work space.
    pub(crate) fn reduce_one(
        &self,
        test: &Test,
        work: &mut Workspace,
    ) -> Result<(Reduction, DesignClass), ReduceError> {
        self.with_class(test, (work, false), |digest, gains, work| self.reduce_prepared(test, (digest, gains), work))
    }

    /// The reduction and, where last states are requested, the last state of a test.
    pub(crate) fn reduce_to_end(&self, test: &Test, work: &mut Workspace) -> ReducedWithEnd {
        let (reduction, class) = self.reduce_one(test, work)?;
        Ok((reduction, self.ending(&class, work.pass.x.iter().copied())))
    }

    /// [`Reducer::reduce_one`] for a test whose design is known to need square-root arrays.
    pub(crate) fn reduce_by_root(
        &self,
        test: &Test,
        work: &mut Workspace,
    ) -> Result<(Reduction, DesignClass), ReduceError> {
        self.with_class(test, (work, true), |digest, gains, work| self.reduce_prepared(test, (digest, gains), work))
    }

    /// Evaluates a test, and calls `reduce` under the gains of the test's class. `by_root`: the design is known to need
    /// square-root arrays.
    fn with_class(
        &self,
        test: &Test,
        (work, by_root): (&mut Workspace, bool),
        reduce: impl FnOnce(u128, &Gains, &mut Workspace) -> Result<Reduction, Box<Fault>>,
    ) -> Result<(Reduction, DesignClass), ReduceError> {
        let found = self.preparer.prepare(test, work).and_then(|()| {
            let digest = work.design.digest();
            let class = self.class(digest, work, by_root);
            let gains = self.valid_gains(&class, (test, &work.instances))?;
            Ok((reduce(digest, gains, work)?, class))
        });
        found.map_err(|fault| self.named(*fault, test))
    }

    /// The gains or the fault of a class. A noise that is zero at the current free values but positive at other values
    /// makes no exact rows but a fault: ℓ is maximised over values where that noise is positive.
    fn valid_gains<'c>(
        &self,
        class: &'c DesignClass,
        (test, instances): (&Test, &Instances),
    ) -> Result<&'c Gains, Box<Fault>> {
        let gains = class.gains().as_ref().map_err(|&error| root_fault(error))?;
        let exact = gains.rotations.iter().flat_map(|rotations| rotations.exact.rows());
        match exact.map(|row| instances.get(row)).find(|instance| self.preparer.has_free_noise(test, *instance)) {
            Some(Instance { meter, row }) => {
                Err(Fault::new(Subject::Value(meter), ReduceErrorKind::ExactMeasurement).on(row))
            }
            None => Ok(gains),
        }
    }

    /// The reduction of the test in the work space under given gains.
    fn reduce_prepared(
        &self,
        test: &Test,
        (digest, gains): (u128, &Gains),
        work: &mut Workspace,
    ) -> Result<Reduction, Box<Fault>> {
        let outcome = outcome(&work.design, gains, &work.data, &mut work.pass).map_err(|miss| {
            let Instance { meter, row } = work.instances.get(miss.row);
            Fault::new(Subject::Value(meter), impossible(miss)).on(row)
        })?;
        if !outcome.is_finite() {
            return Err(Fault::new(Subject::Test, ReduceErrorKind::NotFinite));
        }
        let header = ReductionHeader::new(gains, &work.covariates, (work.design.steps(), digest));
        Ok(self.counted_reduction(test, &outcome, header).into())
    }

    /// The reduction of a test, whose data pass is counted.
    pub(crate) fn counted_reduction<'a>(
        &self,
        test: &'a Test,
        outcome: &'a Outcome,
        header: ReductionHeader<'a>,
    ) -> ReductionRef<'a> {
        self.data_runs.fetch_add(1, Ordering::Relaxed);
        header.reduction(test, outcome)
    }

    /// The error made from a fault of a test, with names filled in.
    pub(crate) fn named(&self, fault: Fault, test: &Test) -> ReduceError {
        fault.name(&self.preparer.model, Some(test))
    }

    /// Counts the covariance run of a design, in lanes or alone.
    pub(crate) fn count_design_run(&self, digest: u128) {
        // threads that reach one design at the same time count once, so that the reported work does not depend on
        // threads
        self.design_runs.fetch_add(u64::from(self.classes.is_new(digest)), Ordering::Relaxed);
    }

    /// The design class of the test in the work space. `by_root`: the design is known to need square-root arrays.
    pub(crate) fn class(&self, digest: u128, work: &mut Workspace, by_root: bool) -> DesignClass {
        let make = |design: &Design, work: &mut GainsWork| {
            self.count_design_run(digest);
            self.gains_of(design, work, by_root)
        };
        class_in(&self.classes, digest, work, make)
    }

    /// The design class of the test in the work space, with gains of every row.
    fn row_class(&self, work: &mut Workspace) -> DesignClass {
        let digest = work.design.digest();
        if !has_segments(&work.design) {
            return self.class(digest, work, false);
        }
        let make = |design: &Design, work: &mut GainsWork| {
            work.every_row = true;
            let found = self.gains_of(design, work, false);
            work.every_row = false;
            found
        };
        class_in(&self.row_classes, digest, work, make)
    }

    fn gains_of(&self, design: &Design, work: &mut GainsWork, by_root: bool) -> Result<Gains, RootError> {
        let states = self.ends.then_some(&*self.preparer.order.states);
        if !by_root && let Some(gains) = information_gains(design, states, work) {
            return Ok(gains);
        }
        self.root_runs.fetch_add(1, Ordering::Relaxed);
        root_gains(design, states, self.paths)
    }
}

/// The class of the design in the work space, with gains from `make` where `classes` does not contain it.
fn class_in(
    classes: &SharedStore<Design, Result<Gains, RootError>>,
    digest: u128,
    work: &mut Workspace,
    make: impl FnOnce(&Design, &mut GainsWork) -> Result<Gains, RootError>,
) -> DesignClass {
    let Workspace { design, gains, .. } = work;
    let design = &*design;
    let make = |design: &Design| make(design, gains);
    DesignClass(classes.get(digest, |known| known.same(design), || design.clone(), make, class_bytes))
}

/// Computes the innovations of the test in the work space for σ = 0 into `pass.e`, and x̂_K into `pass.x`, with the
/// same bits as in lanes.
pub fn single_test_innovations(gains: &Gains, work: &mut Workspace) {
    let Workspace { design, data, pass, .. } = work;
    innovations((design, gains), data, pass, &mut ());
}

pub(crate) fn impossible(miss: Miss) -> ReduceErrorKind {
    ReduceErrorKind::Impossible { residual: miss.residual }
}

fn root_fault(error: RootError) -> Box<Fault> {
    match error {
        RootError::NotSemidefinite(bad) => Fault::new(Subject::Transition, bad),
        RootError::NotFinite => Fault::new(Subject::Test, ReduceErrorKind::NotFinite),
    }
}
