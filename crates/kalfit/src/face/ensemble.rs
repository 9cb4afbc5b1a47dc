//! A model with its tests.

use crate::build::{Columns, ColumnsError};
use crate::dynamic::DynamicError;
use crate::ensemble::Labels;
use crate::estimate::{FitError, Progress, Silent};
use crate::face::fit::{self, Fit, Options};
use crate::model::{Alpha, ParameterError, PhasedModel, Population};
use crate::record::MixedGroup;
use crate::reduce::{PhasedReducer, PhasedTest, ReduceError, Reduction};
use crate::simulate::{Designs, SimulateError, Simulator};

/// A model with the tests that it is to be fitted to.
#[derive(Debug, Clone)]
pub struct Ensemble {
    model: PhasedModel,
    labels: Labels,
    tests: Vec<PhasedTest>,
}

/// Why there is no fit.
#[derive(Debug, thiserror::Error)]
pub enum EnsembleError {
    /// The columns are not those of the model.
    #[error(transparent)]
    Columns(#[from] ColumnsError),
    /// A test has no reduction.
    #[error(transparent)]
    Reduce(#[from] Box<ReduceError>),
    /// μ and Σ cannot be estimated.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// Nor can α.
    #[error(transparent)]
    Dynamic(#[from] Box<DynamicError>),
    /// Free parameters where nothing estimates them.
    #[error(transparent)]
    Parameters(#[from] ParameterError),
    /// A test of two groups.
    #[error(transparent)]
    Group(#[from] MixedGroup),
    /// A reduction of another model.
    #[error("test `{test}` has {found} unknown numbers, expected {expected}: {}", names.join(", "))]
    Dimension {
        /// Id of the test.
        test: String,
        /// Unknown numbers of the test.
        found: usize,
        /// Those of the model.
        expected: usize,
        /// Their names.
        names: Vec<String>,
    },
}

impl From<ReduceError> for EnsembleError {
    fn from(error: ReduceError) -> EnsembleError {
        EnsembleError::Reduce(Box::new(error))
    }
}

impl From<DynamicError> for EnsembleError {
    fn from(error: DynamicError) -> EnsembleError {
        EnsembleError::Dynamic(Box::new(error))
    }
}

/// Fits a model to tests: μ, Σ and free dynamic parameters by maximum likelihood, with all that is inferred from them. The tests'
/// order does not change the answer, nor does the number of threads.
///
/// # Errors
/// Columns that are not those of the model, numbers that the filter cannot work with, no tests.
pub fn fit(model: &PhasedModel, tests: &[Columns]) -> Result<Fit, EnsembleError> {
    Ensemble::new(model, tests)?.fit()
}

impl Ensemble {
    /// Puts tests in columns together with their model.
    ///
    /// # Errors
    /// Columns that are not those of the model.
    pub fn new(model: &PhasedModel, tests: &[Columns]) -> Result<Ensemble, ColumnsError> {
        let mut labels = Labels::new(&model.shared().literals);
        let tests = tests.iter().map(|columns| columns.test(model, &mut labels)).collect::<Result<_, _>>()?;
        Ok(Ensemble { model: model.clone(), labels, tests })
    }

    /// Tests that are there already: rows, estimates of somebody's filter, reductions.
    pub fn of_tests(model: &PhasedModel, labels: Labels, tests: Vec<PhasedTest>) -> Ensemble {
        Ensemble { model: model.clone(), labels, tests }
    }

    /// The model.
    pub fn model(&self) -> &PhasedModel {
        &self.model
    }

    /// The texts of the data.
    pub fn labels(&self) -> &Labels {
        &self.labels
    }

    /// The tests.
    pub fn tests(&self) -> &[PhasedTest] {
        &self.tests
    }

    /// Runs the filters once, at α: all that the tests say about the initial states there.
    ///
    /// # Errors
    /// Numbers that the filter cannot work with.
    pub fn reduce(&self, alpha: &Alpha) -> Result<Vec<Reduction>, ReduceError> {
        PhasedReducer::new(&self.model, alpha)?.reduce(&self.tests)
    }

    /// A new ensemble of so many tests, drawn from a population: times, inputs and what is missing are those of these tests, which
    /// are used over and over. The same seed draws the same ensemble.
    ///
    /// # Errors
    /// A population that is not of the model; no tests, or two with one id; numbers that the filter cannot work with.
    pub fn draw(
        &self,
        alpha: &Alpha,
        population: Population,
        tests: u64,
        seed: u64,
    ) -> Result<Ensemble, SimulateError> {
        let simulator = Simulator::new(&self.model, alpha, population, seed)?;
        let drawn = simulator.draw(&Designs::new(self.tests.clone())?, 0..tests)?;
        let tests = drawn.into_iter().map(|drawn| drawn.test).collect();
        Ok(Ensemble { model: self.model.clone(), labels: self.labels.clone(), tests })
    }

    /// As [`fit`](crate::fit).
    ///
    /// # Errors
    /// As there.
    pub fn fit(&self) -> Result<Fit, EnsembleError> {
        self.fit_with(&Options::default(), &mut Silent)
    }

    /// Fits as it is asked to, and tells how far it is.
    ///
    /// # Errors
    /// As [`fit`](crate::fit); also options that do not go together.
    pub fn fit_with(&self, options: &Options, progress: &mut dyn Progress) -> Result<Fit, EnsembleError> {
        fit::of_tests(self, options, progress)
    }
}
