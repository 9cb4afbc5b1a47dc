//! Drawing ensembles of tests from a model (theory §1).
//!
//! ```text
//! ξ_j ~ N(μ_j, Σ)                          the population
//! x_0 = a + Aξ_j + ζ, ζ ~ N(0, P0)         states that start in a known or stationary distribution
//! x_k = φ_k x_{k-1} + b_k + w_k, w_k ~ N(0, Q_k)
//! z_k = M_k x_k + d_k + v_k, v_k ~ N(0, R_k)
//! ```
//!
//! Phases follow each other: each phase has a separate ξ, and x_0 of a later phase inherits t + T x_K from x_K, the
//! true final state of the phase before (theory §7).
//!
//! A test of the design gives times, inputs and which values are missing; measured values of the design do not matter.
//! The simulator and the reducer evaluate coefficients by the same code. Σ, P0, Q and R may be singular. Estimates of a
//! suboptimal filter are not drawn: measurements of a phase with a filter are drawn as in any other phase.
//!
//! In a model with levels, each group of test j adds to ξ_j a deviation ~ N(0, Σ) with the Σ of its level. Group g,
//! counted over all levels, the innermost first and in the order in which the design names the groups, draws p standard
//! normals from stream 2⁶⁴ - 1 - g.
//!
//! # Seeds
//!
//! Test j of an ensemble draws from stream j of ChaCha8 seeded with the seed, phase after phase in this order: ξ (p
//! standard normals), ζ (one for each state that noise ever reaches), then step by step w (one for each state with
//! process noise, where a transition leads to the step) and v (one for each measured value). So a draw depends on the
//! seed, j, the design of test j, the model, α and the population, and on nothing else: not on threads, batches, other
//! tests or the length of the ensemble. One version of kalfit always makes the same draw; a later version may draw
//! differently, and the change log of that version then says so.

mod designs;
mod error;
mod inputs;
mod path;

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

pub use designs::Designs;
use designs::DrawnGroup;
pub use error::SimulateError;

use crate::reduce::{Fault, Instance, PhaseReducer, PhasedReducer, Preparer};
use kalfit_algebra::symmetric;
use kalfit_model::Test;
use kalfit_model::{Alpha, Phase, PhasedModel, Population};
use kalfit_model::{Evidence, PhasedTest};
use path::DrawWorkspace;

/// A test drawn from a model, with the true initial states.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawn {
    /// The cells of the design, with a drawn value in the place of each measured value.
    pub test: PhasedTest,
    /// ξ of all phases of the test, concatenated.
    pub initial: Vec<f64>,
}

/// Draws tests of a model at α from a population.
///
/// ```
/// # mod kalfit { pub use {kalfit_filter::*, kalfit_model::*}; }
/// use kalfit::model::{
///     Clock, Column, CovarianceStructure, Initial, Linear, MeanStructure, Measurement, Motion, State,
/// };
/// use kalfit::simulate::{Designs, Simulator};
/// use kalfit::model::PhasedModel;
/// use kalfit::reduce::Evidence;
/// use kalfit::{Alpha, Expression, Model, Population, Source, Test};
/// use nalgebra::{DMatrix, DVector};
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
/// let simulator = Simulator::new(&PhasedModel::from(model), &Alpha::default(), population, 1)?;
/// let ensemble = simulator.draw(&Designs::new(vec![unit.into()])?, 0..3)?;
/// assert_eq!(ensemble.iter().map(|drawn| drawn.test.id.as_str()).collect::<Vec<_>>(), ["unit", "unit#2", "unit#3"]);
/// let Evidence::Rows(first) = &ensemble[0].test.phases[0] else { panic!("rows are drawn") };
/// assert!((first.numbers(0)[0] - ensemble[0].initial[0]).abs() < 0.5);
/// assert!(first.numbers(1)[0].is_nan());
/// # Ok::<(), kalfit::simulate::SimulateError>(())
/// ```
#[derive(Debug)]
pub struct Simulator {
    /// Reducer whose phases evaluate the rows of tests in entering coordinates σ.
    reducer: PhasedReducer,
    drawn_phases: Vec<DrawnPhase>,
    /// F with FF' = Σ for the deviations of groups, one for each level, the innermost first.
    levels: Vec<DMatrix<f64>>,
    seed: u64,
}

/// The population from which the ξ of one phase is drawn.
#[derive(Debug)]
struct DrawnPhase {
    name: String,
    population: Population,
    /// F with FF' = Σ.
    root: DMatrix<f64>,
}

/// Population, reducer and preparer with which one phase is drawn.
#[derive(Debug, Clone, Copy)]
struct PhaseDraw<'a> {
    law: &'a DrawnPhase,
    phase: &'a PhaseReducer,
    preparer: &'a Preparer,
}

impl Simulator {
    /// A simulator of a model at α, with the population of all phases together.
    ///
    /// # Errors
    /// A population that does not fit the model or is not a valid law; a coefficient without a value, whatever the
    /// data; a measured column that a phase also reads as an input.
    pub fn new(
        model: &PhasedModel,
        alpha: &Alpha,
        population: Population,
        seed: u64,
    ) -> Result<Simulator, SimulateError> {
        population.check(model)?;
        model.phases.iter().try_for_each(inputs::refuse_measured_inputs)?;
        let reducer = PhasedReducer::new(model, alpha)?;
        let law = |(phase, population): (&Phase, Population)| DrawnPhase {
            name: phase.name.clone(),
            root: symmetric::square_root(&population.covariance),
            population,
        };
        let p = model.dimension();
        let of_level = |level: usize| {
            let at = ((level + 1) * p, (level + 1) * p);
            symmetric::square_root(&population.covariance.view(at, (p, p)).into_owned())
        };
        let levels = (0..model.levels.len()).map(of_level).collect();
        let drawn_phases = model.phases.iter().zip(population.by_phase(model)).map(law).collect();
        Ok(Simulator { reducer, drawn_phases, levels, seed })
    }

    /// The phases of the model, in order.
    fn phases(&self) -> impl Iterator<Item = PhaseDraw<'_>> {
        let draw = |(phase, law)| PhaseDraw { law, phase, preparer: phase.reducer.preparer() };
        self.reducer.phases().iter().zip(&self.drawn_phases).map(draw)
    }

    /// Draws tests `places` of the ensemble, in order.
    ///
    /// # Errors
    /// The error of the first test that fails.
    pub fn draw(&self, designs: &Designs, places: Range<u64>) -> Result<Vec<Drawn>, SimulateError> {
        let paths =
            || -> Vec<DrawWorkspace> { self.phases().map(|phase| DrawWorkspace::new(phase.preparer)).collect() };
        let all: Vec<Result<Drawn, SimulateError>> =
            places.into_par_iter().map_init(paths, |paths, place| self.draw_one(designs, place, paths)).collect();
        all.into_iter().collect()
    }

    fn draw_one(&self, designs: &Designs, place: u64, paths: &mut [DrawWorkspace]) -> Result<Drawn, SimulateError> {
        let (design, id) = (designs.design(place), designs.id(place));
        let (found, expected) = (design.phases.len(), self.drawn_phases.len());
        if !(1..=expected).contains(&found) {
            return Err(SimulateError::Phases { test: id, found, expected });
        }
        let group_deviations = self.group_deviations(designs, place)?;
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream(place);
        let (mut phases, mut initial, mut last) = (Vec::new(), Vec::new(), DVector::zeros(0));
        for ((phase, evidence), path) in self.phases().zip(&design.phases).zip(paths) {
            let mut rows = phase.rows(evidence, &id)?;
            rows.id = id.as_str().into();
            let xi = phase.draw(&mut rows, (&last, &group_deviations), path, &mut random)?;
            last = phase.last(path);
            initial.extend(xi);
            phases.push(Evidence::Rows(rows));
        }
        Ok(Drawn { test: PhasedTest { id: id.into(), phases: phases.into() }, initial })
    }
}

impl Simulator {
    /// Sum of the deviations that the groups of a test add to ξ, p numbers; empty without levels.
    fn group_deviations(&self, designs: &Designs, place: u64) -> Result<Vec<f64>, SimulateError> {
        if self.levels.is_empty() {
            return Ok(Vec::new());
        }
        let groups = designs.groups(place).ok_or(SimulateError::Ungrouped)?;
        let mut group_deviations = vec![0.0; self.levels[0].nrows()];
        for (root, groups) in self.levels.iter().zip(groups) {
            for DrawnGroup { number, member } in groups {
                let mut random = ChaCha8Rng::seed_from_u64(self.seed);
                random.set_stream(u64::MAX - number);
                // term by term, so that draws keep their bits
                path::add_noise(root, &mut random, |effect, value| match member.selection {
                    None => group_deviations[effect] += value,
                    Some(selection) => {
                        let acts = selection.pairs().iter().filter(|pair| pair.1 == effect);
                        acts.for_each(|&(state, _)| group_deviations[state] += value);
                    }
                });
            }
        }
        Ok(group_deviations)
    }
}

impl PhaseDraw<'_> {
    /// The rows of the design, with a zero in the place of every measured value.
    fn rows(&self, evidence: &Evidence, test: &str) -> Result<Test, SimulateError> {
        let found = match evidence {
            Evidence::Rows(rows) => {
                let mut rows = rows.clone();
                for row in 0..rows.rows() {
                    for measurement in &self.preparer.model.measurements {
                        if !rows.numbers(row)[measurement.column].is_nan() {
                            rows.set_number(row, measurement.column, 0.0);
                        }
                    }
                }
                return Ok(rows);
            }
            Evidence::Estimates(_) => "estimates",
            Evidence::Reduced(_) => "a reduction",
        };
        Err(SimulateError::NoRows { test: test.to_owned(), phase: self.law.name.clone(), found })
    }

    /// Writes drawn values of the phase into `rows`, and returns the phase's ξ. `before`: final state of the phase
    /// before; `group_deviations`: sum of the deviations that the groups of the test add to ξ.
    fn draw(
        &self,
        rows: &mut Test,
        (before, group_deviations): (&DVector<f64>, &[f64]),
        path: &mut DrawWorkspace,
        random: &mut ChaCha8Rng,
    ) -> Result<Vec<f64>, SimulateError> {
        let model = &self.preparer.model;
        let named = |fault: Box<Fault>, rows: &Test| self.phase.named(fault.name(model, Some(rows)));
        self.preparer.prepare(rows, &mut path.work).map_err(|fault| named(fault, rows))?;
        self.refuse_shared_cells(rows, path)?;
        let mut xi = path.draw_initial(model, &self.law.population, &self.law.root, random);
        xi.iter_mut().zip(group_deviations).for_each(|(own, more)| *own += more);
        let mut entering = xi.clone();
        if let Some(inheritance) = &self.phase.inheritance {
            let inherited = inheritance.of(&self.preparer.at(), rows, &mut path.cells);
            let inherited = inherited.map_err(|error| self.phase.named(error))?;
            entering.resize(model.estimated.len(), 0.0);
            let inherited = &inherited.transition * before + &inherited.input;
            entering.iter_mut().zip(&inherited).for_each(|(own, more)| *own += more);
        }
        path.draw_values(&entering, random).map_err(|fault| named(fault, rows))?;
        for (instance, &value) in path.work.instances.iter().zip(&path.values) {
            let (row, column) = (instance.row, model.measurements[instance.meter].column);
            if !value.is_finite() {
                let (row, column) = (rows.source(row), model.columns[column].name.clone());
                return Err(SimulateError::NotFinite { test: rows.id.to_string(), row, column });
            }
            rows.set_number(row, column, value);
        }
        Ok(xi)
    }

    /// The final state of the path, in the order of the model.
    fn last(&self, path: &DrawWorkspace) -> DVector<f64> {
        let place = &self.preparer.order.place;
        DVector::from_fn(place.len(), |state, _| path.last()[place[state]])
    }

    fn refuse_shared_cells(&self, test: &Test, path: &DrawWorkspace) -> Result<(), SimulateError> {
        let model = &self.preparer.model;
        let instances = &path.work.instances;
        let mut own: Vec<Instance> = Vec::new(); // instances of this row so far
        for instance in instances.iter() {
            let column = model.measurements[instance.meter].column;
            own.retain(|other| other.row == instance.row);
            let mut same_row = own.iter().rev();
            if let Some(other) = same_row.find(|other| model.measurements[other.meter].column == column) {
                return Err(SimulateError::SharedCell {
                    test: test.id.to_string(),
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
