//! The optimality certificate (theory §3): what "converged" means, inside the cone of positive semidefinite Σ and on
//! the boundary.
//!
//! With Λ the Lagrange multipliers of the constraints on Σ, the conditions are ∂ℓ/∂μ = 0 along the free mean, (G - Λ)Σ
//! = 0, and -(G - Λ) ⪰ 0 on the null space of Σ. Each figure of the certificate is a distance to the optimum in
//! standard errors.

use nalgebra::{DMatrix, DMatrixView, DVector};

use crate::covariance::{Constraint, CoordinateForm, CovarianceMap, PhaseForm, place as place_block, submatrix};
use crate::curvature::Curvature;
use crate::local::natural_sizes;
use crate::newton::NewtonIterate;
use crate::relaxed::{minimise_largest_eigenvalue, undetermined_multipliers};
use kalfit_algebra::symmetric;

/// Rounding errors above this many standard errors are reported.
const REPORTED_ROUNDING: f64 = 1e-6;
/// Rounding errors above this many standard errors withhold the certificate.
const MAX_ROUNDING: f64 = 1e-3;

/// Null-space scores below this many standard errors count as zero.
const NULL_TOLERANCE: f64 = 1e-5;

/// Eigenvalues of Σ (in natural sizes) below this count as zero: so near the boundary, the score in L no longer
/// indicates a direction inward.
const NULL_EIGENVALUE: f64 = 1e-10;

/// Standard deviations (in η) below this count as zero.
const ZERO_STD_DEV: f64 = 1e-9;

/// Where two standard deviations leave zero together, the smaller is at least this fraction of the larger, in natural
/// units.
const MIN_STD_DEV_RATIO: f64 = 1e-3;

/// Deviations from the conditions of a maximum, in standard errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Certificate {
    /// Newton decrement over the free mean coordinates, with Σ held fixed.
    pub mean: f64,
    /// Newton decrement over the free coordinates of Σ, with the mean held fixed: zero where (G - Λ)Σ = 0.
    pub covariance: f64,
    /// Largest score G - Λ along a direction in the null space of Σ, zero if no score is positive: ℓ rises if Σ grows
    /// in a direction of positive score.
    pub null_space: f64,
    /// Newton decrement over all coordinates together.
    pub decrement: f64,
    /// A bound on the effect of rounding errors on the estimates: where large numbers are added up, computed scores
    /// vanish before the optimum is reached.
    pub rounding: f64,
}

impl Certificate {
    /// Whether the conditions hold to this tolerance, and rounding errors are below a thousandth of a standard error.
    pub fn holds(&self, tolerance: f64) -> bool {
        self.decrement <= tolerance && self.null_space <= NULL_TOLERANCE && self.is_precise()
    }

    /// Whether rounding errors are below a thousandth of a standard error.
    pub fn is_precise(&self) -> bool {
        self.rounding <= MAX_ROUNDING
    }

    /// Whether rounding errors exceed 10⁻⁶ standard errors: such errors limit how well the optimum is known.
    pub fn is_limited_by_rounding(&self) -> bool {
        self.rounding > REPORTED_ROUNDING
    }

    /// A bound on the distance to the optimum, in standard errors.
    pub fn distance(&self) -> f64 {
        self.decrement.max(self.rounding)
    }

    pub(super) fn with_rounding(self, parts: &[f64]) -> Certificate {
        let rounding = parts.iter().sum::<f64>();
        Certificate { rounding: if rounding.is_finite() { rounding } else { f64::MAX }, ..self }
    }
}

/// A direction dΣ off the boundary of the cone, and the length of a Newton step along dΣ.
#[derive(Debug, Clone)]
pub(crate) struct Escape {
    /// dΣ, a positive semidefinite matrix of rank one or Σ* itself.
    pub(crate) direction: DMatrix<f64>,
    pub(crate) length: f64,
    /// Score along `direction`, in standard errors.
    pub(crate) score: f64,
}

/// The certificate at an iterate and, if the certificate fails on the null space of Σ, a direction off the boundary.
pub(crate) fn certificate(map: &CovarianceMap, place: &NewtonIterate, tests: f64) -> (Certificate, Option<Escape>) {
    let escape = escape(map, place, tests);
    let (mean, covariance) = scores(place);
    let null_space = escape.as_ref().map_or(0.0, |e| e.score.max(0.0));
    (
        Certificate { mean, covariance, null_space, decrement: place.decrement(), rounding: 0.0 },
        escape.filter(|e| e.score > NULL_TOLERANCE),
    )
}

/// (decrement over the mean coordinates at fixed Σ, decrement over the coordinates of Σ at a fixed mean).
fn scores(place: &NewtonIterate) -> (f64, f64) {
    let tangent = &place.tangent;
    let (q, n) = (tangent.mean, tangent.gradient.len());
    let part = |from: usize, size: usize| {
        let gradient = tangent.gradient.rows(from, size).clone_owned();
        decrement(tangent.information.view((from, from), (size, size)), &gradient)
    };
    (part(0, q), part(q, n - q))
}

fn decrement(information: DMatrixView<'_, f64>, gradient: &DVector<f64>) -> f64 {
    let size = |h: f64| if h.abs() > 0.0 { h.abs().sqrt().recip() } else { 0.0 };
    let scale = DVector::from_fn(gradient.len(), |i, _| size(information[(i, i)]));
    let gradient = gradient.component_mul(&scale);
    Curvature::scaled_by(scale, gradient, information).decrement()
}

/// The direction of largest score in the null space of Σ, within the structure.
fn escape(map: &CovarianceMap, place: &NewtonIterate, tests: f64) -> Option<Escape> {
    map.parts.iter().filter_map(|part| part_escape(map, part, place, tests)).max_by(|a, b| a.score.total_cmp(&b.score))
}

fn part_escape(map: &CovarianceMap, part: &PhaseForm, place: &NewtonIterate, tests: f64) -> Option<Escape> {
    let residual = &place.tangent.residual_score;
    let weight = &place.local.weight;
    match &part.form {
        CoordinateForm::Factor(blocks) => {
            let root = &place.point.root;
            let own = |c: &&Constraint| c.terms.iter().all(|(i, _, _)| part.states.contains(i));
            let constraints: Vec<Constraint> = map.constraints.iter().filter(own).cloned().collect();
            let multiplier_matrices = undetermined_multipliers(&constraints, root);
            if !multiplier_matrices.is_empty() {
                return null_escape(blocks, root, (residual, &multiplier_matrices), weight, tests); // constraints may tie blocks
            }
            let of_block =
                |block: &Vec<usize>| null_escape(std::slice::from_ref(block), root, (residual, &[]), weight, tests);
            blocks.iter().filter_map(of_block).max_by(|a, b| a.score.total_cmp(&b.score))
        }
        CoordinateForm::Scale(star) if part.of(&place.point.root).amax() <= 1e-9 * star.amax() => {
            let direction = part.placed(&(star * star.transpose()), map.p);
            let slope = (residual * &direction).trace();
            Some(along(direction, slope, weight, tests))
        }
        CoordinateForm::StdDevs(correlation, states) => {
            let r = part.placed(&(correlation * correlation.transpose()), map.p);
            std_dev_escape(&r, states, place, tests)
        }
        _ => None,
    }
}

/// The direction off the boundary for Σ = DRD, where D has zeros. To first order ℓ is flat in a standard deviation that
/// is zero, unless the state is correlated with a state of non-zero variance, which the gradient shows. To second order
/// ℓ rises by u'(G∘R)u when the zero standard deviations grow to u ≥ 0; single standard deviations and pairs are tried.
fn std_dev_escape(r: &DMatrix<f64>, states: &[usize], place: &NewtonIterate, tests: f64) -> Option<Escape> {
    let (residual, weight) = (&place.tangent.residual_score, &place.local.weight);
    let sigma = place.point.covariance();
    let is_zero = |i: usize| sigma[(i, i)].sqrt() <= ZERO_STD_DEV;
    let nonzero_partners = |i: usize| states.iter().filter(move |&&j| !is_zero(j)).map(move |&j| (i, j));
    let slope =
        |i: usize| nonzero_partners(i).map(|(i, j)| residual[(i, j)] * r[(i, j)] * sigma[(j, j)].sqrt()).sum::<f64>();
    let zero: Vec<usize> = states.iter().copied().filter(|&i| is_zero(i) && slope(i) >= 0.0).collect();
    let growth_escape = |parts: &[(usize, f64)]| {
        let mut u = DVector::zeros(r.nrows());
        parts.iter().for_each(|&(i, x)| u[i] = x);
        let direction = r.component_mul(&(&u * u.transpose()));
        let slope = (residual * &direction).trace();
        along(direction, slope, weight, tests)
    };
    let unit = |i: usize| if weight[(i, i)] > 0.0 { (tests / weight[(i, i)]).sqrt() } else { 0.0 };
    // √ of the loss of ℓ by one standard deviation: -a u² - b v² + 2cuv is largest relative to a u² + b v² at u : v =
    // √b : √a
    let loss = |i: usize| (-residual[(i, i)] * r[(i, i)]).max(0.0).sqrt() * unit(i);
    let pairs = zero.iter().enumerate().flat_map(|(k, &i)| zero[..k].iter().map(move |&j| (i, j)));
    let singles = zero.iter().map(|&i| growth_escape(&[(i, unit(i))]));
    let pair_escapes = pairs.map(|(i, j)| {
        let (a, b) = (loss(i), loss(j));
        let (u, v) = if a.max(b) > 0.0 { (b / a.max(b), a / a.max(b)) } else { (1.0, 1.0) };
        growth_escape(&[(i, u.max(MIN_STD_DEV_RATIO) * unit(i)), (j, v.max(MIN_STD_DEV_RATIO) * unit(j))])
    });
    singles.chain(pair_escapes).max_by(|a, b| a.score.total_cmp(&b.score))
}

/// The direction of largest score in the null space of the blocks of Σ, after undetermined multipliers have made that
/// score as small as possible.
fn null_escape(
    blocks: &[Vec<usize>],
    root: &DMatrix<f64>,
    (residual, multiplier_matrices): (&DMatrix<f64>, &[DMatrix<f64>]),
    weight: &DMatrix<f64>,
    tests: f64,
) -> Option<Escape> {
    let null = null_spaces(blocks, root);
    if null.iter().all(|basis| basis.ncols() == 0) {
        return None;
    }
    let on_null_space = |matrix: &DMatrix<f64>| {
        let parts = blocks.iter().zip(&null).map(|(block, basis)| basis.transpose() * submatrix(matrix, block) * basis);
        block_diagonal(&parts.collect::<Vec<_>>())
    };
    let multiplier_matrices: Vec<DMatrix<f64>> = multiplier_matrices.iter().map(on_null_space).collect();
    let (score, density) = minimise_largest_eigenvalue(&on_null_space(residual), &multiplier_matrices);
    let (scores, _) = symmetric::eigen(&score);
    let mut direction = DMatrix::zeros(root.nrows(), root.nrows());
    let mut from = 0;
    for (block, basis) in blocks.iter().zip(&null) {
        let n = basis.ncols();
        let own = basis * density.view((from, from), (n, n)) * basis.transpose();
        place_block(&mut direction, block, &own);
        from += n;
    }
    Some(along(direction, *scores.last()?, weight, tests))
}

/// For each block, a basis (columns) of a complement of the range of FF', orthogonal to the range in natural sizes, so
/// that a large standard deviation does not make a small one look negligible. Where GΣ = 0, any complement of the range
/// may replace the null space.
fn null_spaces(blocks: &[Vec<usize>], root: &DMatrix<f64>) -> Vec<DMatrix<f64>> {
    let sizes = natural_sizes(root);
    let of = |block: &Vec<usize>| {
        let size = |i: usize| sizes[block[i]];
        let own = DMatrix::from_fn(block.len(), root.ncols(), |i, c| root[(block[i], c)] / size(i));
        let (values, vectors) = symmetric::eigen(&(&own * own.transpose()));
        let floor = values.last().copied().unwrap_or(0.0).max(1.0) * NULL_EIGENVALUE;
        let null: Vec<usize> = (0..values.len()).filter(|&k| values[k] <= floor).collect();
        DMatrix::from_fn(block.len(), null.len(), |i, c| size(i) * vectors[(i, null[c])])
    };
    blocks.iter().map(of).collect()
}

fn block_diagonal(parts: &[DMatrix<f64>]) -> DMatrix<f64> {
    let n = parts.iter().map(DMatrix::nrows).sum();
    let mut whole = DMatrix::zeros(n, n);
    let mut from = 0;
    for part in parts {
        whole.view_mut((from, from), part.shape()).copy_from(part);
        from += part.nrows();
    }
    whole
}

/// The escape in direction D, with the expected information ½ N tr(W̄DW̄D), W̄ the mean of W_j over the N tests.
fn along(direction: DMatrix<f64>, slope: f64, weight: &DMatrix<f64>, tests: f64) -> Escape {
    let each = weight * &direction; // N W̄D
    let information = 0.5 * (&each * &each).trace() / tests;
    if information <= 0.0 {
        return Escape { direction, length: 0.0, score: 0.0 };
    }
    Escape { direction, length: slope / information, score: slope / information.sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(decrement: f64, null_space: f64, rounding: f64) -> Certificate {
        Certificate { mean: 0.0, covariance: 0.0, null_space, decrement, rounding }
    }

    #[test]
    fn each_condition_by_itself_withholds_it() {
        assert!(found(1e-8, 1e-5, 1e-3).holds(1e-8), "at the limits");
        assert!(found(0.0, 0.0, 0.0).holds(0.0), "nothing is left");
        for (what, figures) in [
            ("decrement", found(1.1e-8, 0.0, 0.0)),
            ("null space", found(0.0, 1.1e-5, 0.0)),
            ("rounding", found(0.0, 0.0, 1.1e-3)),
        ] {
            assert!(!figures.holds(1e-8), "{what}: {figures:?}");
        }
        for (rounding, precise, limited) in
            [(1e-3, true, true), (1.1e-3, false, true), (1.1e-6, true, true), (1e-6, true, false)]
        {
            let figures = found(0.0, 0.0, rounding);
            assert_eq!((figures.is_precise(), figures.is_limited_by_rounding()), (precise, limited), "{figures:?}");
        }
        assert_eq!(found(3.0, 9.0, 2.0).distance(), 3.0);
        assert_eq!(found(2.0, 9.0, 3.0).distance(), 3.0);
    }

    #[test]
    fn rounding_adds_up_and_is_finite() {
        assert_eq!(found(1.0, 2.0, 9.0).with_rounding(&[0.25, 0.5]), found(1.0, 2.0, 0.75));
        for part in [f64::NAN, f64::INFINITY] {
            let figures = found(0.0, 0.0, 0.0).with_rounding(&[0.5, part]);
            assert_eq!(figures.rounding, f64::MAX);
            assert!(!figures.holds(1.0), "{figures:?}");
        }
    }

    /// g'|H|⁻¹g, with H scaled to a unit diagonal before its eigenvalues are taken by absolute value.
    #[test]
    fn a_decrement_is_a_distance_in_standard_errors() {
        let cases = [
            // regular: g'H⁻¹g = 4/4 + 36/9
            ([4.0, 0.0, 9.0], [2.0, 6.0], 5.0),
            // regular: H⁻¹ = (2, -1; -1, 2)/3
            ([2.0, 1.0, 2.0], [1.0, 0.0], 2.0 / 3.0),
            // eigenvalues 3 and -1 along (1, ±1)/√2: ½/3 + ½
            ([1.0, 2.0, 1.0], [1.0, 0.0], 2.0 / 3.0),
            // the previous case in other units
            ([16.0, 8.0, 1.0], [4.0, 0.0], 2.0 / 3.0),
            // flat along (1, -1): the data do not inform that direction
            ([1.0, 1.0, 1.0], [3.0, 3.0], 9.0),
            ([1.0, 1.0, 1.0], [3.0, -3.0], 0.0),
            // no information at all on one coordinate
            ([4.0, 0.0, 0.0], [6.0, 5.0], 9.0),
            // a negative eigenvalue
            ([-4.0, 0.0, 9.0], [2.0, 6.0], 5.0),
        ];
        for ([a, b, c], g, expected) in cases {
            let information = DMatrix::from_row_slice(2, 2, &[a, b, b, c]);
            let found = decrement(information.as_view(), &DVector::from_column_slice(&g));
            assert!((found - f64::sqrt(expected)).abs() < 1e-12, "{information} {g:?}: {found}² {expected}");
        }
    }

    /// Null vectors are orthogonal to F with elements in their natural sizes, and their number is the dimension less
    /// the rank.
    #[test]
    fn a_null_space_is_what_the_range_leaves() {
        for (columns, expected) in [
            (vec![], 3),
            (vec![[1e4, 1.0, 0.0]], 2),
            (vec![[1e4, 1.0, 0.0], [0.0, 2.0, 1e-3]], 1),
            (vec![[1.0, 0.0, 0.0], [0.0, 1e-6, 0.0]], 2), // 1e-12 of its natural size
            (vec![[1.0, 0.0, 0.0], [0.0, 1e-4, 0.0]], 1), // 1e-8 of its natural size
            (vec![[1e6, 0.0, 0.0], [0.0, 1e6, 0.0], [0.0, 0.0, 1e6]], 0),
        ] {
            let root = DMatrix::from_fn(3, 3, |i, c| columns.get(c).map_or(0.0, |column: &[f64; 3]| column[i]));
            let null = null_spaces(&[vec![0, 1, 2]], &root).remove(0);
            assert_eq!(null.ncols(), expected, "{root}");
            let natural = |i: usize| 1.0 + root.row(i).norm_squared();
            let weighed = DMatrix::from_fn(3, null.ncols(), |i, k| null[(i, k)] / natural(i));
            let product = root.transpose() * &weighed;
            assert!(product.amax() < 2e-6, "{root} {null} {product}");
            let unit = null.transpose() * &weighed;
            assert!((&unit - DMatrix::identity(expected, expected)).amax() < 1e-9, "{root} {null} {unit}");
        }
        let root = DMatrix::from_row_slice(3, 1, &[0.0, 0.8, -0.6]);
        let null = null_spaces(&[vec![2, 1], vec![0]], &root);
        assert_eq!((null[0].ncols(), null[1].ncols()), (1, 1));
        let along = null[0][(1, 0)] * 0.8 / 1.64 - null[0][(0, 0)] * 0.6 / 1.36;
        assert!(along.abs() < 1e-12, "{} {}", null[0], null[1]);
    }

    #[test]
    fn the_step_along_a_direction_is_that_of_newton() {
        let direction = DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 2.0, 4.0]);
        let weight = DMatrix::from_row_slice(2, 2, &[8.0, 0.0, 0.0, 2.0]);
        // ½ N tr((W̄D)²) of four tests, W̄ = diag(2, ½): ½ 4 (2 + 2)²
        let (information, slope) = (32.0, 3.0);
        let found = along(direction.clone(), slope, &weight, 4.0);
        assert!((found.length - slope / information).abs() < 1e-14, "{} {}", found.length, slope / information);
        assert!(
            (found.score - slope / information.sqrt()).abs() < 1e-14,
            "{} {}",
            found.score,
            slope / information.sqrt()
        );
        let nothing = along(direction, slope, &DMatrix::zeros(2, 2), 4.0);
        assert_eq!((nothing.length, nothing.score), (0.0, 0.0), "no test informs the direction");
    }
}
