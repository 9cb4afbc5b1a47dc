//! Innovations of tests in phases in plain covariances: one filter over all phases that starts from the known law of what enters.
//!
//! With nothing unknown, σ ~ N(m, C) is part of a and P0 of a phase, as Σ is of a test of one phase, and from the last step of a
//! phase on
//!
//! ```text
//! m = [μ_j; 0] + T x̂_K + t        C = EΣE' + T P_K T'
//! ```
//!
//! Tests of one design then have one covariance run, and each but a data pass.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::innovations::chained::Start;
use crate::innovations::rows::{self, Figures};
use crate::innovations::series::Innovation;
use crate::model::{Alpha, Phase, PhasedModel};
use crate::reduce::{
    Cells, Evidence, Frame, Gains, Inherited, PhaseReducer, PhasedTest, ReduceError, Reducer, Terminal, Workspace,
};

/// The filters of the phases.
#[derive(Debug)]
pub(super) struct Plain {
    phases: Vec<Known>,
}

/// The filter of a phase that nothing unknown enters.
#[derive(Debug)]
struct Known {
    reducer: Reducer,
    /// The reducer's order of states, without unknowns.
    frame: Arc<Frame>,
    /// Through which states σ enters.
    entering: Vec<usize>,
}

/// What a phase leaves: its innovations, and the last state where another phase follows.
type Left = (Vec<Innovation>, Option<Terminal>);

impl Plain {
    pub(super) fn new(model: &PhasedModel, alpha: &Alpha) -> Result<Plain, ReduceError> {
        let last = model.phases.len() - 1;
        let of = |(at, phase): (usize, &Phase)| -> Result<Known, ReduceError> {
            let reducer = Reducer::of_known_starts(&phase.entry_model(), alpha)?;
            let reducer = if at < last { reducer.with_ends() } else { reducer };
            let frame = Arc::new(reducer.workspace().design.frame.without_unknowns());
            Ok(Known { reducer, frame, entering: phase.entering() })
        };
        Ok(Plain { phases: model.phases.iter().enumerate().map(of).collect::<Result<_, _>>()? })
    }

    pub(super) fn workspace(&self) -> Vec<Workspace> {
        let of = |known: &Known| {
            let mut work = known.reducer.workspace();
            work.design.frame = known.frame.clone();
            work
        };
        self.phases.iter().map(of).collect()
    }

    /// The innovations of a test all of whose phases are given by rows; `None` where some phase calls for square roots.
    pub(super) fn series(
        &self,
        whole: &PhasedTest,
        (starts, carries): (&[Start], &[PhaseReducer]),
        (work, cells): (&mut [Workspace], &mut Cells),
    ) -> Result<Option<Vec<Innovation>>, ReduceError> {
        let mut series = Vec::new();
        let mut before: Option<Terminal> = None;
        for (at, (known, evidence)) in self.phases.iter().zip(&whole.phases).enumerate() {
            let Evidence::Rows(rows) = evidence else { return Ok(None) };
            let inherited = match &before {
                Some(terminal) => Some((terminal, carries[at].inherited(rows, cells)?)),
                None => None,
            };
            let start = &starts[at];
            let begin = |work: &mut Workspace| {
                let link = inherited.as_ref().map(|(terminal, inherited)| (*terminal, &**inherited));
                known.begin(start, link, work);
            };
            let look = |gains: &Gains, work: &mut Workspace| -> Option<Left> {
                let figures = |value: f64, weight: f64, _: &[f64]| {
                    let (variance, standardised) = (weight.recip(), value * weight.sqrt());
                    Figures { value, variance, standardised }
                };
                if gains.turns.is_some() {
                    return None;
                }
                let found = rows::series((at, rows, start.time), gains, work, figures);
                let states = &known.reducer.preparer().order.states;
                Some((found, gains.end.as_ref().map(|end| end.terminal(states, &work.pass.x))))
            };
            let left = known.reducer.with_start(rows, &mut work[at], begin, look);
            let Some((found, terminal)) = left.map_err(|error| carries[at].named(error))? else { return Ok(None) };
            series.extend(found);
            before = terminal;
        }
        Ok(Some(series))
    }
}

impl Known {
    /// Adds the law of σ to a and P0.
    fn begin(&self, start: &Start, link: Option<(&Terminal, &Inherited)>, work: &mut Workspace) {
        let q = self.entering.len();
        let mut mean: DVector<f64> = start.mean_of(&work.covariates, q);
        let mut covariance: DMatrix<f64> = start.covariance.clone().resize(q, q, 0.0);
        if let Some((Terminal { mean: state, root, .. }, Inherited { transition, input })) = link {
            mean += transition * state + input;
            let carried = transition * root;
            covariance += &carried * carried.transpose();
        }
        let place = |row: usize| self.reducer.preparer().order.place[self.entering[row]];
        let r = work.design.frame.r;
        for i in 0..q {
            work.data.start[place(i)] += mean[i];
            for k in 0..=i {
                let (a, b) = (place(i).max(place(k)), place(i).min(place(k)));
                work.design.variance[a * r + b] += covariance[(i, k)];
            }
        }
    }
}
