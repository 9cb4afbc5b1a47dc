//! The chain of the segments of one test: from what the rows of each segment say to x̂ before each segment and y of ξ.

use crate::reduce::scan::with_states;
use crate::reduce::segments::root::root_data;
use crate::reduce::segments::strands::{OneSegment, SegmentData};
use crate::reduce::segments::stretch::Link;
use crate::reduce::segments::{SegmentedStretch, Vector};

/// Sums over the rows of a stretch of one test, for a given ξ.
#[derive(Debug)]
pub(crate) struct ChainSums {
    /// Σ T'S⁻¹e, p numbers.
    pub(crate) y: Vec<f64>,
    /// Σ e'S⁻¹e.
    pub(crate) square: f64,
    /// Sum of what is subtracted in `square`.
    pub(crate) cancelled: f64,
}

/// x̂ of a test before each segment, and the adjoints b of x̂ from the rows of the segment alone. The rows are the
/// measurement d of Rδ, R'd = y, and leave q - d'd:
///
/// ```text
/// g = x̂ - x̄        w = d - Rg        b = R'S⁻¹w        x̂⁺ = x̂ + Gw        next segment: x̂ = last x̂ of the rows + Ψ_l (x̂⁺ - x̄)
/// Σ e'S⁻¹e: q - d'd + w'S⁻¹w        Σ T'S⁻¹e: Ψ'b
/// ```
#[derive(Debug, Default, Clone)]
pub(crate) struct ChainMeans {
    /// (x̂, g, b) of each segment, 3N numbers.
    numbers: Vec<f64>,
}

impl SegmentedStretch {
    /// Moves the filtered state `x` (N) of a test through the segments.
    pub(crate) fn chain(&self, of: (&SegmentData, usize), x: &mut [f64]) -> (ChainMeans, ChainSums) {
        with_states!(self.prefix.size(), N => self.chain_sized::<N>(of, x))
    }

    fn chain_sized<const N: usize>(
        &self,
        (data, test): (&SegmentData, usize),
        state: &mut [f64],
    ) -> (ChainMeans, ChainSums) {
        let mut means = ChainMeans { numbers: Vec::with_capacity(3 * N * self.segments()) };
        let mut sums = ChainSums { y: Vec::new(), square: 0.0, cancelled: 0.0 };
        let mut x = Vector::<N>::from_column_slice(state);
        for segment in 0..self.segments() {
            let Link { R, weight, G, Psi, .. } = self.link::<N>(segment);
            let OneSegment { reference, y, last, q } = data.of::<N>(test, segment);
            let (d, g) = (root_data(&R, &y), x - reference);
            let w = d - R * g;
            let b = R.transpose() * (weight * w);
            sums.square += q - d.norm_squared() + w.dot(&(weight * w));
            sums.cancelled += d.norm_squared();
            sums.y.resize(Psi.ncols(), 0.0);
            sums.y.iter_mut().zip(Psi.column_iter()).for_each(|(sum, column)| *sum += column.dot(&b));
            [x, g, b].iter().for_each(|numbers| means.numbers.extend_from_slice(numbers.as_slice()));
            x = last + self.moments_of::<N>(segment).Psi * (g + G * w);
        }
        state.copy_from_slice(x.as_slice());
        (means, sums)
    }
}

impl ChainMeans {
    /// (x̂, g, b) of a segment.
    pub(crate) fn of<const N: usize>(&self, segment: usize) -> [Vector<N>; 3] {
        let own = &self.numbers[3 * N * segment..][..3 * N];
        std::array::from_fn(|k| Vector::from_column_slice(&own[k * N..(k + 1) * N]))
    }
}
