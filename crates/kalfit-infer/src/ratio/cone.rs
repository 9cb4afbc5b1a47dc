//! The tangent cone of a model at a hypothesis, and the law of the likelihood ratio that follows from this cone
//! (Chernoff; Self and Liang).
//!
//! Near a Σ₀ of the hypothesis the model's Σ₀ + D must be positive semidefinite: N'DN ⪰ 0 for the null space N of each
//! block of Σ that is singular under the hypothesis. Where each N is a line, these conditions are m half-spaces, and
//! -2 log λ is χ² with d - m degrees of freedom plus the squared length of the projection of a normal vector onto an
//! orthant: a mixture of χ² whose weights follow from the correlations of the m estimates.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::information::null_space;
use crate::ratio::law::{Component, ReferenceLaw};
use crate::ratio::nested::regressions;
use kalfit_algebra::elements::Elements;
use kalfit_algebra::symmetric;
use kalfit_estimate::Order;
use kalfit_estimate::{CoordinateForm, CovarianceMap, Estimate, PhaseForm, Point, Problem, generic_root};
use kalfit_model::Population;

/// Eigenvalues of an information or of a block of Σ, scaled to unit diagonal, below this threshold count as zero.
const ZERO_EIGENVALUE: f64 = 1e-10;
/// Number of draws for the weights of four and more half-spaces.
const DRAWS: usize = 200_000;
/// Largest number of half-spaces for which weights are computed; for more, the law is a bound.
const MAX_HALF_SPACES: usize = 20;

/// Degrees of freedom and law that follow from the tangent cone.
pub(super) struct TangentCone {
    pub(super) degrees_of_freedom: usize,
    pub(super) law: ReferenceLaw,
    pub(super) null_on_boundary: bool,
}

/// The law of the likelihood ratio; `equal`: hypothesis and model have the same likelihood.
pub(super) fn tangent(null: &Estimate, alternative: &Estimate, equal: bool) -> TangentCone {
    let (inner, outer) = (&*null.state.problem, &*alternative.state.problem);
    let regression_indices =
        regressions(&null.state.structure(), &alternative.state.structure()).expect("nesting was checked");
    let information = information(null, outer, &regression_indices);
    let wide = directions(outer, outer.mean.jacobian(), &null.state.newton_iterate.point.root);
    let uncentred = inner.mean.centring.uncentred(&inner.mean.jacobian());
    let mean = narrow_mean(&uncentred, outer.mean.jacobian().nrows(), &regression_indices);
    let mean = outer.mean.centring.centred(&mean);
    let narrow = directions(inner, mean, &null.state.newton_iterate.point.root);
    let rank = |basis: &DMatrix<f64>| rank(&(basis.transpose() * &information * basis));
    let degrees_of_freedom = rank(&wide).saturating_sub(rank(&narrow));
    let boundary_cone = boundary_cone(&null.state.newton_iterate.point.root, inner, outer);
    let null_on_boundary = !null_is_generic(null, inner);
    if degrees_of_freedom == 0 && !equal {
        // the hypothesis removes quantities of which the data identify only a sum with other quantities, and so bounds
        // the sum: a sum of two variances is at least the variance that remains
        let removed = wide.ncols().saturating_sub(narrow.ncols()).max(1);
        let law = ReferenceLaw { is_bound: true, ..ReferenceLaw::chi_squared(removed) };
        return TangentCone { degrees_of_freedom: removed, law, null_on_boundary };
    }
    let law = match boundary_cone {
        BoundaryCone::None => ReferenceLaw::chi_squared(degrees_of_freedom),
        BoundaryCone::Unknown => upper_bound_law(degrees_of_freedom),
        BoundaryCone::Lines(lines) => {
            let covariance = covariance_of(&lines, &wide, &information, outer.mean.jacobian().nrows());
            mixture_law(&covariance, degrees_of_freedom)
        }
    };
    TangentCone { degrees_of_freedom, law, null_on_boundary }
}

/// Expected information on mean coordinates and elements of Σ of the model, at the estimate of the hypothesis.
fn information(null: &Estimate, outer: &Problem, regression_indices: &[usize]) -> DMatrix<f64> {
    let mut coefficients = vec![0.0; outer.mean.regressors.len()];
    regression_indices.iter().zip(&null.coefficients).for_each(|(&at, value)| coefficients[at] = *value);
    let values = Population { mean: null.mean.clone(), coefficients, covariance: null.covariance.clone() };
    let point = Point { root: null.state.newton_iterate.point.root.clone(), ..outer.point_of(&values) };
    outer.likelihood(&point, Order::Expected).all_expected_information()
}

/// d(mean coordinates of the model) / d(free mean coordinates of the hypothesis).
fn narrow_mean(jacobian: &DMatrix<f64>, rows: usize, regression_indices: &[usize]) -> DMatrix<f64> {
    let p = jacobian.nrows() - regression_indices.len();
    let mut mean = DMatrix::zeros(rows, jacobian.ncols());
    for row in 0..jacobian.nrows() {
        let at = if row < p { row } else { p + regression_indices[row - p] };
        mean.set_row(at, &jacobian.row(row));
    }
    mean
}

/// Directions in which the free quantities move mean coordinates of the model and elements of Σ, as columns.
fn directions(problem: &Problem, mean: DMatrix<f64>, root: &DMatrix<f64>) -> DMatrix<f64> {
    let map = &problem.covariance;
    let sigma = map.cone_directions(&map.chart(root)).dense();
    let mut all = DMatrix::zeros(mean.nrows() + sigma.nrows(), mean.ncols() + sigma.ncols());
    all.view_mut((0, 0), mean.shape()).copy_from(&mean);
    all.view_mut(mean.shape(), sigma.shape()).copy_from(&sigma);
    all
}

/// Number of identified directions: rank of the information, scaled to unit diagonal.
fn rank(information: &DMatrix<f64>) -> usize {
    let size = symmetric::sizes(information);
    let n = information.nrows();
    let largest = information.diagonal().amax();
    let known = |i: usize| information[(i, i)] > 1e-14 * largest;
    let scaled =
        DMatrix::from_fn(n, n, |i, j| if known(i) && known(j) { information[(i, j)] / size[i] / size[j] } else { 0.0 });
    symmetric::eigen(&scaled).0.iter().filter(|v| **v > ZERO_EIGENVALUE).count()
}

/// Position of the hypothesis' Σ in the set of Σ that the model allows.
enum BoundaryCone {
    /// Σ is not on the boundary.
    None,
    /// D is in half-spaces: w'D ≥ 0 for each vector w of weights of the elements of Σ.
    Lines(Vec<DVector<f64>>),
    /// Σ is on the boundary with a null space of more than one dimension within a block, or in a curved structure.
    Unknown,
}

fn boundary_cone(null_root: &DMatrix<f64>, inner: &Problem, outer: &Problem) -> BoundaryCone {
    let (narrow, wide) = (generic_root(inner), generic_root(outer));
    let elements = &outer.covariance.elements;
    let mut lines = Vec::new();
    for part in &outer.covariance.parts {
        match &part.form {
            CoordinateForm::Factor(blocks) => {
                for block in blocks {
                    let null = null_space_at(null_root, &narrow, block);
                    let own = null_space(&wide, block, ZERO_EIGENVALUE).ncols();
                    match null.ncols() {
                        n if n == own => {}
                        1 => lines.push(line(&null.column(0).into_owned(), block, elements)),
                        _ => return BoundaryCone::Unknown,
                    }
                }
            }
            CoordinateForm::Scale(sigma_star) if part.of(&narrow).amax() == 0.0 => {
                lines.push(along_scale(part, sigma_star, elements))
            }
            CoordinateForm::StdDevs(_, states) if states.iter().any(|&i| narrow.row(i).norm() == 0.0) => {
                return BoundaryCone::Unknown;
            }
            _ => {}
        }
    }
    if lines.is_empty() { BoundaryCone::None } else { BoundaryCone::Lines(lines) }
}

/// Weights of the elements of D that give β where D = βΣ*.
fn along_scale(part: &PhaseForm, sigma_star: &DMatrix<f64>, elements: &Elements) -> DVector<f64> {
    let sigma_star = part.placed(&(sigma_star * sigma_star.transpose()), elements.states());
    let size = sigma_star.norm_squared();
    let weight = |(i, j): (usize, usize)| sigma_star[(i, j)] / size * if i == j { 1.0 } else { 2.0 };
    DVector::from_iterator(elements.count(), elements.all().map(weight))
}

/// Null space that a hypothesis gives a block at its estimate. The null space of the estimate (which varies, as with
/// DRD and a singular R) if its dimension is that of a generic member of the hypothesis; otherwise the null space of
/// the generic member.
fn null_space_at(null_root: &DMatrix<f64>, generic: &DMatrix<f64>, block: &[usize]) -> DMatrix<f64> {
    let (own, of_any) = (null_space(null_root, block, ZERO_EIGENVALUE), null_space(generic, block, ZERO_EIGENVALUE));
    if own.ncols() == of_any.ncols() { own } else { of_any }
}

/// Weights of the elements of D that give n'Dn.
fn line(n: &DVector<f64>, block: &[usize], elements: &Elements) -> DVector<f64> {
    let mut weights = DVector::zeros(elements.count());
    for a in 0..block.len() {
        for b in 0..=a {
            weights[elements.index(block[a], block[b])] = n[a] * n[b] * if a == b { 1.0 } else { 2.0 };
        }
    }
    weights
}

/// Whether the estimated Σ of the hypothesis has the rank of a generic member of the hypothesis.
fn null_is_generic(null: &Estimate, inner: &Problem) -> bool {
    let map: &CovarianceMap = &inner.covariance;
    let generic = generic_root(inner);
    let rank = |root: &DMatrix<f64>| map.random.len() - null_space(root, &map.random, ZERO_EIGENVALUE).ncols();
    rank(&null.state.newton_iterate.point.root) >= rank(&generic)
}

/// Covariance of the estimates of w'D for each line w, with all other free quantities estimated too.
fn covariance_of(lines: &[DVector<f64>], wide: &DMatrix<f64>, information: &DMatrix<f64>, m: usize) -> DMatrix<f64> {
    let free = wide.transpose() * information * wide;
    let inverse = symmetric::scaled_inverse(&free);
    let rows = DMatrix::from_fn(lines.len(), wide.nrows(), |k, c| if c < m { 0.0 } else { lines[k][c - m] });
    let along = rows * wide;
    &along * inverse * along.transpose()
}

/// The law of the likelihood ratio for half-spaces; `covariance`: of the estimates of w'D.
fn mixture_law(covariance: &DMatrix<f64>, degrees_of_freedom: usize) -> ReferenceLaw {
    // a half-space without information does not affect the statistic
    let known: Vec<usize> = (0..covariance.nrows()).filter(|&k| covariance[(k, k)] > 0.0).collect();
    let m = known.len().min(degrees_of_freedom);
    if m == 0 {
        return ReferenceLaw::chi_squared(degrees_of_freedom);
    }
    if m > MAX_HALF_SPACES || m < known.len() {
        return upper_bound_law(degrees_of_freedom);
    }
    let correlation = DMatrix::from_fn(m, m, |a, b| {
        let (a, b) = (known[a], known[b]);
        covariance[(a, b)] / (covariance[(a, a)] * covariance[(b, b)]).sqrt()
    });
    let component = |(i, weight): (usize, f64)| Component { degrees_of_freedom: degrees_of_freedom - m + i, weight };
    let independent = (0..=m).map(|i| binomial(m, i) * 0.5_f64.powi(m as i32));
    ReferenceLaw {
        components: orthant_weights(&correlation).into_iter().enumerate().map(component).collect(),
        independent: independent.enumerate().map(component).collect(),
        is_bound: false,
    }
}

/// ½χ²_{d-1} + ½χ²_d: no cone other than the whole space gives a larger tail (Perlman).
fn upper_bound_law(degrees_of_freedom: usize) -> ReferenceLaw {
    let half = |d: usize| Component { degrees_of_freedom: d, weight: 0.5 };
    let components = vec![half(degrees_of_freedom.saturating_sub(1)), half(degrees_of_freedom)];
    ReferenceLaw { independent: components.clone(), components, is_bound: true }
}

fn binomial(n: usize, k: usize) -> f64 {
    (0..k).fold(1.0, |product, i| product * (n - i) as f64 / (i + 1) as f64)
}

/// Probabilities that the projection of N(0, R) onto the positive orthant, in the metric R⁻¹, has 0, 1, …, m positive
/// entries.
fn orthant_weights(r: &DMatrix<f64>) -> Vec<f64> {
    use std::f64::consts::PI;
    let arc = |x: f64| x.clamp(-1.0, 1.0).acos();
    match r.nrows() {
        1 => vec![0.5, 0.5],
        2 => {
            let both = 0.25 + (0.5 * PI - arc(r[(0, 1)])) / (2.0 * PI);
            vec![0.5 - both, 0.5, both]
        }
        3 => {
            let angle = |a: usize, b: usize| arc(r[(a, b)]);
            let all = (2.0 * PI - angle(0, 1) - angle(0, 2) - angle(1, 2)) / (4.0 * PI);
            let partial = |a: usize, b: usize, c: usize| {
                let left = (1.0 - r[(a, c)].powi(2)) * (1.0 - r[(b, c)].powi(2));
                arc((r[(a, b)] - r[(a, c)] * r[(b, c)]) / left.sqrt())
            };
            let two = (3.0 * PI - partial(0, 1, 2) - partial(0, 2, 1) - partial(1, 2, 0)) / (4.0 * PI);
            vec![0.5 - two, 0.5 - all, two, all]
        }
        _ => drawn_weights(r),
    }
}

/// The weights of [`orthant_weights`], estimated from draws with a fixed seed.
fn drawn_weights(r: &DMatrix<f64>) -> Vec<f64> {
    let m = r.nrows();
    let mut random = ChaCha8Rng::seed_from_u64(0);
    let root = symmetric::square_root(r);
    let metric = symmetric::pseudo_inverse(r);
    let mut counts = vec![0_usize; m + 1];
    for _ in 0..DRAWS {
        let z = DVector::from_fn(m, |_, _| StandardNormal.sample(&mut random));
        counts[positive_entries(&metric, &(&root * z))] += 1;
    }
    counts.iter().map(|&n| n as f64 / DRAWS as f64).collect()
}

/// Number of positive entries of the minimiser of (x - u)'M(x - u) over x ≥ 0, by coordinate descent.
fn positive_entries(metric: &DMatrix<f64>, u: &DVector<f64>) -> usize {
    let mut x = u.map(|v| v.max(0.0));
    for _ in 0..200 {
        let mut largest_change = 0.0_f64;
        for i in 0..x.len() {
            let gradient: f64 = (0..x.len()).map(|k| metric[(i, k)] * (x[k] - u[k])).sum();
            let next = (x[i] - gradient / metric[(i, i)]).max(0.0);
            largest_change = largest_change.max((next - x[i]).abs());
            x[i] = next;
        }
        if largest_change < 1e-9 {
            break;
        }
    }
    x.iter().filter(|v| **v > 1e-7).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn equal(m: usize, rho: f64) -> DMatrix<f64> {
        DMatrix::from_fn(m, m, |i, j| if i == j { 1.0 } else { rho })
    }

    #[test]
    fn weights_of_independent_estimates_are_binomial() {
        for (m, expected) in [(2, vec![0.25, 0.5, 0.25]), (3, vec![0.125, 0.375, 0.375, 0.125])] {
            let found = orthant_weights(&equal(m, 0.0));
            for (f, e) in found.iter().zip(&expected) {
                assert!((f - e).abs() < 1e-12, "{found:?} {expected:?}");
            }
        }
    }

    #[test]
    fn weights_by_formula_are_those_by_drawing() {
        for (m, rho) in [(2, 0.6), (2, -0.4), (3, 0.5), (3, -0.3)] {
            let sum = drawn_weights(&equal(m, rho)).iter().sum::<f64>();
            assert!((sum - 1.0).abs() < 1e-12, "every draw counts once: {sum}");
            let (formula, drawn) = (orthant_weights(&equal(m, rho)), drawn_weights(&equal(m, rho)));
            assert!((formula.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{formula:?}");
            for (f, d) in formula.iter().zip(&drawn) {
                assert!((f - d).abs() < 5e-3, "m = {m}, ρ = {rho}: {formula:?} {drawn:?}");
            }
        }
        let drawn = drawn_weights(&equal(4, 0.0));
        for (i, d) in drawn.iter().enumerate() {
            assert!((binomial(4, i) / 16.0 - d).abs() < 5e-3, "{drawn:?}");
        }
    }

    /// Estimates of three variances with three different correlations, so that a swap of two would show.
    #[test]
    fn weights_of_unequal_correlations_are_those_by_drawing() {
        let r = DMatrix::from_row_slice(3, 3, &[1.0, 0.7, -0.2, 0.7, 1.0, 0.3, -0.2, 0.3, 1.0]);
        for order in [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1]] {
            let own = DMatrix::from_fn(3, 3, |i, j| r[(order[i], order[j])]);
            let (formula, drawn) = (orthant_weights(&own), drawn_weights(&own));
            for (f, d) in formula.iter().zip(&drawn) {
                assert!((f - d).abs() < 5e-3, "{order:?}: {formula:?} {drawn:?}");
            }
        }
    }

    /// β where D = βΣ*; for any other D the β of the nearest βΣ*, tr(DΣ*)/tr(Σ*Σ*).
    #[test]
    fn a_common_factor_is_read_off_a_direction() {
        let sigma_star = DMatrix::from_row_slice(2, 2, &[1.0, 0.5, 0.5, 2.0]);
        let root = symmetric::square_root(&sigma_star);
        let part = PhaseForm { states: 1..3, form: CoordinateForm::Scale(root.clone()), linear: false, start: None };
        let elements = Elements::single(3);
        let weights = along_scale(&part, &root, &elements);
        for (d, expected) in [
            ([3.0, 1.5, 6.0], 3.0),
            ([0.0, 1.0, 0.0], 2.0 * 0.5 / 5.5),
            ([1.0, 0.0, 0.0], 1.0 / 5.5),
            ([0.0, 0.0, 1.0], 2.0 / 5.5),
        ] {
            let at = |i: usize, j: usize| if i == 0 || j == 0 { 9.0 } else { d[i + j - 2] };
            let direction = DVector::from_iterator(elements.count(), elements.all().map(|(i, j)| at(i, j)));
            let found = weights.dot(&direction);
            assert!((found - expected).abs() < 1e-12, "{d:?}: {found} {expected}");
        }
    }
}
