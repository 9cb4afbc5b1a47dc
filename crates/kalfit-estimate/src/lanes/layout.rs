//! Layout of a block of classes.

use crate::class::{Class, ClassRef};
use kalfit_algebra::symmetric::{pair, pairs};

/// Order of the entries of a block, each entry with one number for every lane: R by columns, C by rows, d and g, the
/// vectors of the scatter (only in classes of several tests), the covariates, and n (only in classes of several tests).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ClassLayout {
    pub(super) p: usize,
    /// q, number of rows of C.
    pub(super) exact: usize,
    pub(super) covariates: usize,
    pub(super) several: bool,
}

impl ClassLayout {
    /// Offset of the vectors of the scatter.
    pub(super) fn scatter(&self) -> usize {
        pairs(self.p) + self.exact * self.p + self.rows()
    }

    /// Number of rows of R and C together.
    pub(super) fn rows(&self) -> usize {
        self.p + self.exact
    }

    /// Offset of the covariates.
    pub(super) fn covariates(&self) -> usize {
        self.scatter() + if self.several { self.rows() * self.rows() } else { 0 }
    }

    /// Offset of n, for classes of several tests.
    pub(super) fn count(&self) -> usize {
        self.covariates() + self.covariates
    }

    /// Number of values of a class.
    pub(super) fn size(&self) -> usize {
        self.count() + usize::from(self.several)
    }

    /// Writes a class into a lane, filled with zeros, of a block.
    pub(super) fn put(&self, class: ClassRef<'_>, (block, lane, lanes): (&mut [f64], usize, usize)) {
        let p = self.p;
        let triangle = (0..p).flat_map(|k| (0..=k).map(move |i| class.factor[i * p + k]));
        let mut put = |from: usize, numbers: &mut dyn Iterator<Item = f64>| {
            block[from * lanes..].chunks_exact_mut(lanes).zip(numbers).for_each(|(entry, x)| entry[lane] = x);
        };
        let exact = class.factor[p * p..].iter().copied();
        put(0, &mut triangle.chain(exact).chain(class.mean.iter().copied()));
        put(self.scatter(), &mut class.scatter.iter().copied());
        put(self.covariates(), &mut class.covariates.iter().copied());
        if self.several {
            put(self.count(), &mut std::iter::once(class.count));
        }
    }

    /// Reads the class in a lane of a block, without its constant; d and the scatter are multiplied by `unit`.
    pub(super) fn read(&self, (block, lane, lanes): (&[f64], usize, usize), unit: f64, class: &mut Class) {
        let p = self.p;
        let number = |at: usize| block[at * lanes + lane];
        let copy = |to: &mut Vec<f64>, from: usize, size: usize| {
            to.clear();
            to.extend((from..from + size).map(number));
        };
        class.count = if self.several { number(self.count()) } else { 1.0 };
        class.factor.clear();
        class.factor.resize(p * p, 0.0);
        for k in 0..p {
            (0..=k).for_each(|i| class.factor[i * p + k] = number(pair(k, i)));
        }
        // a class of n < p tests has n scatter vectors; the block holds zeros for the remaining p - n
        let vectors = if self.several { p.min(class.count as usize) } else { 0 };
        copy(&mut class.mean, pairs(p), p);
        copy(&mut class.scatter, self.scatter(), vectors * p);
        copy(&mut class.covariates, self.covariates(), self.covariates);
        class.mean.iter_mut().chain(&mut class.scatter).for_each(|x| *x *= unit);
        (class.square_root, class.chain) = (false, None);
    }
}
