//! The state after the last step of a test.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, U with U'U = P")]

use std::sync::Arc;

pub(super) use kalfit_model::Terminal;
use nalgebra::{DMatrix, DVector};

use crate::reduce::semidefinite::information_root;

/// Least scaled pivot of P_K at which plain covariance arithmetic is accurate enough: the next phase may measure
/// exactly the combination of states to which the pivot belongs.
const LEAST_PIVOT: f64 = 1e-8;

/// The part of the last state that depends only on the design: Ψ_K and a root of P_K, states in the order of the model.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TerminalRoot {
    /// Ψ_K, n × p.
    pub(crate) sensitivity: DMatrix<f64>,
    /// C with CC' = P_K, n × any number of columns.
    pub(crate) root: DMatrix<f64>,
}

impl TerminalRoot {
    /// The root given by Ψ (row-major) and U (r × r, row-major, U'U = P) in kernel order; `states`: the state of the
    /// model at each kernel index.
    pub(crate) fn new(states: &[usize], Psi: &[f64], U: &[f64], r: usize) -> TerminalRoot {
        TerminalRoot::of_root(states, Psi, r, |row, place| U[row * r + place])
    }

    /// The root given by the lower triangle of P, r × r, row-major; `None` where square-root arrays are needed.
    pub(crate) fn of_covariance(states: &[usize], Psi: &[f64], P: &[f64], r: usize) -> Option<TerminalRoot> {
        let mut packed = Vec::with_capacity(r * (r + 1) / 2);
        (0..r).for_each(|k| packed.extend_from_slice(&P[k * r..=k * r + k]));
        let (root, least) = information_root(&packed, r, LEAST_PIVOT);
        let U = |row: usize, place: usize| if row <= place { root[row + place * (place + 1) / 2] } else { 0.0 };
        (least >= LEAST_PIVOT).then(|| TerminalRoot::of_root(states, Psi, r, U))
    }

    /// The root from U, without rows of zeros of U.
    fn of_root(states: &[usize], Psi: &[f64], r: usize, U: impl Fn(usize, usize) -> f64) -> TerminalRoot {
        let (n, p) = (states.len(), Psi.len() / states.len().max(1));
        let is_nonzero = |row: &usize| (0..r).any(|place| U(*row, place) != 0.0);
        let nonzero_rows = || (0..r).filter(is_nonzero).enumerate();
        let mut end =
            TerminalRoot { sensitivity: DMatrix::zeros(n, p), root: DMatrix::zeros(n, nonzero_rows().count()) };
        for (place, &state) in states.iter().enumerate() {
            for c in 0..p {
                end.sensitivity[(state, c)] = Psi[place * p + c];
            }
        }
        for (c, row) in nonzero_rows() {
            states.iter().take(r).enumerate().for_each(|(place, &state)| end.root[(state, c)] = U(row, place));
        }
        end
    }

    /// Bytes of memory that the matrices occupy.
    pub(crate) fn bytes(&self) -> usize {
        8 * (self.sensitivity.len() + self.root.len())
    }
}

/// The last state of a test; tests of one design share the part that does not depend on data.
#[derive(Debug, Clone)]
pub(crate) struct TerminalState {
    mean: DVector<f64>,
    root: Arc<TerminalRoot>,
}

impl TerminalState {
    /// The last state with x̂_K, given in kernel order.
    pub(crate) fn new(root: Arc<TerminalRoot>, states: &[usize], x: impl Iterator<Item = f64>) -> TerminalState {
        TerminalState { mean: in_model_order(states, x), root }
    }

    /// The last state with a copy of the shared part.
    pub(crate) fn terminal(self) -> Terminal {
        let TerminalRoot { sensitivity, root } = Arc::unwrap_or_clone(self.root);
        Terminal { mean: self.mean, sensitivity, root }
    }
}

/// The vector `x`, given in kernel order, reordered by state of the model.
fn in_model_order(states: &[usize], x: impl Iterator<Item = f64>) -> DVector<f64> {
    let mut out = DVector::zeros(states.len());
    states.iter().zip(x).for_each(|(&state, x)| out[state] = x);
    out
}
