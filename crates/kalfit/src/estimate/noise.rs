//! A factor of all noise: fits where all variances of noise are λ times as large, without new reductions, and derivatives by λ.
//!
//! R and d are then R/√λ and d/√λ, so that ℓ depends on λ through Σ/λ, a factor 1/λ of the squared residuals, and a constant. With
//! u = log λ, O = Σ r r', W = Σ W_j, G = ∂ℓ/∂Σ, Q = Σ e'(I + RΣR')⁻¹e for e = d - Rμ, n measurements, r the residual sum of squares
//! that tests are left with at any ξ and, under the restricted likelihood, q directions of the mean that the tests inform (otherwise
//! none), at u = 0
//!
//! ```text
//! ∂ℓ/∂u         = ½ (r - n + Q) + ½ tr(WΣ) - ½ tr(OΣ)
//! ∂/∂u ∂ℓ/∂mean = -∂ℓ/∂mean - ∂²ℓ/∂mean∂Σ [Σ]
//! ∂/∂u G        = -½ O - G - ∂²ℓ/∂Σ∂Σ [Σ]
//! ∂²ℓ/∂u²       = -½ (n - q) - ∂ℓ/∂u + tr(OΣ) + ∂²ℓ/∂Σ∂Σ [Σ, Σ]
//! ```
//!
//! What the restricted likelihood adds to ℓ is a(Σ/λ) + ½ q u with a its value at λ = 1, and ½ q - tr(A Σ) to ∂ℓ/∂u with A = ∂a/∂Σ.

use std::sync::Arc;

use nalgebra::DVector;

use crate::estimate::classes::Classes;
use crate::estimate::listed::Residual;
use crate::estimate::problem::Problem;
use crate::estimate::{Estimate, FitError, Settings, Silent, State, Structure, ended, problem};
use crate::model::{Population, StructureError};
use crate::reduce::Reduction;

/// Tests in one phase whose noise may be scaled.
#[derive(Debug)]
pub(crate) struct Noisy {
    /// At λ = 1.
    classes: Classes,
    /// Of each class.
    told: Arc<Vec<Residual>>,
    all: Residual,
}

impl Noisy {
    /// From reductions at λ = 1 and the r of each.
    pub(crate) fn new(
        reductions: &[Reduction],
        residuals: &[f64],
        structure: &Structure<'_>,
        settings: &Settings,
    ) -> Result<Noisy, FitError> {
        let classes = problem(reductions, structure, settings)?.classes;
        let of = |&j: &usize| Residual { measurements: reductions[j].observations as f64, squares: residuals[j] };
        let sum = |told: &mut dyn Iterator<Item = Residual>| told.fold(Residual::default(), Residual::and);
        let told: Vec<Residual> = classes.members().iter().map(|members| sum(&mut members.iter().map(of))).collect();
        let all = sum(&mut told.iter().copied());
        Ok(Noisy { classes, told: Arc::new(told), all })
    }

    /// The best (μ, Σ) where all noise is λ times as large, from values near them if there are any.
    pub(crate) fn fit(
        &self,
        variance: f64,
        structure: &Structure<'_>,
        near: Option<&Population>,
        settings: &Settings,
    ) -> Result<Estimate, FitError> {
        let classes = self.classes.with_noise(variance, &self.told);
        let problem = Problem::of(classes, structure, settings.criterion)?;
        ended(problem, structure, near, settings, &mut Silent)
    }

    /// ∂ℓ/∂u where a fit at this λ ended.
    pub(crate) fn slope(&self, variance: f64, state: &State) -> f64 {
        let Residual { measurements, squares } = self.all;
        let (sums, sigma) = (&state.sums, state.place.point.covariance());
        let own = squares / variance - measurements + sums.quadratic + (&sums.weight - &sums.outer).dot(&sigma);
        let restricted = sums.restricted.as_ref().map(|restricted| restricted.score.dot(&sigma));
        0.5 * (own + state.problem.informed() as f64) - restricted.unwrap_or(0.0)
    }

    /// -∂²ℓ/∂u² and -∂²ℓ/∂u∂(μ, Σ) there.
    pub(crate) fn information(&self, variance: f64, state: &State) -> NoiseInformation {
        state.noise_information(self.all.measurements, self.slope(variance, state))
    }
}

/// -∂²ℓ/∂u² and -∂²ℓ/∂u∂(μ, Σ), this along the tangent basis of the state's place.
#[derive(Debug, Clone)]
pub(crate) struct NoiseInformation {
    pub(crate) own: f64,
    pub(crate) cross: DVector<f64>,
}

impl State {
    fn noise_information(&self, measurements: f64, slope: f64) -> NoiseInformation {
        let (local, tangent, elements) = (&self.place.local, &self.place.tangent, &self.sums.elements);
        debug_assert!(elements.is_single(), "between phases noise has links of its own");
        let covariance = self.place.point.covariance();
        let sigma = DVector::from_iterator(elements.count(), elements.all().map(|(k, l)| covariance[(k, l)]));
        let outer = elements.pack_score(&self.sums.outer);
        let curved = &local.information * &sigma;
        let of_mean = &local.mean_score - &local.cross * &sigma;
        let of_sigma = &outer * 0.5 + elements.pack_score(&local.score) - &curved;
        let mut cross = DVector::zeros(tangent.basis.nrows());
        let mean = self.problem.mean.jacobian().transpose() * of_mean;
        cross.rows_mut(0, mean.len()).copy_from(&mean);
        cross.rows_mut(mean.len(), tangent.jacobian.ncols()).copy_from(&(tangent.jacobian.transpose() * of_sigma));
        let informed = measurements - self.problem.informed() as f64;
        let own = 0.5 * informed + slope - outer.dot(&sigma) + sigma.dot(&curved);
        NoiseInformation { own, cross: tangent.basis.transpose() * cross }
    }
}

impl State {
    /// The same, its classes gathered from reductions of the same tests.
    pub(crate) fn grounded(self, reductions: &[Reduction]) -> Result<State, StructureError> {
        let problem = Problem::within(&self.evidence(reductions), &self.structure(), &self.problem)?;
        Ok(State { problem: Arc::new(problem), ..self })
    }
}
