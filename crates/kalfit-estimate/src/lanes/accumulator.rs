//! Sums of the likelihood terms of classes, evaluated one by one or in lanes, in one phase or in several, with
//! regressions, and with the terms of the restricted likelihood (theory §3). The mean of test j is E_jm: m has the p
//! elements of μ, then the coefficients of the regressions, M in all.
#![expect(non_snake_case, reason = "W, E, V, X are the letters of the theory")]

use kalfit_lanes::Lanes;
use nalgebra::DMatrix;

use crate::lanes::gather::ProductSums;
use crate::lanes::rows::{add_one, log_det};
use crate::order::Order;
use crate::order::SumsWanted;
use kalfit_algebra::symmetric::{pair, pairs};

/// Likelihood terms of one class, or of one class in each lane. Index a of a state counts within the phase of the
/// state.
pub(crate) trait Contribution<T> {
    /// Number K of phases of the class's tests: the first K phases of the model.
    fn phases(&self) -> usize;

    /// n of each class; `None` where every class is a single test.
    fn count(&self) -> Option<T>;

    /// |S| of one test of the class, as mantissa × 2^exponent.
    fn det(&self) -> (T, T);

    /// Σ u'D⁻¹u over the tests of the class.
    fn quadratic(&self) -> T;

    /// r of the mean of the class's data, for state a of phase k.
    fn r(&self, k: usize, a: usize) -> T;

    /// Row of W for state a of phase k, over the states of phase i ≤ k; for i = k at least up to state a.
    fn weight(&self, at: (usize, usize), i: usize) -> &[T];

    /// Writes the row of Σ r r' over the class's tests for state a of phase k, over as many first states of phase i as
    /// `to` holds.
    fn outer(&self, at: (usize, usize), i: usize, to: &mut [T]);
}

/// Sums over tests. The pair of phases k ≥ i has index k(k+1)/2 + i. Matrices are by rows; for k = i only the lower
/// triangle.
#[derive(Debug, Clone, Default)]
pub(crate) struct ClassSums {
    /// ℓ without the constants.
    pub(crate) value: f64,
    /// Sum of the quadratic forms, Σ u'D⁻¹u.
    pub(crate) quadratic: f64,
    /// Σ E'r, M numbers.
    pub(crate) score: Vec<f64>,
    /// Σ W by pairs of phases; zero for k > i unless the blocks between phases are requested.
    pub(crate) weight: Vec<Vec<f64>>,
    /// Rows of Σ E'WE for the regression coefficients, coefficients × M.
    pub(crate) regression: Vec<f64>,
    /// Σ r r' of each phase.
    pub(crate) outer: Vec<Vec<f64>>,
    /// Σ W ⊗ (r r' - ½W), or Σ W ⊗ (r r' - ½W + WXVX'W) where V is known: for each pair of phases a square matrix over
    /// the entries of the pair's block of W; empty unless requested.
    pub(crate) curvature: Vec<Vec<f64>>,
    /// Σ WE ⊗ r of each phase, pM × p; empty unless requested.
    pub(crate) cross: Vec<Vec<f64>>,
    /// Σ W ⊗ W, arranged as the curvature; empty unless requested.
    pub(crate) expected: Vec<Vec<f64>>,
    /// Σ WX ⊗ WX of each phase, pq × pq; empty unless requested.
    pub(crate) spread: Vec<Vec<f64>>,
}

/// Sums in lanes, and buffers for the terms of one class in each lane.
pub(crate) struct Accumulator<'a, T> {
    wanted: SumsWanted<'a>,
    /// M, number of mean coordinates.
    mean: usize,
    /// q, number of free mean coordinates: columns of X.
    free: usize,
    log_det: f64,
    /// Π |S| over classes of one test, as mantissa × 2^exponent.
    mantissa: T,
    exponent: T,
    quadratic: T,
    score: Vec<T>,
    weight: Vec<Vec<T>>,
    regression: Vec<T>,
    outer: Vec<Vec<T>>,
    curvature: Vec<ProductSums<T>>,
    cross: Vec<ProductSums<T>>,
    expected: Vec<ProductSums<T>>,
    spread: Vec<ProductSums<T>>,
    /// WE of the current class, p × M.
    WE: Vec<T>,
    /// WX of the current class, p × q.
    WX: Vec<T>,
    /// WXV of the current class, p × q.
    WXV: Vec<T>,
    /// A row of Σ r r' of the current class.
    moment: Vec<T>,
}

impl<'a, T: Lanes> Accumulator<'a, T> {
    pub(crate) fn new(wanted: SumsWanted<'a>) -> Self {
        let (p, regressors) = (wanted.elements.states(), wanted.regressors.len());
        let (m, q) = (p + regressors, wanted.flat.map_or(0, |flat| flat.jacobian.ncols()));
        let sizes: Vec<usize> = wanted.elements.blocks().iter().map(ExactSizeIterator::len).collect();
        let places = (0..sizes.len()).flat_map(|k| (0..=k).map(move |i| (k, i)));
        let places = places.map(|(k, i)| if k == i { pairs(sizes[k]) } else { sizes[k] * sizes[i] });
        let places: Vec<usize> = places.collect();
        let zeros = |size: usize| vec![T::splat(0.0); size];
        let products = |sizes: &[usize], by: usize, wanted: bool| -> Vec<ProductSums<T>> {
            sizes.iter().map(|size| ProductSums::new((size * by, *size), wanted)).collect()
        };
        let second = wanted.order >= Order::Second;
        let free = sizes.iter().map(|size| size * q).collect::<Vec<usize>>();
        Accumulator {
            wanted,
            mean: m,
            free: q,
            log_det: 0.0,
            mantissa: T::splat(1.0),
            exponent: T::splat(0.0),
            quadratic: T::splat(0.0),
            score: zeros(m),
            weight: places.iter().map(|size| zeros(*size)).collect(),
            regression: zeros(regressors * m),
            outer: sizes.iter().map(|size| zeros(pairs(*size))).collect(),
            curvature: products(&places, 1, second),
            cross: products(&sizes, m, second),
            expected: products(&places, 1, wanted.order >= Order::Expected),
            spread: free.iter().map(|size| ProductSums::new((*size, *size), q > 0)).collect(),
            WE: zeros(p * m),
            WX: zeros(p * q),
            WXV: zeros(p * q),
            moment: zeros(p),
        }
    }

    /// Adds the terms of a class; `covariates`: covariates of the class.
    #[inline(always)]
    pub(crate) fn add(&mut self, evaluated: &impl Contribution<T>, covariates: &[T]) {
        let count = evaluated.count().unwrap_or(T::splat(1.0));
        self.add_det(evaluated);
        self.quadratic = self.quadratic + evaluated.quadratic();
        for k in 0..evaluated.phases() {
            let own = &self.wanted.elements.blocks()[k];
            for a in 0..own.len() {
                let sum = &mut self.score[own.start + a];
                *sum = count.fma(evaluated.r(k, a), *sum);
            }
        }
        let second = self.wanted.order >= Order::Second;
        let mut has_covariance = false;
        if second || !self.wanted.regressors.is_empty() || self.wanted.flat.is_some() {
            self.compute_weights(evaluated, covariates);
            self.add_regressions(count, evaluated, covariates);
            has_covariance = self.add_flat(count, evaluated.phases());
        }
        for k in 0..evaluated.phases() {
            let first = if self.wanted.between() { 0 } else { k };
            for i in first..=k {
                self.add_pair((k, i), count, evaluated, has_covariance);
            }
            if second {
                self.add_cross(k, count, evaluated);
            }
        }
    }

    #[inline(always)]
    fn add_det(&mut self, evaluated: &impl Contribution<T>) {
        let (mantissa, exponent) = evaluated.det();
        let Some(count) = evaluated.count() else {
            let (both, more) = (self.mantissa * mantissa).split();
            (self.mantissa, self.exponent) = (both, self.exponent + exponent + more);
            return;
        };
        for lane in 0..T::COUNT {
            let log_det_per_test = mantissa.lane(lane).ln() + exponent.lane(lane) * std::f64::consts::LN_2;
            self.log_det += count.lane(lane) * log_det_per_test;
        }
    }

    /// Computes WE.
    #[inline(always)]
    fn compute_weights(&mut self, evaluated: &impl Contribution<T>, covariates: &[T]) {
        let (m, blocks) = (self.mean, self.wanted.elements.blocks());
        let regressors = self.wanted.regressors;
        if evaluated.phases() < blocks.len() {
            self.WE.fill(T::splat(0.0));
        }
        for k in 0..evaluated.phases() {
            for i in 0..=k {
                let (rows, columns) = (&blocks[k], &blocks[i]);
                for a in 0..rows.len() {
                    let count = if k == i { a + 1 } else { columns.len() };
                    for (b, w) in evaluated.weight((k, a), i)[..count].iter().enumerate() {
                        self.WE[(rows.start + a) * m + columns.start + b] = *w;
                        self.WE[(columns.start + b) * m + rows.start + a] = *w;
                    }
                }
            }
        }
        for (c, &element) in regressors.iter().enumerate() {
            for row in self.WE.chunks_exact_mut(m) {
                row[m - regressors.len() + c] = covariates[c] * row[element];
            }
        }
    }

    /// Adds n E'r and n E'WE of the coefficients.
    #[inline(always)]
    fn add_regressions(&mut self, count: T, evaluated: &impl Contribution<T>, covariates: &[T]) {
        let (m, elements) = (self.mean, self.wanted.elements);
        for (c, &element) in self.wanted.regressors.iter().enumerate() {
            let (k, x) = (elements.block_of(element), count * covariates[c]);
            if k >= evaluated.phases() {
                continue;
            }
            let score = &mut self.score[elements.states() + c];
            *score = x.fma(evaluated.r(k, element - elements.blocks()[k].start), *score);
            let sums = self.regression[c * m..][..m].iter_mut();
            for (sum, w) in sums.zip(&self.WE[element * m..]) {
                *sum = x.fma(*w, *sum);
            }
        }
    }

    /// Adds n WX ⊗ WX, and stores WX and WXV; returns whether V is known.
    #[inline(always)]
    fn add_flat(&mut self, count: T, phases: usize) -> bool {
        let (q, Some(flat)) = (self.free, self.wanted.flat) else { return false };
        if q == 0 {
            return false;
        }
        times(&self.WE, self.mean, flat.jacobian, &mut self.WX);
        for (own, spread) in self.wanted.elements.blocks()[..phases].iter().zip(&mut self.spread) {
            let rows = &self.WX[own.start * q..own.end * q];
            let (left, right) = spread.next();
            right.copy_from_slice(rows);
            scaled(count, rows, left);
        }
        let Some(covariance) = flat.covariance else { return false };
        times(&self.WX, q, covariance, &mut self.WXV);
        true
    }

    /// Adds the terms of phases k ≥ i: n W, Σ r r' with the scatter, and, if requested, W ⊗ (r r' - ½W) and W ⊗ W.
    #[inline(always)]
    fn add_pair(&mut self, (k, i): (usize, usize), count: T, evaluated: &impl Contribution<T>, has_covariance: bool) {
        let (number, q, blocks) = (pair(k, i), self.free, self.wanted.elements.blocks());
        let second = self.wanted.order >= Order::Second;
        let (mut left, mut right): (&mut [T], &mut [T]) = (&mut [], &mut []);
        if second {
            (left, right) = self.curvature[number].next();
        }
        let (one, half, mut at) = (T::splat(1.0), T::splat(0.5) * count, 0);
        for a in 0..blocks[k].len() {
            let places = at..at + if k == i { a + 1 } else { blocks[i].len() };
            at = places.end;
            let weight = &evaluated.weight((k, a), i)[..places.len()];
            add_one(&mut self.weight[number][places.clone()], count, weight);
            let outer = &mut self.moment[..places.len()];
            if k == i || second {
                evaluated.outer((k, a), i, outer);
            }
            if k == i {
                add_one(&mut self.outer[k][places.clone()], one, outer);
            }
            if !second {
                continue;
            }
            left[places.clone()].copy_from_slice(weight);
            add_one(outer, -half, weight);
            if has_covariance {
                let own = &self.WXV[(blocks[k].start + a) * q..][..q];
                let others = self.WX[blocks[i].start * q..].chunks_exact(q);
                for (outer, other) in outer.iter_mut().zip(others) {
                    let mut sum = T::splat(0.0);
                    for c in 0..q {
                        sum = own[c].fma(other[c], sum);
                    }
                    *outer = count.fma(sum, *outer);
                }
            }
            right[places].copy_from_slice(outer);
        }
        if self.wanted.order >= Order::Expected {
            let (scaled_left, same) = self.expected[number].next();
            same.copy_from_slice(left);
            scaled(count, left, scaled_left);
        }
    }

    /// Adds n WE ⊗ r of a phase.
    #[inline(always)]
    fn add_cross(&mut self, k: usize, count: T, evaluated: &impl Contribution<T>) {
        let (m, own) = (self.mean, &self.wanted.elements.blocks()[k]);
        let (left, right) = self.cross[k].next();
        for (a, r) in right.iter_mut().enumerate() {
            *r = evaluated.r(k, a);
        }
        scaled(count, &self.WE[own.start * m..own.end * m], left);
    }

    #[inline(always)]
    pub(crate) fn totals(self) -> ClassSums {
        let quadratic = self.quadratic.sum();
        ClassSums {
            value: -0.5 * (self.log_det + log_det(self.mantissa, self.exponent) + quadratic),
            quadratic,
            score: summed(&self.score),
            weight: self.weight.iter().map(|block| summed(block)).collect(),
            regression: summed(&self.regression),
            outer: self.outer.iter().map(|block| summed(block)).collect(),
            curvature: self.curvature.into_iter().map(ProductSums::total).collect(),
            cross: self.cross.into_iter().map(ProductSums::total).collect(),
            expected: self.expected.into_iter().map(ProductSums::total).collect(),
            spread: self.spread.into_iter().map(ProductSums::total).collect(),
        }
    }
}

fn summed<T: Lanes>(numbers: &[T]) -> Vec<f64> {
    numbers.iter().map(|x| x.sum()).collect()
}

/// to ← scale × numbers.
#[inline(always)]
fn scaled<T: Lanes>(scale: T, numbers: &[T], to: &mut [T]) {
    for (to, x) in to.iter_mut().zip(numbers) {
        *to = scale * *x;
    }
}

/// to ← AB, by rows; A has `width` columns.
#[inline(always)]
fn times<T: Lanes>(A: &[T], width: usize, B: &DMatrix<f64>, to: &mut [T]) {
    for (to, from) in to.chunks_exact_mut(B.ncols()).zip(A.chunks_exact(width)) {
        for (c, to) in to.iter_mut().enumerate() {
            let mut sum = T::splat(0.0);
            for k in 0..width {
                sum = from[k].fma(T::splat(B[(k, c)]), sum);
            }
            *to = sum;
        }
    }
}
