//! Affine PX-EM (parameter-expanded EM): the start of the Newton solver.
//!
//! Write ξ = μ + B u with u ~ N(δ, S). At B = I, δ = 0, S = Σ this is the model; one EM step that also maximises over B
//! (within blocks) removes most of the slowness of plain EM, at the cost of one linear system. Then μ ← μ + Bδ, Σ ← BSB'.

use nalgebra::{DMatrix, DVector};

use crate::estimate::covariance::Form;
use crate::estimate::pass::{Point, Terms};
use crate::estimate::problem::{Problem, scaled_solve};

/// Expected second moments that the complete-data least squares needs.
struct Moments {
    /// Σ J_ab E[u_c u_d], at (a p + b, c p + d).
    second: DMatrix<f64>,
    /// Σ J_ab E[u_c], at (a p + b, c).
    first: DMatrix<f64>,
    /// Σ J.
    information: DMatrix<f64>,
    /// Σ (y - J offset) û'.
    cross: DMatrix<f64>,
    /// Σ (y - J offset).
    right: DVector<f64>,
    /// Σ û.
    sum: DVector<f64>,
    /// Σ E[u u'].
    spread: DMatrix<f64>,
}

/// One step from `point`, one pass over the classes; `None` where the structure leaves no B free.
pub(crate) fn step(problem: &Problem, point: &Point) -> Option<Point> {
    let Form::Factor(blocks) = &problem.covariance.form else { return None };
    if !problem.covariance.constraints.is_empty() || !problem.mean.regressors.is_empty() || blocks.is_empty() {
        return None;
    }
    let p = point.mean.len();
    let free: Vec<(usize, usize)> =
        blocks.iter().flat_map(|b| b.iter().flat_map(move |&i| b.iter().map(move |&l| (i, l)))).collect();
    problem.count_pass();
    let moments = moments(problem, point);
    let (mean, b) = expanded(problem, &moments, &free, p);
    let n = problem.classes.tests as f64;
    let delta = if problem.mean.basis.ncols() == p { &moments.sum / n } else { DVector::zeros(p) };
    let spread = problem.covariance.mask(&(&moments.spread / n - &delta * delta.transpose()));
    let sigma = &b * spread * b.transpose();
    let root = problem.covariance.root_of(&sigma);
    Some(Point { mean: (mean + &b * delta).as_slice().to_vec(), coefficients: point.coefficients.clone(), root })
}

fn moments(problem: &Problem, point: &Point) -> Moments {
    let p = point.mean.len();
    let sigma = point.covariance();
    let mut m = Moments {
        second: DMatrix::zeros(p * p, p * p),
        first: DMatrix::zeros(p * p, p),
        information: DMatrix::zeros(p, p),
        cross: DMatrix::zeros(p, p),
        right: DVector::zeros(p),
        sum: DVector::zeros(p),
        spread: DMatrix::zeros(p, p),
    };
    let mut terms = Terms::new(p);
    for class in &problem.classes.classes {
        let n = class.count;
        terms.evaluate(class, &problem.mean.regressors, point);
        let factor = DMatrix::from_row_slice(p, p, &class.factor);
        let information = factor.transpose() * &factor;
        let u = &sigma * DVector::from_column_slice(&terms.r);
        let weight = DMatrix::from_row_slice(p, p, &terms.W);
        let outer = DMatrix::from_row_slice(p, p, &terms.outer);
        let spread = (&sigma - &sigma * weight * &sigma) * n + &sigma * outer * &sigma;
        let residual = DVector::from_column_slice(&class.mean) - &factor * &problem.mean.offset;
        let right = factor.transpose() * residual;
        m.cross += &right * u.transpose() * n + terms.scattered_cross(class) * &sigma;
        m.right += right * n;
        for a in 0..p {
            for b in 0..p {
                let j = information[(a, b)];
                for c in 0..p {
                    m.first[(a * p + b, c)] += n * j * u[c];
                    for d in 0..p {
                        m.second[(a * p + b, c * p + d)] += j * spread[(c, d)];
                    }
                }
            }
        }
        m.information += information * n;
        m.sum += u * n;
        m.spread += spread;
    }
    m
}

/// Complete-data least squares for the free mean coordinates and the free entries of B; gives (μ, B).
fn expanded(problem: &Problem, m: &Moments, free: &[(usize, usize)], p: usize) -> (DVector<f64>, DMatrix<f64>) {
    let basis = &problem.mean.basis;
    let q = basis.ncols();
    let size = q + free.len();
    let mut normal = DMatrix::zeros(size, size);
    let mut right = DVector::zeros(size);
    normal.view_mut((0, 0), (q, q)).copy_from(&(basis.transpose() * &m.information * basis));
    right.rows_mut(0, q).copy_from(&(basis.transpose() * &m.right));
    for (k, &(i, l)) in free.iter().enumerate() {
        let column = DVector::from_fn(p, |a, _| m.first[(a * p + i, l)]);
        let mixed = basis.transpose() * column;
        for c in 0..q {
            normal[(c, q + k)] = mixed[c];
            normal[(q + k, c)] = mixed[c];
        }
        for (t, &(a, b)) in free.iter().enumerate() {
            normal[(q + k, q + t)] = m.second[(i * p + a, l * p + b)];
        }
        right[q + k] = m.cross[(i, l)];
    }
    let solution = scaled_solve(&normal, &right);
    let mut b = DMatrix::identity(p, p);
    for (k, &(i, l)) in free.iter().enumerate() {
        b[(i, l)] = solution[q + k];
    }
    (&problem.mean.offset + basis * solution.rows(0, q), b)
}
