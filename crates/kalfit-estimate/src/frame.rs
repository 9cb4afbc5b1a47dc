//! The frame, which is the coordinates η of estimation, from sums over all tests.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use kalfit_algebra::symmetric;
use kalfit_algebra::symmetric::{pair, pairs};
use kalfit_filter::reduce::Reductions;
use kalfit_model::ExactRows;

pub(crate) use kalfit_model::remote::Coordinates as Frame;

/// Number of tests that form one partial sum.
const TESTS_PER_SUM: usize = 1024;

/// A covariate whose standard deviation is below this fraction of its size counts as constant. The square is about the
/// rounding error of a variance that is a difference of sums.
const CONSTANT: f64 = 1e-8;

/// Sums over tests that determine the frame.
pub(super) struct Pooled {
    /// Σ R'R, p × p, packed.
    information: Vec<f64>,
    /// Number of tests that inform each state.
    informed: Vec<f64>,
    /// Σ R'd.
    y: Vec<f64>,
    /// Σ x over tests for each covariate x.
    sums: Vec<f64>,
    /// Σ x² over tests for each covariate x.
    squares: Vec<f64>,
    tests: f64,
}

impl Pooled {
    /// The coordinates η: the centre is the pooled least-squares estimate, and the scale gives unit information on each
    /// state to the average test that informs the state. A covariate of `centred` is centred at its average.
    pub(super) fn frame(&self, centred: &[bool]) -> Frame {
        let Pooled { information, informed, y, tests, .. } = self;
        let p = y.len();
        let entry = |i: usize, k: usize| information[pair(i.max(k), i.min(k))];
        let unit = |i: usize| if entry(i, i) > 0.0 { (informed[i] / entry(i, i)).sqrt() } else { 1.0 };
        let scale: Vec<f64> = (0..p).map(unit).collect();
        let scaled = DMatrix::from_fn(p, p, |i, k| scale[i] * entry(i, k) * scale[k]);
        let right = DVector::from_fn(p, |i, _| scale[i] * y[i]);
        let solution = symmetric::pseudo_solve(&scaled, &right);
        let centre = (0..p).map(|i| scale[i] * solution[i]).collect();
        let covariates = (0..centred.len()).map(|c| self.covariate(c, tests.max(1.0), centred[c]));
        let (covariate_centre, covariate_scale) = covariates.unzip();
        Frame { centre, scale, covariate_centre, covariate_scale }
    }

    /// Centre and scale of a covariate: average and standard deviation if it is centred, else zero and the root of the
    /// mean square. A constant is not centred: nothing would remain.
    fn covariate(&self, c: usize, tests: f64, centred: bool) -> (f64, f64) {
        let (average, square) = (self.sums[c] / tests, self.squares[c] / tests);
        let variance = square - average * average;
        match square.sqrt() {
            _ if centred && variance > CONSTANT.powi(2) * square => (average, variance.sqrt()),
            size if size > 0.0 => (0.0, size),
            _ => (0.0, 1.0),
        }
    }

    pub(super) fn none((p, regressors): (usize, usize)) -> Pooled {
        Pooled {
            information: vec![0.0; pairs(p)],
            informed: vec![0.0; p],
            y: vec![0.0; p],
            sums: vec![0.0; regressors],
            squares: vec![0.0; regressors],
            tests: 0.0,
        }
    }

    /// Sums over the reductions of the indices in `order`, which must not depend on the order of the data.
    pub(super) fn all(reductions: &Reductions, order: &[usize], (p, regressors): (usize, usize)) -> Pooled {
        let units = &exact_units(reductions, order);
        let of = |part| Pooled::of((reductions, units), part, (p, regressors));
        let parts: Vec<Pooled> = order.par_chunks(TESTS_PER_SUM).map(of).collect();
        parts.iter().fold(Pooled::none((p, regressors)), |sum, part| sum.plus(part))
    }

    /// The sums as a list; lists of several places can be added up.
    pub(super) fn numbers(&self) -> Vec<f64> {
        let Pooled { information, informed, y, sums, squares, tests } = self;
        [information, informed, y, sums, squares].into_iter().flatten().copied().chain([*tests]).collect()
    }

    /// The sums from a list that `numbers` has made; `None` where the length is wrong.
    pub(super) fn of_numbers((p, regressors): (usize, usize), numbers: &[f64]) -> Option<Pooled> {
        let (information, rest) = numbers.split_at_checked(pairs(p))?;
        let (informed, rest) = rest.split_at_checked(p)?;
        let (y, rest) = rest.split_at_checked(p)?;
        let (sums, rest) = rest.split_at_checked(regressors)?;
        let (squares, rest) = rest.split_at_checked(regressors)?;
        let [tests] = *rest else { return None };
        let [information, informed, y, sums, squares] = [information, informed, y, sums, squares].map(<[f64]>::to_vec);
        Some(Pooled { information, informed, y, sums, squares, tests })
    }

    /// Σ R'R in η, p × p.
    pub(super) fn information(&self, frame: &Frame) -> DMatrix<f64> {
        let (p, scale) = (self.y.len(), &frame.scale);
        DMatrix::from_fn(p, p, |i, k| scale[i] * self.information[pair(i, k)] * scale[k])
    }

    fn of((reductions, units): (&Reductions, &[f64]), tests: &[usize], (p, regressors): (usize, usize)) -> Pooled {
        let mut sum = Pooled { tests: tests.len() as f64, ..Pooled::none((p, regressors)) };
        for &j in tests {
            let (factor, data) = (reductions.factor(j), reductions.data(j));
            for k in 0..p {
                let column = &factor[pair(k, 0)..][..=k];
                for i in 0..=k {
                    sum.information[pair(k, i)] += dot(&factor[pair(i, 0)..][..=i], column);
                }
                sum.informed[k] += f64::from(u8::from(column.iter().any(|x| *x != 0.0)));
                sum.y[k] += dot(column, data);
            }
            if let Some(exact) = reductions.exact(j) {
                sum.add_exact(exact, units, factor);
            }
            sum.sums.iter_mut().zip(reductions.covariates(j)).for_each(|(s, x)| *s += x);
            sum.squares.iter_mut().zip(reductions.covariates(j)).for_each(|(s, x)| *s += x * x);
        }
        sum
    }

    /// Adds the exact rows of a test as measurements with the standard deviations `units`: the sums only serve to
    /// choose coordinates.
    fn add_exact(&mut self, exact: &ExactRows, units: &[f64], factor: &[f64]) {
        let p = self.y.len();
        for ((row, value), unit) in exact.rows(p).zip(units) {
            let weight = unit.powi(-2);
            for k in 0..p {
                (0..=k).for_each(|i| self.information[pair(k, i)] += weight * row[i] * row[k]);
                self.y[k] += weight * row[k] * value;
            }
        }
        for k in 0..p {
            let known = factor[pair(k, 0)..][..=k].iter().any(|x| *x != 0.0);
            let exact_informs = exact.rows(p).any(|(row, _)| row[k] != 0.0);
            self.informed[k] += f64::from(u8::from(exact_informs && !known));
        }
    }

    fn plus(mut self, other: &Pooled) -> Pooled {
        let add = |a: &mut [f64], b: &[f64]| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        add(&mut self.information, &other.information);
        add(&mut self.informed, &other.informed);
        add(&mut self.y, &other.y);
        add(&mut self.sums, &other.sums);
        add(&mut self.squares, &other.squares);
        self.tests += other.tests;
        self
    }
}

/// A unit for the first, second, … value that tests measure exactly: the standard deviation over tests, else the
/// absolute value of the mean, else one.
fn exact_units(reductions: &Reductions, order: &[usize]) -> Vec<f64> {
    let mut found: Vec<Spread> = Vec::new();
    for exact in order.iter().filter_map(|&j| reductions.exact(j)) {
        found.resize_with(found.len().max(exact.values.len()), Spread::default);
        found.iter_mut().zip(&exact.values).for_each(|(spread, value)| spread.add(*value));
    }
    found.iter().map(Spread::unit).collect()
}

/// Mean and scatter of numbers.
#[derive(Debug, Default)]
struct Spread {
    count: f64,
    mean: f64,
    squares: f64,
}

impl Spread {
    fn add(&mut self, value: f64) {
        let off = value - self.mean;
        self.count += 1.0;
        self.mean += off / self.count;
        self.squares += off * (value - self.mean);
    }

    fn unit(&self) -> f64 {
        let deviation = (self.squares / self.count).sqrt();
        [deviation, self.mean.abs(), 1.0].into_iter().find(|unit| unit.is_normal()).unwrap_or(1.0)
    }
}

/// Dot product over the shorter length, by four partial sums.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let size = a.len().min(b.len());
    let (a, b) = (a[..size].chunks_exact(4), b[..size].chunks_exact(4));
    let rest: f64 = a.remainder().iter().zip(b.remainder()).map(|(a, b)| a * b).sum();
    let mut sums = [0.0; 4];
    for (a, b) in a.zip(b) {
        (0..4).for_each(|k| sums[k] += a[k] * b[k]);
    }
    (sums[0] + sums[2]) + (sums[1] + sums[3]) + rest
}
