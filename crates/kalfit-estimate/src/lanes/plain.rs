//! Sums over blocks of classes of one test each, for numbers of states known at compile time.
#![expect(non_snake_case, reason = "W is the letter of the theory")]

use kalfit_lanes::Lanes;

use crate::lanes::accumulator::ClassSums;
use crate::lanes::dense::{BlockTerms, LaneLaw, block_terms, entries};
use crate::lanes::gather::ProductSums;
use crate::lanes::rows::log_det;
use crate::lanes::whole::BlockPass;
use crate::order::Order;
use kalfit_algebra::symmetric::pairs;

/// Largest number of states for which the sums of first derivatives fit into the registers.
const IN_REGISTERS: usize = 3;

impl BlockPass<'_> {
    #[inline(always)]
    pub(super) fn sized<T: Lanes, const P: usize>(self) -> ClassSums {
        let (law, order) = (self.law::<P>(), self.wanted.order);
        if P <= IN_REGISTERS && order < Order::Second {
            return self.first::<T, P>(&law);
        }
        let mut products = SecondOrderSums::<T>::new(P, order);
        let mut sums = FirstOrderSums::<T, P>::new();
        for block in self.blocks.chunks_exact(entries(P) * T::COUNT) {
            let block_terms = block_terms::<T, P>(block, &law, &mut sums.det);
            sums.add(&block_terms);
            if order >= Order::Second {
                products.take(&block_terms);
            }
        }
        products.into(sums.totals())
    }

    /// Sums of first derivatives alone: the loop has nothing else, so that the sums of few states stay in registers.
    #[inline(always)]
    fn first<T: Lanes, const P: usize>(self, law: &LaneLaw<P>) -> ClassSums {
        let mut sums = FirstOrderSums::<T, P>::new();
        for block in self.blocks.chunks_exact(entries(P) * T::COUNT) {
            let block_terms = block_terms::<T, P>(block, law, &mut sums.det);
            sums.add(&block_terms);
        }
        sums.totals()
    }

    fn law<const P: usize>(&self) -> LaneLaw<P> {
        let mut law = LaneLaw { unit: self.unit, mean: [0.0; P], root: [[0.0; P]; P] };
        for i in 0..P {
            law.mean[i] = self.point.mean[i];
            for c in 0..=i {
                law.root[i][c] = self.root[(i, c)];
            }
        }
        law
    }
}

/// Sums of products for second derivatives.
struct SecondOrderSums<T> {
    p: usize,
    /// Σ W ⊗ [r r' - ½W, r].
    observed: ProductSums<T>,
    /// Σ W ⊗ W, if requested.
    expected: ProductSums<T>,
    is_expected: bool,
}

impl<T: Lanes> SecondOrderSums<T> {
    fn new(p: usize, order: Order) -> Self {
        let (s, is_expected) = (pairs(p), order >= Order::Expected);
        let observed = ProductSums::new((s, s + p), order >= Order::Second);
        SecondOrderSums { p, observed, expected: ProductSums::new((s, s), is_expected), is_expected }
    }

    /// Adds the products of W with r r' - ½W and r of a block.
    #[inline(always)]
    fn take<const P: usize>(&mut self, block_terms: &BlockTerms<T, P>) {
        let (weights, right) = self.observed.next();
        let (inner, r) = right.split_at_mut(right.len() - P);
        block_terms.write(weights, inner, r);
        if self.is_expected {
            let (left, right) = self.expected.next();
            left.copy_from_slice(weights);
            right.copy_from_slice(weights);
        }
    }

    #[inline(always)]
    fn into(self, totals: ClassSums) -> ClassSums {
        let (p, s) = (self.p, pairs(self.p));
        let (mut curvature, mut cross) = (Vec::new(), Vec::new());
        let observed = self.observed.total();
        if !observed.is_empty() {
            cross.resize(p * p * p, 0.0);
        }
        let places = (0..p).flat_map(|a| (0..=a).map(move |b| (a, b)));
        for ((a, b), row) in places.zip(observed.chunks_exact(s + p)) {
            let (inner, r) = row.split_at(s);
            curvature.extend_from_slice(inner);
            cross[(a * p + b) * p..][..p].copy_from_slice(r);
            cross[(b * p + a) * p..][..p].copy_from_slice(r);
        }
        ClassSums { curvature: vec![curvature], cross: vec![cross], expected: vec![self.expected.total()], ..totals }
    }
}

impl<T: Lanes, const P: usize> BlockTerms<T, P> {
    /// Writes W and r r' - ½W, lower triangles by rows, and r.
    #[inline(always)]
    fn write(&self, weights: &mut [T], inner: &mut [T], r: &mut [T]) {
        let half = T::splat(0.5);
        let mut at = 0;
        for a in 0..P {
            r[a] = self.r[a];
            for b in 0..=a {
                weights[at] = self.W[a][b];
                inner[at] = self.r[a].fma(self.r[b], -(half * self.W[a][b]));
                at += 1;
            }
        }
    }
}

/// Sums of first order, in lanes.
struct FirstOrderSums<T, const P: usize> {
    /// Π |S| over the tests, as mantissa × 2^exponent.
    det: (T, T),
    quadratic: T,
    r: [T; P],
    W: [[T; P]; P],
    outer: [[T; P]; P],
}

impl<T: Lanes, const P: usize> FirstOrderSums<T, P> {
    #[inline(always)]
    fn new() -> Self {
        let zero = T::splat(0.0);
        let square = [[zero; P]; P];
        FirstOrderSums { det: (T::splat(1.0), zero), quadratic: zero, r: [zero; P], W: square, outer: square }
    }

    #[inline(always)]
    fn add(&mut self, block_terms: &BlockTerms<T, P>) {
        self.quadratic = self.quadratic + block_terms.quadratic;
        for a in 0..P {
            self.r[a] = self.r[a] + block_terms.r[a];
            for b in 0..=a {
                self.W[a][b] = self.W[a][b] + block_terms.W[a][b];
                self.outer[a][b] = block_terms.r[a].fma(block_terms.r[b], self.outer[a][b]);
            }
        }
    }

    #[inline(always)]
    fn totals(&self) -> ClassSums {
        let (mut score, mut W, mut outer) = (Vec::new(), Vec::new(), Vec::new());
        for a in 0..P {
            score.push(self.r[a].sum());
            for b in 0..=a {
                W.push(self.W[a][b].sum());
                outer.push(self.outer[a][b].sum());
            }
        }
        let quadratic = self.quadratic.sum();
        ClassSums {
            value: -0.5 * (log_det(self.det.0, self.det.1) + quadratic),
            quadratic,
            score,
            weight: vec![W],
            outer: vec![outer],
            ..ClassSums::default()
        }
    }
}
