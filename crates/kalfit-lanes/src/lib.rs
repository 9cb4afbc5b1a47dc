//! Numbers in lanes: kernels written once over [`Real`] work on one test, on four or on eight at a time.
//!
//! [`Isa::run`] runs a [`Kernel`] with the widest registers that the machine has. A function that a kernel calls must
//! be `#[inline(always)]`, down to the arithmetic: only code inlined into the kernel is compiled for the registers of
//! the kernel.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
#[cfg(any(target_arch = "x86_64", all(target_arch = "aarch64", target_feature = "neon")))]
mod fused;
mod isa;
#[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
mod neon;
mod portable;
mod real;

pub use isa::{Alone, Isa, Kernel, UnknownInstructions, Width};
pub use portable::Four;
pub use real::{Counted, Flops, Part, Real};

/// Several numbers, one in each lane, which are read from memory together and written to memory together.
pub trait Lanes: Real + Send + Sync {
    /// Number of lanes.
    const COUNT: usize;

    /// Largest q for which q × q matrices have a separate kernel that keeps the matrices in registers; 0 where the
    /// registers are not known.
    const MAX_FIXED_SIZE: usize;

    /// Reads the first [`Self::COUNT`] numbers of `from`, a slice of at least [`Self::COUNT`] numbers.
    fn load(from: &[f64]) -> Self;

    /// Writes the numbers of all lanes to the start of `to`, a slice of at least [`Self::COUNT`] numbers.
    fn store(self, to: &mut [f64]);

    /// The number in lane `lane`, 0 ≤ `lane` < [`Self::COUNT`].
    #[inline(always)]
    fn lane(self, lane: usize) -> f64 {
        let mut all = [0.0; MAX_LANES];
        self.store(&mut all);
        all[lane]
    }

    /// Sum of the numbers of all lanes, added in a fixed order.
    #[inline(always)]
    fn sum(self) -> f64 {
        let mut all = [0.0; MAX_LANES];
        self.store(&mut all);
        let mut width = Self::COUNT;
        while width > 1 {
            width /= 2;
            for k in 0..width {
                all[k] += all[k + width];
            }
        }
        all[0]
    }
}

/// Largest [`Lanes::COUNT`] of all types of numbers.
pub const MAX_LANES: usize = 8;

/// Interleaves `lists` ≥ 1 lists: element i of the result holds `list(k)[i]` in lane k, and lanes beyond the last list
/// repeat the last list. The result is as long as the first list; no other list may be shorter.
#[inline(always)]
pub fn interleaved<'a, T: Lanes>(lists: usize, list: impl Fn(usize) -> &'a [f64]) -> Vec<T> {
    let mut all: [&[f64]; MAX_LANES] = [&[]; MAX_LANES];
    for (lane, slice) in all.iter_mut().enumerate() {
        *slice = list(lane.min(lists - 1));
    }
    let size = all[0].len();
    let mut lanes = Vec::with_capacity(size);
    for i in 0..size {
        let mut one = [0.0; MAX_LANES];
        for lane in 0..T::COUNT {
            one[lane] = all[lane][i];
        }
        lanes.push(T::load(&one));
    }
    lanes
}

impl Lanes for f64 {
    const COUNT: usize = 1;
    const MAX_FIXED_SIZE: usize = 0;

    #[inline(always)]
    fn load(from: &[f64]) -> f64 {
        from[0]
    }

    #[inline(always)]
    fn store(self, to: &mut [f64]) {
        to[0] = self;
    }
}

impl Lanes for Counted {
    const COUNT: usize = 1;
    const MAX_FIXED_SIZE: usize = 0;

    fn load(from: &[f64]) -> Counted {
        Counted(from[0])
    }

    fn store(self, to: &mut [f64]) {
        to[0] = self.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All operations of a kernel, with one number in each lane.
    struct Everything([f64; MAX_LANES], [f64; MAX_LANES]);

    impl Kernel for Everything {
        type Output = Vec<Vec<f64>>;

        #[inline(always)]
        fn run<T: Lanes>(self) -> Vec<Vec<f64>> {
            let all = |x: [f64; MAX_LANES], y: [f64; MAX_LANES]| {
                let (x, y) = (T::load(&x), T::load(&y));
                let (mantissa, exponent) = y.or_one().split();
                [
                    x + y,
                    x - y,
                    x * y,
                    x / y,
                    -x,
                    x.minimum(y),
                    x.maximum(y),
                    x.magnitude(),
                    x.recip_or_zero(),
                    x.or_one(),
                    x.magnitude().root(),
                    mantissa,
                    exponent,
                ]
            };
            let mut found = vec![Vec::new(); MAX_LANES];
            for start in (0..MAX_LANES).step_by(T::COUNT) {
                let part = |of: &[f64; MAX_LANES]| {
                    let mut part = [0.0; MAX_LANES];
                    part[..T::COUNT].copy_from_slice(&of[start..start + T::COUNT]);
                    part
                };
                for number in all(part(&self.0), part(&self.1)) {
                    (0..T::COUNT).for_each(|lane| found[start + lane].push(number.lane(lane)));
                }
            }
            found
        }
    }

    #[test]
    fn every_machine_works_on_each_lane_as_on_one_number() {
        let x = [1.5, -2.25, 0.0, 1e100, -0.0, f64::NAN, 5e-324, f64::INFINITY];
        let y = [3.0, 7.5, 1e-3, -4.0, f64::NAN, 1.0, 3e-310, -2.0];
        let expected = Everything(x, y).run::<f64>();
        for isa in Isa::all() {
            let found = isa.run(Everything(x, y));
            for (lane, (found, expected)) in found.iter().zip(&expected).enumerate() {
                for (at, (found, expected)) in found.iter().zip(expected).enumerate() {
                    let same = found.to_bits() == expected.to_bits() || (found.is_nan() && expected.is_nan());
                    assert!(same, "{isa:?}: operation {at} of lane {lane}: {found} {expected}");
                }
            }
            assert_eq!(
                format!("{:?}", isa.alone().run(Everything(x, y))),
                format!("{expected:?}"),
                "{isa:?}, one by one"
            );
        }
    }

    struct SideBySide;

    impl Kernel for SideBySide {
        type Output = Vec<Vec<f64>>;

        #[inline(always)]
        fn run<T: Lanes>(self) -> Vec<Vec<f64>> {
            let lists = [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]];
            let all = interleaved::<T>(3.min(T::COUNT), |at| &lists[at]);
            (0..T::COUNT).map(|lane| all.iter().map(|x| x.lane(lane)).collect()).collect()
        }
    }

    #[test]
    fn lists_stand_side_by_side_and_the_last_one_fills_up() {
        for isa in Isa::all() {
            for (lane, found) in isa.run(SideBySide).into_iter().enumerate() {
                let first = 1.0 + 2.0 * lane.min(2) as f64;
                assert_eq!(found, [first, first + 1.0], "{isa:?}, lane {lane}");
            }
        }
    }

    struct OneRounding;

    impl Kernel for OneRounding {
        type Output = [f64; 3];

        #[inline(always)]
        fn run<T: Lanes>(self) -> [f64; 3] {
            let (a, b) = (T::splat(1.0 + 2f64.powi(-30)), T::splat(1.0 - 2f64.powi(-30)));
            let sum = T::load(&[1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0]).sum();
            [a.fma(b, T::splat(-1.0)).lane(0), a.fnma(b, T::splat(1.0)).lane(0), sum]
        }
    }

    #[test]
    fn products_are_added_with_one_rounding_where_the_machine_can() {
        for isa in Isa::all() {
            let [fma, fnma, sum] = isa.run(OneRounding);
            let one_rounding = -(2f64.powi(-60));
            assert!(fma == one_rounding || fma == 0.0, "{isa:?}: {fma:e}");
            assert_eq!(fma, -fnma, "{isa:?}");
            assert_eq!(sum, f64::from((1 << isa.lanes()) - 1), "{isa:?}");
            assert_eq!(isa.alone().run(OneRounding), [fma, fnma, 1.0], "{isa:?}, one by one");
        }
    }

    struct Reciprocals(Vec<f64>);

    impl Kernel for Reciprocals {
        type Output = Vec<(f64, f64)>;

        #[inline(always)]
        fn run<T: Lanes>(self) -> Vec<(f64, f64)> {
            self.0.iter().map(|x| (T::splat(*x).recip().lane(0), T::splat(*x).recip_root().lane(0))).collect()
        }
    }

    #[test]
    fn reciprocals_are_off_by_two_roundings_at_most() {
        let numbers: Vec<f64> =
            (0..2000).map(|k| 1.0 + (f64::from(k) * 0.7).sin().abs() * 1.5f64.powi(k % 1500)).collect();
        for isa in Isa::all() {
            for (x, (found, root)) in numbers.iter().zip(isa.run(Reciprocals(numbers.clone()))) {
                assert!((found * x - 1.0).abs() <= 3.0 * f64::EPSILON, "{isa:?}: 1/{x}: {found} {}", 1.0 / x);
                let off = root * x.sqrt() - 1.0;
                assert!(off.abs() <= 4.0 * f64::EPSILON, "{isa:?}: 1/√{x}: {root} {}", 1.0 / x.sqrt());
            }
        }
    }

    struct Bounded;

    impl Kernel for Bounded {
        type Output = [bool; 3];

        #[inline(always)]
        fn run<T: Lanes>(self) -> [bool; 3] {
            let mut one_large = [1.0; MAX_LANES];
            one_large[T::COUNT - 1] = 3.0;
            let mut one_unknown = [1.0; MAX_LANES];
            one_unknown[T::COUNT - 1] = f64::NAN;
            let at_most = |of: [f64; MAX_LANES]| T::load(&of).at_most(T::splat(2.0));
            [at_most([1.0; MAX_LANES]), at_most(one_large), at_most(one_unknown)]
        }
    }

    #[test]
    fn a_bound_holds_when_it_holds_in_every_lane() {
        for isa in Isa::all() {
            assert_eq!(isa.run(Bounded), [true, false, false], "{isa:?}");
        }
    }
}
