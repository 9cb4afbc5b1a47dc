//! Numbers as kernels read them: one per lane, or one for all lanes.

use kalfit_lanes::{Lanes, Real};

/// A list of numbers.
pub(crate) trait Entries<R>: Copy {
    /// Number `k`.
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

/// Numbers that are the same in every lane.
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

/// Numbers in lanes: number k of every test, then number k + 1 of every test.
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
