//! Steps and measurements of a phase in the order of the data: linear forms of the states that predict each
//! measurement, and noise before whitening.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::apply::states::{PhaseStates, Prediction, StepMoments, StepStates};
use kalfit_filter::reduce::{DesignStep, PhaseReducer, ReduceError, Workspace};
use kalfit_model::Test;

/// Linear form h'x + d of the states x, which are in the order of the kernels.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StateForm {
    /// Nonzero terms of h, as (state, coefficient).
    pub(crate) terms: Vec<(usize, f64)>,
    pub(crate) constant: f64,
}

impl StateForm {
    pub(crate) fn of(&self, x: &[f64]) -> f64 {
        self.terms.iter().map(|&(at, h)| h * x[at]).sum::<f64>() + self.constant
    }

    /// A'h for a matrix A with one row per state.
    pub(crate) fn along(&self, matrix: &DMatrix<f64>) -> DVector<f64> {
        let mut sum = DVector::zeros(matrix.ncols());
        for &(at, h) in &self.terms {
            sum.axpy(h, &matrix.row(at).transpose(), 1.0);
        }
        sum
    }

    /// h'Vh for a covariance V of the states.
    pub(crate) fn variance(&self, covariance: &DMatrix<f64>) -> f64 {
        let row = |&(i, a): &(usize, f64)| self.terms.iter().map(|&(k, b)| a * b * covariance[(i, k)]).sum::<f64>();
        let variance = self.terms.iter().map(row).sum::<f64>();
        if variance < 0.0 { 0.0 } else { variance }
    }
}

/// The state or measurement that a value at a step is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ValueSubject {
    /// A state, by its index in the phase's model.
    State(usize),
    /// (Index of the measurement in the phase's model, index of the row among the rows of the phase).
    Measurement(usize, usize),
}

/// (Rows of a step among the rows of the phase, time of the step, values of the step with the linear form of each
/// value).
pub(crate) type StepForms = (Range<usize>, Option<f64>, Vec<(ValueSubject, StateForm)>);

/// A phase of a test with the design, data and noise that the filter computes from the rows.
pub(crate) struct EvaluatedPhase<'a> {
    phase: &'a PhaseReducer,
    rows: &'a Test,
    work: Workspace,
}

impl<'a> EvaluatedPhase<'a> {
    pub(crate) fn new(phase: &'a PhaseReducer, rows: &'a Test) -> Result<EvaluatedPhase<'a>, ReduceError> {
        let preparer = phase.reducer.preparer();
        let mut work = preparer.workspace();
        work.covariances = Some(Vec::new());
        let named = |fault: Box<kalfit_filter::reduce::Fault>| phase.named(fault.name(&preparer.model, Some(rows)));
        preparer.prepare(rows, &mut work).map_err(named)?;
        Ok(EvaluatedPhase { phase, rows, work })
    }

    /// States at each step. `known`: moments of all states, one entry per step; `noisy`: whether predictions include
    /// the noise of the measurements.
    pub(super) fn states(&self, phase: usize, known: impl Iterator<Item = StepMoments>, noisy: bool) -> PhaseStates {
        let steps = self.each_step().zip(known);
        let one = |((step, rows), known): ((DesignStep<'_>, Range<usize>), StepMoments)| {
            let of = |form: StateForm| (form.of(&known.mean), form.variance(&known.covariance));
            let (mean, variances): (Vec<f64>, Vec<f64>) = self.state_forms().map(of).unzip();
            let prediction = |line: usize, (measurement, row): (usize, usize), form: StateForm| {
                let (value, variance) = of(form);
                let noise = if noisy { self.work.design.noise[line] } else { 0.0 };
                Prediction { measurement, row, value, std_dev: (variance + noise).sqrt() }
            };
            StepStates {
                time: self.time(rows.start),
                mean,
                std_dev: variances.into_iter().map(f64::sqrt).collect(),
                measurements: self.measured(&step).map(|(line, of, form)| prediction(line, of, form)).collect(),
                rows,
            }
        };
        PhaseStates { phase, steps: steps.map(one).collect() }
    }

    /// Rows, time and values of each step; the values are the states, then the measurements.
    pub(crate) fn forms(&self) -> Vec<StepForms> {
        let one = |(step, rows): (DesignStep<'_>, Range<usize>)| {
            let states = self.state_forms().enumerate().map(|(state, form)| (ValueSubject::State(state), form));
            let measured = self.measured(&step);
            let measured = measured.map(|(_, (meter, row), form)| (ValueSubject::Measurement(meter, row), form));
            (rows.clone(), self.time(rows.start), states.chain(measured).collect())
        };
        self.each_step().map(one).collect()
    }

    fn each_step(&self) -> impl Iterator<Item = (DesignStep<'_>, Range<usize>)> {
        self.work.design.each_step().zip(self.work.step_rows())
    }

    /// Linear forms of the states, in the order of the model.
    fn state_forms(&self) -> impl Iterator<Item = StateForm> {
        let place = &self.phase.reducer.preparer().order.place;
        place.iter().map(|&at| StateForm { terms: vec![(at, 1.0)], constant: 0.0 })
    }

    /// For each measurement of a step: (line of the design, (measurement, row), linear form in the states).
    fn measured(&self, step: &DesignStep<'_>) -> impl Iterator<Item = (usize, (usize, usize), StateForm)> {
        let (work, model) = (&self.work, &self.phase.reducer.preparer().model);
        step.lines.clone().zip(step.rows.clone()).map(move |(line, row)| {
            let instance = work.instances.get(row);
            let (states, h) = work.design.terms(line);
            let terms = states.iter().map(|&state| state as usize).zip(h.iter().copied()).collect();
            // `data.values` holds z - d
            let measured = self.rows.numbers(instance.row)[model.measurements[instance.meter].column];
            let form = StateForm { terms, constant: measured - work.data.values[row] };
            (line, (instance.meter, instance.row), form)
        })
    }

    fn time(&self, row: usize) -> Option<f64> {
        let column = self.phase.reducer.preparer().model.clock.time?;
        Some(self.rows.numbers(row)[column])
    }
}
