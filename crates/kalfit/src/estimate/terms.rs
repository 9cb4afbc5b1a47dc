//! What one class of tests says at a point: the kernel of every pass, one source for every kind of [`Real`].
//!
//! With S = I + RΣR' = LDL', U = L⁻¹R and u = L⁻¹(d - Rμ), which needs no inverse of R, J or Σ and no square root:
//!
//! ```text
//! ℓ = constant - ½ log|D| - ½ u'D⁻¹u      W = U'D⁻¹U = (I+JΣ)⁻¹J      r = U'D⁻¹u = (I+JΣ)⁻¹(y - Jμ)
//! ```
#![expect(non_snake_case, reason = "R, S, L, D, U, W, F are the letters of the theory")]

use std::ops::Range;

use nalgebra::DMatrix;

use crate::estimate::chained::{ChainDetail, ChainTerms};
use crate::estimate::class::ClassRef;
use crate::estimate::point::{Point, Regressors};
use crate::linalg::fold::fold;
use crate::linalg::rows::Rows;
use kalfit_lanes::Real;

/// What one class says at a point, and the room to work it out. Matrices p × p by rows.
#[derive(Debug, Clone)]
pub(crate) struct ClassTerms<T = f64> {
    p: usize,
    /// RF, then work.
    work: Vec<T>,
    other: Vec<T>,
    /// L below the diagonal; S while it is being factorised.
    L: Vec<T>,
    /// D⁻¹.
    inverse: Vec<T>,
    U: Vec<T>,
    u: Vec<T>,
    /// log|D| = ln(mantissa) + exponent ln 2.
    mantissa: T,
    exponent: T,
    /// Σ_j u_j'D⁻¹u_j over the class.
    pub(crate) quadratic: T,
    /// (I+JΣ)⁻¹(y - Jμ) of the class mean.
    pub(crate) r: Vec<T>,
    /// (I+JΣ)⁻¹J.
    pub(crate) W: Vec<T>,
    /// Σ_j r_j r_j' over the class.
    pub(crate) outer: Vec<T>,
    /// Of tests kept phase by phase, Var[ξ_i | z] of each phase, where it was asked for ([`ChainDetail::Posterior`]).
    pub(crate) covariances: Vec<Rows<T>>,
    /// And log|S| of the links alone.
    pub(crate) link_log_det: f64,
}

impl<T: Real> ClassTerms<T> {
    pub(crate) fn new(p: usize) -> ClassTerms<T> {
        let zero = T::splat(0.0);
        let square = || vec![zero; p * p];
        let vector = || vec![zero; p];
        ClassTerms {
            p,
            work: square(),
            other: square(),
            L: square(),
            inverse: vector(),
            U: square(),
            u: vector(),
            mantissa: T::splat(1.0),
            exponent: zero,
            quadratic: zero,
            r: vector(),
            W: square(),
            outer: square(),
            covariances: Vec::new(),
            link_log_det: 0.0,
        }
    }

    /// RF into `work`. R is upper triangular.
    fn spread(&mut self, class: ClassRef<'_, T>, F: &DMatrix<f64>) {
        let p = self.p;
        for i in 0..p {
            for c in 0..p {
                let mut sum = T::splat(0.0);
                for k in i..p {
                    sum = class.factor[i * p + k].fma(T::splat(F[(k, c)]), sum);
                }
                self.work[i * p + c] = sum;
            }
        }
    }

    /// S = I + RF(RF)' = LDL'.
    pub(crate) fn factorise(&mut self, class: ClassRef<'_, T>, F: &DMatrix<f64>) {
        let p = self.p;
        self.spread(class, F);
        (self.mantissa, self.exponent) = (T::splat(1.0), T::splat(0.0));
        for i in 0..p {
            for k in 0..=i {
                let mut sum = T::splat(if i == k { 1.0 } else { 0.0 });
                for c in 0..p {
                    sum = self.work[i * p + c].fma(self.work[k * p + c], sum);
                }
                // the row of LD so far stands in L; `other` keeps the row of L itself
                for c in 0..k {
                    sum = self.L[i * p + c].fnma(self.other[k * p + c], sum);
                }
                self.L[i * p + k] = sum;
                if k < i {
                    self.other[i * p + k] = sum * self.inverse[k];
                }
            }
            // S ⪰ I, so no pivot is below one; rounding must not make it so
            let pivot = self.L[i * p + i].maximum(T::splat(1.0));
            self.pivot(i, pivot);
        }
        std::mem::swap(&mut self.L, &mut self.other);
    }

    fn pivot(&mut self, i: usize, pivot: T) {
        self.inverse[i] = T::splat(1.0) / pivot;
        let (mantissa, exponent) = (self.mantissa * pivot).split();
        self.mantissa = mantissa;
        self.exponent = self.exponent + exponent;
    }

    /// All sums from L and D.
    pub(crate) fn finish(&mut self, class: ClassRef<'_, T>, regressors: &Regressors, point: &Point) {
        let p = self.p;
        self.U.copy_from_slice(class.factor);
        solve_unit_lower(&self.L, &mut self.U, p, p);
        self.residual(class, regressors, point);
        solve_unit_lower(&self.L, &mut self.u, p, 1);
        let mut quadratic = T::splat(0.0);
        for i in 0..p {
            quadratic = (self.u[i] * self.u[i]).fma(self.inverse[i], quadratic);
        }
        self.quadratic = class.count * quadratic;
        for a in 0..p {
            let mut r = T::splat(0.0);
            for i in 0..p {
                r = (self.U[i * p + a] * self.inverse[i]).fma(self.u[i], r);
            }
            self.r[a] = r;
        }
        self.weigh();
        for a in 0..p {
            for b in 0..p {
                self.outer[a * p + b] = class.count * self.r[a] * self.r[b];
            }
        }
        for away in class.scatter.chunks_exact(p.max(1)) {
            self.scatter(away);
        }
    }

    /// d - Rμ_j of the class mean into u.
    fn residual(&mut self, class: ClassRef<'_, T>, regressors: &Regressors, point: &Point) {
        let p = self.p;
        for i in 0..p {
            let mut residual = class.mean[i];
            for k in i..p {
                residual = class.factor[i * p + k].fnma(T::splat(point.mean[k]), residual);
            }
            for (c, &element) in regressors.iter().enumerate() {
                let moved = class.covariates[c] * T::splat(point.coefficients[c]);
                residual = class.factor[i * p + element].fnma(moved, residual);
            }
            self.u[i] = residual;
        }
    }

    /// W = U'D⁻¹U.
    fn weigh(&mut self) {
        let p = self.p;
        for i in 0..p {
            for a in 0..p {
                self.other[i * p + a] = self.U[i * p + a] * self.inverse[i];
            }
        }
        for a in 0..p {
            for b in 0..=a {
                let mut sum = T::splat(0.0);
                for i in 0..p {
                    sum = self.U[i * p + a].fma(self.other[i * p + b], sum);
                }
                self.W[a * p + b] = sum;
                self.W[b * p + a] = sum;
            }
        }
    }

    /// Adds what a vector of the tests' scatter about their mean gives to Σ r r' and to Σ u'D⁻¹u.
    fn scatter(&mut self, away: &[T]) {
        let p = self.p;
        self.u.copy_from_slice(away);
        solve_unit_lower(&self.L, &mut self.u, p, 1);
        for i in 0..p {
            self.quadratic = (self.u[i] * self.u[i]).fma(self.inverse[i], self.quadratic);
        }
        let r = &mut self.work[..p];
        for a in 0..p {
            let mut sum = T::splat(0.0);
            for i in 0..p {
                sum = self.other[i * p + a].fma(self.u[i], sum); // D⁻¹U
            }
            r[a] = sum;
        }
        for a in 0..p {
            for b in 0..p {
                self.outer[a * p + b] = r[a].fma(r[b], self.outer[a * p + b]);
            }
        }
    }
}

impl ClassTerms<f64> {
    /// All that the class says at a point; of tests kept phase by phase in as much detail as is wanted, with zeros where nothing is:
    /// between phases, or, for posteriors, in all of W and Σ r r'.
    pub(crate) fn evaluate(
        &mut self,
        class: ClassRef<'_>,
        regressors: &Regressors,
        point: &Point,
        detail: ChainDetail,
    ) {
        if let Some(chain) = class.chain {
            let said = chain.chained().at(&point.mean_of(class, regressors), &point.root, detail);
            return self.take((&chain.ranges(), class), &said, detail, |x| x);
        }
        if class.square_root {
            self.factorise_by_qr(class, &point.root);
        } else {
            self.factorise(class, &point.root);
        }
        self.finish(class, regressors, point);
    }

    /// Σ_j ℓ_j over the class.
    pub(crate) fn value(&self, class: ClassRef<'_>) -> f64 {
        let log_det = self.mantissa.ln() + self.exponent * std::f64::consts::LN_2;
        class.constant - 0.5 * (class.count * log_det + self.quadratic)
    }

    /// |S| of one test as mantissa × 2^exponent.
    pub(crate) fn det(&self) -> (f64, f64) {
        (self.mantissa, self.exponent)
    }

    /// What a class in phases says, as far as it is wanted; where the states of its phases stand.
    #[inline(always)]
    pub(crate) fn take<N: Real>(
        &mut self,
        (ranges, class): (&[Range<usize>], ClassRef<'_>),
        said: &ChainTerms<N>,
        detail: ChainDetail,
        of: impl Fn(N) -> f64,
    ) {
        let (mantissa, exponent) = said.root_det;
        (self.mantissa, self.exponent) = (of(mantissa) * of(mantissa), 2.0 * of(exponent));
        self.quadratic = of(said.quadratic);
        [&mut self.r, &mut self.W, &mut self.outer].into_iter().for_each(|all| all.fill(0.0));
        for (r, own) in said.r.iter().zip(ranges) {
            for (a, to) in self.r[own.clone()].iter_mut().enumerate() {
                *to = of(r[(a, 0)]);
            }
        }
        if detail == ChainDetail::Posterior {
            let (mantissa, exponent) = said.link_root_det;
            self.link_log_det = 2.0 * (of(mantissa).ln() + of(exponent) * std::f64::consts::LN_2);
            let lane = |m: &Rows<N>| Rows::from_fn(m.nrows(), m.ncols(), |i, k| of(m[(i, k)]));
            self.covariances = said.covariances.iter().map(lane).collect();
        } else {
            self.take_pairs((ranges, class), said, of);
        }
    }

    /// W and Σ r r' of each pair of phases of which W is known.
    #[inline(always)]
    fn take_pairs<N: Real>(
        &mut self,
        (own, class): (&[Range<usize>], ClassRef<'_>),
        said: &ChainTerms<N>,
        of: impl Fn(N) -> f64,
    ) {
        let p = self.p;
        let mut blocks = said.W.iter();
        for (k, one) in own.iter().enumerate() {
            for (i, other) in own[..=k].iter().enumerate() {
                let Some(block) = blocks.next().and_then(Option::as_ref) else { continue };
                for a in 0..one.len() {
                    for b in 0..other.len() {
                        let (x, y) = (said.r[k].row(a), said.r[i].row(b));
                        let mut outer = class.count * self.r[one.start + a] * self.r[other.start + b];
                        for (&x, &y) in x[1..].iter().zip(&y[1..]) {
                            outer += of(x) * of(y);
                        }
                        let at = (one.start + a) * p + other.start + b;
                        let mirror = (other.start + b) * p + one.start + a;
                        let w = of(block[(a, b)]);
                        (self.W[at], self.W[mirror]) = (w, w);
                        (self.outer[at], self.outer[mirror]) = (outer, outer);
                    }
                }
            }
        }
    }

    /// The same L and D without forming RΣR': the rows of (RF)' folded into I by QR.
    fn factorise_by_qr(&mut self, class: ClassRef<'_>, F: &DMatrix<f64>) {
        let p = self.p;
        self.spread(class, F);
        transpose(&mut self.work, p);
        let mut upper = vec![0.0; p * p];
        (0..p).for_each(|i| upper[i * p + i] = 1.0);
        fold(&mut upper, &mut self.work, p);
        (self.mantissa, self.exponent) = (1.0, 0.0);
        for k in 0..p {
            let root = upper[k * p + k];
            for i in k + 1..p {
                self.L[i * p + k] = upper[k * p + i] / root;
            }
            self.pivot(k, root * root);
        }
    }
}

/// X ← L⁻¹X, L unit lower triangular p × p by rows, X p × columns by rows.
fn solve_unit_lower<T: Real>(L: &[T], X: &mut [T], p: usize, columns: usize) {
    for i in 1..p {
        let (done, rest) = X.split_at_mut(i * columns);
        let row = &mut rest[..columns];
        for k in 0..i {
            let factor = L[i * p + k];
            for (x, d) in row.iter_mut().zip(&done[k * columns..]) {
                *x = factor.fnma(*d, *x);
            }
        }
    }
}

fn transpose<T: Copy>(a: &mut [T], p: usize) {
    for i in 0..p {
        for k in 0..i {
            a.swap(i * p + k, k * p + i);
        }
    }
}
