//! States along the records of tests.

use std::ops::Range;

use nalgebra::DMatrix;

use crate::apply::{Applied, ApplyError};
use kalfit_model::{Evidence, PhasedTest};

/// What is known of a state when it is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StateKind {
    /// All that was measured before the step.
    Predicted,
    /// All that was measured up to the step, the step among it.
    Filtered,
    /// All that was measured in the test, before and after the step; where tests stand in groups, in all tests of the group.
    Smoothed,
}

/// States of one phase of a test.
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseStates {
    /// The phase, by its place in the model.
    pub phase: usize,
    /// Step by step.
    pub steps: Vec<StepStates>,
}

/// States at one step: rows of the same time are one step.
#[derive(Debug, Clone, PartialEq)]
pub struct StepStates {
    /// Its rows among those of the phase.
    pub rows: Range<usize>,
    /// Its time, where the model has a column of times.
    pub time: Option<f64>,
    /// One number for each state of the phase's model.
    pub mean: Vec<f64>,
    /// Their standard deviations.
    pub std_dev: Vec<f64>,
    /// What the states say of each value that was measured at the step.
    pub measurements: Vec<Prediction>,
}

/// What the states say of one measured value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// The measurement, by its place in the phase's model.
    pub measurement: usize,
    /// Its row among those of the phase.
    pub row: usize,
    /// Mx + d at the mean of the states.
    pub value: f64,
    /// Its standard deviation: with the noise of the measurement where it is predicted, without it where it is filtered or smoothed.
    pub std_dev: f64,
}

/// Mean and covariance of the states after each step, by place in the kernels: n and n × n numbers.
pub(super) struct StepMoments {
    pub(super) mean: Vec<f64>,
    pub(super) covariance: DMatrix<f64>,
}

impl Applied<'_> {
    /// The states of some of the tests at every step of their records, phase by phase.
    ///
    /// # Errors
    /// A phase that is given by estimates or by a reduction, or has a filter of its own; rows that cannot be filtered.
    pub fn states(&self, kind: StateKind, tests: Range<usize>) -> Result<Vec<Vec<PhaseStates>>, ApplyError> {
        self.tests[tests.clone()].iter().try_for_each(|test| self.refuse_without_rows(test))?;
        match kind {
            StateKind::Smoothed => self.smoothed(tests),
            StateKind::Predicted | StateKind::Filtered => self.forward(kind, tests),
        }
    }

    /// That [`states`](Applied::states) are known of all tests.
    ///
    /// # Errors
    /// [`ApplyError::NoRows`], of the first test whose are not.
    pub fn check_states(&self) -> Result<(), ApplyError> {
        self.tests.iter().try_for_each(|test| self.refuse_without_rows(test))
    }

    pub(super) fn refuse_without_rows(&self, test: &PhasedTest) -> Result<(), ApplyError> {
        for (evidence, phase) in test.phases.iter().zip(&self.model.phases) {
            let found = match evidence {
                Evidence::Rows(_) if phase.filter.is_none() => continue,
                Evidence::Rows(_) => "a filter of its own",
                Evidence::Estimates(_) => "estimates",
                Evidence::Reduced(_) => "a reduction",
            };
            return Err(ApplyError::NoRows { test: test.id.to_string(), phase: phase.name.clone(), found });
        }
        Ok(())
    }
}
