//! Lists of numbers for kernels: each entry is one number per lane, or one number for all lanes.

use kalfit_lanes::{Lanes, Real};

/// A list of numbers.
pub(crate) trait Entries<R>: Copy {
    /// Entry `k` of the list.
    fn entry(self, k: usize) -> R;

    /// The list without its first `count` numbers.
    fn skip(self, count: usize) -> Self;
}

/// A list of numbers of the type that the kernel computes with.
impl<R: Real> Entries<R> for &[R] {
    #[inline(always)]
    fn entry(self, k: usize) -> R {
        self[k]
    }

    #[inline(always)]
    fn skip(self, count: usize) -> Self {
        &self[count..]
    }
}

/// A list of numbers that all lanes share.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Common<'a>(pub(crate) &'a [f64]);

impl<R: Real> Entries<R> for Common<'_> {
    #[inline(always)]
    fn entry(self, k: usize) -> R {
        R::splat(self.0[k])
    }

    #[inline(always)]
    fn skip(self, count: usize) -> Self {
        Common(&self.0[count..])
    }
}

/// A list of numbers in lanes: entry k of the test in a lane is at k × lanes + lane.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SideBySide<'a>(pub(crate) &'a [f64]);

impl<T: Lanes> Entries<T> for SideBySide<'_> {
    #[inline(always)]
    fn entry(self, k: usize) -> T {
        T::load(&self.0[k * T::COUNT..][..T::COUNT])
    }

    #[inline(always)]
    fn skip(self, count: usize) -> Self {
        SideBySide(&self.0[count * T::COUNT..])
    }
}
