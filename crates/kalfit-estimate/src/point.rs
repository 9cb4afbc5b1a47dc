//! A point of (μ, Σ), in η.

use kalfit_lanes::Lanes;
use nalgebra::DMatrix;

use crate::chained::Packed;
use crate::class::ClassRef;

/// A point at which ℓ is evaluated, in η: the mean (without regression), scaled regression coefficients, and F with Σ =
/// FF'.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// μ without regression (p).
    pub mean: Vec<f64>,
    /// Scaled regression coefficients, one for each regression.
    pub coefficients: Vec<f64>,
    /// F with FF' = Σ.
    pub root: DMatrix<f64>,
}

impl Point {
    /// μ of the tests of a class.
    pub(crate) fn mean_of(&self, class: ClassRef<'_>, regressors: &Regressors) -> Vec<f64> {
        let mut mean = Vec::new();
        self.put_mean(class, regressors, &mut mean);
        mean
    }

    /// Writes μ of the tests of a class into `mean`.
    pub fn put_mean(&self, class: ClassRef<'_>, regressors: &Regressors, mean: &mut Vec<f64>) {
        mean.clone_from(&self.mean);
        for (c, &element) in regressors.iter().enumerate() {
            mean[element] += class.covariates[c] * self.coefficients[c];
        }
    }

    /// Σ = FF'.
    pub fn covariance(&self) -> DMatrix<f64> {
        &self.root * self.root.transpose()
    }
}

/// Elements of the mean that the regression coefficients act on.
pub(crate) type Regressors = [usize];

impl Packed {
    /// The first `count` covariates of each class, one class per lane.
    #[inline(always)]
    pub(crate) fn covariates<'a, T: Lanes>(&self, class: impl Fn(usize) -> ClassRef<'a>, count: usize) -> Vec<T> {
        let mut covariates = Vec::with_capacity(count);
        for c in 0..count {
            let mut all = [0.0; kalfit_lanes::MAX_LANES];
            for (to, &member) in all.iter_mut().zip(&self.members) {
                *to = class(member).covariates[c];
            }
            covariates.push(T::load(&all));
        }
        covariates
    }

    /// μ of the tests of each class, one class per lane, from the covariates of the classes.
    #[inline(always)]
    pub(crate) fn means<T: Lanes>(&self, covariates: &[T], point: &Point, regressors: &Regressors) -> Vec<T> {
        let mut mean = Vec::with_capacity(point.mean.len());
        for x in &point.mean {
            mean.push(T::splat(*x));
        }
        for (c, &element) in regressors.iter().enumerate() {
            mean[element] = mean[element] + covariates[c] * T::splat(point.coefficients[c]);
        }
        mean
    }
}
