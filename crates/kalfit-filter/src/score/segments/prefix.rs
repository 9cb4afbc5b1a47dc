//! The covariance filter of a prefix in reverse.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, K, T, S, V")]

use std::collections::BTreeMap;

use crate::reduce::segments::prefix::{Prefix, PrefixMoments};
use crate::reduce::segments::{Square, Vector, symmetric};
use crate::score::segments::chain::DesignAdjoints;

/// Adjoints of the moments after the last row of segments of one length, summed over the segments.
#[derive(Debug, Clone, Copy)]
pub(super) struct Event<const N: usize> {
    /// Number of segments.
    pub(super) count: f64,
    /// Covariance of the smoothed state before a segment: ∂ℓ/∂J = -½V.
    pub(super) V: Square<N>,
    /// ∂ℓ/∂P and ∂ℓ/∂Ψ after the last row.
    pub(super) P: Square<N>,
    pub(super) Psi: Square<N>,
}

impl<const N: usize> Default for Event<N> {
    fn default() -> Event<N> {
        let zero = Square::zeros();
        Event { count: 0.0, V: zero, P: zero, Psi: zero }
    }
}

/// Adjoints of the coefficients of a step, summed over the rows of the prefix: the plain reverse mode of the filter
///
/// ```text
/// P⁻ = φPφ' + Q    Ψ⁻ = φΨ    v = P⁻h    S = h'v + R    K = v/S    T = Ψ⁻'h    P = P⁻ - vv'/S    Ψ = Ψ⁻ - KT'
/// ```
///
/// with ½ log S and ½ tr(V TT'/S) of every row; `events`: by number of rows.
pub(super) fn back<const N: usize>(prefix: &Prefix, events: &BTreeMap<usize, Event<N>>) -> DesignAdjoints {
    let (phi, h) = (Square::<N>::from_row_slice(&prefix.phi), Vector::<N>::from_column_slice(&prefix.h));
    let mut at = Event::<N>::default();
    let (mut phi_bar, mut q_bar) = (Square::<N>::zeros(), Square::<N>::zeros());
    let (mut h_bar, mut noise) = (Vector::<N>::zeros(), 0.0);
    let last = events.keys().last().copied().unwrap_or(0);
    for row in (0..last).rev() {
        if let Some(event) = events.get(&(row + 1)) {
            at.count += event.count;
            at.V += event.V;
            at.P += event.P;
            at.Psi += event.Psi;
        }
        let PrefixMoments { P: P_before, Psi: Psi_before, .. } = prefix.after::<N>(row);
        let gains = &prefix.gains[row * (2 * N + 1)..][..2 * N + 1];
        let (K, weight) = (Vector::<N>::from_column_slice(&gains[..N]), gains[2 * N]);
        let S = 1.0 / weight;
        let (T, v) = (Vector::<N>::from_column_slice(&gains[N..2 * N]) * S, K * S);
        let (VT, PK, PsiT) = (at.V * T, at.P * K, at.Psi * T);
        let S_bar = 0.5 * weight * (weight * T.dot(&VT) - at.count) + K.dot(&PK) + weight * PsiT.dot(&K);
        let T_bar = -(at.Psi.transpose() * K) - VT * weight;
        let v_bar = h * S_bar - PK * 2.0 - PsiT * weight;
        noise += S_bar;
        let P_predicted = prefix.after::<N>(row + 1).P + v * K.transpose();
        h_bar += P_predicted * v_bar + v * S_bar + phi * (Psi_before * T_bar);
        at.Psi += h * T_bar.transpose();
        at.P += symmetric(&(v_bar * h.transpose()));
        q_bar += at.P;
        phi_bar += at.P * phi * P_before * 2.0 + at.Psi * Psi_before.transpose();
        at.P = symmetric(&(phi.transpose() * at.P * phi));
        at.Psi = phi.transpose() * at.Psi;
    }
    let by_rows = |matrix: Square<N>| matrix.transpose().as_slice().to_vec();
    DesignAdjoints { noise, h: h_bar.as_slice().to_vec(), q: by_rows(q_bar), phi: by_rows(phi_bar) }
}
