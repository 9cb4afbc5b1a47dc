//! Segments of tests in lanes, for the data pass over whole tests.
#![expect(non_snake_case, reason = "the letters of the theory: R, Psi")]

use nalgebra::DVector;

use crate::reduce::scan::with_states;
use crate::reduce::segments::chain::{ChainMeans, ChainSums};
use crate::reduce::segments::root::root_data;
use crate::reduce::segments::strands::{SegmentData, StretchData};
use crate::reduce::segments::stretch::Link;
use crate::reduce::segments::{SegmentedStretch, Vector};

/// Fraction of what a segment would tell about ξ, if the states were otherwise known, below which it says too little about
/// ξ to start from.
const LEAST_TOLD: f64 = 1e-6;

/// Largest ratio of what is subtracted in a sum of squares to the sum: a digit may be lost.
const MOST_CANCELLED: f64 = 10.0;

/// Tests in lanes: number k of test t is at k × tests + t.
pub(crate) struct TestsInLanes<'a> {
    pub(crate) data: StretchData<'a>,
    /// Σ T'S⁻¹e, p numbers a test, to which the stretch is added.
    pub(crate) y: &'a mut [f64],
    /// Σ e'S⁻¹e, one number a test, to which the stretch is added.
    pub(crate) square: &'a mut [f64],
}

/// A stretch of tests in lanes after the data pass with ξ = 0.
#[derive(Debug)]
pub(crate) struct FilteredStretch {
    data: SegmentData,
    /// x̂ of each test before the stretch, N numbers.
    before: Vec<f64>,
}

impl SegmentedStretch {
    /// Filters tests through the stretch; `x`: x̂ of all states of each test, before and then after it.
    pub(crate) fn filter_tests(&self, tests: TestsInLanes<'_>, x: &mut [f64]) -> FilteredStretch {
        let (many, states) = (tests.data.tests, &self.prefix.states);
        let places = |test: usize| states.iter().map(move |&state| state * many + test);
        let before: Vec<f64> = (0..many).flat_map(places).map(|at| x[at]).collect();
        let near = with_states!(states.len(), N => self.near::<N>(tests.data, &before));
        let reference = |test: usize, _: usize, out: &mut [f64]| {
            out.copy_from_slice(&near[test * states.len()..][..states.len()]);
        };
        let filtered = FilteredStretch { data: self.run(tests.data, reference, false), before };
        let after = self.add_at(tests, None, &filtered);
        (0..many).flat_map(places).zip(after).for_each(|(at, after)| x[at] = after);
        filtered
    }

    /// Adds Σ T'S⁻¹(e - Tξ) and Σ (e - Tξ)'S⁻¹(e - Tξ) of each test, and returns x̂ of each test after the stretch. `xi`:
    /// ξ of each test, or zero. Where too much cancels, the segments run again from the means that the chain has found.
    pub(crate) fn add_at(&self, tests: TestsInLanes<'_>, xi: Option<&[f64]>, filtered: &FilteredStretch) -> Vec<f64> {
        with_states!(self.prefix.size(), N => self.add_sized::<N>(tests, xi, filtered))
    }

    fn add_sized<const N: usize>(
        &self,
        TestsInLanes { data, y, square }: TestsInLanes<'_>,
        xi: Option<&[f64]>,
        filtered: &FilteredStretch,
    ) -> Vec<f64> {
        let (many, Psi) = (data.tests, self.link::<N>(0).Psi);
        let chain = |run: &SegmentData, test: usize| -> (ChainMeans, ChainSums, Vector<N>) {
            let mut x = Vector::<N>::from_column_slice(&filtered.before[test * N..][..N]);
            if let Some(xi) = xi {
                x += Psi * DVector::from_fn(Psi.ncols(), |k, _| xi[k * many + test]);
            }
            let (means, sums) = self.chain((run, test), x.as_mut_slice());
            (means, sums, x)
        };
        let mut found: Vec<_> = (0..many).map(|test| chain(&filtered.data, test)).collect();
        let loses_digits = |sums: &ChainSums| sums.cancelled > MOST_CANCELLED * sums.square || sums.square.is_nan();
        if found.iter().any(|(_, sums, _)| loses_digits(sums)) {
            let mean = |test: usize, segment: usize, out: &mut [f64]| {
                let [x, _, b] = found[test].0.of::<N>(segment);
                out.copy_from_slice((x + self.link::<N>(segment).P * b).as_slice());
            };
            let again = self.run(data, mean, false);
            for (test, own) in found.iter_mut().enumerate().filter(|(_, own)| loses_digits(&own.1)) {
                *own = chain(&again, test);
            }
        }
        for (test, (_, sums, _)) in found.iter().enumerate() {
            square[test] += sums.square;
            sums.y.iter().enumerate().for_each(|(k, own)| y[k * many + test] += own);
        }
        found.iter().flat_map(|(.., x)| x.iter().copied()).collect()
    }

    /// States of each test near those before the stretch, N numbers, from x̂ and the best ξ of the first segment alone.
    fn near<const N: usize>(&self, data: StretchData<'_>, before: &[f64]) -> Vec<f64> {
        let start = |test: usize, _: usize, out: &mut [f64]| out.copy_from_slice(&before[test * N..][..N]);
        let run = self.run_first(data, start);
        let Link { R, weight, Psi, .. } = self.link::<N>(0);
        let told = R * Psi;
        let mut information = told.transpose() * weight * &told;
        for (k, column) in Psi.column_iter().enumerate() {
            let of_states: f64 = column.iter().zip(R.column_iter()).map(|(Psi, R)| Psi * Psi * R.norm_squared()).sum();
            information[(k, k)] += if of_states > 0.0 { LEAST_TOLD * of_states } else { 1.0 };
        }
        let Some(information) = information.cholesky() else { return before.to_vec() };
        let near = |test: usize| {
            let said = told.transpose() * (weight * root_data(&R, &run.of::<N>(test, 0).y));
            Vector::<N>::from_column_slice(&before[test * N..][..N]) + Psi * information.solve(&said)
        };
        (0..data.tests).flat_map(|test| near(test).iter().copied().collect::<Vec<f64>>()).collect()
    }
}
