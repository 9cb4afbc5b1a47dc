//! Expected information of each independent unit of tests about (α, μ, Σ), before anything is measured (theory §15):
//!
//! ```text
//! F_ββ = X'ΩX    F_st = ½ tr(ΩS_sΩS_t)    F_βs = 0                      by the reductions                     (15.1)
//! F_aa, F_aβ, F_as                                                       by one run of the filter with tangents (15.2)
//! ```

use std::collections::HashMap;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::SharedProgress;
use crate::dynamic::expected::{EvaluationPair, is_possible, sides, units};
use crate::dynamic::mixed::{ElementLaws, of_each_unit};
use crate::dynamic::stepwise::{EvaluationPoint, GroupedTest};
use crate::holdable::Holdable;
use crate::law::AsymptoticLaw;
use kalfit_estimate::{
    ExpectedError, FinalState, Progress, Structure, at_population, information_at_population, law_at,
};
use kalfit_filter::reduce::Reductions;
use kalfit_filter::score::InitialLaw;
use kalfit_model::{Alpha, Grouping, PhasedModel, PhasedTest, Population, Reduction, Slots};
use kalfit_search::{Coordinate, DynamicError, ProfileLikelihood, Settings};

/// Information of a unit about a free value of α, in units of its size, that counts as none: a standard error of 10 000 times
/// the value.
const LEAST_INFORMATION: f64 = 1e-8;
/// Step of a value of α in its coordinate, relative to its size, for differences of predictions.
const VALUE_STEP: f64 = 1e-4;
/// Rounding of a derivative whose terms cancel, as a part of the terms.
const CANCELLED: f64 = 1e-11;

/// Expected information of units of tests at a population, in the user's units: about the free values of α, in the
/// coordinates in which they are sought, then μ, coefficients, and the elements of Σ.
#[derive(Debug, Clone)]
pub struct UnitInformation {
    /// Indices of the tests of each unit: a test, or all tests of a group of the outermost level.
    pub members: Vec<Vec<usize>>,
    /// Information of each unit.
    pub units: Vec<DMatrix<f64>>,
    /// Derivatives of (α, μ, coefficients, Σ) by the free coordinates: the free values of α, then those along the tangent
    /// basis of (μ, Σ) at the population.
    pub jacobian: DMatrix<f64>,
    state: FinalState,
    coordinates: Vec<Coordinate>,
    values: Vec<f64>,
    population: Population,
}

/// Why there is no such information.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum UnitError {
    /// The population does not agree with the structure, or the structure is not possible.
    #[error("the population cannot be used: {0:?}")]
    Expected(ExpectedError),
    /// A test cannot be evaluated.
    #[error(transparent)]
    Dynamic(#[from] DynamicError),
    /// Free values of α need tests that are given by rows, and phases without suboptimal filters.
    #[error("the information about free parameters needs tests that are given by rows, and no suboptimal filters")]
    NotByRows,
}

impl From<ExpectedError> for UnitError {
    fn from(error: ExpectedError) -> UnitError {
        UnitError::Expected(error)
    }
}

/// Expected information of each unit of `tests`, at the free `values` of α in the order of `slots`. `reductions`: those of
/// the tests at these values, in the same order; only their information counts. `None` once `progress` stops.
///
/// # Errors
/// A population that does not agree with the structure, and tests that cannot be evaluated.
pub fn unit_information(
    (model, tests): (&PhasedModel, &[PhasedTest]),
    (slots, values): (&Slots, &[f64]),
    (reductions, structure, population): (&Reductions, &Structure<'_>, &Population),
    progress: &mut dyn Progress,
) -> Result<Option<UnitInformation>, UnitError> {
    let settings = Settings::default();
    let objective = ProfileLikelihood::new(model, tests, slots, &settings);
    let units = units(&objective);
    let state = at_population(reductions, structure, population)?;
    let places: HashMap<&str, usize> = (0..reductions.len()).map(|at| (reductions.id(at), at)).collect();
    let place = |member: &GroupedTest<'_>| places[member.test.id.as_str()];
    let members: Vec<Vec<usize>> = units.iter().map(|unit| unit.iter().map(place).collect()).collect();
    let progress = &SharedProgress::new(progress, None);
    let of_unit = |members: &Vec<usize>| -> Result<DMatrix<f64>, ExpectedError> {
        let own: Reductions = members.iter().map(|&at| Reduction::from(reductions.get(at))).collect();
        let grouping = structure.grouping.as_deref().map(|all| Arc::new(grouping_of(all, &own)));
        information_at_population(&own, &Structure { grouping, ..structure.clone() }, population)
    };
    let by_reductions: Vec<DMatrix<f64>> = members.par_iter().map(of_unit).collect::<Result<_, _>>()?;
    let found = match slots.is_empty() {
        true => Some(by_reductions),
        false if !is_possible(&objective) => return Err(UnitError::NotByRows),
        false => with_values(&objective, values, (&state, &units), by_reductions, progress)?,
    };
    let (k, along) = (values.len(), state.user_jacobian());
    let mut jacobian = DMatrix::identity(k + along.nrows(), k + along.ncols());
    jacobian.view_mut((k, k), along.shape()).copy_from(&along);
    Ok(found.filter(|_| !progress.stops()).map(|units| UnitInformation {
        members,
        units,
        jacobian,
        coordinates: objective.coordinates.clone(),
        values: values.to_vec(),
        population: population.clone(),
        state,
    }))
}

/// The groups of some tests.
fn grouping_of(all: &Grouping, tests: &Reductions) -> Grouping {
    let path = |id: &str| {
        let number = all.number(id).expect("all tests are grouped");
        all.groups(0)[all.group_of(number, 0)].path.clone()
    };
    let depth = all.groups(0).first().map_or(0, |group| group.path.len());
    Grouping::from_paths(depth, tests.iter().map(|test| (test.test, path(test.test))))
}

/// The information with the rows of the free values of α before those of (μ, Σ).
fn with_values(
    objective: &ProfileLikelihood<'_>,
    values: &[f64],
    (state, units): (&FinalState, &[Vec<GroupedTest<'_>>]),
    by_reductions: Vec<DMatrix<f64>>,
    progress: &SharedProgress<'_>,
) -> Result<Option<Vec<DMatrix<f64>>>, DynamicError> {
    let (problem, point) = (&state.problem, &state.newton_iterate.point);
    let (k, law, sought) = (values.len(), law_at(problem, point), objective.sought(values));
    let place = |alpha: &Alpha, law: InitialLaw| EvaluationPoint::new(objective, alpha, law);
    let along = |s: usize| -> Result<EvaluationPair, DynamicError> {
        let ([up, down], width) = sides(objective, &sought, s);
        let at = |sought: &[f64]| place(&objective.alpha(sought), law.clone());
        Ok(([at(&up)?, at(&down)?], width))
    };
    let pairs = || (0..k).map(along).collect::<Result<Vec<_>, _>>().map(Some);
    let alpha = objective.alpha(&sought);
    let elsewhere = |law| place(&alpha, law);
    let laws = ElementLaws::of(problem, &law);
    let chosen: Vec<&[GroupedTest<'_>]> = units.iter().map(Vec::as_slice).collect();
    let Some(found) = of_each_unit(&chosen, k, &pairs, (&laws, &elsewhere, &law), progress)? else { return Ok(None) };
    let to_eta = state.user_to_eta();
    let sizes: Vec<f64> = (0..k).map(|s| objective.coordinates[s].size(values[s])).collect();
    let whole = |([mut of_values, mut with_elements], own): ([DMatrix<f64>; 2], DMatrix<f64>)| {
        // differences of a filter that does not change leave rounding
        let is_none = |a: &usize| of_values[(*a, *a)] * sizes[*a] * sizes[*a] < LEAST_INFORMATION;
        for a in (0..k).filter(is_none).collect::<Vec<_>>() {
            of_values.row_mut(a).fill(0.0);
            of_values.column_mut(a).fill(0.0);
            with_elements.row_mut(a).fill(0.0);
        }
        let n = own.nrows();
        let mut all = DMatrix::zeros(k + n, k + n);
        let cross = with_elements * &to_eta;
        all.view_mut((0, 0), (k, k)).copy_from(&of_values);
        all.view_mut((0, k), (k, n)).copy_from(&cross);
        all.view_mut((k, 0), (n, k)).copy_from(&cross.transpose());
        all.view_mut((k, k), (n, n)).copy_from(&own);
        all
    };
    Ok(Some(found.into_iter().zip(by_reductions).map(whole).collect()))
}

impl UnitInformation {
    /// Number of free values of α, the first coordinates.
    pub fn values(&self) -> usize {
        self.values.len()
    }

    /// Number of elements of μ and coefficients.
    pub fn means(&self) -> usize {
        self.state.problem.mean_units().len()
    }

    /// The elements (i, j) of Σ, in the order of the last rows of the information.
    pub fn elements(&self) -> impl Iterator<Item = (usize, usize)> {
        self.state.problem.covariance.elements.all()
    }

    /// The population.
    pub fn population(&self) -> &Population {
        &self.population
    }

    /// Value of a quantity; `None` for a correlation with a variance of zero.
    pub fn value(&self, quantity: Holdable) -> Option<f64> {
        let Population { mean, coefficients, covariance } = &self.population;
        quantity.value(mean, coefficients, covariance)
    }

    /// The free value `slot` of α.
    pub fn value_of(&self, slot: usize) -> f64 {
        self.values[slot]
    }

    /// The free value `slot` of α a step below and above, and the distance of the two in its coordinate.
    pub fn value_sides(&self, slot: usize) -> ([f64; 2], f64) {
        let (value, coordinate) = (self.values[slot], &self.coordinates[slot]);
        let step = coordinate.step(value, VALUE_STEP);
        let sides = [-step, step].map(|step| coordinate.moved(value, step));
        (sides, coordinate.of_value(sides[1]) - coordinate.of_value(sides[0]))
    }

    /// The free value `slot` of α after an error to first order, within its bounds: a positive value by its logarithm.
    pub fn value_after(&self, slot: usize, error: f64) -> f64 {
        let (value, coordinate) = (self.values[slot], &self.coordinates[slot]);
        let slope = coordinate.slope(value);
        if slope == 0.0 { value } else { coordinate.moved(value, error / slope) }
    }

    /// Derivatives of an element of (μ, Σ), a coefficient, a standard deviation or a correlation by the coordinates; zero
    /// where the model fixes the quantity, and where it has no derivative because a variance is zero.
    pub fn gradient(&self, quantity: Holdable) -> DVector<f64> {
        let law = AsymptoticLaw::new(&self.state);
        let mut gradient = DVector::zeros(self.jacobian.ncols());
        let Some(weights) = law.weights_of(&self.population.covariance, quantity) else { return gradient };
        for (column, entries) in law.jacobian().columns().enumerate() {
            let terms = entries.iter().map(|&(row, x)| x * weights[row]);
            let [sum, size] = terms.fold([0.0, 0.0f64], |[sum, size], x| [sum + x, size + x.abs()]);
            if sum.abs() > CANCELLED * size {
                gradient[self.values.len() + column] = sum;
            }
        }
        gradient
    }

    /// Derivatives of the free value `slot` of α by the coordinates.
    pub fn gradient_of_value(&self, slot: usize) -> DVector<f64> {
        let mut gradient = DVector::zeros(self.jacobian.ncols());
        gradient[slot] = self.coordinates[slot].slope(self.values[slot]);
        gradient
    }
}
