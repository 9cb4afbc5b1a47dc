//! The structure of μ in η: μ = offset + Q b, with the columns of Q orthonormal, and scaled regression coefficients γ.

use nalgebra::{DMatrix, DVector};

use crate::centring::Centring;
use crate::frame::Frame;
use crate::point::Point;
use crate::structure::Structure;
use kalfit_algebra::symmetric;
use kalfit_model::MeanElement;

/// Free coordinates of the mean: b, then γ.
#[derive(Debug, Clone)]
pub struct MeanMap {
    /// μ in η where b = 0.
    pub offset: DVector<f64>,
    /// Q, p × q.
    pub basis: DMatrix<f64>,
    /// For each regression coefficient, the element of μ that the coefficient acts on.
    pub regressors: Vec<usize>,
    /// Scale of each regression coefficient: γ = coefficient × scale.
    pub coefficient_scale: Vec<f64>,
    /// The map between centred mean coordinates and the same without centring.
    pub centring: Centring,
    /// For each element of μ the fixed value in the user's units, or `None` if the element is not fixed.
    pub(crate) fixed: Vec<Option<f64>>,
}

impl MeanMap {
    pub(crate) fn new(structure: &Structure<'_>, frame: &Frame) -> MeanMap {
        let (m0, b) = structure.basis();
        let p = m0.len();
        let offset = DVector::from_vec(frame.mean_in(m0.as_slice()));
        let scaled = DMatrix::from_fn(p, b.ncols(), |i, c| b[(i, c)] / frame.scale[i]);
        let basis = orthonormal(scaled);
        let regressors: Vec<usize> = structure.regressions().iter().map(|r| r.element).collect();
        let coefficient_scale =
            regressors.iter().zip(&frame.covariate_scale).map(|(&i, x)| x / frame.scale[i]).collect();
        let known = |element: &MeanElement| match element {
            MeanElement::Fixed(value) => Some(*value),
            _ => None,
        };
        let fixed = structure.elements().iter().map(known).collect();
        let centring = Centring::new(&regressors, frame);
        MeanMap { offset, basis, regressors, coefficient_scale, centring, fixed }
    }

    /// μ and the regression coefficients in the user's units, at a point.
    pub(crate) fn in_user_units(&self, frame: &Frame, point: &Point) -> (Vec<f64>, Vec<f64>) {
        let mut coordinates = [&point.mean[..], &point.coefficients].concat();
        self.centring.uncentre(&mut coordinates);
        let scaled = coordinates.split_off(point.mean.len());
        frame.take_mean_out(&mut coordinates);
        (coordinates, scaled.iter().zip(&self.coefficient_scale).map(|(c, s)| c / s).collect())
    }

    /// μ in η and the scaled regression coefficients, from both in the user's units; coefficients that are not given
    /// are zero.
    pub(crate) fn in_eta(&self, frame: &Frame, mean: &[f64], coefficients: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let mut coordinates = frame.mean_in(mean);
        let given = coefficients.iter().copied().chain(std::iter::repeat(0.0));
        coordinates.extend(self.coefficient_scale.iter().zip(given).map(|(scale, value)| value * scale));
        self.centring.centre(&mut coordinates);
        let scaled = coordinates.split_off(mean.len());
        (coordinates, scaled)
    }

    /// d(mean coordinates of [`Sums`](super::sums::Sums)) / d(b, γ): block diagonal (Q, I).
    pub fn jacobian(&self) -> DMatrix<f64> {
        let (p, q) = self.basis.shape();
        let r = self.regressors.len();
        let mut jacobian = DMatrix::zeros(p + r, q + r);
        jacobian.view_mut((0, 0), (p, q)).copy_from(&self.basis);
        jacobian.view_mut((p, q), (r, r)).fill_with_identity();
        jacobian
    }

    /// d(b, γ) / d(the user's β and regression coefficients), q × q.
    pub(crate) fn by_user(&self, structure: &Structure<'_>, frame: &Frame) -> DMatrix<f64> {
        let (_, b) = structure.basis();
        let scaled = DMatrix::from_fn(b.nrows(), b.ncols(), |i, c| b[(i, c)] / frame.scale[i]);
        let (q, r) = (b.ncols(), self.regressors.len());
        let mut by_user = DMatrix::zeros(q + r, q + r);
        by_user.view_mut((0, 0), (q, q)).copy_from(&(self.basis.transpose() * scaled));
        for (c, scale) in self.coefficient_scale.iter().enumerate() {
            let mut moved = DVector::zeros(b.nrows() + r);
            moved[b.nrows() + c] = *scale;
            self.centring.centre(moved.as_mut_slice());
            by_user.view_mut((0, q + c), (q, 1)).copy_from(&(self.basis.transpose() * moved.rows(0, b.nrows())));
            by_user[(q + c, q + c)] = *scale;
        }
        by_user
    }

    /// The paper's (20), generalised: the point of the structure nearest to the mean of the posterior means in the
    /// metric Σ⁻¹. Without constraints, that point is the mean of the posterior means, (8). `None` when Σ is singular
    /// and the mean is constrained: the metric is not defined then, and the mean needs generalised least squares
    /// instead.
    pub(crate) fn maximise(&self, posterior_mean: &DVector<f64>, sigma: &DMatrix<f64>) -> Option<DVector<f64>> {
        if self.basis.ncols() == posterior_mean.len() {
            return Some(posterior_mean.clone());
        }
        let (least, largest) = symmetric::scaled_range(sigma);
        let inverse = (least > 1e-12 * largest).then(|| sigma.clone().cholesky())?;
        let inverse = inverse?.inverse();
        let information = self.basis.transpose() * &inverse * &self.basis;
        let right = self.basis.transpose() * inverse * (posterior_mean - &self.offset);
        Some(&self.offset + &self.basis * symmetric::pseudo_solve(&information, &right))
    }
}

/// Orthonormal columns with the span of the columns of a matrix of full column rank, by Gram-Schmidt, twice. Columns
/// without a common element keep their directions: reflections would cause rounding errors in elements that are zero,
/// and means that the data do not inform would seem to be informed a little.
fn orthonormal(mut a: DMatrix<f64>) -> DMatrix<f64> {
    for c in 0..a.ncols() {
        for _ in 0..2 {
            for k in 0..c {
                let along = a.column(k).dot(&a.column(c));
                if along != 0.0 {
                    let part = a.column(k) * along;
                    a.set_column(c, &(a.column(c) - part));
                }
            }
            let norm = a.column(c).norm();
            if norm > 0.0 {
                a.column_mut(c).unscale_mut(norm);
            }
        }
    }
    a
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_orthonormal_basis_leaves_elements_of_other_columns_at_zero() {
        let fixed_first = orthonormal(DMatrix::from_row_slice(3, 2, &[0.0, 0.0, 3.0, 0.0, 0.0, 0.2]));
        assert_eq!(fixed_first, DMatrix::from_row_slice(3, 2, &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]));
        let tied = orthonormal(DMatrix::from_row_slice(4, 2, &[0.5, 0.5, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0]));
        let product = tied.transpose() * &tied;
        assert!((&product - DMatrix::identity(2, 2)).amax() < 1e-15, "{product}");
        assert_eq!((tied[(3, 0)], tied[(3, 1)]), (0.0, 0.0));
    }
}
