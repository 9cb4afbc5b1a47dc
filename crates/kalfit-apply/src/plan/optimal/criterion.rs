//! What a plan is to make best: concave functions log φ of the information M, with φ(aM) = aφ(M) (15.3).

use nalgebra::{Cholesky, DMatrix, Dyn};

/// A criterion; the columns of a matrix are the derivatives of figures by the coordinates, each over its scale.
#[derive(Debug, Clone, PartialEq)]
pub enum Criterion {
    /// φ = |M|^{1/d}: all coordinates together.
    Determinant,
    /// φ = 1/tr(A'M⁻¹A): the sum of the variances of figures.
    Variances(DMatrix<f64>),
    /// φ = |A'M⁻¹A|^{-1/s}: s figures together.
    FigureDeterminant(DMatrix<f64>),
}

/// log φ at M, with what its derivatives are made of.
#[derive(Debug, Clone)]
pub(super) struct Evaluated {
    pub(super) log_phi: f64,
    /// G = ∂log φ/∂M; ⟨G, M⟩ = 1.
    pub(super) gradient: DMatrix<f64>,
    inverse: DMatrix<f64>,
    /// M⁻¹A; empty for the determinant.
    solved: DMatrix<f64>,
    /// (A'M⁻¹A)⁻¹ for the determinant of figures, and 1/tr(A'M⁻¹A) × I for the variances.
    weight: DMatrix<f64>,
}

impl Criterion {
    /// log φ at M; `None` where M is not positive definite.
    pub(super) fn log_phi(&self, m: &DMatrix<f64>) -> Option<f64> {
        let (root, sizes) = scaled_root(m)?;
        let d = m.nrows() as f64;
        let solve = |a: &DMatrix<f64>| a.transpose() * solved(&root, &sizes, a);
        let value = match self {
            Criterion::Determinant => log_determinant(&root, &sizes) / d,
            Criterion::Variances(a) => -solve(a).trace().ln(),
            Criterion::FigureDeterminant(a) => {
                let (root, sizes) = scaled_root(&solve(a))?;
                -log_determinant(&root, &sizes) / a.ncols() as f64
            }
        };
        value.is_finite().then_some(value)
    }

    /// log φ at M with its gradient; `None` where M is not positive definite.
    pub(super) fn evaluate(&self, m: &DMatrix<f64>) -> Option<Evaluated> {
        let (root, sizes) = scaled_root(m)?;
        let d = m.nrows();
        let inverse = solved(&root, &sizes, &DMatrix::identity(d, d));
        let (log_phi, gradient, solved, weight) = match self {
            Criterion::Determinant => {
                let gradient = &inverse / d as f64;
                (log_determinant(&root, &sizes) / d as f64, gradient, DMatrix::zeros(d, 0), DMatrix::zeros(0, 0))
            }
            Criterion::Variances(a) => {
                let solved = &inverse * a;
                let trace = a.dot(&solved);
                let weight = DMatrix::identity(a.ncols(), a.ncols()) / trace;
                (-trace.ln(), &solved * solved.transpose() / trace, solved, weight)
            }
            Criterion::FigureDeterminant(a) => {
                let solved = &inverse * a;
                let of_figures = a.transpose() * &solved;
                let (root, sizes) = scaled_root(&of_figures)?;
                let s = a.ncols();
                let weight = self::solved(&root, &sizes, &DMatrix::identity(s, s));
                let gradient = &solved * &weight * solved.transpose() / s as f64;
                (-log_determinant(&root, &sizes) / s as f64, gradient, solved, weight)
            }
        };
        log_phi.is_finite().then_some(Evaluated { log_phi, gradient, inverse, solved, weight })
    }

    /// Second derivatives of log φ along the matrices `directions` at an evaluated point.
    pub(super) fn hessian(&self, at: &Evaluated, directions: &[&DMatrix<f64>]) -> DMatrix<f64> {
        let n = directions.len();
        match self {
            Criterion::Determinant => {
                let turned: Vec<DMatrix<f64>> = directions.iter().map(|f| &at.inverse * *f).collect();
                let d = at.inverse.nrows() as f64;
                symmetric(n, |k, l| -turned[k].dot(&turned[l].transpose()) / d)
            }
            Criterion::Variances(_) => {
                let along: Vec<DMatrix<f64>> = directions.iter().map(|f| *f * &at.solved).collect();
                let slope = |k: usize| at.solved.dot(&along[k]) * at.weight[(0, 0)];
                let slopes: Vec<f64> = (0..n).map(slope).collect();
                symmetric(n, |k, l| {
                    slopes[k] * slopes[l] - 2.0 * along[k].dot(&(&at.inverse * &along[l])) * at.weight[(0, 0)]
                })
            }
            Criterion::FigureDeterminant(a) => {
                let along: Vec<DMatrix<f64>> = directions.iter().map(|f| *f * &at.solved).collect();
                let own: Vec<DMatrix<f64>> = along.iter().map(|f| &at.weight * at.solved.transpose() * f).collect();
                symmetric(n, |k, l| {
                    let second = &at.weight * along[k].transpose() * (&at.inverse * &along[l]);
                    (own[k].dot(&own[l].transpose()) - 2.0 * second.trace()) / a.ncols() as f64
                })
            }
        }
    }
}

fn symmetric(n: usize, of: impl Fn(usize, usize) -> f64) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(n, n);
    for k in 0..n {
        for l in 0..=k {
            matrix[(k, l)] = of(k, l);
            matrix[(l, k)] = matrix[(k, l)];
        }
    }
    matrix
}

/// Cholesky factor of a matrix that is scaled to unit diagonal, and the square roots of its diagonal.
fn scaled_root(m: &DMatrix<f64>) -> Option<(Cholesky<f64, Dyn>, Vec<f64>)> {
    let sizes: Vec<f64> = m.diagonal().iter().map(|x| x.sqrt()).collect();
    if sizes.iter().any(|size| !(*size > 0.0 && size.is_finite())) {
        return None;
    }
    let scaled = DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)] / sizes[i] / sizes[j]);
    Some((scaled.cholesky()?, sizes))
}

fn log_determinant(root: &Cholesky<f64, Dyn>, sizes: &[f64]) -> f64 {
    2.0 * root.l_dirty().diagonal().iter().zip(sizes).map(|(l, size)| l.ln() + size.ln()).sum::<f64>()
}

fn solved(root: &Cholesky<f64, Dyn>, sizes: &[f64], right: &DMatrix<f64>) -> DMatrix<f64> {
    let divided = |mut matrix: DMatrix<f64>| {
        matrix.row_iter_mut().zip(sizes).for_each(|(mut row, size)| row /= *size);
        matrix
    };
    divided(root.solve(&divided(right.clone())))
}
