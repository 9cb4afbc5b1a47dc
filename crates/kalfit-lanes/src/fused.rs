//! One number at a time with fused multiply-add, on machines that have the instruction: results have the same bits as
//! in a lane.

use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::{Lanes, Real};

/// One number with fused products. Only kernels that run [alone](crate::Isa::alone) use this type: elsewhere `mul_add`
/// would be a library call.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Fused(f64);

macro_rules! operator {
    ($trait:ident, $method:ident) => {
        impl $trait for Fused {
            type Output = Fused;
            #[inline(always)]
            fn $method(self, other: Fused) -> Fused {
                Fused(self.0.$method(other.0))
            }
        }
    };
}

operator!(Add, add);
operator!(Sub, sub);
operator!(Mul, mul);
operator!(Div, div);

impl Neg for Fused {
    type Output = Fused;
    #[inline(always)]
    fn neg(self) -> Fused {
        Fused(-self.0)
    }
}

impl Real for Fused {
    /// Runs the part inline: a separate function would be compiled without the kernel's instructions.
    #[inline(always)]
    fn apart<P: crate::Part>(part: P) -> P::Output {
        part.run()
    }

    #[inline(always)]
    fn splat(x: f64) -> Fused {
        Fused(x)
    }

    #[inline(always)]
    fn fma(self, factor: Fused, addend: Fused) -> Fused {
        Fused(self.0.mul_add(factor.0, addend.0))
    }

    #[inline(always)]
    fn fnma(self, factor: Fused, addend: Fused) -> Fused {
        Fused((-self.0).mul_add(factor.0, addend.0))
    }

    #[inline(always)]
    fn minimum(self, other: Fused) -> Fused {
        Fused(Real::minimum(self.0, other.0))
    }

    #[inline(always)]
    fn maximum(self, other: Fused) -> Fused {
        Fused(Real::maximum(self.0, other.0))
    }

    #[inline(always)]
    fn magnitude(self) -> Fused {
        Fused(self.0.abs())
    }

    #[inline(always)]
    fn at_most(self, bound: Fused) -> bool {
        self.0 <= bound.0
    }

    #[inline(always)]
    fn recip_or_zero(self) -> Fused {
        Fused(self.0.recip_or_zero())
    }

    #[inline(always)]
    fn or_one(self) -> Fused {
        Fused(self.0.or_one())
    }

    #[inline(always)]
    fn root(self) -> Fused {
        Fused(self.0.sqrt())
    }

    #[inline(always)]
    fn split(self) -> (Fused, Fused) {
        let (mantissa, exponent) = self.0.split();
        (Fused(mantissa), Fused(exponent))
    }
}

impl Lanes for Fused {
    const COUNT: usize = 1;
    const MAX_FIXED_SIZE: usize = 0;

    #[inline(always)]
    fn load(from: &[f64]) -> Fused {
        Fused(from[0])
    }

    #[inline(always)]
    fn store(self, to: &mut [f64]) {
        to[0] = self.0;
    }

    #[inline(always)]
    fn lane(self, _: usize) -> f64 {
        self.0
    }
}
