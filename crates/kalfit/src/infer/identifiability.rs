//! What the ensemble says nothing about (theory §5).
//!
//! For μ: the null space of Σ_j J_j on the free mean. For Σ: the null space of the expected information
//! ½ Σ_j tr(W_j D W_j E) on the free directions of Σ.

use nalgebra::{DMatrix, DVector};

use crate::estimate::{Estimate, FitError, Place, Problem, Structure, Tangent, harmonic, natural_sizes};
use crate::linalg::symmetric::{self, pairs};
use crate::reduce::Reduction;

/// Scaled information below this is none.
const NONE: f64 = 1e-10;

/// What a direction is a direction of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Of μ; entries by element.
    Mean,
    /// Of Σ; entries by pair (0,0), (1,0), (1,1), (2,0), …
    Covariance,
}

/// A direction without information: a unit vector in the user's units.
#[derive(Debug, Clone, PartialEq)]
pub struct Direction {
    /// Of what.
    pub quantity: Quantity,
    /// p entries for the mean, p(p+1)/2 for the covariance.
    pub direction: Vec<f64>,
}

/// Unidentified directions at an estimate.
pub fn identifiability(estimate: &Estimate) -> Vec<Direction> {
    let state = &estimate.state;
    directions(&state.problem, &state.place, &state.sums.expected_information())
}

/// Unidentified directions before any fit: at the start values.
pub fn identifiability_at_start(
    reductions: &[Reduction],
    structure: &Structure<'_>,
) -> Result<Vec<Direction>, FitError> {
    let (problem, place, sums) = crate::estimate::at_start(reductions, structure)?;
    Ok(directions(&problem, &place, &sums.expected_information()))
}

pub(crate) fn directions(problem: &Problem, place: &Place, expected: &DMatrix<f64>) -> Vec<Direction> {
    let mut found = mean_directions(problem);
    found.extend(covariance_directions(problem, &place.tangent, expected));
    found
}

fn mean_directions(problem: &Problem) -> Vec<Direction> {
    let basis = &problem.mean.basis;
    let information = basis.transpose() * &problem.classes.information * basis;
    let scale = &problem.classes.frame.scale;
    let out = |v: DVector<f64>| {
        let direction = basis * v;
        Direction {
            quantity: Quantity::Mean,
            direction: unit(direction.iter().zip(scale).map(|(d, s)| d * s).collect()),
        }
    };
    // in η the average test has unit information on each element, so 1 is the natural size
    null_space(&information, &vec![1.0; basis.ncols()], problem.classes.information.diagonal().amax())
        .into_iter()
        .map(out)
        .collect()
}

fn covariance_directions(problem: &Problem, tangent: &Tangent, expected: &DMatrix<f64>) -> Vec<Direction> {
    let free = problem.covariance.free_directions(&tangent.chart);
    let information = free.transpose() * expected * &free;
    let scale = &problem.classes.frame.scale;
    let p = scale.len();
    let units: Vec<f64> = (0..p).flat_map(|i| (0..=i).map(move |j| (i, j))).map(|(i, j)| scale[i] * scale[j]).collect();
    debug_assert_eq!(units.len(), pairs(p));
    let out = |v: DVector<f64>| {
        let direction = &free * v;
        Direction {
            quantity: Quantity::Covariance,
            direction: unit(direction.iter().zip(&units).map(|(d, s)| d * s).collect()),
        }
    };
    let sizes = natural_sizes(&tangent.chart.root);
    let sizes: Vec<f64> = (0..p).flat_map(|i| (0..=i).map(move |j| (i, j))).map(|(i, j)| sizes[i] * sizes[j]).collect();
    let own = free.column_iter().map(|c| harmonic(c.iter().copied().zip(sizes.iter().copied()))).collect::<Vec<_>>();
    null_space(&information, &own, 0.0).into_iter().map(out).collect()
}

/// Directions v with vanishing information after scaling to unit diagonal, in the unscaled coordinates. A coordinate is one
/// itself when, in steps of its size, it has nothing beside the best known one and beside `elsewhere`.
fn null_space(information: &DMatrix<f64>, sizes: &[f64], elsewhere: f64) -> Vec<DVector<f64>> {
    let n = information.nrows();
    let own = |i: usize| information[(i, i)] * sizes[i].powi(2);
    let largest = (0..n).map(own).fold(elsewhere, f64::max);
    let known = |i: usize| own(i) > 1e-14 * largest;
    let scale = DVector::from_fn(n, |i, _| if known(i) { information[(i, i)].sqrt().recip() } else { 1.0 });
    let scaled =
        DMatrix::from_fn(
            n,
            n,
            |i, j| {
                if known(i) && known(j) { scale[i] * information[(i, j)] * scale[j] } else { 0.0 }
            },
        );
    let (values, vectors) = symmetric::eigen(&scaled);
    let flat = (0..n).filter(|&k| values[k] < NONE);
    flat.map(|k| vectors.column(k).component_mul(&scale)).collect()
}

/// Scaled to length one, noise removed, largest entry positive.
fn unit(mut direction: Vec<f64>) -> Vec<f64> {
    let norm = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
    let largest = direction.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
    let sign = if largest < 0.0 { -1.0 } else { 1.0 };
    for x in &mut direction {
        *x = if x.abs() < 1e-9 * norm { 0.0 } else { sign * *x / norm };
    }
    direction
}
