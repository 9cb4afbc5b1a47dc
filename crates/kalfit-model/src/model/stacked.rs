//! Populations of tests in several phases: ξ = (ξ_1, …, ξ_I), independent from phase to phase (theory §7).

use std::ops::Range;

use crate::model::{Phase, PhasedModel, Population};

impl Population {
    /// The population of each phase: parts of μ, of the regression coefficients and of Σ. `self` must have the
    /// dimensions of the model.
    pub fn by_phase(&self, model: &PhasedModel) -> Vec<Population> {
        let mut coefficients = self.coefficients.as_slice();
        let phase_population = |(phase, range): (&Phase, Range<usize>)| {
            let (phase_coefficients, rest) = coefficients.split_at(phase.model.mean.regression.len());
            coefficients = rest;
            let covariance = self.covariance.view((range.start, range.start), (range.len(), range.len())).into_owned();
            Population { mean: self.mean[range].to_vec(), coefficients: phase_coefficients.to_vec(), covariance }
        };
        model.phases.iter().zip(model.ranges()).map(phase_population).collect()
    }
}
