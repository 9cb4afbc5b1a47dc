//! Predictions of a test that has not been made: states and outputs at each step of a design, with variances from test
//! to test, by process noise and by errors of estimation (theory §12).
//!
//! ```text
//! y_k = g'θ̂ + …        population g'Σg,   process noise h'P_kh,   estimation (∂y/∂θ)' Var[θ̂] (∂y/∂θ)
//! ```
//!
//! Nothing is measured, so the three variances add up. Limits of the mean, and tolerance limits, which contain a given
//! part of all tests, follow from the variances.

mod bounds;
mod degrees;
mod error;
mod few_tests;
mod known;
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
pub use known::KnownEffect;
pub use pair::{Ellipse, Pair};

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::predict::steps::ValueSteps;
use crate::predict::trajectory::{Propagator, Trajectory};
use kalfit_infer::{Estimand, Knowledge, MeanCombination};
use kalfit_model::{Alpha, Column, Expression, Linear, Measurement, Model, Operator, Phase, PhasedModel, Population};
use kalfit_model::{Evidence, LevelSlots, PhasedTest};

/// A quantity that is linear in the states, as a measurement is, but is not measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Output {
    /// Name of the output.
    pub name: String,
    /// Unit of the output, a label.
    pub unit: Option<String>,
    /// Linear form h'x + d of the output.
    pub equation: Linear,
}

impl Output {
    /// The sum of two outputs, without a name; the variance of the sum gives the covariance of the outputs.
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

/// The quantity that is predicted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum What {
    /// A state, by its index in the phase's model.
    State(usize),
    /// An output, by its index among the outputs of the phase.
    Output(usize),
}

/// States and outputs of one phase of a test.
#[derive(Debug, Clone, PartialEq)]
pub struct PhasePredictions {
    /// Index of the phase in the model.
    pub phase: usize,
    /// States and outputs at each step.
    pub steps: Vec<StepPredictions>,
}

/// States and outputs at one step: rows of the same time are one step.
#[derive(Debug, Clone, PartialEq)]
pub struct StepPredictions {
    /// Rows of the step among the rows of the phase.
    pub rows: Range<usize>,
    /// Time of the step, where the model has a column of times.
    pub time: Option<f64>,
    /// Values of the states, one for each state, then of the outputs, one for each row and output.
    pub values: Vec<Predicted>,
}

/// Prediction of one value of a test that has not been made.
#[derive(Debug, Clone, PartialEq)]
pub struct Predicted {
    /// The state or output that is predicted.
    pub what: What,
    /// Row of the value among the rows of the phase.
    pub row: usize,
    /// Mean over tests.
    pub mean: f64,
    /// Variance from test to test, by the initial state.
    pub population: f64,
    /// Variance by process noise.
    pub process: f64,
    /// Whether a variance or noise level that affects the value was estimated as zero, so that no standard error shows
    /// how large the variance may be.
    pub hangs_on_zero: bool,
    /// Whether the value is of a known group, and a variance between groups that affects it was estimated as zero: the
    /// group then has the mean of all groups, and no standard error shows how far its own may be from it.
    pub is_drawn_to_zero: bool,
    /// Errors of the estimates; `None` where the value depends on a quantity that the data do not determine.
    pub estimation: Option<Estimation>,
    /// Source of the limits of the mean.
    pub limits: MeanLimits,
}

/// Source of the limits of a mean: its standard error or its profile likelihood.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum MeanLimits {
    /// The standard error of the mean.
    #[default]
    Error,
    /// The limits by the mean's profile likelihood; `None` where the profile gives no limits.
    Profile(Option<[f64; 2]>),
}

/// Variances of the estimates of a mean and of a variance over tests.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Estimation {
    /// Variance of the estimate of the mean.
    pub mean: f64,
    /// Variance of the estimate of the variance over tests, including process noise.
    pub variance: f64,
    /// Variance of the estimate of the variance over tests by the initial state alone.
    pub population: f64,
    /// Number of degrees of freedom that the variance lost to the mean, by maximum likelihood.
    pub lost: usize,
    /// Whether the variance already allows for the lost degrees of freedom: true by restricted likelihood.
    pub is_restricted: bool,
    /// Number of tests, or of groups of the outermost level, that the estimates are from.
    pub tests: f64,
    /// Degrees of freedom by the laws of few tests (14.8), (14.12); `None` where the fit has no such laws.
    pub few_tests: Option<FewTestsDegrees>,
}

/// Degrees of freedom of a prediction by the laws of few tests. Infinite where what is estimated has no error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FewTestsDegrees {
    /// ν of the estimate of the mean.
    pub mean: f64,
    /// ν_h of the variance of the difference between the value of a new test and its prediction.
    pub new_test: f64,
    /// ν of the variance over tests together with the errors of tests, as the estimate of the mean tells it; `None` for
    /// a test of a known unit, and where the mean is known.
    pub seen: Option<f64>,
}

impl Predicted {
    /// Variance over tests, by the initial state and by process noise.
    pub fn variance(&self) -> f64 {
        self.population + self.process
    }

    /// Standard deviation of the difference between the value of a new test and the prediction, including errors of the
    /// estimates where known.
    pub fn std_dev(&self) -> f64 {
        (self.variance() + self.estimation.map_or(0.0, |estimation| estimation.mean)).sqrt()
    }
}

/// Distribution of the initial state of the tests that are predicted.
#[derive(Debug, Clone, PartialEq)]
pub struct Initial {
    /// Mean of ξ, without the regressions.
    pub mean: Vec<f64>,
    /// Covariance of ξ.
    pub covariance: DMatrix<f64>,
    /// Covariance of `mean` given μ and the tests of a known group; counts among the errors of the estimates. `None`
    /// for a new group, whose mean is μ.
    pub left: Option<DMatrix<f64>>,
    /// Derivative of `mean` with respect to μ; `None` where `mean` is μ itself.
    pub shrinkage: Option<DMatrix<f64>>,
    /// Derivative of `mean` with respect to the regression coefficients; `None` where `mean` does not depend on the
    /// coefficients.
    pub by_coefficients: Option<DMatrix<f64>>,
    /// Derivatives of `mean` with respect to estimates other than means and coefficients, for a known group, whose mean
    /// is drawn to μ the more the less groups vary. `None` where the derivatives are not known.
    pub by_estimates: Option<HashMap<Estimand, DVector<f64>>>,
    /// Indices of the blocks of Σ, one per level, that `covariance` is the sum of.
    pub levels: Vec<usize>,
    /// How the effects of each level enter the state, in the slots whose groups are new.
    pub slots: LevelSlots,
    /// How the effects of each level enter the state, in all slots, slots of known groups included.
    pub all_slots: LevelSlots,
    /// Number of tests that a known group has; zero for a new group.
    pub group_tests: usize,
}

impl Initial {
    /// Initial state of a new test, from a new group at each level.
    pub fn new(model: &PhasedModel, population: &Population) -> Initial {
        let slots = model.slots();
        let Population { mean, covariance, .. } = population.together(model.dimension(), &slots);
        let levels = (0..=model.levels.len()).collect();
        Initial {
            mean,
            covariance,
            left: None,
            shrinkage: None,
            by_coefficients: None,
            by_estimates: None,
            levels,
            all_slots: slots.clone(),
            slots,
            group_tests: 0,
        }
    }

    /// Initial state of a new test of a known group of the innermost level. `mean`, `covariance`: posterior E[m | z], V
    /// = Var[m | z] of the mean m of the group's tests; `follows`: derivatives of m with respect to μ and the
    /// coefficients. Without `follows`, the derivative with respect to μ is VΣ⁺ + I - ΣΣ⁺, with Σ the sum over the
    /// levels of groups; the true derivative is smaller where different groups of one outer group also inform of m.
    pub fn of_group(
        model: &PhasedModel,
        population: &Population,
        (mean, covariance): (Vec<f64>, &DMatrix<f64>),
        follows: Option<DMatrix<f64>>,
    ) -> Initial {
        let p = model.dimension();
        let block = |level: usize| population.covariance.view((level * p, level * p), (p, p));
        let group_covariance = (1..=model.levels.len()).fold(DMatrix::zeros(p, p), |sum, level| sum + block(level));
        let inverse = kalfit_algebra::symmetric::pseudo_inverse(&group_covariance);
        // in directions in which groups do not differ, m is μ
        let invariant = DMatrix::identity(p, p) - &group_covariance * &inverse;
        let shrinkage = Some(covariance * inverse + invariant);
        let by_mean = follows.as_ref().map(|follows| follows.columns(0, p).into_owned());
        Initial {
            mean,
            covariance: block(0).into_owned(),
            left: Some(covariance.clone()),
            shrinkage: by_mean.or(shrinkage),
            by_coefficients: follows.map(|follows| follows.columns(p, follows.ncols() - p).into_owned()),
            by_estimates: None,
            levels: vec![0],
            slots: LevelSlots::default(),
            all_slots: LevelSlots::default(),
            group_tests: 1,
        }
    }
}

/// A model at given α and regression coefficients, with the errors of the estimates.
#[derive(Debug)]
pub struct Predictor {
    model: PhasedModel,
    coefficients: Vec<f64>,
    knowledge: Option<Knowledge>,
    /// Filters at α, then at each α of `steps.moved()`.
    propagators: Vec<Propagator>,
    steps: ValueSteps,
}

impl Predictor {
    /// A predictor for a model with `outputs`, by phase, instead of measurements. `knowledge`: `None` where the errors
    /// of the estimates are not known; [`Knowledge::exact`] for values that are given.
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

    /// States and outputs of designs, phase by phase; `initial`: distribution of each design's initial state.
    ///
    /// # Errors
    /// Tests without rows; rows that have no value.
    pub fn predict(
        &self,
        designs: &[PhasedTest],
        initial: &[&Initial],
    ) -> Result<Vec<Vec<PhasePredictions>>, PredictError> {
        let found: Vec<Result<Vec<PhasePredictions>, PredictError>> =
            designs.par_iter().zip(initial).map(|(design, initial)| self.predict_design(design, initial)).collect();
        found.into_iter().collect()
    }

    /// Means of all values of designs as linear combinations of (μ, γ), at `alpha`, in the order of
    /// [`Predictor::predict`].
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

    fn predict_design(&self, design: &PhasedTest, initial: &Initial) -> Result<Vec<PhasePredictions>, PredictError> {
        for (evidence, phase) in design.phases.iter().zip(&self.model.phases) {
            if !matches!(evidence, Evidence::Rows(_)) {
                return Err(PredictError::NoRows { test: design.id.to_string(), phase: phase.name.clone() });
            }
        }
        let mut propagators = self.propagators.iter();
        let trajectory_of =
            |propagator: &Propagator| propagator.trajectory(&self.model, design, (initial, &self.coefficients));
        let central = propagators.next().map(trajectory_of).expect("the model itself is the first propagator")?;
        let sides = propagators.map(trajectory_of).collect::<Result<Vec<Trajectory>, _>>()?;
        let known = self.knowledge.as_ref().map(|knowledge| (knowledge, &self.steps));
        central.check(&design.id, initial)?;
        Ok(central.predictions(&sides, initial, known))
    }
}

/// The model with outputs in place of measurements; outputs are read from an additional last column.
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
