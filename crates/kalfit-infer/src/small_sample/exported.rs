//! The laws of the means and of θ in the user's units, from which degrees of freedom of predictions follow (14.12).

use nalgebra::DMatrix;

use crate::estimated::Estimated;
use crate::small_sample::SmallSample;
use crate::small_sample::theta::Theta;
use crate::small_sample::variances::Variances;
use kalfit_estimate::FinalState;

/// Most numbers of a law that is exported: about 0.4 MB of fit.json.
const MOST_NUMBERS: usize = 20_000;

/// The laws of (μ, coefficients) and of θ, the free elements of Σ and the free parameters that move, in the user's units.
#[derive(Debug, Clone, PartialEq)]
pub struct MeanAndVarianceLaw<Quantity = Estimated> {
    /// Number of elements of μ, in the order of the estimate; rows after them are of regression coefficients.
    pub means: usize,
    /// The elements of θ.
    pub quantities: Vec<Quantity>,
    /// Value of each.
    pub values: Vec<f64>,
    /// Power of each that is a variance: 1 for elements of Σ, 2 for a standard deviation of noise, 0 where there is none.
    pub powers: Vec<f64>,
    /// V_θ (14.5), θ × θ, over all directions that the structure leaves free, singular Σ or not.
    pub covariance: DMatrix<f64>,
    /// Covariance of the estimates of (μ, coefficients) by the method, C_A for Kenward and Roger, (p + r) × (p + r).
    pub mean_covariance: DMatrix<f64>,
    /// C, the covariance of the same estimates at known θ.
    pub mean_covariance_plain: DMatrix<f64>,
    /// Derivatives of C by each element of θ, -C M_a C: (p + r) × (p + r) each.
    pub mean_slopes: Vec<DMatrix<f64>>,
}

/// An element of θ in the user's units.
#[derive(Debug, Clone)]
pub(super) struct UserTheta {
    quantity: Estimated,
    /// dvalue/dθ.
    by: f64,
    value: f64,
    power: f64,
}

/// The elements of θ in the user's units.
pub(super) fn user_theta(state: &FinalState, theta: &Theta, variances: Option<&Variances>) -> Vec<UserTheta> {
    let scale = &state.problem.classes.frame.scale;
    let elements: Vec<(usize, usize)> = state.problem.covariance.elements.all().collect();
    let parameters = variances.into_iter().flat_map(|own| own.slots.iter().zip(&own.value_by_theta).zip(&own.values));
    let parameters = parameters.map(|((&slot, &by), &[value, power])| UserTheta {
        quantity: Estimated::Value(slot),
        by,
        value,
        power,
    });
    let covariance = state.newton_iterate.point.covariance();
    let of_sigma = theta.elements.iter().map(|&k| {
        let (i, j) = elements[k];
        let by = scale[i] * scale[j];
        let quantity = Estimated::Covariance(i.max(j), i.min(j));
        UserTheta { quantity, by, value: covariance[(i, j)] * by, power: 1.0 }
    });
    parameters.chain(of_sigma).collect()
}

impl SmallSample {
    /// The laws in the user's units; `None` where they have too many numbers to keep, or one that is not finite.
    pub fn exported(&self) -> Option<MeanAndVarianceLaw> {
        let (count, width) = (self.user_theta.len(), self.estimates.len());
        if count * (count + width * width) > MOST_NUMBERS {
            return None;
        }
        let by = |a: usize| self.user_theta[a].by;
        let theta = &self.law.theta.covariance;
        let covariance = DMatrix::from_fn(count, count, |a, b| by(a) * theta[(a, b)] * by(b));
        let in_user_units = |matrix: &DMatrix<f64>| self.from_user.transpose() * matrix * &self.from_user;
        let slope = |(a, slope): (usize, &DMatrix<f64>)| in_user_units(slope) * -by(a).recip();
        let law = MeanAndVarianceLaw {
            means: self.means,
            quantities: self.user_theta.iter().map(|one| one.quantity).collect(),
            values: self.user_theta.iter().map(|one| one.value).collect(),
            powers: self.user_theta.iter().map(|one| one.power).collect(),
            covariance,
            mean_covariance: in_user_units(&self.law.adjusted),
            mean_covariance_plain: in_user_units(&self.law.covariance),
            mean_slopes: self.law.slopes.iter().enumerate().map(slope).collect(),
        };
        let matrices =
            [&law.covariance, &law.mean_covariance, &law.mean_covariance_plain].into_iter().chain(&law.mean_slopes);
        let is_finite = matrices.flat_map(|matrix| matrix.iter()).all(|x| x.is_finite());
        is_finite.then_some(law)
    }
}

impl<Quantity: Clone> MeanAndVarianceLaw<Quantity> {
    /// The law with the elements of θ that `is_exact` selects treated as known exactly.
    #[must_use]
    pub fn without(&self, is_exact: &dyn Fn(&Quantity) -> bool) -> MeanAndVarianceLaw<Quantity> {
        let kept: Vec<usize> = (0..self.quantities.len()).filter(|&a| !is_exact(&self.quantities[a])).collect();
        MeanAndVarianceLaw {
            means: self.means,
            quantities: kept.iter().map(|&a| self.quantities[a].clone()).collect(),
            values: kept.iter().map(|&a| self.values[a]).collect(),
            powers: kept.iter().map(|&a| self.powers[a]).collect(),
            covariance: self.covariance.select_rows(&kept).select_columns(&kept),
            mean_covariance: self.mean_covariance.clone(),
            mean_covariance_plain: self.mean_covariance_plain.clone(),
            mean_slopes: kept.iter().map(|&a| self.mean_slopes[a].clone()).collect(),
        }
    }
}
