//! Four numbers in lanes of a plain array, for machines without AVX2 and without NEON.

use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::{Lanes, Real};

/// Four numbers in a plain array, one in each lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Four(pub [f64; 4]);

impl Four {
    #[inline(always)]
    fn map(self, of: impl Fn(f64) -> f64) -> Four {
        Four(self.0.map(of))
    }

    #[inline(always)]
    fn with(self, other: Four, of: impl Fn(f64, f64) -> f64) -> Four {
        let (a, b) = (self.0, other.0);
        Four([of(a[0], b[0]), of(a[1], b[1]), of(a[2], b[2]), of(a[3], b[3])])
    }
}

impl Add for Four {
    type Output = Four;
    #[inline(always)]
    fn add(self, other: Four) -> Four {
        self.with(other, |a, b| a + b)
    }
}

impl Sub for Four {
    type Output = Four;
    #[inline(always)]
    fn sub(self, other: Four) -> Four {
        self.with(other, |a, b| a - b)
    }
}

impl Mul for Four {
    type Output = Four;
    #[inline(always)]
    fn mul(self, other: Four) -> Four {
        self.with(other, |a, b| a * b)
    }
}

impl Div for Four {
    type Output = Four;
    #[inline(always)]
    fn div(self, other: Four) -> Four {
        self.with(other, |a, b| a / b)
    }
}

impl Neg for Four {
    type Output = Four;
    #[inline(always)]
    fn neg(self) -> Four {
        self.map(|a| -a)
    }
}

impl Real for Four {
    #[inline(always)]
    fn splat(x: f64) -> Four {
        Four([x; 4])
    }

    #[inline(always)]
    fn fma(self, factor: Four, addend: Four) -> Four {
        let (a, b, c) = (self.0, factor.0, addend.0);
        Four([a[0].fma(b[0], c[0]), a[1].fma(b[1], c[1]), a[2].fma(b[2], c[2]), a[3].fma(b[3], c[3])])
    }

    #[inline(always)]
    fn fnma(self, factor: Four, addend: Four) -> Four {
        let (a, b, c) = (self.0, factor.0, addend.0);
        Four([a[0].fnma(b[0], c[0]), a[1].fnma(b[1], c[1]), a[2].fnma(b[2], c[2]), a[3].fnma(b[3], c[3])])
    }

    #[inline(always)]
    fn minimum(self, other: Four) -> Four {
        self.with(other, Real::minimum)
    }

    #[inline(always)]
    fn maximum(self, other: Four) -> Four {
        self.with(other, Real::maximum)
    }

    #[inline(always)]
    fn magnitude(self) -> Four {
        self.map(f64::abs)
    }

    #[inline(always)]
    fn at_most(self, bound: Four) -> bool {
        self.0.iter().zip(&bound.0).all(|(a, b)| a <= b)
    }

    #[inline(always)]
    fn recip_or_zero(self) -> Four {
        self.map(Real::recip_or_zero)
    }

    #[inline(always)]
    fn or_one(self) -> Four {
        self.map(Real::or_one)
    }

    #[inline(always)]
    fn root(self) -> Four {
        self.map(f64::sqrt)
    }

    #[inline(always)]
    fn split(self) -> (Four, Four) {
        let parts = self.0.map(Real::split);
        (Four(parts.map(|(mantissa, _)| mantissa)), Four(parts.map(|(_, exponent)| exponent)))
    }
}

impl Lanes for Four {
    const COUNT: usize = 4;
    const MAX_FIXED_SIZE: usize = 0;

    #[inline(always)]
    fn load(from: &[f64]) -> Four {
        Four([from[0], from[1], from[2], from[3]])
    }

    #[inline(always)]
    fn store(self, to: &mut [f64]) {
        to[..4].copy_from_slice(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_numbers_are_worked_on_as_each_by_itself() {
        fn some<T: Real>(x: T, y: T) -> [T; 5] {
            let (mantissa, exponent) = (x * x + y).root().maximum(T::splat(0.5)).split();
            [mantissa, exponent, x.fnma(y, x / y), (-x).magnitude().recip_or_zero(), (x - y).or_one().minimum(y)]
        }
        let (x, y) = ([1.5, -2.25, 0.0, 1e100], [3.0, 7.5, 1e-3, 4.0]);
        let found = some(Four(x), Four(y));
        for lane in 0..4 {
            let expected = some(x[lane], y[lane]);
            found
                .iter()
                .zip(&expected)
                .for_each(|(found, expected)| assert_eq!(found.0[lane], *expected, "lane {lane}"));
        }
        assert!(Four(x).at_most(Four::splat(1e101)) && !Four(x).at_most(Four::splat(1e99)));
    }
}
