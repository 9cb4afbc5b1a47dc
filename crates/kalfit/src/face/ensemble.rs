//! A model together with the tests that it is fitted to.

use kalfit_filter::reduce::{PhasedReducer, ReduceError, Reductions};
use kalfit_filter::simulate::{Designs, SimulateError, Simulator};
use kalfit_model::Labels;
use kalfit_model::PhasedTest;
use kalfit_model::build::{Columns, ColumnsError};
use kalfit_model::{Alpha, PhasedModel, Population};

/// A model together with the tests that it is to be fitted to.
#[derive(Debug, Clone)]
pub struct Ensemble {
    model: PhasedModel,
    labels: Labels,
    tests: Vec<PhasedTest>,
}

impl Ensemble {
    /// An ensemble of a model and tests given as columns.
    ///
    /// # Errors
    /// The columns do not fit the model.
    pub fn new(model: &PhasedModel, tests: &[Columns]) -> Result<Ensemble, ColumnsError> {
        let mut labels = Labels::new(&model.shared().literals);
        let tests = tests.iter().map(|columns| columns.test(model, &mut labels)).collect::<Result<_, _>>()?;
        Ok(Ensemble { model: model.clone(), labels, tests })
    }

    /// An ensemble of a model and existing tests: rows, estimates of some filter, or reductions.
    pub fn of_tests(model: &PhasedModel, labels: Labels, tests: Vec<PhasedTest>) -> Ensemble {
        Ensemble { model: model.clone(), labels, tests }
    }

    /// The model.
    pub fn model(&self) -> &PhasedModel {
        &self.model
    }

    /// Labels for the texts in the data.
    pub fn labels(&self) -> &Labels {
        &self.labels
    }

    /// The tests.
    pub fn tests(&self) -> &[PhasedTest] {
        &self.tests
    }

    /// Reduces the tests, with one run of the filters at α: their information on the initial states.
    ///
    /// # Errors
    /// The filter cannot work with the numbers of a test.
    pub fn reduce(&self, alpha: &Alpha) -> Result<Reductions, ReduceError> {
        PhasedReducer::new(&self.model, alpha)?.reduce(&self.tests)
    }

    /// A new ensemble of `tests` tests, drawn from a population: times, inputs and missing values are those of the
    /// existing tests, which are used in turn. The same seed draws the same ensemble.
    ///
    /// # Errors
    /// The population does not fit the model; there are no tests, or two tests have one id; the filter cannot work with
    /// the numbers.
    pub fn draw(
        &self,
        alpha: &Alpha,
        population: Population,
        tests: u64,
        seed: u64,
    ) -> Result<Ensemble, SimulateError> {
        let simulator = Simulator::new(&self.model, alpha, population, seed)?;
        let drawn = simulator.draw(&Designs::of(&self.model, self.tests.clone())?, 0..tests)?;
        let tests = drawn.into_iter().map(|drawn| drawn.test).collect();
        Ok(Ensemble { model: self.model.clone(), labels: self.labels.clone(), tests })
    }
}
