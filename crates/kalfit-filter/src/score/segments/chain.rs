//! The chain of the segments, backward.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, N, R, S, G, F, V, W")]

use std::collections::BTreeMap;

use nalgebra::{Const, DMatrix, Dyn, OMatrix};

use crate::reduce::segments::chain::ChainMeans;
use crate::reduce::segments::stretch::Link;
use crate::reduce::segments::{SegmentedStretch, Square, Vector, symmetric};
use crate::reduce::with_states;
use crate::score::segments::prefix::{Event, back};

/// Adjoints ρ (N × c) and N (N × N) of the states of the segments, row-major.
#[derive(Debug, Clone)]
pub(crate) struct StateAdjoints {
    pub(crate) rho: Vec<f64>,
    pub(crate) N: Vec<f64>,
}

/// The design's part of the adjoints of the steps of a stretch, summed over the steps; matrices are row-major, and the
/// entries of Q are taken as independent.
#[derive(Debug, Clone, Default)]
pub(crate) struct DesignAdjoints {
    pub(crate) noise: f64,
    pub(crate) h: Vec<f64>,
    pub(crate) q: Vec<f64>,
    pub(crate) phi: Vec<f64>,
}

/// Takes the adjoints r of a test through the segments, from the last to the first:
///
/// ```text
/// r⁺ = Ψ_l'r        r ← b + F'r⁺ = b + r⁺ - R'G'r⁺        δ̂ = g + Pr
/// ```
///
/// Appends (δ̂, r after the segment) of each segment, first segment first.
pub(super) fn means_back(stretch: &SegmentedStretch, means: &ChainMeans, r: &mut [f64], ends: &mut Vec<f64>) {
    with_states!(stretch.prefix.size(), N => sized_means_back::<N>(stretch, means, r, ends));
}

fn sized_means_back<const N: usize>(
    stretch: &SegmentedStretch,
    means: &ChainMeans,
    state: &mut [f64],
    ends: &mut Vec<f64>,
) {
    let start = ends.len();
    ends.resize(start + stretch.segments() * 2 * N, 0.0);
    let mut r = Vector::<N>::from_column_slice(state);
    for segment in (0..stretch.segments()).rev() {
        let [_, g, b] = means.of::<N>(segment);
        let Link { P, R, G, .. } = stretch.link::<N>(segment);
        let (delta, end) = ends[start + segment * 2 * N..][..2 * N].split_at_mut(N);
        end.copy_from_slice(r.as_slice());
        let later = stretch.moments_of::<N>(segment).Psi.transpose() * r;
        r = b + later - R.transpose() * (G.transpose() * later);
        delta.copy_from_slice((g + P * r).as_slice());
    }
    state.copy_from_slice(r.as_slice());
}

impl DesignAdjoints {
    /// Moves ρ and N through the segments, from the last to the first, and sums what the covariances of the steps add:
    ///
    /// ```text
    /// ρ⁺ = Ψ_l'ρ        N⁺ = Ψ_l'NΨ_l        P⁺ = FPF' + GG'        W = ΨC - GRΨC - P⁺ρ⁺        V = WW' + P⁺ - P⁺N⁺P⁺
    /// P̄_l = ½(ρρ' - N)        Ψ̄_l = -ρW' - NΨ_l P⁺        ρ ← R'S⁻¹RΨC + F'ρ⁺        N ← R'S⁻¹R + F'N⁺F
    /// ```
    ///
    /// `root`: C, p × c, row-major, and c.
    pub(crate) fn of(stretch: &SegmentedStretch, root: (&[f64], usize), state: &mut StateAdjoints) -> DesignAdjoints {
        with_states!(stretch.prefix.size(), N => DesignAdjoints::of_size::<N>(stretch, root, state))
    }

    fn of_size<const N: usize>(
        stretch: &SegmentedStretch,
        (root, c): (&[f64], usize),
        state: &mut StateAdjoints,
    ) -> DesignAdjoints {
        let C = DMatrix::from_row_slice(root.len() / c.max(1), c, root);
        let mut information = Square::<N>::from_row_slice(&state.N);
        let mut rho = OMatrix::<f64, Const<N>, Dyn>::from_row_slice(&state.rho);
        let mut events: BTreeMap<usize, Event<N>> = BTreeMap::new();
        for segment in (0..stretch.segments()).rev() {
            let (link, Psi_l) = (stretch.link::<N>(segment), stretch.moments_of::<N>(segment).Psi);
            let Link { P, R, weight, G, Psi } = link;
            let F = Square::identity() - G * R;
            let filtered = symmetric(&(F * P * F.transpose() + G * G.transpose()));
            let (later, rho_later) = (Psi_l.transpose() * information * Psi_l, Psi_l.transpose() * &rho);
            let told = R * Psi * &C;
            let W = Psi * &C - G * &told - filtered * &rho_later;
            let event = events.entry(stretch.rows_of(segment)).or_default();
            event.count += 1.0;
            event.V += &W * W.transpose() + filtered - filtered * later * filtered;
            event.P += (&rho * rho.transpose() - information) * 0.5;
            event.Psi -= &rho * W.transpose() + information * Psi_l * filtered;
            information = symmetric(&(R.transpose() * weight * R + F.transpose() * later * F));
            rho = R.transpose() * weight * told + F.transpose() * rho_later;
        }
        state.N.copy_from_slice(information.transpose().as_slice());
        (0..N).for_each(|i| (0..c).for_each(|k| state.rho[i * c + k] = rho[(i, k)]));
        back(&stretch.prefix, &events)
    }
}
