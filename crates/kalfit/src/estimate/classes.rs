//! The reductions as the estimator wants them: scaled, centred, and tests that share one R gathered into one class.
//!
//! Inside this module ξ = m + D η with a centre m near the population mean and a diagonal D that gives the average
//! test unit information on each state, so that nothing here depends on the user's units. For a class of n tests
//! with one R, only the mean of their d and its scatter matter: a class costs as much as one test.

use std::cmp::Ordering;

use nalgebra::{DMatrix, DVector};

use crate::linalg::symmetric;
use crate::reduce::{Path, Reduction};

/// Tests that share R and covariates, in η: log p(z_j | η) = constant_j - ½ ‖d_j - R η‖².
#[derive(Debug, Clone)]
pub(crate) struct Class<T = f64> {
    /// n, the number of tests.
    pub(crate) count: T,
    /// Σ_j constant_j.
    pub(crate) constant: T,
    /// R, p × p by rows, upper triangular.
    pub(crate) factor: Vec<T>,
    /// Mean of d_j.
    pub(crate) mean: Vec<T>,
    /// Σ_j (d_j - mean)(d_j - mean)', p × p by rows; `None` for a single test.
    pub(crate) scatter: Option<Vec<T>>,
    /// Scaled covariates of the regressions.
    pub(crate) covariates: Vec<T>,
    /// Some test of it needs square-root arithmetic.
    pub(crate) square_root: bool,
}

/// All reductions of an ensemble, ready for passes.
#[derive(Debug, Clone)]
pub(crate) struct Classes {
    /// In an order that does not depend on the order of the tests.
    pub(crate) classes: Vec<Class>,
    pub(crate) frame: Frame,
    pub(crate) tests: usize,
    /// Σ_j R_j'R_j, in η.
    pub(crate) information: DMatrix<f64>,
}

/// The coordinates η: ξ = centre + scale ∘ η.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Frame {
    pub(crate) centre: Vec<f64>,
    pub(crate) scale: Vec<f64>,
    /// Scale of each covariate.
    pub(crate) covariate_scale: Vec<f64>,
}

impl Frame {
    /// Σ in the user's units from Σ in η.
    pub(crate) fn covariance_out(&self, sigma: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(sigma.nrows(), sigma.ncols(), |i, j| self.scale[i] * sigma[(i, j)] * self.scale[j])
    }

    /// Σ in η from Σ in the user's units.
    pub(crate) fn covariance_in(&self, sigma: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(sigma.nrows(), sigma.ncols(), |i, j| sigma[(i, j)] / (self.scale[i] * self.scale[j]))
    }

    /// μ in the user's units from μ in η.
    pub(crate) fn mean_out(&self, mu: &[f64]) -> Vec<f64> {
        mu.iter().zip(&self.centre).zip(&self.scale).map(|((m, c), s)| c + s * m).collect()
    }
}

impl Classes {
    /// Gathers reductions of dimension p with `regressors` covariates each.
    pub(crate) fn new(reductions: &[Reduction], p: usize, regressors: usize) -> Classes {
        let order = ordered(reductions);
        Classes::gathered(reductions, &order, frame(reductions, &order, p, regressors))
    }

    /// The same in coordinates that are given.
    pub(crate) fn within(reductions: &[Reduction], frame: Frame) -> Classes {
        Classes::gathered(reductions, &ordered(reductions), frame)
    }

    fn gathered(reductions: &[Reduction], order: &[usize], frame: Frame) -> Classes {
        let p = frame.scale.len();
        let mut classes: Vec<Class> = Vec::new();
        let mut start = 0;
        while start < order.len() {
            let same = |k: &&usize| same_class(&reductions[order[start]], &reductions[**k]);
            let end = start + order[start..].iter().take_while(same).count();
            classes.push(gather(reductions, &order[start..end], &frame, p));
            start = end;
        }
        let mut information = DMatrix::zeros(p, p);
        for class in &classes {
            let factor = DMatrix::from_row_slice(p, p, &class.factor);
            information += factor.transpose() * &factor * class.count;
        }
        Classes { classes, frame, tests: reductions.len(), information }
    }

    /// One test as a class of its own, in the same η.
    pub(crate) fn single(&self, reduction: &Reduction) -> Class {
        gather(std::slice::from_ref(reduction), &[0], &self.frame, self.dimension())
    }

    /// Σ_j E_j'J_jE_j: information on the p elements of μ and the scaled regression coefficients at Σ = 0.
    pub(crate) fn mean_information(&self, regressors: &[usize]) -> DMatrix<f64> {
        let p = self.dimension();
        let mut information = DMatrix::zeros(p + regressors.len(), p + regressors.len());
        for class in &self.classes {
            let column = |m: usize| if m < p { (m, 1.0) } else { (regressors[m - p], class.covariates[m - p]) };
            let rows = DMatrix::from_fn(p, p + regressors.len(), |i, m| {
                let (k, x) = column(m);
                x * class.factor[i * p + k]
            });
            information += rows.transpose() * &rows * class.count;
        }
        information
    }

    /// p.
    pub(crate) fn dimension(&self) -> usize {
        self.frame.scale.len()
    }
}

fn ordered(reductions: &[Reduction]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..reductions.len()).collect();
    order.sort_by(|&a, &b| canonical(&reductions[a], &reductions[b]));
    order
}

/// Order by R, covariates, then id: a total order that gathers classes and does not see the order of the tests.
fn canonical(a: &Reduction, b: &Reduction) -> Ordering {
    compare(&a.factor, &b.factor).then_with(|| compare(&a.covariates, &b.covariates)).then_with(|| a.test.cmp(&b.test))
}

fn compare(a: &[f64], b: &[f64]) -> Ordering {
    let different = a.iter().zip(b).map(|(x, y)| x.total_cmp(y)).find(|o| o.is_ne());
    different.unwrap_or_else(|| a.len().cmp(&b.len()))
}

fn same_class(a: &Reduction, b: &Reduction) -> bool {
    compare(&a.factor, &b.factor).is_eq() && compare(&a.covariates, &b.covariates).is_eq()
}

/// Centre: pooled least squares. Scale: the average informed test has unit information on each state.
fn frame(reductions: &[Reduction], order: &[usize], p: usize, regressors: usize) -> Frame {
    let mut information = DMatrix::zeros(p, p);
    let mut informed = vec![0.0; p];
    let mut y = DVector::zeros(p);
    let mut squares = vec![0.0; regressors];
    for &j in order {
        let factor = unpack(&reductions[j].factor, p);
        let own = factor.transpose() * &factor;
        for i in 0..p {
            informed[i] += f64::from(u8::from(own[(i, i)] > 0.0));
        }
        y += factor.transpose() * DVector::from_column_slice(&reductions[j].data);
        information += own;
        squares.iter_mut().zip(&reductions[j].covariates).for_each(|(s, x)| *s += x * x);
    }
    let scale: Vec<f64> = (0..p)
        .map(|i| if information[(i, i)] > 0.0 { (informed[i] / information[(i, i)]).sqrt() } else { 1.0 })
        .collect();
    let scaled = DMatrix::from_fn(p, p, |i, j| scale[i] * information[(i, j)] * scale[j]);
    let right = DVector::from_fn(p, |i, _| scale[i] * y[i]);
    let solution = symmetric::pseudo_solve(&scaled, &right);
    let centre = (0..p).map(|i| scale[i] * solution[i]).collect();
    let n = order.len().max(1) as f64;
    let covariate_scale = squares.iter().map(|&s| if s > 0.0 { (s / n).sqrt() } else { 1.0 }).collect();
    Frame { centre, scale, covariate_scale }
}

fn gather(reductions: &[Reduction], members: &[usize], frame: &Frame, p: usize) -> Class {
    let first = &reductions[members[0]];
    let user = unpack(&first.factor, p);
    let offset = &user * DVector::from_column_slice(&frame.centre);
    let count = members.len() as f64;
    let centred = |j: usize| DVector::from_column_slice(&reductions[j].data) - &offset;
    let mut mean = DVector::zeros(p);
    for &j in members {
        mean += centred(j);
    }
    mean /= count;
    let scatter = (members.len() > 1).then(|| {
        let mut scatter = DMatrix::zeros(p, p);
        for &j in members {
            let away = centred(j) - &mean;
            scatter += &away * away.transpose();
        }
        rows(&scatter)
    });
    Class {
        count,
        constant: members.iter().map(|&j| reductions[j].constant).sum(),
        factor: rows(&DMatrix::from_fn(p, p, |i, k| user[(i, k)] * frame.scale[k])),
        mean: mean.as_slice().to_vec(),
        scatter,
        covariates: first.covariates.iter().zip(&frame.covariate_scale).map(|(x, s)| x / s).collect(),
        square_root: members.iter().any(|&j| reductions[j].path == Path::SquareRoot),
    }
}

/// The packed R of a reduction as a matrix.
pub(crate) fn unpack(factor: &[f64], p: usize) -> DMatrix<f64> {
    DMatrix::from_fn(p, p, |i, k| if i <= k { factor[i + k * (k + 1) / 2] } else { 0.0 })
}

fn rows(matrix: &DMatrix<f64>) -> Vec<f64> {
    matrix.transpose().as_slice().to_vec()
}
