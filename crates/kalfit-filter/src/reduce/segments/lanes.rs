//! Segments of tests in lanes, for the data pass over whole tests.
#![expect(non_snake_case, reason = "the letters of the theory: Psi")]

use crate::reduce::segments::SegmentedStretch;
use crate::reduce::segments::chain::{ChainMeans, ChainSums};
use crate::reduce::segments::strands::StretchData;

/// Tests in lanes: number k of test t is at k × tests + t.
pub(crate) struct TestsInLanes<'a> {
    pub(crate) data: StretchData<'a>,
    /// Σ T'S⁻¹e, p numbers a test, to which the stretch is added.
    pub(crate) y: &'a mut [f64],
    /// Σ e'S⁻¹e, one number a test, to which the stretch is added.
    pub(crate) square: &'a mut [f64],
}

impl SegmentedStretch {
    /// Filters tests through the stretch; `x`: x̂ of all states of each test. Appends the means of each test to `means`.
    pub(crate) fn filter_tests(&self, tests: TestsInLanes<'_>, x: &mut [f64], means: &mut Vec<ChainMeans>) {
        let TestsInLanes { data, y, square } = tests;
        let (many, states) = (data.tests, &self.prefix.states);
        let before = |test: usize| states.iter().map(move |&state| state * many + test);
        let reference = |test: usize, _: usize, out: &mut [f64]| {
            out.iter_mut().zip(before(test)).for_each(|(out, at)| *out = x[at]);
        };
        let run = self.run(data, reference, false);
        for test in 0..many {
            let mut own: Vec<f64> = before(test).map(|at| x[at]).collect();
            means.push(self.add_chain((&run, test), &mut own, (&mut *y, &mut *square), many));
            own.iter().zip(before(test)).for_each(|(own, at)| x[at] = *own);
        }
    }

    /// Adds Σ T'S⁻¹(e - Tξ) and Σ (e - Tξ)'S⁻¹(e - Tξ) of each test; `means`: of [`SegmentedStretch::filter_tests`],
    /// `xi`: ξ of each test. The segments run again from the states that follow from ξ, so that nothing cancels.
    pub(crate) fn add_at(&self, tests: TestsInLanes<'_>, xi: &[f64], means: &[ChainMeans]) {
        let TestsInLanes { data, y, square } = tests;
        let (many, size) = (data.tests, self.prefix.size());
        let p = y.len() / many;
        let reference = |test: usize, segment: usize, out: &mut [f64]| {
            let (x, Psi) = (means[test].of(segment, size)[0], self.link(segment).Psi);
            for i in 0..size {
                out[i] = x[i] + (0..p).map(|k| Psi[i * p + k] * xi[k * many + test]).sum::<f64>();
            }
        };
        let run = self.run(data, reference, false);
        for test in 0..many {
            let mut own = vec![0.0; size];
            reference(test, 0, &mut own);
            self.add_chain((&run, test), &mut own, (&mut *y, &mut *square), many);
        }
    }

    fn add_chain(
        &self,
        (run, test): (&crate::reduce::segments::strands::SegmentData, usize),
        x: &mut [f64],
        (y, square): (&mut [f64], &mut [f64]),
        tests: usize,
    ) -> ChainMeans {
        let mut own = vec![0.0; y.len() / tests];
        let mut sums = ChainSums { y: &mut own, square: 0.0 };
        let means = self.chain((run, test), x, &mut sums);
        square[test] += sums.square;
        own.iter().enumerate().for_each(|(k, own)| y[k * tests + test] += own);
        means
    }
}
