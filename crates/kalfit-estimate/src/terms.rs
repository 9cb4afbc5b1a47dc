//! The terms of ℓ and its derivatives from one class of tests at a point, for code that handles classes one at a time.
//! With S = I + RΣR' = LDL', U = L⁻¹R and u = L⁻¹(d - Rμ), the terms need no inverse of R, J or Σ and no square root:
//!
//! ```text
//! ℓ = constant - ½ log|D| - ½ u'D⁻¹u      W = U'D⁻¹U = (I+JΣ)⁻¹J      r = U'D⁻¹u = (I+JΣ)⁻¹(y - Jμ)
//! ```
#![expect(non_snake_case, reason = "W is the letter of the theory")]

use std::ops::Range;

use crate::chained::{ChainDetail, ChainTerms};
use crate::class::ClassRef;
use crate::lanes::{ClassEvaluator, Contribution};
use crate::point::{Point, Regressors};
use kalfit_algebra::rows::Rows;
use kalfit_lanes::Real;

/// The terms of one class at a point, with the workspace that computes the terms. Matrices are p × p by rows.
#[derive(Debug)]
pub struct ClassTerms<'a> {
    at: ClassEvaluator<'a>,
    /// |S| of one test as mantissa × 2^exponent.
    det: (f64, f64),
    /// Σ_j u_j'D⁻¹u_j over the class.
    pub quadratic: f64,
    /// (I+JΣ)⁻¹(y - Jμ) at the mean of d over the class.
    pub r: Vec<f64>,
    /// (I+JΣ)⁻¹J.
    pub(crate) W: Vec<f64>,
    /// Σ_j r_j r_j' over the class.
    pub(crate) outer: Vec<f64>,
    /// Var[ξ_i | z] of each phase for tests stored phase by phase, where requested ([`ChainDetail::Posterior`]).
    pub covariances: Vec<Rows<f64>>,
    /// log|S| of the links between phases alone, computed together with `covariances`.
    pub link_log_det: f64,
}

impl<'a> ClassTerms<'a> {
    /// A workspace for the terms of classes at a point; the terms are zero until a class is evaluated.
    pub fn new(point: &'a Point, regressors: &'a Regressors) -> ClassTerms<'a> {
        let p = point.mean.len();
        ClassTerms {
            at: ClassEvaluator::new(point, regressors),
            det: (1.0, 0.0),
            quadratic: 0.0,
            r: vec![0.0; p],
            W: vec![0.0; p * p],
            outer: vec![0.0; p * p],
            covariances: Vec::new(),
            link_log_det: 0.0,
        }
    }

    /// Computes the terms of a class. For tests stored phase by phase, `detail` selects the terms that are computed.
    /// The rest is zero: W and Σ r r' between phases, or, for posteriors, all of W and Σ r r'.
    pub fn evaluate(&mut self, class: ClassRef<'_>, detail: ChainDetail) {
        if let Some(chain) = class.chain {
            let terms = self.at.in_phases(class, chain, detail);
            return self.take((&chain.ranges(), class), &terms, detail, |x| x);
        }
        let p = self.r.len();
        let all = 0..p;
        let terms = self.at.whole(class, std::slice::from_ref(&all));
        (self.det, self.quadratic) = (terms.det(), terms.quadratic());
        for a in 0..p {
            self.r[a] = terms.r(0, a);
            for (b, &w) in terms.weight((0, a), 0).iter().enumerate() {
                (self.W[a * p + b], self.W[b * p + a]) = (w, w);
            }
            terms.outer((0, a), 0, &mut self.outer[a * p..][..p]);
        }
    }

    /// Σ_j ℓ_j over the class.
    pub fn value(&self, class: ClassRef<'_>) -> f64 {
        let (mantissa, exponent) = self.det;
        let log_det = mantissa.ln() + exponent * std::f64::consts::LN_2;
        class.constant - 0.5 * (class.count * log_det + self.quadratic)
    }

    /// Copies the terms of a class in phases that `detail` selects; `ranges` holds the positions of the states of each
    /// phase.
    #[inline(always)]
    pub(crate) fn take<N: Real>(
        &mut self,
        (ranges, class): (&[Range<usize>], ClassRef<'_>),
        terms: &ChainTerms<N>,
        detail: ChainDetail,
        of: impl Fn(N) -> f64,
    ) {
        let (mantissa, exponent) = terms.root_det;
        self.det = (of(mantissa) * of(mantissa), 2.0 * of(exponent));
        self.quadratic = of(terms.quadratic);
        [&mut self.r, &mut self.W, &mut self.outer].into_iter().for_each(|all| all.fill(0.0));
        for (r, own) in terms.r.iter().zip(ranges) {
            for (a, to) in self.r[own.clone()].iter_mut().enumerate() {
                *to = of(r[(a, 0)]);
            }
        }
        if detail == ChainDetail::Posterior {
            let (mantissa, exponent) = terms.link_root_det;
            self.link_log_det = 2.0 * (of(mantissa).ln() + of(exponent) * std::f64::consts::LN_2);
            let lane = |m: &Rows<N>| Rows::from_fn(m.nrows(), m.ncols(), |i, k| of(m[(i, k)]));
            self.covariances = terms.covariances.iter().map(lane).collect();
        } else {
            self.take_pairs((ranges, class), terms, of);
        }
    }

    /// Copies W and Σ r r' of each pair of phases for which W is known.
    #[inline(always)]
    fn take_pairs<N: Real>(
        &mut self,
        (own, class): (&[Range<usize>], ClassRef<'_>),
        terms: &ChainTerms<N>,
        of: impl Fn(N) -> f64,
    ) {
        let p = self.r.len();
        let mut blocks = terms.W.iter();
        for (k, one) in own.iter().enumerate() {
            for (i, other) in own[..=k].iter().enumerate() {
                let Some(block) = blocks.next().and_then(Option::as_ref) else { continue };
                for a in 0..one.len() {
                    for b in 0..other.len() {
                        let (x, y) = (terms.r[k].row(a), terms.r[i].row(b));
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
}
