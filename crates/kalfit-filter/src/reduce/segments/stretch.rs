//! A stretch of equal steps cut into segments: the covariances from segment to segment.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, J, B")]

use std::ops::Range;
use std::sync::Arc;

use crate::reduce::scan::with_states;
use crate::reduce::segments::prefix::{Prefix, PrefixMoments};
use crate::reduce::segments::square::{
    Square, congruence, identity, inverse, product, root, square, sum, symmetric, transposed,
};

/// Largest difference of entries (i, j) and (j, i) of P(I + JP)⁻¹, relative to the standard deviations, with which
/// plain arithmetic is accurate enough.
const MOST_ASYMMETRY: f64 = 1e-9;

/// Largest Σ |J_ij P_ij| before a segment: how many times more the segment tells about the state than was known. The
/// plain information form loses as many digits as this number has, twice as many where two states are seen as a sum:
/// at 1e5 the log-likelihood keeps ten.
const MOST_NEWS: f64 = 1e5;

/// A stretch of equal steps cut into segments.
///
/// The state x at the start of a segment has the mean x̄ + Ψξ and the covariance P. The rows of the segment give
/// information J about x, and the filter moves on from the state that they leave:
///
/// ```text
/// B = (I + JP)⁻¹        P⁺ = PB        Ψ⁺ = B'Ψ        information about ξ: Ψ'BJΨ        log|S| + log|I + JP|
/// next segment: P = Ψ_l P⁺ Ψ_l' + P_l        Ψ = Ψ_l Ψ⁺        with (P_l, Ψ_l, J) of the prefix of l rows
/// ```
#[derive(Debug, Clone)]
pub(crate) struct SegmentedStretch {
    /// Rows of the stretch among the rows of the test.
    pub(crate) rows: Range<usize>,
    pub(crate) prefix: Arc<Prefix>,
    /// p, number of unknowns ξ.
    p: usize,
    /// (P, B, Ψ) before each segment: N × N, N × N, N × p.
    links: Vec<f64>,
    /// (P, Ψ) after the last segment: r × r, n × p.
    end: (Vec<f64>, Vec<f64>),
}

/// (P, B, Ψ) before a segment.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Link<'a> {
    pub(crate) P: &'a [f64],
    pub(crate) B: &'a [f64],
    pub(crate) Psi: &'a [f64],
}

/// P (r × r, row-major) and Ψ (n × p) of the filter, and what the segments add to the sums over rows.
pub(crate) struct SegmentFilter<'a> {
    pub(crate) P: &'a mut [f64],
    pub(crate) Psi: &'a mut [f64],
    /// J of ξ, packed by columns.
    pub(crate) J: &'a mut [f64],
    /// Σ log S.
    pub(crate) log_determinant: &'a mut f64,
}

impl SegmentedStretch {
    /// The stretch with these rows, from the state of the filter before it; moves the filter to the end of the stretch.
    /// `None` where plain arithmetic would lose too many digits.
    pub(crate) fn new(
        rows: Range<usize>,
        prefix: Arc<Prefix>,
        (r, p): (usize, usize),
        filter: SegmentFilter<'_>,
    ) -> Option<SegmentedStretch> {
        let mut stretch = SegmentedStretch { rows, prefix, p, links: Vec::new(), end: Default::default() };
        with_states!(stretch.prefix.size(), N => stretch.filter::<N>(r, filter))?;
        Some(stretch)
    }

    /// Number of segments.
    pub(crate) fn segments(&self) -> usize {
        self.rows.len().div_ceil(self.prefix.rows())
    }

    /// Number of rows of a segment.
    pub(crate) fn rows_of(&self, segment: usize) -> usize {
        self.prefix.rows().min(self.rows.len() - segment * self.prefix.rows())
    }

    /// Moments of the rows of a segment.
    pub(crate) fn moments_of(&self, segment: usize) -> PrefixMoments<'_> {
        self.prefix.after(self.rows_of(segment))
    }

    /// (P, B, Ψ) before a segment.
    pub(crate) fn link(&self, segment: usize) -> Link<'_> {
        let N = self.prefix.size();
        let stride = 2 * N * N + N * self.p;
        let (P, rest) = self.links[segment * stride..][..stride].split_at(N * N);
        let (B, Psi) = rest.split_at(N * N);
        Link { P, B, Psi }
    }

    /// P (r × r) and Ψ (n × p) after the stretch.
    pub(crate) fn end(&self) -> (&[f64], &[f64]) {
        (&self.end.0, &self.end.1)
    }

    /// Memory in bytes, without the prefix.
    pub(crate) fn bytes(&self) -> usize {
        8 * (self.links.len() + self.end.0.len() + self.end.1.len()) + 100
    }

    fn filter<const N: usize>(&mut self, r: usize, filter: SegmentFilter<'_>) -> Option<()> {
        let SegmentFilter { P: all, Psi: all_Psi, J: information, log_determinant } = filter;
        let p = self.p;
        let mut P: Square<N> = [[0.0; N]; N];
        for i in 0..r {
            (0..r).for_each(|j| P[i][j] = all[i.max(j) * r + i.min(j)]);
        }
        let mut Psi = Vec::with_capacity(N * p);
        self.prefix.states.iter().for_each(|&state| Psi.extend_from_slice(&all_Psi[state * p..][..p]));
        for segment in 0..self.segments() {
            let rows = self.rows_of(segment);
            let prefix = self.prefix.clone();
            let moments = prefix.after(rows);
            let (J, Psi_l, P_l) = (square::<N>(moments.J), square::<N>(moments.Psi), square::<N>(moments.P));
            let news: f64 = (0..N * N).map(|ij| (J[ij / N][ij % N] * P[ij / N][ij % N]).abs()).sum();
            if news > MOST_NEWS || news.is_nan() {
                return None;
            }
            let (B, determinant) = inverse(&sum(&identity(), 1.0, &product(&J, &P)))?;
            if !(determinant > 0.0 && determinant.is_finite()) {
                return None;
            }
            *log_determinant += prefix.log_determinant(rows) + determinant.ln();
            self.links.extend_from_slice(P.as_flattened());
            self.links.extend_from_slice(B.as_flattened());
            self.links.extend_from_slice(&Psi);
            let filtered = product(&P, &B);
            if !is_symmetric(&filtered) {
                return None;
            }
            // BJ = R'(I + RPR')⁻¹R, and RΨ first: what two states tell as a sum cancels in RΨ without rounding of J
            let R = root(&J)?;
            let S = inverse(&sum(&identity(), 1.0, &congruence(&R, &P)))?.0;
            let (told, gain) = (times_columns(&R, &Psi, p), product(&product(&P, &transposed(&R)), &S));
            add_congruence(&symmetric(&S), &told, p, information);
            // B'Ψ = Ψ - P BJ Ψ
            let filtered_Psi: Vec<f64> =
                Psi.iter().zip(times_columns(&gain, &told, p)).map(|(before, told)| before - told).collect();
            Psi = times_columns(&Psi_l, &filtered_Psi, p);
            P = sum(&congruence(&Psi_l, &symmetric(&filtered)), 1.0, &P_l);
        }
        for i in 0..r {
            (0..r).for_each(|j| all[i * r + j] = P[i][j]);
        }
        for (k, &state) in self.prefix.states.iter().enumerate() {
            all_Psi[state * p..][..p].copy_from_slice(&Psi[k * p..][..p]);
        }
        self.end = (all.to_vec(), all_Psi.to_vec());
        Some(())
    }
}

/// Whether a covariance computed without regard to symmetry is symmetric up to rounding, with variances not below zero.
fn is_symmetric<const N: usize>(P: &Square<N>) -> bool {
    (0..N).all(|i| {
        P[i][i] >= 0.0
            && (0..i).all(|j| {
                let difference = P[i][j] - P[j][i];
                difference * difference <= MOST_ASYMMETRY * MOST_ASYMMETRY * P[i][i] * P[j][j]
            })
    })
}

/// The product of an N × N matrix and an N × p matrix, row-major.
fn times_columns<const N: usize>(a: &Square<N>, columns: &[f64], p: usize) -> Vec<f64> {
    let mut out = vec![0.0; N * p];
    for i in 0..N {
        for k in 0..N {
            (0..p).for_each(|j| out[i * p + j] += a[i][k] * columns[k * p + j]);
        }
    }
    out
}

/// J ← J + Ψ'MΨ, packed by columns; Ψ is N × p.
pub(super) fn add_congruence<const N: usize>(M: &Square<N>, Psi: &[f64], p: usize, J: &mut [f64]) {
    let mut at = 0;
    for k in 0..p {
        let column: [f64; N] = std::array::from_fn(|i| (0..N).map(|j| M[i][j] * Psi[j * p + k]).sum());
        for i in 0..=k {
            J[at] += (0..N).map(|j| Psi[j * p + i] * column[j]).sum::<f64>();
            at += 1;
        }
    }
}
