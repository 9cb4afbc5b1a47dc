//! Reduction of one phase of a test, from rows, estimates or a given reduction.

use std::borrow::Cow;

use nalgebra::DMatrix;

use crate::reduce::carry::Inheritance;
use crate::reduce::error::{ReduceError, ReduceErrorKind, check_shape, finite, refuse};
use crate::reduce::prepare::Workspace;
use crate::reduce::reducer::{ReducedWithEnd, Reducer};
use crate::reduce::steps::GatheredCells;
use crate::reduce::subject::WHOLE;
use crate::reduce::{EstimateReducer, FilterRunner, Terminal};
use kalfit_model::Reduction;
use kalfit_model::Test;
use kalfit_model::{Alpha, Model, Phase};
use kalfit_model::{Estimates, Evidence, Inherited, PhaseReduction};

/// Position of a phase among the phases of a model.
#[derive(Debug, Clone)]
pub(crate) struct PhasePosition {
    /// Name of the phase; `None` for the only phase of a model.
    pub(crate) name: Option<String>,
    /// Number of states of the phase before; `None` for the first phase.
    pub(crate) before: Option<usize>,
    /// Whether the model has a next phase.
    pub(crate) followed: bool,
}

/// Reducer of one phase: the filter in the phase's entering coordinates, and the map by which it inherits from the
/// phase before.
#[derive(Debug)]
pub struct PhaseReducer {
    position: PhasePosition,
    /// Reducer of rows of the phase, in entering coordinates.
    pub reducer: Reducer,
    /// Map by which the phase inherits from the phase before; `None` for the first phase.
    pub(crate) inheritance: Option<Inheritance>,
    /// p: number of elements of the phase's ξ, which are the first p entering coordinates.
    pub own: usize,
    /// Reducer of estimates of this phase.
    estimates: EstimateReducer,
    /// Suboptimal filter of the phase; `None` where the optimal filter runs.
    filter: Option<FilterRunner>,
    sizes: Sizes,
}

/// Sizes that a given reduction of the phase must have.
#[derive(Debug, Clone, Copy)]
struct Sizes {
    /// Number of entering coordinates.
    q: usize,
    /// Number of states.
    n: usize,
    regressions: usize,
}

/// The reduction of one phase, owned or borrowed.
#[derive(Clone)]
pub(crate) struct ReducedPhase<'a> {
    pub(crate) reduction: Cow<'a, Reduction>,
    /// Last state of the phase; `None` where no phase follows.
    pub(crate) terminal: Option<Cow<'a, Terminal>>,
    /// Map by which the phase inherits from the phase before; `None` for the first phase.
    pub(crate) inherited: Option<Cow<'a, Inherited>>,
}

impl PhaseReducer {
    /// The reducer of a phase. `make_reducer` creates the reducer in entering coordinates.
    pub(crate) fn new(
        (phase, alpha): (&Phase, &Alpha),
        position: PhasePosition,
        make_reducer: &dyn Fn(&Model) -> Result<Reducer, ReduceError>,
    ) -> Result<PhaseReducer, ReduceError> {
        let named = |error| of_phase(position.name.as_deref(), error);
        let reducer = make_reducer(&phase.entry_model()).map_err(named)?;
        let reducer = if position.followed { reducer.with_ends() } else { reducer };
        let at = reducer.preparer().at();
        let inheritance = position.before.map(|before| Inheritance::new(phase, before, &at)).transpose();
        let inheritance = inheritance.map_err(|fault| named(fault.name(&phase.model, None)))?;
        let sizes = Sizes {
            q: at.model.estimated.len(),
            n: at.model.states.len(),
            regressions: at.model.mean.regression.len(),
        };
        let own = phase.model.dimension();
        let estimates = EstimateReducer::new(phase, alpha).map_err(named)?;
        let filter = phase.filter.as_ref().map(|_| FilterRunner::new(phase, alpha)).transpose().map_err(named)?;
        Ok(PhaseReducer { position, reducer, inheritance, own, estimates, filter, sizes })
    }

    /// Whether rows of the phase are reduced by the optimal filter.
    pub(crate) fn is_optimal(&self) -> bool {
        self.filter.is_none()
    }

    /// Adds the name of this phase to an error, where the model has several phases.
    pub fn named(&self, error: ReduceError) -> ReduceError {
        of_phase(self.position.name.as_deref(), error)
    }

    /// The reducer that freezes no gains: every step of every record is computed in full.
    pub(crate) fn unfrozen(self) -> PhaseReducer {
        PhaseReducer { reducer: self.reducer.unfrozen(), ..self }
    }

    /// Reduces the phase of a test. `designs`: no measured value is read; `linked`: the test has a phase after it.
    pub(crate) fn part<'a>(
        &'a self,
        (id, evidence): (&str, &'a Evidence),
        (work, cells): (&mut Workspace, &mut GatheredCells),
        (designs, linked): (bool, bool),
    ) -> Result<ReducedPhase<'a>, ReduceError> {
        let part = match (evidence, &self.filter) {
            (Evidence::Rows(rows), None) => self.reduce_rows(rows, self.reduce_to_end(rows, work, designs), cells),
            (Evidence::Rows(rows), Some(filter)) => {
                filter.run(rows).and_then(|estimates| self.reduce_estimates(id, &estimates, cells))
            }
            (Evidence::Estimates(estimates), _) => self.reduce_estimates(id, estimates, cells),
            (Evidence::Reduced(piece), _) => self.continue_reduction(id, piece, linked),
        };
        part.map_err(|error| self.named(error))
    }

    /// Reduces the phase from estimates of a filter that need not be optimal, run here or elsewhere.
    fn reduce_estimates<'a>(
        &'a self,
        id: &str,
        estimates: &Estimates,
        cells: &mut GatheredCells,
    ) -> Result<ReducedPhase<'a>, ReduceError> {
        let (reduction, terminal) = self.estimates.reduce(id, estimates)?;
        let at = self.reducer.preparer().at();
        let inherited = self.inheritance.as_ref();
        let inherited = inherited.map(|inheritance| inheritance.of(&at, &estimates.constants, cells)).transpose()?;
        let terminal = self.position.followed.then_some(Cow::Owned(terminal));
        Ok(ReducedPhase { reduction: Cow::Owned(reduction), terminal, inherited })
    }

    fn reduce_to_end(&self, rows: &Test, work: &mut Workspace, designs: bool) -> ReducedWithEnd {
        if designs {
            let (reduction, class) = self.reducer.designed(rows, work)?;
            return Ok((reduction, self.reducer.ending(&class, std::iter::repeat(0.0))));
        }
        self.reducer.reduce_to_end(rows, work)
    }

    /// The reduced phase of a test, from `found`, the reduction of `rows`.
    pub(crate) fn complete<'a>(
        &'a self,
        rows: &Test,
        found: ReducedWithEnd,
        cells: &mut GatheredCells,
    ) -> Result<ReducedPhase<'a>, ReduceError> {
        self.reduce_rows(rows, found, cells).map_err(|error| self.named(error))
    }

    fn reduce_rows<'a>(
        &'a self,
        rows: &Test,
        found: ReducedWithEnd,
        cells: &mut GatheredCells,
    ) -> Result<ReducedPhase<'a>, ReduceError> {
        let (reduction, terminal) = found?;
        self.refuse_exact(&rows.id, &reduction)?;
        let inherited = self.inheritance.is_some().then(|| self.inherited_from(rows, cells)).transpose()?;
        Ok(ReducedPhase {
            reduction: Cow::Owned(reduction),
            terminal: terminal.map(|end| Cow::Owned(end.terminal())),
            inherited,
        })
    }

    /// Refuses noise-free measurements of estimated states in a model with several phases.
    fn refuse_exact(&self, id: &str, reduction: &Reduction) -> Result<(), ReduceError> {
        let refused = self.position.name.is_some() && reduction.exact.is_some();
        if refused { Err(refuse(Some(id), WHOLE, ReduceErrorKind::ExactMeasurement)) } else { Ok(()) }
    }

    /// The map by which a later phase inherits from the phase before, evaluated on `rows`.
    pub fn inherited(&self, rows: &Test, cells: &mut GatheredCells) -> Result<Cow<'_, Inherited>, ReduceError> {
        self.inherited_from(rows, cells).map_err(|error| self.named(error))
    }

    fn inherited_from(&self, rows: &Test, cells: &mut GatheredCells) -> Result<Cow<'_, Inherited>, ReduceError> {
        let inheritance = self.inheritance.as_ref().expect("a later phase inherits");
        inheritance.of(&self.reducer.preparer().at(), rows, cells)
    }

    /// The given reduction `piece` of the phase; an error where a shape is not that of the phase. `linked`: the test
    /// has a phase after this one.
    fn continue_reduction<'a>(
        &self,
        id: &str,
        piece: &'a PhaseReduction,
        linked: bool,
    ) -> Result<ReducedPhase<'a>, ReduceError> {
        let Sizes { q, n, regressions } = self.sizes;
        let before = self.position.before;
        let PhaseReduction { reduction, terminal, inherited, .. } = piece;
        let refuse = |what: &str, kind: ReduceErrorKind| refuse(Some(id), what, kind);
        let check = |what: &str, numbers: &[f64], found: (usize, usize), expected: (usize, usize)| {
            check_shape(found, expected).and_then(|()| finite(numbers)).map_err(|kind| refuse(what, kind))
        };
        let check_numbers =
            |what: &str, numbers: &[f64], expected: usize| check(what, numbers, (numbers.len(), 1), (expected, 1));
        let check_matrix = |what: &str, found: &DMatrix<f64>, rows: usize, columns: usize| {
            check(what, found.as_slice(), found.shape(), (rows, columns))
        };
        check_numbers("constant of the reduction", &[reduction.constant], 1)?;
        check_numbers("data of the reduction", &reduction.data, q)?;
        check_numbers("factor of the reduction", &reduction.factor, q * (q + 1) / 2)?;
        check_numbers("covariates of the reduction", &reduction.covariates, regressions)?;
        self.refuse_exact(id, reduction)?;
        if let Some(exact) = &reduction.exact {
            let rows = exact.values.len();
            check_numbers("exact values of the reduction", &exact.values, rows)?;
            check_numbers("exact rows of the reduction", &exact.coefficients, rows * q)?;
        }
        if let Some(value) = (0..q).map(|k| reduction.factor[k * (k + 3) / 2]).find(|diagonal| *diagonal < 0.0) {
            return Err(refuse("factor of the reduction", ReduceErrorKind::NegativeDiagonal { value }));
        }
        if let Some(terminal) = terminal {
            check_numbers("mean of the last state", terminal.mean.as_slice(), n)?;
            check_matrix("sensitivity of the last state", &terminal.sensitivity, n, q)?;
            check_matrix("covariance root of the last state", &terminal.root, n, terminal.root.ncols())?;
        } else if linked {
            return Err(refuse(WHOLE, ReduceErrorKind::Absent { what: "last state" }));
        }
        match (inherited, before) {
            (Some(inherited), Some(before)) => {
                check_matrix("transition from the phase before", &inherited.transition, q, before)?;
                check_numbers("input from the phase before", inherited.input.as_slice(), q)?;
            }
            (None, Some(_)) => {
                let kind = ReduceErrorKind::Absent { what: "transition from the phase before" };
                return Err(refuse(WHOLE, kind));
            }
            (Some(inherited), None) => {
                check_matrix("transition from the phase before", &inherited.transition, 0, 0)?;
            }
            (None, None) => {}
        }
        Ok(ReducedPhase {
            reduction: Cow::Borrowed(reduction),
            terminal: terminal.as_ref().map(Cow::Borrowed),
            inherited: inherited.as_ref().filter(|_| before.is_some()).map(Cow::Borrowed),
        })
    }
}

impl ReducedPhase<'_> {
    /// The owned reduction of the phase.
    pub(crate) fn into_piece(self) -> PhaseReduction {
        PhaseReduction {
            reduction: self.reduction.into_owned(),
            terminal: self.terminal.map(Cow::into_owned),
            inherited: self.inherited.map(Cow::into_owned),
            groups: Vec::new(),
        }
    }

    /// The map by which a later phase inherits from the phase before.
    pub(crate) fn inherits(&self) -> &Inherited {
        self.inherited.as_ref().expect("a later phase inherits")
    }

    /// The last state of a phase that another phase follows.
    pub(crate) fn last(&self) -> &Terminal {
        self.terminal.as_ref().expect("a phase that another follows has an end")
    }
}

/// Adds the name of the phase, if there is one, to an error.
fn of_phase(name: Option<&str>, error: ReduceError) -> ReduceError {
    let Some(name) = name else { return error };
    let what =
        if error.what == WHOLE { format!("phase `{name}`") } else { format!("{} of phase `{name}`", error.what) };
    ReduceError { what, ..error }
}
