//! A prepared test as matrices, states in the order of the model.
#![expect(non_snake_case, reason = "the letters of the theory: M, Q, R")]

use nalgebra::DMatrix;

use crate::reduce::design::{DesignStep, Transition};
use crate::reduce::prepare::{Preparer, Workspace};
use crate::reduce::semidefinite::{NotSemidefinite, root};

/// Matrices of the test in a work space, whose measurements are not whitened.
#[derive(Debug, Clone, Copy)]
pub(super) struct Matrices<'a> {
    work: &'a Workspace,
    /// State of the model at each kernel index.
    states: &'a [usize],
}

impl<'a> Matrices<'a> {
    pub(super) fn new(preparer: &'a Preparer, work: &'a Workspace) -> Matrices<'a> {
        Matrices { work, states: &preparer.order.states }
    }

    /// φ and Q, n × n.
    pub(super) fn motion(&self, transition: &Transition) -> (DMatrix<f64>, DMatrix<f64>) {
        let n = self.states.len();
        let state = |place: usize| self.states[place];
        (transition.dense_phi(n, state), transition.dense_noise(n, state))
    }

    /// M of a step, m × n.
    pub(super) fn measurement(&self, step: &DesignStep<'_>) -> DMatrix<f64> {
        let mut M = DMatrix::zeros(step.rows.len(), self.states.len());
        for (i, line) in step.lines.clone().enumerate() {
            let (states, h) = self.work.design.terms(line);
            for (&state, &h) in states.iter().zip(h) {
                M[(i, self.states[state as usize])] = h;
            }
        }
        M
    }

    /// R of a step, m × m.
    pub(super) fn noise(&self, step: &DesignStep<'_>) -> DMatrix<f64> {
        let m = step.rows.len();
        let mut R = DMatrix::zeros(m, m);
        for (i, line) in step.lines.clone().enumerate() {
            R[(i, i)] = self.work.design.noise[line];
        }
        let covariances = self.work.covariances.as_deref().unwrap_or_default();
        // covariances are in the order of the steps
        let begin = covariances.partition_point(|&(i, ..)| i < step.rows.start);
        for &(i, j, value) in covariances[begin..].iter().take_while(|(i, ..)| *i < step.rows.end) {
            let (i, j) = (i - step.rows.start, j - step.rows.start);
            R[(i, j)] += value;
            R[(j, i)] += value;
        }
        R
    }
}

/// F with FF' = `a`, which is m × m and positive semidefinite; F has no columns of zeros.
pub(super) fn root_of(a: &DMatrix<f64>) -> Result<DMatrix<f64>, NotSemidefinite> {
    let m = a.nrows();
    // `a` is symmetric, so that columns are rows
    let U = root(a.as_slice(), m)?;
    let nonzero_rows: Vec<usize> = (0..m).filter(|k| U[k * m..][..m].iter().any(|x| *x != 0.0)).collect();
    Ok(DMatrix::from_fn(m, nonzero_rows.len(), |i, k| U[nonzero_rows[k] * m + i]))
}

/// Largest ratio of columns to rows that a root may have before it is folded.
const MOST_COLUMNS_PER_ROW: usize = 3;

/// Adds independent noise to a root: appends the columns of `noise`, with the first row of `noise` at row `first` and
/// zeros elsewhere.
pub(super) fn append(root: &mut DMatrix<f64>, first: usize, noise: &DMatrix<f64>) {
    if noise.ncols() == 0 {
        return;
    }
    if root.ncols() + noise.ncols() > MOST_COLUMNS_PER_ROW * root.nrows() {
        fold(root);
    }
    let columns = root.ncols();
    let old = std::mem::replace(root, DMatrix::zeros(0, 0));
    *root = old.resize_horizontally(columns + noise.ncols(), 0.0);
    root.view_mut((first, columns), noise.shape()).copy_from(noise);
}

/// Reduces a root to at most as many columns as rows, by an orthogonal transformation. Rows of zeros remain zero.
pub(super) fn fold(root: &mut DMatrix<f64>) {
    if root.ncols() > root.nrows() && root.nrows() > 0 {
        *root = root.transpose().qr().r().transpose();
    }
}
