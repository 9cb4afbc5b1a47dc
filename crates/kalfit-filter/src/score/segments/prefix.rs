//! The covariance filter of a prefix in reverse.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, K, T, S, V")]

use std::collections::BTreeMap;

use crate::reduce::segments::prefix::Prefix;
use crate::reduce::segments::square::{
    Square, added, congruence, dot, product, square, sum, times, transposed, transposed_times, vector,
};
use crate::score::segments::chain::DesignAdjoints;

/// What segments of one length say about the moments after their last row, summed over the segments.
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
        let zero = [[0.0; N]; N];
        Event { count: 0.0, V: zero, P: zero, Psi: zero }
    }
}

/// Adjoints of the coefficients of a step, summed over the rows of the prefix: the plain reverse mode of the filter
///
/// ```text
/// P⁻ = φPφ' + Q    Ψ⁻ = φΨ    v = P⁻h    S = h'v + R    K = v/S    T = h'Ψ⁻    P = P⁻ - vv'/S    Ψ = Ψ⁻ - KT
/// ```
///
/// with ½ log S and ½ tr(V T'T/S) of every row; `events`: by number of rows.
pub(super) fn back<const N: usize>(prefix: &Prefix, events: &BTreeMap<usize, Event<N>>) -> DesignAdjoints {
    let (phi, h) = (square::<N>(&prefix.phi), vector::<N>(&prefix.h));
    let transposed_phi = transposed(&phi);
    let mut at = Event::<N>::default();
    let (mut phi_bar, mut q_bar, mut h_bar, mut noise) = ([[0.0; N]; N], [[0.0; N]; N], [0.0; N], 0.0);
    let last = events.keys().last().copied().unwrap_or(0);
    for row in (0..last).rev() {
        if let Some(event) = events.get(&(row + 1)) {
            at.count += event.count;
            at.V = sum(&at.V, 1.0, &event.V);
            at.P = sum(&at.P, 1.0, &event.P);
            at.Psi = sum(&at.Psi, 1.0, &event.Psi);
        }
        let (before, after) = (prefix.after(row), prefix.after(row + 1));
        let gains = &prefix.gains[row * (2 * N + 1)..][..2 * N + 1];
        let (K, weight) = (vector::<N>(gains), gains[2 * N]);
        let S = 1.0 / weight;
        let T: [f64; N] = std::array::from_fn(|i| gains[N + i] * S);
        let v: [f64; N] = std::array::from_fn(|i| K[i] * S);
        let (VT, PK, PsiT) = (times(&at.V, &T), times(&at.P, &K), times(&at.Psi, &T));
        let S_bar =
            -0.5 * at.count * weight + 0.5 * weight * weight * dot(&T, &VT) + dot(&K, &PK) + weight * dot(&PsiT, &K);
        let T_bar = added(&transposed_times(&at.Psi, &K).map(|x| -x), -weight, &VT);
        let v_bar = added(&added(&PK.map(|x| -2.0 * x), -weight, &PsiT), S_bar, &h);
        noise += S_bar;
        let Psi_before: Square<N> = product(&phi, &square(before.Psi));
        for i in 0..N {
            let of_variance: f64 = (0..N).map(|j| (after.P[i * N + j] + S * K[i] * K[j]) * v_bar[j]).sum();
            h_bar[i] += of_variance + S_bar * v[i] + dot(&Psi_before[i], &T_bar);
        }
        for i in 0..N {
            for j in 0..N {
                at.Psi[i][j] += h[i] * T_bar[j];
                at.P[i][j] += 0.5 * (v_bar[i] * h[j] + h[i] * v_bar[j]);
            }
        }
        q_bar = sum(&q_bar, 1.0, &at.P);
        let P_phi = product(&at.P, &phi);
        phi_bar = sum(&phi_bar, 2.0, &product(&P_phi, &square(before.P)));
        phi_bar = sum(&phi_bar, 1.0, &product(&at.Psi, &transposed(&square(before.Psi))));
        at.P = congruence(&transposed_phi, &at.P);
        at.Psi = product(&transposed_phi, &at.Psi);
    }
    DesignAdjoints { noise, h: h_bar.to_vec(), q: q_bar.as_flattened().to_vec(), phi: phi_bar.as_flattened().to_vec() }
}
