//! Sums over blocks of classes in phases, worked on side by side.
#![expect(non_snake_case, reason = "W is the letter of the theory")]

use std::sync::Arc;

use kalfit_lanes::{Isa, Kernel, Lanes};

use crate::estimate::chained::{Detail, Packed, Root, Said};
use crate::estimate::lanes::gather::Gather;
use crate::estimate::listed::Listed;
use crate::estimate::order::Order;
use crate::estimate::point::{Point, Regressors};
use crate::linalg::elements::Elements;
use crate::linalg::rows::Rows;
use crate::linalg::symmetric::pair;

/// One pass over some blocks.
pub(crate) struct Pass<'a> {
    pub(crate) blocks: &'a [Arc<Packed>],
    pub(crate) classes: &'a Listed,
    pub(crate) point: &'a Point,
    pub(crate) regressors: &'a Regressors,
    pub(crate) elements: &'a Elements,
    pub(crate) order: Order,
    pub(crate) isa: Isa,
}

/// Sums over tests. A pair of phases k ≥ i stands at k(k+1)/2 + i; matrices by rows.
#[derive(Debug, Clone)]
pub(crate) struct Totals {
    /// ℓ.
    pub(crate) value: f64,
    /// Σ r.
    pub(crate) r: Vec<f64>,
    /// Σ W by pairs of phases; zero between phases where that is not wanted.
    pub(crate) W: Vec<Vec<f64>>,
    /// Σ r r' by phase.
    pub(crate) outer: Vec<Vec<f64>>,
    /// Σ W ⊗ (r r' - ½W) by pairs of phases, places × places, if it is wanted.
    pub(crate) curvature: Vec<Vec<f64>>,
    /// Σ W ⊗ r by phase, if it is wanted.
    pub(crate) cross: Vec<Vec<f64>>,
    /// Σ W ⊗ W, if it is wanted.
    pub(crate) expected: Vec<Vec<f64>>,
    /// Classes that need more care than this.
    pub(crate) refused: Vec<usize>,
}

impl Kernel for Pass<'_> {
    type Output = Totals;

    #[inline(always)]
    fn run<T: Lanes>(self) -> Totals {
        let mut sums = Sums::<T>::new(&self);
        let detail = if self.order >= Order::Mean { Detail::Between } else { Detail::Phases };
        let root = Root::of(&self.point.root);
        for block in self.blocks {
            let mean = block.means::<T>(|member| self.classes.get(member), self.point, self.regressors);
            match block.said::<T>(&mean, &root, detail) {
                Some(said) => {
                    for &member in block.members() {
                        sums.value += self.classes.get(member).constant;
                    }
                    sums.add(block.count(), &said);
                }
                None => sums.refused.extend_from_slice(block.members()),
            }
        }
        sums.totals()
    }
}

/// Sums in lanes.
struct Sums<'a, T> {
    elements: &'a Elements,
    order: Order,
    value: f64,
    r: Vec<T>,
    W: Vec<Vec<T>>,
    outer: Vec<Vec<T>>,
    curvature: Vec<Gather>,
    cross: Vec<Gather>,
    expected: Vec<Gather>,
    refused: Vec<usize>,
}

impl<'a, T: Lanes> Sums<'a, T> {
    fn new(pass: &Pass<'a>) -> Self {
        let (elements, isa) = (pass.elements, pass.isa);
        let (p, sizes) = (elements.states(), elements.blocks().iter().map(ExactSizeIterator::len));
        let sizes: Vec<usize> = sizes.collect();
        let pairs: Vec<(usize, usize)> = (0..sizes.len()).flat_map(|k| (0..=k).map(move |i| (k, i))).collect();
        let zeros = |size: usize| vec![T::splat(0.0); size];
        let places = |&(k, i): &(usize, usize)| if k == i { pair(sizes[k], 0) } else { sizes[k] * sizes[i] };
        let products = |wanted: bool| -> Vec<Gather> {
            pairs.iter().map(|at| Gather::new(isa, (places(at), places(at)), wanted)).collect()
        };
        let second = pass.order >= Order::Second;
        Sums {
            elements,
            order: pass.order,
            value: 0.0,
            r: zeros(p),
            W: pairs.iter().map(|&(k, i)| zeros(sizes[k] * sizes[i])).collect(),
            outer: sizes.iter().map(|size| zeros(size * size)).collect(),
            curvature: products(second),
            cross: sizes.iter().map(|size| Gather::new(isa, (size * p, *size), second)).collect(),
            expected: products(pass.order >= Order::Expected),
            refused: Vec::new(),
        }
    }

    #[inline(always)]
    fn add(&mut self, count: T, said: &Said<T>) {
        let (mantissa, exponent) = said.root_det;
        for lane in 0..T::COUNT {
            let log_root = mantissa.lane(lane).ln() + exponent.lane(lane) * std::f64::consts::LN_2;
            self.value -= count.lane(lane) * log_root + 0.5 * said.quadratic.lane(lane);
        }
        for (k, r) in said.r.iter().enumerate() {
            let start = self.elements.blocks()[k].start;
            for a in 0..r.nrows() {
                self.r[start + a] = count.fma(r[(a, 0)], self.r[start + a]);
            }
            for i in 0..=k {
                if let Some(W) = &said.W[pair(k, i)] {
                    self.add_pair(count, (k, i), W, (r, &said.r[i]));
                }
            }
        }
        if self.order >= Order::Second {
            for k in 0..said.r.len() {
                self.add_cross(count, k, said);
            }
        }
    }

    /// A pair of phases k ≥ i.
    #[inline(always)]
    fn add_pair(&mut self, count: T, (k, i): (usize, usize), W: &Rows<T>, (x, y): (&Rows<T>, &Rows<T>)) {
        let number = pair(k, i);
        for (sum, w) in self.W[number].iter_mut().zip(W.as_slice()) {
            *sum = count.fma(*w, *sum);
        }
        let second = self.order >= Order::Second;
        if k != i && !second {
            return;
        }
        let half = T::splat(0.5) * count;
        let mut at = 0;
        let width = W.ncols();
        let (mut left, mut right): (&mut [f64], &mut [f64]) = (&mut [], &mut []);
        if second {
            (left, right) = self.curvature[number].next();
        }
        for a in 0..W.nrows() {
            let columns = if k == i { a + 1 } else { width };
            for b in 0..columns {
                let mut outer = count * x[(a, 0)] * y[(b, 0)];
                for c in 1..x.ncols() {
                    outer = x[(a, c)].fma(y[(b, c)], outer);
                }
                if k == i {
                    self.outer[k][a * width + b] = self.outer[k][a * width + b] + outer;
                }
                if second {
                    W[(a, b)].store(&mut left[at..]);
                    half.fnma(W[(a, b)], outer).store(&mut right[at..]);
                    at += T::COUNT;
                }
            }
        }
        if self.order >= Order::Expected {
            let (left, right) = self.expected[number].next();
            let mut at = 0;
            for a in 0..W.nrows() {
                let columns = if k == i { a + 1 } else { width };
                for b in 0..columns {
                    (count * W[(a, b)]).store(&mut left[at..]);
                    W[(a, b)].store(&mut right[at..]);
                    at += T::COUNT;
                }
            }
        }
    }

    /// W ⊗ r of the r of a phase.
    #[inline(always)]
    fn add_cross(&mut self, count: T, f: usize, said: &Said<T>) {
        let (p, own) = (self.elements.states(), said.r[f].nrows());
        let (left, right) = self.cross[f].next();
        left.fill(0.0); // phases that the tests do not have
        for l in 0..own {
            said.r[f][(l, 0)].store(&mut right[l * T::COUNT..]);
        }
        for g in 0..said.r.len() {
            let start = self.elements.blocks()[g].start;
            if let Some(W) = &said.W[pair(f, g)] {
                for k in 0..own {
                    for m in 0..said.r[g].nrows() {
                        let w = if g >= f { W[(m, k)] } else { W[(k, m)] };
                        (count * w).store(&mut left[(k * p + start + m) * T::COUNT..]);
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn totals(self) -> Totals {
        Totals {
            value: self.value,
            r: summed(&self.r),
            W: self.W.iter().map(|block| summed(block)).collect(),
            outer: self.outer.iter().map(|block| summed(block)).collect(),
            curvature: self.curvature.into_iter().map(Gather::total).collect(),
            cross: self.cross.into_iter().map(Gather::total).collect(),
            expected: self.expected.into_iter().map(Gather::total).collect(),
            refused: self.refused,
        }
    }
}

fn summed<T: Lanes>(numbers: &[T]) -> Vec<f64> {
    numbers.iter().map(|x| x.sum()).collect()
}
