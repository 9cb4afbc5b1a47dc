//! The chain of the segments of one test: from what the rows of each segment say to x̂ before each segment and y of ξ.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, J, B")]

use crate::reduce::scan::with_states;
use crate::reduce::segments::SegmentedStretch;
use crate::reduce::segments::square::{Square, added, dot, square, times};
use crate::reduce::segments::strands::{OneSegment, SegmentData};

/// Sums over the rows of a stretch of one test, for a given ξ.
pub(crate) struct ChainSums {
    /// Σ T'S⁻¹e, p numbers.
    pub(crate) y: Vec<f64>,
    /// Σ e'S⁻¹e.
    pub(crate) square: f64,
    /// Sum of the magnitudes of all terms that are subtracted in `square`.
    pub(crate) cancelled: f64,
}

/// x̂ of a test before each segment, and the adjoints b of x̂ from the rows of the segment alone:
///
/// ```text
/// g = x̂ - x̄        b = B(y - Jg)        x̂⁺ = x̂ + Pb        next segment: x̂ = last x̂ of the rows + Ψ_l (x̂⁺ - x̄)
/// Σ e'S⁻¹e: q - g'(2y - Jg) - (y - Jg)'Pb        Σ T'S⁻¹e: Ψ'b
/// ```
#[derive(Debug, Default, Clone)]
pub(crate) struct ChainMeans {
    /// (x̂, g, b) of each segment, 3N numbers.
    pub(crate) numbers: Vec<f64>,
}

impl SegmentedStretch {
    /// Moves the filtered state `x` (N) of a test through the segments.
    pub(crate) fn chain(&self, (data, test): (&SegmentData, usize), x: &mut [f64], sums: &mut ChainSums) -> ChainMeans {
        with_states!(self.prefix.size(), N => self.chain_sized::<N>((data, test), x, sums))
    }

    /// As [`SegmentedStretch::chain`], without sums.
    pub(crate) fn chain_means(&self, of: (&SegmentData, usize), x: &mut [f64]) -> ChainMeans {
        self.chain(of, x, &mut ChainSums { y: Vec::new(), square: 0.0, cancelled: 0.0 })
    }

    fn chain_sized<const N: usize>(
        &self,
        (data, test): (&SegmentData, usize),
        state: &mut [f64],
        sums: &mut ChainSums,
    ) -> ChainMeans {
        let p = sums.y.len();
        let mut means = ChainMeans { numbers: Vec::with_capacity(3 * N * self.segments()) };
        let mut x = [0.0; N];
        x.copy_from_slice(state);
        for segment in 0..self.segments() {
            let (link, moments) = (self.link(segment), self.moments_of(segment));
            let (P, B): (Square<N>, Square<N>) = (square(link.P), square(link.B));
            let (J, Psi_l): (Square<N>, Square<N>) = (square(moments.J), square(moments.Psi));
            let OneSegment { reference, y, last, q } = data.of::<N>(test, segment);
            let g = added(&x, -1.0, &reference);
            let a = added(&y, -1.0, &times(&J, &g));
            let b = times(&B, &a);
            let moved = times(&P, &b);
            sums.square += q - dot(&g, &added(&y, 1.0, &a)) - dot(&a, &moved);
            for i in 0..N {
                let of_row: f64 = (0..N).map(|j| (J[i][j] * g[j]).abs()).sum();
                sums.cancelled += g[i].abs() * of_row + (a[i] * moved[i]).abs();
            }
            for k in 0..p {
                sums.y[k] += (0..N).map(|i| link.Psi[i * p + k] * b[i]).sum::<f64>();
            }
            [x, g, b].iter().for_each(|numbers| means.numbers.extend_from_slice(numbers));
            x = added(&last, 1.0, &times(&Psi_l, &added(&g, 1.0, &moved)));
        }
        state.copy_from_slice(&x);
        means
    }
}

impl ChainMeans {
    /// (x̂, g, b) of a segment of N states.
    pub(crate) fn of(&self, segment: usize, N: usize) -> [&[f64]; 3] {
        let own = &self.numbers[3 * N * segment..][..3 * N];
        [&own[..N], &own[N..2 * N], &own[2 * N..]]
    }
}
