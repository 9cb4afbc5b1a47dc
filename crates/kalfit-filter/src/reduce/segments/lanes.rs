//! Segments of tests in lanes, for the data pass over whole tests.
#![expect(non_snake_case, reason = "the letters of the theory: J, Psi")]

use crate::reduce::scan::with_states;
use crate::reduce::segments::SegmentedStretch;
use crate::reduce::segments::chain::{ChainMeans, ChainSums};
use crate::reduce::segments::square::{product, square, symmetric, times};
use crate::reduce::segments::strands::{SegmentData, StretchData};
use crate::reduce::segments::stretch::add_congruence;
use crate::reduce::semidefinite::information_root;
use kalfit_algebra::symmetric::pairs;

/// Least scaled pivot of the information of a first segment about ξ that tells where to start, and least fraction of the
/// information that is left where the other states are uncertain.
const LEAST_PIVOT: f64 = 1e-6;

/// Largest ratio of what is subtracted in a sum of squares to the sum.
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
    /// Means of each test.
    means: Vec<ChainMeans>,
}

impl SegmentedStretch {
    /// Filters tests through the stretch; `x`: x̂ of all states of each test, before and then after it.
    pub(crate) fn filter_tests(&self, tests: TestsInLanes<'_>, x: &mut [f64]) -> FilteredStretch {
        let TestsInLanes { data, y, square } = tests;
        let (many, states, p) = (data.tests, &self.prefix.states, y.len() / data.tests);
        let before = |test: usize| states.iter().map(move |&state| state * many + test);
        let near = self.near_unknowns(data, |test, out| {
            out.iter_mut().zip(before(test)).for_each(|(out, at)| *out = x[at]);
        });
        let Psi = self.link(0).Psi;
        let reference = |test: usize, _: usize, out: &mut [f64]| {
            for ((i, out), at) in out.iter_mut().enumerate().zip(before(test)) {
                *out = x[at] + (0..p).map(|k| Psi[i * p + k] * near[test * p + k]).sum::<f64>();
            }
        };
        let run = self.run(data, reference, false);
        let start: Vec<f64> = x.to_vec();
        let mut filtered = FilteredStretch { data: run, means: Vec::with_capacity(many) };
        for test in 0..many {
            let mut own: Vec<f64> = before(test).map(|at| start[at]).collect();
            let means = self.chain((&filtered.data, test), &mut own, &mut ChainSums::zeros(p));
            filtered.means.push(means);
            own.iter().zip(before(test)).for_each(|(own, at)| x[at] = *own);
        }
        self.add_at(TestsInLanes { data, y, square }, &vec![0.0; p * many], &filtered);
        filtered
    }

    /// Adds Σ T'S⁻¹(e - Tξ) and Σ (e - Tξ)'S⁻¹(e - Tξ) of each test. `xi`: ξ of each test. Where too much cancels, the
    /// segments run again from the states that follow from ξ.
    pub(crate) fn add_at(&self, tests: TestsInLanes<'_>, xi: &[f64], filtered: &FilteredStretch) {
        let TestsInLanes { data, y, square } = tests;
        let (many, size, p) = (data.tests, self.prefix.size(), y.len() / data.tests);
        let mean = |test: usize, segment: usize, out: &mut [f64]| {
            let (x, Psi) = (filtered.means[test].of(segment, size)[0], self.link(segment).Psi);
            for i in 0..size {
                out[i] = x[i] + (0..p).map(|k| Psi[i * p + k] * xi[k * many + test]).sum::<f64>();
            }
        };
        let sums = |run: &SegmentData, test: usize| {
            let (mut sums, mut own) = (ChainSums::zeros(p), vec![0.0; size]);
            mean(test, 0, &mut own);
            self.chain((run, test), &mut own, &mut sums);
            sums
        };
        let mut again = None;
        for test in 0..many {
            let mut own = sums(&filtered.data, test);
            if own.cancelled > MOST_CANCELLED * own.square || own.square.is_nan() {
                own = sums(again.get_or_insert_with(|| self.run(data, mean, false)), test);
            }
            own.add_to((&mut *y, &mut *square), (test, many));
        }
    }

    /// ξ of each test, p numbers, from the first segment alone, so that references are near the states of the test; zero
    /// where the segment says too little. `start`: writes x̂ of a test before the stretch.
    fn near_unknowns(&self, data: StretchData<'_>, start: impl Fn(usize, &mut [f64])) -> Vec<f64> {
        let run = self.run_first(data, |test, _, out| start(test, out));
        with_states!(self.prefix.size(), N => self.near_sized::<N>(data.tests, &run))
    }

    fn near_sized<const N: usize>(&self, tests: usize, run: &SegmentData) -> Vec<f64> {
        let (link, moments) = (self.link(0), self.moments_of(0));
        let p = link.Psi.len() / N.max(1);
        let B = square::<N>(link.B);
        let mut J = vec![0.0; pairs(p)];
        let of_state = square::<N>(moments.J);
        add_congruence(&symmetric(&product(&B, &of_state)), link.Psi, p, &mut J);
        for k in 0..p {
            // what the rows would tell if the states were otherwise known
            let all: f64 = (0..N).map(|i| link.Psi[i * p + k].powi(2) * of_state[i][i]).sum();
            if J[k * (k + 3) / 2] < LEAST_PIVOT * all {
                (0..p).for_each(|i| J[k.min(i) + k.max(i) * (k.max(i) + 1) / 2] = 0.0);
            }
        }
        let root = information_root(&J, p, LEAST_PIVOT).0;
        let at = |i: usize, k: usize| root[i + k * (k + 1) / 2];
        let solved = |x: f64, pivot: f64| if pivot > 0.0 { x / pivot } else { 0.0 };
        let mut all = Vec::with_capacity(tests * p);
        for test in 0..tests {
            let b = times(&B, &run.of::<N>(test, 0).y);
            let mut xi: Vec<f64> = (0..p).map(|k| (0..N).map(|i| link.Psi[i * p + k] * b[i]).sum()).collect();
            for k in 0..p {
                xi[k] = solved((0..k).fold(xi[k], |left, i| left - at(i, k) * xi[i]), at(k, k));
            }
            for k in (0..p).rev() {
                xi[k] = solved((k + 1..p).fold(xi[k], |left, j| left - at(k, j) * xi[j]), at(k, k));
            }
            all.extend(xi);
        }
        all
    }
}

impl ChainSums {
    fn zeros(p: usize) -> ChainSums {
        ChainSums { y: vec![0.0; p], square: 0.0, cancelled: 0.0 }
    }

    /// Adds the sums to those of a test in lanes.
    fn add_to(&self, (y, square): (&mut [f64], &mut [f64]), (test, tests): (usize, usize)) {
        square[test] += self.square;
        self.y.iter().enumerate().for_each(|(k, own)| y[k * tests + test] += own);
    }
}
