//! Four numbers in an AVX2 register, with fused multiply-add.
//!
//! # Why the `unsafe` here is sound
//!
//! Every intrinsic needs AVX2 or FMA. The type `Avx2` is not public: only the generic code of a kernel uses `Avx2`, and
//! [`crate::Isa::run`] calls this code only where the machine has AVX2 and FMA. Loads and stores check the length of
//! the slice and need no alignment.
#![expect(unsafe_code, reason = "intrinsics of instructions found at run time")]

use std::arch::x86_64::*;
use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::{Lanes, Part, Real};

#[derive(Debug, Clone, Copy)]
pub(crate) struct Avx2(__m256d);

macro_rules! lane_operator {
    ($trait:ident, $method:ident, $intrinsic:ident) => {
        impl $trait for Avx2 {
            type Output = Avx2;
            #[inline(always)]
            fn $method(self, other: Avx2) -> Avx2 {
                // SAFETY: see the module
                Avx2(unsafe { $intrinsic(self.0, other.0) })
            }
        }
    };
}

lane_operator!(Add, add, _mm256_add_pd);
lane_operator!(Sub, sub, _mm256_sub_pd);
lane_operator!(Mul, mul, _mm256_mul_pd);
lane_operator!(Div, div, _mm256_div_pd);

impl Neg for Avx2 {
    type Output = Avx2;
    #[inline(always)]
    fn neg(self) -> Avx2 {
        Avx2::splat(-0.0) - self
    }
}

#[target_feature(enable = "avx2,fma")]
#[inline(never)]
fn apart<P: Part>(part: P) -> P::Output {
    part.run()
}

impl Real for Avx2 {
    #[inline(always)]
    fn apart<P: Part>(part: P) -> P::Output {
        // SAFETY: see the module
        unsafe { apart(part) }
    }

    #[inline(always)]
    fn splat(x: f64) -> Avx2 {
        // SAFETY: see the module
        Avx2(unsafe { _mm256_set1_pd(x) })
    }

    #[inline(always)]
    fn fma(self, factor: Avx2, addend: Avx2) -> Avx2 {
        // SAFETY: see the module
        Avx2(unsafe { _mm256_fmadd_pd(self.0, factor.0, addend.0) })
    }

    #[inline(always)]
    fn fnma(self, factor: Avx2, addend: Avx2) -> Avx2 {
        // SAFETY: see the module
        Avx2(unsafe { _mm256_fnmadd_pd(self.0, factor.0, addend.0) })
    }

    #[inline(always)]
    fn minimum(self, other: Avx2) -> Avx2 {
        // SAFETY: see the module
        let least = Avx2(unsafe { _mm256_min_pd(other.0, self.0) });
        least.unless_unknown(other) // the instruction returns the second operand if either is NaN
    }

    #[inline(always)]
    fn maximum(self, other: Avx2) -> Avx2 {
        // SAFETY: see the module
        let most = Avx2(unsafe { _mm256_max_pd(other.0, self.0) });
        most.unless_unknown(other) // as in `minimum`
    }

    #[inline(always)]
    fn magnitude(self) -> Avx2 {
        // SAFETY: see the module
        Avx2(unsafe { _mm256_andnot_pd(_mm256_set1_pd(-0.0), self.0) })
    }

    #[inline(always)]
    fn at_most(self, bound: Avx2) -> bool {
        // SAFETY: see the module
        unsafe { _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_LE_OQ>(self.0, bound.0)) == 0xf }
    }

    #[inline(always)]
    fn recip_or_zero(self) -> Avx2 {
        // SAFETY: see the module
        unsafe {
            let positive = _mm256_cmp_pd::<_CMP_GT_OQ>(self.0, _mm256_setzero_pd());
            Avx2(_mm256_and_pd(positive, _mm256_div_pd(_mm256_set1_pd(1.0), self.0)))
        }
    }

    #[inline(always)]
    fn or_one(self) -> Avx2 {
        // SAFETY: see the module
        unsafe {
            let positive = _mm256_cmp_pd::<_CMP_GT_OQ>(self.0, _mm256_setzero_pd());
            Avx2(_mm256_blendv_pd(_mm256_set1_pd(1.0), self.0, positive))
        }
    }

    #[inline(always)]
    fn root(self) -> Avx2 {
        // SAFETY: see the module
        Avx2(unsafe { _mm256_sqrt_pd(self.0) })
    }

    #[inline(always)]
    fn split(self) -> (Avx2, Avx2) {
        let mut mantissa = [0.0; 4];
        self.store(&mut mantissa);
        let mut exponent = [0.0; 4];
        for k in 0..4 {
            (mantissa[k], exponent[k]) = Real::split(mantissa[k]);
        }
        (Avx2::load(&mantissa), Avx2::load(&exponent))
    }
}

impl Avx2 {
    /// NaN where `other` is NaN, else `self`.
    #[inline(always)]
    fn unless_unknown(self, other: Avx2) -> Avx2 {
        // SAFETY: see the module
        unsafe {
            let unknown = _mm256_cmp_pd::<_CMP_UNORD_Q>(other.0, other.0);
            Avx2(_mm256_blendv_pd(self.0, other.0, unknown))
        }
    }
}

impl Lanes for Avx2 {
    const COUNT: usize = 4;
    const MAX_FIXED_SIZE: usize = 6;

    #[inline(always)]
    fn load(from: &[f64]) -> Avx2 {
        let from = &from[..4];
        // SAFETY: see the module; the slice has four numbers
        Avx2(unsafe { _mm256_loadu_pd(from.as_ptr()) })
    }

    #[inline(always)]
    fn store(self, to: &mut [f64]) {
        let to = &mut to[..4];
        // SAFETY: see the module; the slice has room for four numbers
        unsafe { _mm256_storeu_pd(to.as_mut_ptr(), self.0) }
    }
}
