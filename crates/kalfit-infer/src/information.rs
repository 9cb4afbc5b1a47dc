//! Standard errors at the optimum: from the observed information, the expected information, or the sandwich of both.

use nalgebra::DMatrix;

use crate::direction::{Direction, Quantity};
use crate::estimated::Estimated;
use crate::estimates::EstimateCovariance;
use crate::holdable::{Holdable, Quantities};
use crate::law::AsymptoticLaw;
use crate::std_errors::StdErrors;
use kalfit_algebra::elements::Elements;
use kalfit_algebra::symmetric;
use kalfit_estimate::{CoordinateForm, CovarianceMap, Estimate, FinalState, PhaseForm};
use kalfit_filter::reduce::Reductions;

/// A squared correlation of at least 1 minus this tolerance counts as 1.
const CORRELATION_ONE_TOLERANCE: f64 = 1e-6;
/// Eigenvalues of a correlation matrix up to this threshold count as zero.
const SINGULAR_EIGENVALUE: f64 = 1e-11;

/// Standard errors, in the user's units. `None` where a quantity is fixed, not identified, a variance of zero or a
/// correlation of one. Where Σ is singular, standard errors are for the estimation among matrices with the rank of Σ.
#[derive(Debug, Clone, PartialEq)]
pub struct Uncertainty {
    /// Standard error of each quantity.
    pub errors: Quantities<Option<f64>>,
    /// Relative standard error of β in Σ = βΣ*, for each phase.
    pub scale: Vec<Option<f64>>,
    /// Blocks of Σ that are singular.
    pub boundary: Vec<Boundary>,
}

/// A block of Σ on the boundary of the positive semidefinite cone.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Boundary {
    /// States of the block.
    pub states: Vec<usize>,
    /// Rank of the block.
    pub rank: usize,
    /// States of the block whose variance is zero.
    pub zero_variances: Vec<usize>,
}

/// Whether element k of μ or Σ takes part in an unidentified direction.
fn takes_part(unidentified: &[Direction], quantity: Quantity, k: usize) -> bool {
    unidentified.iter().any(|d| d.quantity == quantity && d.direction[k] != 0.0)
}

/// Whether an element of Σ takes part in an unidentified direction; elements between phases do not.
fn element_takes_part(unidentified: &[Direction], elements: &Elements, i: usize, j: usize) -> bool {
    elements.get(i, j).is_some_and(|k| takes_part(unidentified, Quantity::Covariance, k))
}

/// For each quantity of an estimate, whether it is neither fixed nor unidentified.
pub fn free(estimate: &Estimate, unidentified: &[Direction]) -> Quantities<bool> {
    let problem = &estimate.state.problem;
    let p = estimate.mean.len();
    let mean = |i: usize| problem.mean.basis.row(i).amax() > 0.0 && !takes_part(unidentified, Quantity::Mean, i);
    let directions = problem.covariance.free_directions(&estimate.state.newton_iterate.tangent.chart).row_sizes();
    let map = &problem.covariance;
    let moves = |i: usize, j: usize| {
        map.elements
            .get(i, j)
            .is_some_and(|k| directions[k] > 1e-12 && !takes_part(unidentified, Quantity::Covariance, k))
    };
    let moves_correlation = |i: usize, j: usize| {
        matches!(map.form_of(i), CoordinateForm::Factor(_))
            && i != j
            && (moves(i, j)
                || (estimate.covariance[(i, j)] != 0.0
                    && (moves(i, i) || moves(j, j))
                    && !element_takes_part(unidentified, &map.elements, i, j)))
    };
    let square_list = |of: &dyn Fn(usize, usize) -> bool| (0..p).map(|i| (0..p).map(|j| of(i, j)).collect()).collect();
    Quantities {
        mean: (0..p).map(mean).collect(),
        coefficients: vec![true; estimate.coefficients.len()],
        std_dev: (0..p).map(|i| moves(i, i)).collect(),
        covariance: square_list(&moves),
        correlation: square_list(&moves_correlation),
    }
}

/// Standard errors at an estimate; `reductions`: the reductions of the estimate, which only the sandwich uses.
pub fn uncertainty(
    estimate: &Estimate,
    reductions: &Reductions,
    unidentified: &[Direction],
    kind: StdErrors,
) -> Uncertainty {
    uncertainty_of(estimate, &estimate.state.evidence(reductions), unidentified, kind).0
}

/// Standard errors, and the covariance of all estimates, from the reductions whose likelihood was maximised.
pub(super) fn uncertainty_of(
    estimate: &Estimate,
    evidence: &Reductions,
    unidentified: &[Direction],
    kind: StdErrors,
) -> (Uncertainty, Option<EstimateCovariance>) {
    let law = AsymptoticLaw::of(&estimate.state, evidence, kind);
    let elements = &estimate.state.problem.covariance.elements;
    let p = estimate.mean.len();
    let is_open = |one: Estimated| match one {
        Estimated::Mean(i) => takes_part(unidentified, Quantity::Mean, i),
        Estimated::Coefficient(c) => takes_part(unidentified, Quantity::Mean, p + c),
        Estimated::Covariance(i, j) => element_takes_part(unidentified, elements, i, j),
        Estimated::Value(_) => false,
    };
    let uncertainty = uncertainty_by(&law, &estimate.covariance, unidentified, SingularBlock::Face);
    let zeros = uncertainty.boundary.iter().flat_map(|boundary| &boundary.zero_variances);
    let zeros: Vec<Estimated> = zeros.map(|&i| Estimated::Covariance(i, i)).collect();
    let estimates = law.estimates(&is_open).map(|mut estimates| {
        estimates.at_zero.extend(zeros);
        estimates
    });
    (uncertainty, estimates)
}

/// Standard errors from the information in a state of the estimator, at the end of a search or at any other point;
/// `sigma` is Σ of `state`, in the user's units.
pub fn uncertainty_at(state: &FinalState, sigma: &DMatrix<f64>, unidentified: &[Direction]) -> Uncertainty {
    uncertainty_by(&AsymptoticLaw::new(state), sigma, unidentified, SingularBlock::Nothing)
}

/// Which standard errors a singular block of Σ gets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum SingularBlock {
    /// Standard errors on the face of the cone that contains the estimate: among matrices with the rank of the block.
    Face,
    /// No standard errors: where Σ is assumed, not estimated, estimates of Σ will not be on the face.
    Nothing,
}

fn uncertainty_by(
    law: &AsymptoticLaw<'_>,
    sigma: &DMatrix<f64>,
    unidentified: &[Direction],
    singular: SingularBlock,
) -> Uncertainty {
    let state = law.state;
    let map = &state.problem.covariance;
    let boundary = boundary(map, &state.newton_iterate.point.root);
    let p = sigma.nrows();
    let on_boundary = |i: usize| boundary.iter().any(|b| b.states.contains(&i));
    let has_no_error = |i: usize| match singular {
        SingularBlock::Face => boundary.iter().any(|b| b.zero_variances.contains(&i)),
        SingularBlock::Nothing => on_boundary(i),
    };
    let elements = &map.elements;
    let known =
        |i: usize, j: usize| !(has_no_error(i) || has_no_error(j) || element_takes_part(unidentified, elements, i, j));
    // on the face a correlation of 1 does not move: a standard error of this correlation would be rounding
    let at_end = |i: usize, j: usize| {
        let size = sigma[(i, i)] * sigma[(j, j)];
        on_boundary(i) && on_boundary(j) && sigma[(i, j)].powi(2) >= (1.0 - CORRELATION_ONE_TOLERANCE) * size
    };
    let has_mean = |row: usize| !takes_part(unidentified, Quantity::Mean, row);
    let mut errors = Quantities::all(None, p, state.problem.mean.regressors.len());
    let set = |errors: &mut Quantities<Option<f64>>, what: Holdable, known: bool| {
        errors.set(what, known.then(|| law.error(sigma, what)).flatten());
    };
    for (i, j) in elements.all() {
        set(&mut errors, Holdable::Covariance(i, j), known(i, j));
    }
    for i in 0..p {
        let of_variance = errors.covariance[i][i].filter(|_| sigma[(i, i)] > 0.0);
        errors.std_dev[i] = of_variance.map(|e| e / (2.0 * sigma[(i, i)].sqrt()));
        set(&mut errors, Holdable::Mean(i), has_mean(i));
    }
    for (i, j) in elements.all().filter(|(i, j)| i != j) {
        let known = known(i, j) && known(i, i) && known(j, j) && !at_end(i, j);
        set(&mut errors, Holdable::Correlation(i, j), known);
    }
    for c in 0..errors.coefficients.len() {
        set(&mut errors, Holdable::Coefficient(c), has_mean(p + c));
    }
    let of_part = |part: &PhaseForm| {
        let is_scale = matches!(part.form, CoordinateForm::Scale(_));
        let is_open = |i: usize| element_takes_part(unidentified, elements, i, i);
        (is_scale && !part.states.clone().any(is_open)).then(|| law.scale_error(sigma, part)).flatten()
    };
    let scale = map.parts.iter().map(of_part).collect();
    Uncertainty { errors, scale, boundary }
}

/// Blocks of Σ that are singular.
fn boundary(map: &CovarianceMap, root: &DMatrix<f64>) -> Vec<Boundary> {
    let of_part = |part: &PhaseForm| -> Vec<Vec<usize>> {
        match &part.form {
            CoordinateForm::Factor(blocks) => blocks.clone(),
            CoordinateForm::StdDevs(_, states) => {
                states.iter().filter(|&&i| root.row(i).norm() == 0.0).map(|&i| vec![i]).collect()
            }
            CoordinateForm::Scale(_) if part.of(root).amax() == 0.0 => {
                vec![map.random.iter().copied().filter(|i| part.states.contains(i)).collect()]
            }
            _ => Vec::new(),
        }
    };
    let blocks: Vec<Vec<usize>> = map.parts.iter().flat_map(of_part).collect();
    let rank = |block: &[usize]| block.len() - null_space(root, block, SINGULAR_EIGENVALUE).ncols();
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

/// Null space of FF' on a block: eigenvectors with eigenvalues up to `floor`, in units of the standard deviations.
pub(super) fn null_space(root: &DMatrix<f64>, block: &[usize], floor: f64) -> DMatrix<f64> {
    let own = DMatrix::from_fn(block.len(), root.ncols(), |i, c| root[(block[i], c)]);
    let norms: Vec<f64> = own.row_iter().map(|r| r.norm()).collect();
    let unit = |i: usize| if norms[i] > 0.0 { norms[i] } else { 1.0 };
    let scaled = DMatrix::from_fn(own.nrows(), own.ncols(), |i, c| own[(i, c)] / unit(i));
    let (values, vectors) = symmetric::eigen(&(&scaled * scaled.transpose()));
    let null: Vec<usize> = (0..values.len()).filter(|&k| values[k] <= floor).collect();
    let vectors = vectors.select_columns(&null);
    DMatrix::from_fn(block.len(), null.len(), |i, c| vectors[(i, c)] / unit(i))
}
