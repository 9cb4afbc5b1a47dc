//! A model with its tests.

use kalfit_filter::reduce::{PhasedReducer, ReduceError, Reductions};
use kalfit_filter::simulate::{Designs, SimulateError, Simulator};
use kalfit_model::Labels;
use kalfit_model::PhasedTest;
use kalfit_model::build::{Columns, ColumnsError};
use kalfit_model::{Alpha, PhasedModel, Population};

/// A model with the tests that it is to be fitted to.
#[derive(Debug, Clone)]
pub struct Ensemble {
    model: PhasedModel,
    labels: Labels,
    tests: Vec<PhasedTest>,
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
    pub fn reduce(&self, alpha: &Alpha) -> Result<Reductions, ReduceError> {
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
        let drawn = simulator.draw(&Designs::of(&self.model, self.tests.clone())?, 0..tests)?;
        let tests = drawn.into_iter().map(|drawn| drawn.test).collect();
        Ok(Ensemble { model: self.model.clone(), labels: self.labels.clone(), tests })
    }
}
