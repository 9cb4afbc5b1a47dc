//! A factor λ of all noise variances: fits at any λ without new reductions, and derivatives by λ.
//!
//! R and d are then R/√λ and d/√λ, so that ℓ depends on λ through Σ/λ, a factor 1/λ of the squared residuals, and a
//! constant. Let u = log λ, O = Σ r r', W = Σ W_j, G = ∂ℓ/∂Σ, Q = Σ e'(I + RΣR')⁻¹e for e = d - Rμ, n the number of
//! measurements, r the part of the residual sum of squares of the tests that does not depend on ξ, and q the number of
//! directions of the mean that the tests inform under the restricted likelihood, zero under maximum likelihood. Then at
//! u = 0
//!
//! ```text
//! ∂ℓ/∂u         = ½ (r - n + Q) + ½ tr(WΣ) - ½ tr(OΣ)
//! ∂/∂u ∂ℓ/∂mean = -∂ℓ/∂mean - ∂²ℓ/∂mean∂Σ [Σ]
//! ∂/∂u G        = -½ O - G - ∂²ℓ/∂Σ∂Σ [Σ]
//! ∂²ℓ/∂u²       = -½ (n - q) - ∂ℓ/∂u + tr(OΣ) + ∂²ℓ/∂Σ∂Σ [Σ, Σ]
//! ```
//!
//! The restricted likelihood adds a(Σ/λ) + ½ q u to ℓ, with a the term of the restricted likelihood at λ = 1, and ½ q -
//! tr(A Σ) to ∂ℓ/∂u, with A = ∂a/∂Σ.

use std::sync::Arc;

use nalgebra::DVector;

use crate::classes::Classes;
use crate::local::Objective;
use crate::problem::Problem;
use crate::residual::Residual;
use crate::search::{Beginning, Search};
use crate::{Estimate, FinalState, FitError, Settings, Silent, Structure, problem};
use kalfit_filter::reduce::Reductions;
use kalfit_model::{Population, StructureError};

/// Tests in one phase, with or without groups, whose noise can be scaled; with groups, Σ has one block for each level.
#[derive(Debug)]
pub struct ScalableNoise {
    /// Classes at λ = 1.
    classes: Classes,
    /// Residual of each class.
    residuals: Arc<Vec<Residual>>,
    all: Residual,
}

impl ScalableNoise {
    /// From reductions at λ = 1, each with a known residual sum of squares.
    pub fn new(
        reductions: &Reductions,
        structure: &Structure<'_>,
        settings: &Settings,
    ) -> Result<ScalableNoise, FitError> {
        let classes = problem(reductions, structure, settings)?.classes;
        let sum = |residuals: &mut dyn Iterator<Item = Residual>| residuals.fold(Residual::default(), Residual::plus);
        let of_test = |&j: &usize| Residual::of(reductions, j);
        let residuals: Vec<Residual> =
            (0..classes.len()).map(|k| sum(&mut classes.tests_of(k).iter().map(of_test))).collect();
        let all = sum(&mut residuals.iter().copied());
        Ok(ScalableNoise { classes, residuals: Arc::new(residuals), all })
    }

    /// Fits (μ, Σ) with all noise variances multiplied by λ = `variance`, from nearby values if given.
    pub fn fit(
        &self,
        variance: f64,
        structure: &Structure<'_>,
        near: Option<&Population>,
        settings: &Settings,
    ) -> Result<Estimate, FitError> {
        let classes = self.classes.with_noise(variance, &self.residuals);
        let problem = Problem::of(classes, structure, settings.criterion)?;
        let start = near.map_or(Beginning::Open, Beginning::Near);
        Search::new(problem, settings, &mut Silent).run(start, structure)
    }

    /// ∂ℓ/∂u at `state`, the end of a fit at λ = `variance`.
    pub fn slope(&self, variance: f64, state: &FinalState) -> f64 {
        let Residual { measurements, squares } = self.all;
        let (sums, sigma) = (&state.sums, state.newton_iterate.point.covariance());
        let own = squares / variance - measurements + sums.quadratic + (&sums.weight - &sums.outer).dot(&sigma);
        let restricted = sums.restricted.as_ref().map(|restricted| restricted.score.dot(&sigma));
        0.5 * (own + state.problem.informed() as f64) - restricted.unwrap_or(0.0)
    }

    /// -∂²ℓ/∂u² and -∂²ℓ/∂u∂(μ, Σ) at a state, from `slope` = ∂ℓ/∂u.
    pub fn information(&self, slope: f64, state: &FinalState) -> NoiseInformation {
        state.noise_information(self.all.measurements, slope)
    }
}

/// -∂²ℓ/∂u² and -∂²ℓ/∂u∂(μ, Σ), the latter along the tangent basis of the state.
#[derive(Debug, Clone)]
pub struct NoiseInformation {
    /// -∂²ℓ/∂u².
    pub own: f64,
    /// -∂²ℓ/∂u∂(μ, Σ), one number for each column of the tangent basis.
    pub cross: DVector<f64>,
}

impl FinalState {
    fn noise_information(&self, measurements: f64, slope: f64) -> NoiseInformation {
        let (local, tangent, elements) =
            (&self.newton_iterate.local, &self.newton_iterate.tangent, &self.sums.elements);
        let levels = self.problem.classes.units.is_some();
        debug_assert!(levels || elements.is_single(), "between phases noise has links of its own");
        let covariance = self.newton_iterate.point.covariance();
        let sigma = DVector::from_iterator(elements.count(), elements.all().map(|(k, l)| covariance[(k, l)]));
        let outer = elements.pack_score(&self.sums.outer);
        let curved = &*local.information * &sigma;
        let of_mean = &local.mean_score - &local.cross * &sigma;
        let of_sigma = &outer * 0.5 + elements.pack_score(&local.score) - &curved;
        let of_psi = tangent.jacobian.transposed_times(&of_sigma);
        let informed = measurements - self.problem.informed() as f64;
        let own = 0.5 * informed + slope - outer.dot(&sigma) + sigma.dot(&curved);
        NoiseInformation { own, cross: tangent.pulled_back(self.problem.mean_jacobian(), &of_mean, &of_psi) }
    }
}

impl FinalState {
    /// The state with `reductions`, of the tests of this state, as the data of the problem.
    pub fn with_reductions(self, reductions: &Reductions) -> Result<FinalState, StructureError> {
        let problem = match self.problem.classes.with_reductions(reductions) {
            Some(classes) => Problem::of(classes, &self.structure(), self.problem.criterion())?,
            None => Problem::within(&self.evidence(reductions), &self.structure(), &self.problem)?,
        };
        Ok(FinalState { problem: Arc::new(problem), ..self })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::order::Order;
    use crate::{Criterion, fit, fit_from};
    use kalfit_filter::reduce::ReductionRef;
    use kalfit_model::Path;
    use kalfit_model::Reduction;
    use kalfit_model::{Alpha, CovarianceStructure, MeanStructure, Regression};

    fn wave(j: usize, at: usize) -> f64 {
        ((7 * j + 3 * at) as f64).sin()
    }

    /// Every third test has a separate design, the others share designs, and two tests need square-root arithmetic.
    fn test(j: usize) -> Reduction {
        let design = if j.is_multiple_of(3) { j } else { 1 + j / 15 };
        let factor = vec![2.0 + wave(design, 1), wave(design, 2), 1.5 + 0.5 * wave(design, 3)];
        let [a, b] = [1.0 + 0.8 * wave(j, 4), 0.6 * wave(j, 5) - 0.4];
        let residual = 8.0 * (1.0 + 0.3 * wave(j, 6));
        Reduction {
            test: format!("t{j:02}"),
            constant: wave(j, 7) - 0.5 * residual,
            residual: Some(residual),
            data: vec![factor[0] * a + factor[1] * b + 0.5 * wave(j, 8), factor[2] * b + 0.5 * wave(j, 9)],
            factor,
            covariates: vec![wave(design, 10)],
            steps: 10,
            observations: 10,
            path: if j == 4 || j == 9 { Path::SquareRoot } else { Path::Information },
            design: design as u128,
            chain: None,
            exact: None,
        }
    }

    /// The reduction with all noise variances multiplied by λ.
    fn noisier(test: ReductionRef<'_>, variance: f64) -> Reduction {
        let residual = test.residual.expect("it is known");
        let shrunk = |numbers: &[f64]| numbers.iter().map(|x| x / variance.sqrt()).collect();
        Reduction {
            constant: test.constant
                - 0.5 * (test.observations as f64 * variance.ln() + residual * (variance.recip() - 1.0)),
            data: shrunk(test.data),
            factor: shrunk(test.factor),
            ..test.into()
        }
    }

    #[test]
    fn fits_at_other_noise_are_those_of_the_reductions_there() {
        let reductions: Reductions = (0..40).map(test).collect();
        let regression = vec![Regression { element: 0, column: 0 }];
        let covariance = CovarianceStructure::full();
        let alpha = Alpha { values: Vec::new() };
        for mean in [MeanStructure::free(2), MeanStructure { regression, ..MeanStructure::free(2) }] {
            let structure = Structure::single(&mean, &covariance, &alpha);
            let reductions = reductions.clone().with_covariates(&[0][..mean.regression.len()]);
            for criterion in [Criterion::Ml, Criterion::Reml] {
                let settings = Settings { criterion, ..Settings::default() };
                let noisy = ScalableNoise::new(&reductions, &structure, &settings).expect("sound");
                assert!(!noisy.classes.unbatched.is_empty() && noisy.classes.len() < 40, "of all kinds");
                let direct = |variance: f64, near: Option<&Population>| {
                    let there: Reductions = reductions.iter().map(|test| noisier(test, variance)).collect();
                    match near {
                        Some(start) => fit_from(&there, &structure, start, &settings, &mut Silent),
                        None => fit(&there, &structure, &settings, &mut Silent),
                    }
                    .expect("a fit")
                };
                for variance in [0.3, 1.0, 5.0] {
                    let found = noisy.fit(variance, &structure, None, &settings).expect("a fit");
                    let expected = direct(variance, None);
                    let near = |a: f64, b: f64| (a - b).abs() < 1e-9 * (1.0 + b.abs());
                    let about =
                        format!("{criterion:?} {variance}: {} {}", found.log_likelihood, expected.log_likelihood);
                    assert!(near(found.log_likelihood, expected.log_likelihood), "{about}");
                    let off = (&found.covariance - &expected.covariance).amax();
                    assert!(
                        off <= 1e-6 * expected.covariance.amax(),
                        "{about}: {} {}",
                        found.covariance,
                        expected.covariance
                    );
                    let h: f64 = 1e-4;
                    let at = |u: f64| direct(variance * u.exp(), Some(&Population::from(&expected))).log_likelihood;
                    let by_differences = (at(h) - at(-h)) / (2.0 * h);
                    let slope = noisy.slope(variance, &found.state);
                    assert!((slope - by_differences).abs() < 1e-5 * (1.0 + slope.abs()), "{slope} {by_differences}");
                    let all: Reductions = reductions.iter().map(|test| noisier(test, variance)).collect();
                    let with_reductions = found.state.clone().with_reductions(&all).expect("sound");
                    let again = with_reductions
                        .problem
                        .sums(&with_reductions.newton_iterate.point, Order::First, None)
                        .expect("defined");
                    assert!(near(again.value, found.log_likelihood), "{} {}", again.value, found.log_likelihood);
                }
            }
        }
    }
}
