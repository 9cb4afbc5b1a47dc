//! Passes over blocks of classes in phases.

use std::sync::Arc;

use kalfit_lanes::{Kernel, Lanes};

use crate::chained::{ChainTerms, Packed, Root};
use crate::lanes::accumulator::{Accumulator, ClassSums, Contribution};
use crate::listed::Listed;
use crate::order::SumsWanted;
use crate::point::Point;
use kalfit_algebra::symmetric::pair;

/// A pass, at a point, over blocks of classes in phases.
pub(crate) struct ChainKernel<'a> {
    pub(crate) blocks: &'a [Arc<Packed>],
    pub(crate) classes: &'a Listed,
    pub(crate) point: &'a Point,
    pub(crate) wanted: SumsWanted<'a>,
}

/// Sums over the classes of a pass.
pub(crate) struct ChainSums {
    pub(crate) totals: ClassSums,
    /// Sum of the constants of the classes.
    pub(crate) constant: f64,
    /// Indices of the classes that need square-root arithmetic and are therefore not in the sums.
    pub(crate) needs_rotations: Vec<usize>,
}

impl Kernel for ChainKernel<'_> {
    type Output = ChainSums;

    #[inline(always)]
    fn run<T: Lanes>(self) -> ChainSums {
        let ChainKernel { classes, point, wanted, .. } = self;
        let mut sums = Accumulator::<T>::new(wanted);
        let (mut constant, mut needs_rotations) = (0.0, Vec::new());
        let root = Root::of(&point.root);
        for block in self.blocks {
            let covariates = block.covariates::<T>(|member| classes.get(member), wanted.regressors.len());
            let mean = block.means(&covariates, point, wanted.regressors);
            match block.evaluated::<T>(&mean, &root, wanted.detail()) {
                Some(evaluated) => {
                    for &member in block.members() {
                        constant += classes.get(member).constant;
                    }
                    sums.add(&ChainContribution { evaluated: &evaluated, count: block.count() }, &covariates);
                }
                None => needs_rotations.extend_from_slice(block.members()),
            }
        }
        ChainSums { totals: sums.totals(), constant, needs_rotations }
    }
}

/// Likelihood terms of a block, one class in each lane.
pub(crate) struct ChainContribution<'a, T> {
    pub(crate) evaluated: &'a ChainTerms<T>,
    pub(crate) count: T,
}

impl<T: Lanes> Contribution<T> for ChainContribution<'_, T> {
    #[inline(always)]
    fn phases(&self) -> usize {
        self.evaluated.r.len()
    }

    #[inline(always)]
    fn count(&self) -> Option<T> {
        Some(self.count)
    }

    #[inline(always)]
    fn det(&self) -> (T, T) {
        let (mantissa, exponent) = self.evaluated.root_det;
        (mantissa * mantissa, exponent + exponent)
    }

    #[inline(always)]
    fn quadratic(&self) -> T {
        self.evaluated.quadratic
    }

    #[inline(always)]
    fn r(&self, k: usize, a: usize) -> T {
        self.evaluated.r[k][(a, 0)]
    }

    #[inline(always)]
    fn weight(&self, (k, a): (usize, usize), i: usize) -> &[T] {
        match &self.evaluated.W[pair(k, i)] {
            Some(weight) => weight.row(a),
            None => unreachable!("it was asked for"),
        }
    }

    #[inline(always)]
    fn outer(&self, (k, a): (usize, usize), i: usize, to: &mut [T]) {
        let (x, other) = (self.evaluated.r[k].row(a), &self.evaluated.r[i]);
        for (b, to) in to.iter_mut().enumerate() {
            let y = other.row(b);
            *to = self.count * x[0] * y[0];
            for c in 1..x.len() {
                *to = x[c].fma(y[c], *to);
            }
        }
    }
}
