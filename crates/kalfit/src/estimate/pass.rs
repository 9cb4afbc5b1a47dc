//! One pass over the classes: ℓ(μ, Σ) and its derivatives (theory §3), the sums that every solver lives on.
#![expect(non_snake_case, reason = "W and M are the letters of the theory")]

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::estimate::classes::{Class, Classes};
use crate::estimate::reml::Restricted;
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
    /// What the restricted likelihood adds, already part of `value`.
    pub(crate) restricted: Option<Restricted>,
    /// Σ X'W ⊗ WX, pairs of free mean coordinates × pairs of elements; nothing under maximum likelihood.
    spread: DMatrix<f64>,
    /// Σ W ⊗ (r r' - ½W), pairs × pairs; under the restricted likelihood Σ W ⊗ (r r' - ½W + W X V X'W).
    curvature: DMatrix<f64>,
    /// Σ W ⊗ r for each mean coordinate: entry (coordinate, k, l) of E'W_{·k} r_l at (coordinate, k p + l).
    cross: DMatrix<f64>,
    /// Σ W ⊗ W, pairs × pairs.
    expected: DMatrix<f64>,
}

impl Sums {
    fn zero(p: usize, regressors: usize, order: Order, flat: Option<&FlatMean<'_>>) -> Sums {
        let size = |n: usize, from: Order| if order >= from { n } else { 0 };
        let (m, s) = (p + regressors, pairs(p));
        Sums {
            value: 0.0,
            mean_score: DVector::zeros(m),
            mean_information: DMatrix::zeros(m, m),
            outer: DMatrix::zeros(p, p),
            weight: DMatrix::zeros(p, p),
            restricted: None,
            spread: flat.map_or_else(|| DMatrix::zeros(0, 0), |f| DMatrix::zeros(pairs(f.jacobian.ncols()), s)),
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
        self.spread += &other.spread;
        self.curvature += &other.curvature;
        self.cross += &other.cross;
        self.expected += &other.expected;
        self
    }

    /// Σ X'W ⊗ WX.
    pub(crate) fn spread(&self) -> &DMatrix<f64> {
        &self.spread
    }

    /// With what the restricted likelihood adds.
    pub(crate) fn restrict(mut self, restricted: Restricted) -> Sums {
        self.value += restricted.value;
        self.restricted = Some(restricted);
        self
    }

    /// What places near by may take from this one.
    pub(crate) fn near(&self) -> Option<&DMatrix<f64>> {
        self.restricted.as_ref().map(|r| &r.covariance)
    }

    /// Σ r r', to which under the restricted likelihood the uncertainty of the mean adds Σ W X V X'W.
    pub(crate) fn moment(&self) -> DMatrix<f64> {
        match &self.restricted {
            Some(restricted) => &self.outer + &restricted.score * 2.0,
            None => self.outer.clone(),
        }
    }

    /// G = ∂ℓ/∂Σ = ½ Σ (r r' - W), (5), with what the restricted likelihood adds: the value changes by tr(G dΣ).
    pub(crate) fn score(&self) -> DMatrix<f64> {
        (self.moment() - &self.weight) * 0.5
    }

    /// G once the mean coordinates have moved by `shift`: r_j becomes r_j - W_j E_j shift. Exact, without regressors; with
    /// them their part of the shift is left out. Needs [`Order::Expected`].
    pub(crate) fn score_after(&self, regressors: &Regressors, shift: &DVector<f64>) -> DMatrix<f64> {
        let p = self.outer.nrows();
        debug_assert_eq!(shift.len(), p + regressors.len(), "mean coordinates");
        let mut outer = self.moment();
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
        let own = over_pairs(p, |k, l, a, b| self.curvature[(pair(l, a), pair(b, k))]);
        match &self.restricted {
            Some(restricted) => own - &restricted.curvature,
            None => own,
        }
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

/// What the restricted likelihood needs of every class: X = E × jacobian, the mean by its free coordinates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FlatMean<'a> {
    /// d(mean coordinates) / d(free mean coordinates).
    pub(crate) jacobian: &'a DMatrix<f64>,
    /// V, the covariance of the free mean coordinates.
    pub(crate) covariance: Option<&'a DMatrix<f64>>,
}

/// ℓ and its derivatives at a point.
pub(crate) fn pass(
    classes: &Classes,
    regressors: &Regressors,
    point: &Point,
    order: Order,
    flat: Option<&FlatMean<'_>>,
) -> Sums {
    let zero = || Sums::zero(classes.dimension(), regressors.len(), order, flat);
    let chunks: Vec<Sums> = classes
        .classes
        .par_chunks(CHUNK)
        .map(|chunk| {
            let mut sums = zero();
            let mut terms = Terms::new(classes.dimension());
            for class in chunk {
                terms.evaluate(class, regressors, point);
                terms.add_to(&mut sums, class, regressors, order, flat);
            }
            sums
        })
        .collect();
    chunks.iter().fold(zero(), Sums::add)
}

/// What one class says by itself.
pub(crate) fn of_class(class: &Class, regressors: &Regressors, point: &Point, order: Order) -> Sums {
    let p = point.mean.len();
    let mut sums = Sums::zero(p, regressors.len(), order, None);
    let mut terms = Terms::new(p);
    terms.evaluate(class, regressors, point);
    terms.add_to(&mut sums, class, regressors, order, None);
    sums
}

impl Terms {
    fn add_to(
        &self,
        sums: &mut Sums,
        class: &Class,
        regressors: &Regressors,
        order: Order,
        flat: Option<&FlatMean<'_>>,
    ) {
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
        let uncertainty = flat.and_then(|flat| self.add_flat(sums, class, regressors, flat));
        if order >= Order::Second {
            self.add_second(sums, class, regressors, uncertainty.as_ref());
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

    /// Adds to Σ X'W ⊗ WX, and returns W X V X'W (p × p) where V is known.
    fn add_flat(
        &self,
        sums: &mut Sums,
        class: &Class,
        regressors: &Regressors,
        flat: &FlatMean<'_>,
    ) -> Option<DMatrix<f64>> {
        let p = self.r.len();
        let rows = DMatrix::from_fn(p, p + regressors.len(), |a, m| {
            if m < p { self.W[a * p + m] } else { class.covariates[m - p] * self.W[regressors[m - p] * p + a] }
        });
        let own = rows * flat.jacobian; // WX
        for c in 0..own.ncols() {
            for d in 0..=c {
                for k in 0..p {
                    for l in 0..=k {
                        let both = own[(k, c)] * own[(l, d)] + own[(l, c)] * own[(k, d)];
                        sums.spread[(pair(c, d), pair(k, l))] += 0.5 * class.count * both;
                    }
                }
            }
        }
        flat.covariance.map(|covariance| &own * covariance * own.transpose())
    }

    fn add_second(&self, sums: &mut Sums, class: &Class, regressors: &Regressors, uncertainty: Option<&DMatrix<f64>>) {
        let (p, n) = (self.r.len(), class.count);
        let mut inner = self.outer.clone();
        inner.iter_mut().zip(&self.W).for_each(|(m, w)| *m -= 0.5 * n * w);
        if let Some(uncertainty) = uncertainty {
            inner.iter_mut().zip(uncertainty.iter()).for_each(|(m, u)| *m += n * u); // symmetric
        }
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
