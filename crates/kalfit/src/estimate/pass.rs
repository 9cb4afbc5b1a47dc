//! One pass over the classes: ℓ(μ, Σ) and its derivatives (theory §3), the sums that every solver lives on.
//!
//! With S = I + RΣR' = CC', V = C⁻¹R and w = C⁻¹(d - Rμ), which needs no inverse of R, J or Σ:
//!
//! ```text
//! ℓ = constant - ½ log|S| - ½ w'w      W = V'V = (I+JΣ)⁻¹J      r = V'w = (I+JΣ)⁻¹(y - Jμ)
//! ```
#![expect(non_snake_case, reason = "R, S, C, V, W, F are the letters of the theory")]

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::estimate::classes::{Class, Classes};
use crate::linalg::fold::fold;
use crate::linalg::symmetric::{over_pairs, pair, pairs};

/// Classes summed by one task. Fixed, so that sums have the same bits for any number of threads.
const CHUNK: usize = 128;

/// Where ℓ is evaluated, in η: the mean (without regression), scaled regression coefficients, and F with Σ = FF'.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Point {
    pub(crate) mean: Vec<f64>,
    pub(crate) coefficients: Vec<f64>,
    pub(crate) root: DMatrix<f64>,
}

impl Point {
    /// Σ = FF'.
    pub(crate) fn covariance(&self) -> DMatrix<f64> {
        &self.root * self.root.transpose()
    }
}

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

/// Elements of the mean that the regression coefficients act on.
pub(crate) type Regressors = [usize];

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

/// What one class says at a point. Matrices p × p by rows.
#[derive(Debug, Clone)]
pub(crate) struct Terms {
    p: usize,
    /// RF, p × p.
    RF: Vec<f64>,
    /// C, lower triangular.
    C: Vec<f64>,
    V: Vec<f64>,
    /// C⁻¹ (d - Rμ) of the class mean.
    w: Vec<f64>,
    work: Vec<f64>,
    /// Σ_j ℓ_j over the class.
    pub(crate) value: f64,
    /// (I+JΣ)⁻¹(y - Jμ) of the class mean.
    pub(crate) r: Vec<f64>,
    /// (I+JΣ)⁻¹J.
    pub(crate) W: Vec<f64>,
    /// Σ_j r_j r_j' over the class.
    pub(crate) outer: Vec<f64>,
}

impl Terms {
    pub(crate) fn new(p: usize) -> Terms {
        let square = || vec![0.0; p * p];
        let vector = || vec![0.0; p];
        Terms {
            p,
            RF: square(),
            C: square(),
            V: square(),
            w: vector(),
            work: square(),
            value: 0.0,
            r: vector(),
            W: square(),
            outer: square(),
        }
    }

    pub(crate) fn evaluate(&mut self, class: &Class, regressors: &Regressors, point: &Point) {
        let p = self.p;
        self.factorise(class, &point.root);
        // V = C⁻¹R
        self.V.copy_from_slice(&class.factor);
        solve_lower(&self.C, &mut self.V, p, p);
        // w = C⁻¹(d - Rμ_j)
        for i in 0..p {
            let mut residual = class.mean[i];
            for k in i..p {
                residual -= class.factor[i * p + k] * point.mean[k];
            }
            for (c, &element) in regressors.iter().enumerate() {
                residual -= class.factor[i * p + element] * class.covariates[c] * point.coefficients[c];
            }
            self.w[i] = residual;
        }
        solve_lower(&self.C, &mut self.w, p, 1);
        let log_det: f64 = 2.0 * (0..p).map(|i| self.C[i * p + i].ln()).sum::<f64>();
        let mut quadratic = class.count * self.w.iter().map(|x| x * x).sum::<f64>();
        transposed_times(&self.V, &self.w, &mut self.r, p);
        for a in 0..p {
            for b in 0..=a {
                let dot: f64 = (0..p).map(|i| self.V[i * p + a] * self.V[i * p + b]).sum();
                let outer = class.count * self.r[a] * self.r[b];
                self.W[a * p + b] = dot;
                self.W[b * p + a] = dot;
                self.outer[a * p + b] = outer;
                self.outer[b * p + a] = outer;
            }
        }
        if let Some(scatter) = &class.scatter {
            quadratic += self.scatter(scatter);
        }
        self.value = class.constant - 0.5 * (class.count * log_det + quadratic);
    }

    /// C with CC' = I + RΣR'.
    fn factorise(&mut self, class: &Class, F: &DMatrix<f64>) {
        let p = self.p;
        for i in 0..p {
            for c in 0..p {
                self.RF[i * p + c] = (i..p).map(|k| class.factor[i * p + k] * F[(k, c)]).sum();
            }
        }
        if class.square_root {
            return self.factorise_by_qr();
        }
        for i in 0..p {
            for k in 0..=i {
                let dot: f64 = (0..p).map(|c| self.RF[i * p + c] * self.RF[k * p + c]).sum();
                self.C[i * p + k] = dot + f64::from(u8::from(i == k));
            }
        }
        cholesky(&mut self.C, p);
    }

    /// The same C without forming RΣR': the rows of (RF)' folded into I by QR.
    fn factorise_by_qr(&mut self) {
        let p = self.p;
        let mut upper = vec![0.0; p * p];
        (0..p).for_each(|i| upper[i * p + i] = 1.0);
        for c in 0..p {
            for i in 0..p {
                self.work[c * p + i] = self.RF[i * p + c];
            }
        }
        fold(&mut upper, &mut self.work, p);
        for i in 0..p {
            for k in 0..p {
                self.C[i * p + k] = if k <= i { upper[k * p + i] } else { 0.0 };
            }
        }
    }

    /// Adds what the tests' scatter about their mean gives to Σ r r', and returns its part of Σ w'w.
    fn scatter(&mut self, scatter: &[f64]) -> f64 {
        let p = self.p;
        // T = C⁻¹ scatter C⁻ᵀ
        self.work.copy_from_slice(scatter);
        solve_lower(&self.C, &mut self.work, p, p);
        transpose(&mut self.work, p);
        solve_lower(&self.C, &mut self.work, p, p);
        let trace = (0..p).map(|i| self.work[i * p + i]).sum();
        // V'TV
        for b in 0..p {
            for i in 0..p {
                self.RF[i * p + b] = (0..p).map(|k| self.work[i * p + k] * self.V[k * p + b]).sum();
            }
        }
        for a in 0..p {
            for b in 0..p {
                self.outer[a * p + b] += (0..p).map(|i| self.V[i * p + a] * self.RF[i * p + b]).sum::<f64>();
            }
        }
        trace
    }

    /// w'w of the class mean: the squared distance of a single test from the mean, in its own innovations.
    pub(crate) fn distance(&self) -> f64 {
        self.w.iter().map(|x| x * x).sum()
    }

    fn add_to(&self, sums: &mut Sums, class: &Class, regressors: &Regressors, order: Order) {
        let (p, n) = (self.p, class.count);
        sums.value += self.value;
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
        let (p, n, x) = (self.p, class.count, class.covariates[at.0]);
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
        let (p, n) = (self.p, class.count);
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
        let p = self.p;
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

/// In-place lower Cholesky factor of a p × p matrix by rows; only the lower triangle is read.
fn cholesky(a: &mut [f64], p: usize) {
    for i in 0..p {
        for k in 0..=i {
            let mut sum = a[i * p + k];
            for c in 0..k {
                sum -= a[i * p + c] * a[k * p + c];
            }
            a[i * p + k] = if i == k { sum.max(1.0).sqrt() } else { sum / a[k * p + k] };
        }
    }
}

/// X ← C⁻¹X, C lower triangular p × p by rows, X p × columns by rows.
fn solve_lower(C: &[f64], X: &mut [f64], p: usize, columns: usize) {
    for i in 0..p {
        let (done, rest) = X.split_at_mut(i * columns);
        let row = &mut rest[..columns];
        for k in 0..i {
            let factor = C[i * p + k];
            row.iter_mut().zip(&done[k * columns..]).for_each(|(x, d)| *x -= factor * d);
        }
        let pivot = C[i * p + i].recip();
        row.iter_mut().for_each(|x| *x *= pivot);
    }
}

fn transposed_times(V: &[f64], w: &[f64], r: &mut [f64], p: usize) {
    for a in 0..p {
        r[a] = (0..p).map(|i| V[i * p + a] * w[i]).sum();
    }
}

fn transpose(a: &mut [f64], p: usize) {
    for i in 0..p {
        for k in 0..i {
            a.swap(i * p + k, k * p + i);
        }
    }
}
