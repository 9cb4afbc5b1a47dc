//! What a test that nobody has made will give: states and outputs along its design, with what they vary by from test to test, by process
//! noise, and by what estimation leaves open (theory §12).
//!
//! ```text
//! y_k = g'θ̂ + …        population g'Σg,   process noise h'P_kh,   estimation (∂y/∂θ)' Var[θ̂] (∂y/∂θ)
//! ```
//!
//! Nothing is measured, so that all three add up. From them come limits for the mean, and limits that a given part of all tests stays within.

mod bounds;
mod degrees;
mod error;
mod pair;
mod root;
mod steps;
#[cfg(test)]
mod tests;
mod trajectory;
mod value;
mod widths;

pub use bounds::{Bounds, Limits, Sides};
pub use error::PredictError;
pub use pair::{Ellipse, Pair};

use std::collections::BTreeMap;
use std::ops::Range;

use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::predict::steps::ValueSteps;
use crate::predict::trajectory::{Propagator, Trajectory};
use kalfit_infer::{Knowledge, MeanCombination};
use kalfit_model::{Alpha, Column, Expression, Linear, Measurement, Model, Operator, Phase, PhasedModel, Population};
use kalfit_model::{Evidence, PhasedTest};

/// A quantity that is linear in the states, as a measurement is, and that nobody measures.
#[derive(Debug, Clone, PartialEq)]
pub struct Output {
    /// Its name.
    pub name: String,
    /// Its unit, a label.
    pub unit: Option<String>,
    /// h'x + d.
    pub equation: Linear,
}

impl Output {
    /// The sum of two, without a name: what tells how they vary together.
    pub fn sum(first: &Output, second: &Output) -> Output {
        let add = |a: &Expression, b: &Expression| {
            Expression::Binary(Operator::Add, Box::new(a.clone()), Box::new(b.clone()))
        };
        let mut terms: BTreeMap<usize, Expression> = first.equation.terms.iter().cloned().collect();
        for (state, coefficient) in &second.equation.terms {
            let both = terms.get(state).map_or(coefficient.clone(), |own| add(own, coefficient));
            terms.insert(*state, both);
        }
        let constant = add(&first.equation.constant, &second.equation.constant);
        let equation = Linear { terms: terms.into_iter().collect(), constant };
        Output { name: String::new(), unit: None, equation }
    }
}

/// What is predicted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum What {
    /// A state, by its place in the phase's model.
    State(usize),
    /// An output, by its place among those of the phase.
    Output(usize),
}

/// States and outputs of one phase of a test.
#[derive(Debug, Clone, PartialEq)]
pub struct PhasePredictions {
    /// The phase, by its place in the model.
    pub phase: usize,
    /// Step by step.
    pub steps: Vec<StepPredictions>,
}

/// States and outputs at one step: rows of the same time are one step.
#[derive(Debug, Clone, PartialEq)]
pub struct StepPredictions {
    /// Its rows among those of the phase.
    pub rows: Range<usize>,
    /// Its time, where the model has a column of times.
    pub time: Option<f64>,
    /// The states, once a step, and then the outputs, once a row.
    pub values: Vec<Predicted>,
}

/// What is known of one value of a test that nobody has made.
#[derive(Debug, Clone, PartialEq)]
pub struct Predicted {
    /// What it is.
    pub what: What,
    /// Its row among those of the phase.
    pub row: usize,
    /// Its mean over tests.
    pub mean: f64,
    /// Its variance from test to test, by the initial state.
    pub population: f64,
    /// Its variance by process noise.
    pub process: f64,
    /// A variance that it hangs on was estimated as zero: how large it may be, the standard errors do not say.
    pub hangs_on_zero: bool,
    /// What the estimates leave open; `None` where it hangs on something that the data do not determine.
    pub estimation: Option<Estimation>,
    /// What limits of the mean are made of.
    pub limits: MeanLimits,
}

/// What limits of a mean are made of.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum MeanLimits {
    /// Of its standard error.
    #[default]
    Error,
    /// Of its profile likelihood; `None` where no limit was found.
    Profile(Option<[f64; 2]>),
}

/// Variances of the estimates of a mean and of a variance over tests.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Estimation {
    /// Of the mean.
    pub mean: f64,
    /// Of the variance over tests, process noise in it.
    pub variance: f64,
    /// Of that part of it that is by the initial state.
    pub population: f64,
    /// How many degrees of freedom the variance lost to the mean, by maximum likelihood.
    pub lost: usize,
    /// The variance allows for those: by restricted likelihood.
    pub is_restricted: bool,
    /// How many tests, or groups of the outermost level, all of it is from.
    pub tests: f64,
}

impl Predicted {
    /// Its variance over tests.
    pub fn variance(&self) -> f64 {
        self.population + self.process
    }

    /// The standard deviation of what will be seen from what is predicted, the estimates' in it where it is known.
    pub fn std_dev(&self) -> f64 {
        (self.variance() + self.estimation.map_or(0.0, |estimation| estimation.mean)).sqrt()
    }
}

/// The law of the initial state of the tests that are predicted.
#[derive(Debug, Clone, PartialEq)]
pub struct Initial {
    /// The mean of ξ, with the regressions apart.
    pub mean: Vec<f64>,
    /// The covariance of ξ.
    pub covariance: DMatrix<f64>,
    /// The covariance of that mean given μ: what the tests of a known group leave open of it, which is counted with the errors of estimates.
    /// `None` of a new one, whose mean is μ.
    pub left: Option<DMatrix<f64>>,
    /// The derivative of the mean by μ; `None` where the mean is μ itself.
    pub shrinkage: Option<DMatrix<f64>>,
    /// Its derivative by the regression coefficients, which are apart from it; `None` where it does not hang on them.
    pub by_coefficients: Option<DMatrix<f64>>,
    /// Levels of groups whose covariance is in `covariance`, by their place among the blocks of Σ.
    pub levels: Range<usize>,
}

impl Initial {
    /// Of a new test, of a new group of each level.
    pub fn new(model: &PhasedModel, population: &Population) -> Initial {
        let Population { mean, covariance, .. } = population.together(model.dimension());
        let levels = 0..model.levels.len() + 1;
        Initial { mean, covariance, left: None, shrinkage: None, by_coefficients: None, levels }
    }

    /// Of a new test of a group that is known, of the innermost level: from what is known of the mean m of its tests, V = Var[m | z], and how
    /// it follows μ and the coefficients. Where that is not told, m hangs on μ by VΣ⁺, Σ that of all levels together; where other groups of
    /// the same outer group tell of m too, by less.
    pub fn of_group(
        model: &PhasedModel,
        population: &Population,
        (mean, covariance): (Vec<f64>, &DMatrix<f64>),
        follows: Option<DMatrix<f64>>,
    ) -> Initial {
        let p = model.dimension();
        let block = |level: usize| population.covariance.view((level * p, level * p), (p, p));
        let between = (1..=model.levels.len()).fold(DMatrix::zeros(p, p), |sum, level| sum + block(level));
        let inverse = kalfit_algebra::symmetric::pseudo_inverse(&between);
        // directions in which groups do not differ are all of μ
        let still = DMatrix::identity(p, p) - &between * &inverse;
        let shrinkage = Some(covariance * inverse + still);
        let by_mean = follows.as_ref().map(|follows| follows.columns(0, p).into_owned());
        Initial {
            mean,
            covariance: block(0).into_owned(),
            left: Some(covariance.clone()),
            shrinkage: by_mean.or(shrinkage),
            by_coefficients: follows.map(|follows| follows.columns(p, follows.ncols() - p).into_owned()),
            levels: 0..1,
        }
    }
}

/// A model at (α, μ, Σ), and what is known of those.
#[derive(Debug)]
pub struct Predictor {
    model: PhasedModel,
    coefficients: Vec<f64>,
    knowledge: Option<Knowledge>,
    /// The model at α, and at α with each free value moved to both sides.
    propagators: Vec<Propagator>,
    steps: ValueSteps,
}

impl Predictor {
    /// A model that measures nothing, with the outputs of each phase. `knowledge`: `None` where the estimates say nothing of how far they can
    /// be trusted; [`Knowledge::exact`] of values that are given.
    ///
    /// # Errors
    /// Coefficients that have no value.
    pub fn new(
        design: &PhasedModel,
        outputs: &[Vec<Output>],
        (alpha, coefficients): (&Alpha, &[f64]),
        knowledge: Option<Knowledge>,
    ) -> Result<Predictor, PredictError> {
        let model = with_outputs(design, outputs);
        let steps = ValueSteps::new(&model, alpha, knowledge.as_ref());
        let alphas = std::iter::once(alpha).chain(steps.moved());
        let propagators = alphas.map(|alpha| Propagator::new(&model, alpha)).collect::<Result<_, _>>()?;
        Ok(Predictor { model, coefficients: coefficients.to_vec(), knowledge, propagators, steps })
    }

    /// States and outputs of designs, phase by phase; `initial`: the law of each one's initial state.
    ///
    /// # Errors
    /// Tests without rows; rows that have no value.
    pub fn predict(
        &self,
        designs: &[PhasedTest],
        initial: &[&Initial],
    ) -> Result<Vec<Vec<PhasePredictions>>, PredictError> {
        let found: Vec<Result<Vec<PhasePredictions>, PredictError>> =
            designs.par_iter().zip(initial).map(|(design, initial)| self.one(design, initial)).collect();
        found.into_iter().collect()
    }

    /// The means of all values of designs as what is linear in (μ, γ), at some α, in the order of [`Predictor::predict`].
    ///
    /// # Errors
    /// Coefficients that have no value.
    pub fn means(
        &self,
        designs: &[PhasedTest],
        initial: &Initial,
        alpha: &Alpha,
    ) -> Result<Vec<MeanCombination>, PredictError> {
        let propagator = Propagator::new(&self.model, alpha)?;
        let mut all = Vec::new();
        for design in designs {
            let found = propagator.trajectory(&self.model, design, (initial, &self.coefficients))?;
            all.extend(found.means(initial, &self.coefficients));
        }
        Ok(all)
    }

    fn one(&self, design: &PhasedTest, initial: &Initial) -> Result<Vec<PhasePredictions>, PredictError> {
        for (evidence, phase) in design.phases.iter().zip(&self.model.phases) {
            if !matches!(evidence, Evidence::Rows(_)) {
                return Err(PredictError::NoRows { test: design.id.to_string(), phase: phase.name.clone() });
            }
        }
        let mut propagators = self.propagators.iter();
        let at = |propagator: &Propagator| propagator.trajectory(&self.model, design, (initial, &self.coefficients));
        let home = propagators.next().map(at).expect("the model itself is the first propagator")?;
        let sides = propagators.map(at).collect::<Result<Vec<Trajectory>, _>>()?;
        let known = self.knowledge.as_ref().map(|knowledge| (knowledge, &self.steps));
        home.check(&design.id, initial)?;
        Ok(home.predictions(&sides, initial, known))
    }
}

/// The model with the outputs in the place of measurements, read from a column of their own after all others.
fn with_outputs(design: &PhasedModel, outputs: &[Vec<Output>]) -> PhasedModel {
    let mut columns = design.shared().columns.clone();
    columns.push(Column { name: String::new(), used_in: String::new() });
    let column = columns.len() - 1;
    let measured = |output: &Output| Measurement {
        name: output.name.clone(),
        column,
        filter: None,
        equation: output.equation.clone(),
        noise_variance: Expression::Number(0.0),
    };
    let of = |(phase, outputs): (&Phase, &Vec<Output>)| Phase {
        model: Model {
            columns: columns.clone(),
            measurements: outputs.iter().map(measured).collect(),
            noise_covariance: Vec::new(),
            ..phase.model.clone()
        },
        filter: None,
        ..phase.clone()
    };
    PhasedModel { phases: design.phases.iter().zip(outputs).map(of).collect(), ..design.clone() }
}
