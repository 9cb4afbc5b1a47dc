//! The arithmetic that kernels are written in: one source for plain numbers, for counting and for lanes.

use std::cell::Cell;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// A number, or several numbers in lanes. Kernels never branch on the value of a number, since lanes may hold different
/// values.
pub trait Real:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// The number `x` in every lane.
    fn splat(x: f64) -> Self;
    /// self × factor + addend, rounded once where the machine has an instruction for the sum.
    fn fma(self, factor: Self, addend: Self) -> Self;
    /// addend - self × factor, rounded as in `fma`.
    fn fnma(self, factor: Self, addend: Self) -> Self;
    /// The smaller of the two; NaN if either is NaN.
    fn minimum(self, other: Self) -> Self;
    /// The larger of the two; NaN if either is NaN.
    fn maximum(self, other: Self) -> Self;
    /// Absolute value.
    fn magnitude(self) -> Self;
    /// Whether self ≤ `bound` in every lane; false if a lane of either is NaN.
    fn at_most(self, bound: Self) -> bool;
    /// 1/x to a rounding or two, for a normal x whose reciprocal is normal.
    #[inline(always)]
    fn recip(self) -> Self {
        Self::splat(1.0) / self
    }
    /// 1/√x to a rounding or two, for a normal x.
    #[inline(always)]
    fn recip_root(self) -> Self {
        Self::splat(1.0) / self.root()
    }
    /// 1/x where x > 0, else 0.
    fn recip_or_zero(self) -> Self;
    /// x where x > 0, else 1.
    fn or_one(self) -> Self;
    /// Square root.
    fn root(self) -> Self;
    /// (m, e) with x = m 2^e, 1 ≤ m < 2 and e a whole number, for a positive finite x.
    fn split(self) -> (Self, Self);
    /// Runs a part of a kernel as a separate function, compiled for the instructions of this type of number: code that
    /// a kernel uses in many places need not be inlined into each place.
    #[inline(never)]
    fn apart<P: Part>(part: P) -> P::Output {
        part.run()
    }
}

/// A part of a kernel. `run` must be `#[inline(always)]`.
pub trait Part {
    /// Result of the part.
    type Output;

    /// Does the part's work.
    fn run(self) -> Self::Output;
}

impl Real for f64 {
    #[inline(always)]
    fn splat(x: f64) -> f64 {
        x
    }

    #[inline(always)]
    fn fma(self, factor: f64, addend: f64) -> f64 {
        // Without a fused instruction, `mul_add` is a slow library call.
        if cfg!(target_feature = "fma") { self.mul_add(factor, addend) } else { self * factor + addend }
    }

    #[inline(always)]
    fn fnma(self, factor: f64, addend: f64) -> f64 {
        if cfg!(target_feature = "fma") { (-self).mul_add(factor, addend) } else { addend - self * factor }
    }

    #[inline(always)]
    fn minimum(self, other: f64) -> f64 {
        if other < self || other.is_nan() { other } else { self }
    }

    #[inline(always)]
    fn maximum(self, other: f64) -> f64 {
        if other > self || other.is_nan() { other } else { self }
    }

    #[inline(always)]
    fn magnitude(self) -> f64 {
        self.abs()
    }

    #[inline(always)]
    fn at_most(self, bound: f64) -> bool {
        self <= bound
    }

    #[inline(always)]
    fn recip_or_zero(self) -> f64 {
        if self > 0.0 { 1.0 / self } else { 0.0 }
    }

    #[inline(always)]
    fn or_one(self) -> f64 {
        if self > 0.0 { self } else { 1.0 }
    }

    #[inline(always)]
    fn root(self) -> f64 {
        self.sqrt()
    }

    #[inline(always)]
    fn split(self) -> (f64, f64) {
        const MANTISSA: u64 = (1 << 52) - 1;
        const BIAS: f64 = 1023.0;
        let tiny = self < f64::MIN_POSITIVE; // subnormal: scaled up first
        let bits = if tiny { self * 2f64.powi(64) } else { self }.to_bits();
        let exponent = (bits >> 52) as f64 - BIAS - if tiny { 64.0 } else { 0.0 };
        (f64::from_bits((bits & MANTISSA) | 1f64.to_bits()), exponent)
    }
}

/// Numbers of floating-point operations on [`Counted`] numbers, by kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Flops {
    /// Additions and subtractions.
    pub add: u64,
    /// Multiplications.
    pub mul: u64,
    /// Multiplications fused with an addition.
    pub fma: u64,
    /// Divisions, reciprocals and square roots.
    pub div: u64,
}

thread_local! {
    static FLOPS: Cell<Flops> = const { Cell::new(Flops { add: 0, mul: 0, fma: 0, div: 0 }) };
}

/// A number whose operations are counted, separately on each thread.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Counted(pub f64);

impl Counted {
    /// Numbers of the operations on [`Counted`] numbers that `work` does on this thread.
    pub fn count(work: impl FnOnce()) -> Flops {
        FLOPS.set(Flops::default());
        work();
        FLOPS.get()
    }
}

fn tally(note: impl FnOnce(&mut Flops)) {
    let mut flops = FLOPS.get();
    note(&mut flops);
    FLOPS.set(flops);
}

fn bump(count: &mut u64) {
    *count += 1;
}

impl Add for Counted {
    type Output = Counted;
    fn add(self, other: Counted) -> Counted {
        tally(|f| bump(&mut f.add));
        Counted(self.0 + other.0)
    }
}

impl Sub for Counted {
    type Output = Counted;
    fn sub(self, other: Counted) -> Counted {
        tally(|f| bump(&mut f.add));
        Counted(self.0 - other.0)
    }
}

impl Mul for Counted {
    type Output = Counted;
    fn mul(self, other: Counted) -> Counted {
        tally(|f| bump(&mut f.mul));
        Counted(self.0 * other.0)
    }
}

impl Div for Counted {
    type Output = Counted;
    fn div(self, other: Counted) -> Counted {
        tally(|f| bump(&mut f.div));
        Counted(self.0 / other.0)
    }
}

impl Neg for Counted {
    type Output = Counted;
    fn neg(self) -> Counted {
        Counted(-self.0)
    }
}

impl Real for Counted {
    fn splat(x: f64) -> Counted {
        Counted(x)
    }

    fn fma(self, factor: Counted, addend: Counted) -> Counted {
        tally(|f| bump(&mut f.fma));
        Counted(self.0.fma(factor.0, addend.0))
    }

    fn fnma(self, factor: Counted, addend: Counted) -> Counted {
        tally(|f| bump(&mut f.fma));
        Counted(self.0.fnma(factor.0, addend.0))
    }

    fn minimum(self, other: Counted) -> Counted {
        Counted(Real::minimum(self.0, other.0))
    }

    fn maximum(self, other: Counted) -> Counted {
        Counted(Real::maximum(self.0, other.0))
    }

    fn magnitude(self) -> Counted {
        Counted(self.0.abs())
    }

    fn at_most(self, bound: Counted) -> bool {
        self.0 <= bound.0
    }

    fn recip_or_zero(self) -> Counted {
        tally(|f| bump(&mut f.div));
        Counted(self.0.recip_or_zero())
    }

    fn or_one(self) -> Counted {
        Counted(self.0.or_one())
    }

    fn root(self) -> Counted {
        tally(|f| bump(&mut f.div));
        Counted(self.0.sqrt())
    }

    fn split(self) -> (Counted, Counted) {
        let (mantissa, exponent) = self.0.split();
        (Counted(mantissa), Counted(exponent))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_split_number_is_mantissa_times_power_of_two() {
        for x in [1.0, 0.75, 3e-310, 5e-324, 1e300, f64::MAX, f64::MIN_POSITIVE] {
            let (mantissa, exponent) = x.split();
            assert!((1.0..2.0).contains(&mantissa), "{x:e}: mantissa {mantissa}");
            let half = 2f64.powi((exponent / 2.0) as i32);
            let back = mantissa * half * 2f64.powi(exponent as i32 - (exponent / 2.0) as i32);
            assert_eq!(back, x, "{mantissa} 2^{exponent}");
        }
    }

    #[test]
    fn counting_does_not_change_the_numbers() {
        let flops = Counted::count(|| {
            let x = Counted(3.0).fma(Counted(2.0), Counted(1.0)) / Counted(2.0) - Counted(0.5) * Counted(1.0);
            assert_eq!(x, Counted(3.0));
        });
        assert_eq!(flops, Flops { add: 1, mul: 1, fma: 1, div: 1 });
    }
}
