//! The evidence of a test, phase by phase: rows of data, estimates of a filter, or a finished reduction.

mod chain;
mod exact_rows;
mod path;
mod phases;
mod reduction;
mod split;
mod terminal;

pub use chain::{Chain, ChainPhase, Link};
pub use exact_rows::{ExactRows, FreeStates};
pub use path::Path;
pub use phases::Phases;
pub use reduction::{Reduction, ReductionRef, unpack};
pub use split::SplitError;
pub use terminal::Terminal;

use nalgebra::{DMatrix, DVector};

use crate::ensemble::{Label, Labels, Test, TestId};
use crate::model::{PhasedModel, Slots};
pub use kalfit_algebra::symmetric::eigen;

/// One test with all phases. The test may lack the last phases of the model, but not the first phases.
#[derive(Debug, Clone, PartialEq)]
pub struct PhasedTest {
    /// Id of the test.
    pub id: TestId,
    /// Evidence of each phase, from the first phase on.
    pub phases: Phases,
}

/// The evidence of one phase of a test.
#[derive(Debug, Clone, PartialEq)]
pub enum Evidence {
    /// The rows of the phase.
    Rows(Test),
    /// Estimates that a filter made from the rows of the phase (theory §8).
    Estimates(Box<Estimates>),
    /// The reduction of the phase at the α of the fit.
    Reduced(Box<PhaseReduction>),
}

/// The estimates ŝ that a filter, optimal or not, made from one phase (theory §8). ŝ is linear in the data; with the
/// final state x_K it obeys
///
/// ```text
/// [x_K; ŝ] = [φ_K; S] x_0 + [s̄_1; s̄] + D × white noise
/// ```
///
/// x_0 is the whole state of the phase's model, n numbers in file order. ŝ holds any linear functions of the data,
/// usually the estimates [x̂_K; x̂_{0|K}] of the filter; more functions contain more information.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimates {
    /// ŝ, m numbers.
    pub estimates: DVector<f64>,
    /// s̄, the mean of ŝ at x_0 = 0: m numbers.
    pub offsets: DVector<f64>,
    /// S, m × n.
    pub sensitivities: DMatrix<f64>,
    /// φ_K from x_0 to the last step, n × n.
    pub transition: DMatrix<f64>,
    /// s̄_1, the part of x_K that comes from known inputs: n numbers.
    pub drift: DVector<f64>,
    /// D, (n + m) × any number of columns: DD' = Γ, the covariance of (x_K, ŝ) at a known x_0.
    pub root: DMatrix<f64>,
    /// One row with the columns of the model that are constant within the test; the cells of other columns, and unknown
    /// cells, are missing.
    pub constants: Test,
    /// Number of steps behind the estimates.
    pub steps: usize,
    /// Number of scalar measurements behind the estimates.
    pub observations: usize,
}

/// The reduction of one phase given the entering coordinates σ of the phase
/// ([`Phase::entering`](crate::model::Phase::entering)).
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseReduction {
    /// The reduction of log p(z | σ), without a chain.
    pub reduction: Reduction,
    /// The state after the last step given σ; `None` where no phase of the model follows.
    pub terminal: Option<Terminal>,
    /// T and t of the phase; `None` for the first phase.
    pub inherited: Option<Inherited>,
    /// Names of the groups of the test, the outermost first; empty if the reduction came without names of groups.
    pub groups: Vec<Label>,
}

/// What a phase inherits: σ = [ξ; 0] + T x_K + t, with x_K the last state of the phase before.
#[derive(Debug, Clone, PartialEq)]
pub struct Inherited {
    /// T, q × n: q entering coordinates σ, n states of the phase before.
    pub transition: DMatrix<f64>,
    /// t, a list of q numbers.
    pub input: DVector<f64>,
}

impl Estimates {
    /// A root D of Γ = DD' from the eigenvalues of Γ scaled to unit diagonal. Eigenvalues up to `rounding` times the
    /// largest eigenvalue are set to zero: tiny variances that come from rounding alone would count as almost exact
    /// knowledge.
    ///
    /// # Errors
    /// (least eigenvalue, largest eigenvalue), if the least eigenvalue is more negative than rounding explains;
    /// (negative variance, largest variance), if a variance is negative.
    pub fn root_of(covariance: &DMatrix<f64>, rounding: f64) -> Result<DMatrix<f64>, [f64; 2]> {
        let variances = covariance.diagonal();
        if let Some(&negative) = variances.iter().find(|x| **x < 0.0) {
            return Err([negative, variances.max()]);
        }
        let scale = variances.map(f64::sqrt);
        let correlation = |i: usize, j: usize| {
            let (element, of) = (covariance[(i, j)], scale[i] * scale[j]);
            // An element of variance zero has no covariances; a nonzero covariance here makes an eigenvalue negative.
            if of > 0.0 {
                element / scale[i] / scale[j]
            } else {
                element.signum() * f64::from(u8::from(element != 0.0))
            }
        };
        let size = scale.len();
        let (values, vectors) = eigen(&DMatrix::from_fn(size, size, correlation));
        let (least, largest) = (values.first().copied().unwrap_or(0.0), values.last().copied().unwrap_or(0.0));
        if least < -1e3 * rounding * largest {
            return Err([least, largest]);
        }
        let significant: Vec<usize> = (0..size).filter(|&k| values[k] > rounding * largest).collect();
        Ok(DMatrix::from_fn(size, significant.len(), |i, k| {
            scale[i] * vectors[(i, significant[k])] * values[significant[k]].sqrt()
        }))
    }
}

impl From<Test> for PhasedTest {
    fn from(test: Test) -> PhasedTest {
        PhasedTest { id: test.id.clone(), phases: Evidence::Rows(test).into() }
    }
}

impl PhasedTest {
    /// The rows of each phase whose evidence is rows.
    pub fn rows(self) -> impl Iterator<Item = Test> {
        self.phases.into_iter().filter_map(|evidence| match evidence {
            Evidence::Rows(rows) => Some(rows),
            Evidence::Estimates(_) | Evidence::Reduced(_) => None,
        })
    }

    /// Number of rows of all phases.
    pub fn row_count(&self) -> usize {
        let rows = |evidence: &Evidence| match evidence {
            Evidence::Rows(rows) => rows.rows(),
            Evidence::Estimates(_) | Evidence::Reduced(_) => 0,
        };
        self.phases.iter().map(rows).sum()
    }

    /// The rows of all phases as one test, in the order of the rows in the data; rows with one source are phase after
    /// phase. This undoes [`PhasedModel::split`](crate::model::PhasedModel::split).
    pub fn joined(self) -> Test {
        let id = self.id.clone();
        let mut phases: Vec<Test> = self.rows().collect();
        if phases.len() == 1 {
            return phases.remove(0);
        }
        let all = phases.iter().flat_map(|rows| (0..rows.rows()).map(move |row| (rows, row)));
        let mut all: Vec<(&Test, usize)> = all.collect();
        all.sort_by_key(|(rows, row)| {
            let source = rows.source(*row);
            (source.file, source.row)
        });
        let mut whole = phases.first().map_or_else(|| Test::new(id, 0, 0), |phase| phase.first(0));
        all.into_iter().for_each(|(rows, row)| whole.push(rows.numbers(row), rows.texts(row), rows.source(row)));
        whole
    }
}

impl Evidence {
    /// The rows of data, or the single row of constants of estimates; `None` for a reduction.
    pub fn cells(&self) -> Option<&Test> {
        match self {
            Evidence::Rows(test) => Some(test),
            Evidence::Estimates(estimates) => Some(&estimates.constants),
            Evidence::Reduced(_) => None,
        }
    }
}

impl Slots {
    /// The free values of a model in phases: the levels of a column are taken from the rows of all phases and from the
    /// constants of estimates.
    pub fn in_phases(model: &PhasedModel, labels: &Labels, tests: &[PhasedTest]) -> Slots {
        let all: Vec<&Test> = tests.iter().flat_map(|test| &test.phases).filter_map(Evidence::cells).collect();
        Slots::of(model.shared(), labels, &all)
    }
}
