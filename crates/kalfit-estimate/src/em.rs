//! The paper's DL algorithm: EM on the reductions, (8)-(11), with the constrained M-steps of theory §4.
//!
//! E-step: the posterior of every test, x̂_j = μ + Σ r_j and V_j = Σ - Σ W_j Σ. M-step: μ ← mean x̂_j, then Σ ← mean
//! (V_j + (x̂_j - μ)(x̂_j - μ)') with the new μ, both under the constraints of the structure. ℓ cannot fall.

use nalgebra::{DMatrix, DVector};

use crate::Criterion;
use crate::covariance::{CoordinateForm, CovarianceMap, PhaseForm, place, submatrix};
use crate::exact::maximise_exact;
use crate::local::Objective;
use crate::order::Order;
use crate::point::Point;
use crate::problem::Problem;
use crate::sums::Sums;
use kalfit_algebra::symmetric;

/// Which conditional maximisation comes next, when μ and Σ cannot move together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ConditionalStep {
    Mean,
    Covariance,
}

/// The order of the pass that EM needs: first derivatives, and the information on the mean where the mean may need
/// least squares.
pub(crate) fn order(problem: &Problem) -> Order {
    let (p, mean) = (problem.classes.dimension(), &problem.mean);
    let closed = mean.basis.ncols() == p && mean.regressors.is_empty() && problem.covariance.random.len() == p;
    if closed && problem.criterion() == Criterion::Ml { Order::First } else { Order::Mean }
}

/// One EM step from the sums at a point. Where μ has no closed form together with Σ (a singular Σ with a constrained
/// mean, or a regression), μ and Σ alternate: generalised least squares for μ, EM for Σ (ECM). They also alternate
/// under the restricted likelihood, where the mean is missing data too, with a flat prior: the uncertainty of the mean
/// adds to the second moment.
pub(crate) fn step(problem: &Problem, point: &Point, sums: &Sums, next_step: &mut ConditionalStep) -> Point {
    let tests = counts(problem);
    let sigma = point.covariance();
    let mu = DVector::from_column_slice(&point.mean);
    let p = mu.len();
    let shift = (&sigma * sums.mean_score.rows(0, p)).component_div(&tests); // mean x̂_j - μ
    let together = (problem.mean.regressors.is_empty() && problem.criterion() == Criterion::Ml)
        .then(|| problem.mean.maximise(&(&mu + &shift), &sigma))
        .flatten();
    let random = problem.covariance.random.len() == p;
    let next_mean = match together {
        Some(next) if random => next,
        _ => {
            if *next_step == ConditionalStep::Mean {
                *next_step = ConditionalStep::Covariance;
                return problem.move_mean(point, problem.least_squares_step(sums).as_slice());
            }
            *next_step = ConditionalStep::Mean;
            mu.clone()
        }
    };
    let delta = &next_mean - &mu;
    let second = second_moment(&sigma, sums, &shift, &delta, &tests);
    let map = &problem.covariance;
    let of = |(part, tests): (&PhaseForm, &f64)| {
        maximise(&map.of_part(part), &part.of(&second), part.of(&point.root), tests.max(1.0))
    };
    let root = map.block_diagonal(map.parts.iter().zip(&problem.classes.present).map(of));
    Point { mean: next_mean.as_slice().to_vec(), coefficients: point.coefficients.clone(), root }
}

/// For each element of ξ, the number of tests that have the phase of that element: an M-step averages over that many
/// tests.
fn counts(problem: &Problem) -> DVector<f64> {
    let (classes, p) = (&problem.classes, problem.classes.dimension());
    DVector::from_fn(p, |i, _| classes.present[classes.elements.block_of(i)].max(1.0))
}

/// M̄ = mean (V_j + (x̂_j - μ)(x̂_j - μ)') with the new μ = old μ + δ, (9). As x̂_j = old μ + Σr_j and V_j = Σ - ΣW_jΣ,
/// M̄ = Σ - Σ (∑_j (W_j - r_j r_j')) Σ / n - sδ' - δs' + δδ', where ∑_j adds over tests and s = mean (x̂_j - old μ).
fn second_moment(
    sigma: &DMatrix<f64>,
    sums: &Sums,
    shift: &DVector<f64>,
    delta: &DVector<f64>,
    tests: &DVector<f64>,
) -> DMatrix<f64> {
    let variance_reduction = sigma * (&sums.weight - sums.moment()) * sigma;
    let posterior_variance = DMatrix::from_fn(variance_reduction.nrows(), variance_reduction.ncols(), |i, j| {
        sigma[(i, j)] - variance_reduction[(i, j)] / tests[i]
    });
    posterior_variance - shift * delta.transpose() - delta * shift.transpose() + delta * delta.transpose()
}

/// A root of the Σ that maximises -log|Σ| - tr(Σ⁻¹M̄) within the structure of one phase.
fn maximise(map: &CovarianceMap, second: &DMatrix<f64>, root: DMatrix<f64>, n: f64) -> DMatrix<f64> {
    match &map.parts[0].form {
        CoordinateForm::Fixed(_) => root,
        CoordinateForm::Factor(_) if map.constraints.is_empty() => map.root_of(&map.mask(second)),
        CoordinateForm::Factor(blocks) => match regression_form(map, blocks, second) {
            Some(sigma) => map.root_of(&sigma),
            None => maximise_exact(map, second, root, n),
        },
        CoordinateForm::Scale(star) => {
            let inverse = symmetric::pseudo_inverse(&(star * star.transpose()));
            let rank = (&inverse * star * star.transpose()).trace();
            star * ((inverse * second).trace() / rank).max(0.0).sqrt()
        }
        CoordinateForm::StdDevs(correlation, states) => correlation_step(correlation, states, second),
    }
}

/// Σ by (23), block by block; `None` unless every fixed element is in a row that is fixed as a whole. With such rows as
/// set 2, other rows as set 1 and B = Σ12 Σ22⁻¹, Σ11 = [I -B] M̄ [I -B]' + B Σ22 B'.
fn regression_form(map: &CovarianceMap, blocks: &[Vec<usize>], second: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let fixed = |i: usize, j: usize| {
        let found = map.constraints.iter().find(|c| c.terms.len() == 1 && same(c.terms[0], i, j));
        found.map(|c| c.value)
    };
    if map.constraints.iter().any(|c| c.terms.len() != 1) {
        return None;
    }
    let mut sigma = DMatrix::zeros(map.p, map.p);
    for block in blocks {
        let fixed_rows: Vec<usize> =
            block.iter().copied().filter(|&i| block.iter().all(|&j| fixed(i, j).is_some())).collect();
        let free: Vec<usize> = block.iter().copied().filter(|i| !fixed_rows.contains(i)).collect();
        if free.iter().any(|&i| free.iter().any(|&j| fixed(i, j).is_some())) {
            return None;
        }
        let entry = |i: usize, j: usize| fixed(i, j).expect("rows of the held set are fixed");
        let sigma22 = DMatrix::from_fn(fixed_rows.len(), fixed_rows.len(), |i, j| entry(fixed_rows[i], fixed_rows[j]));
        let sigma12 = DMatrix::from_fn(free.len(), fixed_rows.len(), |i, j| entry(free[i], fixed_rows[j]));
        let b = if fixed_rows.is_empty() {
            DMatrix::zeros(free.len(), 0)
        } else {
            &sigma12 * sigma22.clone().cholesky()?.inverse()
        };
        let own = submatrix(second, &free);
        let mixed = DMatrix::from_fn(free.len(), fixed_rows.len(), |i, j| second[(free[i], fixed_rows[j])]);
        let part = &mixed * b.transpose();
        let sigma11 = own - &part - part.transpose() + &b * (submatrix(second, &fixed_rows) + &sigma22) * b.transpose();
        place(&mut sigma, &free, &sigma11);
        place(&mut sigma, &fixed_rows, &sigma22);
        for (i, &f) in free.iter().enumerate() {
            for (j, &h) in fixed_rows.iter().enumerate() {
                sigma[(f, h)] = sigma12[(i, j)];
                sigma[(h, f)] = sigma12[(i, j)];
            }
        }
    }
    Some(sigma)
}

fn same(term: (usize, usize, f64), i: usize, j: usize) -> bool {
    (term.0, term.1) == (i, j) || (term.0, term.1) == (j, i)
}

/// A root of Σ = DRD with R given, (35): Newton's method minimises the strictly convex -2 Σ log u_i + u'(R⁻¹∘M̄)u over
/// u_i = 1/σ_i.
fn correlation_step(root: &DMatrix<f64>, states: &[usize], second: &DMatrix<f64>) -> DMatrix<f64> {
    let own = DMatrix::from_fn(states.len(), root.ncols(), |i, c| root[(states[i], c)]);
    let inverse = symmetric::pseudo_inverse(&(&own * own.transpose()));
    let a = inverse.component_mul(&submatrix(second, states));
    let n = states.len();
    let mut u = DVector::from_fn(n, |i, _| a[(i, i)].max(f64::MIN_POSITIVE).sqrt().recip());
    for _ in 0..100 {
        let gradient = &a * &u - u.map(f64::recip);
        let hessian = &a + DMatrix::from_diagonal(&u.map(|x| x.powi(-2)));
        let Some(factor) = hessian.cholesky() else { break };
        let step = factor.solve(&gradient);
        let decrement = gradient.dot(&step);
        // self-concordant: the damped step keeps u positive and always descends
        u -= step / (1.0 + decrement.max(0.0).sqrt());
        if decrement < 1e-28 {
            break;
        }
    }
    let mut sd = DVector::zeros(root.nrows());
    states.iter().enumerate().for_each(|(k, &i)| sd[i] = u[k].recip());
    DMatrix::from_fn(root.nrows(), root.ncols(), |i, c| sd[i] * root[(i, c)])
}
