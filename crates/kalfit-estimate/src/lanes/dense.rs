//! Likelihood terms, at a point, of a block of tests in lanes, each with one J: the pass of the theory with sizes known
//! at compile time (theory §3). [`super::any`] has the same formulas for any size and any class.
//!
//! ```text
//! S = I + RΣR' = LDL'      U = L⁻¹R      u = L⁻¹(d - Rμ)      W = U'D⁻¹U      r = U'D⁻¹u
//! ```
#![expect(non_snake_case, reason = "R, S, L, D, U, W, F are the letters of the theory")]

use kalfit_lanes::Lanes;

/// The point at which ℓ is evaluated: μ and F with Σ = FF', lower triangular.
#[derive(Debug, Clone, Copy)]
pub(super) struct LaneLaw<const P: usize> {
    /// Factor on d in the blocks.
    pub(super) unit: f64,
    pub(super) mean: [f64; P],
    pub(super) root: [[f64; P]; P],
}

/// Likelihood terms of a block, one test in each lane.
#[derive(Debug, Clone, Copy)]
pub(super) struct BlockTerms<T, const P: usize> {
    /// The quadratic form u'D⁻¹u.
    pub(super) quadratic: T,
    pub(super) r: [T; P],
    /// Lower triangle of W.
    pub(super) W: [[T; P]; P],
}

/// Number of values of one test in a block: R by columns, then d.
pub(super) const fn entries(p: usize) -> usize {
    p * (p + 1) / 2 + p
}

/// Evaluates a block, and multiplies `det`, mantissa × 2^exponent, by |S|.
#[inline(always)]
pub(super) fn block_terms<T: Lanes, const P: usize>(
    block: &[f64],
    law: &LaneLaw<P>,
    det: &mut (T, T),
) -> BlockTerms<T, P> {
    let zero = T::splat(0.0);
    let mut R = [[zero; P]; P];
    let block = &block[..entries(P) * T::COUNT];
    let mut at = 0;
    for k in 0..P {
        for i in 0..=k {
            R[i][k] = T::load(&block[at * T::COUNT..]);
            at += 1;
        }
    }
    let mut u = [zero; P];
    for i in 0..P {
        u[i] = T::load(&block[(at + i) * T::COUNT..]) * T::splat(law.unit);
        for k in i..P {
            u[i] = R[i][k].fnma(T::splat(law.mean[k]), u[i]);
        }
    }
    let mut S = covariance::<T, P>(&R, law);
    let inverse = factorise::<T, P>(&mut S, det);
    forward::<T, P>(&S, &mut R, &mut u);
    let (mut W, mut r, mut quadratic) = ([[zero; P]; P], [zero; P], zero);
    for i in 0..P {
        let weighed = u[i] * inverse[i];
        quadratic = weighed.fma(u[i], quadratic);
        for a in 0..P {
            r[a] = R[i][a].fma(weighed, r[a]);
            let scaled = R[i][a] * inverse[i];
            for b in 0..=a {
                W[a][b] = scaled.fma(R[i][b], W[a][b]);
            }
        }
    }
    BlockTerms { quadratic, r, W }
}

/// The lower triangle of I + RF(RF)'.
#[inline(always)]
fn covariance<T: Lanes, const P: usize>(R: &[[T; P]; P], law: &LaneLaw<P>) -> [[T; P]; P] {
    let mut S = [[T::splat(0.0); P]; P];
    for i in 0..P {
        S[i][i] = T::splat(1.0);
    }
    for c in 0..P {
        // column c of RF
        let mut X = [T::splat(0.0); P];
        for i in 0..P {
            for k in if i > c { i } else { c }..P {
                X[i] = R[i][k].fma(T::splat(law.root[k][c]), X[i]);
            }
        }
        for i in 0..P {
            for k in 0..=i {
                S[i][k] = X[i].fma(X[k], S[i][k]);
            }
        }
    }
    S
}

/// Factorises S = LDL' in place, L below the diagonal; multiplies `det` by |D| and returns D⁻¹.
#[inline(always)]
fn factorise<T: Lanes, const P: usize>(S: &mut [[T; P]; P], det: &mut (T, T)) -> [T; P] {
    let one = T::splat(1.0);
    let mut inverse = [one; P];
    for k in 0..P {
        // S ⪰ I, so no pivot is below 1 but for rounding
        let pivot = S[k][k].maximum(one);
        inverse[k] = pivot.recip();
        let (mantissa, exponent) = (det.0 * pivot).split();
        *det = (mantissa, det.1 + exponent);
        for i in k + 1..P {
            let l = S[i][k] * inverse[k];
            for j in k + 1..=i {
                S[i][j] = l.fnma(S[j][k], S[i][j]);
            }
        }
        for i in k + 1..P {
            S[i][k] = S[i][k] * inverse[k];
        }
    }
    inverse
}

/// Replaces R by U = L⁻¹R and u by L⁻¹u.
#[inline(always)]
fn forward<T: Lanes, const P: usize>(L: &[[T; P]; P], R: &mut [[T; P]; P], u: &mut [T; P]) {
    for k in 0..P {
        for i in k + 1..P {
            let l = L[i][k];
            u[i] = l.fnma(u[k], u[i]);
            for a in 0..P {
                R[i][a] = l.fnma(R[k][a], R[i][a]);
            }
        }
    }
}
