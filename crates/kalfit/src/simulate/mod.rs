//! Drawing ensembles: tests as the model says they come about (theory §1).
//!
//! ```text
//! ξ_j ~ N(μ_j, Σ)                          the population
//! x_0 = a + Aξ_j + ζ, ζ ~ N(0, P0)         states that start in a known or stationary law
//! x_k = φ_k x_{k-1} + b_k + w_k, w_k ~ N(0, Q_k)
//! z_k = M_k x_k + d_k + v_k, v_k ~ N(0, R_k)
//! ```
//!
//! A test of the design gives times, inputs and which values are missing; its measured values themselves do not matter. The
//! coefficients are those that the reducer filters with, evaluated by the same code. Σ, P0, Q and R may be singular.
//!
//! # Seeds
//!
//! Test j of an ensemble draws from stream j of ChaCha8 seeded with the seed, in this order: ξ (p standard normals), ζ (one for
//! each state that noise ever reaches), then step by step w (one for each state with process noise, where a transition leads to
//! the step) and v (one for each measured value). So a draw depends on the seed, j, the design of test j, the model, α and the
//! population, and on nothing else: not on threads, batches, other tests or the length of the ensemble. It is the same for the
//! same version of kalfit; a later version may draw otherwise, and then says so in its change log.

mod designs;
mod error;
mod inputs;
mod path;

use std::ops::Range;

use nalgebra::DMatrix;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

pub use designs::Designs;
pub use error::SimulateError;

use crate::ensemble::Test;
use crate::linalg::symmetric;
use crate::model::{Alpha, Model, PhasedModel, Population};
use crate::reduce::{Fault, Instance, Preparer, ReduceError};
use path::Path;

/// A test that was drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawn {
    /// The test: the design's cells, drawn values where the design has measured ones.
    pub test: Test,
    /// ξ, its initial state (p).
    pub initial: Vec<f64>,
}

/// Draws tests of a model at α from a population.
///
/// ```
/// use kalfit::model::{
///     Clock, Column, CovarianceStructure, Initial, Linear, MeanStructure, Measurement, Motion, State,
/// };
/// use kalfit::simulate::{Designs, Simulator};
/// use kalfit::{Alpha, Expression, Model, Population, Source, Test};
/// use nalgebra::DMatrix;
///
/// // each unit has a level of its own, measured twice
/// let number = Expression::Number;
/// let level = State {
///     name: "level".into(), unit: None, motion: Motion::Constant, initial: Initial::Estimated, offset: None, random: true,
/// };
/// let measurement = Measurement {
///     name: "y".into(),
///     column: 0,
///     filter: None,
///     equation: Linear { terms: vec![(0, number(1.0))], constant: number(0.0) },
///     noise_variance: number(0.01),
/// };
/// let model = Model {
///     title: String::new(),
///     columns: vec![Column { name: "y".into(), used_in: "measurement `y`".into() }],
///     text_columns: vec![], literals: vec![], parameters: vec![],
///     states: vec![level], process_noise_covariance: vec![],
///     measurements: vec![measurement], noise_covariance: vec![],
///     clock: Clock::default(), group: None, estimated: vec![0],
///     mean: MeanStructure::free(1), covariance: CovarianceStructure::full(),
/// };
/// let mut unit = Test::new("unit", 1, 0);
/// unit.push(&[1.0], &[], Source::default());
/// unit.push(&[f64::NAN], &[], Source::default()); // the second value is missing
///
/// let population = Population { mean: vec![5.0], coefficients: vec![], covariance: DMatrix::from_element(1, 1, 4.0) };
/// let simulator = Simulator::new(&model, &Alpha::default(), population, 1)?;
/// let ensemble = simulator.draw(&Designs::new(vec![unit])?, 0..3)?;
/// assert_eq!(ensemble.iter().map(|drawn| drawn.test.id.as_str()).collect::<Vec<_>>(), ["unit", "unit#2", "unit#3"]);
/// assert!((ensemble[0].test.numbers(0)[0] - ensemble[0].initial[0]).abs() < 0.5);
/// assert!(ensemble[0].test.numbers(1)[0].is_nan());
/// # Ok::<(), kalfit::simulate::SimulateError>(())
/// ```
#[derive(Debug)]
pub struct Simulator {
    preparer: Preparer,
    population: Population,
    /// F with FF' = Σ.
    root: DMatrix<f64>,
    seed: u64,
}

impl Simulator {
    /// A simulator of a model at α.
    ///
    /// # Errors
    /// A population that does not fit the model or is no law; a coefficient without a value, whatever the data; a measured
    /// column that the model reads as an input too.
    pub fn new(model: &Model, alpha: &Alpha, population: Population, seed: u64) -> Result<Simulator, SimulateError> {
        population.check(&PhasedModel::from(model.clone()))?;
        inputs::refuse_measured_inputs(model)?;
        let preparer = Preparer::new(model, alpha).map_err(|fault| fault.name(model, None))?;
        let root = symmetric::square_root(&population.covariance);
        Ok(Simulator { preparer, population, root, seed })
    }

    /// Draws the tests with these places in the ensemble, in their order.
    ///
    /// # Errors
    /// Of several tests in error, the first one's error.
    pub fn draw(&self, designs: &Designs, places: Range<u64>) -> Result<Vec<Drawn>, SimulateError> {
        let all: Vec<Result<Drawn, SimulateError>> =
            places.into_par_iter().map_init(|| Path::new(self), |path, place| self.one(designs, place, path)).collect();
        all.into_iter().collect()
    }

    fn one(&self, designs: &Designs, place: u64, path: &mut Path) -> Result<Drawn, SimulateError> {
        let model = &self.preparer.model;
        let mut test = designs.design(place).clone();
        test.id = designs.id(place);
        for row in 0..test.rows() {
            for measurement in &model.measurements {
                if !test.numbers(row)[measurement.column].is_nan() {
                    test.set_number(row, measurement.column, 0.0);
                }
            }
        }
        let named = |fault: Box<Fault>, test: &Test| -> ReduceError { fault.name(model, Some(test)) };
        self.preparer.prepare(&test, &mut path.work).map_err(|fault| named(fault, &test))?;
        self.refuse_shared_cells(&test, path)?;
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream(place);
        let initial = path.draw_initial(model, &self.population, &self.root, &mut random);
        path.draw_values(&initial, &mut random).map_err(|fault| named(fault, &test))?;
        for (instance, &value) in path.work.instances.iter().zip(&path.values) {
            let (row, column) = (instance.row, model.measurements[instance.meter].column);
            if !value.is_finite() {
                let (row, column) = (test.source(row), model.columns[column].name.clone());
                return Err(SimulateError::NotFinite { test: test.id, row, column });
            }
            test.set_number(row, column, value);
        }
        Ok(Drawn { test, initial })
    }

    fn refuse_shared_cells(&self, test: &Test, path: &Path) -> Result<(), SimulateError> {
        let model = &self.preparer.model;
        let instances = &path.work.instances;
        let mut own: Vec<Instance> = Vec::new(); // of the row so far
        for instance in instances.iter() {
            let column = model.measurements[instance.meter].column;
            own.retain(|other| other.row == instance.row);
            let mut same_row = own.iter().rev();
            if let Some(other) = same_row.find(|other| model.measurements[other.meter].column == column) {
                return Err(SimulateError::SharedCell {
                    test: test.id.clone(),
                    row: test.source(instance.row),
                    column: model.columns[column].name.clone(),
                    first: model.measurements[other.meter].name.clone(),
                    second: model.measurements[instance.meter].name.clone(),
                });
            }
            own.push(instance);
        }
        Ok(())
    }
}
