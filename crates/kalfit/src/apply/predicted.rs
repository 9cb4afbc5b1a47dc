//! What states say of what was measured: steps and measurements of a phase as they stand in the data, noise not whitened.

use std::ops::Range;

use crate::apply::states::{Known, PhaseStates, Prediction, StepStates};
use crate::ensemble::Test;
use crate::reduce::{PhaseReducer, ReduceError, Workspace};

/// A phase of a test, evaluated.
pub(super) struct Record<'a> {
    phase: &'a PhaseReducer,
    rows: &'a Test,
    work: Workspace,
}

impl<'a> Record<'a> {
    pub(super) fn new(phase: &'a PhaseReducer, rows: &'a Test) -> Result<Record<'a>, ReduceError> {
        let preparer = phase.reducer.preparer();
        let mut work = preparer.workspace();
        work.covariances = Some(Vec::new());
        let named = |fault: Box<crate::reduce::Fault>| phase.named(fault.name(&preparer.model, Some(rows)));
        preparer.prepare(rows, &mut work).map_err(named)?;
        Ok(Record { phase, rows, work })
    }

    /// Steps with what is known of the states after each of them; `noisy`: measurements have their noise.
    pub(super) fn states(&self, phase: usize, known: impl Iterator<Item = Known>, noisy: bool) -> PhaseStates {
        let steps = self.work.design.each_step().zip(self.work.step_rows()).zip(known);
        let one = |((step, rows), known): ((crate::reduce::Step<'_>, Range<usize>), Known)| {
            let place = &self.phase.reducer.preparer().order.place;
            let variance = |&at: &usize| known.covariance[(at, at)].max(0.0);
            let lines = step.lines.clone().zip(step.rows.clone());
            StepStates {
                time: self.time(rows.start),
                mean: place.iter().map(|&at| known.mean[at]).collect(),
                std_dev: place.iter().map(|at| variance(at).sqrt()).collect(),
                measurements: lines.map(|line| self.prediction(line, &known, noisy)).collect(),
                rows,
            }
        };
        PhaseStates { phase, steps: steps.map(one).collect() }
    }

    fn time(&self, row: usize) -> Option<f64> {
        let column = self.phase.reducer.preparer().model.clock.time?;
        Some(self.rows.numbers(row)[column])
    }

    fn prediction(&self, (line, row): (usize, usize), known: &Known, noisy: bool) -> Prediction {
        let (work, model) = (&self.work, &self.phase.reducer.preparer().model);
        let instance = work.instances.get(row);
        let (states, h) = work.design.terms(line);
        let terms = || states.iter().map(|&state| state as usize).zip(h.iter().copied());
        let moved: f64 = terms().map(|(at, h)| h * known.mean[at]).sum();
        // the data of a measurement are z - d
        let measured = self.rows.numbers(instance.row)[model.measurements[instance.meter].column];
        let constant = measured - work.data.values[row];
        let variance: f64 =
            terms().map(|(i, a)| terms().map(|(k, b)| a * b * known.covariance[(i, k)]).sum::<f64>()).sum();
        let noise = if noisy { work.design.noise[line] } else { 0.0 };
        Prediction {
            measurement: instance.meter,
            row: instance.row,
            value: moved + constant,
            std_dev: (variance.max(0.0) + noise).sqrt(),
        }
    }
}
