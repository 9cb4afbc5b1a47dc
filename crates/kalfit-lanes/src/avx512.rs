//! Eight numbers in an AVX-512 register.
//!
//! # Why the `unsafe` here is sound
//!
//! Every intrinsic needs AVX-512F. The type `Avx512` is not public: only the generic code of a kernel uses `Avx512`,
//! and [`crate::Isa::run`] calls this code only where the machine has AVX-512F. Loads and stores check the length of
//! the slice and need no alignment.
#![expect(unsafe_code, reason = "intrinsics of instructions found at run time")]

use std::arch::x86_64::*;
use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::{Lanes, Part, Real};

#[derive(Debug, Clone, Copy)]
pub(crate) struct Avx512(__m512d);

macro_rules! lane_operator {
    ($trait:ident, $method:ident, $intrinsic:ident) => {
        impl $trait for Avx512 {
            type Output = Avx512;
            #[inline(always)]
            fn $method(self, other: Avx512) -> Avx512 {
                // SAFETY: see the module
                Avx512(unsafe { $intrinsic(self.0, other.0) })
            }
        }
    };
}

lane_operator!(Add, add, _mm512_add_pd);
lane_operator!(Sub, sub, _mm512_sub_pd);
lane_operator!(Mul, mul, _mm512_mul_pd);
lane_operator!(Div, div, _mm512_div_pd);

impl Neg for Avx512 {
    type Output = Avx512;
    #[inline(always)]
    fn neg(self) -> Avx512 {
        Avx512::splat(-0.0) - self
    }
}

#[target_feature(enable = "avx512f,avx2,fma")]
#[inline(never)]
fn apart<P: Part>(part: P) -> P::Output {
    part.run()
}

impl Real for Avx512 {
    #[inline(always)]
    fn apart<P: Part>(part: P) -> P::Output {
        // SAFETY: see the module
        unsafe { apart(part) }
    }

    #[inline(always)]
    fn splat(x: f64) -> Avx512 {
        // SAFETY: see the module
        Avx512(unsafe { _mm512_set1_pd(x) })
    }

    #[inline(always)]
    fn fma(self, factor: Avx512, addend: Avx512) -> Avx512 {
        // SAFETY: see the module
        Avx512(unsafe { _mm512_fmadd_pd(self.0, factor.0, addend.0) })
    }

    #[inline(always)]
    fn fnma(self, factor: Avx512, addend: Avx512) -> Avx512 {
        // SAFETY: see the module
        Avx512(unsafe { _mm512_fnmadd_pd(self.0, factor.0, addend.0) })
    }

    #[inline(always)]
    fn minimum(self, other: Avx512) -> Avx512 {
        // SAFETY: see the module
        let least = Avx512(unsafe { _mm512_min_pd(other.0, self.0) });
        least.unless_unknown(other) // the instruction returns the second operand if either is NaN
    }

    #[inline(always)]
    fn maximum(self, other: Avx512) -> Avx512 {
        // SAFETY: see the module
        let most = Avx512(unsafe { _mm512_max_pd(other.0, self.0) });
        most.unless_unknown(other) // as in `minimum`
    }

    #[inline(always)]
    fn magnitude(self) -> Avx512 {
        // SAFETY: see the module
        Avx512(unsafe { _mm512_abs_pd(self.0) })
    }

    #[inline(always)]
    fn at_most(self, bound: Avx512) -> bool {
        // SAFETY: see the module
        unsafe { _mm512_cmp_pd_mask::<_CMP_LE_OQ>(self.0, bound.0) == 0xff }
    }

    /// Two steps of Newton's method from an estimate; a division would take as long as 32 products.
    #[inline(always)]
    fn recip(self) -> Avx512 {
        // SAFETY: see the module
        let mut x = Avx512(unsafe { _mm512_rcp14_pd(self.0) });
        let one = Avx512::splat(1.0);
        for _ in 0..2 {
            x = x.fma(self.fnma(x, one), x);
        }
        x
    }

    /// Two steps of Newton's method from an estimate, as in `recip`.
    #[inline(always)]
    fn recip_root(self) -> Avx512 {
        // SAFETY: see the module
        let mut x = Avx512(unsafe { _mm512_rsqrt14_pd(self.0) });
        let (half, one) = (Avx512::splat(0.5), Avx512::splat(1.0));
        for _ in 0..2 {
            let off = (self * x).fnma(x, one);
            x = (half * off).fma(x, x);
        }
        x
    }

    #[inline(always)]
    fn recip_or_zero(self) -> Avx512 {
        // SAFETY: see the module
        unsafe {
            let positive = _mm512_cmp_pd_mask::<_CMP_GT_OQ>(self.0, _mm512_setzero_pd());
            Avx512(_mm512_maskz_div_pd(positive, _mm512_set1_pd(1.0), self.0))
        }
    }

    #[inline(always)]
    fn or_one(self) -> Avx512 {
        // SAFETY: see the module
        unsafe {
            let positive = _mm512_cmp_pd_mask::<_CMP_GT_OQ>(self.0, _mm512_setzero_pd());
            Avx512(_mm512_mask_mov_pd(_mm512_set1_pd(1.0), positive, self.0))
        }
    }

    #[inline(always)]
    fn root(self) -> Avx512 {
        // SAFETY: see the module
        Avx512(unsafe { _mm512_sqrt_pd(self.0) })
    }

    #[inline(always)]
    fn split(self) -> (Avx512, Avx512) {
        // SAFETY: see the module
        unsafe {
            let mantissa = _mm512_getmant_pd::<_MM_MANT_NORM_1_2, _MM_MANT_SIGN_ZERO>(self.0);
            (Avx512(mantissa), Avx512(_mm512_getexp_pd(self.0)))
        }
    }
}

impl Avx512 {
    /// NaN where `other` is NaN, else `self`.
    #[inline(always)]
    fn unless_unknown(self, other: Avx512) -> Avx512 {
        // SAFETY: see the module
        unsafe {
            let unknown = _mm512_cmp_pd_mask::<_CMP_UNORD_Q>(other.0, other.0);
            Avx512(_mm512_mask_mov_pd(self.0, unknown, other.0))
        }
    }
}

impl Lanes for Avx512 {
    const COUNT: usize = 8;
    const MAX_FIXED_SIZE: usize = 10;

    #[inline(always)]
    fn load(from: &[f64]) -> Avx512 {
        let from = &from[..8];
        // SAFETY: see the module; the slice has eight numbers
        Avx512(unsafe { _mm512_loadu_pd(from.as_ptr()) })
    }

    #[inline(always)]
    fn store(self, to: &mut [f64]) {
        let to = &mut to[..8];
        // SAFETY: see the module; the slice has room for eight numbers
        unsafe { _mm512_storeu_pd(to.as_mut_ptr(), self.0) }
    }

    #[inline(always)]
    fn lane(self, lane: usize) -> f64 {
        assert!(lane < 8, "there are eight lanes");
        // SAFETY: see the module
        unsafe { _mm512_cvtsd_f64(_mm512_permutexvar_pd(_mm512_set1_epi64(lane as i64), self.0)) }
    }

    #[inline(always)]
    fn sum(self) -> f64 {
        // SAFETY: see the module
        unsafe {
            let four = _mm256_add_pd(_mm512_castpd512_pd256(self.0), _mm512_extractf64x4_pd::<1>(self.0));
            let two = _mm_add_pd(_mm256_castpd256_pd128(four), _mm256_extractf128_pd::<1>(four));
            _mm_cvtsd_f64(_mm_add_sd(two, _mm_unpackhi_pd(two, two)))
        }
    }
}
