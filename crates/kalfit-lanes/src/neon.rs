//! Four numbers in two NEON registers, with fused multiply-add.
//!
//! NEON and AVX2 have four lanes and equal roundings of every operation: a kernel gives equal bits with both.
//!
//! # Why the `unsafe` here is sound
//!
//! Every intrinsic needs NEON, which every processor of the target has: this module is compiled for no other target.
//! Loads and stores check the length of the slice and need no alignment.
#![expect(unsafe_code, reason = "intrinsics of instructions that every processor of the target has")]

use std::arch::aarch64::*;
use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::{Lanes, Real};

#[derive(Debug, Clone, Copy)]
pub(crate) struct Neon(float64x2_t, float64x2_t);

macro_rules! operator {
    ($trait:ident, $method:ident, $intrinsic:ident) => {
        impl $trait for Neon {
            type Output = Neon;
            #[inline(always)]
            fn $method(self, other: Neon) -> Neon {
                // SAFETY: see the module
                unsafe { Neon($intrinsic(self.0, other.0), $intrinsic(self.1, other.1)) }
            }
        }
    };
}

operator!(Add, add, vaddq_f64);
operator!(Sub, sub, vsubq_f64);
operator!(Mul, mul, vmulq_f64);
operator!(Div, div, vdivq_f64);

impl Neg for Neon {
    type Output = Neon;
    #[inline(always)]
    fn neg(self) -> Neon {
        // SAFETY: see the module
        unsafe { Neon(vnegq_f64(self.0), vnegq_f64(self.1)) }
    }
}

impl Neon {
    /// `other` where `other` is NaN or `first < second`, else `self`.
    #[inline(always)]
    fn unless(self, other: Neon, first: Neon, second: Neon) -> Neon {
        // SAFETY: see the module
        let half = |own, other, first, second| unsafe {
            let known = vbslq_f64(vcltq_f64(first, second), other, own);
            vbslq_f64(vceqq_f64(other, other), known, other)
        };
        Neon(half(self.0, other.0, first.0, second.0), half(self.1, other.1, first.1, second.1))
    }

    /// `self` where `of` is above zero, else `other`.
    #[inline(always)]
    fn if_positive(self, of: Neon, other: Neon) -> Neon {
        // SAFETY: see the module
        let half = |own, of, other| unsafe { vbslq_f64(vcgtzq_f64(of), own, other) };
        Neon(half(self.0, of.0, other.0), half(self.1, of.1, other.1))
    }
}

impl Real for Neon {
    #[inline(always)]
    fn splat(x: f64) -> Neon {
        // SAFETY: see the module
        unsafe { Neon(vdupq_n_f64(x), vdupq_n_f64(x)) }
    }

    #[inline(always)]
    fn fma(self, factor: Neon, addend: Neon) -> Neon {
        // SAFETY: see the module
        unsafe { Neon(vfmaq_f64(addend.0, self.0, factor.0), vfmaq_f64(addend.1, self.1, factor.1)) }
    }

    #[inline(always)]
    fn fnma(self, factor: Neon, addend: Neon) -> Neon {
        // SAFETY: see the module
        unsafe { Neon(vfmsq_f64(addend.0, self.0, factor.0), vfmsq_f64(addend.1, self.1, factor.1)) }
    }

    #[inline(always)]
    fn minimum(self, other: Neon) -> Neon {
        self.unless(other, other, self)
    }

    #[inline(always)]
    fn maximum(self, other: Neon) -> Neon {
        self.unless(other, self, other)
    }

    #[inline(always)]
    fn magnitude(self) -> Neon {
        // SAFETY: see the module
        unsafe { Neon(vabsq_f64(self.0), vabsq_f64(self.1)) }
    }

    #[inline(always)]
    fn at_most(self, bound: Neon) -> bool {
        // SAFETY: see the module
        unsafe {
            let both = vandq_u64(vcleq_f64(self.0, bound.0), vcleq_f64(self.1, bound.1));
            vgetq_lane_u64::<0>(both) & vgetq_lane_u64::<1>(both) == u64::MAX
        }
    }

    #[inline(always)]
    fn recip_or_zero(self) -> Neon {
        (Neon::splat(1.0) / self).if_positive(self, Neon::splat(0.0))
    }

    #[inline(always)]
    fn or_one(self) -> Neon {
        self.if_positive(self, Neon::splat(1.0))
    }

    #[inline(always)]
    fn root(self) -> Neon {
        // SAFETY: see the module
        unsafe { Neon(vsqrtq_f64(self.0), vsqrtq_f64(self.1)) }
    }

    #[inline(always)]
    fn split(self) -> (Neon, Neon) {
        let mut mantissa = [0.0; 4];
        self.store(&mut mantissa);
        let mut exponent = [0.0; 4];
        for k in 0..4 {
            (mantissa[k], exponent[k]) = Real::split(mantissa[k]);
        }
        (Neon::load(&mantissa), Neon::load(&exponent))
    }
}

impl Lanes for Neon {
    const COUNT: usize = 4;
    const MAX_FIXED_SIZE: usize = 6;

    #[inline(always)]
    fn load(from: &[f64]) -> Neon {
        let from = &from[..4];
        // SAFETY: see the module; the slice has four numbers
        unsafe { Neon(vld1q_f64(from.as_ptr()), vld1q_f64(from[2..].as_ptr())) }
    }

    #[inline(always)]
    fn store(self, to: &mut [f64]) {
        let to = &mut to[..4];
        // SAFETY: see the module; the slice has room for four numbers
        unsafe {
            vst1q_f64(to.as_mut_ptr(), self.0);
            vst1q_f64(to[2..].as_mut_ptr(), self.1);
        }
    }
}
