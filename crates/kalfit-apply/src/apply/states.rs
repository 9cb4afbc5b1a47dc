//! States of tests at each step of the records.

use std::ops::Range;

use nalgebra::DMatrix;

use crate::apply::{Applied, ApplyError};
use kalfit_model::{Evidence, PhasedTest};

/// Which measurements the states at a step are conditioned on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StateKind {
    /// All measurements before the step.
    Predicted,
    /// All measurements before the step and at the step.
    Filtered,
    /// All measurements of the test, before and after the step; where tests are in groups, all measurements of all
    /// tests of the group.
    Smoothed,
}

/// States of one phase of a test.
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseStates {
    /// Index of the phase in the model.
    pub phase: usize,
    /// States at each step.
    pub steps: Vec<StepStates>,
}

/// States at one step: rows of the same time are one step.
#[derive(Debug, Clone, PartialEq)]
pub struct StepStates {
    /// Rows of the step among the rows of the phase.
    pub rows: Range<usize>,
    /// Time of the step, where the model has a column of times.
    pub time: Option<f64>,
    /// Mean of each state of the phase's model.
    pub mean: Vec<f64>,
    /// Standard deviation of each state.
    pub std_dev: Vec<f64>,
    /// Prediction of each value that was measured at the step.
    pub measurements: Vec<Prediction>,
}

/// One measured value, as predicted by the states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// Index of the measurement in the phase's model.
    pub measurement: usize,
    /// Row of the measurement among the rows of the phase.
    pub row: usize,
    /// Mx + d at the mean of the states.
    pub value: f64,
    /// Standard deviation of `value`: including the noise of the measurement for [`StateKind::Predicted`], without the
    /// noise for the other kinds.
    pub std_dev: f64,
}

/// Mean (n) and covariance (n × n) of the states at one step, in the order of the kernels.
pub(super) struct StepMoments {
    pub(super) mean: Vec<f64>,
    pub(super) covariance: DMatrix<f64>,
}

impl Applied<'_> {
    /// The states of the tests with indices `tests` at every step, phase by phase.
    ///
    /// # Errors
    /// A phase that is given by estimates or by a reduction, or has a separate filter; rows that cannot be filtered.
    pub fn states(&self, kind: StateKind, tests: Range<usize>) -> Result<Vec<Vec<PhaseStates>>, ApplyError> {
        self.tests[tests.clone()].iter().try_for_each(|test| self.refuse_without_rows(test))?;
        match kind {
            StateKind::Smoothed => self.smoothed(tests),
            StateKind::Predicted | StateKind::Filtered => self.forward(kind, tests),
        }
    }

    /// Checks that [`states`](Applied::states) are known for all tests.
    ///
    /// # Errors
    /// [`ApplyError::NoRows`], for the first test whose states are not known.
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
