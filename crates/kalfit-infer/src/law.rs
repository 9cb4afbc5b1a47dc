//! The asymptotic normal law of the estimates: the inverse of an information, or the sandwich, transformed to the
//! quantities that are reported.

use nalgebra::{DMatrix, DVector};

use crate::estimated::Estimated;
use crate::holdable::Holdable;
use crate::std_errors::{MAX_OPEN_SHARE, StdErrors};
use kalfit_algebra::regular::Regular;
use kalfit_algebra::sparse::Sparse;
use kalfit_algebra::symmetric;
use kalfit_estimate::{FinalState, JointLaw, PhaseForm};
use kalfit_filter::reduce::Reductions;

/// Eigenvalues of the information, scaled to unit diagonal, below this threshold count as zero.
const MIN_SCALED_EIGENVALUE: f64 = 1e-10;

/// The asymptotic normal law of the free coordinates, transformed to mean coordinates and elements of Σ.
pub(crate) struct AsymptoticLaw<'a> {
    pub(super) state: &'a FinalState,
    /// Covariance of the coordinates along the tangent basis.
    coordinates: DMatrix<f64>,
    /// Covariance of the mean coordinates alone, under the restricted likelihood: the covariance of generalised least
    /// squares at the estimated Σ, plus (dβ̂/dα) Var(α̂) (dβ̂/dα)' for estimated dynamic parameters.
    mean: Option<DMatrix<f64>>,
    /// dβ̂/dα of the mean coordinates, where `mean` and estimated dynamic parameters are given: coordinates × free
    /// values of α.
    follows: Option<DMatrix<f64>>,
    /// d(μ in η, γ; σ pairs) / d(tangent coordinates).
    jacobian: Sparse,
    /// The joint law with the free values of α, where some value of α moves Σ at fixed coordinates.
    joint: Option<WithParameters>,
}

/// The joint law of the coordinates along the tangent basis and the free values of α, in this order.
struct WithParameters {
    covariance: DMatrix<f64>,
    jacobian: Sparse,
    /// d(μ in η, γ; σ pairs) / d(values of α that the data do not determine).
    open: Sparse,
}

impl<'a> AsymptoticLaw<'a> {
    /// The law from the observed information.
    pub(crate) fn new(state: &'a FinalState) -> AsymptoticLaw<'a> {
        AsymptoticLaw::of(state, &Reductions::new(), StdErrors::Observed)
    }

    pub(super) fn of(state: &'a FinalState, reductions: &Reductions, kind: StdErrors) -> AsymptoticLaw<'a> {
        let tangent = &state.newton_iterate.tangent;
        let mean = state.problem.mean.jacobian();
        let (m, s) = (mean.nrows(), state.problem.covariance.elements.count());
        let mut jacobian = Sparse::with_height(m + s);
        mean.column_iter().for_each(|column| jacobian.push(column.iter().copied().enumerate()));
        tangent.jacobian.columns().for_each(|column| jacobian.push(column.iter().map(|&(row, x)| (m + row, x))));
        let gls = state.newton_iterate.near().map(|own| {
            let mut mean = DMatrix::zeros(tangent.basis.ncols(), tangent.basis.ncols());
            mean.view_mut((0, 0), own.shape()).copy_from(own); // the basis begins with the mean coordinates
            mean
        });
        let jacobian = jacobian.times_columns(&tangent.basis);
        let coordinates = match kind {
            // with estimated dynamic parameters, for every `kind`, the joint covariance is already known
            _ if state.joint.is_some() => {
                let joint = state.joint.as_ref().expect("there is one");
                joint.covariance.view((0, 0), (jacobian.ncols(), jacobian.ncols())).into_owned()
            }
            StdErrors::Observed => inverse(&tangent.information),
            StdErrors::Expected => {
                let information = jacobian.congruence(&state.sums.all_expected_information());
                inverse(&information)
            }
            StdErrors::Sandwich => {
                let meat = jacobian.congruence(&outer_scores(state, reductions, m, s));
                let bread = inverse(&tangent.information);
                let half = &bread * meat;
                half * bread
            }
        };
        // the sandwich includes the mean; with the two other kinds the mean has the covariance of generalised least
        // squares
        let mean = gls.filter(|_| kind != StdErrors::Sandwich);
        let follows =
            mean.as_ref().and(state.joint.as_ref()).map(|joint| follows(joint, tangent.mean, jacobian.ncols()));
        let by_values = |follows: &DMatrix<f64>| {
            let free = follows.ncols();
            let joint = state.joint.as_ref().expect("it follows its values");
            follows * joint.covariance.view((jacobian.ncols(), jacobian.ncols()), (free, free)) * follows.transpose()
        };
        let mean = mean.map(|own| follows.as_ref().map_or(own.clone(), |follows| own + by_values(follows)));
        let moves_sigma = |joint: &&JointLaw| joint.moves.iter().chain(&joint.open_moves).any(|x| *x != 0.0);
        let joint = state.joint.as_ref().filter(moves_sigma).map(|joint| WithParameters::of(joint, &jacobian));
        AsymptoticLaw { state, coordinates, mean, follows, jacobian, joint }
    }

    /// Covariance of the coordinates along the tangent basis.
    pub(crate) fn coordinates(&self) -> &DMatrix<f64> {
        &self.coordinates
    }

    /// d(μ in η, γ; σ pairs) / d(tangent coordinates).
    pub(crate) fn jacobian(&self) -> &Sparse {
        &self.jacobian
    }

    /// Covariance of the mean coordinates alone, under the restricted likelihood.
    pub(super) fn mean_law(&self) -> Option<&DMatrix<f64>> {
        self.mean.as_ref()
    }

    /// dβ̂/dα of the mean coordinates, where `mean_law` is given: coordinates × free values of α.
    pub(super) fn follows(&self) -> Option<&DMatrix<f64>> {
        self.follows.as_ref()
    }

    /// The rows of the jacobian: row, quantity, and the size of one unit of η in the user's units.
    pub(super) fn quantities(&self) -> Vec<(usize, Estimated, f64)> {
        let (p, problem) = (self.scale().len(), &self.state.problem);
        let means = (0..p).map(|i| (i, Estimated::Mean(i), self.scale()[i]));
        let scales = problem.mean.coefficient_scale.iter().enumerate();
        let coefficients = scales.map(|(c, scale)| (p + c, Estimated::Coefficient(c), scale.recip()));
        let covariances = problem.covariance.elements.all().map(|(i, j)| {
            let (row, unit) = self.sigma(i, j, 1.0);
            (row, Estimated::Covariance(i, j), unit)
        });
        means.chain(coefficients).chain(covariances).collect()
    }

    fn weights(&self, entries: &[(usize, f64)]) -> DVector<f64> {
        let mut weights = DVector::zeros(self.jacobian.nrows());
        entries.iter().for_each(|&(k, w)| weights[k] += w);
        self.state.problem.mean.centring.weights(weights.as_mut_slice());
        weights
    }

    fn scale(&self) -> &[f64] {
        &self.state.problem.classes.frame.scale
    }

    /// Row of σ_ij in the jacobian, and `weight` times the unit of σ_ij in the user's units.
    fn sigma(&self, i: usize, j: usize, weight: f64) -> (usize, f64) {
        let p = self.scale().len();
        let rows = p + self.state.problem.mean.regressors.len();
        (rows + self.state.problem.covariance.elements.index(i, j), weight * self.scale()[i] * self.scale()[j])
    }

    /// Derivatives of a quantity by mean coordinates and elements of Σ; `None` where the derivatives do not exist (a
    /// variance of zero). `sigma` is Σ in the user's units.
    pub(crate) fn weights_of(&self, sigma: &DMatrix<f64>, what: Holdable) -> Option<DVector<f64>> {
        let variance = |i: usize| Some(sigma[(i, i)]).filter(|variance| *variance > 0.0);
        Some(match what {
            Holdable::Mean(i) => self.weights(&[(i, self.scale()[i])]),
            Holdable::Coefficient(c) => {
                let unit = self.state.problem.mean.coefficient_scale[c].recip();
                self.weights(&[(self.scale().len() + c, unit)])
            }
            Holdable::StdDev(i) => self.weights(&[self.sigma(i, i, 0.5 / variance(i)?.sqrt())]),
            Holdable::Covariance(i, j) => self.weights(&[self.sigma(i, j, 1.0)]),
            // delta method for ρ = σ_ij / √(σ_ii σ_jj)
            Holdable::Correlation(i, j) => {
                let (vi, vj) = (variance(i)?, variance(j)?);
                let unit = (vi * vj).sqrt();
                let rho = sigma[(i, j)] / unit;
                let (own, first) = (self.sigma(i, j, 1.0 / unit), self.sigma(i, i, -0.5 * rho / vi));
                self.weights(&[own, first, self.sigma(j, j, -0.5 * rho / vj)])
            }
        })
    }

    /// Standard error of a quantity; `None` where the quantity has no standard error. `sigma` is Σ in the user's units.
    pub(super) fn error(&self, sigma: &DMatrix<f64>, what: Holdable) -> Option<f64> {
        let weights = &self.weights_of(sigma, what)?;
        match (what, &self.joint) {
            (Holdable::Mean(_) | Holdable::Coefficient(_), _) => {
                error(&self.jacobian, self.mean.as_ref().unwrap_or(&self.coordinates), weights)
            }
            (_, Some(joint)) if !joint.is_known(weights) => None,
            (_, Some(joint)) => error(&joint.jacobian, &joint.covariance, weights),
            (_, None) => error(&self.jacobian, &self.coordinates, weights),
        }
    }

    /// Derivative of a quantity along the tangent basis; zero where the derivative does not exist. `sigma` is Σ in the
    /// user's units.
    pub(crate) fn derivative(&self, sigma: &DMatrix<f64>, what: Holdable) -> DVector<f64> {
        match self.weights_of(sigma, what) {
            Some(weights) => self.jacobian.transposed_times(&weights),
            None => DVector::zeros(self.jacobian.ncols()),
        }
    }

    /// Derivative of a mean coordinate (μ in η, then γ), with covariates that are not centred, along the tangent basis.
    pub(super) fn derivative_of_coordinate(&self, row: usize) -> DVector<f64> {
        self.jacobian.transposed_times(&self.weights(&[(row, 1.0)]))
    }

    /// Derivative of weights'(μ, γ) along the tangent basis.
    pub(crate) fn derivative_of_means(&self, weights: &DVector<f64>) -> DVector<f64> {
        let units = self.state.problem.mean_units();
        let entries: Vec<(usize, f64)> =
            weights.iter().zip(units).map(|(weight, unit)| weight * unit).enumerate().collect();
        self.jacobian.transposed_times(&self.weights(&entries))
    }

    /// Relative standard error of a common factor on the Σ of a phase, from the largest variance of this Σ.
    pub(super) fn scale_error(&self, sigma: &DMatrix<f64>, part: &PhaseForm) -> Option<f64> {
        let i = part.states.clone().max_by(|&a, &b| sigma[(a, a)].total_cmp(&sigma[(b, b)]))?;
        let error = self.error(sigma, Holdable::Covariance(i, i)).filter(|_| sigma[(i, i)] > 0.0)?;
        Some(error / sigma[(i, i)])
    }
}

impl WithParameters {
    fn of(joint: &JointLaw, along: &Sparse) -> WithParameters {
        let rows = along.nrows();
        let push_sigma_columns = |moves: &DMatrix<f64>, whole: &mut Sparse| {
            let first = rows - moves.nrows();
            moves.column_iter().for_each(|c| whole.push(c.iter().enumerate().map(|(row, x)| (first + row, *x))));
        };
        let (mut jacobian, mut open) = (along.clone(), Sparse::with_height(rows));
        push_sigma_columns(&joint.moves, &mut jacobian);
        push_sigma_columns(&joint.open_moves, &mut open);
        WithParameters { covariance: joint.covariance.clone(), jacobian, open }
    }

    /// Whether a quantity with the derivatives `weights` is independent of all values of α that the data do not
    /// determine.
    fn is_known(&self, weights: &DVector<f64>) -> bool {
        self.open.transposed_times(weights).amax() <= MAX_OPEN_SHARE * weights.amax()
    }
}

/// dβ̂/dα = Cov(β̂, α̂) Var(α̂)⁻¹.
fn follows(joint: &JointLaw, mean: usize, coordinates: usize) -> DMatrix<f64> {
    let free = joint.slots.len();
    let of_values = joint.covariance.view((coordinates, coordinates), (free, free)).into_owned();
    let mut all = DMatrix::zeros(coordinates, free);
    let mean_slope = joint.covariance.view((0, coordinates), (mean, free)) * inverse(&of_values);
    all.view_mut((0, 0), (mean, free)).copy_from(&mean_slope);
    all
}

/// Standard error of the quantity whose derivatives by mean coordinates and elements of Σ are `weights`.
fn error(jacobian: &Sparse, law: &DMatrix<f64>, weights: &DVector<f64>) -> Option<f64> {
    // sizes are compared in η, independent of the user's units
    let unit = Some(weights.amax()).filter(|unit| *unit > 0.0)?;
    let along = jacobian.transposed_times(&(weights / unit));
    let size = along.amax();
    let moved: Vec<(usize, f64)> = along.iter().copied().enumerate().filter(|(_, x)| *x != 0.0).collect();
    let of = |k: usize| moved.iter().map(|&(i, x)| x * law[(i, k)]).sum::<f64>();
    let variance = moved.iter().map(|&(k, x)| x * of(k)).sum::<f64>() * unit * unit;
    (size > 1e-12 && variance.is_finite() && variance > 0.0).then(|| variance.sqrt())
}

/// Σ s s' over independent tests or units of tests; scores s by mean coordinates and elements of Σ.
fn outer_scores(state: &FinalState, reductions: &Reductions, m: usize, s: usize) -> DMatrix<f64> {
    let mut sum = DMatrix::zeros(m + s, m + s);
    state.each_independent(reductions, &mut |_, own| {
        let mut score = DVector::zeros(m + s);
        score.rows_mut(0, m).copy_from(&own.mean_score);
        score.rows_mut(m, s).copy_from(&state.problem.covariance.elements.pack_score(&own.score()));
        sum.ger(1.0, &score, &score, 1.0);
    });
    sum
}

/// Inverse after scaling to unit diagonal; flat and negative directions carry no information and are omitted.
pub(crate) fn inverse(information: &DMatrix<f64>) -> DMatrix<f64> {
    let n = information.nrows();
    let unit = |i: usize| if information[(i, i)] > 0.0 { information[(i, i)].sqrt().recip() } else { 0.0 };
    let scale = DVector::from_fn(n, |i, _| unit(i));
    let scaled = || DMatrix::from_fn(n, n, |i, j| scale[i] * information[(i, j)] * scale[j]);
    let from_eigen = || {
        let (values, vectors) = symmetric::eigen(&scaled());
        symmetric::from_eigen(&vectors, values.iter().map(|&v| if v > MIN_SCALED_EIGENVALUE { v.recip() } else { 0.0 }))
    };
    let mut inverse = Regular::within(scaled()).map_or_else(from_eigen, Regular::into_inverse);
    for (j, mut column) in inverse.column_iter_mut().enumerate() {
        column.iter_mut().zip(scale.iter()).for_each(|(x, of_row)| *x = of_row * *x * scale[j]);
    }
    inverse
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::value;
    use kalfit_estimate as estimate;
    use kalfit_estimate::{Estimate, Settings, Silent, Structure};
    use kalfit_model::Path;
    use kalfit_model::Reduction;
    use kalfit_model::{Alpha, CovarianceStructure, MeanStructure};

    /// A fit of two states with variances near 0.4 and 9, which twenty tests measure to about a tenth.
    fn fitted() -> Estimate {
        let factor = [10.0, 3.0, 10.0];
        let test = |j: usize| {
            let (x, y) = (0.9 * f64::sin(1.7 * j as f64), 3.7 * f64::sin(2.9 * j as f64 + 0.3));
            let y = y + 2.0 * x;
            Reduction {
                test: format!("t{j:02}"),
                constant: 0.0,
                residual: None,
                data: vec![factor[0] * x + factor[1] * y, factor[2] * y],
                factor: factor.to_vec(),
                covariates: Vec::new(),
                steps: 2,
                observations: 2,
                path: Path::Information,
                design: 0,
                chain: None,
                exact: None,
            }
        };
        let (mean, covariance, alpha) = (MeanStructure::free(2), CovarianceStructure::full(), Alpha::default());
        let structure = Structure::single(&mean, &covariance, &alpha);
        let data: Reductions = (0..20).map(test).collect();
        estimate::fit(&data, &structure, &Settings::default(), &mut Silent).expect("a legal problem")
    }

    #[test]
    fn standard_deviations_and_correlations_move_with_the_covariances_that_they_are_made_of() {
        let estimate = fitted();
        let (sigma, law) = (&estimate.covariance, AsymptoticLaw::new(&estimate.state));
        let (a, b, c) = (sigma[(0, 0)], sigma[(1, 1)], sigma[(1, 0)]);
        assert!(a < 1.0 && b > 2.0 && c > 0.1, "{sigma}");
        let of = |i, j| law.derivative(sigma, Holdable::Covariance(i, j));
        for (what, now, expected) in [
            (Holdable::StdDev(0), a.sqrt(), of(0, 0) / (2.0 * a.sqrt())),
            (Holdable::StdDev(1), b.sqrt(), of(1, 1) / (2.0 * b.sqrt())),
            (
                Holdable::Correlation(1, 0),
                c / (a * b).sqrt(),
                (of(1, 0) - of(0, 0) * (0.5 * c / a) - of(1, 1) * (0.5 * c / b)) / (a * b).sqrt(),
            ),
        ] {
            let found = law.derivative(sigma, what);
            assert!(expected.norm() > 0.0, "it moves");
            assert!((&found - &expected).norm() < 1e-12 * expected.norm(), "{what:?}: {found} {expected}");
            let value = value(&estimate, what).expect("it has a value");
            assert!((value - now).abs() < 1e-14, "{what:?}: {value} {now}");
        }
        let mut flat = sigma.clone();
        flat.fill_row(0, 0.0);
        flat.fill_column(0, 0.0);
        for what in [Holdable::StdDev(0), Holdable::Correlation(1, 0)] {
            assert_eq!(law.derivative(&flat, what).amax(), 0.0, "{what:?} of no variance does not move");
        }
    }
}
