//! A stretch of equal steps cut into segments: the covariances from segment to segment.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, J, R, S, G, F")]

use std::ops::Range;
use std::sync::Arc;

use nalgebra::{Const, Dyn, MatrixView, OMatrix};

use crate::reduce::kernel::MIN_REMAINING;
use crate::reduce::scan::with_states;
use crate::reduce::segments::prefix::{Prefix, PrefixMoments};
use crate::reduce::segments::root::root;
use crate::reduce::segments::{Square, symmetric};

/// A stretch of equal steps cut into segments.
///
/// The state x at the start of a segment has the mean x̄ + Ψξ and the covariance P. The rows of the segment are one
/// measurement of it, w = Rx + v with v ~ N(0, I) and R'R = J, after which the filter moves on by the transition Ψ_l and
/// the noise P_l that the prefix has after l rows:
///
/// ```text
/// S = I + RPR'        G = PR'S⁻¹        F = I - GR        information about ξ: (RΨ)'S⁻¹RΨ        log|S| + Σ log S of the rows
/// P⁺ = FPF' + GG'        Ψ⁺ = Ψ - G(RΨ)        next segment: P = Ψ_l P⁺ Ψ_l' + P_l        Ψ = Ψ_l Ψ⁺
/// ```
///
/// Nothing cancels, however much more the rows tell than was known: S ≥ I, and P⁺ is a sum of squares.
#[derive(Debug, Clone)]
pub(crate) struct SegmentedStretch {
    /// Rows of the stretch among the rows of the test.
    pub(crate) rows: Range<usize>,
    pub(crate) prefix: Arc<Prefix>,
    /// p, number of unknowns ξ.
    p: usize,
    /// (P, R, S⁻¹, G, Ψ) of each segment: four N × N and an N × p matrix, by columns.
    links: Vec<f64>,
    /// (P, Ψ) after the last segment: r × r, n × p, by rows.
    end: (Vec<f64>, Vec<f64>),
}

/// The measurement that the rows of a segment are, and P and Ψ before it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Link<'a, const N: usize> {
    pub(crate) P: Square<N>,
    pub(crate) R: Square<N>,
    /// S⁻¹.
    pub(crate) weight: Square<N>,
    pub(crate) G: Square<N>,
    pub(crate) Psi: MatrixView<'a, f64, Const<N>, Dyn>,
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
    /// `None` where the sums over the rows of a segment have lost too many digits.
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
    pub(crate) fn moments_of<const N: usize>(&self, segment: usize) -> PrefixMoments<N> {
        self.prefix.after(self.rows_of(segment))
    }

    /// The link of a segment.
    pub(crate) fn link<const N: usize>(&self, segment: usize) -> Link<'_, N> {
        let (size, stride) = (N * N, N * (4 * N + self.p));
        let own = &self.links[segment * stride..][..stride];
        let square = |k: usize| Square::<N>::from_column_slice(&own[k * size..(k + 1) * size]);
        let Psi = MatrixView::from_slice_generic(&own[4 * size..], Const::<N>, Dyn(self.p));
        Link { P: square(0), R: square(1), weight: square(2), G: square(3), Psi }
    }

    /// P (N × N) and Ψ (N × p) before a segment, by columns.
    pub(crate) fn before(&self, segment: usize) -> (&[f64], &[f64]) {
        let N = self.prefix.size();
        let own = &self.links[segment * N * (4 * N + self.p)..][..N * (4 * N + self.p)];
        (&own[..N * N], &own[4 * N * N..])
    }

    /// P (r × r) and Ψ (n × p) after the stretch, by rows.
    pub(crate) fn end(&self) -> (&[f64], &[f64]) {
        (&self.end.0, &self.end.1)
    }

    /// Memory in bytes, without the prefix.
    pub(crate) fn bytes(&self) -> usize {
        8 * (self.links.len() + self.end.0.len() + self.end.1.len()) + 100
    }

    fn filter<const N: usize>(&mut self, r: usize, filter: SegmentFilter<'_>) -> Option<()> {
        let SegmentFilter { P: all, Psi: all_Psi, J: information, log_determinant } = filter;
        let (p, prefix) = (self.p, self.prefix.clone());
        let is_noisy = |i: usize, j: usize| i.max(j) < r;
        let mut P = Square::<N>::from_fn(|i, j| if is_noisy(i, j) { all[i.max(j) * r + i.min(j)] } else { 0.0 });
        let place = |i: usize, k: usize| prefix.states[i] * p + k;
        let mut Psi = OMatrix::<f64, Const<N>, Dyn>::from_fn(p, |i, k| all_Psi[place(i, k)]);
        for segment in 0..self.segments() {
            let rows = self.rows_of(segment);
            let PrefixMoments { P: P_l, Psi: Psi_l, J } = prefix.after::<N>(rows);
            let R = root(&J)?;
            let S = symmetric(&(R * P * R.transpose() + Square::identity()));
            // as in a scalar measurement: the terms of S must not cancel
            let size = |i: usize| (0..N).map(|j| R[(i, j)].powi(2) * P[(j, j)]).sum::<f64>();
            if (0..N).any(|i| S[(i, i)] < MIN_REMAINING * size(i)) {
                return None;
            }
            let S = S.cholesky()?;
            let weight = S.inverse();
            let G = P * R.transpose() * weight;
            let F = Square::identity() - G * R;
            let told = R * &Psi;
            *log_determinant += prefix.log_determinant(rows) + S.ln_determinant();
            let added = told.transpose() * weight * &told;
            (0..p).for_each(|k| (0..=k).for_each(|i| information[i + k * (k + 1) / 2] += added[(i, k)]));
            [P, R, weight, G].iter().for_each(|square| self.links.extend_from_slice(square.as_slice()));
            self.links.extend_from_slice(Psi.as_slice());
            Psi = Psi_l * (&Psi - G * told);
            P = symmetric(&(Psi_l * (F * P * F.transpose() + G * G.transpose()) * Psi_l.transpose() + P_l));
        }
        (0..r * r).for_each(|ij| all[ij] = P[(ij / r, ij % r)]);
        (0..N).for_each(|i| (0..p).for_each(|k| all_Psi[place(i, k)] = Psi[(i, k)]));
        self.end = (all.to_vec(), all_Psi.to_vec());
        Some(())
    }
}
