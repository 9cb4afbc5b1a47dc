//! The backward pass over stretches of equal steps that are cut into segments.
//!
//! A segment starts from a known state, so its adjoints have two parts. The data's part goes through the rows, many
//! segments in lanes ([`strands`]), from the smoothed state δ̂ before the segment and the adjoint r of the state after
//! it, which the chain gives ([`chain`]). The design's part is one reverse pass over the prefix that all segments share
//! ([`prefix`]): what a segment adds is linear in the moments V, P̄ and Ψ̄ at its last row, so these are summed first.

mod chain;
mod prefix;
mod strands;

use crate::reduce::segments::SegmentedStretch;
use crate::reduce::segments::chain::ChainMeans;
use crate::reduce::segments::strands::{SegmentData, StretchData};
use crate::score::backward::AdjointsWanted;

pub(crate) use chain::{DesignAdjoints, StateAdjoints};
pub(crate) use strands::DataAdjoints;

/// The forward pass of tests over a stretch, for a backward pass.
#[derive(Debug)]
pub(crate) struct ForwardStretch {
    data: SegmentData,
    /// Means before the segments of each test.
    means: Vec<ChainMeans>,
}

impl ForwardStretch {
    /// Runs tests in lanes through a stretch; `x`: x̄ of the states of the segments, before the stretch and then after
    /// it, that of state i of test t at i × tests + t.
    pub(crate) fn new(stretch: &SegmentedStretch, data: StretchData<'_>, x: &mut [f64]) -> ForwardStretch {
        let tests = data.tests;
        let reference = |test: usize, _: usize, out: &mut [f64]| {
            out.iter_mut().enumerate().for_each(|(i, out)| *out = x[i * tests + test]);
        };
        let run = stretch.run(data, reference, true);
        let means = (0..tests).map(|test| {
            let mut own: Vec<f64> = x.iter().skip(test).step_by(tests).copied().collect();
            let means = stretch.chain((&run, test), &mut own).0;
            own.iter().enumerate().for_each(|(i, own)| x[i * tests + test] = *own);
            means
        });
        let means = means.collect();
        ForwardStretch { data: run, means }
    }

    /// The data's part of the adjoints of each test; `r`: the adjoints of the states after the stretch and then before
    /// it, in lanes as x̄.
    pub(crate) fn back(
        &self,
        stretch: &SegmentedStretch,
        (data, wanted): (StretchData<'_>, AdjointsWanted),
        r: &mut [f64],
    ) -> Vec<DataAdjoints> {
        let (tests, size) = (data.tests, stretch.prefix.size());
        let mut ends = Vec::with_capacity(tests * stretch.segments() * 2 * size);
        for (test, means) in self.means.iter().enumerate() {
            let mut own: Vec<f64> = r.iter().skip(test).step_by(tests).copied().collect();
            chain::means_back(stretch, means, &mut own, &mut ends);
            own.iter().enumerate().for_each(|(i, own)| r[i * tests + test] = *own);
        }
        strands::back(stretch, &self.data, data, &ends, wanted)
    }
}
