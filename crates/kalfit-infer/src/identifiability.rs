//! Directions of μ and Σ that the ensemble does not determine (theory §5).
//!
//! For (μ, γ), with the regression coefficients γ: the null space of Σ_j E_j'J_jE_j on the free directions of (μ, γ),
//! with μ_j = E_j(μ, γ). For Σ: the null space of the expected information ½ Σ_j tr(W_j D W_j E) on the free directions
//! of Σ.

use nalgebra::{DMatrix, DVector};

use crate::direction::{Direction, Quantity, ZERO_EIGENVALUE, in_units, simplest};
use crate::law::AsymptoticLaw;
use crate::observability::{Observability, observability};
use crate::phases::{PhaseObservability, phases};
use crate::reason::{Explanation, Reason, explain};
use kalfit_algebra::regular::Regular;
use kalfit_algebra::sparse::Sparse;
use kalfit_algebra::symmetric;
use kalfit_estimate::{
    Estimate, FinalState, FitError, FlatDirection, Objective, Point, Problem, Structure, Sums, natural_length,
    natural_sizes,
};
use kalfit_filter::reduce::Reductions;

/// An element whose weight is below this fraction of the largest weight is not part of a direction computed by
/// differences.
pub(crate) const MIN_DIFFERENCED_WEIGHT: f64 = 1e-3;

/// What the data do not identify and why, and which tests inform each state.
#[derive(Debug, Clone, PartialEq)]
pub struct Examination {
    /// Directions that the data do not determine.
    pub unidentified: Vec<Direction>,
    /// Why the data do not determine each of the directions.
    pub explanations: Vec<Explanation>,
    /// Which tests inform and observe each state.
    pub observability: Observability,
    /// Which directions enter at which phase; empty where the reductions are not stored phase by phase.
    pub phases: Vec<PhaseObservability>,
}

/// Examines identifiability before any fit, at the start values.
pub fn examine_at_start(reductions: &Reductions, structure: &Structure<'_>) -> Result<Examination, FitError> {
    let (problem, point, sums) = kalfit_estimate::at_start(reductions, structure)?;
    Ok(examine_at((&problem, &point, &sums), structure, reductions))
}

/// Examines identifiability at a point.
pub(crate) fn examine_at(
    at: (&Problem, &Point, &Sums),
    structure: &Structure<'_>,
    reductions: &Reductions,
) -> Examination {
    examination(at, structure, (reductions, reductions), phases(at.0, reductions))
}

/// Examines identifiability at an estimate; `evidence`: the reductions whose likelihood was maximised.
pub(crate) fn examine(estimate: &Estimate, evidence: &Reductions, reductions: &Reductions) -> Examination {
    let state = &estimate.state;
    let phases = phases(&state.problem, reductions);
    let at = (&*state.problem, &state.newton_iterate.point, &state.sums);
    let mut found = examination(at, &state.structure(), (evidence, reductions), phases);
    found.extend(with_parameters(state));
    found
}

impl Examination {
    /// Adds directions; one that is known already keeps its first reason, with the parameters of the other.
    pub(crate) fn extend(&mut self, directions: Vec<(Direction, Explanation)>) {
        for (direction, explanation) in directions {
            match self.unidentified.iter().position(|other| is_same(other, &direction)) {
                Some(at) => self.explanations[at].also(&explanation),
                None => {
                    self.unidentified.push(direction);
                    self.explanations.push(explanation);
                }
            }
        }
    }
}

/// Whether two directions are equal but for rounding.
fn is_same(one: &Direction, other: &Direction) -> bool {
    let mut pairs = one.direction.iter().zip(&other.direction);
    one.quantity == other.quantity && pairs.all(|(a, b)| (a - b).abs() < MIN_DIFFERENCED_WEIGHT)
}

/// Directions of μ and Σ that belong to directions of dynamic parameters along which ℓ does not change.
fn with_parameters(state: &FinalState) -> Vec<(Direction, Explanation)> {
    let Some(joint) = state.joint.as_ref().filter(|joint| !joint.flat.is_empty()) else { return Vec::new() };
    let law = AsymptoticLaw::new(state);
    let elements = state.problem.covariance.elements.count();
    let of = |flat: &FlatDirection| {
        let mut moved = law.jacobian().times(&flat.inner);
        let first = moved.len() - elements;
        moved.rows_mut(first, elements).zip_apply(&flat.moves, |own, by_matrices| *own += by_matrices);
        parts_with_parameters(&state.problem, moved, &flat.parameters)
    };
    joint.flat.iter().flat_map(of).collect()
}

/// The parts of a direction of (mean coordinates, elements of Σ) in η along which ℓ does not change while `parameters`
/// change too, in the user's units.
pub(crate) fn parts_with_parameters(
    problem: &Problem,
    mut moved: DVector<f64>,
    parameters: &[usize],
) -> Vec<(Direction, Explanation)> {
    let (means, scale) = (problem.mean_units(), &problem.classes.frame.scale);
    let elements: Vec<f64> = problem.covariance.elements.all().map(|(i, j)| scale[i] * scale[j]).collect();
    let first = moved.len() - elements.len();
    problem.mean.centring.uncentre(moved.as_mut_slice());
    let least = MIN_DIFFERENCED_WEIGHT * moved.amax();
    moved.apply(|weight| *weight = if weight.abs() > least { *weight } else { 0.0 });
    let parts = [(Quantity::Mean, 0, &means[..]), (Quantity::Covariance, first, &elements[..])];
    let part = |(quantity, at, units): (Quantity, usize, &[f64])| {
        let own = moved.rows(at, units.len()).into_owned();
        let reason = Reason::WithParameters { parameters: parameters.to_vec() };
        let explanation = Explanation { reason, tests: Vec::new() };
        (own.amax() > 0.0).then(|| (to_user_units(quantity, &own, units), explanation))
    };
    parts.into_iter().filter_map(part).collect()
}

fn examination(
    (problem, point, sums): (&Problem, &Point, &Sums),
    structure: &Structure<'_>,
    (evidence, reductions): (&Reductions, &Reductions),
    phases: Vec<PhaseObservability>,
) -> Examination {
    let unidentified = directions(problem, point, sums);
    // for observability, tests in groups are treated as independent tests
    let alone = problem.classes.units.as_ref().and_then(|_| problem.apart(structure, point, reductions));
    let (of, point, seen) = match &alone {
        Some((alone, point)) => (alone, point, reductions),
        None => (problem, point, evidence),
    };
    let p = of.classes.dimension();
    let weight = sums.mean_information.view((0, 0), (p, p)).clone_owned();
    let observability = observability(of, point, &weight, seen);
    Examination { explanations: explain(problem, &unidentified, &observability), unidentified, observability, phases }
}

/// Unidentified directions at an estimate.
pub fn identifiability(estimate: &Estimate) -> Vec<Direction> {
    let state = &estimate.state;
    directions(&state.problem, &state.newton_iterate.point, &state.sums)
}

/// Directions of (μ, regression coefficients) and of Σ that the data do not determine, in the user's units.
pub fn directions(problem: &Problem, point: &Point, sums: &Sums) -> Vec<Direction> {
    let chart = problem.covariance.chart(&point.root);
    let free = problem.covariance.free_directions(&chart);
    let mut found = mean_directions(problem);
    found.extend(covariance_directions(problem, (&chart.root, &free), sums));
    found.extend(of_single_groups(problem, &free.row_sizes()));
    found
}

/// Directions of the covariance of a level with only one group: the effect of this group cannot be separated from the
/// mean.
fn of_single_groups(problem: &Problem, free: &[f64]) -> Vec<Direction> {
    let elements = &problem.covariance.elements;
    let alone = |&e: &usize| {
        let (i, _) = elements.at(e).expect("an element");
        problem.is_one_group(elements.block_of(i)) && free[e] > 0.0
    };
    let one = |e: usize| {
        let direction = (0..elements.count()).map(|k| f64::from(u8::from(k == e))).collect();
        Direction { quantity: Quantity::Covariance, direction }
    };
    (0..elements.count()).filter(alone).map(one).collect()
}

fn mean_directions(problem: &Problem) -> Vec<Direction> {
    let (basis, regressors, pooled) = (problem.mean_jacobian(), &problem.mean.regressors, &problem.classes.information);
    let information = match regressors.is_empty() {
        true => basis.transpose() * pooled * basis,
        false => basis.transpose() * problem.classes.mean_information(regressors) * basis,
    };
    let units = problem.mean_units();
    // in η the average test has unit information on each element, so 1 is the natural size
    null_space(&|| information.clone(), &vec![1.0; basis.ncols()], pooled.diagonal().amax())
        .into_iter()
        .map(|v| to_user_units(Quantity::Mean, &uncentred(problem, basis * v), &units))
        .collect()
}

/// A direction of the mean coordinates without the centring of covariates.
fn uncentred(problem: &Problem, mut direction: DVector<f64>) -> DVector<f64> {
    problem.mean.centring.uncentre(direction.as_mut_slice());
    direction
}

/// Converts a direction in η to the user's units.
fn to_user_units(quantity: Quantity, direction: &DVector<f64>, units: &[f64]) -> Direction {
    Direction { quantity, direction: in_units(direction, units.iter()) }
}

fn covariance_directions(problem: &Problem, (root, free): (&DMatrix<f64>, &Sparse), sums: &Sums) -> Vec<Direction> {
    let information = || free.congruence_of(sums.expected_information());
    let scale = &problem.classes.frame.scale;
    let elements = &problem.covariance.elements;
    let units: Vec<f64> = elements.all().map(|(i, j)| scale[i] * scale[j]).collect();
    let sizes = natural_sizes(root);
    let sizes: Vec<f64> = elements.all().map(|(i, j)| sizes[i] * sizes[j]).collect();
    let own = free.columns().map(|c| natural_length(c.iter().map(|&(row, x)| (x, sizes[row])))).collect::<Vec<_>>();
    null_space(&information, &own, 0.0)
        .into_iter()
        .map(|v| to_user_units(Quantity::Covariance, &free.times(&v), &units))
        .collect()
}

/// Directions v with vanishing information after scaling to unit diagonal, in the unscaled coordinates. A single
/// coordinate is such a direction when diagonal entry × size² of the information is negligible against the largest such
/// number of all coordinates and against `elsewhere`; such coordinates cost nothing more. The information is computed
/// twice rather than stored: for many states a copy would take most of the memory.
pub(crate) fn null_space(information: &dyn Fn() -> DMatrix<f64>, sizes: &[f64], elsewhere: f64) -> Vec<DVector<f64>> {
    let whole = information();
    let (n, diagonal) = (whole.nrows(), whole.diagonal());
    let own = |i: usize| diagonal[i] * sizes[i].powi(2);
    let largest = (0..n).map(own).fold(elsewhere, f64::max);
    let (known, unknown): (Vec<usize>, Vec<usize>) = (0..n).partition(|&i| own(i) > 1e-14 * largest);
    let scale: Vec<f64> = known.iter().map(|&i| diagonal[i].sqrt().recip()).collect();
    let scaled = |whole: DMatrix<f64>| {
        let mut block = if unknown.is_empty() { whole } else { whole.select_rows(&known).select_columns(&known) };
        for (mut column, own) in block.column_iter_mut().zip(&scale) {
            column.iter_mut().zip(&scale).for_each(|(x, other)| *x *= own * other);
        }
        block
    };
    let axis = |&i: &usize| DVector::from_fn(n, |k, _| f64::from(u8::from(k == i)));
    let mut found: Vec<DVector<f64>> = unknown.iter().map(axis).collect();
    if Regular::within(scaled(whole)).is_none() {
        let (values, vectors) = symmetric::eigen(&scaled(information()));
        let flat: Vec<usize> = (0..known.len()).filter(|&k| values[k] < ZERO_EIGENVALUE).collect();
        found.extend(simplest(vectors.select_columns(&flat)).column_iter().map(|v| {
            let mut direction = DVector::zeros(n);
            known.iter().zip(&scale).zip(v.iter()).for_each(|((&i, scale), x)| direction[i] = x * scale);
            direction
        }));
    }
    found
}
