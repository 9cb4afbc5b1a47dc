//! One pass over the classes: ℓ(μ, Σ) and its derivatives (theory §3), the sums that every solver lives on.
#![expect(non_snake_case, reason = "W and M are the letters of the theory")]

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::estimate::classes::{Class, Classes};
use crate::estimate::terms::{Point, Regressors, Terms};
use crate::linalg::symmetric::{over_pairs, pair, pairs};

/// Classes summed by one task. Fixed, so that sums have the same bits for any number of threads.
const CHUNK: usize = 128;

/// Which derivatives a pass computes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Order {
    /// ℓ and the first derivatives: all that EM needs.
    First,
    /// And the observed information.
    Second,
    /// And the expected information of Σ.
    Expected,
}

/// Sums over tests. The mean coordinates are the p elements of μ, then the regression coefficients.
#[derive(Debug, Clone)]
pub(crate) struct Sums {
    /// ℓ.
    pub(crate) value: f64,
    /// ∂ℓ/∂(mean coordinates): Σ E'r.
    pub(crate) mean_score: DVector<f64>,
    /// Σ E'WE.
    pub(crate) mean_information: DMatrix<f64>,
    /// Σ r r'.
    pub(crate) outer: DMatrix<f64>,
    /// Σ W.
    pub(crate) weight: DMatrix<f64>,
    /// Σ W ⊗ (r r' - ½W), pairs × pairs.
    curvature: DMatrix<f64>,
    /// Σ W ⊗ r for each mean coordinate: entry (coordinate, k, l) of E'W_{·k} r_l at (coordinate, k p + l).
    cross: DMatrix<f64>,
    /// Σ W ⊗ W, pairs × pairs.
    expected: DMatrix<f64>,
}

impl Sums {
    fn zero(p: usize, regressors: usize, order: Order) -> Sums {
        let size = |n: usize, from: Order| if order >= from { n } else { 0 };
        let (m, s) = (p + regressors, pairs(p));
        Sums {
            value: 0.0,
            mean_score: DVector::zeros(m),
            mean_information: DMatrix::zeros(m, m),
            outer: DMatrix::zeros(p, p),
            weight: DMatrix::zeros(p, p),
            curvature: DMatrix::zeros(size(s, Order::Second), size(s, Order::Second)),
            cross: DMatrix::zeros(size(m, Order::Second), size(p * p, Order::Second)),
            expected: DMatrix::zeros(size(s, Order::Expected), size(s, Order::Expected)),
        }
    }

    fn add(mut self, other: &Sums) -> Sums {
        self.value += other.value;
        self.mean_score += &other.mean_score;
        self.mean_information += &other.mean_information;
        self.outer += &other.outer;
        self.weight += &other.weight;
        self.curvature += &other.curvature;
        self.cross += &other.cross;
        self.expected += &other.expected;
        self
    }

    /// G = ∂ℓ/∂Σ = ½ Σ (r r' - W), (5): ℓ changes by tr(G dΣ).
    pub(crate) fn score(&self) -> DMatrix<f64> {
        (&self.outer - &self.weight) * 0.5
    }

    /// G once the mean coordinates have moved by `shift`: r_j becomes r_j - W_j E_j shift. Exact, without regressors; with
    /// them their part of the shift is left out. Needs [`Order::Expected`].
    pub(crate) fn score_after(&self, regressors: &Regressors, shift: &DVector<f64>) -> DMatrix<f64> {
        let p = self.outer.nrows();
        debug_assert_eq!(shift.len(), p + regressors.len(), "mean coordinates");
        let mut outer = self.outer.clone();
        for a in 0..p {
            for b in 0..p {
                for k in 0..p {
                    // Σ W_ak r_b and its mirror
                    outer[(a, b)] -= shift[k] * (self.cross[(a, k * p + b)] + self.cross[(b, k * p + a)]);
                    for l in 0..p {
                        outer[(a, b)] += shift[k] * shift[l] * self.expected[(pair(a, k), pair(b, l))];
                    }
                }
            }
        }
        (outer - &self.weight) * 0.5
    }

    /// -∂²ℓ/∂σ_kl ∂σ_ab, pairs × pairs; an off-diagonal element moves both of its places.
    pub(crate) fn observed_information(&self) -> DMatrix<f64> {
        let p = self.outer.nrows();
        over_pairs(p, |k, l, a, b| self.curvature[(pair(l, a), pair(b, k))])
    }

    /// ½ Σ tr(W D W E), pairs × pairs.
    pub(crate) fn expected_information(&self) -> DMatrix<f64> {
        let p = self.outer.nrows();
        over_pairs(p, |k, l, a, b| 0.5 * self.expected[(pair(l, a), pair(b, k))])
    }

    /// -∂²ℓ/∂(mean coordinate) ∂σ_kl = Σ E'(W_{·k} r_l + W_{·l} r_k), mean coordinates × pairs.
    pub(crate) fn cross_information(&self) -> DMatrix<f64> {
        let p = self.outer.nrows();
        let mut cross = DMatrix::zeros(self.mean_score.len(), pairs(p));
        for m in 0..self.mean_score.len() {
            for k in 0..p {
                for l in 0..=k {
                    let once = self.cross[(m, k * p + l)];
                    cross[(m, pair(k, l))] = if k == l { once } else { once + self.cross[(m, l * p + k)] };
                }
            }
        }
        cross
    }
}

/// ℓ and its derivatives at a point.
pub(crate) fn pass(classes: &Classes, regressors: &Regressors, point: &Point, order: Order) -> Sums {
    let zero = || Sums::zero(classes.dimension(), regressors.len(), order);
    let chunks: Vec<Sums> = classes
        .classes
        .par_chunks(CHUNK)
        .map(|chunk| {
            let mut sums = zero();
            let mut terms = Terms::new(classes.dimension());
            for class in chunk {
                terms.evaluate(class, regressors, point);
                terms.add_to(&mut sums, class, regressors, order);
            }
            sums
        })
        .collect();
    chunks.iter().fold(zero(), Sums::add)
}

/// What one class says by itself.
pub(crate) fn of_class(class: &Class, regressors: &Regressors, point: &Point, order: Order) -> Sums {
    let p = point.mean.len();
    let mut sums = Sums::zero(p, regressors.len(), order);
    let mut terms = Terms::new(p);
    terms.evaluate(class, regressors, point);
    terms.add_to(&mut sums, class, regressors, order);
    sums
}

impl Terms {
    fn add_to(&self, sums: &mut Sums, class: &Class, regressors: &Regressors, order: Order) {
        let (p, n) = (self.r.len(), class.count);
        sums.value += self.value(class);
        for a in 0..p {
            sums.mean_score[a] += n * self.r[a];
            for b in 0..p {
                sums.mean_information[(a, b)] += n * self.W[a * p + b];
                sums.weight[(a, b)] += n * self.W[a * p + b];
                sums.outer[(a, b)] += self.outer[a * p + b];
            }
        }
        for (c, &element) in regressors.iter().enumerate() {
            self.add_regressor(sums, class, regressors, (c, element));
        }
        if order >= Order::Second {
            self.add_second(sums, class, regressors);
        }
        if order >= Order::Expected {
            self.for_pairs(|s, t, w, u| sums.expected[(s, t)] += n * w * u, &self.W);
        }
    }

    fn add_regressor(&self, sums: &mut Sums, class: &Class, regressors: &Regressors, at: (usize, usize)) {
        let (p, n, x) = (self.r.len(), class.count, class.covariates[at.0]);
        let row = p + at.0;
        sums.mean_score[row] += n * x * self.r[at.1];
        for a in 0..p {
            let value = n * x * self.W[at.1 * p + a];
            sums.mean_information[(row, a)] += value;
            sums.mean_information[(a, row)] += value;
        }
        for (c, &element) in regressors.iter().enumerate() {
            sums.mean_information[(row, p + c)] += n * x * class.covariates[c] * self.W[at.1 * p + element];
        }
    }

    fn add_second(&self, sums: &mut Sums, class: &Class, regressors: &Regressors) {
        let (p, n) = (self.r.len(), class.count);
        let mut inner = self.outer.clone();
        inner.iter_mut().zip(&self.W).for_each(|(m, w)| *m -= 0.5 * n * w);
        self.for_pairs(|s, t, w, m| sums.curvature[(s, t)] += w * m, &inner);
        for k in 0..p {
            for l in 0..p {
                let column = k * p + l;
                for a in 0..p {
                    sums.cross[(a, column)] += n * self.W[a * p + k] * self.r[l];
                }
                for (c, &element) in regressors.iter().enumerate() {
                    sums.cross[(p + c, column)] += n * class.covariates[c] * self.W[element * p + k] * self.r[l];
                }
            }
        }
    }

    /// Calls `f(s, t, W_s, M_t)` for all pairs s, t of elements.
    fn for_pairs(&self, mut f: impl FnMut(usize, usize, f64, f64), M: &[f64]) {
        let p = self.r.len();
        for i in 0..p {
            for j in 0..=i {
                let m = M[i * p + j];
                for a in 0..p {
                    for b in 0..=a {
                        f(pair(a, b), pair(i, j), self.W[a * p + b], m);
                    }
                }
            }
        }
    }
}
