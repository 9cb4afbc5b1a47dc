//! A model, a population, and tests drawn from it.

use std::ops::Range;

use kalfit::simulate::{Designs, Simulator};
use kalfit::{Alpha, Label, PhasedModel, PhasedTest, Population, Source, Test};
use kalfit_spec::Spec;
use nalgebra::DMatrix;

const MODEL: &str = r#"
[data]
time = "t"
[states]
bias = {}
scale = {}
drift = { process = "gauss-markov", time_constant = 0.5, sigma = 0.15 }
[measurements.rate]
column = "z"
equation = "bias + scale * turn + drift"
noise = 0.08
"#;

pub(super) struct SimulatedModel {
    pub(super) model: PhasedModel,
    pub(super) alpha: Alpha,
    pub(super) population: Population,
}

/// Rows of test number k, and the time of each.
pub(super) struct TestShape {
    pub(super) rows: fn(k: usize) -> usize,
    pub(super) time: fn(k: usize, row: f64) -> f64,
}

impl SimulatedModel {
    pub(super) fn new() -> Result<SimulatedModel, String> {
        let model = Spec::parse("model", MODEL).map_err(|error| error.to_string())?.model;
        let alpha = Alpha::fixed(&model.shared().parameters).map_err(|error| error.to_string())?;
        let population = Population {
            mean: vec![0.5, 40.0],
            coefficients: vec![],
            covariance: DMatrix::from_row_slice(2, 2, &[0.64, -8.0, -8.0, 625.0]),
        };
        Ok(SimulatedModel { model, alpha, population })
    }

    /// Designs of so many tests, which turn in some rows so that both states are told.
    pub(super) fn designs(&self, count: usize, shape: &TestShape) -> Result<Designs, String> {
        let columns = &self.model.shared().columns;
        let one = |k: usize| {
            let mut test = Test::new(format!("t{k:05}"), columns.len(), 0);
            for row in 0..(shape.rows)(k) {
                let cell = |name: &str| match name {
                    "t" => (shape.time)(k, row as f64),
                    "turn" => 0.02 * ((row % 3) as f64 - 0.7),
                    _ => 0.0,
                };
                let cells: Vec<f64> = columns.iter().map(|column| cell(&column.name)).collect();
                test.push(&cells, &[] as &[Label], Source::default());
            }
            PhasedTest::from(test)
        };
        Designs::new((0..count).map(one).collect()).map_err(|error| error.to_string())
    }

    pub(super) fn draw(&self, designs: &Designs, seed: u64, tests: Range<u64>) -> Result<Vec<PhasedTest>, String> {
        let simulator = Simulator::new(&self.model, &self.alpha, self.population.clone(), seed)
            .map_err(|error| error.to_string())?;
        let drawn = simulator.draw(designs, tests).map_err(|error| error.to_string())?;
        Ok(drawn.into_iter().map(|drawn| drawn.test).collect())
    }
}
