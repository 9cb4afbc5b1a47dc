//! Standard errors at the optimum: from the observed information, the expected information, or the sandwich of both.

use nalgebra::{DMatrix, DVector};

use crate::estimate::{CovarianceMap, Estimate, Form, Order, Part, State};
use crate::infer::{Direction, Quantity};
use crate::linalg::elements::Elements;
use crate::linalg::symmetric;
use crate::reduce::Reduction;

/// What standard errors are made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum StdErrors {
    /// H⁻¹, H the negative Hessian of ℓ.
    #[default]
    Observed,
    /// I⁻¹, I the expected information (theory §3).
    Expected,
    /// H⁻¹ (Σ_j s_j s_j') H⁻¹ with the scores s_j of the tests: right also when the model is not, given many tests.
    Sandwich,
}

/// Scaled eigenvalues of the information below this carry none.
const FLAT: f64 = 1e-10;
/// An element that takes part in an unidentified direction by more than this has no standard error.
pub(crate) const PART: f64 = 1e-6;

/// Standard errors, in the user's units. `None` where a quantity is fixed, not identified, or on the boundary.
#[derive(Debug, Clone, PartialEq)]
pub struct Uncertainty {
    /// Of μ (p).
    pub mean: Vec<Option<f64>>,
    /// Of the regression coefficients.
    pub coefficients: Vec<Option<f64>>,
    /// Of Σ (p × p).
    pub covariance: Vec<Vec<Option<f64>>>,
    /// Of the standard deviations (p).
    pub std_dev: Vec<Option<f64>>,
    /// Of the correlations (p × p).
    pub correlation: Vec<Vec<Option<f64>>>,
    /// Relative standard error of β in Σ = βΣ*, by phase.
    pub scale: Vec<Option<f64>>,
    /// Blocks of Σ that are singular.
    pub boundary: Vec<Boundary>,
}

/// A block of Σ on the boundary of the positive semidefinite cone.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Boundary {
    /// Elements of the block.
    pub states: Vec<usize>,
    /// Its rank.
    pub rank: usize,
    /// Elements whose variance is zero.
    pub zero_variances: Vec<usize>,
}

/// Whether a quantity takes part in an unidentified direction.
fn takes_part(unidentified: &[Direction], quantity: Quantity, k: usize) -> bool {
    let of = unidentified.iter().filter(|d| d.quantity == quantity);
    of.map(|d| d.direction[k].abs()).fold(0.0, f64::max) > PART
}

/// Whether an element of Σ does; those between phases do not.
fn element_takes_part(unidentified: &[Direction], elements: &Elements, i: usize, j: usize) -> bool {
    elements.get(i, j).is_some_and(|k| takes_part(unidentified, Quantity::Covariance, k))
}

/// Quantities that are neither fixed nor unidentified.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Free {
    /// Of μ (p).
    pub mean: Vec<bool>,
    /// Of Σ (p × p).
    pub covariance: Vec<Vec<bool>>,
    /// Of the correlations (p × p).
    pub correlation: Vec<Vec<bool>>,
}

/// The free quantities of an estimate.
pub fn free(estimate: &Estimate, unidentified: &[Direction]) -> Free {
    let problem = &estimate.state.problem;
    let p = estimate.mean.len();
    let mean = |i: usize| problem.mean.basis.row(i).amax() > 0.0 && !takes_part(unidentified, Quantity::Mean, i);
    let directions = problem.covariance.free_directions(&estimate.state.place.tangent.chart);
    let map = &problem.covariance;
    let moves = |i: usize, j: usize| {
        map.elements.get(i, j).is_some_and(|k| {
            directions.row(k).iter().any(|x| x.abs() > 1e-12) && !takes_part(unidentified, Quantity::Covariance, k)
        })
    };
    let bends = |i: usize, j: usize| {
        matches!(map.form_of(i), Form::Factor(_))
            && i != j
            && (moves(i, j)
                || (estimate.covariance[(i, j)] != 0.0
                    && (moves(i, i) || moves(j, j))
                    && !element_takes_part(unidentified, &map.elements, i, j)))
    };
    let matrix = |of: &dyn Fn(usize, usize) -> bool| (0..p).map(|i| (0..p).map(|j| of(i, j)).collect()).collect();
    Free { mean: (0..p).map(mean).collect(), covariance: matrix(&moves), correlation: matrix(&bends) }
}

/// Standard errors at an estimate. The reductions are those it was made from; only the sandwich looks at them.
pub fn uncertainty(
    estimate: &Estimate,
    reductions: &[Reduction],
    unidentified: &[Direction],
    kind: StdErrors,
) -> Uncertainty {
    uncertainty_of(estimate, &estimate.state.evidence(reductions), unidentified, kind)
}

/// The same from the reductions whose likelihood was maximised.
pub(super) fn uncertainty_of(
    estimate: &Estimate,
    evidence: &[Reduction],
    unidentified: &[Direction],
    kind: StdErrors,
) -> Uncertainty {
    uncertainty_by(&Law::of(&estimate.state, evidence, kind), &estimate.covariance, unidentified)
}

/// Standard errors from the information in a state of the estimator, at the end of a search or anywhere else; `sigma` is Σ
/// there, in the user's units.
pub(crate) fn uncertainty_at(state: &State, sigma: &DMatrix<f64>, unidentified: &[Direction]) -> Uncertainty {
    uncertainty_by(&Law::new(state), sigma, unidentified)
}

fn uncertainty_by(law: &Law<'_>, sigma: &DMatrix<f64>, unidentified: &[Direction]) -> Uncertainty {
    let state = law.state;
    let map = &state.problem.covariance;
    let boundary = boundary(map, &state.place.point.root);
    let p = sigma.nrows();
    let parts = |quantity: Quantity, k: usize| takes_part(unidentified, quantity, k);
    let on_boundary = |i: usize| boundary.iter().any(|b| b.states.contains(&i));
    let elements = &map.elements;
    let known =
        |i: usize, j: usize| !(on_boundary(i) || on_boundary(j) || element_takes_part(unidentified, elements, i, j));
    let mut covariance = vec![vec![None; p]; p];
    let mut correlation = vec![vec![None; p]; p];
    let mut std_dev = vec![None; p];
    for (i, j) in elements.all() {
        let error = known(i, j).then(|| law.sigma_error(i, j)).flatten();
        covariance[i][j] = error;
        covariance[j][i] = error;
    }
    for i in 0..p {
        std_dev[i] = covariance[i][i].filter(|_| sigma[(i, i)] > 0.0).map(|e| e / (2.0 * sigma[(i, i)].sqrt()));
    }
    for (i, j) in elements.all().filter(|(i, j)| i != j) {
        let error = (known(i, j) && known(i, i) && known(j, j)).then(|| law.correlation_error(sigma, i, j)).flatten();
        correlation[i][j] = error;
        correlation[j][i] = error;
    }
    let mean = (0..p).map(|i| if parts(Quantity::Mean, i) { None } else { law.mean_error(i) }).collect();
    let coefficients = (0..state.problem.mean.regressors.len())
        .map(|c| if parts(Quantity::Mean, p + c) { None } else { law.coefficient_error(c) })
        .collect();
    let of_part = |part: &Part| matches!(part.form, Form::Scale(_)).then(|| law.scale_error(sigma, part)).flatten();
    let scale = map.parts.iter().map(of_part).collect();
    Uncertainty { mean, coefficients, covariance, std_dev, correlation, scale, boundary }
}

/// Blocks of Σ that are singular.
fn boundary(map: &CovarianceMap, root: &DMatrix<f64>) -> Vec<Boundary> {
    let of_part = |part: &Part| -> Vec<Vec<usize>> {
        match &part.form {
            Form::Factor(blocks) => blocks.clone(),
            Form::StdDevs(_, states) => {
                states.iter().filter(|&&i| root.row(i).norm() == 0.0).map(|&i| vec![i]).collect()
            }
            Form::Scale(_) if part.of(root).amax() == 0.0 => {
                vec![map.random.iter().copied().filter(|i| part.states.contains(i)).collect()]
            }
            _ => Vec::new(),
        }
    };
    let blocks: Vec<Vec<usize>> = map.parts.iter().flat_map(of_part).collect();
    let rank = |block: &[usize]| {
        let own = DMatrix::from_fn(block.len(), root.ncols(), |i, c| root[(block[i], c)]);
        let norms: Vec<f64> = (0..block.len()).map(|i| own.row(i).norm()).collect();
        let scaled =
            DMatrix::from_fn(
                block.len(),
                own.ncols(),
                |i, c| if norms[i] > 0.0 { own[(i, c)] / norms[i] } else { 0.0 },
            );
        let (values, _) = symmetric::eigen(&(&scaled * scaled.transpose()));
        values.iter().filter(|v| **v > 1e-11).count()
    };
    blocks
        .into_iter()
        .map(|states| Boundary {
            rank: rank(&states),
            zero_variances: states.iter().copied().filter(|&i| root.row(i).norm() == 0.0).collect(),
            states,
        })
        .filter(|b| b.rank < b.states.len())
        .collect()
}

/// The asymptotic normal law of the free coordinates, carried to mean coordinates and elements of Σ.
pub(crate) struct Law<'a> {
    state: &'a State,
    /// Covariance of the coordinates along the tangent basis.
    coordinates: DMatrix<f64>,
    /// The same for the mean alone: under the restricted likelihood that of generalised least squares at the estimated Σ.
    mean: Option<DMatrix<f64>>,
    /// d(μ in η, γ; σ pairs) / d(tangent coordinates).
    jacobian: DMatrix<f64>,
}

impl<'a> Law<'a> {
    /// From the observed information.
    pub(crate) fn new(state: &'a State) -> Law<'a> {
        Law::of(state, &[], StdErrors::Observed)
    }

    fn of(state: &'a State, reductions: &[Reduction], kind: StdErrors) -> Law<'a> {
        let tangent = &state.place.tangent;
        let mean = state.problem.mean.jacobian();
        let (m, s) = (mean.nrows(), state.problem.covariance.elements.count());
        let mut jacobian = DMatrix::zeros(m + s, tangent.mean + tangent.jacobian.ncols());
        jacobian.view_mut((0, 0), mean.shape()).copy_from(&mean);
        jacobian.view_mut((m, tangent.mean), tangent.jacobian.shape()).copy_from(&tangent.jacobian);
        let gls = state.place.near().map(|own| {
            let mut mean = DMatrix::zeros(tangent.basis.ncols(), tangent.basis.ncols());
            mean.view_mut((0, 0), own.shape()).copy_from(own); // the basis begins with the mean coordinates
            mean
        });
        let jacobian = jacobian * &tangent.basis;
        let coordinates = match kind {
            StdErrors::Observed => match &state.joint {
                Some(joint) => joint.clone(),
                None => inverse(&tangent.information),
            },
            StdErrors::Expected => inverse(&(jacobian.transpose() * expected(state, m, s) * &jacobian)),
            StdErrors::Sandwich => {
                let bread = inverse(&tangent.information);
                &bread * (jacobian.transpose() * outer_scores(state, reductions, m, s) * &jacobian) * &bread
            }
        };
        // the sandwich is of the mean as well; the other two are generalised least squares for it
        let mean = gls.filter(|_| kind != StdErrors::Sandwich);
        Law { state, coordinates, mean, jacobian }
    }

    /// Inverse of the information along the tangent basis.
    pub(crate) fn coordinates(&self) -> &DMatrix<f64> {
        &self.coordinates
    }

    fn error(&self, law: &DMatrix<f64>, weights: &DVector<f64>) -> Option<f64> {
        // in η, where sizes have a meaning whatever the user's units
        let unit = Some(weights.amax()).filter(|unit| *unit > 0.0)?;
        let along = self.jacobian.transpose() * (weights / unit);
        let size = along.amax();
        let variance = along.dot(&(law * &along)) * unit * unit;
        (size > 1e-12 && variance.is_finite() && variance > 0.0).then(|| variance.sqrt())
    }

    fn sigma_part(&self, weights: &DVector<f64>) -> Option<f64> {
        self.error(&self.coordinates, weights)
    }

    fn mean_part(&self, weights: &DVector<f64>) -> Option<f64> {
        self.error(self.mean.as_ref().unwrap_or(&self.coordinates), weights)
    }

    fn weights(&self, entries: &[(usize, f64)]) -> DVector<f64> {
        let mut weights = DVector::zeros(self.jacobian.nrows());
        entries.iter().for_each(|&(k, w)| weights[k] += w);
        weights
    }

    fn scale(&self) -> &[f64] {
        &self.state.problem.classes.frame.scale
    }

    /// Place of σ_ij among the rows of the jacobian, with its unit.
    fn sigma(&self, i: usize, j: usize, weight: f64) -> (usize, f64) {
        let p = self.scale().len();
        let rows = p + self.state.problem.mean.regressors.len();
        (rows + self.state.problem.covariance.elements.index(i, j), weight * self.scale()[i] * self.scale()[j])
    }

    fn mean_error(&self, i: usize) -> Option<f64> {
        self.mean_part(&self.weights(&[(i, self.scale()[i])]))
    }

    fn coefficient_error(&self, c: usize) -> Option<f64> {
        let row = self.scale().len() + c;
        let weights = self.weights(&[(row, self.state.problem.mean.coefficient_scale[c].recip())]);
        self.mean_part(&weights)
    }

    fn sigma_error(&self, i: usize, j: usize) -> Option<f64> {
        self.sigma_part(&self.weights(&[self.sigma(i, j, 1.0)]))
    }

    /// Delta method for ρ = σ_ij / √(σ_ii σ_jj).
    fn correlation_error(&self, sigma: &DMatrix<f64>, i: usize, j: usize) -> Option<f64> {
        let (vi, vj) = (sigma[(i, i)], sigma[(j, j)]);
        if !(vi > 0.0 && vj > 0.0) {
            return None;
        }
        let unit = (vi * vj).sqrt();
        let rho = sigma[(i, j)] / unit;
        let entries =
            [self.sigma(i, j, 1.0 / unit), self.sigma(i, i, -0.5 * rho / vi), self.sigma(j, j, -0.5 * rho / vj)];
        self.sigma_part(&self.weights(&entries))
    }

    /// Relative standard error of a common factor on the Σ of a phase, read off its largest variance.
    fn scale_error(&self, sigma: &DMatrix<f64>, part: &Part) -> Option<f64> {
        let i = part.states.clone().max_by(|&a, &b| sigma[(a, a)].total_cmp(&sigma[(b, b)]))?;
        (sigma[(i, i)] > 0.0).then(|| self.sigma_error(i, i).map(|e| e / sigma[(i, i)])).flatten()
    }
}

/// Expected information of mean coordinates and elements of Σ: no cross terms.
fn expected(state: &State, m: usize, s: usize) -> DMatrix<f64> {
    let mut information = DMatrix::zeros(m + s, m + s);
    information.view_mut((0, 0), (m, m)).copy_from(&state.sums.mean_information);
    information.view_mut((m, m), (s, s)).copy_from(&state.sums.expected_information());
    information
}

/// Σ_j s_j s_j' over the tests, in mean coordinates and elements of Σ.
fn outer_scores(state: &State, reductions: &[Reduction], m: usize, s: usize) -> DMatrix<f64> {
    let (problem, point) = (&state.problem, &state.place.point);
    let mut sum = DMatrix::zeros(m + s, m + s);
    let mut order: Vec<&Reduction> = reductions.iter().collect();
    order.sort_by(|a, b| a.test.cmp(&b.test)); // the same bits whatever the order of the tests
    for reduction in order {
        let own = problem.of_class(&problem.classes.single(reduction), point, Order::First);
        let mut score = DVector::zeros(m + s);
        score.rows_mut(0, m).copy_from(&own.mean_score);
        score.rows_mut(m, s).copy_from(&problem.covariance.elements.pack_score(&own.score()));
        sum.ger(1.0, &score, &score, 1.0);
    }
    sum
}

/// Inverse after scaling to unit diagonal; flat and negative directions count as no information and are left out.
fn inverse(information: &DMatrix<f64>) -> DMatrix<f64> {
    let n = information.nrows();
    let unit = |i: usize| if information[(i, i)] > 0.0 { information[(i, i)].sqrt().recip() } else { 0.0 };
    let scale = DVector::from_fn(n, |i, _| unit(i));
    let scaled = DMatrix::from_fn(n, n, |i, j| scale[i] * information[(i, j)] * scale[j]);
    let (values, vectors) = symmetric::eigen(&scaled);
    let inverse = values.iter().map(|&v| if v > FLAT { v.recip() } else { 0.0 });
    let inverse = &vectors * DMatrix::from_diagonal(&DVector::from_iterator(n, inverse)) * vectors.transpose();
    DMatrix::from_fn(n, n, |i, j| scale[i] * inverse[(i, j)] * scale[j])
}
