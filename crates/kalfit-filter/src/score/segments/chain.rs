//! The chain of the segments, backward.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, J, N, B, V, W")]

use std::collections::BTreeMap;

use crate::reduce::segments::SegmentedStretch;
use crate::reduce::segments::chain::ChainMeans;
use crate::reduce::segments::square::{
    Square, added, congruence, product, square, sum, symmetric, times, transposed, transposed_times,
};
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

/// The adjoints r of a test through the segments, from the last to the first:
///
/// ```text
/// r⁺ = Ψ_l'r        r ← b + Br⁺        δ̂ = g + Pr
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
    let mut r = [0.0; N];
    r.copy_from_slice(state);
    for segment in (0..stretch.segments()).rev() {
        let [_, g, b] = means.of(segment, N);
        let (link, moments) = (stretch.link(segment), stretch.moments_of(segment));
        let (P, B): (Square<N>, Square<N>) = (square(link.P), square(link.B));
        let out = &mut ends[start + segment * 2 * N..][..2 * N];
        out[N..].copy_from_slice(&r);
        let through = times(&B, &transposed_times(&square::<N>(moments.Psi), &r));
        for i in 0..N {
            r[i] = b[i] + through[i];
        }
        let moved = times(&P, &r);
        for i in 0..N {
            out[i] = g[i] + moved[i];
        }
    }
    state.copy_from_slice(&r);
}

impl DesignAdjoints {
    /// Moves ρ and N through the segments, from the last to the first, and sums what the covariances of the steps add:
    ///
    /// ```text
    /// N_J = BJ        P⁺ = PB        W = ΨC - P N_J ΨC - P⁺ Ψ_l'ρ        V = WW' + P⁺ - P⁺ Ψ_l'NΨ_l P⁺
    /// P̄_l = ½(ρρ' - N)        Ψ̄_l = -ρW' - NΨ_l P⁺        ρ ← N_J ΨC + BΨ_l'ρ        N ← N_J + B Ψ_l'NΨ_l B'
    /// ```
    ///
    /// `root`: C, p × c, row-major.
    pub(crate) fn of(stretch: &SegmentedStretch, root: (&[f64], usize), state: &mut StateAdjoints) -> DesignAdjoints {
        with_states!(stretch.prefix.size(), N => DesignAdjoints::of_size::<N>(stretch, root, state))
    }

    fn of_size<const N: usize>(
        stretch: &SegmentedStretch,
        (root, c): (&[f64], usize),
        state: &mut StateAdjoints,
    ) -> DesignAdjoints {
        let p = root.len() / c.max(1);
        let mut information = square::<N>(&state.N);
        let mut rho = columns::<N>(&state.rho, c);
        let mut events: BTreeMap<usize, Event<N>> = BTreeMap::new();
        for segment in (0..stretch.segments()).rev() {
            let (link, moments) = (stretch.link(segment), stretch.moments_of(segment));
            let (P, B): (Square<N>, Square<N>) = (square(link.P), square(link.B));
            let (J, Psi_l): (Square<N>, Square<N>) = (square(moments.J), square(moments.Psi));
            let (N_J, filtered) = (symmetric(&product(&B, &J)), symmetric(&product(&P, &B)));
            let event = events.entry(stretch.rows_of(segment)).or_default();
            let before = congruence(&transposed(&Psi_l), &information);
            event.count += 1.0;
            event.V = sum(&event.V, 1.0, &sum(&filtered, -1.0, &congruence(&filtered, &before)));
            event.P = sum(&event.P, -0.5, &information);
            event.Psi = sum(&event.Psi, -1.0, &product(&product(&information, &Psi_l), &filtered));
            information = sum(&N_J, 1.0, &congruence(&B, &before));
            for (k, rho) in rho.iter_mut().enumerate() {
                let sensitivity: [f64; N] =
                    std::array::from_fn(|i| (0..p).map(|j| link.Psi[i * p + j] * root[j * c + k]).sum());
                let (informed, before) = (times(&N_J, &sensitivity), transposed_times(&Psi_l, rho));
                let W = added(&added(&sensitivity, -1.0, &times(&P, &informed)), -1.0, &times(&filtered, &before));
                add_outer(&mut event.V, 1.0, &W, &W);
                add_outer(&mut event.P, 0.5, rho, rho);
                add_outer(&mut event.Psi, -1.0, rho, &W);
                *rho = added(&informed, 1.0, &times(&B, &before));
            }
        }
        state.N.copy_from_slice(information.as_flattened());
        for (k, rho) in rho.iter().enumerate() {
            (0..N).for_each(|i| state.rho[i * c + k] = rho[i]);
        }
        back(&stretch.prefix, &events)
    }
}

/// The columns of an N × c matrix.
fn columns<const N: usize>(matrix: &[f64], c: usize) -> Vec<[f64; N]> {
    (0..c).map(|k| std::array::from_fn(|i| matrix[i * c + k])).collect()
}

/// A ← A + factor × xy'.
fn add_outer<const N: usize>(a: &mut Square<N>, factor: f64, x: &[f64; N], y: &[f64; N]) {
    for i in 0..N {
        for j in 0..N {
            a[i][j] += factor * x[i] * y[j];
        }
    }
}
