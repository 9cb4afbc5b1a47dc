//! The mean at the average of the covariates: centred regression columns.
//!
//! A covariate x that acts on a free element μ_i of the mean is centred at its average x̄,
//!
//! ```text
//! μ_i + γ x_j = (μ_i + γ x̄) + γ (x_j - x̄)
//! ```
//!
//! and the element of the mean in η is μ_i + γ x̄. The sums over tests then do not depend on the zero of x; in the
//! user's coordinates a column far from zero is nearly parallel to the constant, and the information on (μ_i, γ) loses
//! twice as many digits as x̄ is larger than the scatter of x. The map from one to the other has determinant 1, so the
//! restricted likelihood is the same in both.

use nalgebra::DMatrix;

use crate::frame::Frame;
use crate::structure::{PhaseStructure, Structure};

/// One centred coefficient.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Centred {
    /// The element of the mean that the coefficient acts on.
    element: usize,
    /// The number of the coefficient.
    coefficient: usize,
    /// x̄ in units of the scale of x.
    average: f64,
}

/// The map between mean coordinates (μ, γ) in η whose covariates are centred, and the same without centring.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Centring {
    /// Number of elements of the mean, which come before the coefficients.
    elements: usize,
    centred: Vec<Centred>,
}

impl Centring {
    /// The centring of a frame.
    pub(crate) fn new(regressors: &[usize], frame: &Frame) -> Centring {
        let averages = frame.covariate_centre.iter().zip(&frame.covariate_scale).map(|(centre, scale)| centre / scale);
        let of = |(coefficient, (&element, average))| Centred { element, coefficient, average };
        let centred = regressors.iter().zip(averages).enumerate().map(of).filter(|one| one.average != 0.0).collect();
        Centring { elements: frame.scale.len(), centred }
    }

    /// The centring of mean coordinates with the first `elements` elements of the mean alone, those of the tests in
    /// groups.
    pub fn of_first(&self, elements: usize) -> Centring {
        Centring { elements, centred: self.centred.clone() }
    }

    /// (element of the mean, coordinate of the coefficient, average of the covariate) of each centred covariate.
    fn each(&self) -> impl Iterator<Item = (usize, usize, f64)> {
        self.centred.iter().map(|one| (one.element, self.elements + one.coefficient, one.average))
    }

    /// Overwrites centred mean coordinates with the same coordinates without centring.
    pub fn uncentre(&self, coordinates: &mut [f64]) {
        self.each().for_each(|(i, c, average)| coordinates[i] -= average * coordinates[c]);
    }

    /// Overwrites mean coordinates without centring with the centred coordinates.
    pub fn centre(&self, coordinates: &mut [f64]) {
        self.each().for_each(|(i, c, average)| coordinates[i] += average * coordinates[c]);
    }

    /// Overwrites the weights of a linear combination of coordinates without centring with the weights on the centred
    /// coordinates: the same combination.
    pub fn weights(&self, weights: &mut [f64]) {
        self.each().for_each(|(i, c, average)| weights[c] -= average * weights[i]);
    }

    /// Overwrites derivatives with respect to centred coordinates with those with respect to coordinates without
    /// centring.
    pub fn derivatives(&self, derivatives: &mut [f64]) {
        self.each().for_each(|(i, c, average)| derivatives[c] += average * derivatives[i]);
    }

    /// Directions of the centred coordinates, as columns, without centring.
    pub fn uncentred(&self, directions: &DMatrix<f64>) -> DMatrix<f64> {
        each_column(directions, |column| self.uncentre(column))
    }

    /// Directions of coordinates without centring, as columns, in the centred coordinates.
    pub fn centred(&self, directions: &DMatrix<f64>) -> DMatrix<f64> {
        each_column(directions, |column| self.centre(column))
    }
}

/// The matrix with each column changed.
fn each_column(matrix: &DMatrix<f64>, change: impl Fn(&mut [f64])) -> DMatrix<f64> {
    let (mut changed, rows) = (matrix.clone(), matrix.nrows().max(1));
    changed.as_mut_slice().chunks_exact_mut(rows).for_each(change);
    changed
}

/// For each regression, whether its covariate is centred: whether the structure leaves the element of the mean free and
/// no other element moves with it.
pub(crate) fn is_centred(structure: &Structure<'_>) -> Vec<bool> {
    let of = |phase: &PhaseStructure<'_>| -> Vec<bool> {
        phase.mean.regression.iter().map(|regression| phase.mean.is_free_alone(regression.element)).collect()
    };
    structure.phases.iter().flat_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(averages: [f64; 2]) -> Centring {
        let frame = Frame {
            centre: vec![0.0; 2],
            scale: vec![1.0; 2],
            covariate_centre: averages.to_vec(),
            covariate_scale: vec![1.0, 2.0],
        };
        Centring::new(&[1, 1], &frame)
    }

    #[test]
    fn a_combination_and_its_derivatives_are_the_same_in_both_coordinates() {
        let (centring, uncentred) = (of([3.0, -4.0]), [0.5, 7.0, 1.5, -0.25]);
        let mut centred = uncentred;
        centring.centre(&mut centred);
        assert_eq!(centred, [0.5, 7.0 + 3.0 * 1.5 - 2.0 * -0.25, 1.5, -0.25]);
        let (weights, mut moved) = ([1.0, -2.0, 0.5, 3.0], [1.0, -2.0, 0.5, 3.0]);
        centring.weights(&mut moved);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        assert_eq!(dot(&moved, &centred), dot(&weights, &uncentred));
        centring.derivatives(&mut moved);
        assert_eq!(moved, weights);
        centring.uncentre(&mut centred);
        assert_eq!(centred, uncentred);
    }

    #[test]
    fn a_covariate_that_is_not_centred_changes_nothing() {
        let mut coordinates = [0.5, 7.0, 1.5, -0.25];
        of([0.0, 0.0]).uncentre(&mut coordinates);
        assert_eq!(coordinates, [0.5, 7.0, 1.5, -0.25]);
    }
}
