//! Random models as matrices of all measurements: V = Σ Z_g Σ Z_g' over the groups g of all levels, plus noise.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::small_sample::effects::CrossedEffects;
use crate::small_sample::forest::{Forest, Leaf};
use crate::small_sample::theta::{SigmaElement, Theta};
use kalfit_algebra::symmetric::{pair, pairs};
use kalfit_model::{Grouping, Label};

/// Levels of groups, crossed factors, states, regressors, and the rank of the Σ of the tests.
#[derive(Clone, Copy)]
pub(super) struct Shape {
    pub(super) depth: usize,
    pub(super) factors: usize,
    pub(super) p: usize,
    pub(super) regressors: usize,
    pub(super) rank: usize,
}

#[derive(Clone)]
struct Rows {
    h: DMatrix<f64>,
    x: DMatrix<f64>,
    z: DVector<f64>,
    groups: Vec<usize>,
}

/// Tests with one free variance of noise.
#[derive(Clone)]
pub(super) struct Dense {
    shape: Shape,
    noise: f64,
    tests: Vec<Rows>,
    roots: Vec<DMatrix<f64>>,
}

impl Dense {
    pub(super) fn drawn(shape: Shape, seed: u64) -> Dense {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut number = || random.random::<f64>() * 2.0 - 1.0;
        let (p, depth, factors) = (shape.p, shape.depth, shape.factors);
        let test = |j: usize, number: &mut dyn FnMut() -> f64| {
            let rows = 1 + j % 4 + usize::from(depth + factors == 0) * p;
            let mut x = DMatrix::zeros(p, p + shape.regressors);
            x.view_mut((0, 0), (p, p)).fill_with_identity();
            (0..shape.regressors).for_each(|c| x[(c % p, p + c)] = number());
            let h = DMatrix::from_fn(rows, p, |_, _| number());
            let z = DVector::from_fn(rows, |_, _| 2.0 * number());
            let nested = (0..depth).map(|level| j / 3 / (1 + level * 2));
            let groups =
                nested.chain((0..factors).map(|factor| (j * (2 + factor) + j / 5) % (3 + 2 * factor))).collect();
            Rows { h, x, z, groups }
        };
        let tests = (0..14).map(|j| test(j, &mut number)).collect();
        let mut root = |rank: usize| DMatrix::from_fn(p, p, |_, c| if c < rank { number() } else { 0.0 });
        let roots = (0..=depth + factors).map(|level| root(if level == 0 { shape.rank } else { p })).collect();
        Dense { shape, noise: 0.4, tests, roots }
    }

    /// Tests of one design with two states.
    pub(super) fn balanced(n: usize) -> Dense {
        let shape = Shape { depth: 0, factors: 0, p: 2, regressors: 0, rank: 2 };
        let first = Dense { noise: 1.0, ..Dense::drawn(shape, 5) };
        Dense { tests: vec![first.tests[2].clone(); n], ..first }
    }

    pub(super) fn reversed(&self) -> Dense {
        Dense { tests: self.tests.iter().rev().cloned().collect(), ..self.clone() }
    }

    pub(super) fn means(&self) -> usize {
        self.shape.p + self.shape.regressors
    }

    fn theta(&self, noises: usize) -> Theta {
        let p = self.shape.p;
        let own = |blocks: Arc<[usize]>| -> Vec<SigmaElement> {
            let all = (0..p).flat_map(|i| (0..=i).map(move |j| (i, j)));
            all.map(|(i, j)| SigmaElement { i, j, unit: 1.0, blocks: Arc::clone(&blocks) }).collect()
        };
        let mut levels = vec![own(Arc::new([0])); self.shape.depth + 1];
        if let Some(effects) = self.effects() {
            let blocks = (0..self.shape.factors).filter_map(|factor| effects.blocks_of(self.shape.depth + 1 + factor));
            levels.push(blocks.flat_map(own).collect());
        }
        let n = noises + levels.iter().map(Vec::len).sum::<usize>();
        Theta { noises, elements: (0..n - noises).collect(), levels, directions: DMatrix::identity(n, n) }
    }

    fn grouping(&self) -> Grouping {
        let path = |test: &Rows| test.groups.iter().rev().map(|&group| Label::literal(group)).collect::<Vec<_>>();
        let names: Vec<String> = (0..self.tests.len()).map(|j| j.to_string()).collect();
        Grouping::crossed(
            (self.shape.factors, self.shape.depth),
            names.iter().zip(&self.tests).map(|(id, test)| (id.as_str(), path(test))),
        )
    }

    fn effects(&self) -> Option<CrossedEffects> {
        CrossedEffects::of(&Arc::new(self.grouping()), self.shape.p)
    }

    pub(super) fn forest(&self) -> (Forest, Theta, Vec<DMatrix<f64>>) {
        let (grouping, effects) = (self.grouping(), self.effects());
        let crossed = effects.as_ref().map_or(0, CrossedEffects::len);
        let leaf = |(j, test): (usize, &Rows)| {
            let (p, q, rows) = (self.shape.p, self.means(), test.h.nrows());
            let first = p + crossed;
            let mut all = DMatrix::zeros(rows, first + q + 1);
            all.columns_mut(0, p).copy_from(&test.h);
            for (state, effect) in effects.iter().flat_map(|effects| effects.met_by(&j.to_string()).expect("a test")) {
                all.column_mut(p + effect).axpy(1.0, &test.h.column(state), 1.0);
            }
            all.columns_mut(first, q).copy_from(&(&test.h * &test.x));
            all.set_column(first + q, &test.z);
            let (plain, v) = (all.transpose() * &all, self.noise);
            let log = -(rows as f64) / (v * v);
            Leaf {
                slopes: vec![&plain * -v.powi(-2)],
                curvatures: vec![&plain * (2.0 * v.powi(-3))],
                k: plain / v,
                log_curvatures: vec![log],
            }
        };
        let numbers = (0..self.tests.len()).collect::<Vec<_>>();
        let grouped = (grouping.depth() > 0).then_some((&grouping, &numbers[..]));
        let forest = Forest::of(self.tests.iter().enumerate().map(leaf).collect(), grouped);
        let mut roots = self.roots.clone();
        if let Some(effects) = &effects {
            let of_factors = roots.split_off(effects.first_block());
            roots.push(effects.root(&of_factors));
        }
        (Forest { crossed, ..forest }, self.theta(1), roots)
    }

    pub(super) fn forest_without_data(&self) -> (Forest, Theta, Vec<DMatrix<f64>>) {
        let leaf = |test: &Rows| {
            let p = self.shape.p;
            let mut all = DMatrix::zeros(test.h.nrows(), p + self.means());
            all.columns_mut(0, p).copy_from(&test.h);
            all.columns_mut(p, self.means()).copy_from(&(&test.h * &test.x));
            Leaf { k: all.transpose() * &all, slopes: vec![], curvatures: vec![], log_curvatures: vec![] }
        };
        (Forest::of(self.tests.iter().map(leaf).collect(), None), self.theta(0), self.roots.clone())
    }

    fn starts(&self) -> Vec<usize> {
        self.tests.iter().scan(0, |at, test| Some(std::mem::replace(at, *at + test.h.nrows()))).collect()
    }

    fn size(&self) -> usize {
        self.tests.iter().map(|test| test.h.nrows()).sum()
    }

    /// Σ_g Z_g S Z_g' over the groups of a level.
    fn spread(&self, level: usize, s: &DMatrix<f64>) -> DMatrix<f64> {
        let mut whole = DMatrix::zeros(self.size(), self.size());
        let grouping = self.grouping();
        let starts = self.starts();
        let group = |j: usize| level.checked_sub(1).map_or(j, |level| grouping.group_of(j, level));
        for (j, one) in self.tests.iter().enumerate() {
            for (k, other) in self.tests.iter().enumerate().filter(|(k, _)| group(*k) == group(j)) {
                let block = &one.h * s * other.h.transpose();
                whole.view_mut((starts[j], starts[k]), block.shape()).copy_from(&block);
            }
        }
        whole
    }

    fn precision(&self) -> DMatrix<f64> {
        let mut v = DMatrix::identity(self.size(), self.size()) * self.noise;
        self.roots.iter().enumerate().for_each(|(level, f)| v += self.spread(level, &(f * f.transpose())));
        v.try_inverse().expect("noise is positive")
    }

    /// V_a.
    fn slope(&self, a: usize) -> DMatrix<f64> {
        let (p, per) = (self.shape.p, pairs(self.shape.p));
        let Some(element) = a.checked_sub(1) else { return DMatrix::identity(self.size(), self.size()) };
        let s = DMatrix::from_fn(p, p, |i, j| f64::from(u8::from(pair(i, j) == element % per)));
        self.spread(element / per, &s)
    }

    fn x(&self) -> DMatrix<f64> {
        let mut x = DMatrix::zeros(self.size(), self.means());
        for (test, start) in self.tests.iter().zip(self.starts()) {
            x.rows_mut(start, test.h.nrows()).copy_from(&(&test.h * &test.x));
        }
        x
    }

    fn count(&self) -> usize {
        1 + (self.shape.depth + self.shape.factors + 1) * pairs(self.shape.p)
    }

    pub(super) fn c(&self) -> DMatrix<f64> {
        let x = self.x();
        (x.transpose() * self.precision() * x).try_inverse().expect("the mean is identified")
    }

    pub(super) fn m(&self, a: usize) -> DMatrix<f64> {
        let (x, w) = (self.x(), self.precision());
        -(x.transpose() * &w * self.slope(a) * &w * x)
    }

    fn projected(&self) -> DMatrix<f64> {
        let (x, w) = (self.x(), self.precision());
        let half = &w * x;
        &w - &half * self.c() * half.transpose()
    }

    fn data(&self) -> DMatrix<f64> {
        let all = self.tests.iter().flat_map(|test| test.z.iter().copied());
        DMatrix::from_iterator(self.size(), 1, all)
    }

    /// ∂β̂/∂θ_a.
    pub(super) fn moved(&self, a: usize) -> DMatrix<f64> {
        -(self.c() * self.x().transpose() * self.precision() * self.slope(a) * self.projected() * self.data())
    }

    pub(super) fn expected(&self) -> DMatrix<f64> {
        let p = self.projected();
        let all: Vec<DMatrix<f64>> = (0..self.count()).map(|a| &p * self.slope(a)).collect();
        DMatrix::from_fn(all.len(), all.len(), |a, b| 0.5 * all[a].dot(&all[b].transpose()))
    }

    pub(super) fn observed(&self) -> DMatrix<f64> {
        let (p, z) = (self.projected(), self.data());
        let all: Vec<DMatrix<f64>> = (0..self.count()).map(|a| self.slope(a)).collect();
        let r = &p * z;
        let square = |a: usize, b: usize| (r.transpose() * &all[a] * &p * &all[b] * &r)[(0, 0)];
        let expected = self.expected();
        DMatrix::from_fn(all.len(), all.len(), |a, b| square(a, b) - expected[(a, b)])
    }

    /// C_A by its definition.
    pub(super) fn adjusted(&self, v: &DMatrix<f64>) -> DMatrix<f64> {
        let (x, w, c) = (self.x(), self.precision(), self.c());
        let mut sum = DMatrix::zeros(self.means(), self.means());
        for a in 0..self.count() {
            for b in 0..self.count() {
                let q = x.transpose() * &w * self.slope(a) * &w * self.slope(b) * &w * &x;
                sum += (q - self.m(a) * &c * self.m(b)) * v[(a, b)];
            }
        }
        &c + &c * sum * &c * 2.0
    }
}
